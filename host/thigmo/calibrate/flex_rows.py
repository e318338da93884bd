"""The curvature that each row of the flex step should show, and which rows contradict it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from thigmo.calibrate.columns import constants_of, places_of, sensors_of
from thigmo.calibrate.encoder import TIP_SE
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import (
    LOOP_WIDTHS,
    Column,
    fit_line,
    loop_turns,
    sweeps_of,
    working,
)
from thigmo.calibrate.regression import Array, LinearFit, Mask, fit_linear
from thigmo.calibrate.verdict import listed
from thigmo.config import SIDES, FlexSensor, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.mechanics import Tube, phi, push, push_tip

_OHM_RANGE = (1_000.0, 300_000.0)  # outside, a sensor is shorted or open
_WRONG_SIDE = -0.3


@dataclass
class Rows:
    """Readings and the curvature that they should show, (n, m) each, and which of them count."""

    readings: FlexReadings  # as they were taken
    ohm: Array  # resistances, ohm; nan for an open or shorted sensor
    model: Array  # curvature that each sensor should show, 1/cm
    error: Array  # its standard error, 1/cm
    sides: list[Side]  # (m,) side of each sensor's column
    to_fit: Mask  # (m,) flex sensors that are everted
    usable: Mask  # (n, m) whether a sensor can read the row's bend
    good: Mask  # (n,) rows that can be trusted
    sweep: NDArray[np.int64]  # (n,) number of each row's sweep
    notes: list[str]  # what was omitted, and why
    loop_width: float = LOOP_WIDTHS[1]  # curvature over which the sensors' loops turn

    @property
    def tips(self) -> Mask:
        """(n,) whether the tip was pushed."""
        return np.array([kind == "tip" for kind in self.readings.kind])

    def columns(self) -> list[Column]:
        """The rows of each sensor, with the readings that count."""
        counts = self.usable & self.good[:, None] & self.to_fit
        ohm, block = np.where(counts, self.ohm, np.nan), self.readings.block
        turn = loop_turns(self.model, block, self.loop_width)
        parts = zip(ohm.T, self.model.T, self.error.T, turn.T, strict=True)
        return [Column(*part, block, self.sweep, part[1][:, None]) for part in parts]

    def lines(self) -> list[tuple[Column, LinearFit]]:
        """The sensors whose slope differs significantly from zero, with their robust lines."""
        fits = [(column, fit_line(column)) for column in self.columns()]
        return [(column, fit) for column, fit in fits if fit is not None and working(fit)]

    def expected_readings(self, number: int) -> int:
        """Number of trusted rows that a sensor should have read."""
        return int((self.usable[:, number] & self.good).sum())

    def find_loop_width(self) -> None:
        """Choose the loop width with the least scatter."""
        scatter = {}
        for width in LOOP_WIDTHS:
            self.loop_width = width
            scatter[width] = sum(np.log(max(fit.sigma, 1e-9)) for _, fit in self.lines())
        self.loop_width = min(scatter, key=scatter.__getitem__)

    def note(self, rows: Sequence[int], problem: str, cure: str) -> None:
        """Note which rows are omitted and why, if there are any."""
        if rows:
            names = listed(self.readings.name, rows)
            self.notes.append(f"omitted {names}: {problem}; {cure} to take it again")


def tip_curvature(
    y_tip: float, length_cm: float, centers: Array, spans: Array, tube: Tube | None = None
) -> Array:
    """Mean curvature (m,) under each sensor, 1/cm, if a force normal to the tip holds it at y_tip.

    The limit for small deflections is the thesis's (2.12) and (2.9). Raises DataError if the tip
    cannot reach y_tip (cm).
    """
    if abs(y_tip) >= 0.75 * length_cm:
        raise DataError(
            f"the tip cannot stand {y_tip:.1f} cm aside at {length_cm:.1f} cm of length",
            "check the camera and the length",
        )
    if y_tip == 0:
        return np.zeros(len(centers))

    def miss(force: float) -> float:
        bent = push(force, length_cm, free_curvature=0.0, length=length_cm, tube=tube)
        return bent.pose(length_cm)[1] - abs(y_tip)

    first = 3 * abs(y_tip) / length_cm**3
    force = float(brentq(miss, 0.0, 4 * first + 1e-9, xtol=1e-12, rtol=1e-6))
    bent = push(force, length_cm, free_curvature=0.0, length=length_cm, tube=tube)
    return np.asarray(np.sign(y_tip) * bent.averages(centers, spans), float)


def model_rows(readings: FlexReadings, config: RobotConfig) -> Rows:
    """Model the curvature of each row, and find which rows can be used."""
    n, length, kinds = len(readings.kind), readings.length_cm, np.array(readings.kind)
    centers, spans = constants_of(config, "center_cm", "span_cm")
    model, error = np.full((n, len(spans)), np.nan), np.zeros((n, len(spans)))
    unseen, wrong_side, folded = [], [], []
    # The straight robot, as the camera sees it, defines y = 0.
    straight_y = readings.tip_cm[kinds == "straight", 1]
    straight_y = straight_y[np.isfinite(straight_y)]
    center_y = float(np.median(straight_y)) if len(straight_y) else 0.0
    reach = push_tip(config.body.push_curvature, length).tip[1]
    # A base that turns carries the tip aside without bending the body.
    compliance = config.body.base_compliance_cm
    tube = Tube(config.body.diameter_cm, base_compliance_cm=compliance)
    reach += length * compliance * config.body.push_curvature
    tip_se = TIP_SE * length
    per_cm = phi(length, centers, spans) * 3 / length**3
    model[kinds == "straight"] = 0.0
    model[kinds == "bend"] = readings.curvature[kinds == "bend", None]
    error[kinds == "bend"] = readings.curvature_se[kinds == "bend", None]
    for row in np.flatnonzero(kinds == "tip").tolist():
        x, y = readings.tip_cm[row] - np.array([0.0, center_y])
        intended_y = readings.intended_y_cm[row]
        if not (np.isfinite(y) and np.isfinite(x)):
            unseen.append(row)
        elif (
            np.isfinite(intended_y)
            and intended_y * y < 0
            and min(abs(intended_y), abs(y)) > 3 * tip_se
        ):
            wrong_side.append(row)
        elif abs(y) > 1.02 * reach:
            folded.append(row)
        else:
            model[row] = tip_curvature(y, length, centers, spans, tube)
            error[row] = per_cm * tip_se
    unseen += np.flatnonzero((kinds == "bend") & ~np.isfinite(readings.curvature)).tolist()
    in_range = (readings.ohm > _OHM_RANGE[0]) & (readings.ohm < _OHM_RANGE[1])
    sides = [side for side, _ in places_of(config)]
    is_flex = np.array([isinstance(sensor, FlexSensor) for sensor in sensors_of(config).values()])
    rows = Rows(
        readings,
        np.where(in_range, readings.ohm, np.nan),
        model,
        error,
        sides,
        (centers + spans / 2 <= length + 1e-6) & is_flex,
        # In a free bend only the side opposite to the active muscle reads well.
        np.array(readings.active)[:, None] != np.array(sides),
        np.isfinite(model).all(axis=1),
        sweeps_of(readings.block, readings.kind, readings.active, model),
        [],
    )
    if abs(center_y) > 2.0:
        rows.notes.append(
            f"the straight robot's tip stands {center_y:+.1f} cm aside: lay the robot straight, or "
            "measure the cards' places again"
        )
    rows.note(sorted(unseen), "the camera lost the marker or the body", "clear the view")
    rows.note(wrong_side, "the tip stood on the other side than asked for",
              "push it to the side asked for")  # fmt: skip
    rows.note(folded, "the tip was pushed so far that the base folds", "push it less")
    return rows


def judge_rows(rows: Rows) -> None:
    """Omit rows in which the sensors agree with one another but not with the camera.

    For each row, `share` is the weighted median over the sensors of their curvature over the
    camera's. A single row near -1 means that the tip was on the other side; any other single row,
    that its place is wrong. If all rows from some row on disagree, camera or base have moved.
    """
    live = rows.lines()
    share, scatter = np.full((2, len(rows.good)), np.nan)
    lines = np.array([fit.coefficients[:2] for _, fit in live]).reshape(-1, 2, 1)
    expected = np.array([column.model for column, _ in live])
    measured = (np.array([column.ohm for column, _ in live]) - lines[:, 0]) / lines[:, 1]
    noise = np.array([max(fit.sigma / abs(fit.coefficients[1]), 1e-6) for _, fit in live])
    for row in np.flatnonzero(np.isfinite(measured).sum(axis=0) >= 3):
        finite = np.isfinite(measured[:, row])
        bend, spread = expected[finite, row], noise[finite]
        # What lies within the camera's error is bent to no side.
        if np.abs(bend).max() > 3 * max(float(np.median(spread)), float(rows.error[row].max())):
            weights = np.abs(bend) / spread
            share[row] = _weighted_median(measured[finite, row] / bend, weights)
            scatter[row] = 1.25 / np.sqrt(weights @ weights)
    wrong_side = np.flatnonzero((share < _WRONG_SIDE) & (share + 3 * scatter < 0)).tolist()
    rows.note(wrong_side,
              "the sensors say that the robot was bent to the other side than the camera saw",
              "check which side is +y")  # fmt: skip
    rows.good[wrong_side] = False
    split = _find_shift(rows, live)
    if split is not None:
        first_shifted, shift = split
        rows.good[first_shifted:] &= ~rows.tips[first_shifted:]
        rows.notes.append(
            f"omitted {rows.readings.name[first_shifted]} and all later tip places: the camera or "
            f"the base moved by about {abs(shift):.1f} cm before it; fix it, run `thigmo camera "
            "locate` and take them again"
        )
    places = np.flatnonzero(rows.good & np.isfinite(share) & rows.tips)
    if len(places) >= 4:
        y = rows.readings.tip_cm[places, 1]
        miss_cm, miss_se = (
            (share[places] - 1) * y,
            np.hypot(scatter[places] * y, TIP_SE * rows.readings.length_cm),
        )
        misplaced = np.abs(miss_cm - np.median(miss_cm)) > np.maximum(4.5 * miss_se, 0.5)
        outliers = places[misplaced].tolist()
        if len(outliers) <= 0.35 * len(places):
            rows.note(outliers, "the sensors agree that the tip stood elsewhere", "hold it still")
            rows.good[outliers] = False


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def _find_shift(rows: Rows, live: Sequence[tuple[Column, LinearFit]]) -> tuple[int, float] | None:
    """Row from which all tip places are shifted sideways, and by how much (cm); None if none is.

    For each possible row, each sensor's line gets a step in the pattern that a shift causes; the
    sensors must agree on its size.
    """
    readings = []
    for column, fit in live:
        size = np.where(column.finite, np.abs(fit.residuals), np.nan)
        inliers = size < 12 * np.nanmedian(size)
        if inliers.sum() >= 8:
            readings.append(column._replace(ohm=np.where(inliers, column.ohm, np.nan)))
    tips, aside = rows.tips & rows.good, np.abs(rows.readings.tip_cm[:, 1])
    splits: list[tuple[float, int, float]] = []
    for first in np.flatnonzero(tips)[3:-2].tolist():
        late = tips & (np.arange(len(tips)) >= first) & (aside > 0.5)
        shifts, errors = [], []
        for column in readings:
            # Curvature at this sensor per cm that the tip is aside.
            pattern = np.where(late, np.abs(column.model) / np.maximum(aside, 0.5), 0.0)
            design = np.column_stack([np.ones(len(late)), column.model, pattern, column.turn])
            try:
                line = fit_linear(design, column.ohm, reject=False)
            except DataError:
                continue
            shifts.append(line.coefficients[2] / line.coefficients[1])
            errors.append(line.se(2) / abs(line.coefficients[1]))
        if len(shifts) < 3:
            continue
        weights = 1 / np.square(errors)
        shift = float((weights * shifts).sum() / weights.sum())
        certainty = abs(shift) * float(np.sqrt(weights.sum()))
        agree = float((weights * (np.array(shifts) - shift) ** 2).sum()) / len(shifts) < 6
        if abs(shift) > 0.4 and certainty > 6 and agree:
            splits.append((certainty, first, shift))
    return max(splits, key=lambda split: split[0])[1:] if splits else None


def mirrored(readings: FlexReadings) -> bool:
    """Whether most tips were on the opposite of the side that was asked for."""
    same = readings.tip_cm[:, 1] * readings.intended_y_cm
    same = same[np.isfinite(same)]
    return len(same) >= 4 and float(np.mean(same < 0)) > 0.5


def columns_swapped(rows: Rows) -> bool:
    """Whether the columns of sensors are exchanged.

    In a free bend, the side of the active muscle wrinkles and reads poorly. If the readings of the
    other side scatter far more about their lines, the columns are swapped.
    """
    ratios: list[float] = []
    for side in SIDES:
        bent = rows.good & (np.array(rows.readings.active) == side)
        spread: dict[bool, list[float]] = {True: [], False: []}  # by whether it is the active side
        for column in np.flatnonzero(rows.to_fit & (bent.sum() >= 6)).tolist():
            model = rows.model[:, column]
            design = np.column_stack([np.ones(len(model)), model])
            try:
                fit = fit_linear(design, np.where(bent, rows.ohm[:, column], np.nan))
            except DataError:
                continue
            steep = abs(float(fit.coefficients[1])) * float(np.ptp(model[bent]))
            scatter = float(np.sqrt(np.nanmean(fit.residuals**2)))
            spread[rows.sides[column] == side].append(scatter / max(steep, 1e-9))
        if all(spread.values()):
            active, passive = (float(np.median(spread[is_active])) for is_active in (True, False))
            ratios.append(passive / max(active, 1e-9))
    return len(ratios) > 0 and min(ratios) > 3.0
