"""Finds mistakes in a table of readings that the readings themselves show.

A hint is a sentence for the person who made the table. It does not change the answer, because a
body may really bend like that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thigmo.localization.localizer import localize
from thigmo.localization.result import Array, LocalizeResult
from thigmo.reading_errors import SETTLED

# Gain in log odds from which positions seem to be counted from the tip.
_TURNED = 7.0
_HELD = 0.9  # probability of a held end from which any gain counts
# Sum of squares of the differences over that of the sums, below which two sets agree.
_OPPOSITE = 0.1
_SIGMAS = 5.0  # root mean square over noise from which readings are a signal


def hints(
    result: LocalizeResult, curvature: Array, position: Array, **options: Any
) -> tuple[str, ...]:
    """Likely mistakes in the readings (N,) of a result; `options` are those of its `localize`."""
    given = options.get("free_curvature")
    free = np.broadcast_to(0.0 if given is None else given, curvature.shape)
    finite = np.isfinite(curvature)
    stated = options.get("noise")
    noise = None if stated is None else float(np.sqrt(np.mean(np.square(stated))))
    hints = []
    if _mirrored(curvature[finite], -free[finite], result.noise if noise is None else noise):
        hints.append(
            "the readings have the other sign than the free curvature: change the sign of one"
        )
    elif options.get("angle") is None and (
        opposite := _opposite_columns(curvature[finite], position[finite], noise)
    ):
        hints.append(
            f"the two sensors at {opposite} read opposite curvatures: change the sign of the "
            "column that faces the other way"
        )
    elif (
        options.get("angle") is None
        and options.get("held_end") is not True
        and _bends_the_end(
            (curvature - free)[finite],
            result.length - position[finite],
            result.noise if noise is None else noise,
        )
    ):
        hints.append(
            "the readings near the end differ from the free curvature by more than a contact can "
            "cause: give the bend of the inflated muscle as --free-curvature, in the readings' "
            "unit (or is a sensor there bad, or does something hold the end?)"
        )
    # Mistakes in the readings, if they are weighed, explain such positions as well.
    plain = SETTLED | {"offset_error": 0.0, "map_error": 0.0}
    plain |= {name: value for name, value in options.items() if value is not None}
    straight = localize(curvature, position, **plain)
    turned = localize(curvature, result.length - position, **plain)
    # Counted from the tip, a contact's moment grows towards the end, as that of a held end does.
    held = straight.hypotheses.get("end wrench", 0.0) > _HELD
    if turned.log_odds - straight.log_odds > (0.0 if held else _TURNED):
        hints.append(
            "the readings look as if positions were counted from the tip: count them from the base"
            + (" (or does something hold the end?)" if held else "")
        )
    return tuple(hints)


def _bends_the_end(excess: Array, to_end: Array, noise: float) -> bool:
    """Whether the sensors nearest to the end read more excess (n,) than a contact causes there.

    The moment of one contact falls linearly to zero at the contact, so it falls at least as fast
    towards the end as that of a contact at the end does. `to_end` (n,) is the distance to the end.
    """
    last = to_end == to_end.min(initial=np.inf)
    if last.all():
        return False
    most = to_end.min() * np.max(np.abs(excess[~last]) / to_end[~last])
    # Sensors at one place have to agree: one of them may be bad.
    agreed = max(excess[last].min(), -excess[last].max())
    return bool(agreed > most + _SIGMAS * noise)


def _mirrored(first: Array, second: Array, noise: float) -> bool:
    """Whether two sets of curvatures (n,) agree, and are well above the noise."""
    apart, together = np.square(first - second).sum(), np.square(first + second).sum()
    strong = min(np.square(first).mean(), np.square(second).mean()) > (_SIGMAS * noise) ** 2
    return bool(strong and apart < _OPPOSITE * together)


def _opposite_columns(curvature: Array, position: Array, noise: float | None) -> str:
    """Positions, as text, of the pairs of sensors if they read opposite curvatures; else "".

    If the noise is not stated, it is estimated from the sums of the pairs: the localizer's estimate
    would include the difference between the columns.
    """
    pairs = [
        (place, curvature[position == place])
        for place in np.unique(position)
        if (position == place).sum() == 2
    ]
    if not pairs:
        return ""
    first, second = np.array([pair for _, pair in pairs]).T
    if noise is None:
        noise = float(np.sqrt(np.square(first + second).mean() / 2.0))
    return ", ".join(f"{place:g}" for place, _ in pairs) if _mirrored(first, -second, noise) else ""
