"""Mistakes in a table of readings that can be seen in the readings themselves.

Each is a sentence for the person who made the table. None changes an answer: a body may bend like
that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thigmo.localization.localizer import localize
from thigmo.localization.result import Array, LocalizeResult

# Log of how much likelier the readings must be with positions counted from the tip.
_TURNED = 7.0
_HELD = 0.9  # probability of a held end from which any gain is a reason to look
_OPPOSITE = 0.1  # share of the squares that a change of sign leaves
_SIGMAS = 5.0  # root mean square from which readings are more than noise


def hints(
    result: LocalizeResult, curvature: Array, position: Array, **options: Any
) -> tuple[str, ...]:
    """What the readings (N,) of a result look like; `options` are those of its `localize`."""
    free = np.broadcast_to(options.get("free_curvature", 0.0), curvature.shape)
    seen = np.isfinite(curvature)
    stated = options.get("noise")
    noise = None if stated is None else float(np.sqrt(np.mean(np.square(stated))))
    found = []
    if _mirrored(curvature[seen], -free[seen], result.noise if noise is None else noise):
        found.append(
            "the readings have the other sign than the free curvature: change the sign of one"
        )
    elif options.get("direction") is None and (
        opposite := _opposite_columns(curvature[seen], position[seen], noise)
    ):
        found.append(
            f"the two sensors at {opposite} read opposite curvatures: change the sign of the "
            "column that faces the other way"
        )
    turned = localize(curvature, result.length - position, **options)
    # Counted from the tip, a contact's moment grows towards the end, as that of a held end does.
    held = result.hypotheses.get("end wrench", 0.0) > _HELD
    if turned.log_odds - result.log_odds > (0.0 if held else _TURNED):
        found.append(
            "the readings look as if positions were counted from the tip: count them from the base"
            + (" (or does something hold the end?)" if held else "")
        )
    return tuple(found)


def _mirrored(one: Array, other: Array, noise: float) -> bool:
    """Whether two sets of curvatures (n,) are one another's negatives, and not the same."""
    apart, together = np.square(one - other).sum(), np.square(one + other).sum()
    strong = min(np.square(one).mean(), np.square(other).mean()) > (_SIGMAS * noise) ** 2
    return bool(strong and apart < _OPPOSITE * together)


def _opposite_columns(curvature: Array, position: Array, noise: float | None) -> str:
    """Positions, as words, of pairs of sensors that read opposite; none if one pair agrees.

    Noise that is not stated is that of the pairs' sums: the localizer's would take a column of the
    other sign for noise.
    """
    pairs = [
        (place, curvature[position == place])
        for place in np.unique(position)
        if (position == place).sum() == 2
    ]
    if not pairs:
        return ""
    one, other = np.array([both for _, both in pairs]).T
    if noise is None:
        noise = float(np.sqrt(np.square(one + other).mean() / 2.0))
    return ", ".join(f"{place:g}" for place, _ in pairs) if _mirrored(one, -other, noise) else ""
