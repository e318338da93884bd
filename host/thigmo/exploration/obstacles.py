"""From what a run found to the map that a planner reads: obstacles, free space, a grid.

Built from contacts.json alone, so that a live run, one cut short and a replay all export the same
way. Free is where the tube has been but for one chance in a thousand, as far as its shapes' errors
tell; occupied is what lies within a standard deviation of a localized contact, or between the
points of a wall that is one to 95 %; it wins over free. The rest is unknown, and so is what lies
near a contact, up to the same chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

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
_SURE = 0.95  # probability from which a cell is occupied
GONE = "prior, not felt"  # source of an expected obstacle whose place was swept
_BITS = 4  # fractions of a cell in OpenCV's drawing

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
    """The grid of what a run knows, and its obstacles.

    Free cells keep `sigmas` standard errors from what is not.
    """
    felt = [_obstacle(contact) for contact in document.contacts]
    met = {contact.known for contact in document.contacts}
    grid = _empty_grid(document, radius_cm, [*felt, *prior])
    free = _free(grid, document, radius_cm, sigmas)
    rest = [
        replace(obstacle, source=GONE if _swept_through(obstacle, grid, free) else "prior")
        for index, obstacle in enumerate(prior)
        if index not in met
    ]
    grid.cells[free] = FREE
    there = [*felt, *(obstacle for obstacle in rest if obstacle.source != GONE)]
    for obstacle in there:
        for line in (obstacle.track, obstacle.surface):
            grid.cells[_near_line(grid, obstacle, line, max(sigmas, _SIGMA_95))] = UNKNOWN
    for obstacle in there:
        for line in _occupied_lines(obstacle):
            grid.cells[_near_line(grid, obstacle, line, 1.0)] = OCCUPIED
    return grid, felt + rest


def _occupied_lines(obstacle: Obstacle) -> list[list[Point]]:
    """Lines along which something stands for sure: to 95 %, and within a standard deviation."""
    lines = []
    if obstacle.status == "localized" and obstacle.probability >= _SURE:
        lines.append(_core(obstacle) if obstacle.normal_rad is not None else obstacle.track)
    if obstacle.probability * obstacle.wall_probability >= _SURE:
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
    # What stopped the growth bent nothing.
    side = {1.0: "right", -1.0: "left"}.get(np.sign(contact.force_per_cm2), "tip")
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
        wall_probability=contact.wall_probability,
        surface=contact.surface,
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
        reach = obstacle.ellipse_95.semi_major_cm
        point = np.array([[obstacle.x_cm, obstacle.y_cm]])
        points += [np.asarray(obstacle.track), point - reach, point + reach]
        points += [np.asarray(obstacle.surface)] if obstacle.surface else []
    every = np.vstack(points)
    margin = radius_cm + _MARGIN_CM
    low = np.floor((every.min(axis=0) - margin) / _RESOLUTION_CM) * _RESOLUTION_CM
    columns, rows = np.ceil((every.max(axis=0) + margin - low) / _RESOLUTION_CM).astype(int)
    cells = np.full((rows, columns), UNKNOWN, dtype=np.int8)
    return OccupancyGrid(cells, _RESOLUTION_CM, (float(low[0]), float(low[1]), 0.0))


def _pixels(grid: OccupancyGrid, points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Points as OpenCV draws them: cell centres at whole numbers, with fractions."""
    cells = (points - np.array(grid.origin[:2])) / grid.resolution_cm - 0.5
    scaled: NDArray[np.int32] = np.round(cells * (1 << _BITS)).astype(np.int32)
    return scaled


def _free(grid: OccupancyGrid, document: RunDocument, radius_cm: float, sigmas: float) -> Mask:
    """Cells that lie whole within the tube at some time of a sweep."""
    canvas = np.zeros(grid.cells.shape, dtype=np.uint8)
    inner = radius_cm - grid.resolution_cm * np.sqrt(0.5)
    for stage in document.stages:
        for side in ("left", "right"):
            mine = (s for s in stage.shapes if s.side == side and s.curvature_se is not None)
            for polygon in _pixels(grid, outline(passed(mine, sigmas), inner)):
                cv2.fillPoly(canvas, [polygon], 1, lineType=cv2.LINE_8, shift=_BITS)
    return canvas.astype(np.bool_)


def _near_line(
    grid: OccupancyGrid, obstacle: Obstacle, points: Sequence[Point], sigmas: float
) -> Mask:
    """Cells that may hold the obstacle's surface along a line of it, and so far across it."""
    if not points:
        return np.zeros(grid.cells.shape, dtype=np.bool_)
    away = np.ones(grid.cells.shape, dtype=np.uint8)
    # OpenCV draws no line of one point.
    line = _pixels(grid, np.asarray([*points, points[-1]]))
    cv2.polylines(away, [line], False, 0, lineType=cv2.LINE_8, shift=_BITS)
    distance = cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    across_cm = 0.0  # standard error
    if obstacle.normal_rad is not None:
        normal = np.array([np.cos(obstacle.normal_rad), np.sin(obstacle.normal_rad)])
        across_cm = float(np.sqrt(normal @ np.asarray(obstacle.covariance_cm2) @ normal))
    near = distance * grid.resolution_cm <= sigmas * across_cm + grid.resolution_cm / 2
    return np.asarray(near)


def _swept_through(obstacle: Obstacle, grid: OccupancyGrid, free: Mask) -> bool:
    """Whether an obstacle's place, and all within its standard deviation, was swept freely."""
    distance = cv2.distanceTransform(free.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    sigma = float(np.sqrt(np.linalg.eigvalsh(np.asarray(obstacle.covariance_cm2))[-1]))
    column = int((obstacle.x_cm - grid.origin[0]) // grid.resolution_cm)
    row = int((obstacle.y_cm - grid.origin[1]) // grid.resolution_cm)
    return bool(distance[row, column] * grid.resolution_cm > max(sigma, grid.resolution_cm))


def _areas(grid: OccupancyGrid, free: Mask) -> list[FreeArea]:
    """Outlines of the free cells, through their centres."""
    cells = free.astype(np.uint8)
    contours, tree = cv2.findContours(cells, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if tree is None:
        return []
    low, parents = np.array(grid.origin[:2]), tree[0, :, 3]
    drawn = [
        [
            (round(float(x), 3), round(float(y), 3))
            for x, y in low + (contour[:, 0, :] + 0.5) * grid.resolution_cm
        ]
        for contour in contours
    ]
    return [
        FreeArea(drawn[outer], [drawn[hole] for hole in np.flatnonzero(parents == outer)])
        for outer in np.flatnonzero(parents < 0)
        if len(drawn[outer]) > 2
    ]
