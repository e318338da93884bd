"""Section 3.5: whole explorations on the emulator, by the thesis's protocol and by ours.

`explorations.py` makes them with a robot and draws the same.

The thesis's column here is its solver on the full sweep's peak readings of its own protocol, at the
first stage with a contact; ours is the exploration's answer. Robot time is device time.
"""

from __future__ import annotations

import tempfile

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from thigmo.exploration.map import best_contact
from thigmo.exploration.replay import recorded_sweeps
from thigmo.record import RunDocument, RunFolder
from thigmo.report.axes import BLUE, ORANGE, RED
from thigmo.robot import SensorTable
from thigmo.studies import charts
from thigmo.studies.baselines import BASELINES, Problem
from thigmo.studies.engine import Claim, Context, Outcome, Record
from thigmo.studies.experiments import schematics, thesis
from thigmo.studies.experiments.attendant import Place
from thigmo.studies.rooms import explored

_URL = "emulator://default"


Made = dict[str, float]
"""An exploration's |x error| "x_cm", error in the plane "cm" and robot time "s"; "solver_cm" of the
thesis's solver where its protocol was followed. Errors are infinite where no contact was mapped."""


def made(document: RunDocument, dowel: Place, thesis_run: RunFolder | None = None) -> Made:
    """What an exploration came to; its folder is needed if it followed the thesis's protocol.

    On a real robot nobody knows the point of contact: there the dowel that touches it at the
    mapped point is compared with the one that was measured.
    """
    best = best_contact(document.contacts)
    x = plane = float("inf")
    if document.error_x_cm is not None and document.error_cm is not None:
        x, plane = document.error_x_cm, document.error_cm
    elif document.truth is None and best is not None:
        # Centre of a dowel that touches the skin there.
        off_x = best.x_cm + thesis.DOWEL_CM * float(np.cos(best.normal_rad)) - dowel[0]
        off_y = best.y_cm + thesis.DOWEL_CM * float(np.sin(best.normal_rad)) - dowel[1]
        x, plane = abs(off_x), float(np.hypot(off_x, off_y))
    found = {"x_cm": x, "cm": plane, "s": document.robot_time_s}
    return found | ({"solver_cm": thesis_solver(thesis_run, dowel[0])} if thesis_run else {})


def in_words(made: Made) -> str:
    """The errors of an exploration."""
    return f"|x error| {made['x_cm']:.2f} cm, in the plane {made['cm']:.2f} cm"


def row(number: int, theirs: Made, ours: Made) -> Record:
    """Both protocols in one room (cm, s)."""
    return {
        "seed": number,
        "thesis_solver_cm": theirs["solver_cm"],
        **{f"thesis_protocol_{what}": theirs[what] for what in ("x_cm", "cm", "s")},
        **{f"ours_{what}": value for what, value in ours.items()},
    }


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
            read = peak.curvature[use] - peak.free_curvature
            places = table.center_cm[use]
            problem = Problem(read, places, np.zeros_like(places), peak.length_cm)
            arcs, _ = BASELINES["alternating"](problem)
            return abs(float(arcs[0]) - obstacle_x_cm)
    return float("inf")


def run_seed(seed: int) -> Record:
    """Explore the default room by both protocols."""
    with tempfile.TemporaryDirectory() as folder:
        theirs = explored(_URL, folder, seed, protocol="thesis", frames=True)
        assert theirs.document.truth is not None  # the emulator's room knows itself
        (peg,) = theirs.document.truth.pegs
        dowel = peg.x_cm, peg.y_cm
        solved = made(theirs.document, dowel, RunFolder(theirs.folder))
        return row(seed, solved, made(explored(_URL, folder, seed).document, dowel))


def run(robots: int, context: Context) -> Outcome:
    """One run of each protocol a seed."""
    seeds = [context.seed + robot for robot in range(robots)]
    outcome = compared(context.map(run_seed, seeds, "explorations"))
    outcome.figures |= {"stages": stages(context.seed), "flow": schematics.flow()}
    return outcome


def compared(runs: list[Record]) -> Outcome:
    """What explorations of one room promise over all seeds."""
    ours, times, theirs = (
        np.array([run[what] for run in runs], dtype=np.float64)
        for what in ("ours_x_cm", "ours_s", "thesis_protocol_s")
    )
    return Outcome(
        {"runs": runs},
        {"errors": _figure(runs)},
        [
            Claim("exploration: mean |x error| over the seeds", ours.mean(), 1.5, unit="cm"),
            Claim("exploration: robot time over the thesis's protocol's",
                  times.sum() / theirs.sum(), 0.5),
            Claim("exploration: worst |x error| over the seeds", ours.max(), 3.0, unit="cm"),
        ],
    )  # fmt: skip


def _figure(runs: list[Record]) -> Figure:
    """Error on the map against robot time, both protocols."""
    figure, (axis,) = charts.panels(
        size=(7, 4.4), title=f"Exploration of the default room, {len(runs)} seeds"
    )
    for label, color, time, error in (
        ("thesis's protocol and solver", RED, "thesis_protocol_s", "thesis_solver_cm"),
        ("thesis's protocol, our localizer", ORANGE, "thesis_protocol_s",
         "thesis_protocol_x_cm"),
        ("ours", BLUE, "ours_s", "ours_x_cm"),
    ):  # fmt: skip
        points = np.array([(run[time], run[error]) for run in runs], dtype=np.float64)
        mapped = points[np.isfinite(points[:, 1])]
        count = f"{len(mapped)} of {len(runs)} mapped"
        axis.plot(*mapped.T, "o", color=color, alpha=0.7, label=f"{label} ({count})")
    told = thesis.RESULTS["exploration", "obstacle at the farthest place"].mean_cm
    axis.axhline(told, color="gray", linestyle="--", label=f"thesis, one run: {told} cm")
    axis.set(
        xlabel="robot time (s)", ylabel="|x error| of the mapped contact (cm)", xlim=(0, None),
        ylim=(0, None),
    )  # fmt: skip
    axis.legend(fontsize=8)
    return figure


def stages(seed: int) -> Figure:
    """The robot growing and bending until it meets the peg, stage by stage (figure 3.9)."""
    with tempfile.TemporaryDirectory() as folder:
        found = explored(_URL, folder, seed, protocol="thesis").document
    shown = [stage for stage in found.stages if stage.shapes]
    error = "none" if found.error_x_cm is None else f"{found.error_x_cm:.2f} cm"
    figure, axes = charts.panels(
        -(-len(shown) // 3), 3, size=(3.6, 4.2), share="all",
        title=f"Exploring with an obstacle at an unknown place (thesis, figure 3.9); |x error| "
        f"{error}",
    )  # fmt: skip
    for axis in axes[len(shown) :]:
        axis.axis("off")
    for letter, axis, stage in zip("abcdefghij", axes, shown, strict=False):
        for shape in stage.shapes:
            x, y, _ = np.array(shape.poses).T
            axis.plot(x, y, color=BLUE if shape.side == "left" else ORANGE, linewidth=1)
        for peg in found.truth.pegs if found.truth else ():
            axis.add_patch(Circle((peg.x_cm, peg.y_cm), peg.radius_cm, color="k"))
        felt = [c for c in found.contacts if c.everted_length_cm == stage.everted_length_cm]
        axis.plot([c.x_cm for c in felt], [c.y_cm for c in felt], "rx", markersize=9)
        title = f"({letter}) {stage.everted_length_cm:.0f} cm out"
        axis.set(title=title + (", contact" if felt else ""), aspect="equal", xlabel="x (cm)")
    for color, label in (
        (BLUE, "left muscle, 0 to 18 psi"),
        (ORANGE, "right muscle, 0 to 18 psi"),
        ("k", "dowel"),
        (RED, "contact, localized"),
    ):
        axes[0].plot([], [], color=color, label=label)
    charts.legend_below(figure)
    return figure
