"""The exploration's flow chart (figure 3.8), drawn from the table that the exploration walks."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from thigmo.exploration.states import TRANSITIONS, State

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TALL = 1.0  # between states
_HALF_WIDTH = 2.1
_HALF_TALL = 0.27
_LANE = 1.15  # between arrows beside the column
_INK = ("0.15", "tab:blue", "tab:red", "tab:green", "tab:purple", "tab:brown", "tab:cyan")


def figure() -> Figure:
    """States from top to bottom in the table's order; arrows on carry their outcomes.

    To the next state arrows run down the column, further ones on lanes at its right, back ones on
    lanes at its left.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyBboxPatch

    order = list(State)
    at = {state: -_TALL * number for number, state in enumerate(order)}
    outcomes: dict[tuple[State, State], list[str]] = defaultdict(list)
    for step in TRANSITIONS:
        outcomes[step.source, step.target].append(step.outcome)
    picture = Figure(figsize=(12.5, 14), layout="constrained")
    axis = picture.subplots()
    for state in order:
        axis.add_patch(
            FancyBboxPatch(
                (-_HALF_WIDTH, at[state] - _HALF_TALL), 2 * _HALF_WIDTH, 2 * _HALF_TALL,
                boxstyle="round,pad=0,rounding_size=0.12", facecolor="#eef3fa", edgecolor="0.3",
            )
        )  # fmt: skip
        axis.text(0.0, at[state], state.value, ha="center", va="center", fontsize=9, zorder=3)
    lanes = {1: _lanes(order, outcomes, down=True), -1: _lanes(order, outcomes, down=False)}
    arrow = {"arrowstyle": "-|>", "color": "0.15", "shrinkA": 0, "shrinkB": 0}
    for number, (pair, words) in enumerate(outcomes.items()):
        source, target = pair
        text = " / ".join(words)
        color = _INK[number % len(_INK)]
        if order.index(target) - order.index(source) == 1:
            axis.annotate(
                "", (0.0, at[target] + _HALF_TALL), (0.0, at[source] - _HALF_TALL),
                arrowprops={**arrow, "color": color},
            )  # fmt: skip
            axis.text(0.1, at[source] - _TALL / 2, text, fontsize=8, va="center", color=color)
            continue
        side = 1 if pair in lanes[1] else -1
        lane = side * (_HALF_WIDTH + _LANE * (lanes[side][pair] + 1))
        # Arrows leave below a box's middle and come in above it, so that they do not lie on
        # each other.
        begin, end = at[source] - 0.12, at[target] + 0.12
        axis.plot([side * _HALF_WIDTH, lane, lane], [begin, begin, end], color=color, linewidth=1)
        axis.annotate(
            "", (side * _HALF_WIDTH, end), (lane, end), arrowprops={**arrow, "color": color}
        )
        axis.text(
            lane, (begin + end) / 2, text, fontsize=8, color=color, va="center",
            ha="center" if source != target else "right", rotation=90 if source != target else 0,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
        )  # fmt: skip
    reach = [max(lane.values(), default=0) + 2 for lane in (lanes[-1], lanes[1])]
    axis.set(
        xlim=(-_HALF_WIDTH - _LANE * reach[0], _HALF_WIDTH + _LANE * reach[1]),
        ylim=(at[order[-1]] - 0.6, 0.6),
    )
    axis.axis("off")
    picture.suptitle("The exploration's states and transitions (thesis, figure 3.8)")
    return picture


def _lanes(
    order: list[State], pairs: dict[tuple[State, State], list[str]], *, down: bool
) -> dict[tuple[State, State], int]:
    """A lane for each arrow that does not go to the next state, short ones inside."""
    rank = {state: number for number, state in enumerate(order)}
    mine = [(s, t) for s, t in pairs if (rank[t] - rank[s] > 1 if down else rank[t] - rank[s] <= 0)]
    mine.sort(key=lambda pair: abs(rank[pair[1]] - rank[pair[0]]))
    taken: list[list[tuple[int, int]]] = []
    lanes = {}
    for source, target in mine:
        low, high = sorted((rank[source], rank[target]))
        lane = next(
            (n for n, held in enumerate(taken) if all(high < a or low > b for a, b in held)),
            len(taken),
        )
        if lane == len(taken):
            taken.append([])
        taken[lane].append((low, high))
        lanes[source, target] = lane
    return lanes
