"""map.png: where the robot was, what it swept, what it touched, and how sure it is of that.

Drawn from contacts.json alone, so that a replay draws the same picture. Everything shown was
measured, except what is marked as the room's truth, which only the emulator knows.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thigmo.config import SIDES
from thigmo.contact_status import POINT_ESTIMATE
from thigmo.display.axes import INK, MUTED, new_axes, plain, titled
from thigmo.display.bars import COLORS, OTHER_COLOR
from thigmo.errors import RunFolderError
from thigmo.extras import NotInstalledError, require
from thigmo.files import whole_file
from thigmo.record import Ellipse as Spread
from thigmo.record import outline, passed

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from thigmo.record import MapContact, Obstacle, RunDocument, Stage, Truth

_log = logging.getLogger(__name__)

_SWEPT = "#e9eff5"
_TRUTH = "#009e73"
_PRIOR = "#cc79a7"
_SIZE_IN = (7.2, 6.9)  # the width of a page: nothing is scaled down in print
_LEAST_ZOOM_CM, _MOST_ZOOM_CM = 3.0, 12.0  # half the side of what an enlarged view shows


def draw_map(
    document: RunDocument,
    path: str | os.PathLike[str],
    *,
    radius_cm: float,
    prior: Sequence[Obstacle] = (),
) -> None:
    """Draw a run's map into a PNG file, as `plot_map` does.

    Without matplotlib there is none, which a warning of this module's logger says.

    Raises:
        RunFolderError: the picture cannot be written.
    """
    try:
        require("plot", f"drawing {Path(path).name}")
    except NotInstalledError as missing:
        _log.warning("%s", missing)
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_IN, layout="constrained", facecolor="white")
    plot_map(document, figure.add_subplot(), radius_cm=radius_cm, prior=prior)
    refused = RunFolderError.from_os(
        f"cannot write {path}", "free some space, or check permissions"
    )
    figure.draw_without_rendering()  # the layout settles in its second pass
    with refused, whole_file(path) as file:
        figure.savefig(file, format="png", dpi=160)


def plot_map(
    document: RunDocument,
    axes: Axes | None = None,
    *,
    radius_cm: float,
    prior: Sequence[Obstacle] = (),
) -> Axes:
    """Draw a run's map on axes; None makes a new figure with matplotlib's pyplot.

    The radius is the tube's, `prior` the obstacles of the map that the run was given.
    """
    axes = axes or new_axes(*_SIZE_IN)
    sides = [
        [shape for shape in stage.shapes if shape.side == side]
        for stage in document.stages
        for side in SIDES
    ]
    swept = [polygon for shapes in sides for polygon in outline(passed(shapes), radius_cm)]

    def room(target: Axes) -> None:
        _robot(target, document.stages, swept, radius_cm)
        for obstacle in prior:
            _expected(target, obstacle)
        for number, contact in enumerate(document.contacts, 1):
            _contact(target, contact, number if len(document.contacts) > 1 else None)
        if document.truth is not None:
            _truth(target, document.truth)

    room(axes)
    _frame(axes, document)
    _zooms(axes, document.contacts, swept, room)
    _legend(axes)
    return axes


def _expected(axes: Axes, obstacle: Obstacle) -> None:
    """An obstacle of the map that the run was given: its cells, or the track of a contact."""
    if not obstacle.cell_cm:
        axes.plot(
            *np.asarray(obstacle.track).T, "s", color=_PRIOR, ms=3.5, mfc="none", mew=0.9,
            zorder=4, label="map given",
        )  # fmt: skip
        return
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    # All cells as one path: a building's thousands, each by itself, take a second.
    corners = obstacle.cell_corners()
    cells = PathPatch(
        Outline.make_compound_path_from_polys(corners), color=_PRIOR, alpha=0.5, lw=0, zorder=1,
        label="map given",
    )  # fmt: skip
    axes.add_artist(cells)
    axes.update_datalim([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])


def _zooms(
    axes: Axes,
    contacts: list[MapContact],
    swept: list[NDArray[np.float64]],
    room: Callable[[Axes], None],
) -> None:
    """Enlarged views of the surest contact on each side, in the corners beside the base.

    A robot sweeps a fan in front of its base, so the corners are empty unless it curls back; a view
    that would cover something is omitted.
    """
    from matplotlib.patches import Rectangle
    from matplotlib.transforms import Bbox

    (low_x, high_x), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    side_cm = min(0.36 * (high_x - low_x), 0.34 * (top - bottom))
    points = np.concatenate([np.zeros((1, 2)), *swept])
    for y_cm, corner_cm in ((1.0, top - side_cm), (-1.0, bottom)):
        corner = Bbox.from_bounds(low_x, corner_cm, side_cm, side_cm)
        side_contacts = [c for c in contacts if (c.y_cm >= 0) == (y_cm > 0)]
        if not side_contacts or corner.count_contains(points):
            continue
        contact = min(side_contacts, key=lambda c: c.interval_cm[1] - c.interval_cm[0])
        around = 1.4 * Spread.of(contact.covariance_cm2).semi_major_cm
        zoom_cm = min(max(around, _LEAST_ZOOM_CM), _MOST_ZOOM_CM)
        if side_cm < 2.5 * zoom_cm:
            continue  # it would enlarge nothing
        x, y = contact.x_cm - zoom_cm, contact.y_cm - zoom_cm
        if corner.overlaps(Bbox.from_bounds(x, y, 2 * zoom_cm, 2 * zoom_cm)):
            continue
        zoom = axes.inset_axes((low_x, corner_cm, side_cm, side_cm), transform=axes.transData)
        room(zoom)
        zoom.set(
            xlim=(x, x + 2 * zoom_cm), ylim=(y, y + 2 * zoom_cm), xticks=[], yticks=[],
            aspect="equal",
        )  # fmt: skip
        unit = zoom_cm / 5  # the ruler takes the same room in every view
        ruler = 1 if unit < 1 else 2 if unit < 2 else 4  # cm
        room_for = (2.4 * unit + ruler, 1.1 * unit)
        zoom.add_patch(Rectangle((x, y), *room_for, color="white", alpha=0.85, zorder=8))
        ends = [x + 0.4 * unit, x + 0.4 * unit + ruler]
        zoom.plot(ends, [y + 0.5 * unit] * 2, color=INK, lw=2.5, zorder=9)
        zoom.text(
            ends[1] + 0.3 * unit, y + 0.5 * unit, f"{ruler} cm", fontsize=8, color=INK,
            va="center", zorder=9,
        )  # fmt: skip
        for spine in zoom.spines.values():
            spine.set(color=MUTED, linewidth=0.8)
        axes.indicate_inset((x, y, 2 * zoom_cm, 2 * zoom_cm), edgecolor=MUTED, lw=0.8, alpha=1.0)


def _robot(
    axes: Axes, stages: list[Stage], swept: list[NDArray[np.float64]], radius_cm: float
) -> None:
    """Swept space as one pale area; over it the widest bends of each stage, darker with length."""
    from matplotlib import colormaps
    from matplotlib.collections import PolyCollection

    # One collection: a thousand single patches would take seconds. No edges: positions overlap.
    axes.add_collection(PolyCollection(swept, facecolor=_SWEPT, edgecolor="none", zorder=1))
    axes.autoscale_view()
    # A record that is cut short may not hold a length yet.
    longest = max((stage.everted_length_cm for stage in stages), default=0.0) or 1.0
    for stage in stages:
        shade = colormaps["Blues"](0.35 + 0.6 * stage.everted_length_cm / longest)
        for side in SIDES:
            shapes = [shape for shape in stage.shapes if shape.side == side]
            if shapes:
                poses = max(shapes, key=lambda shape: shape.pressure_psi).poses
                axes.plot(*np.asarray(poses).T[:2], color=shade, lw=1.4, zorder=3)
                axes.plot(*poses[-1][:2], "o", color=shade, ms=3.5, zorder=3)
        axes.plot([0.0, stage.everted_length_cm], [0.0, 0.0], color=shade, lw=1.2, zorder=2)
        axes.plot(stage.everted_length_cm, 0, "|", color=shade, ms=9, mew=1.6, zorder=2)
    if stages:
        last = stages[-1]
        touched = [s for s in last.shapes if s.side in {t.side for t in last.triggers}]
        for shape in sorted(touched, key=lambda s: s.pressure_psi)[-1:]:
            around = outline(shape.poses, radius_cm)
            axes.fill(*around.T, facecolor="#bcd0e2", alpha=0.55, edgecolor=INK, lw=0.8, zorder=2)
        axes.plot([], [], color=colormaps["Blues"](0.85), lw=1.4, label="robot at its widest bends")
        axes.fill([], [], color=_SWEPT, label="space swept")
    axes.fill([-2.4, 0, 0, -2.4], [-2.6, -2.6, 2.6, 2.6], color=INK, zorder=4, label="base")


def _contact(axes: Axes, contact: MapContact, number: int | None) -> None:
    """A contact: point on the skin, interval along the skin, 95 % ellipse; its words are a key."""
    from matplotlib.patches import Ellipse
    from matplotlib.patheffects import withStroke

    color = COLORS.get(contact.status, OTHER_COLOR)
    placed = contact.status != POINT_ESTIMATE
    if placed and len(contact.track) > 1:
        axes.plot(
            *np.asarray(contact.track).T, color=color, lw=5, alpha=0.45, zorder=5,
            solid_capstyle="round", label="95 % interval along the body",
        )  # fmt: skip
    if contact.surface:
        # Dashed while it may be something else: then it is drawn, and not occupied.
        sure = contact.status == "localized"
        axes.plot(
            *np.asarray(contact.surface).T, color=INK, lw=2.2, zorder=6,
            ls="-" if sure else (0, (3, 2)), label="wall" if sure else "wall, its place a guess",
        )  # fmt: skip
    if placed:
        around = Spread.of(contact.covariance_cm2)
        axes.add_patch(
            Ellipse(
                (contact.x_cm, contact.y_cm), 2 * around.semi_major_cm, 2 * around.semi_minor_cm,
                angle=float(np.degrees(around.angle_rad)), facecolor="none", edgecolor=color,
                lw=1.0, ls=(0, (4, 2)), zorder=5, label="95 % ellipse in the plane",
            )
        )  # fmt: skip
    named = "contact" if number is None else f"{number}"
    axes.plot(
        contact.x_cm, contact.y_cm, "o", color=color, ms=7, zorder=7, linestyle="none",
        # Hollow while it is not sure: the two differ in grey as well.
        mfc=color if contact.status == "localized" else "white",
        mec="white" if contact.status == "localized" else color, mew=1.2,
        label=f"{named}: {contact.kind_text}, {contact.status}, {contact.along_text} "
        f"({'95 %: ' * placed}{contact.interval_text})",
    )  # fmt: skip
    if number is not None:
        away_x, away_y = -11 * np.cos(contact.normal_rad), -11 * np.sin(contact.normal_rad)
        axes.annotate(
            str(number), (contact.x_cm, contact.y_cm), xytext=(away_x, away_y),
            textcoords="offset points", fontsize=9, color=INK, ha="center", va="center", zorder=8,
            path_effects=[withStroke(linewidth=2.5, foreground="white")], clip_on=True,
        )  # fmt: skip


def _truth(axes: Axes, truth: Truth) -> None:
    from matplotlib.patches import Circle

    for peg in truth.pegs:
        circle = Circle(
            (peg.x_cm, peg.y_cm), peg.radius_cm, facecolor="#d5eadf", edgecolor=_TRUTH, lw=1.3,
            zorder=4, label="peg (truth)",
        )  # fmt: skip
        axes.add_patch(circle)
    for touch in truth.contacts:
        axes.plot(
            touch.x_cm, touch.y_cm, "x", color=_TRUTH, ms=8, mew=2, zorder=6,
            label="true contact point",
        )  # fmt: skip


def _frame(axes: Axes, document: RunDocument) -> None:
    axes.set_aspect("equal", adjustable="box")
    axes.margins(0.06)
    # A run cut short still gets a picture of a readable size.
    axes.update_datalim([(-4.0, -18.0), (30.0, 18.0)])
    axes.autoscale_view()
    axes.set(xlabel="x, along the straight robot (cm)", ylabel="y, to its left (cm)")
    plain(axes)
    count = len(document.contacts)
    count_text = "no contact" if count == 0 else f"{count} contact{'s' if count > 1 else ''}"
    facts = [shorten(document.outcome, 70, placeholder=" ...")]
    if document.error_x_cm is not None:
        facts.append(
            f"x error {document.error_x_cm:.2f} cm, in the plane {document.error_cm:.2f} cm"
        )
    if document.stall is not None and document.stall.pressure > 0.5:
        facts.append(f"stalled at {document.stall.length_cm:.0f} cm, for want of pressure")
    facts.append(f"{document.robot_time_s:.0f} s of robot time")
    titled(axes, f"{document.name}: {count_text}", "; ".join(facts))


def _legend(axes: Axes) -> None:
    """The key, below the map, where it covers nothing; a line for each kind of thing."""
    key: dict[str, Artist] = {}
    for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
        key.setdefault(label, handle)
    if key:
        axes.figure.legend(
            list(key.values()), list(key), loc="outside lower center", ncols=2, fontsize=8,
            frameon=False,
        )  # fmt: skip
