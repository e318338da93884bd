"""The figure of an occupancy grid: what is free, what is occupied, what nobody knows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from thigmo.record.occupancy import FREE, OCCUPIED
from thigmo.report.axes import INK, new_axes, plain, titled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from thigmo.record import OccupancyGrid

_FREE, _UNKNOWN = "#ffffff", "#d3d9df"


def draw_grid(grid: OccupancyGrid, axes: Axes | None = None) -> Axes:
    """Draw the cells in the robot's frame; `axes` None makes a new figure."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch
    from matplotlib.transforms import Affine2D

    axes = axes or new_axes(7.2, 6.0)
    rows, columns = grid.cells.shape
    shade = np.ones(grid.cells.shape)
    shade[grid.cells == FREE] = 0
    shade[grid.cells == OCCUPIED] = 2
    x, y, yaw = grid.origin
    size = grid.resolution_cm
    axes.imshow(
        shade, origin="lower", cmap=ListedColormap([_FREE, _UNKNOWN, INK]), vmin=0, vmax=2,
        interpolation="nearest", extent=(0, columns * size, 0, rows * size),
        transform=Affine2D().rotate(yaw).translate(x, y) + axes.transData,
    )  # fmt: skip
    corners = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], dtype=np.float64) * size
    turned = Affine2D().rotate(yaw).translate(x, y).transform(corners)
    axes.set_xlim(turned[:, 0].min(), turned[:, 0].max())
    axes.set_ylim(turned[:, 1].min(), turned[:, 1].max())
    axes.set_aspect("equal")
    axes.set_xlabel("x, along the straight robot (cm)")
    axes.set_ylabel("y, to its left (cm)")
    plain(axes)
    axes.grid(visible=False)
    area = (size / 100.0) ** 2
    titled(
        axes,
        "Occupancy grid",
        f"{columns} x {rows} cells of {size:.4g} cm; free {area * (grid.cells == FREE).sum():.2f} "
        f"m², occupied {area * (grid.cells == OCCUPIED).sum():.3f} m²",
    )
    names = (("free", _FREE), ("unknown", _UNKNOWN), ("occupied", INK))
    axes.legend(
        handles=[Patch(facecolor=color, edgecolor="#9aa6b2", label=name) for name, color in names],
        loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8,
    )  # fmt: skip
    return axes
