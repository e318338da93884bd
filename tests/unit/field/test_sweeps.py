"""What the fit reads of sweeps: bins of frames, and the bend behind a pressure that lags."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from thigmo.config import SIGN, RobotConfig, Side
from thigmo.field import Swept, read
from thigmo.robot import Peak, SweepFrame, SweepResult
from thigmo.wiring import Wiring

CONFIG = RobotConfig()
FINE_S, FRAME_S, STARTS_S = 1e-3, 0.05, 0.5
BODY_PRESSURE, LENGTH_CM = 2, 53.0


def _behind(psi: np.ndarray, lags: int) -> np.ndarray:
    """Pressures behind so many lags of equal time, of the muscle's lag in all."""
    keeps = np.exp(-FINE_S * lags / CONFIG.muscle("left").lag_s)
    for _ in range(lags):
        psi = lfilter([1 - keeps], [1, -keeps], psi)
    return psi


def _sweep(side: Side, lags: int) -> SweepResult:
    """A ramp that begins at once, by the board's map at a lag, of a body behind several."""
    t_s = np.arange(0.0, 3.0, FINE_S)
    psi = 6.0 * np.maximum(t_s - STARTS_S, 0.0)
    inflate = CONFIG.muscle(side).maps[BODY_PRESSURE].inflate
    frames = slice(0, None, round(FRAME_S / FINE_S))
    rows = zip(t_s[frames], psi[frames], _behind(psi, 1)[frames], strict=True)
    telemetry = [
        SweepFrame(side, t, p, SIGN[side] * inflate.curvature(lagged), 0.0) for t, p, lagged in rows
    ]
    bends = SIGN[side] * np.vectorize(inflate.curvature)(_behind(psi, lags)[frames])
    curvature = np.repeat(bends[:, None], 10, axis=1)
    peak = Peak(side, t_s[-1], LENGTH_CM, curvature[-1], bends[-1], psi[-1], 0x3FF, 10)
    return SweepResult([], [peak], telemetry, curvature, sensors=0x3FF)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("lags", [1, 2, 4, 8])
def test_a_bend_behind_any_chain_of_lags_lies_between_a_lag_and_a_delay(
    side: Side, lags: int
) -> None:
    prepared = read([Swept(_sweep(side, lags), BODY_PRESSURE)], side, Wiring.laid_out(CONFIG))
    assert prepared is not None
    readings, _ = prepared
    assert readings.response is not None
    off = readings.curvature.mean(axis=1) - readings.bend
    response = readings.response
    assert np.abs(response).max() > 5e-4  # the start of a ramp tells them apart
    share = float(off @ response / (response @ response))
    assert -1.05 < share < 1.0
    # What no mixture explains; the fit allows a fifth of `response` in each bin.
    assert np.abs(off - share * response).max() < 0.25 * np.abs(response).max()


def test_a_bin_knows_how_far_its_frames_bend_apart() -> None:
    prepared = read([Swept(_sweep("left", 1), BODY_PRESSURE)], "left", Wiring.laid_out(CONFIG))
    assert prepared is not None
    readings, _ = prepared
    assert readings.half_range is not None
    steps, half = np.diff(readings.bend), readings.half_range
    inner = slice(2, -2)
    assert (half[:-1] + half[1:])[inner] == pytest.approx(steps[inner], rel=0.15)
    # Of two frames, a range of 0.08 rad of the whole body has this standard deviation.
    assert (2 * half * CONFIG.body.length_cm <= 0.08 * 3**0.5).all()
