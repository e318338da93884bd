"""A tip that stalls while the line pays out: seen by the sensors that do not evert."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from thigmo.config import RobotConfig
from thigmo.exploration.map import ContactMap
from thigmo.exploration.stall import Obstruction, causes, stall
from thigmo.robot import SensorTable
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

CONFIG = RobotConfig()
TABLE = SensorTable.laid_out(Wiring.laid_out(CONFIG))
UNKNOWN = np.full(10, np.nan)  # zeros of sensors that were never zeroed


def _growth(start: float, stop: float, tip: float = 99.0, seed: int = 0) -> tuple[Floats, Floats]:
    """Readings of a growth whose tip stalls at `tip`: fold, creep after it, stowed offsets."""
    rng = np.random.default_rng(seed)
    length = np.linspace(start, stop, 120)
    true = np.minimum(length, tip)[:, None]
    low, high = TABLE.center_cm - TABLE.span_cm / 2, TABLE.center_cm + TABLE.span_cm / 2
    out = np.clip((true - low) / (high - low), 0, 1)
    sign = np.where(np.arange(10) < 5, -1.0, 1.0)
    since = np.maximum(true - high, 0) / 2.0  # s, at 2 cm/s
    creep = np.where(out >= 1, 0.02 * np.abs(rng.standard_normal(10)) * np.exp(-since / 8.0), 0.0)
    bend = sign * (0.15 * (1 - np.cos(2 * np.pi * out)) / 2 + creep)
    bend += (1 - out) * 0.01 * rng.standard_normal(10) + 8e-4 * rng.standard_normal((120, 10))
    return length, bend + 0.3  # any zero


@given(st.integers(0, 4), st.integers(0, 2**31))
def test_a_growth_that_went_well_is_no_stall(pitch: int, seed: int) -> None:
    assert stall(*_growth(10.0 * pitch, 10.0 * pitch + 10, seed=seed), TABLE, UNKNOWN) is None


@given(st.floats(33.5, 36.0), st.integers(0, 2**31))
@example(33.5, 1358)  # one noisy frame long after the tip stood still
def test_a_tip_that_stalls_within_a_sensor_is_placed_within_a_centimetre(
    tip: float, seed: int
) -> None:
    obstruction = stall(*_growth(30.0, 40.0, tip, seed), TABLE, UNKNOWN)
    assert obstruction is not None
    assert obstruction.sensors == 2
    assert obstruction.arc_cm == pytest.approx(tip, abs=1.0)
    assert obstruction.interval_cm[0] <= tip <= obstruction.interval_cm[1]


@given(st.floats(30.2, 32.5), st.integers(0, 2**31))
def test_a_tip_that_stalls_before_the_sensor_has_an_interval(tip: float, seed: int) -> None:
    obstruction = stall(*_growth(30.0, 40.0, tip, seed), TABLE, UNKNOWN)
    assert obstruction is not None
    assert obstruction.interval_cm[0] <= tip <= obstruction.interval_cm[1]


def test_a_thicker_body_folds_more_gently() -> None:
    thick = RobotConfig()
    thick.body.diameter_cm *= 4
    length, bend = _growth(30.0, 40.0, 35.0)
    obstruction = stall(length, bend / 6, SensorTable.laid_out(Wiring.laid_out(thick)), UNKNOWN)
    assert obstruction is not None
    assert obstruction.arc_cm == pytest.approx(35.0, abs=1.0)
    # Of the thesis's tube so small a rise is creep.
    creep = stall(length, bend / 6, TABLE, UNKNOWN)
    assert creep is None or creep.arc_cm != pytest.approx(35.0, abs=1.0)


def test_one_sensor_that_is_silent_is_a_sensor_that_is_broken() -> None:
    length, bend = _growth(30.0, 40.0)
    bend[:, 3] = 0.3
    assert stall(length, bend, TABLE, UNKNOWN) is None


@pytest.mark.parametrize("off_cm", [-0.4, 0.4])
def test_a_fold_that_comes_before_its_sensors_place_is_no_stall(off_cm: float) -> None:
    """An IMU turns over within a centimetre, and places are in doubt."""
    length = np.linspace(30.0, 41.0, 240)
    bend = np.full((240, 10), 0.12)
    low, high = TABLE.center_cm - TABLE.span_cm / 2, TABLE.center_cm + TABLE.span_cm / 2
    bend += 0.35 * np.clip(length[:, None] - (low + off_cm) + 0.5, 0.0, 1.0)
    bend -= 0.34 * np.clip(length[:, None] - (high + off_cm) + 0.5, 0.0, 1.0)
    assert stall(length, bend, TABLE, UNKNOWN) is None


def test_where_no_sensor_was_due_nothing_can_be_said() -> None:
    assert stall(*_growth(50.0, 53.0, 51.0), TABLE, UNKNOWN) is None
    assert stall(np.zeros(0), np.zeros((0, 10)), TABLE, UNKNOWN) is None


def _obstruction(late_cm: tuple[float, ...] = (), at: float = 36.0) -> Obstruction:
    return Obstruction(at, at, (at - 1.5, at + 1.5), 2, 0.0, late_cm=late_cm)


def test_a_stall_has_causes_and_never_is_a_localized_peg_by_itself() -> None:
    for late in ((), (0.0, 0.1), (2.5, 2.6)):
        likely_causes = causes(_obstruction(late))
        assert (
            likely_causes.obstacle + likely_causes.wall + likely_causes.pressure
            == pytest.approx(1.0, abs=1e-3)
        )
        room = ContactMap(Wiring.laid_out(CONFIG))
        room.add_obstruction(_obstruction(late))
        assert room.stall == likely_causes
        assert all(contact.status == "ambiguous" for contact in room.contacts)


def test_a_tip_that_slowed_before_it_stopped_lacks_pressure() -> None:
    at_once, unknown, slowed = (
        causes(_obstruction(late)).pressure for late in ((0.0, 0.1), (), (2.5, 2.5))
    )
    assert at_once < unknown < slowed
    assert slowed > 0.95
    room = ContactMap(Wiring.laid_out(CONFIG))
    room.add_obstruction(_obstruction((2.5, 2.5)))
    assert room.contacts == []  # and what is likely no obstacle is on no map
    assert room.stall is not None
    assert "body pressure" in room.stall.words.split(",")[0]


def test_a_trial_at_a_higher_pressure_decides() -> None:
    moved, stood = (causes(_obstruction((0.0, 0.1)), moved_on=moved) for moved in (True, False))
    assert moved.pressure > 0.95
    assert stood.pressure < 0.05
    room = ContactMap(Wiring.laid_out(CONFIG))
    room.tried(_obstruction(), moved_on=True)
    assert room.contacts == []
    room.tried(_obstruction(), moved_on=False)
    (contact,) = room.contacts
    assert contact.status == "localized"


def test_a_body_that_a_caught_tip_bends_where_no_sensor_reads_puts_it_nowhere() -> None:
    length, bend = _growth(30.0, 40.0, 35.0)
    last = np.median(bend[-5:], axis=0)
    at_base, everted = np.isin(np.arange(10), (0, 5)), TABLE.center_cm < 26.0
    unread = []
    for read, bent in ((at_base, 0.01), (at_base, 0.0), (everted, 0.01)):
        obstruction = stall(length, bend, TABLE, np.where(read, last - bent, np.nan))
        assert obstruction is not None
        room = ContactMap(Wiring.laid_out(CONFIG))
        room.tried(obstruction, moved_on=False)
        (contact,) = room.contacts
        assert (contact.status == "localized") == (read is everted or not bent)
        unread.append((obstruction.unread, np.linalg.eigvalsh(contact.covariance_cm2)[-1] ** 0.5))
    shares, errors_cm = np.array(unread).T
    until_cm = obstruction.interval_cm[1]  # read up to midway to the next sensor
    assert shares == pytest.approx(
        [(1 - 10 / until_cm) ** 2, 0, (1 - 30 / until_cm) ** 2], abs=0.01
    )
    # Half the square of the length, by a curvature that is even up to the muscles' highest.
    widest = shares[0] * CONFIG.muscles[0].most_bend / 12**0.5 * obstruction.arc_cm**2
    assert errors_cm[0] == pytest.approx(widest, rel=0.05)
    assert errors_cm[1:].max() < 3.0


def test_a_known_wall_that_leads_to_the_tip_is_the_likelier_cause() -> None:
    line = [(16.0, 10.0), (26.0, 5.0)]  # crosses the path at 36 cm
    assert causes(_obstruction(), [line]).wall > 0.5 > causes(_obstruction()).wall
    assert causes(_obstruction(at=20.0), [line]).wall < 0.5


def test_sensors_that_evert_late_are_told_by_the_growth() -> None:
    """Line that pays out faster than the tip moves, and then the tip stands."""
    length, bend = _growth(30.0, 50.0, 44.0)
    obstruction = stall(length, bend, TABLE, UNKNOWN)
    assert obstruction is not None
    assert max(np.abs(obstruction.late_cm)) < 0.5
    slow = 30.0 + (length - 30.0) * 0.7
    late = np.column_stack([np.interp(slow, length, column) for column in bend.T])
    slowed = stall(length, late, TABLE, UNKNOWN)
    assert slowed is not None
    assert min(slowed.late_cm) > 1.0
