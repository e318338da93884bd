"""Section 3.5: whole explorations on the emulator, by the thesis's protocol and by ours.

`explorations.py` makes them with a robot and draws the same.

The thesis's column here is its solver on the full sweep's peak readings of its own protocol, at the
first stage with a contact; ours is the exploration's answer. Robot time is device time.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from thigmo.exploration import ExplorationResult, explore
from thigmo.exploration.replay import recorded_sweeps
from thigmo.record import RunFolder
from thigmo.robot import SensorTable
from thigmo.studies.baselines import BASELINES, Problem
from thigmo.studies.engine import Claim, Table
from thigmo.studies.experiments import thesis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_URL = "emulator://default"


@dataclass(frozen=True)
class Run:
    """One seed: both protocols (cm, s); infinite errors where no contact was mapped."""

    seed: int
    thesis_solver_cm: float
    thesis_protocol_x_cm: float
    thesis_protocol_cm: float
    thesis_protocol_s: float
    ours_x_cm: float
    ours_cm: float
    ours_s: float


def _errors(result: ExplorationResult) -> tuple[float, float]:
    found = result.document
    if found.error_x_cm is None or found.error_cm is None:
        return float("inf"), float("inf")
    return found.error_x_cm, found.error_cm


def thesis_solver(run: RunFolder, obstacle_x_cm: float) -> float:
    """|a - x of the obstacle| of the thesis's solver on the first contact's peak, cm.

    Stages with fewer readings than the thesis's solver needs are passed over, as the thesis does.
    """
    table = SensorTable.of(run.read_config())
    for sweep in recorded_sweeps(run.path):
        for trigger in sweep.triggers:
            peak = next((p for p in sweep.peaks if p.side == trigger.side), None)
            if peak is None:
                continue
            use = table.usable(peak.side, peak.sensors) & np.isfinite(peak.curvature)
            if use.sum() < thesis.LEAST_READINGS:
                continue
            arcs, _ = BASELINES["alternating"](
                Problem(
                    peak.curvature[use] - peak.free_curvature,
                    table.center_cm[use],
                    np.zeros(int(use.sum())),
                    peak.length_cm,
                )
            )
            return abs(float(arcs[0]) - obstacle_x_cm)
    return float("inf")


def run_seed(seed: int) -> Run:
    """Explore the default room by both protocols."""
    with tempfile.TemporaryDirectory() as folder:
        theirs = explore(_URL, seed=seed, out=folder, name="thesis", protocol="thesis")
        assert theirs.document.truth is not None  # the emulator's room knows itself
        (peg,) = theirs.document.truth.pegs
        solver = thesis_solver(RunFolder(theirs.folder), peg.x_cm)
        mine = explore(_URL, seed=seed, out=folder, name="measure", protocol="measure")
    return Run(
        seed,
        solver,
        *_errors(theirs),
        theirs.document.robot_time_s,
        *_errors(mine),
        mine.document.robot_time_s,
    )


def claims(runs: list[Run]) -> list[Claim]:
    """What the exploration promises over all seeds."""
    ours = [run.ours_x_cm for run in runs]
    return [
        Claim("exploration: mean |x error| over the seeds", float(np.mean(ours)), 1.5, unit="cm"),
        Claim(
            "exploration: robot time over the thesis's protocol's",
            float(np.mean([run.ours_s for run in runs]) / _mean_time(runs)),
            0.5,
        ),
        Claim("exploration: worst |x error| over the seeds", float(np.max(ours)), 3.0, unit="cm"),
    ]


def _mean_time(runs: list[Run]) -> float:
    return float(np.mean([run.thesis_protocol_s for run in runs]))


def table(runs: list[Run]) -> Table:
    """One line a seed."""
    return Table("runs", tuple(vars(runs[0])), [tuple(vars(run).values()) for run in runs])


def figure(runs: list[Run]) -> Figure:
    """Error on the map against robot time, both protocols."""
    from matplotlib.figure import Figure

    picture = Figure(figsize=(7, 4.4), layout="constrained")
    axis = picture.subplots()
    for label, color, times, errors in (
        (
            "thesis's protocol and solver",
            "tab:red",
            [r.thesis_protocol_s for r in runs],
            [r.thesis_solver_cm for r in runs],
        ),
        (
            "thesis's protocol, our localizer",
            "tab:orange",
            [r.thesis_protocol_s for r in runs],
            [r.thesis_protocol_x_cm for r in runs],
        ),
        ("ours", "tab:blue", [r.ours_s for r in runs], [r.ours_x_cm for r in runs]),
    ):
        answered = np.isfinite(errors)
        count = f"{int(answered.sum())} of {len(runs)} mapped"
        axis.plot(
            np.array(times)[answered],
            np.array(errors)[answered],
            "o",
            color=color,
            alpha=0.7,
            label=f"{label} ({count})",
        )
    told = thesis.published("exploration", "obstacle at the farthest place").mean_cm
    axis.axhline(told, color="gray", linestyle="--", label=f"thesis, one run: {told} cm")
    axis.set(
        xlabel="robot time (s)",
        ylabel="|x error| of the mapped contact (cm)",
        xlim=(0, None),
        ylim=(0, None),
    )
    axis.grid(alpha=0.2)
    axis.legend(fontsize=8)
    axis.set_title(f"Exploration of the default room, {len(runs)} seeds")
    return picture


def stages(seed: int) -> Figure:
    """The robot growing and bending until it meets the peg, stage by stage (figure 3.9)."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    with tempfile.TemporaryDirectory() as folder:
        found = explore(_URL, seed=seed, out=folder, name="stages", protocol="thesis").document
    shown = [stage for stage in found.stages if stage.shapes]
    columns = 3
    rows = -(-len(shown) // columns)
    picture = Figure(figsize=(3.6 * columns, 4.2 * rows), layout="constrained")
    axes = np.atleast_2d(picture.subplots(rows, columns, sharex=True, sharey=True)).ravel()
    for axis in axes[len(shown) :]:
        axis.axis("off")
    for letter, axis, stage in zip("abcdefghij", axes, shown, strict=False):
        for side, color in (("left", "tab:blue"), ("right", "tab:orange")):
            shapes = [shape for shape in stage.shapes if shape.side == side]
            for number, shape in enumerate(shapes):
                x, y, _ = np.array(shape.poses).T
                label = f"{side} muscle, 0 to 18 psi" if number == 0 else None
                axis.plot(x, y, color=color, linewidth=1, label=label)
        for number, peg in enumerate(found.truth.pegs if found.truth else ()):
            circle = Circle((peg.x_cm, peg.y_cm), peg.radius_cm, color="k")
            circle.set_label("dowel" if number == 0 else "")
            axis.add_patch(circle)
        felt = [c for c in found.contacts if c.everted_length_cm == stage.everted_length_cm]
        for contact in felt:
            axis.plot(
                contact.x_cm, contact.y_cm, "rx", markersize=9, markeredgewidth=2,
                label="contact, localized",
            )  # fmt: skip
        title = f"({letter}) {stage.everted_length_cm:.0f} cm out"
        axis.set_title(title + (", contact" if felt else ""), fontsize=10)
        axis.set(aspect="equal", xlabel="x (cm)", ylabel="y (cm)")
        axis.grid(alpha=0.2)
    axes[len(shown) - 1].legend(fontsize=7, loc="lower left")
    error = "none" if found.error_x_cm is None else f"{found.error_x_cm:.2f} cm"
    picture.suptitle(
        f"Exploring with an obstacle at an unknown place (thesis, figure 3.9); |x error| {error}"
    )
    return picture
