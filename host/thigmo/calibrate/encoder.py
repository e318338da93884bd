"""Encoder counts per cm of line, from the lengths that the camera sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from thigmo.calibrate.bench import Bench, growth_rows
from thigmo.calibrate.columns import Array, column
from thigmo.calibrate.drive import Row, pull_duty
from thigmo.calibrate.regression import Mask, fit_linear
from thigmo.calibrate.verdict import StepResult, Verdict, listed
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table

TIP_SE = 0.0015  # standard error of a tip by camera, along or across, as a share of the length


@dataclass(frozen=True)
class EncoderResult(StepResult):
    """Counts per cm of line."""

    counts_per_cm: float  # of line
    counts_se: float  # its standard error
    length_cm: Array  # (n,) lengths by camera
    counts: Array  # (n,) counts of the encoder
    used: Mask  # (n,) rows that were kept
    pull_duty: list[float | None]  # see `pull_duty`
    verdict: Verdict
    EVIDENCE: ClassVar = ("length_cm", "counts", "used")

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {**super().as_data(), "rows_left_out": np.flatnonzero(~self.used).tolist()}

    def write(self, config: RobotConfig) -> None:
        """Put in counts per cm, and the pull's duty at each body pressure."""
        config.spool.counts_per_cm = self.counts_per_cm
        for pressure, saved in zip(config.body.pressures, self.pull_duty, strict=True):
            if saved is not None:
                pressure.pull_duty = round(saved, 1)


def guided(bench: Bench) -> EncoderResult:
    """Grow, and fit counts per cm and the motor's duty to what was recorded."""
    rows = growth_rows(bench)
    drive = list(bench.session.rows("drive").values())
    return fit_encoder(column(rows, "counts"), column(rows, "seen_cm"), bench.config, drive)


def of_csv(table: Table, config: RobotConfig) -> EncoderResult:
    """Fit counts and lengths, in order of growth, from a CSV."""
    return fit_encoder(table.numbers("counts"), table.numbers("length_cm"), config)


def fit_encoder(
    counts: Array, length_cm: Array, config: RobotConfig, drive: Sequence[Row] = ()
) -> EncoderResult:
    """Counts per cm of line from counts and lengths (n,), in order of growth; rows of `Drive`.

    If the line slips (the spool turns, the tip does not move), all later rows are shifted. The
    verdict says so.
    """
    missing = ~(np.isfinite(counts) & np.isfinite(length_cm))
    names = [f"row {row + 1}" for row in range(len(counts))]
    notes: list[str] = []
    if missing.any():
        rows = listed(names, np.flatnonzero(missing).tolist())
        notes.append(f"omitted {rows}: no counts, or the camera lost the tip")
    if (~missing).sum() < 4 or np.ptp(length_cm[np.isfinite(length_cm)]) < 5:
        raise DataError(
            "four or more lengths over 5 cm or more are needed",
            "`thigmo retract` the robot and run this again; give a CSV more rows",
        )
    # Counts are exact and the camera is not, so length is fitted over counts, then inverted.
    ones = np.ones(len(counts))
    tip_se = TIP_SE * config.body.length_cm
    fit = fit_linear(np.column_stack([ones, counts]), length_cm, tip_se)
    per_count = float(fit.coefficients[1])
    slip = _slip(counts, length_cm, tip_se)
    value, error = config.spool.counts_per_cm, float("inf")
    if per_count > 0:
        value = 1 / (per_count * config.spool.payout_ratio)
        error = fit.se(1) / per_count * value
    good = False
    if per_count <= 0:
        reason = "counts fall while the robot grows: swap the encoder's A and B"
    elif slip is not None:
        row, size = slip
        reason = (
            f"the line slipped by about {size:.1f} cm before row {row + 1}: the spool turned and "
            "the tip did not follow; tighten the line, `thigmo retract`, and run "
            "`thigmo calibrate encoder --again`"
        )
    else:
        outliers = np.flatnonzero(~fit.used & ~missing).tolist()
        if outliers:
            notes.append(f"omitted {listed(names, outliers)} as outliers")
        if fit.used.sum() >= 6:
            unit = counts / max(np.nanmax(np.abs(counts)), 1)
            inlier_cm = np.where(fit.used, length_cm, np.nan)
            design = np.column_stack([ones, unit, unit**2])
            curved = fit_linear(design, inlier_cm, tip_se, reject=False)
            bow = abs(float(curved.coefficients[2]))
            if bow > max(4 * curved.se(2), 1.2):
                notes.append(f"the wound radius changes: lengths are off by up to {bow / 4:.1f} cm")
        good = error / value < 0.02
        reason = f"{value:.2f} counts per cm of line +- {100 * error / value:.2f} %"
        if not good:
            reason += (
                ", and 2 % are needed; `thigmo retract`, then `thigmo calibrate encoder` takes "
                "lengths between these"
            )
    pulls = pull_duty(drive, value, config)
    if drive and None in pulls:
        notes.append("the motor's duty was not seen at every body pressure: retract the robot and "
                     "repeat with --again, for the board to notice lost counts sooner")  # fmt: skip
    verdict = Verdict(good, reason, tuple(notes))
    return EncoderResult(value, error, length_cm, counts, fit.used, pulls, verdict)


def _slip(counts: Array, length: Array, tip_se: float) -> tuple[int, float] | None:
    """Row and size (cm) of a lasting offset in length at equal slope; None if there is none."""
    good = np.flatnonzero(np.isfinite(counts) & np.isfinite(length))
    splits: list[tuple[float, int, float]] = []
    for first in range(2, len(good) - 1):
        step = np.arange(len(good)) >= first
        design = np.column_stack([np.ones(len(good)), counts[good], step])
        try:
            fit = fit_linear(design, length[good], tip_se, reject=False)
        except DataError:
            continue
        size = -float(fit.coefficients[2])
        if size > max(0.5, 5 * fit.se(2)):
            splits.append((fit.sigma, int(good[first]), size))
    return min(splits, key=lambda split: split[0])[1:] if splits else None
