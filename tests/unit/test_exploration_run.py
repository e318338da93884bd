"""The exploration's flow against a robot that only answers: order, bookkeeping, abort."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fits import a_fit

from thigmo.config import RobotConfig
from thigmo.errors import CommandRefusedError, DataError, RobotFaultError
from thigmo.exploration.effort import THESIS, Effort, Planner
from thigmo.exploration.run import Exploration, Progress, Protocol
from thigmo.exploration.states import State
from thigmo.field import FieldContact, Readings
from thigmo.record import LogWriter, RunDocument, RunFolder
from thigmo.robot import ContactTrigger, Peak, SweepFrame, SweepResult
from thigmo.robot.strains import Strains
from thigmo.stream import Hub
from thigmo.wiring import Wiring

EVERY_PITCH = Effort("every pitch", measurements=1)


@dataclass
class Fit:
    """The fit's answer to any sweeps with readings: a contact 2 cm from the end of the longest."""

    width_cm: float = 6.0

    def __call__(self, readings: Readings, *_: Any, **__: Any) -> list[FieldContact]:
        length_cm = max(stage.length for stage in readings.stages)
        return [a_fit(length_cm - 2.0, length_cm, width_cm=self.width_cm)]


@pytest.fixture(autouse=True)
def fit(monkeypatch: pytest.MonkeyPatch) -> Fit:
    fit = Fit()
    monkeypatch.setattr("thigmo.exploration.fitted.contacts", fit)
    return fit


class Script:
    """A robot that writes down what it is asked, and touches a peg at one length."""

    def __init__(self, touches_at: float | None = None, start_cm: float = 0.0) -> None:
        self.calls: list[str] = []
        self.touches_at = touches_at
        self.length = start_cm
        self.operator = self
        self.fail_at = ""
        self.drifts = 0
        self.young = 0  # sensors that have everted and not settled
        self.aside = 0
        self.clock = 0.0
        self.oversample = 16
        self.settles_at = np.inf
        self.alone = False  # nobody is there once the stages have begun
        self.doubt = 0.0  # about what young sensors rest at, 1/cm
        self.hub = Hub()
        self.strains = Strains()
        self.epoch_s = 1.7e9
        self.virtual = False

    def _call(self, text: str) -> None:
        self.clock += 1.0
        self.calls.append(text)
        if self.fail_at and text.startswith(self.fail_at):
            raise RobotFaultError("spool_stall: the motor stands still", "free it")

    def now(self) -> float:
        return self.clock

    @property
    def elapsed_s(self) -> float:
        return self.clock

    def everted_length_cm(self) -> float:
        return self.length

    def warn(self, danger: str) -> None:
        self._call(f"beware: {danger}")

    def set_body_pressure(self, pressure_psi: float) -> None:
        if self.alone and self.length > 50:
            raise DataError("the body pressure must be set by hand", "set the regulator")
        self._call(f"body {pressure_psi}")

    def configure(self, config: RobotConfig) -> bool:
        self._call("configure")
        return True

    def confirm_length(self, length_cm: float) -> None:
        self._call(f"confirm {length_cm:g}")

    def measure_length(self) -> float:
        self.confirm_length(self.length)
        return self.length

    def pressurize(self, body_pressure: int) -> None:
        self.set_body_pressure(RobotConfig().body.pressures[body_pressure].pressure_psi)
        self.select_body_pressure(body_pressure)

    def arm(self) -> None:
        self._call("arm")

    def select_body_pressure(self, body_pressure: int) -> None:
        self._call(f"select {body_pressure}")

    def grow_to(self, length_cm: float, watcher: Any = None) -> float:
        self._call(f"grow {length_cm:g}")
        self.length = length_cm + 0.02
        return self.length

    def wait_settled(self, progress: Any, sensors: int = 0x3FF) -> None:
        self._call("settle")

    def settles_s(self, sensors: int) -> float:
        return 0.0

    def wait(self, seconds: float) -> None:
        self.clock += seconds

    def zero(self) -> int:
        self._call("zero")
        if self.drifts:
            self.drifts -= 1
            raise CommandRefusedError("zeroing ended early", "wait", reason="drifting")
        return 0

    def zeros(self) -> tuple[Any, Any]:
        return np.zeros(10), np.zeros(10)

    def status(self) -> Any:
        settled = self.young if self.clock > self.settles_at else 0
        return SimpleNamespace(everted=self.young, settled=settled)

    def set_aside(self, mask: int) -> None:
        if mask != self.aside:
            self._call(f"aside {mask:#x}")
        self.aside = mask

    def sweep(
        self,
        tops_psi: dict[str, float],
        *,
        period_s: float,
        rising_only: bool = False,
        enough: Any = None,
    ) -> SweepResult:
        self._call(f"sweep {tops_psi.get('left', 0.0):g} {tops_psi.get('right', 0.0):g}")
        if self.touches_at is None or abs(self.length - self.touches_at) > 0.1:
            return SweepResult()
        arc, force, centers = self.length - 2.0, -3e-4, np.array([5.0, 15, 25, 35, 45])
        column = 0.03 + force * np.maximum(arc - centers, 0)
        curvature = np.concatenate((np.full(5, np.nan), column))
        peak = Peak("left", 0.0, self.length, curvature, 0.03, 18.0, 0x3FF, 10)
        frames = [
            SweepFrame("left", n / 20, psi, psi / 600, -0.008 if psi > 9 else 0.0)
            for n, psi in enumerate(np.linspace(0.0, tops_psi.get("left", 0.0), 100))
        ]
        unread = np.full((len(frames), 10), np.nan)
        result = SweepResult([ContactTrigger("left", 0.0, -0.006)], [peak], frames, unread)
        if enough:
            enough(result)
        return result

    def follow_settling(self) -> None:
        pass

    def young_noise(self) -> np.ndarray:
        return np.full(10, self.doubt)

    def vent(self) -> None:
        self._call("vent")

    def disarm(self) -> None:
        self._call("disarm")


def _explore(
    tmp_path: Path,
    robot: Script,
    protocol: Protocol = "measure",
    progress: Progress = lambda doing, share: None,
    effort: Effort = EVERY_PITCH,
) -> Exploration:
    document = RunDocument(thigmo="0", name="n", url="u", started="s")
    tmp_path.mkdir(exist_ok=True)
    log = LogWriter(tmp_path / "run.mcap", {})
    run = Exploration(
        robot,  # type: ignore[arg-type]
        Wiring.laid_out(RobotConfig()),
        RunFolder(tmp_path),
        log,
        document,
        progress,
        Planner(Wiring.laid_out(RobotConfig()), THESIS if protocol == "thesis" else effort),
        protocol,
    )
    with log:
        run.run()
    return run


def test_an_empty_room_is_explored_to_the_full_length(tmp_path: Path) -> None:
    robot = Script()
    run = _explore(tmp_path, robot)
    assert run.state is State.DONE
    assert run.document.outcome == "full length"
    assert run.document.contacts == []
    assert [s.everted_length_cm for s in run.document.stages] == pytest.approx(
        [10, 20, 30, 40, 50, 53], abs=0.05
    )
    assert robot.calls[:4] == ["configure", "confirm 0", "arm", "body 1.47"]
    assert robot.calls[-1] == "disarm"
    first_stage = robot.calls[4:11]
    assert first_stage == [
        "select 0",
        "grow 10",
        "settle",
        "zero",
        "sweep 18 18",
        "vent",
        "select 0",
    ]
    assert [c for c in robot.calls if c.startswith("body")] == [
        "body 1.47",
        "body 1.01",
        "body 0.49",
    ]


@pytest.mark.parametrize("protocol", ["measure", "thesis"])
def test_progress_never_falls_and_ends_at_the_whole(tmp_path: Path, protocol: Protocol) -> None:
    shares: list[float] = []
    run = _explore(tmp_path, Script(), protocol, lambda doing, share: shares.append(share))
    run.tell()
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert len(set(shares)) > 10


def _measured(robot: Script) -> list[str]:
    """What the robot was asked from the first sweep that found the contact until measured."""
    calls = robot.calls
    last = max(n for n, call in enumerate(calls) if call.startswith("sweep") and call[-2:] == " 0")
    looked = max(n for n, call in enumerate(calls[:last]) if call == "sweep 18 18")
    return calls[looked + 1 : last + 1]


def test_the_body_pressure_is_raised_to_measure_at_the_full_length(tmp_path: Path) -> None:
    robot = Script(touches_at=53)
    _explore(tmp_path, robot)
    assert _measured(robot) == ["vent", "body 1.47", "select 0", "vent", "sweep 18 0"]
    assert not any(call.startswith("body") for call in robot.calls[-4:])  # and stays there


def test_the_body_pressure_is_lowered_again_to_grow_on(tmp_path: Path) -> None:
    robot = Script(touches_at=50)
    _explore(tmp_path / "seldom", robot)
    assert not any(call.startswith("body") for call in _measured(robot))
    robot = Script(touches_at=50)
    _explore(tmp_path / "often", robot, effort=replace(EVERY_PITCH, raises_often=True))
    assert "body 1.47" in _measured(robot)
    raised = robot.calls.index("sweep 18 0")
    assert robot.calls[raised + 1 : raised + 5] == ["vent", "body 0.49", "select 2", "grow 53"]


def test_a_contact_is_measured_as_it_is_if_nobody_raises_the_body_pressure(tmp_path: Path) -> None:
    robot = Script(touches_at=53)
    robot.alone = True
    run = _explore(tmp_path, robot)
    assert run.document.outcome == "full length"
    *before, swept = _measured(robot)
    assert before == ["vent", "vent"]
    assert float(swept.split()[1]) < 18


def test_young_sensors_are_set_aside_and_measure_once_their_rest_is_known(tmp_path: Path) -> None:
    robot = Script(touches_at=50)
    robot.young = 0x210
    _explore(tmp_path, robot)
    calls = robot.calls
    assert calls.index("aside 0x210") < calls.index("sweep 18 18")
    contact = max(n for n, call in enumerate(calls[:-1]) if call == "sweep 18 18")
    measured = [n for n, call in enumerate(calls) if call.startswith("sweep") and n < contact][-1]
    assert calls[measured].split()[2] == "0"  # the side that touched
    assert calls[measured - 3 : measured] == ["sweep 18 18", "vent", "vent"]  # and no waiting
    assert robot.aside == 0  # at the end all are in use again


def test_young_sensors_are_waited_for_and_zeroed_if_their_rest_stays_unknown(
    tmp_path: Path,
) -> None:
    robot = Script(touches_at=50)
    robot.young, robot.doubt = 0x210, np.inf
    robot.settles_at = 200.0
    _explore(tmp_path, robot)
    contact = robot.calls.index("aside 0x0")  # first taken in again where the contact is
    assert robot.calls[contact - 1] == "vent"
    assert robot.calls[contact + 1] == "zero"


def test_a_sweep_that_placed_its_contact_is_not_repeated(tmp_path: Path, fit: Fit) -> None:
    fit.width_cm = 2.0
    robot = Script(touches_at=50)
    run = _explore(tmp_path, robot)
    assert [c for c in robot.calls if c.startswith("sweep")] == ["sweep 18 18"] * 6
    assert len(run.document.contacts) == 1


def test_the_thesis_protocol_zeroes_before_and_after_every_sweep(tmp_path: Path) -> None:
    robot = Script()
    _explore(tmp_path, robot, "thesis")
    at = [n for n, call in enumerate(robot.calls) if call.startswith("sweep")]
    assert len(at) == 6
    assert all(robot.calls[n - 2 : n] == ["settle", "zero"] for n in at)
    assert all(robot.calls[n + 1 : n + 4] == ["vent", "settle", "zero"] for n in at)
    third = robot.calls[robot.calls.index("grow 26.5") - 2 : robot.calls.index("grow 30") + 1]
    assert third == ["body 1.47", "select 0", "grow 26.5", "body 1.01", "select 1", "grow 30"]


def test_a_contact_is_mapped_and_the_run_goes_on_to_the_full_length(tmp_path: Path) -> None:
    robot = Script(touches_at=50)
    run = _explore(tmp_path, robot)
    assert run.document.outcome == "full length"
    (contact,) = run.document.contacts
    assert contact.everted_length_cm == pytest.approx(50.02)
    assert contact.arc_cm == pytest.approx(48.02)
    assert contact.readings == 5
    assert contact.y_cm > 0  # bent to the left
    assert [bool(s.triggers) for s in run.document.stages] == [False] * 4 + [True, False]
    sweeps = [call for call in robot.calls if call.startswith("sweep")]
    assert len(sweeps) == 7
    measuring = sweeps[5].split()  # only the side that touched, and only as far as needed
    assert 9 <= float(measuring[1]) < 12
    assert measuring[2] == "0"
    assert robot.calls[robot.calls.index(sweeps[5]) - 1] == "vent"


def test_a_drifting_zero_is_tried_again_and_then_given_up(tmp_path: Path) -> None:
    robot = Script()
    robot.drifts = 3
    assert _explore(tmp_path, robot).state is State.DONE
    robot = Script()
    robot.drifts = 100
    (tmp_path / "again").mkdir()
    with pytest.raises(CommandRefusedError):
        _explore(tmp_path / "again", robot)


def test_an_error_ends_the_walk_where_it_happened(tmp_path: Path) -> None:
    robot = Script()
    robot.fail_at = "grow 30"
    with pytest.raises(RobotFaultError):
        _explore(tmp_path, robot)
    document = RunFolder(tmp_path).read_document()
    assert [s.everted_length_cm for s in document.stages] == pytest.approx([10.02, 20.02])


def test_a_run_may_start_at_any_length(tmp_path: Path) -> None:
    robot = Script(start_cm=43.0)
    _explore(tmp_path, robot)
    assert [c for c in robot.calls if c.startswith("grow")] == ["grow 50", "grow 53"]
