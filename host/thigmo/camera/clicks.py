"""Points given by hand where detection fails: typed, read from a file, or clicked in a window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thigmo.camera.exceptions import CameraError
from thigmo.camera.model import Kept

Pixel = tuple[float, float]


@dataclass(frozen=True)
class Clicks(Kept):
    """Pixels given by hand; their file spares clicking a picture twice."""

    what = "file of clicks"
    cure = "click with `--click`"
    tip: Pixel | None = None  # the tip of the body's outline
    axis: tuple[Pixel, ...] = ()  # points along the body's middle, base to tip (six or more)
    # for each dowel, three or more points on the rim of its top
    obstacles: tuple[tuple[Pixel, ...], ...] = ()


def parse_pixel(text: str) -> Pixel:
    """`812,440` to a pixel; raises CameraError for anything else."""
    try:
        x, y = map(float, text.split(","))
    except ValueError as error:
        raise CameraError(f"'{text}' is not a pixel", "write it as 812,440") from error
    return x, y


def _clicked(picture: NDArray[np.uint8], what: str) -> tuple[Pixel, ...]:
    """Points clicked on a picture in a window, until Enter is pressed or it is closed."""
    import matplotlib.pyplot as plt

    if plt.get_backend().lower() in ("agg", "pdf", "svg", "ps", "cairo", "template"):
        raise CameraError(
            "no window can be opened here", "give the points with `--tip X,Y` or `--points FILE`"
        )
    figure, axes = plt.subplots(figsize=(14, 8))
    axes.imshow(picture[..., ::-1])
    axes.set_title(f"{what}  (left: add, right: undo, Enter: done)")
    figure.canvas.mpl_connect("close_event", lambda _: figure.canvas.stop_event_loop())
    points = figure.ginput(n=-1, timeout=0)
    plt.close(figure)
    return tuple((float(x), float(y)) for x, y in points)


def click(picture: NDArray[np.uint8], what: tuple[str, ...] = ("tip",)) -> Clicks:
    """Ask for points in a window: any of `tip`, `axis`, `obstacles`.

    Raises CameraError for another word, without a window, or when too few points were clicked.
    """
    for word in what:
        if word not in ("tip", "axis", "obstacles"):
            raise CameraError(f"'{word}' cannot be clicked", "name any of tip,axis,obstacles")
    tip: Pixel | None = None
    axis: tuple[Pixel, ...] = ()
    rims: list[tuple[Pixel, ...]] = []
    if "tip" in what:
        points = _clicked(picture, "click the robot's tip")
        if not points:
            raise CameraError("no tip was clicked", "click it once, then press Enter")
        tip = points[-1]
    if "axis" in what:
        axis = _clicked(picture, "click along the robot's middle, base to tip")
        if len(axis) < 6:
            raise CameraError("the axis needs six points", "click more of them")
    while "obstacles" in what:
        rim = _clicked(picture, "click three points on a dowel's rim; none: done")
        if len(rim) < 3:
            break
        rims.append(rim)
    return Clicks(tip, axis, tuple(rims))
