"""Encoder counts against the length that the camera sees; and zeros of the pressure sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from thigmo.calibrate.regression import fit_linear
from thigmo.calibrate.verdict import StepResult, Verdict, listed
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import DataError

Array = NDArray[np.float64]
TIP_SE_CM = 0.08  # one sigma of a camera place along or across the robot


@dataclass(frozen=True)
class EncoderResult(StepResult):
    """Counts per cm of line."""

    counts_per_cm: float  # of line
    counts_se: float  # its standard error
    length_cm: Array  # (n,) by camera
    counts: Array  # (n,) of the encoder
    used: NDArray[np.bool_]  # (n,) rows that were kept
    verdict: Verdict  # in words
    EVIDENCE: ClassVar = ("length_cm", "counts", "used")

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {**super().as_data(), "rows_left_out": np.flatnonzero(~self.used).tolist()}

    def write(self, config: RobotConfig) -> None:
        """Counts per cm."""
        config.spool.counts_per_cm = self.counts_per_cm


def fit_encoder(counts: Array, length_cm: Array, config: RobotConfig) -> EncoderResult:
    """Slope of counts over length, in order of growth.

    A slip of the line (the spool turns, the tip does not) shifts all later rows: detected and said.

    Raises:
        DataError: fewer than four usable rows.
    """
    counts, length = np.asarray(counts, float), np.asarray(length_cm, float)
    notes: list[str] = []
    missing = ~(np.isfinite(counts) & np.isfinite(length))
    lost = int(missing.sum())
    names = [f"row {row + 1}" for row in range(len(counts))]
    if lost:
        rows = listed(names, np.nonzero(missing)[0].tolist())
        notes.append(f"left out {rows}: no counts, or the camera lost the tip")
    if len(counts) - lost < 4 or np.ptp(length[np.isfinite(length)]) < 5:
        raise DataError("four or more lengths over 5 cm or more are needed", "grow in steps")
    # Counts are exact, the camera is not: length over counts, then inverted.
    design = np.column_stack([np.ones(len(counts)), counts])
    fit = fit_linear(design, length, TIP_SE_CM)
    per_count, se = float(fit.coefficients[1]), fit.se(1)
    slip = _slip(counts, length)
    value, error = config.spool.counts_per_cm, float("inf")
    if per_count > 0:
        value = 1 / (per_count * config.spool.payout_ratio)
        error = se / per_count * value
    good = False
    if per_count <= 0:
        reason = "counts fall while the robot grows: swap the encoder's A and B"
    elif slip is not None:
        row, size = slip
        reason = (
            f"the line slipped by about {size:.1f} cm before row {row + 1}: the spool turned and "
            "the tip did not follow; tighten the line and repeat"
        )
    else:
        out = np.flatnonzero(~fit.used & ~missing).tolist()
        if out:
            notes.append(f"left out {listed(names, out)} as outliers")
        if fit.used.sum() >= 6:
            unit = counts / max(np.nanmax(np.abs(counts)), 1)
            curved = fit_linear(
                np.column_stack([np.ones(len(unit)), unit, unit**2]),
                np.where(fit.used, length, np.nan), TIP_SE_CM, reject=False,
            )  # fmt: skip
            bow = float(curved.coefficients[2])
            if abs(bow) > max(4 * curved.se(2), 1.2):
                notes.append(
                    f"the wound radius changes: lengths are off by up to {abs(bow) / 4:.1f} cm"
                )
        good = error / value < 0.02
        reason = f"{value:.2f} counts per cm of line +- {100 * error / value:.2f} %"
        if not good:
            reason += "; take more lengths"
    verdict = Verdict(good, reason, tuple(notes))
    return EncoderResult(value, error, length, counts, fit.used, verdict)


def _slip(counts: Array, length: Array) -> tuple[int, float] | None:
    """Row and size of a lasting offset in length at equal slope; None = none."""
    good = np.nonzero(np.isfinite(counts) & np.isfinite(length))[0]
    best: tuple[float, int, float] | None = None
    for at in range(2, len(good) - 1):
        step = (np.arange(len(good)) >= at).astype(float)
        design = np.column_stack([np.ones(len(good)), counts[good], step])
        try:
            fit = fit_linear(design, length[good], TIP_SE_CM, reject=False)
        except DataError:
            continue
        size, error = float(fit.coefficients[2]), fit.se(2)
        if size < -0.5 and abs(size) > 5 * error and (best is None or fit.sigma < best[0]):
            best = (fit.sigma, int(good[at]), -size)
    return None if best is None else (best[1], best[2])


@dataclass(frozen=True)
class PressureZero:
    """One muscle's pressure sensor at vent."""

    side: Side  # which muscle
    zero_count: float  # ADC count at 0 psi
    zero_se: float  # its standard error
    good: bool  # it may be used
    reason: str  # why


@dataclass(frozen=True)
class PressureResult(StepResult):
    """Both pressure sensors' zeros, in ADC counts; the board holds them (`pressure_zero`)."""

    zeros: tuple[PressureZero, ...]
    verdict: Verdict

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {**super().as_data(), "pressure_zero": self.board_values()}

    def board_values(self) -> list[int]:
        """The board's parameter `pressure_zero`, in 1/64 count, left then right."""
        return [round(z.zero_count * 64) for z in self.zeros]


def fit_pressure_zero(
    counts: Array, nominal: float = 102.4, span: float = 819.2, full_psi: float = 60.0
) -> PressureResult:
    """Zeros from readings with both muscles vented and the air shut.

    Args:
        counts: (n, 2) ADC counts, left and right.
        nominal: count at 0 psi by the data sheet (10 % of the supply).
        span: counts of full scale.
        full_psi: full scale.

    Raises:
        DataError: fewer than ten readings, or not two columns.
    """
    y = np.asarray(counts, float)
    if y.ndim != 2 or y.shape[1] != 2 or len(y) < 10:
        raise DataError("ten or more readings of both pressure sensors are needed", "read longer")
    zeros, notes = [], []
    for column, side in enumerate(SIDES):
        values = y[np.isfinite(y[:, column]), column]
        middle = float(np.median(values)) if len(values) else float("nan")
        spread = float(median_abs_deviation(values, scale="normal")) if len(values) else 0.0
        calm = values[np.abs(values - middle) <= 5 * max(spread, 0.5)]
        zero = float(calm.mean()) if len(calm) else float("nan")
        se = float(calm.std(ddof=1) / np.sqrt(len(calm))) if len(calm) > 1 else float("inf")
        off = (zero - nominal) * full_psi / span
        half = len(calm) // 2
        fall = float(calm[:half].mean() - calm[half:].mean()) if half else 0.0
        fall_psi = abs(fall) * full_psi / span
        good = False
        if not np.isfinite(zero) or zero < 0.05 * 1024:
            reason = "reads below 5 % of its supply: broken wire"
        elif abs(off) > 3.0:
            reason = f"is {off:+.1f} psi from its data sheet: not vented, or wrong type"
        elif fall_psi > 0.15:
            reason = f"still moves by {fall_psi:.2f} psi: wait until vented"
        else:
            good, reason = True, f"zero at {zero:.2f} counts ({off:+.2f} psi of the data sheet)"
        if not good:
            notes.append(f"the {side} pressure sensor {reason}")
        zeros.append(PressureZero(side, zero, se, good, reason))
    fine = all(z.good for z in zeros)
    reason = "both zeros taken" if fine else "vent, shut the air, check the wires, and repeat"
    return PressureResult(tuple(zeros), Verdict(fine, reason, tuple(notes)))
