"""The firmware built for more, and used for less: one, two and four muscles, under every fault.

The interlock: of all that the host may ask for, at most one muscle has a set point above zero, and
a fault leaves none. A muscle that is not fitted is neither driven nor read.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np
import pytest
from firmware_bench import Bench, Heard, flex_count, pressure_count

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator._large_board import VirtualBoard as LargeBoard
from thigmo.link import protocol as wire
from thigmo.link.framing import encode

CONVERTER = (12, 320)  # bits, us a frame: 13 conversions of the Mega's would not fit a tick
R, F = wire.Reason, wire.Fault


@dataclass(frozen=True)
class Built:
    """A board's build."""

    muscles: int
    sensors: int
    body_pressures: int
    imus: int = 0

    @property
    def table(self) -> dict[str, wire.Parameter]:
        return wire.parameters(
            muscles=self.muscles, sensors=self.sensors, body_pressures=self.body_pressures,
            imus=self.imus,
        )  # fmt: skip


USUAL, LARGE = Built(2, 10, 3), Built(4, 16, 8, 16)


class Lab(Bench):
    """A bench for a board of any build, on which so many muscles are fitted."""

    def __init__(self, built: Built, fitted: int, eeprom: bytes = b"") -> None:
        self.built, self.fitted = built, fitted
        self.most_above_zero = 0  # of the set points, at once
        super().__init__(eeprom=eeprom, noise=0.0)
        self.hello()

    def made(self) -> VirtualBoard:
        if self.built is USUAL:
            return VirtualBoard(self.seed, self.eeprom)
        return LargeBoard(self.seed, self.eeprom, *CONVERTER)

    def inputs(self) -> np.ndarray:
        """Flat sensors; nothing hangs on a muscle's input that is not fitted."""
        first, count = self.built.sensors, self.built.muscles
        levels = np.full(max(16, first + count), flex_count(0.0))
        levels[first : first + self.fitted] = [pressure_count(p) for p in self.psi[: self.fitted]]
        levels[first + self.fitted : first + count] = 0.0
        for channel, value in self.override.items():
            levels[channel] = value
        return levels

    def listen(self) -> list[Heard]:
        fresh = super().listen()
        for arrival in fresh:
            if isinstance(arrival.message, wire.Telemetry):
                above = sum(set_cpsi > 0 for set_cpsi in arrival.message.set_cpsi)
                self.most_above_zero = max(self.most_above_zero, above)
        return fresh

    def fit(self) -> None:
        """Store which muscles there are."""
        for name, values in {
            "muscle_fitted": [int(n < self.fitted) for n in range(self.built.muscles)],
            "trigger_when": [0x8F] * self.built.sensors,  # beside the body: no muscle wrinkles them
            "settle_ms": [0],
            "zero_ms": [100],
            "drift_limit_e5": [10_000],
        }.items():
            for element, value in enumerate(values):
                self.do(wire.SetParameter(self.built.table[name].index + element, value))
        self.do(wire.ApplyParameters())
        self.do(wire.SaveConfig(), 20_000)

    def ready(self) -> None:
        """Armed, of a known length, in a zone, zeroed."""
        self.do(wire.ClearFaults(0xFFFF))
        self.do(wire.Arm())
        self.do(wire.ConfirmLength(100_000, 1))
        self.do(wire.SelectZone(0))
        self.step(4500)
        self.do(wire.ZeroSensors(self.status().everted_mask & 0x3FF))
        self.until(lambda: self.status().activity is wire.Activity.IDLE)

    @property
    def psi(self) -> np.ndarray:
        return np.array(self.air.psi)

    def reason(self, command: wire.Message) -> wire.Reason:
        reply = self.ask(command)
        return reply.reason if isinstance(reply, wire.Ack) else R.NONE

    def alone(self, muscle: int, cpsi: int) -> tuple[int, ...]:
        """Pressures of the muscles, with one above zero."""
        return tuple(cpsi if n == muscle else 0 for n in range(self.built.muscles))


CASES = [(USUAL, 1), (USUAL, 2), (LARGE, 1), (LARGE, 2), (LARGE, 4)]
IDS = [f"{fitted} of {built.muscles}" for built, fitted in CASES]


@pytest.fixture(params=CASES, ids=IDS)
def lab(request: pytest.FixtureRequest) -> Lab:
    lab = Lab(*request.param)
    lab.fit()
    lab.ready()
    return lab


def test_the_board_says_what_it_holds(lab: Lab) -> None:
    said = lab.get(wire.GetCapacity(), wire.Capacity)
    assert Built(said.muscles, said.sensors, said.body_pressures, said.imus) == lab.built


def test_every_muscle_reaches_its_pressure_and_the_others_stay_empty(lab: Lab) -> None:
    for muscle in range(lab.fitted):
        lab.do(wire.SetPressure(lab.alone(muscle, 800), 0))
        lab.step(4000)
        assert lab.psi[muscle] == pytest.approx(8.0, abs=0.3)
        assert np.delete(lab.psi, muscle).max(initial=0.0) < 0.5
    lab.do(wire.Vent())
    assert lab.most_above_zero == 1


def test_a_sweep_takes_the_muscles_in_turn(lab: Lab) -> None:
    top = tuple(1000 if n < lab.fitted else 0 for n in range(lab.built.muscles))
    lab.do(wire.Sweep(top, 4000, 1, 0))
    lab.step(2000 * lab.fitted + 1000)
    peaks = [event.arg for event in lab.event(wire.EventCode.PEAK)]
    assert list(dict.fromkeys(peaks)) == list(range(lab.fitted))
    assert lab.most_above_zero == 1


def test_two_muscles_at_once_and_one_that_is_not_there_are_refused(lab: Lab) -> None:
    count = lab.built.muscles
    for first in range(count):
        for second in range(first):
            both = tuple(500 if n in (first, second) else 0 for n in range(count))
            assert lab.reason(wire.SetPressure(both, 0)) is R.BAD_VALUE
    for absent in range(lab.fitted, count):
        assert lab.reason(wire.SetPressure(lab.alone(absent, 500), 0)) is R.BAD_VALUE
        assert lab.reason(wire.Sweep(lab.alone(absent, 500), 4000, 1, 0)) is R.BAD_VALUE
        test = wire.TestOutput(wire.Output.TRANSDUCER, absent, 300, 100)
        assert lab.reason(test) is R.BAD_VALUE
    assert lab.most_above_zero == 0


def test_whatever_a_host_asks_for_one_muscle_at_most_is_above_zero(lab: Lab) -> None:
    chance = random.Random(lab.fitted)
    count = lab.built.muscles
    for _ in range(120):
        wild = tuple(chance.choice((0, 0, 400, 900, -1)) for _ in range(count))
        lab.ask(
            chance.choice(
                (
                    wire.SetPressure(wild, chance.choice((0, 300))),
                    wire.SetPressure(lab.alone(chance.randrange(count), 900), 0),
                    wire.SetPressure((0,) * count, 300),
                    wire.Sweep(wild, 2000, 1, chance.randrange(2)),
                    wire.Vent(),
                )
            )
        )
        lab.step(5 * chance.randrange(100))
    assert lab.most_above_zero == 1


@pytest.mark.parametrize("failure", ["pressure wire", "over pressure", "host", "stop", "estop"])
def test_a_fault_of_any_muscle_empties_all(lab: Lab, failure: str) -> None:
    for muscle in range(lab.fitted):
        channel = lab.built.sensors + muscle
        lab.do(wire.SetPressure(lab.alone((muscle + 1) % lab.fitted, 900), 0))
        lab.step(2500)
        match failure:
            case "pressure wire":
                lab.override[channel] = 0.0
            case "over pressure":
                lab.override[channel] = pressure_count(25.0)
            case "host":
                lab.beating = False
            case "stop":
                lab.board.write(encode(wire.Stop(7), 0, 0))
            case "estop":
                lab.board.set_estop(True)
        lab.step(1000)
        assert not any(lab.board.drive_enabled), (failure, muscle)
        lab.override.clear()
        lab.beating = True
        lab.board.set_estop(False)
        lab.step(2500)
        assert lab.status().faults or failure == "host"
        if failure == "stop":
            lab.do(wire.ClearStop(7))
        lab.ready()


def test_an_input_without_a_muscle_is_no_fault(lab: Lab) -> None:
    """It is open: of a muscle that is fitted that would be a broken wire."""
    lab.step(1000)
    assert lab.status().faults == 0
    if lab.fitted < lab.built.muscles:
        lab.do(wire.Disarm())
        index = lab.built.table["muscle_fitted"].index + lab.fitted
        lab.do(wire.SetParameter(index, 1))
        lab.do(wire.ApplyParameters())
        lab.step(200)
        assert lab.status().faults & F.PRESSURE_WIRE.mask


def test_a_board_without_muscles_grows_and_refuses_to_bend() -> None:
    lab = Lab(USUAL, 0)
    lab.fit()
    lab.ready()
    lab.do(wire.GrowTo(200_000, 0))
    lab.until(lambda: lab.ended(wire.Activity.GROWING))
    assert lab.status().faults == 0
    assert lab.status().length_um == pytest.approx(200_000, abs=500)
    lab.do(wire.ZeroSensors(lab.status().everted_mask))
    lab.until(lambda: lab.status().activity is wire.Activity.IDLE)
    assert lab.refused(wire.SetPressure((500, 0), 0)) == R.NO_BASE_SENSOR
    assert lab.refused(wire.Sweep((500, 0), 4000, 1, 0)) == R.NO_BASE_SENSOR


def test_a_large_configuration_survives_a_restart() -> None:
    lab = Lab(LARGE, 4)
    curve = tuple(range(0, 1100, 100))
    lab.do(wire.SetMap(7, 3, wire.Branch.DEFLATE, curve))
    lab.do(wire.SaveConfig(), 20_000)
    again = Lab(LARGE, 4, lab.board.eeprom)
    assert again.get(wire.GetMap(7, 3, wire.Branch.DEFLATE), wire.MapValues).curvature_e5 == curve
