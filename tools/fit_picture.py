"""The fit of one room, for docs/methods.md: docs/pictures/fit.png.

    .venv/bin/python tools/fit_picture.py [SCENE [SEED]]

explores a scene of the emulator, reads its sweeps off the record, fits them again as the
exploration did, and draws what they read, what the fit makes of that, and the room's truth.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse

import thigmo
from thigmo.config import SIGN
from thigmo.display.axes import BLUE, GREEN, INK, MUTED, ORANGE, RED, plain
from thigmo.exploration.map import best_contact, of_stage
from thigmo.exploration.recorded import recorded_sweeps
from thigmo.field import Atlas, Readings, Swept, read
from thigmo.field.hypotheses import PEG
from thigmo.field.posterior import Samples, sample
from thigmo.field.search import Search
from thigmo.mechanics import Peg
from thigmo.record import Ellipse as Spread
from thigmo.record import MapContact, RunDocument, RunFolder
from thigmo.wiring import Wiring

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "pictures" / "fit.png"
DRAWN = 120  # samples
COLORS = (BLUE, ORANGE, RED, GREEN)


@dataclass(frozen=True)
class Fitted:
    """A side of a run, and its fit."""

    document: RunDocument
    contact: MapContact
    readings: Readings
    predicted: np.ndarray  # (n, m) readings of the likeliest peg, 1/cm
    samples: Samples
    pegs: list[Peg]  # drawn from the samples by their weights, in the room

    @property
    def lengths(self) -> list[float]:
        """Everted lengths of the sweeps, cm."""
        return sorted({stage.length for stage in self.readings.stages})


def fitted(folder: Path, document: RunDocument) -> Fitted:
    """The fit to the sweeps of the side that the surest contact is on."""
    contact = best_contact(document.contacts)
    if contact is None or not contact.side:
        sys.exit("no sweep of this room felt anything: try another seed")
    config = RunFolder(folder).read_config()
    side, sign = contact.side, SIGN[contact.side]
    sweeps = [
        Swept(sweep, config.body.pressure_number(sweep.peaks[-1].length_cm))
        for sweep in recorded_sweeps(folder)
        if any(peak.side == side for peak in sweep.peaks)
    ]
    prepared = read(sweeps, side, Wiring.laid_out(config))
    assert prepared is not None  # it has a contact
    highest = max(float(prepared[0].bend.max()), 0.02)
    search = Search(*prepared, Atlas(config.body.length_cm, 1.5 * highest))
    chains = search.ridges()
    mode = min((mode for chain in chains for mode in chain), key=lambda mode: mode.cost)
    mode = search.fit.solve(PEG, mode.q, mode.xi)
    samples = sample(search, chains)
    assert samples is not None
    rng = np.random.default_rng(0)
    pegs = []
    for n in np.unique(rng.choice(samples.weight.size, DRAWN, p=samples.weight)):
        (peg,) = PEG.place(samples.q[n], search.fit.body)
        pegs.append(Peg(peg.x, sign * peg.y, peg.radius))
    predicted = search.fit.departures(mode.tables, mode.xi).value
    return Fitted(document, contact, prepared[0], predicted, samples, pegs)


def draw_readings(axes: Axes, fit: Fitted) -> None:
    """What the sensor of the base reads beyond the free bend, against that bend."""
    readings = fit.readings
    sensor = int(np.argmin(readings.centers))
    for color, length in zip(COLORS, fit.lengths, strict=False):
        stages = [n for n, stage in enumerate(readings.stages) if stage.length == length]
        for sweep in np.unique(readings.sweep[np.isin(readings.stage, stages)]):
            rows = readings.sweep == sweep
            bend = readings.bend[rows]
            axes.plot(bend, readings.curvature[rows, sensor] - bend, "o", ms=2.5, color=color,
                      mfc="none", mew=0.7)  # fmt: skip
            axes.plot(bend, fit.predicted[rows, sensor] - bend, "-", lw=1.3, color=color,
                      label=f"{length:.0f} cm out")  # fmt: skip
    axes.axhline(0.0, color=MUTED, lw=0.7)
    axes.set(
        xlabel="bend of the free body (1/cm)",
        ylabel=f"reading at {readings.centers[sensor]:.0f} cm less that bend (1/cm)",
    )
    axes.set_title("One peg explains every frame", loc="left", fontsize=10, color=INK)
    plain(axes)
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    axes.legend(handles.values(), handles.keys(), fontsize=8, frameon=False, loc="lower left")


def draw_room(axes: Axes, fit: Fitted) -> None:
    """Bodies of all sweeps of the side, the pegs that explain them, and the truth."""
    for color, length in zip(COLORS, fit.lengths, strict=False):
        for stage in fit.document.stages:
            if abs(stage.everted_length_cm - length) > 0.5:
                continue
            for shape in stage.shapes:
                if shape.side == fit.contact.side:
                    axes.plot(*np.array(shape.poses).T[:2], color=color, lw=0.8, alpha=0.7)
    draw_place(axes, fit)
    axes.set(xlabel="x (cm)", ylabel="y (cm)", aspect="equal")
    axes.set_title("The sweeps, and such pegs", loc="left", fontsize=10, color=INK)
    plain(axes)


def draw_place(axes: Axes, fit: Fitted) -> None:
    """Pegs and touched points of the samples, the 95 % ellipse, and the truth."""
    circles = [Circle((peg.x, peg.y), peg.radius) for peg in fit.pegs]
    axes.add_collection(
        PatchCollection(circles, facecolor="none", edgecolor=BLUE, lw=0.6, alpha=0.3, zorder=3)
    )
    contact, truth = fit.contact, fit.document.truth
    spread = Spread.of(contact.covariance_cm2)
    axes.add_patch(
        Ellipse(
            (contact.x_cm, contact.y_cm), 2 * spread.semi_major_cm, 2 * spread.semi_minor_cm,
            angle=float(np.degrees(spread.angle_rad)), fill=False, ec=RED, lw=1.3, ls="--",
            zorder=5, label="95 % of where it was touched",
        )
    )  # fmt: skip
    axes.plot(contact.x_cm, contact.y_cm, "o", color=RED, ms=5, zorder=6, label="fitted contact")
    axes.plot([], [], color=BLUE, lw=0.8, alpha=0.6, label="pegs that explain the sweeps")
    if truth is None:
        return
    for peg in truth.pegs:
        axes.add_patch(
            Circle((peg.x_cm, peg.y_cm), peg.radius_cm, fill=False, ec=GREEN, lw=2, zorder=4,
                   label="the peg (truth)")
        )  # fmt: skip
    nearby = [t for t in truth.contacts if of_stage(t, contact.everted_length_cm, contact.side)]
    for touch in nearby:
        axes.plot(touch.x_cm, touch.y_cm, "x", color=GREEN, ms=8, mew=2, zorder=7,
                  label="where it was touched (truth)")  # fmt: skip


def draw(fit: Fitted) -> Figure:
    """The picture."""
    figure = Figure(figsize=(10.5, 3.9), layout="constrained", facecolor="white")
    readings, room, near = figure.subplots(1, 3, width_ratios=(1.15, 1.0, 1.0))
    draw_readings(readings, fit)
    draw_room(room, fit)
    draw_place(near, fit)
    reach = 1.3 * max(3.0, Spread.of(fit.contact.covariance_cm2).semi_major_cm)
    x, y = fit.contact.x_cm, fit.contact.y_cm
    near.set(
        xlim=(x - reach, x + reach), ylim=(y - reach, y + reach), aspect="equal", xlabel="x (cm)"
    )
    error = fit.document.error_cm
    said = "" if error is None else f", {error:.2f} cm off"
    near.set_title(f"The contact{said}", loc="left", fontsize=10, color=INK)
    plain(near)
    labels = dict(zip(*near.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(labels.values(), labels.keys(), loc="outside lower right", ncols=5, fontsize=8,
                  frameon=False)  # fmt: skip
    return figure


def main() -> None:
    """Explore, fit, draw."""
    scene, seed = [*sys.argv[1:], *("default", "1")[len(sys.argv) - 1 :]]
    with tempfile.TemporaryDirectory() as runs:
        run = thigmo.explore(f"emulator://{scene}", seed=int(seed), out=runs, name="fit")
        fit = fitted(run.folder, run.document)
    draw(fit).savefig(PICTURE, dpi=110)
    contact = fit.contact
    print(
        f"{PICTURE.name}: {scene}, seed {seed}: {contact.certainty_text}; {contact.place_text}, "
        f"{fit.document.error_cm:.2f} cm off; {fit.samples.effective:.0f} effective samples"
    )


if __name__ == "__main__":
    main()
