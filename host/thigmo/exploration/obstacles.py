"""From what a run found to the map that a planner reads: obstacles, free space, a grid.

Built from contacts.json alone, so that a live run, one cut short and a replay all export the same
way. A cell is free if the tube has swept it, at a probability of 99.9 % by the errors of the tube's
shapes. A cell is occupied within one standard deviation of a localized contact, and between the
points of a wall that is at least 95 % probable; occupied wins over free. All other cells are
unknown, also those that hold a contact with a probability of more than 0.1 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from contourpy import FillType, contour_generator
from numpy.typing import NDArray

from thigmo.config import SIDES
from thigmo.contact_status import SURE
from thigmo.record import (
    OBSTACLES_FILE,
    Ellipse,
    FreeArea,
    MapContact,
    Obstacle,
    ObstacleMap,
    OccupancyGrid,
    RunDocument,
    RunFolder,
    outline,
    passed,
    write_obstacles,
    write_ros_map,
)
from thigmo.record.obstacles import Point
from thigmo.record.occupancy import FREE, OCCUPIED, UNKNOWN

_RESOLUTION_CM = 0.5
_MARGIN_CM = 3.0
_SIGMA_95 = 2.4477
# Standard errors of a swept shape beyond which a cell is free: one in a thousand is not. Over 200
# random rooms so few cells inside pegs that were felt are free (`thigmo bench exploration`).
SIGMAS = 3.1
GONE = "prior, not felt"  # source of an expected obstacle that a sweep did not feel

Mask = NDArray[np.bool_]


def export_obstacles(
    folder: RunFolder,
    document: RunDocument,
    *,
    radius_cm: float,
    prior: Sequence[Obstacle] = (),
    prefix: str = "",
) -> ObstacleMap:
    """Write obstacles.json, map.pgm and map.yaml of what a run knows, with the map it was given.

    `prefix` begins the files' names (a replay's differ). Raises RunFolderError if they cannot be
    written.
    """
    grid, obstacles = occupancy(document, radius_cm, prior)
    known = ObstacleMap(
        name=document.name,
        started=document.started,
        outcome=document.outcome,
        tube_radius_cm=radius_cm,
        obstacles=obstacles,
        free=_areas(grid, grid.cells == FREE),
        grid=f"{prefix}map.yaml",
    )
    write_ros_map(grid, folder.path / known.grid)
    write_obstacles(known, folder.path / f"{prefix}{OBSTACLES_FILE}")
    return known


def occupancy(
    document: RunDocument, radius_cm: float, prior: Sequence[Obstacle] = (), sigmas: float = SIGMAS
) -> tuple[OccupancyGrid, list[Obstacle]]:
    """The map of a run as a grid of cells, and its obstacles.

    Args:
        radius_cm: of the tube.
        prior: obstacles of the map that the run was given.
        sigmas: standard errors by which swept space is narrowed and contacts are widened before a
            cell counts as free.
    """
    detected = [_obstacle(contact) for contact in document.contacts]
    known = {contact.known for contact in document.contacts}
    grid = _empty_grid(document, radius_cm, [*detected, *prior])
    free = _free(grid, document, radius_cm, sigmas)
    rest = [
        replace(obstacle, source=GONE if _swept_through(obstacle, grid, free) else "prior")
        for index, obstacle in enumerate(prior)
        if index not in known
    ]
    grid.cells[free] = FREE
    standing = [*detected, *(obstacle for obstacle in rest if obstacle.source != GONE)]
    for obstacle in standing:
        for line in [] if obstacle.cell_cm else [obstacle.track, obstacle.surface]:
            grid.cells[_near_line(grid, obstacle, line, max(sigmas, _SIGMA_95))] = UNKNOWN
    for obstacle in standing:
        for line in [] if obstacle.gave_way else _occupied_lines(obstacle):
            grid.cells[_near_line(grid, obstacle, line, 1.0)] = OCCUPIED
    cells = [obstacle.cell_corners() for obstacle in standing if obstacle.cell_cm]
    grid.cells[_within(grid, cells)] = OCCUPIED
    return grid, detected + rest


def _occupied_lines(obstacle: Obstacle) -> list[list[Point]]:
    """Lines along which something stands for sure: to 95 %, and within a standard deviation."""
    lines: list[list[Point]] = []
    if obstacle.cell_cm:
        return lines
    if obstacle.status == "localized" and obstacle.probability >= SURE:
        lines.append(_core(obstacle) if obstacle.normal_rad is not None else obstacle.track)
        lines.append(obstacle.surface)
    return lines


def _core(obstacle: Obstacle) -> list[Point]:
    """The points of a contact's track that are within a standard deviation of its place."""
    away = np.asarray(obstacle.track) - (obstacle.x_cm, obstacle.y_cm)
    inverse = np.linalg.inv(np.asarray(obstacle.covariance_cm2))
    near = np.einsum("pi,ij,pj->p", away, inverse, away) <= 1.0
    core = [point for point, inside in zip(obstacle.track, near, strict=True) if inside]
    return core or [(obstacle.x_cm, obstacle.y_cm)]


def _obstacle(contact: MapContact) -> Obstacle:
    # What stopped the growth bent nothing, nor does what a sweep slipped past at each peak.
    side = {1.0: "right", -1.0: "left"}.get(np.sign(contact.force_per_cm2), contact.side or "tip")
    return Obstacle(
        x_cm=contact.x_cm,
        y_cm=contact.y_cm,
        covariance_cm2=contact.covariance_cm2,
        ellipse_95=Ellipse.of(contact.covariance_cm2),
        track=contact.track or [(contact.x_cm, contact.y_cm)],
        source="felt" if contact.known is None else "felt, prior",
        status=contact.status,
        normal_rad=contact.normal_rad,
        body_side=side,
        arc_cm=contact.arc_cm,
        interval_cm=contact.interval_cm,
        felt_at_cm=[*contact.merged, contact.everted_length_cm],
        force_per_cm2=contact.force_per_cm2,
        force_n=contact.force_n,
        force_interval_n=contact.force_interval_n,
        kind=contact.kind,
        probability=contact.probability,
        surface=contact.surface,
        gave_way=contact.gave_way_per_cm is not None,
    )


def _empty_grid(
    document: RunDocument, radius_cm: float, obstacles: Sequence[Obstacle]
) -> OccupancyGrid:
    """A grid of unknown cells around all that is known."""
    points = [np.array([[0.0, radius_cm], [0.0, -radius_cm]])]
    for stage in document.stages:
        points.append(np.array([[stage.everted_length_cm, 0.0]]))
        points += [np.asarray(shape.poses)[:, :2] for shape in stage.shapes]
    for obstacle in obstacles:
        reach = obstacle.cell_cm or obstacle.ellipse_95.semi_major_cm
        track, point = np.asarray(obstacle.track), np.array([[obstacle.x_cm, obstacle.y_cm]])
        around = track if obstacle.cell_cm else point
        points += [track, around - reach, around + reach]
        points += [np.asarray(obstacle.surface)] if obstacle.surface else []
    points_cm = np.vstack(points)
    margin = radius_cm + _MARGIN_CM
    low = np.floor((points_cm.min(axis=0) - margin) / _RESOLUTION_CM) * _RESOLUTION_CM
    columns, rows = np.ceil((points_cm.max(axis=0) + margin - low) / _RESOLUTION_CM).astype(int)
    cells = np.full((rows, columns), UNKNOWN, dtype=np.int8)
    return OccupancyGrid(cells, _RESOLUTION_CM, (float(low[0]), float(low[1]), 0.0))


def _free(grid: OccupancyGrid, document: RunDocument, radius_cm: float, sigmas: float) -> Mask:
    """Cells that lie whole within the tube at some time of a sweep."""
    inner = radius_cm - grid.resolution_cm * np.sqrt(0.5)
    shapes = [
        outline(passed(measured, sigmas), inner)
        for stage in document.stages
        for side in SIDES
        if (measured := [s for s in stage.shapes if s.side == side and s.curvature_se is not None])
    ]
    return _within(grid, shapes)


def _within(grid: OccupancyGrid, polygons: Sequence[NDArray[np.float64]]) -> Mask:
    """Cells whose centres lie within any of the polygons, (p, n, 2) each, that all turn one way."""
    rows, columns = grid.cells.shape
    turns = np.zeros((rows, columns + 1))  # of the polygons around the cells from there on
    for corners in polygons:
        # In cells, their centres at whole numbers. A row of them is crossed by many edges.
        start = (corners - np.array(grid.origin[:2])) / grid.resolution_cm - 0.5
        (x0, y0), (x1, y1) = (ends.reshape(-1, 2).T for ends in (start, np.roll(start, -1, axis=1)))
        first, end = np.ceil(np.minimum(y0, y1)), np.ceil(np.maximum(y0, y1))
        count = (end - first).astype(np.intp)
        edge = np.repeat(np.arange(count.size), count)
        row = first[edge] + np.arange(edge.size) - np.repeat(np.cumsum(count) - count, count)
        x = x0[edge] + (row - y0[edge]) * (x1 - x0)[edge] / (y1 - y0)[edge]
        in_grid = (row >= 0) & (row < rows)
        column = np.clip(np.ceil(x), 0, columns)[in_grid].astype(np.intp)
        np.add.at(turns, (row[in_grid].astype(np.intp), column), np.sign(y1 - y0)[edge][in_grid])
    inside: Mask = np.cumsum(turns, axis=1)[:, :columns] != 0
    return inside


def _near_line(
    grid: OccupancyGrid, obstacle: Obstacle, points: Sequence[Point], sigmas: float
) -> Mask:
    """Cells within `sigmas` standard errors across a line of an obstacle's surface."""
    near = np.zeros(grid.cells.shape, dtype=np.bool_)
    across_cm = 0.0  # standard error
    if obstacle.normal_rad is not None:
        normal = np.array([np.cos(obstacle.normal_rad), np.sin(obstacle.normal_rad)])
        across_cm = float(np.sqrt(normal @ np.asarray(obstacle.covariance_cm2) @ normal))
    reach = sigmas * across_cm + grid.resolution_cm * np.sqrt(0.5)
    centers = np.stack(grid.centers(), axis=-1)
    corner, last = np.array(grid.origin[:2]), np.array(grid.cells.shape[::-1])
    for start, end in pairwise(np.asarray([*points, *points[-1:]])):
        # The cells around a piece of the line: a map of a building has a million others.
        ends = np.array([np.minimum(start, end) - reach, np.maximum(start, end) + reach])
        cells = np.clip((ends - corner) // grid.resolution_cm + [[0], [1]], 0, last).astype(int)
        window = slice(*cells[:, 1]), slice(*cells[:, 0])
        along = end - start
        share = (centers[window] - start) @ along / max(along @ along, np.finfo(float).tiny)
        nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
        near[window] |= ((centers[window] - nearest) ** 2).sum(axis=-1) <= reach**2
    return near


def _swept_through(obstacle: Obstacle, grid: OccupancyGrid, free: Mask) -> bool:
    """Whether an obstacle's place, and all within its standard deviation, was swept freely.

    Of a ROS map's obstacle: whether the centres of most of its cells were.
    """
    if obstacle.cell_cm:
        corner = np.array(grid.origin[:2])
        column, row = ((np.asarray(obstacle.track) - corner) // grid.resolution_cm).astype(int).T
        return float(free[row, column].mean()) > 0.5
    from scipy.ndimage import distance_transform_edt

    distance = distance_transform_edt(free)
    sigma = float(np.sqrt(np.linalg.eigvalsh(np.asarray(obstacle.covariance_cm2))[-1]))
    column = int((obstacle.x_cm - grid.origin[0]) // grid.resolution_cm)
    row = int((obstacle.y_cm - grid.origin[1]) // grid.resolution_cm)
    return bool(distance[row, column] * grid.resolution_cm > max(sigma, grid.resolution_cm))


def _areas(grid: OccupancyGrid, free: Mask) -> list[FreeArea]:
    """Outlines of the free cells, midway between their centres and those of other cells."""
    x, y = (np.pad(axis, 1, mode="reflect", reflect_type="odd") for axis in grid.centers())
    drawn = contour_generator(x, y, np.pad(free, 1), fill_type=FillType.OuterOffset)
    areas = []
    for points, offsets in zip(*drawn.filled(0.5, 1.5), strict=True):
        outer, *holes = (_corners(points[a:b]) for a, b in pairwise(offsets))
        areas.append(FreeArea(outer, holes))
    return areas


def _corners(loop: NDArray[np.float64]) -> list[Point]:
    """The points of a closed line, its first and last the same, at which it turns."""
    step = np.diff(loop, axis=0)
    previous = np.roll(step, 1, axis=0)
    turns = ~np.isclose(step[:, 0] * previous[:, 1], step[:, 1] * previous[:, 0])
    return [(round(x, 3), round(y, 3)) for x, y in loop[:-1][turns].tolist()]
