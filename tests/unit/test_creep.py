"""What young sensors rest at: foretold from a robot that stands still, with an honest error."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.config import RobotConfig
from thigmo.link import protocol as wire
from thigmo.link.inbox import TelemetryFrame
from thigmo.robot import CreepWatch
from thigmo.robot.curvature import Floats, SensorTable
from thigmo.wiring import Wiring

CONFIG = RobotConfig()
TABLE = SensorTable.laid_out(Wiring.laid_out(CONFIG))
OVERSAMPLE = 16
YOUNG = 1 << 4 | 1 << 9  # the last sensor of each side


def _sums(curvature: Floats, rng: np.random.Generator) -> tuple[int, ...]:
    ohm = 12_000.0 + curvature / TABLE.scale
    mean = 1024.0 * CONFIG.board.divider_ohm / (CONFIG.board.divider_ohm + ohm) - 0.5
    conversions = mean[:, None] + rng.normal(0, 1.0, (10, OVERSAMPLE))
    return tuple(int(v) for v in np.round(conversions.sum(axis=1)))


def _watched(
    until_s: float, seed: int, tau_s: float = 8.0, bent_s: tuple[float, float] = (0.0, 0.0)
) -> tuple[CreepWatch, Floats]:
    """A robot that grew from 40 to 50 cm until t = 0 and stood still since, and its creep."""
    rng = np.random.default_rng(seed)
    creep = 0.02 * rng.standard_normal(10)
    offset = 0.002 * rng.standard_normal(10)
    everted_s = -1.125  # the tip passed 47.75 cm then, at 2 cm/s
    watch = CreepWatch(Wiring.laid_out(CONFIG), OVERSAMPLE)
    for t in np.arange(-5.0, until_s, 0.02):
        length = 50.0 + 2.0 * min(t, 0.0)
        late = np.zeros(10)
        if t > everted_s:
            late = creep * np.exp(-(t - everted_s) / tau_s) + offset
        bent = bent_s[0] < t < bent_s[1]
        value = np.where(np.isin(np.arange(10), (4, 9)), late, 0.0) + (0.02 if bent else 0.0)
        message = wire.Telemetry(
            t_us=0,
            flex_sum=_sums(value, rng),
            pressure_cpsi=(900 if bent else 0, 0),
            set_cpsi=(0, 0),
            drive=(0, 0),
            length_um=round(length * 1e4),
            motor=0 if t >= 0 else 400,
            base_e5=0,
            free_e5=0,
            state_activity=0,
            faults=0,
        )
        watch.telemetry(TelemetryFrame(0, t, round((t + 10.0) * 1e6), message.pack()))
    return watch, creep * np.exp(-(until_s + 4.0 - everted_s) / tau_s) + offset


@pytest.mark.sim
@pytest.mark.parametrize("until_s", [8.0, 14.0])
def test_the_rest_is_foretold_within_its_standard_error(until_s: float) -> None:
    pulls = []
    for seed in range(25):
        tau = float(np.random.default_rng(seed + 100).normal(8.0, 1.0))
        watch, truth = _watched(until_s, seed, tau)
        now = np.asarray(_sums(np.zeros(10), np.random.default_rng(seed)), dtype=np.float64)
        value, sigma = watch.curvature(now, until_s + 14.0, YOUNG)
        assert np.isnan(np.delete(value, (4, 9))).all()
        pulls += list((-value - truth)[[4, 9]] / np.hypot(sigma, 6e-4)[[4, 9]])
    print(f"{np.std(pulls):.2f} standard errors")
    assert 0.1 < np.std(pulls) < 1.3
    assert np.abs(pulls).max() < 4.0


def test_the_longer_it_stands_the_better_is_its_rest_known() -> None:
    sigmas = [_watched(until, 1)[0].rest(until + 14.0, YOUNG)[1][4] for until in (5.0, 9.0, 20.0)]
    assert sigmas[0] > sigmas[1] > sigmas[2]
    assert sigmas[2] < CONFIG.column("left")[4].noise


def test_readings_of_a_bent_robot_do_not_count() -> None:
    bent, _ = _watched(14.0, 3, bent_s=(6.0, 8.0))
    value, sigma = bent.rest(28.0, YOUNG)
    straight, _ = _watched(14.0, 3)
    reference, _ = straight.rest(28.0, YOUNG)
    assert np.abs(value - reference)[[4, 9]].max() < 3 * sigma[[4, 9]].max()


def test_a_sensor_that_was_out_from_the_start_or_seen_too_briefly_is_unknown() -> None:
    watch, _ = _watched(3.0, 1)
    assert np.isnan(watch.rest(14.0, YOUNG)[0]).all()
    later, _ = _watched(14.0, 1)
    assert np.isnan(later.rest(28.0, 1)[0]).all()
