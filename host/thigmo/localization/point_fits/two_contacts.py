"""Global fit of two contacts by branch and bound, in the 1- or the 2-norm.

A box holds each contact between two arcs, with the sign of its force. A sensor whose span the box
of a contact enters or leaves is left out. For every other one the response is a line or a quadratic
of the arc within the box, so the vector of responses runs within the hull of three Bezier points,
and a contact contributes a combination of them with weights of one sign that add up to its force:
the least misfit over such weights (`signed_fit`) is a lower bound. It is exact where no span holds
a contact; elsewhere its error falls with the square of the box. Boxes are split at ends of spans
first, then where the hull is loosest, at the arc that the weights stand for.

A box is a row of seven numbers: near and far end for the proximal contact, near and far end for the
distal one, the signs of both forces, the lower bound.
"""

from __future__ import annotations

import numpy as np

from thigmo.compiled import compiled
from thigmo.localization.point_fits.response import Floats, integer, response
from thigmo.localization.point_fits.signed_fit import COLUMNS, EACH, fit_l1, fit_l2

Limits = tuple[float, float, float]
Room = tuple[Floats, Floats, Floats, Floats]

SIGNS, BOUND, BOX = 4, 6, 7
THINNEST = 1e-12  # boxes no wider are not split


@compiled
def hull_columns(
    box: Floats, y: Floats, low: Floats, high: Floats, g: Floats, data: Floats, cut: Floats
) -> tuple[int, int]:
    """Responses `g` (6, N) at the Bezier points of both contacts of a box.

    Returns how many readings take part, which `data` (N,) begins with, and how many no contact
    reaches, which it ends with. Writes into `cut` the end of a span that lies deepest inside a
    place, the place (0 or 2), and how deep; 0 if none does.
    """
    n = y.shape[0]
    used, idle = integer(0), 0
    cut[2] = 0.0
    for i in range(n):
        mixed = False
        for place in (0, 2):
            for end in (low[i], high[i]):
                depth = min(end - box[place], box[place + 1] - end)
                mixed = mixed or depth > 0.0
                if depth > cut[2]:
                    cut[0], cut[1], cut[2] = end, place, depth
        if mixed:
            continue
        if box[1] <= low[i] and box[3] <= low[i]:
            idle += 1
            data[n - idle] = y[i]
            continue
        for c in range(2):
            near, far = box[2 * c], box[2 * c + 1]
            first = box[SIGNS + c] * response(near, low[i], high[i])
            last = box[SIGNS + c] * response(far, low[i], high[i])
            middle = 0.5 * (first + last)
            if low[i] <= near and far <= high[i] and low[i] < high[i]:
                middle = box[SIGNS + c] * 0.5 * (near - low[i]) * (far - low[i])
                middle /= high[i] - low[i]
            r = EACH * c
            g[r, used], g[r + 1, used], g[r + 2, used] = first, last, middle
        data[used] = y[i]
        used += 1
    return used, idle


@compiled
def bound_box(
    box: Floats, y: Floats, sensors: Floats, norm: int, limit: float, room: Room
) -> float:
    """Lower bound over a box; exact if it is a point. Weights and cut are left in the room."""
    g, data, beta, cut = room
    used, idle = hull_columns(box, y, sensors[0], sensors[1], g, data, cut)
    bound = fit_l1(g, data, used, limit, beta) if norm == 1 else fit_l2(g, data, used, limit, beta)
    for j in range(y.shape[0] - idle, y.shape[0]):
        bound += abs(data[j]) if norm == 1 else data[j] * data[j]
    return bound


@compiled
def aim(box: Floats, beta: Floats, cut: Floats, point: Floats) -> None:
    """Write the point that the weights of a hull stand for and, if no span ends inside, the cut."""
    loosest = cut[2]
    for c in range(2):
        near = box[2 * c]
        width = box[2 * c + 1] - near
        force = beta[EACH * c] + beta[EACH * c + 1] + beta[EACH * c + 2]
        moment = beta[EACH * c + 1] + 0.5 * beta[EACH * c + 2]
        share = min(moment / force, 1.0) if force > 0.0 else 0.5
        point[2 * c] = point[2 * c + 1] = near + share * width
        point[SIGNS + c] = box[SIGNS + c]
        loose = abs(beta[EACH * c + 1] - force * share * share) * width * width + 1e-30 * width
        if cut[2] == 0.0 and width > THINNEST and loose > loosest:
            cut[0] = near + (share if 0.1 <= share <= 0.9 else 0.5) * width
            loosest, cut[1] = loose, 2 * c
    cut[2] = loosest


@compiled
def split_box(boxes: Floats, k: int, other: int, cut: Floats) -> None:
    """Split box k, the second part written as `other`, and cut both to proximal before distal."""
    place = int(cut[1])
    for j in range(BOX):
        boxes[other, j] = boxes[k, j]
    boxes[k, place + 1] = boxes[other, place] = cut[0]
    for part in (k, other):
        boxes[part, 2] = max(boxes[part, 2], boxes[part, 0])
        boxes[part, 1] = min(boxes[part, 1], boxes[part, 3])


@compiled
def search_boxes(
    y: Floats, sensors: Floats, norm: int, limits: Limits, boxes: Floats, answer: Floats
) -> int:
    """Branch and bound; returns how many boxes were looked at.

    `sensors` (2, N) are both ends of the spans; `limits` the largest |force|, the gain below which
    boxes are given up, and the objective at which the search ends (negative for the minimum). The
    first four of `boxes` (B, BOX) are searched, one for each pair of signs, until none is left or
    all are in use. Writes both arcs, both forces, the objective, its bound into `answer` (6,).
    """
    limit, slack, wanted = limits
    n = y.shape[0]
    beta, cut, point = np.empty(COLUMNS), np.empty(3), np.empty(BOX)
    room = (np.empty((COLUMNS, n)), np.empty(n), beta, cut)
    spare = (room[0], room[1], beta, np.empty(3))
    count = integer(4)
    best = lower = np.inf
    bar = wanted if wanted >= 0.0 else np.inf
    done = 0
    while count > 0 and best > wanted:
        k = integer(0)
        for j in range(count):
            if boxes[j, BOUND] < boxes[k, BOUND]:
                k = j
        box = boxes[k]
        if box[BOUND] > bar or count == boxes.shape[0]:
            lower = min(lower, box[BOUND])
            break
        done += 1
        box[BOUND] = max(box[BOUND], bound_box(box, y, sensors, norm, limit, room))
        if box[BOUND] <= bar:
            aim(box, beta, cut, point)
            bound_box(point, y, sensors, norm, limit, spare)
            value = 0.0
            # Rounding must not take a force past the limit.
            first = point[SIGNS] * min(beta[0] + beta[1] + beta[2], limit)
            second = point[SIGNS + 1] * min(beta[3] + beta[4] + beta[5], limit)
            for i in range(n):
                left = y[i] - first * response(point[0], sensors[0, i], sensors[1, i])
                left -= second * response(point[2], sensors[0, i], sensors[1, i])
                value += abs(left) if norm == 1 else left * left
            if value < best:
                best, bar = value, min(bar, value - slack)
                c = 1 if point[0] <= point[2] else 0
                answer[1 - c], answer[c] = point[0], point[2]
                answer[3 - c], answer[2 + c] = first, second
        if box[BOUND] <= bar and cut[2] > 0.0:
            split_box(boxes, k, count, cut)
            count += 1
            continue
        # Given up: the last box takes its place.
        lower = min(lower, box[BOUND])
        count -= 1
        for j in range(BOX):
            box[j] = boxes[count, j]
    answer[4] = best
    answer[5] = min(lower, best)
    return done
