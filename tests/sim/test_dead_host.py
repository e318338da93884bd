"""A host that dies or stalls in mid-sweep or growth, in real time over a pseudo-terminal.

The real firmware core in the emulated body, zeroed in virtual time, is then served on a port; a
host in a process of its own arms it and starts a sweep.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest
from served import EVER_S, LIVE, SWEEP, ServedRobot, comes, ready_to_sweep

from thigmo.errors import CommandRefusedError
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.transport import open_transport
from thigmo.robot.stopping import stop_robot

pytestmark = pytest.mark.realtime
LIMIT_S = 0.6  # of silence, and one period of the heart
Host = subprocess.Popen[bytes]
Start = Callable[[str], Host]

# A host whose port is held by another program than `port_process`.
PORTED = """
import subprocess
process = {!r}
real = subprocess.Popen
subprocess.Popen = lambda command, **o: real([command[0], "-c", process, *command[3:]], **o)
"""
# A lease of another length, in seconds, while an output is energised.
LEASE = PORTED.format(
    "import thigmo.link.port_process as p; p.ENERGISED_LEASE_S = {}; p.main()",
)
# The thread that beats stands still for two seconds, as with the processor that it waits for; the
# one that passes commands on does not.
LATE_BEATS = PORTED.format("""
import thigmo.link.port_process as p
beat, late_s = p.HeartbeatSource.beat, []
def late(source, now_s):
    if source.counter < 20 or late_s and now_s > late_s[0] + 2.0:
        return beat(source, now_s)
    late_s.append(now_s)
p.HeartbeatSource.beat = late
p.main()
""")
# Wakes up as if nothing had happened, and learns why it may not.
CARRIES_ON = (
    SWEEP
    + """
from thigmo.errors import CommandRefusedError
while True:
    client.poll(0.1)
    try:
        client.request(wire.Arm())
        client.request(wire.Sweep((1200, 0), 24_000, 1, 0))
    except CommandRefusedError as error:
        print(error.reason, flush=True)
"""
)
# With the least telemetry that a board sends while it grows.
GROW = """
import sys
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.transport import open_transport
client = Client(open_transport(sys.argv[1]))
while not client.request(wire.GetStatus()).conditions & wire.Condition.HOST_ALIVE.mask:
    client.poll(0.01)
client.request(wire.SetParameter(wire.PARAMETERS["telemetry_ms"].index, 0))
client.request(wire.ApplyParameters())
client.request(wire.Arm())
client.request(wire.GrowTo(530_000, 0))
print("growing", flush=True)
client.wait_for(lambda: False, 600.0)
"""
STALL = (
    SWEEP
    + """
ctypes.PyDLL(None).usleep(3_000_000)  # keeps the interpreter's lock, as a compilation does
report = client.request(wire.GetStatus())
print(report.state.key, report.activity.key, report.faults)
"""
)
ASKS = """
import time
until = time.monotonic() + 5.0
while time.monotonic() < until:
    client.poll(0.02)
    faults = client.request(wire.GetStatus()).faults
print(faults)
"""


@pytest.fixture
def robot() -> Iterator[ServedRobot]:
    served = ready_to_sweep()
    yield served
    served.close()


@pytest.fixture
def start(robot: ServedRobot) -> Iterator[Start]:
    """Starts a host, in a process group of its own, and waits for its sweep or growth."""
    hosts: list[Host] = []

    def start(source: str) -> Host:
        hosts.append(
            subprocess.Popen(
                [sys.executable, "-c", source, robot.port],
                stdout=subprocess.PIPE,
                start_new_session=True,
            )
        )
        said = line_of(hosts[-1])
        assert said in ("sweeping", "growing")
        if said == "sweeping":
            assert comes(lambda: robot.energised), "the sweep never reached the live zero"
        return hosts[-1]

    yield start
    for host in hosts:
        with suppress(ProcessLookupError):
            os.killpg(host.pid, signal.SIGKILL)
        host.communicate()


def line_of(host: Host) -> str:
    assert host.stdout is not None
    return host.stdout.readline().decode().strip()


def clear_and_arm(client: Client) -> None:
    """What an operator does before the next run."""
    while not client.request(wire.GetStatus()).conditions & wire.Condition.HOST_ALIVE.mask:
        client.poll(0.01)  # until the cause of host_silent is gone
    client.request(wire.ClearStop(client.request(wire.GetStatus()).stop_nonce))
    assert client.request(wire.ClearFaults(0xFFFF)).detail == 0
    client.request(wire.Arm())


def test_a_computer_that_dies_in_mid_sweep_leaves_a_safe_robot_and_a_named_fault(
    robot: ServedRobot, start: Start
) -> None:
    """Host and port process die together, as when the computer loses its power."""
    host = start(LIVE)
    os.killpg(host.pid, signal.SIGKILL)
    assert robot.off_within(LIMIT_S)
    with Client(open_transport(robot.port)) as client:
        report = client.request(wire.GetStatus())
        assert report.state is wire.State.FAULT
        assert wire.Fault.from_mask(report.faults) == (wire.Fault.HOST_SILENT,)
        assert client.wait_for(
            lambda: any(
                (e.message.code, e.message.arg) == (wire.EventCode.FAULT, wire.Fault.HOST_SILENT)
                for e in client.events
            ),
            EVER_S,
        )
        clear_and_arm(client)


def test_a_host_killed_in_mid_sweep_is_a_stop(robot: ServedRobot, start: Start) -> None:
    start(LIVE).kill()
    assert robot.off_within(LIMIT_S)
    with Client(open_transport(robot.port)) as client:
        report = client.request(wire.GetStatus())
        assert report.state is wire.State.FAULT
        assert wire.Fault.STOPPED in wire.Fault.from_mask(report.faults)
        with pytest.raises(CommandRefusedError, match="fault is latched"):
            client.request(wire.Arm())
        clear_and_arm(client)


def test_thigmo_stop_beside_a_run_that_hangs_and_the_run_does_not_carry_on(
    robot: ServedRobot, start: Start
) -> None:
    host = start(CARRIES_ON)
    host.send_signal(signal.SIGSTOP)
    stop_robot(robot.port)
    assert not robot.energised
    host.send_signal(signal.SIGCONT)
    assert refused_for(host, wire.Reason.FAULT_LATCHED)
    assert not robot.energised


def test_control_c_beside_a_run_that_hangs(robot: ServedRobot, start: Start) -> None:
    host = start(CARRIES_ON)
    host.send_signal(signal.SIGSTOP)
    os.killpg(host.pid, signal.SIGINT)
    assert robot.off_within(LIMIT_S)


def test_a_run_that_hangs_for_longer_than_its_lease_does_not_carry_on(
    robot: ServedRobot, start: Start
) -> None:
    host = start(LEASE.format(1.0) + CARRIES_ON)
    host.send_signal(signal.SIGSTOP)
    assert robot.off_within(1.0 + LIMIT_S)
    host.send_signal(signal.SIGCONT)
    assert refused_for(host, wire.Reason.FAULT_LATCHED)
    assert not robot.energised


def test_a_suspended_program_holds_a_press_for_five_seconds_at_most(
    robot: ServedRobot, start: Start
) -> None:
    host = start(LIVE)
    host.send_signal(signal.SIGSTOP)
    assert robot.off_within(5.0 + LIMIT_S)
    host.send_signal(signal.SIGCONT)


def test_a_run_that_hangs_while_the_body_grows_costs_two_centimetres_at_most(
    robot: ServedRobot, start: Start
) -> None:
    robot.slow_motion()  # what is limited is the way, not this computer's haste
    host = start(LEASE.format(60.0) + GROW)  # in slow motion 5 s would be over first
    assert comes(lambda: robot.board.motor > 0)
    host.send_signal(signal.SIGSTOP)
    begun_cm = robot.plant.line_cm
    assert comes(lambda: robot.off_for_s > 1.0)
    assert (robot.plant.line_cm - begun_cm) / 2 <= 2.0
    host.send_signal(signal.SIGCONT)


def test_a_run_that_is_well_grows_for_as_long_as_it_takes(robot: ServedRobot, start: Start) -> None:
    start(GROW)
    assert comes(lambda: robot.plant.length_cm > 24.0)
    assert not robot.off


def test_a_robot_that_is_served_waits_for_a_heartbeat_that_its_computer_delays(
    robot: ServedRobot,
) -> None:
    command = [sys.executable, "-c", LATE_BEATS + SWEEP + ASKS, robot.port]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    assert done.stdout.split() == [b"sweeping", b"0"]


def refused_for(host: Host, reason: wire.Reason) -> bool:
    """Whether the host, which prints each refusal, is refused so before long."""
    return any(line_of(host) == reason.key for _ in range(50))


def test_three_seconds_without_the_interpreter_in_mid_sweep_are_no_fault(
    robot: ServedRobot,
) -> None:
    robot.alone()
    command = [sys.executable, "-c", STALL, robot.port]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    assert done.stdout.split() == [b"sweeping", b"moving", b"sweeping", b"0"]
