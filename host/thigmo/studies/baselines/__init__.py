"""The methods that the localizer is compared with: what users would pick, and the thesis's own.

Called directly, with a `Problem`. `pwlf`, `ruptures`, `trees` and `trees-mechanics`
need the packages of `pip install thigmo[bench]` and say so.
"""

from __future__ import annotations

from collections.abc import Callable

from thigmo.studies.baselines import alternating as thesis
from thigmo.studies.baselines import changepoint, general, trees
from thigmo.studies.baselines.problem import Array, Problem

Baseline = Callable[[Problem], tuple[Array, Array]]

BASELINES: dict[str, Baseline] = {
    "alternating": thesis.alternating,
    "alternating-trust-constr": thesis.alternating_trust_constr,
    "coordinate": thesis.coordinate,
    "clamped": thesis.clamped,
    "coupled": thesis.coupled,
    "grid": general.grid,
    "slsqp": general.slsqp,
    "trust-constr": general.trust_constr,
    "nelder-mead": general.nelder_mead,
    "differential-evolution": general.differential_evolution,
    "dual-annealing": general.dual_annealing,
    "pwlf": changepoint.pwlf,
    "ruptures": changepoint.ruptures,
    "trees": trees.trees,
    "trees-mechanics": trees.trees_mechanics,
}

__all__ = ["BASELINES", "Baseline", "Problem"]
