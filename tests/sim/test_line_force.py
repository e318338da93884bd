"""The line is never pulled beyond its rating while the driver obeys, whatever stops the tail."""

from __future__ import annotations

import pytest
from emulated import armed, at_each_step, scene_at

from thigmo.emulator.scene import FaultTable
from thigmo.errors import CommandRefusedError, RobotFaultError
from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder

RATING_N = 100.0


def wound_in(command: wire.Command[wire.Ack], *, jam: bool, share: float = 1.0) -> float:
    """Highest pull on the line while it is wound in; a jam stops the tail half way."""
    scene = scene_at(20.0)
    # A high supply and a cold winding: an eighth more pull, and no more speed to speak of.
    scene.spool.stall_n *= share
    robot, transport = armed(scene)
    lockstep, pulls = transport.lockstep, []
    at_each_step(transport, lambda: pulls.append(lockstep.plant.line_n))
    if jam:
        lockstep.faults.inject(FaultTable(kind="tail_jam", at_s=robot.now() + 3.0))
    try:
        robot.supervisor.start(command)
        robot.supervisor.finish(_ACTIVITY[type(command)], 60.0)
    except (RobotFaultError, CommandRefusedError):
        pass
    assert len(pulls) > 300  # it did wind
    return max(pulls)


_ACTIVITY = {wire.RetractTo: wire.Activity.RETRACTING, wire.Home: wire.Activity.HOMING}


@pytest.mark.parametrize("share", [1.0, 1.12])
@pytest.mark.parametrize("jam", [False, True])
@pytest.mark.parametrize("command", [wire.RetractTo(0, 0), wire.Home()])
def test_what_winds_in_pulls_no_harder_than_the_line_bears(
    command: wire.Command[wire.Ack], jam: bool, share: float
) -> None:
    most_n = wound_in(command, jam=jam, share=share)
    assert 20.0 < most_n <= RATING_N
    if isinstance(command, wire.Home):
        assert most_n <= RATING_N / 2  # homing touches its base on purpose


@pytest.mark.parametrize("duty", [800, -800])
@pytest.mark.parametrize(
    ("command", "speed_cm_s"),
    [
        (None, 0.0),
        (wire.GrowTo(530_000, 0), 4.0),
        (wire.RetractTo(0, 0), -2.77),
        (wire.Home(), -1.6),
    ],
)
def test_motion_against_the_command_is_noticed_within_50_ms(
    command: wire.Command[wire.Ack] | None, speed_cm_s: float, duty: int
) -> None:
    robot, transport = armed(scene_at(20.0))
    plant = transport.lockstep.plant
    if command is not None:
        robot.supervisor.start(command)
    robot.wait(2.0)
    transport.read(0.0)
    begins, line_cm = transport.now(), plant.line_cm
    transport.lockstep.faults.inject(FaultTable(kind="motor_shorted", at_s=begins, value=duty))
    decoder, against_s, noticed_s = Decoder(), None, None
    while noticed_s is None and transport.now() < begins + 0.4:
        messages = [frame.message() for frame in decoder.feed(transport.read(0.01))]
        now = transport.now()
        astray_cm = plant.line_cm - line_cm - speed_cm_s * (now - begins)
        if against_s is None and abs(astray_cm) > 0.02:
            against_s = now
        if any(isinstance(m, wire.Telemetry) and m.faults for m in messages):
            noticed_s = now
    assert against_s is not None
    assert noticed_s is not None
    assert noticed_s - against_s < 0.05 + 0.015  # a step of the emulator, and a half
    assert "spool_slip" in robot.status().faults
