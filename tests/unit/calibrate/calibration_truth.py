"""Synthetic labs: readings of a robot whose constants are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thigmo.calibrate.actuator import BendReadings
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import loop_turns
from thigmo.config import SIDES, SIGN, RobotConfig, TanhMap
from thigmo.mechanics import Tube, push

LENGTH = 53.0
CENTERS = np.array([5.0, 15.0, 25.0, 35.0, 45.0] * 2)
SPANS = np.full(10, 5.5)


class Lab:
    """A robot with drawn constants; curvature noise `sigma` a reading, camera error `tip_se`."""

    def __init__(
        self, seed: int, sigma: float = 6e-4, tip_se: float = 0.05, base_compliance_cm: float = 0.0
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.tube = Tube(base_compliance_cm=base_compliance_cm)
        self.sigma, self.tip_se = sigma, tip_se
        self.scale = self.rng.uniform(2.5e-5, 4.5e-5, 10) * np.repeat([1, -1], 5)
        self.zero = self.rng.uniform(9e3, 14e3, 10)
        self.config = RobotConfig()

    def ohm(self, curvature: np.ndarray) -> np.ndarray:
        noisy = curvature + self.rng.normal(0, self.sigma, np.shape(curvature))
        return self.zero + noisy / self.scale

    def flex(self, places: int = 10, bends: int = 12, straight: int = 3) -> FlexReadings:
        kind: list[str] = []
        tips, ohm, asked, curvature, active = [], [], [], [], []

        def add(
            row_kind: str, k: np.ndarray, tip=(np.nan, np.nan), want=np.nan, seen=np.nan, side=""
        ):
            kind.append(row_kind)
            tips.append(tip)
            asked.append(want)
            curvature.append(seen)
            active.append(side)
            ohm.append(self.ohm(k))

        for _ in range(straight):
            add("straight", np.zeros(10), (LENGTH, self.rng.normal(0, self.tip_se)))
        for want in np.linspace(-8, 8, places):
            force = 3 * want / LENGTH**3
            bent = push(force, LENGTH, free_curvature=0.0, length=LENGTH, tube=self.tube)
            x, y, _ = bent.tip
            seen = (x + self.rng.normal(0, self.tip_se), y + self.rng.normal(0, self.tip_se))
            add("tip", bent.averages(CENTERS, SPANS), seen, want)
        for n in range(bends):
            side = SIDES[n % 2]
            k = (SIGN[side]) * 0.035 * (n // 2 + 1) / (bends // 2)
            seen = k + self.rng.normal(0, 1e-4)
            row = np.full(10, k)
            # The active side wrinkles: its readings are worth nothing.
            wrinkled = slice(0, 5) if side == "left" else slice(5, 10)
            row[wrinkled] *= self.rng.uniform(0.0, 0.8, 5)
            add("bend", row, seen=seen, side=side)
        curvature_se = np.where(np.array(kind) == "bend", 1e-4, 0.0)
        return FlexReadings(
            tuple(kind), np.array(tips), np.array(curvature),
            curvature_se, tuple(active), np.array(ohm), LENGTH, np.array(asked),
        )  # fmt: skip


def merge(first: FlexReadings, second: FlexReadings) -> FlexReadings:
    """Rows of two recordings at the same length, the second after the first."""
    return replace(
        first,
        kind=first.kind + second.kind,
        tip_cm=np.vstack([first.tip_cm, second.tip_cm]),
        curvature=np.concatenate([first.curvature, second.curvature]),
        curvature_se=np.concatenate([first.curvature_se, second.curvature_se]),
        active=first.active + second.active,
        ohm=np.vstack([first.ohm, second.ohm]),
        intended_y_cm=np.concatenate([first.intended_y_cm, second.intended_y_cm]),
        block=np.concatenate([first.block, second.block + first.block.max(initial=0) + 1]),
        name=first.name + second.name,
    )


def real_sweeps(
    seed: int,
    sweeps: int = 6,
    *,
    bow: float = 0.0,
    lost: float = 0.0,
) -> tuple[Lab, list[FlexReadings]]:
    """Sweeps out and back by a muscle, one recording each, as real flex sensors give them.

    0.7 of the scatter's variance lasts over 6 rows; gains differ between sweeps by 0.015.

    Args:
        seed: of everything.
        sweeps: in turn to the left and to the right, two for each number.
        bow: share of the answer at full bend that goes beyond a straight line (sensors 1 and 6).
        lost: share of rows in which sensors 2 and 7 drop out to a constant.
    """
    lab, rows = Lab(seed), 22
    rng = lab.rng
    ramp = 0.035 * np.concatenate([np.linspace(0, 1, 11), np.linspace(1, 0, 11)])
    loop = rng.normal(0, 3e-4, 10)
    taken_rows = []
    for _ in range(sweeps):
        readings = []
        for sign, active in ((1, "left"), (-1, "right")):
            k = np.repeat(sign * ramp[:, None], 10, axis=1)
            k[:, [1, 6]] = (1 - bow) * k[:, [1, 6]] + bow * np.abs(k[:, [1, 6]]) * k[:, [1, 6]] / (
                0.035
            )
            k = k * (1 + rng.normal(0, 0.015, 10))
            k += loop * loop_turns(sign * ramp[:, None], np.zeros(rows, np.int64))
            slow = np.empty((rows, 10))
            slow[0] = rng.normal(0, 1, 10)
            keep = np.exp(-1 / 6.0)
            for row in range(1, rows):
                slow[row] = keep * slow[row - 1] + (1 - keep**2) ** 0.5 * rng.normal(0, 1, 10)
            k += lab.sigma * (0.7**0.5 * slow)
            k += lab.sigma * 0.3**0.5 * rng.normal(0, 1, k.shape)
            wrinkled = slice(0, 5) if active == "left" else slice(5, 10)
            k[:, wrinkled] *= rng.uniform(0.0, 0.8, 5)
            ohm = lab.zero + k / lab.scale
            for column in (2, 7):
                gone = rng.random(rows) < lost
                ohm[gone, column] = lab.zero[column] - 0.012 / lab.scale[column]
            seen = sign * ramp + rng.normal(0, 1e-4, rows)
            readings.append(
                FlexReadings(
                    ("bend",) * rows, np.full((rows, 2), np.nan),
                    seen, np.full(rows, 1e-4), (active,) * rows, ohm, LENGTH,
                    np.full(rows, np.nan),
                )
            )  # fmt: skip
        taken_rows.append(merge(*readings))
    return lab, taken_rows


INFLATE = TanhMap(amplitude=0.03, scale_psi=9.0, offset_psi=7.0)
DEFLATE = TanhMap(amplitude=0.032, scale_psi=8.5, offset_psi=5.5)


def bends(
    seed: int,
    side: str = "left",
    sigma: float = 2e-4,
    offset: float = 2e-4,
    trials: int = 3,
    gain: float = 0.0,
) -> BendReadings:
    """Three trials of 0..20..0 psi in steps of 2, seen by a camera; `gain` from trial to trial."""
    rng = np.random.default_rng(seed)
    pressure, seen, branch, trial = [], [], [], []
    for number in range(trials):
        common, strength = rng.normal(0, offset), 1 + rng.normal(0, gain) if gain else 1.0
        for name, curve, steps in (
            ("inflate", INFLATE, np.arange(0, 20.1, 2)),
            ("deflate", DEFLATE, np.arange(20, -0.1, -2)),
        ):
            for p in steps:
                pressure.append(p + rng.normal(0, 0.02))
                bend = strength * curve.curvature(max(p, 0.0))
                seen.append(bend + common + rng.normal(0, sigma))
                branch.append(name)
                trial.append(number)
    n = len(seen)
    return BendReadings(
        side, 0.49, np.array(pressure), np.array(seen),
        np.full(n, 1e-4), tuple(branch), np.array(trial),
    )  # fmt: skip
