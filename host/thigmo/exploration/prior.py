"""A map of the room that an exploration is given: an earlier run's, or a ROS map.

What it shows makes a contact there likelier, and nothing more: the posterior over the arc is the
likelihood times a prior in which the contact is as likely one of the known obstacles as a new one
anywhere. A wrong map can move an estimate within its interval, but it cannot make a contact or
hide one. Coordinates are those of obstacles.json: the robot's base at the origin, x along it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from thigmo.config import Body
from thigmo.contact_status import POINT_ESTIMATE, SURE
from thigmo.errors import RunFolderError
from thigmo.record import (
    OBSTACLES_FILE,
    PRIOR_FILE,
    Ellipse,
    MapContact,
    Obstacle,
    OccupancyGrid,
    RunFolder,
    read_obstacles,
    read_ros_map,
)
from thigmo.record.occupancy import OCCUPIED
from thigmo.robot.curvature import Floats

# No place is known better than this (one sigma): the peg is touched on another part of its rim, and
# the two runs' shapes err.
_FLOOR_CM = 1.5
_SAME_SIGMA = 3.0
_FAR_SIGMA = 9.0  # exp(-0.5 * 9**2) is below the resolution of a double at 1


class KnownPlaces:
    """Where the obstacles of a map are, with their errors, prepared once for every fit of a run."""

    def __init__(self, prior: Sequence[Obstacle]) -> None:
        from scipy.spatial import KDTree

        self._whiteners = []  # of points, (2, 2) each: to distances in standard deviations
        self._trees = []  # of each obstacle's whitened places
        for obstacle in prior:
            places, covariance = _places(obstacle)
            whitener = _whitener(covariance)
            self._whiteners.append(whitener)
            self._trees.append(KDTree(places @ whitener))

    def boost(self, points: Floats, length_cm: float) -> Floats:
        """Prior density of a contact at points of the skin, (n, 2) in cm, relative to no map.

        Without a map a contact is equally likely anywhere on a body of `length_cm`. The known
        obstacles together are as likely as a new one, so the mean over the arc is about 1: a map
        makes no contact likelier as a whole.
        """
        value = np.ones(len(points))
        if not self._trees:
            return value
        peak = length_cm / (_FLOOR_CM * np.sqrt(2 * np.pi)) / len(self._trees)
        for tree, whitener in zip(self._trees, self._whiteners, strict=True):
            # An obstacle beyond so many standard deviations adds nothing to a double of 1.
            distance, _ = tree.query(points @ whitener, distance_upper_bound=_FAR_SIGMA)
            value += peak * np.exp(-0.5 * np.asarray(distance) ** 2)
        return 0.5 * value


def match(prior: Sequence[Obstacle], contact: MapContact) -> int | None:
    """Index of the expected obstacle that a contact is, or None for a new one."""
    if contact.status == POINT_ESTIMATE:
        return None
    point = np.array([contact.x_cm, contact.y_cm])
    error = np.asarray(contact.covariance_cm2)
    apart = []
    for obstacle in prior:
        places, covariance = _places(obstacle)
        away = (places - point) @ _whitener(covariance + error)
        apart.append(float((away**2).sum(axis=1).min()))
    return int(np.argmin(apart)) if apart and min(apart) <= _SAME_SIGMA**2 else None


def _places(obstacle: Obstacle) -> tuple[Floats, Floats]:
    """The places (n, 2) where an obstacle may be touched, cm, and their covariance, cm^2."""
    covariance = _FLOOR_CM**2 * np.eye(2)
    if obstacle.normal_rad is None:
        return np.asarray(obstacle.track), covariance
    # A contact: a point with its covariance.
    point = np.array([[obstacle.x_cm, obstacle.y_cm]])
    return point, covariance + np.asarray(obstacle.covariance_cm2)


def _whitener(covariance: Floats) -> Floats:
    """(2, 2) by which points are multiplied, for distances in standard deviations."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)).T)


def read_prior(path: str | os.PathLike[str]) -> list[Obstacle]:
    """Obstacles of a map: a run folder, its obstacles.json, or a ROS map's YAML file.

    Those that the map had itself found gone or seen give way are omitted, and places of unknown
    error. Raises RunFolderError: it is neither, or cannot be read.
    """
    file = Path(path)
    if file.is_dir():
        file = file / OBSTACLES_FILE
    if file.suffix == ".json":
        return [
            o
            for o in read_obstacles(file).obstacles
            if o.source != "prior, not felt" and o.status != POINT_ESTIMATE and not o.gave_way
        ]
    if file.suffix in (".yaml", ".yml"):
        return _grid_obstacles(read_ros_map(file))
    raise RunFolderError(
        f"{path} is no map", "give a run folder, its obstacles.json, or a ROS map's YAML file"
    )


def within_reach(prior: Sequence[Obstacle], body: Body) -> list[Obstacle]:
    """The obstacles of a map that a robot can touch, without the cells that it cannot.

    A map of a building shows rooms that the robot never reaches.
    """
    reach_cm = body.length_cm + body.radius_cm + _SAME_SIGMA * _FLOOR_CM
    near = []
    for obstacle in prior:
        places = np.asarray(obstacle.track)
        reached = np.hypot(*places.T) <= reach_cm
        if obstacle.cell_cm and not reached.all():
            if reached.any():
                near.append(_patch(places[reached], obstacle.cell_cm, obstacle.cell_angle_rad))
        elif reached.any():
            near.append(obstacle)
    return near


def obstacle_ahead(prior: Sequence[Obstacle], radius_cm: float) -> tuple[float, float] | None:
    """The nearest obstacle in the straight path of the tip of which a map is sure to 95 %.

    Returns its x (cm), and the length (cm) up to which the body stays clear of it: two standard
    deviations of its place shorter. None if there is none.
    """
    nearest: tuple[float, float] | None = None
    for obstacle in prior:
        if not obstacle.probability >= SURE:  # NaN of a point estimate is not
            continue
        places = np.asarray(obstacle.track)
        std_cm = _FLOOR_CM
        if obstacle.normal_rad is not None:
            places = np.array([[obstacle.x_cm, obstacle.y_cm]])
            std_cm = float(np.hypot(_FLOOR_CM, np.sqrt(obstacle.covariance_cm2[0][0])))
        in_path = places[(places[:, 0] > 0) & (np.abs(places[:, 1]) < radius_cm)]
        if in_path.size:
            x_cm = float(in_path[:, 0].min()) - obstacle.cell_cm / 2
            clear_cm = x_cm - 2 * std_cm
            if nearest is None or clear_cm < nearest[1]:
                nearest = x_cm, clear_cm
    return nearest


def kept_prior(folder: RunFolder) -> list[Obstacle]:
    """Obstacles of the map that a run was given, none without; raises RunFolderError."""
    file = folder.path / PRIOR_FILE
    return read_obstacles(file).obstacles if file.exists() else []


def _grid_obstacles(grid: OccupancyGrid) -> list[Obstacle]:
    """One obstacle for each connected patch of occupied cells."""
    from scipy.ndimage import label

    labels, _ = label(grid.cells == OCCUPIED, np.ones((3, 3)))
    occupied = np.nonzero(labels)
    patches = labels[occupied]
    order = np.argsort(patches, kind="stable")
    x, y = grid.centers()
    centers = np.column_stack((x[occupied], y[occupied]))[order]
    borders = np.flatnonzero(np.diff(patches[order])) + 1
    return [
        _patch(cells, grid.resolution_cm, grid.origin[2])
        for cells in np.split(centers, borders)
        if cells.size
    ]


def _patch(centers: Floats, cell_cm: float, cell_angle_rad: float) -> Obstacle:
    """The obstacle that fills square cells with these centres, (n, 2) in cm."""
    spread = np.cov(centers.T, ddof=0) + cell_cm**2 / 12 * np.eye(2)
    (xx, xy), (yx, yy) = spread.tolist()
    covariance = ((xx, xy), (yx, yy))
    x_cm, y_cm = centers.mean(axis=0).tolist()
    return Obstacle(
        x_cm=x_cm,
        y_cm=y_cm,
        covariance_cm2=covariance,
        ellipse_95=Ellipse.of(covariance),
        track=[(x, y) for x, y in centers.tolist()],
        source="prior",
        status="localized",
        cell_cm=cell_cm,
        cell_angle_rad=cell_angle_rad,
    )
