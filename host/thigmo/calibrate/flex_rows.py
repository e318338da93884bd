"""What each row of the flex step should show, and which rows do not: judged over all sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import working
from thigmo.calibrate.regression import LinearFit, fit_linear
from thigmo.calibrate.verdict import listed
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.mechanics import push
from thigmo.mechanics.spans import phi

Array = NDArray[np.float64]
Deflection = Literal["large", "small"]

TIP_SE_CM = 0.08  # one sigma of a camera place across the robot
_WRONG_SIDE = -0.3


def tip_curvature(
    y_tip: float,
    x_tip: float,
    length_cm: float,
    centers: Array,
    spans: Array,
    deflection: Deflection = "large",
) -> Array:
    """Mean curvature (m,) under each sensor when the tip is pushed to y_tip.

    `large`: the rod is bent by a force normal to it at its tip until the tip stands at y_tip.
    `small`: F/EI = 3 y_tip / x_tip^3 and k = F/EI (x_tip - s) (thesis, (2.12) and (2.9)).

    Raises:
        DataError: a place that the tip cannot reach.
    """
    if deflection == "small":
        force = 3 * y_tip / x_tip**3
        return np.asarray(force * phi(x_tip, centers, spans), float)
    if abs(y_tip) >= 0.75 * length_cm:
        raise DataError(
            f"the tip cannot stand {y_tip:.1f} cm aside at {length_cm:.1f} cm of length",
            "check the camera and the length",
        )
    if y_tip == 0:
        return np.zeros(len(centers))

    def miss(force: float) -> float:
        return push(force, length_cm, free_curvature=0.0, length=length_cm).pose(length_cm)[
            1
        ] - abs(y_tip)

    first = 3 * abs(y_tip) / length_cm**3
    force = float(brentq(miss, 0.0, 4 * first + 1e-9, xtol=1e-12, rtol=1e-6))
    bent = push(force, length_cm, free_curvature=0.0, length=length_cm)
    return np.asarray(np.sign(y_tip) * bent.averages(centers, spans), float)


def model_rows(
    readings: FlexReadings,
    config: RobotConfig,
    centers: Array,
    spans: Array,
    deflection: Deflection,
    tip_se_cm: float,
    notes: list[str],
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Curvature (n, m) that each row should show, its standard error, and which rows have one."""
    n = len(readings.kind)
    model = np.full((n, len(centers)), np.nan)
    error = np.zeros((n, len(centers)))
    length = readings.length_cm
    lost, wrong, folded = [], [], []
    # The straight robot, as the camera sees it, is y = 0.
    straight = np.array([k == "straight" for k in readings.kind])
    aside = readings.tip_cm[straight, 1]
    aside = aside[np.isfinite(aside)]
    ahead = float(np.median(aside)) if len(aside) else 0.0
    if abs(ahead) > 2.0:
        notes.append(
            f"the straight robot's tip stands {ahead:+.1f} cm aside: lay the robot straight, or "
            "measure the cards' places again"
        )
    # The fold at the base: F L = critical moment, y = F L^3 / 3.
    reach = config.body.critical_curvature * length**2 / 3 if deflection == "large" else np.inf
    for row, kind in enumerate(readings.kind):
        x, y = readings.tip_cm[row] - np.array([0.0, ahead])
        if kind == "straight":
            model[row] = 0.0
        elif kind == "bend":
            model[row] = readings.curvature[row]
            error[row] = readings.curvature_se[row]
            if not np.isfinite(readings.curvature[row]):
                lost.append(row)
        elif not (np.isfinite(y) and (np.isfinite(x) or deflection == "large")):
            lost.append(row)
        else:
            asked = readings.intended_y_cm[row]
            if np.isfinite(asked) and asked * y < 0 and min(abs(asked), abs(y)) > 3 * tip_se_cm:
                wrong.append(row)
                continue
            if abs(y) > 1.02 * reach:
                folded.append(row)
                continue
            model[row] = tip_curvature(y, x, length, centers, spans, deflection)
            per_cm = phi(length, centers, spans) * 3 / length**3
            error[row] = per_cm * tip_se_cm
    names = readings.name
    _note(notes, names, lost, "the camera lost the marker or the body", "clear the view")
    _note(notes, names, wrong, "the tip stood on the other side than asked for",
          "push it to the side asked for")  # fmt: skip
    _note(notes, names, folded, "the tip was pushed so far that the base folds", "push it less")
    return model, error, np.isfinite(model).all(axis=1)


def _note(
    notes: list[str], names: Sequence[str], rows: Sequence[int], what: str, cure: str
) -> None:
    if rows:
        notes.append(f"left out {listed(names, rows)}: {what}; {cure} to take it again")


def usable_readings(readings: FlexReadings, sensors: list[tuple[Side, int]]) -> NDArray[np.bool_]:
    """(n, m): in a free bend only the side opposite to the active muscle reads well."""
    return np.array([[side != active for side, _ in sensors] for active in readings.active])


def judge_rows(
    readings: FlexReadings,
    ohm: Array,
    model: Array,
    turn: Array,
    fits: list[LinearFit | None],
    usable: NDArray[np.bool_],
    good: NDArray[np.bool_],
    on_body: NDArray[np.bool_],
    notes: list[str],
) -> NDArray[np.bool_]:
    """Rows on which the sensors agree among themselves but not with the camera.

    For each row the factor `share` by which the curvature seen by the sensors differs from the
    camera's is their weighted median. Alone and near -1: the tip stood on the other side. From
    some row on: the camera (or the base) has moved. Alone otherwise: the place is wrong.
    """
    live = [c for c in range(len(fits)) if working(fits[c])]
    n = len(good)
    share, scatter = np.full(n, np.nan), np.full(n, np.nan)
    offset = np.full(n, np.nan)
    for row in np.nonzero(good)[0]:
        columns = [c for c in live if usable[row, c] and np.isfinite(ohm[row, c])]
        if len(columns) < 3:
            continue
        lines = [fits[c] for c in columns]
        seen = np.array(
            [(ohm[row, c] - f.coefficients[0]) / f.coefficients[1]
             for c, f in zip(columns, lines, strict=True) if f is not None]
        )  # fmt: skip
        noise = np.array([f.sigma / abs(f.coefficients[1]) for f in lines if f is not None])
        noise = np.maximum(noise, 1e-6)
        should = model[row, columns]
        size = float(np.abs(should).max())
        if size > 3 * float(np.median(noise)):
            ratios, weights = seen / should, np.abs(should) / noise
            share[row] = _weighted_median(ratios, weights)
            scatter[row] = 1.25 / np.sqrt(float((weights**2).sum()))
            offset[row] = share[row] - 1
    wrong_side = [
        int(r) for r in np.nonzero(share < _WRONG_SIDE)[0] if share[r] + 3 * scatter[r] < 0
    ]
    _note(notes, readings.name, wrong_side,
          "the sensors say that the robot was bent to the other side than the camera saw",
          "check which side is +y")  # fmt: skip
    kept = good.copy()
    kept[wrong_side] = False
    tips = np.array([k == "tip" for k in readings.kind])
    moved = _moved(readings, ohm, model, turn, fits, usable & kept[:, None], tips & kept, live)
    if moved is not None:
        since, shift = moved
        kept[since:] &= ~tips[since:]
        notes.append(
            f"left out {readings.name[since]} and all later tip places: the camera or the base "
            f"moved by about {abs(shift):.1f} cm before it; fix it, run `thigmo camera locate` and "
            "take them again"
        )
    rows = np.nonzero(kept & np.isfinite(offset) & tips)[0]
    miss_cm = offset[rows] * readings.tip_cm[rows, 1]
    miss_se = np.hypot(scatter[rows] * np.abs(readings.tip_cm[rows, 1]), TIP_SE_CM)
    if len(rows) >= 4:
        middle = float(np.median(miss_cm))
        odd = [
            int(r)
            for r, m, e in zip(rows, miss_cm, miss_se, strict=True)
            if abs(m - middle) > max(4.5 * e, 0.5)
        ]
        if odd and len(odd) <= 0.35 * len(rows):
            _note(notes, readings.name, odd, "the sensors agree that the tip stood elsewhere",
                  "hold it still")  # fmt: skip
            kept[odd] = False
    return kept


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def _moved(
    readings: FlexReadings,
    ohm: Array,
    model: Array,
    turn: Array,
    fits: list[LinearFit | None],
    usable: NDArray[np.bool_],
    tips: NDArray[np.bool_],
    live: list[int],
) -> tuple[int, float] | None:
    """Row from which the tip's places are shifted sideways (cm) for all sensors; None = none.

    For each possible row, each sensor's line gets a step in the pattern that a shifted place
    leaves; the sensors must agree on its size.
    """
    places = np.nonzero(tips)[0]
    best: tuple[float, int, float] | None = None
    for first in places[3:-2].tolist():
        late = tips & (np.arange(len(tips)) >= first)
        shifts, errors = [], []
        for column in live:
            fit = fits[column]
            rows = usable[:, column] & np.isfinite(ohm[:, column])
            if fit is None or rows.sum() < 8:
                continue
            size = np.where(rows & np.isfinite(fit.residuals), np.abs(fit.residuals), np.nan)
            rows &= np.nan_to_num(size, nan=np.inf) < 12 * np.nanmedian(size)
            if rows.sum() < 8:
                continue
            # Curvature at this sensor for each cm that the tip stands aside.
            aside = np.abs(readings.tip_cm[:, 1])
            pattern = np.where(
                late & (aside > 0.5), np.abs(model[:, column]) / np.maximum(aside, 0.5), 0.0
            )
            if np.ptp(pattern[rows]) == 0:
                continue
            design = np.column_stack(
                [np.ones(len(rows)), model[:, column], pattern, turn[:, column]]
            )[rows]
            line, _, rank, _ = np.linalg.lstsq(design, ohm[rows, column], rcond=None)
            if rank < 4:
                continue
            rest = ohm[rows, column] - design @ line
            variance = float(rest @ rest) / max(1, int(rows.sum()) - 4)
            covariance = np.linalg.inv(design.T @ design) * variance
            shifts.append(line[2] / line[1])
            errors.append(float(np.sqrt(covariance[2, 2])) / abs(line[1]))
        if len(shifts) < 3:
            continue
        weights = 1 / np.square(errors)
        shift = float((weights * shifts).sum() / weights.sum())
        certainty = abs(shift) * float(np.sqrt(weights.sum()))
        agree = float((weights * (np.array(shifts) - shift) ** 2).sum()) / len(shifts) < 6
        if abs(shift) > 0.4 and certainty > 6 and agree and (best is None or certainty > best[0]):
            best = (certainty, first, shift)
    return None if best is None else (best[1], best[2])


def mirrored(readings: FlexReadings) -> bool:
    """Whether most tips stood on the other side than asked for."""
    same = readings.tip_cm[:, 1] * readings.intended_y_cm
    same = same[np.isfinite(same)]
    return len(same) >= 4 and float(np.mean(same < 0)) > 0.5


def columns_swapped(
    readings: FlexReadings,
    sensors: list[tuple[Side, int]],
    ohm: Array,
    model: Array,
    good: NDArray[np.bool_],
    on_body: NDArray[np.bool_],
) -> bool:
    """Whether the columns of sensors are exchanged.

    In a free bend the side of the active muscle wrinkles. If instead the other side's readings
    scatter about their lines far more than the active side's, left and right are swapped.
    """
    ratios: list[float] = []
    for side in SIDES:
        rows = good & np.array([a == side for a in readings.active])
        spread = {}
        for which in SIDES:
            values = []
            for column, (of, _) in enumerate(sensors):
                if of != which or not on_body[column] or rows.sum() < 6:
                    continue
                design = np.column_stack([np.ones(len(good)), model[:, column]])
                try:
                    fit = fit_linear(design, np.where(rows, ohm[:, column], np.nan))
                except DataError:
                    continue
                reach = np.ptp(model[rows, column])
                steep = abs(float(fit.coefficients[1])) * reach
                scatter = float(np.sqrt(np.nanmean(fit.residuals**2)))
                values.append(scatter / max(steep, 1e-9))
            spread[which] = float(np.median(values)) if values else np.nan
        other: Side = "right" if side == "left" else "left"
        ratios.append(spread[other] / max(spread[side], 1e-9))
    known = [r for r in ratios if np.isfinite(r)]
    return len(known) > 0 and min(known) > 3.0
