"""Methods for comparison with the localizer: those that users would choose, and the thesis's.

Called directly, with a `BaselineProblem`. `pwlf`, `ruptures`, `trees` and `trees-mechanics` need
the packages of `pip install thigmo[bench]` and say so.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from thigmo.localization import thesis
from thigmo.localization.thesis import Array
from thigmo_bench.baselines import general
from thigmo_bench.baselines.exact import exact
from thigmo_bench.baselines.general import BaselineProblem

Baseline = Callable[[BaselineProblem], tuple[Array, Array]]

BASELINES: dict[str, Baseline] = {
    "alternating": thesis.alternating,
    "alternating-2-norm": partial(thesis.alternating, norm=2),
    "alternating-trust-constr": general.alternating_trust_constr,
    "coordinate": partial(thesis.alternating, barriers=()),
    "clamped": thesis.clamped,
    "coupled": thesis.coupled,
    "l1": exact,
    "l2": partial(exact, norm=2),
    "grid": general.grid,
    **{name: partial(general.optimised, name) for name in general.OPTIMISERS},
    "pwlf": general.pwlf,
    "ruptures": general.ruptures,
    "trees": general.trees,
    "trees-mechanics": partial(general.trees, mechanics=True),
}

__all__ = ["BASELINES", "Baseline", "BaselineProblem"]
