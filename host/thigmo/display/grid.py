"""Figure of an occupancy grid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thigmo.display.axes import INK, new_axes, plain, titled
from thigmo.extras import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FREE, _UNKNOWN = "#ffffff", "#d3d9df"


def draw_grid(
    free: NDArray[np.bool_],
    occupied: NDArray[np.bool_],
    size_cm: float,
    origin: tuple[float, float, float],
    axes: Axes | None = None,
) -> Axes:
    """Draw an occupancy grid in the robot's frame.

    Args:
        free: (rows, columns) cells that are free, row 0 lowest in y.
        occupied: (rows, columns) cells that are occupied; the rest is unknown.
        size_cm: of a cell.
        origin: x, y (cm) and yaw (rad) of the outer corner of cell (0, 0).
        axes: the axes to draw on; None makes a new figure.

    Raises:
        NotInstalledError: matplotlib is missing.
    """
    require("plot", "a figure")
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch
    from matplotlib.transforms import Affine2D

    axes = axes or new_axes(7.2, 6.0)
    rows, columns = free.shape
    x, y, yaw = origin
    turn = Affine2D().rotate(yaw).translate(x, y)
    axes.imshow(
        np.select([free, occupied], [0.0, 2.0], 1.0), origin="lower", vmin=0, vmax=2,
        cmap=ListedColormap([_FREE, _UNKNOWN, INK]), interpolation="nearest",
        extent=(0, columns * size_cm, 0, rows * size_cm), transform=turn + axes.transData,
    )  # fmt: skip
    corners = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], dtype=np.float64)
    turned = turn.transform(size_cm * corners)
    low, high = turned.min(axis=0), turned.max(axis=0)
    axes.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal",
        xlabel="x, along the straight robot (cm)", ylabel="y, to its left (cm)",
    )  # fmt: skip
    plain(axes)
    axes.grid(visible=False)
    area = (size_cm / 100.0) ** 2
    titled(
        axes,
        "Occupancy grid",
        f"{columns} x {rows} cells of {size_cm:.4g} cm; free {area * free.sum():.2f} m², "
        f"occupied {area * occupied.sum():.3f} m²",
    )
    names = (("free", _FREE), ("unknown", _UNKNOWN), ("occupied", INK))
    axes.legend(
        handles=[Patch(facecolor=color, edgecolor="#9aa6b2", label=name) for name, color in names],
        loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8,
    )  # fmt: skip
    return axes
