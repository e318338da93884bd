"""The thesis's experiments, repeated: the same conditions, three columns, and the bound.

`study.py` runs them, `conditions.py` says what is pressed where, `specimen.py` what an imperfect
robot then reads, `fit.py` how imperfect, `compare.py` sets the methods against each other.
"""

from __future__ import annotations

from thigmo.experiments.study import EXPERIMENTS, Results, run

__all__ = ["EXPERIMENTS", "Results", "run"]
