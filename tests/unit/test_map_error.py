"""A body that bends otherwise than its map is told from one that is touched."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.config import SIDES, RobotConfig
from thigmo.exploration.map_error import MapDoubt, MapError, with_doubt
from thigmo.record import MapContact, RunDocument
from thigmo.robot import TRIGGER_PER_CM, ContactTrigger, SensorTable, SweepFrame, SweepResult

LENGTHS_CM = (40.0, 50.0, 53.0)  # the stages of the last body pressure
SENSORS = {40.0: 3, 50.0: 4, 53.0: 5}  # settled, a side


def _config() -> RobotConfig:
    config = RobotConfig()
    for side in SIDES:
        for sensor in config.sensors.column(side):
            sensor.scale_se = 0.02
        for zone in config.actuators.side(side).maps:
            zone.scale_se = 0.01
    return config


def _sweep(
    config: RobotConfig, length_cm: float, share: float, touch: float, rng: np.random.Generator
) -> SweepResult:
    """Both sides swept up: the body bends by a share otherwise, and a peg holds its tip from a free
    curvature on, as a clamped beam that is held at its end.
    """
    table = SensorTable.of(config)
    lever = np.maximum(1.5 * (1 - table.center_cm / length_cm), 0.0)
    frames, readings, triggers = [], [], []
    for row, side in enumerate(SIDES):
        way = 1 - 2 * row
        curve = config.actuators.side(side).maps[2].inflate
        base = 5 if side == "left" else 0
        for n, psi in enumerate(18 * np.sin(np.linspace(0, np.pi / 2, 75))):
            g = curve.curvature(float(psi))
            bent = (1 + share) * g - max(g - touch, 0.0) * lever
            read = way * bent + 4e-4 * rng.standard_normal(10)
            excess = float(read[base] - way * g)
            frames.append(SweepFrame(side, 20.0 * row + n / 20, float(psi), way * g, excess, False))
            readings.append(read)
        if max(-way * f.excess for f in frames if f.side == side) > TRIGGER_PER_CM:
            triggers.append(ContactTrigger(side, 0.0, 0.0))
    mask = sum((1 << SENSORS[length_cm]) - 1 << 5 * row for row in range(2))
    return SweepResult(triggers, frames=frames, curvature=np.array(readings), sensors=mask)


def _doubt(share: float = 0.0, touch: float = 1.0) -> MapDoubt | None:
    config, rng = _config(), np.random.default_rng(3)
    error = MapError(config)
    for length in LENGTHS_CM:
        error.take(_sweep(config, length, share, touch, rng), length, 2)
    return error.doubt()


@pytest.mark.parametrize("share", [-0.3, -0.2, -0.15, 0.15, 0.3])
def test_a_bend_that_is_not_the_maps_is_noticed_and_measured(share: float) -> None:
    doubt = _doubt(share)
    assert doubt is not None
    assert doubt.share == pytest.approx(share, abs=0.03)
    assert doubt.body_pressure_psi == 0.49
    said = f"bends {abs(doubt.share):.0%} {'more' if share > 0 else 'less'} "
    assert said in str(doubt)
    assert "; check the body's regulator" in str(doubt)


def test_a_bend_that_is_the_maps_is_not_doubted() -> None:
    assert _doubt() is None


@pytest.mark.parametrize("touch", [0.0, 0.005, 0.01, 0.02, 0.03, 0.034, 0.035, 0.036])
def test_pegs_at_the_tip_on_both_sides_of_every_stage_are_pegs(touch: float) -> None:
    assert _doubt(touch=touch) is None


def test_what_growth_met_does_not_hang_on_the_map() -> None:
    felt = MapContact(
        30.0, 29.0, 6.0, -1e-3, (29.0, 31.0), "localized", 40.0, "left", 1.0,
        ((1.0, 0.0), (0.0, 1.0)), [], "plain beam", 3,
    )  # fmt: skip
    met = MapContact(
        40.0, 40.0, 0.0, 0.0, (39.0, 40.0), "localized", 40.0, "", 0.0,
        ((1.0, 0.0), (0.0, 1.0)), [], "stalled growth", 1,
    )  # fmt: skip
    document = RunDocument("0", "n", "u", "2026-01-01T00:00:00", contacts=[felt, met])
    doubted = with_doubt(document, MapDoubt(0.49, -0.2, 0.03))
    assert [contact.status for contact in doubted.contacts] == ["doubtful", "localized"]
    assert doubted.doubt
    assert with_doubt(document, None) == document
