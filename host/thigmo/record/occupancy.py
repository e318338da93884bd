"""Occupancy grids as ROS's map_server keeps them: a PGM picture and a YAML file that describes it.

A pixel stands for an occupancy: its darkness, from 0 (white) to 1 (black), or its brightness where
`negate` is 1. Above `occupied_thresh` a cell is occupied, below `free_thresh` it is free, and else
unknown. `mode: scale` differs from `trinary` in that transparent pixels are unknown. `mode: raw`
keeps the occupancy itself, in percent, as the pixel's value; values over 100 are unknown. The
picture's first row is the map's farthest in y; `origin` is the pose of its lower left corner, in m
and rad (wiki.ros.org/map_server, map format; nav2_map_server, map_io; REP 103 for units). The grey
values are those of ROS's own map_saver.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError, model_validator

from thigmo.display.html import html_card, html_table
from thigmo.errors import RunFolderError
from thigmo.extras import require
from thigmo.files import CONFIG_BYTES, DATA_BYTES, read_file, why_unreadable
from thigmo.record.folder import write_whole
from thigmo.toml_model import Finite, Positive, invalid_entry

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FREE, UNKNOWN, OCCUPIED = 0, -1, 100  # as in nav_msgs/OccupancyGrid
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196
_CM_PER_M = 100.0

Share = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """A grid in the plane.

    `cells` (rows, columns) are FREE, UNKNOWN or OCCUPIED, row 0 lowest in y; `origin` is x, y (cm)
    and yaw (rad) of the outer corner of cell (0, 0).
    """

    cells: NDArray[np.int8]
    resolution_cm: float
    origin: tuple[float, float, float]

    def __repr__(self) -> str:
        count = ", ".join(f"{number} {name}" for name, number in self._count().items())
        return f"OccupancyGrid({self._size()}: {count})"

    def _repr_html_(self) -> str:
        x, y, yaw = self.origin
        summary = f"{self._size()}; its lower left corner at x {x:.4g}, y {y:.4g} cm"
        if yaw:
            summary += f", turned by {np.degrees(yaw):.4g}°"
        total = max(self.cells.size, 1)
        rows = [
            (name, number, f"{number * (self.resolution_cm / _CM_PER_M) ** 2:.3g} m²",
             f"{100 * number / total:.3g} %")
            for name, number in self._count().items()
        ]  # fmt: skip
        table = html_table(("", "cells", "area", "share"), rows)
        return html_card("Occupancy grid", summary, table)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the cells in the robot's frame; without axes on a new figure of pyplot."""
        from thigmo.display.grid import draw_grid

        return draw_grid(
            self.cells == FREE, self.cells == OCCUPIED, self.resolution_cm, self.origin, axes
        )

    def _size(self) -> str:
        rows, columns = self.cells.shape
        return f"{columns} x {rows} cells of {self.resolution_cm:.4g} cm"

    def _count(self) -> dict[str, int]:
        return {
            name: int((self.cells == value).sum())
            for name, value in (("free", FREE), ("occupied", OCCUPIED), ("unknown", UNKNOWN))
        }

    def centers(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x and y of every cell's centre, cm, each of the cells' shape."""
        rows, columns = self.cells.shape
        column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
        x0, y0, yaw = self.origin
        cos, sin, size = np.cos(yaw), np.sin(yaw), self.resolution_cm
        return x0 + size * (column * cos - row * sin), y0 + size * (column * sin + row * cos)


class _Description(BaseModel):
    """map.yaml; keys that other tools add (`cost_translation_table`) are kept."""

    image: str
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    resolution: Positive
    origin: tuple[Finite, Finite, Finite]
    negate: Literal[0, 1] = 0
    occupied_thresh: Share = _OCCUPIED_ABOVE
    free_thresh: Share = _FREE_BELOW

    @model_validator(mode="after")
    def _thresholds_are_in_order(self) -> Self:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("free_thresh must not be above occupied_thresh")
        return self


def write_ros_map(grid: OccupancyGrid, path: Path) -> None:
    """Write `path` (a .yaml) and the picture of the same name beside it.

    Raises RunFolderError if they cannot be written.
    """
    picture = path.with_suffix(".pgm")
    grey = np.select([grid.cells == FREE, grid.cells == OCCUPIED], [254, 0], 205).astype(np.uint8)
    x, y, yaw = grid.origin
    described = _Description(
        image=picture.name,
        resolution=round(grid.resolution_cm / _CM_PER_M, 6),
        origin=(round(x / _CM_PER_M, 6), round(y / _CM_PER_M, 6), yaw),
    )
    rows, columns = grey.shape
    write_whole(picture, f"P5\n{columns} {rows}\n255\n".encode() + grey[::-1].tobytes())
    text = yaml.safe_dump(described.model_dump(mode="json"), sort_keys=False)
    write_whole(path, text.encode())


def read_ros_map(path: str | os.PathLike[str]) -> OccupancyGrid:
    """Read a map that map_server could serve: its YAML file, and the picture that this names.

    Raises RunFolderError if one is missing or is not what it should be, NotInstalledError without
    OpenCV if the picture is not a PGM as map_saver writes it.
    """
    try:
        description = _Description.model_validate(_yaml(path))
        data = read_file(Path(path).parent / description.image, DATA_BYTES)
    except OSError as error:
        raise RunFolderError(
            f"cannot read {error.filename or path}: {error.strerror}", "check the map's paths"
        ) from error
    except ValidationError as error:
        raise RunFolderError(
            invalid_entry(path, error),
            "give a ROS map's YAML file (image, resolution, origin), or a run folder",
        ) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = why_unreadable(error)
        raise RunFolderError(
            f"{path} is not valid YAML: {reason}", "give a ROS map's YAML file, or a run folder"
        ) from error
    picture = _picture(data)
    if picture is None:
        raise RunFolderError(
            f"{description.image}, named by {path}, is not a picture", "give the map's own picture"
        )
    brightness = picture.brightness[::-1]
    if description.mode == "raw":
        occupancy = np.rint(255 * brightness) / 100.0
        has_value = occupancy <= 1.0
    else:
        occupancy = brightness if description.negate else 1.0 - brightness
        has_value = picture.opaque[::-1] | (description.mode == "trinary")
    cells = np.full(occupancy.shape, UNKNOWN, dtype=np.int8)
    cells[has_value & (occupancy < description.free_thresh)] = FREE
    cells[has_value & (occupancy > description.occupied_thresh)] = OCCUPIED
    x, y, yaw = description.origin
    return OccupancyGrid(
        cells, description.resolution * _CM_PER_M, (x * _CM_PER_M, y * _CM_PER_M, yaw)
    )


def _yaml(path: str | os.PathLike[str]) -> object:
    return yaml.safe_load(read_file(path, CONFIG_BYTES).decode())


class _Picture(NamedTuple):
    """A map's picture, (rows, columns) from its top."""

    brightness: NDArray[np.float64]  # 0 black to 1 white, the mean of a pixel's colours
    opaque: NDArray[np.bool_]


# Width, height and the value of white, then one white-space character (netpbm's pgm format); lines
# may end as on Windows. Comments run to the end of a line.
_SPACE = rb"(?:\s|#[^\r\n]*[\r\n])+"
_PGM = re.compile(rb"P5" + 3 * (_SPACE + rb"(\d{1,9})") + rb"(?:\r\n|\s)")


def _picture(data: bytes) -> _Picture | None:
    """Decode a picture; None if it is none. A PGM needs no OpenCV."""
    header = _PGM.match(data)
    if header is not None:
        columns, rows, white = map(int, header.groups())
        if not (0 < white < 65536 and rows and columns):
            return None
        kind = np.dtype(np.uint8 if white < 256 else ">u2")
        size = rows * columns * kind.itemsize
        values = data[header.end() :]
        if len(values) == size - 1 and data[header.end() - 2 : header.end()] == b"\r\n":
            values = data[header.end() - 1 :]  # that line end was the separator and a pixel
        if len(values) < size:
            return None
        levels = np.frombuffer(values[:size], kind).reshape(rows, columns).astype(np.float64)
        brightness = np.minimum(levels / white, 1.0)
        return _Picture(brightness, np.ones((rows, columns), dtype=np.bool_))
    if not data:
        return None
    require("camera", "a map's picture that is no PGM")
    import cv2

    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if decoded is None:
        return None
    white = 255 if decoded.dtype == np.uint8 else 65535
    levels = np.atleast_3d(np.asarray(decoded, dtype=np.float64)) / white
    if levels.shape[-1] in (2, 4):  # the last is opacity
        return _Picture(levels[..., :-1].mean(axis=-1), levels[..., -1] >= 1.0)
    return _Picture(levels.mean(axis=-1), np.ones(levels.shape[:-1], dtype=np.bool_))
