"""The thesis's experiments, repeated: the same conditions, three columns, and the bound.

`study.py` runs them on simulated robots: `conditions.py` says what is pressed where, `specimen.py`
what an imperfect robot then reads, `fit.py` how imperfect. `procedure.py` and `recorded.py` do the
same trials with a robot on the bench or the whole emulator. `compare.py` sets the methods against
each other on either.
"""

from __future__ import annotations

from thigmo.studies.experiments.evaluate import Results
from thigmo.studies.experiments.study import EXPERIMENTS, run

__all__ = ["EXPERIMENTS", "Results", "run"]
