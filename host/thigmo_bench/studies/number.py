"""The localizer's two claims: the number of contacts, and the place of each.

The study asks three questions. Is the number right as often as its probability says? (Frames are
drawn from the localizer's own prior, on the independent rod.) Are both of two contacts found where
the Cramer-Rao bound permits it? What does it cost to require a higher level for claims, and to
leave open the body's end and its fold? A contact counts if it alone moves the readings by at least
three standard errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from thigmo.design import arc_bounds
from thigmo.display.axes import BLUE, ORANGE
from thigmo.localization import Localizer, LocalizeResult, priors
from thigmo.mechanics.closed_forms import phi
from thigmo_bench.studies import contact_scenes
from thigmo_bench.studies.charts import curves, legend_below, panels
from thigmo_bench.studies.contact_scenes import holds, signs
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record, last, parts, share
from thigmo_bench.studies.loads import DENSE, NOTHING_SAID, anywhere
from thigmo_bench.studies.rod import Floats, solve
from thigmo_bench.studies.scenes import BOTH, CRITICAL, LENGTH, ROBOT, SIGMA, SPAN

BATCH = 100
BOUNDS = (0.5, 1.0, 1.5, 2.0, 2.5, 4.0, 8.0)  # cm, upper edges of the bins
PROMISED_CM = 2.5
SURE = 0.9  # probability from which a number counts as sure
BINS = np.linspace(0.0, 1.0, 11)
NUMBER_LEVELS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99)
WIDTHS = (0.04, 0.08, 0.12, 0.15, 10.0 / 53.0, 0.25, 0.35)  # of the length
TRADED: dict[str, contact_scenes.Draw] = {
    "pressed": contact_scenes.pressed,
    "bent": contact_scenes.bent,
    "peg": contact_scenes.GROUPS["peg"],
    "two bent, 20 readings": partial(anywhere, 2, True, DENSE),
}
SINGLES = tuple(TRADED)[:3]
# Stated besides, where the truth has no bad reading and nothing on the end's face.
PLAIN: dict[str, Any] = ROBOT | {"end_face_odds": 0.0, "bad_reading_odds": 1e-6}


@dataclass(frozen=True)
class Traded:
    """A group's frames at one level of one claim."""

    group: str
    claim: str  # "number" or "place"
    level: float
    localized: float
    wrong: float  # share of all frames
    wrong_of_localized: float  # share of the frames with a localized contact
    count: int


def _countable(arcs: Floats, forces: Floats) -> int:
    """Number of contacts that count."""
    column = phi(arcs[:, None], BOTH, SPAN) * forces[:, None] / SIGMA
    return int((np.sqrt(np.square(column).sum(axis=1)) >= priors.DETECTED).sum())


def by_prior(task: tuple[tuple[int, ...], int]) -> NDArray[np.float64]:
    """A batch of frames drawn from the prior: (size, 5) probabilities of the number, and the truth.

    The prior is that of a straight body: number by its odds, places by `place_density`, forces by
    the largest moment's three scales.
    """
    key, size = task
    rng = np.random.default_rng(key)
    odds = np.exp([0.0, *(priors.CONTACT + further * priors.ANOTHER for further in range(3))])
    localizer = Localizer.of(position=BOTH, length=LENGTH, span=SPAN, noise=SIGMA, **PLAIN)
    out = np.zeros((size, 5))
    for row in out:
        count = int(rng.choice(4, p=odds / odds.sum()))
        swept = rng.uniform(size=count) < priors.SWEPT
        arcs = LENGTH * np.sort(rng.uniform(size=count) ** np.where(swept, 1.0 / 3.0, 1.0))
        scale = rng.choice(priors.MOMENTS) / LENGTH  # base moment over EI
        forces = scale * rng.standard_normal(count)
        forces /= np.maximum(arcs, priors.LEAST_LEVER * LENGTH)
        clean = np.zeros(BOTH.size)
        if count:
            clean = solve(arcs[None], forces[None], length=LENGTH).readings(BOTH, SPAN)[0]
        result = localizer.localize(clean + SIGMA * rng.standard_normal(BOTH.size))
        row[:4], row[4] = result.number, _countable(arcs, forces)
    return out


def calibration(frames: NDArray[np.float64]) -> tuple[list[dict[str, Any]], float]:
    """How often the likeliest number was right, by bins of its probability; and the mean error."""
    stated, correct = frames[:, :4].max(axis=1), frames[:, :4].argmax(axis=1) == frames[:, 4]
    place = np.clip(np.digitize(stated, BINS) - 1, 0, len(BINS) - 2)
    rows = [
        {"said": float(stated[place == b].mean()), "correct": share(correct[place == b]),
         "count": int((place == b).sum())}
        for b in range(len(BINS) - 1) if (place == b).any()
    ]  # fmt: skip
    error = sum(row["count"] * abs(row["said"] - row["correct"]) for row in rows) / len(frames)
    return rows, error


def pairs(task: tuple[tuple[int, ...], int]) -> NDArray[np.float64]:
    """A batch of two contacts on a straight body.

    Returns:
        (size, 4) bound (cm); whether two were found, each place is in its set, both are localized.
    """
    key, size = task
    rng = np.random.default_rng(key)
    localizer = Localizer.of(position=DENSE, length=LENGTH, span=SPAN, noise=SIGMA, **ROBOT)
    out = np.zeros((size, 4))
    for row in out:
        arcs = np.sort(rng.uniform(8.0, LENGTH, 2))
        forces = signs(rng, 2) * rng.uniform(0.2, 1.0, 2) * CRITICAL / arcs
        row[0] = arc_bounds(arcs, forces, DENSE, SPAN, SIGMA, LENGTH).max()
        clean = solve(arcs[None], forces[None], length=LENGTH).readings(DENSE, SPAN)[0]
        result = localizer.localize(clean + SIGMA * rng.standard_normal(DENSE.size))
        two = len(result.contacts) == 2
        row[1], row[3] = two, result.status == "localized"
        row[2] = two and all(
            any(low <= arc <= high for low, high in contact.intervals)
            for arc, contact in zip(arcs, result.contacts, strict=True)
        )
    return out


def _localized(result: LocalizeResult, arcs: Floats) -> tuple[bool, bool]:
    placed = [contact for contact in result.contacts if contact.status == "localized"]
    return bool(placed), any(not holds(arcs, contact.interval) for contact in placed)


def trade(task: tuple[str, tuple[int, ...], int]) -> NDArray[np.bool_]:
    """A batch of frames of a group at every level: (levels, size, 2) localized and wrong."""
    name, key, size = task
    rng = np.random.default_rng(key)
    scenes = TRADED[name](rng, size)
    noisy = scenes.curvature + SIGMA * rng.standard_normal(scenes.curvature.shape)
    stated: dict[str, Any] = {"position": scenes.position, "length": LENGTH, "span": SPAN}
    stated |= {"noise": SIGMA} | ROBOT
    option_sets: list[dict[str, Any]] = [
        *({"number_level": level} for level in NUMBER_LEVELS),
        *({"width_limit": LENGTH * width} for width in WIDTHS),
        NOTHING_SAID,
    ]
    localizers = [Localizer.of(**(stated | options)) for options in option_sets]
    frames = list(zip(noisy, scenes.free, scenes.arcs, strict=True))
    return np.array([
        [_localized(localizer.localize(y, free_curvature=g), arcs) for y, g, arcs in frames]
        for localizer in localizers
    ])  # fmt: skip


def _calibration_figure(rows: list[dict[str, Any]], curve: list[dict[str, Any]]) -> Figure:
    figure, (first, second) = panels(
        1, 2, size=(3.7, 3.4),
        title="The number of contacts: is its probability right, and are both contacts found?",
    )  # fmt: skip
    first.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    stated, hit, count = (
        np.array([row[column] for row in rows]) for column in ("said", "correct", "count")
    )
    error = np.sqrt(np.maximum(hit * (1.0 - hit), 0.25 / count) / count)
    bars = np.minimum(1.96 * error, [hit, 1.0 - hit])  # shares end at 0 and 1
    first.errorbar(stated, hit, bars, fmt="o", color=BLUE, markersize=4, linewidth=1.0)
    first.set(
        xlabel="probability of the likeliest number", ylabel="share of frames with that number",
        xlim=(0.25, 1.02), ylim=(0, 1.05),
    )  # fmt: skip
    lines = {
        name: [(row["bound_cm"], 100.0 * row[column]) for row in curve]
        for name, column in (("both found", "both"), ("two answered", "two"))
    }
    curves(second, lines, xlabel="Cramér-Rao bound of the worse place (cm)", ylabel="frames (%)")
    # The promise is at the upper left.
    for draw, position, label in (
        (second.axvline, PROMISED_CM, "promise: bounds up to this"),
        (second.axhline, 60.0, "promise: at least this many found"),
    ):
        draw(position, color="0.6", linewidth=0.8, linestyle=":", label=label)
    second.set(xlim=(0, BOUNDS[-1]), ylim=(0, 102))
    second.legend(fontsize=7, frameon=False)
    return figure


def _trade_figure(traded: list[Traded], priced: list[dict[str, Any]]) -> Figure:
    figure, axes = panels(
        1, 3, size=(3.4, 3.4),
        title="What it costs to be right more often: fewer frames are called localized",
    )  # fmt: skip
    for axis, claim, title in (
        (axes[0], "number", "number held to a level"),
        (axes[1], "place", "widest interval"),
    ):
        lines: dict[str, list[tuple[float, float]]] = {group: [] for group in TRADED}
        for row in traded:
            if row.claim == claim:
                point = (100 * row.localized, 100 * row.wrong_of_localized)
                lines[row.group].append(point)
        curves(axis, lines, xlabel="localized (%)", ylabel="wrong (% of localized)", title=title)
    positions = np.arange(len(priced))
    for shift, statement, color in ((-0.2, "said", BLUE), (0.2, "not_said", ORANGE)):
        values = [100 * row[f"localized_{statement}"] for row in priced]
        label = "end and fold stated" if statement == "said" else "nothing stated"
        axes[2].bar(positions + shift, values, 0.4, color=color, label=label)
    axes[2].set_xticks(positions, [row["group"].replace(", ", ",\n") for row in priced], fontsize=6)
    axes[2].set(ylabel="localized (%)", title="price of stating nothing")
    axes[2].legend(fontsize=6, frameon=False)
    legend_below(figure)
    return figure


def run(context: Context) -> Outcome:
    """Calibration of the number, pairs by their bound, and results by level."""
    seed = context.seed

    def batches(part: int, quick: int, full: int) -> list[tuple[tuple[int, ...], int]]:
        return [((seed, part, b), size) for b, size in parts(context.count(quick, full), BATCH)]

    drawn = np.concatenate(context.map(by_prior, batches(1, 100, 2000), "drawn by the prior", last))
    rows, error = calibration(drawn)
    answered = np.concatenate(context.map(pairs, batches(2, 60, 6000), "pairs", last))
    edges = (0.0, *BOUNDS)
    curve = []
    for low, high in pairwise(edges):
        in_bin = answered[(answered[:, 0] > low) & (answered[:, 0] <= high)]
        if len(in_bin):
            curve.append({
                "bound_cm": float(np.median(in_bin[:, 0])), "count": len(in_bin),
                "two": share(in_bin[:, 1]), "both": share(in_bin[:, 2]),
                "localized": share(in_bin[:, 3]),
            })  # fmt: skip
    promised = answered[answered[:, 0] <= PROMISED_CM]
    tasks = [(name, key, size) for n, name in enumerate(TRADED)
             for key, size in batches(3 + n, 20, 600)]  # fmt: skip
    answers: dict[str, list[NDArray[np.bool_]]] = {name: [] for name in TRADED}
    for (name, *_), batch_result in zip(
        tasks, context.map(trade, tasks, "levels", last), strict=True
    ):
        answers[name].append(batch_result)
    levels = [("number", level) for level in NUMBER_LEVELS] + [("place", w) for w in WIDTHS]
    traded: list[Traded] = []
    priced: list[dict[str, Any]] = []
    for name, batch in answers.items():
        together = np.concatenate(batch, axis=1)
        for (claim, level), frames in zip(levels, together[:-1], strict=True):
            localized, wrong = frames.mean(axis=0).tolist()
            of_localized = share(frames[frames[:, 0], 1])
            traded.append(Traded(name, claim, level, localized, wrong, of_localized, len(frames)))
        priced.append({"group": name})
        for statement, frames in (("said", together[0]), ("not_said", together[-1])):
            localized, wrong = frames.mean(axis=0).tolist()
            priced[-1] |= {
                f"localized_{statement}": localized, f"wrong_{statement}": wrong,
                f"wrong_of_localized_{statement}": share(frames[frames[:, 0], 1]),
            }  # fmt: skip
    localized_share = [row["localized_not_said"] / max(row["localized_said"], 1e-9)
            for row in priced if row["group"] in SINGLES]  # fmt: skip
    claims = [
        Claim("P(number): expected calibration error, frames drawn by the prior", error, 0.05),
        Claim(f"two contacts, bound of {PROMISED_CM:g} cm or less: both found, each in its own set",
              share(promised[:, 2]), 0.6, at_most=False),
        Claim("nothing said of end and fold: least share of the localized single contacts that "
              "stay so", min(localized_share), 2.0 / 3.0, at_most=False),
    ]  # fmt: skip
    figures = {
        "number": _calibration_figure(rows, curve),
        "trade": _trade_figure(traded, priced),
    }
    tables: dict[str, Sequence[Record]] = {
        "rows": rows, "bounds": curve, "trade": [asdict(row) for row in traded], "price": priced
    }  # fmt: skip
    doubted = drawn[drawn[:, :4].max(axis=1) < SURE]
    correct = share(doubted[:, :4].argmax(axis=1) == doubted[:, 4])
    mean_probability = float(doubted[:, :4].max(axis=1).mean()) if len(doubted) else float("nan")
    note = (
        f"{len(doubted)} of {len(drawn)} frames have a likeliest number of probability below "
        f"{SURE:g}: {mean_probability:.2f} on average, and {correct:.2f} of them have that number"
    )
    return Outcome(tables, figures, claims, [note], summary=curve)
