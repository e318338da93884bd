"""obstacles.json: the room as a run leaves it to a planner, or to the next exploration.

Obstacles are contacts, merged over the run's stages and with those of a map that was given before;
free is what the robot swept without being held back. `map.pgm` and `map.yaml` beside it hold the
same as a grid. Lengths in cm, angles in rad, forces over EI in 1/cm^2.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from thigmo.record.document import Number
from thigmo.record.folder import read_json, write_whole

OBSTACLES_FILE = "obstacles.json"
PRIOR_FILE = "prior.json"  # the map that an exploration was given, in its run folder
_FRAME = "origin at the robot's base, x along the straight robot, y to its left"
_SIGMA_95 = 2.4477  # radius of the 95 % ellipse of a normal law in the plane
_ELLIPSE_POINTS = 49

Point = tuple[float, float]
Covariance = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Ellipse:
    """95 % ellipse in the plane: half axes, and the angle of the long one from x."""

    semi_major_cm: float
    semi_minor_cm: float
    angle_rad: float

    @classmethod
    def of(cls, covariance_cm2: Covariance) -> Ellipse:
        """The ellipse of a normal law's covariance."""
        values, vectors = np.linalg.eigh(np.asarray(covariance_cm2))
        minor, major = _SIGMA_95 * np.sqrt(np.maximum(values, 0.0))
        return cls(float(major), float(minor), float(np.arctan2(vectors[1, 1], vectors[0, 1])))

    def outline(self, x_cm: float, y_cm: float) -> list[Point]:
        """The points of its edge around a place, counter-clockwise, the first again at the end."""
        turn = np.linspace(0.0, 2 * np.pi, _ELLIPSE_POINTS)
        along, across = self.semi_major_cm * np.cos(turn), self.semi_minor_cm * np.sin(turn)
        cosine, sine = np.cos(self.angle_rad), np.sin(self.angle_rad)
        x, y = x_cm + cosine * along - sine * across, y_cm + sine * along + cosine * across
        return list(zip(x.tolist(), y.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Something that the robot touched, or that an earlier map shows."""

    # x_cm, y_cm: the point of its surface that the robot touched
    x_cm: float
    y_cm: float
    covariance_cm2: Covariance  # of that point
    ellipse_95: Ellipse  # the same, drawn out
    # the 95 % interval along the skin, in the room; of a ROS map's obstacle, its cells' centres
    track: list[Point]
    # "felt" in this run; "prior", shown by the map given and not reached; "felt, prior"; "prior,
    # not felt", where the robot swept through its place
    source: str
    status: str  # "localized", "ambiguous" or "point estimate", as in contacts.json
    # direction from the body into the obstacle; None for a ROS map's obstacle
    normal_rad: float | None = None
    # part of the robot that it touched: a side or "tip"; empty for a grid's
    body_side: str = ""
    # arc_cm, interval_cm: along the body when it was last measured
    arc_cm: float | None = None
    interval_cm: tuple[float, float] | None = None
    # everted lengths at which it was felt, the last measured one last
    felt_at_cm: list[float] = field(default_factory=list)
    force_per_cm2: float | None = None  # F/EI at the last measurement
    force_n: float | None = None  # the same in newtons; null if EI is not known
    force_interval_n: list[float] = field(default_factory=list)  # its 95 % interval
    kind: str = "peg"  # or "wall"
    probability: Number = 1.0  # that it is real; null of a point estimate
    # of a wall: the ends of the part of its face that was touched
    surface: list[Point] = field(default_factory=list)
    gave_way: bool = False  # under the body's force, for good
    # of a ROS map's obstacle: side of its square cells, and their turn from x; 0 for a contact
    cell_cm: float = 0.0
    cell_angle_rad: float = 0.0

    def cell_corners(self) -> NDArray[np.float64]:
        """(n, 4, 2) corners of a ROS map's obstacle's cells, counter-clockwise, cm."""
        angles = self.cell_angle_rad + np.radians([45, 135, 225, 315])
        corners = np.sqrt(0.5) * np.column_stack((np.cos(angles), np.sin(angles)))
        centers = np.array(self.track, dtype=np.float64)
        cells: NDArray[np.float64] = centers[:, None, :] + self.cell_cm * corners
        return cells


@dataclass(frozen=True, slots=True)
class FreeArea:
    """One connected part of the space that was swept freely: its outline, and islands in it."""

    outline: list[Point]
    holes: list[list[Point]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class ObstacleMap:
    """Contents of obstacles.json: obstacles and free space, with its run's name and outcome."""

    name: str
    started: str
    outcome: str
    tube_radius_cm: float  # of the robot that swept
    obstacles: list[Obstacle] = field(default_factory=list)  # merged
    free: list[FreeArea] = field(default_factory=list)  # swept without contact
    grid: str = ""  # file that holds the same as a ROS map, beside this one; empty without
    frame: str = _FRAME
    units: dict[str, str] = field(
        default_factory=lambda: {
            "length": "cm",
            "angle": "rad",
            "force": "N",
            "force over EI": "1/cm^2",
        }
    )
    version: int = 1

    def __repr__(self) -> str:
        return (
            f"ObstacleMap({self.name}: {self.outcome}; {len(self.obstacles)} obstacles, "
            f"{len(self.free)} free areas)"
        )


_MAP = TypeAdapter(ObstacleMap)


def write_obstacles(obstacle_map: ObstacleMap, path: Path) -> None:
    """Write obstacles.json whole or not at all. Raises RunFolderError if it cannot be written."""
    write_whole(path, _MAP.dump_json(obstacle_map, indent=1) + b"\n")


def read_obstacles(path: str | os.PathLike[str]) -> ObstacleMap:
    """Read an obstacles.json. Raises RunFolderError if it is missing or malformed."""
    return read_json(
        _MAP,
        path,
        missing="give a run folder that holds obstacles.json, or a ROS map's YAML file",
        invalid="run `thigmo replay` on its folder, or give another map",
    )
