"""Who can stop the robot, and how soon its outputs are off: by page, command, keys, kills, cable,
emergency stop and ROS 2.

Each trial has an emulated robot of its own, behind a pseudo-terminal in real time, and a program
that presses a muscle to 4 psi. Times are the board's own, from the press to the end of the 10 ms
step after which no transducer is driven and the motor is braked. They include what a browser, a
command and ROS 2 take, but not what a person, a cable and a radio take. They depend on this
computer, which should have nothing else to do.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial

import numpy as np

from thigmo.emulator import serve
from thigmo.emulator.plant import STEP_S
from thigmo.emulator.scene import Scene
from thigmo.errors import DataError
from thigmo.extras import require
from thigmo.link.address import OTHER_PLACE
from thigmo_bench.studies.engine import Claim, Context, Outcome
from thigmo_bench.studies.watch import EVER_MS, Start, opened_page, running

_SILENT_MS = 500.0  # of a host: the board's limit
_LASTS_S = 0.3  # that outputs stay off
_EVER_S = 15.0
_LENGTH_CM = 20.0  # everted
# Presses a muscle until it is stopped.
_PRESS = """
import sys
from thigmo.robot import connect

with connect(sys.argv[1]) as robot:
    robot.arm()
    robot.press("left", 4.0)
    robot.wait(1.0)
    print("pressing", flush=True)
    robot.wait(60.0)
"""


class ServedRobot(serve.ServedRobot):
    """A robot on a port, ready for a muscle to be pressed."""

    def __init__(self, seed: int) -> None:
        from thigmo.emulator._board import VirtualBoard
        from thigmo.emulator.transport import EmulatorTransport
        from thigmo.link.client import Client
        from thigmo.robot import Robot

        scene = Scene.load("empty").model_copy(update={"start_length_cm": _LENGTH_CM})
        transport = EmulatorTransport(scene, VirtualBoard(seed, serve.brought_up()), seed=seed)
        with Robot(Client(transport)) as robot:  # in virtual time
            robot.configure(scene.believed(seed))
            robot.confirm_length(_LENGTH_CM, settled=True)
            robot.select_body_pressure(0)
            robot.arm()
            robot.zero()
        super().__init__(serve.PtyServer(transport.lockstep, reset_on_open=False))

    def off_ms(self, press: Callable[[], object]) -> float:
        """From a press to outputs that are off and stay so.

        Raises DataError if they were off before, or never are.
        """
        if self.off:
            raise DataError("the robot was off before it was stopped", "see `thigmo watch`")
        end_s, pressed_s = time.monotonic() + _EVER_S, self.lockstep.t_s
        press()
        while self.lockstep.t_s - max(self.live_s, pressed_s) < _LASTS_S:
            if time.monotonic() > end_s:
                raise DataError("the robot was not stopped", "see `thigmo watch`")
            time.sleep(STEP_S)
        return 1e3 * (self.live_s + STEP_S - pressed_s)


Press = Callable[[ServedRobot, int], object]
"""Stops a robot, or its program by its process, in one of the ways."""
Way = Callable[[Start], AbstractContextManager[Press]]


def at_once(press: Press) -> Way:
    """A way that needs no preparation."""
    return lambda start: nullcontext(press)


def _pull_cable(robot: ServedRobot, program: int) -> None:
    robot.plugged = False


def _press_emergency_stop(robot: ServedRobot, program: int) -> None:
    robot.lockstep.plant.estop = True
    robot.board.set_estop(True)


@contextmanager
def _command(start: Start) -> Iterator[Press]:
    stop = [sys.executable, "-m", "thigmo", "stop"]
    yield lambda robot, program: start(stop).communicate()


@contextmanager
def _space_bar(start: Start) -> Iterator[Press]:
    with opened_page(start) as (browser, address):
        page = browser.new_page()
        page.goto(address)
        page.wait_for_function("() => thigmo.store.page", timeout=EVER_MS)
        yield lambda robot, program: page.keyboard.press("Space")


@contextmanager
def _phone(start: Start) -> Iterator[Press]:
    with opened_page(start, "--host", "0.0.0.0") as (browser, address):
        size = {"width": 390, "height": 844}
        page = browser.new_page(viewport=size, has_touch=True, is_mobile=True)
        page.goto(address)
        page.wait_for_function("() => thigmo.store.page", timeout=EVER_MS)
        yield lambda robot, program: page.tap("#stop")


@contextmanager
def _ros(start: Start) -> Iterator[Press]:
    require("ros", "a stop over ROS 2")
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    from thigmo.live.ros import configuration
    from thigmo.live.ros_types import Empty

    name = f"stopping{os.getpid()}"  # of no other robot
    with running(start, "ros", "--namespace", name, says="ROS topics"):
        _domain, participant = Domain(0, configuration(None)), DomainParticipant(0)
        writer = DataWriter(participant, Topic(participant, f"rt/{name}/stop", Empty))
        end_s = time.monotonic() + _EVER_S
        while not writer.get_matched_subscriptions():
            if time.monotonic() > end_s:
                raise DataError(
                    "`thigmo ros` does not subscribe to the stop topic", "run it by hand to see why"
                )
            time.sleep(0.1)
        yield lambda robot, program: writer.write(Empty(0))


WAYS: dict[str, tuple[str, Way]] = {
    "space bar": ("on the page, in a browser here", _space_bar),
    "phone": ("a tap on the page, at this computer's network address", _phone),
    "thigmo stop": ("in another terminal, from Enter", _command),
    "Ctrl-C": (
        "in the program's terminal",
        at_once(lambda robot, program: os.killpg(program, signal.SIGINT)),
    ),
    "kill -9": (
        "the program alone",
        at_once(lambda robot, program: os.kill(program, signal.SIGKILL)),
    ),
    "kill -9, all": (
        "the program and the process that owns its port",
        at_once(lambda robot, program: os.killpg(program, signal.SIGKILL)),
    ),
    "cable": ("pulled; the board keeps its supply", at_once(_pull_cable)),
    "emergency stop": ("pressed", at_once(_press_emergency_stop)),
    "ROS 2": ("a message on the topic `stop`", _ros),
}
_HEARTLESS = ("kill -9, all", "cable")  # nobody remains to tell the board


def run(context: Context) -> Outcome:
    """Median and worst time from the press until outputs are off, for each way."""
    rows: list[dict[str, str | int | float]] = []
    for method, (description, _) in WAYS.items():
        times = stopped_ms(method, context.count(2, 10), partial(context.progress, method))
        p50, worst = float(np.median(times)), max(times)
        rows.append(
            {"who": method, "how": description, "n": len(times), "p50_ms": p50, "worst_ms": worst}
        )
        context.save(Outcome({"rows": rows}))
    worst = max(float(row["worst_ms"]) for row in rows if row["who"] in _HEARTLESS)
    limit = _SILENT_MS + 2e3 * STEP_S  # steps at either end
    claim = Claim("nobody remains to tell the board: worst", worst, limit, unit="ms")
    return Outcome({"rows": rows}, claims=[claim], summary=rows)


def stopped_ms(
    method: str, trials: int, progress: Callable[[int, int], None] = lambda done, total: None
) -> list[float]:
    """Times from the press to outputs that are off, in ms, by one of `WAYS`.

    Raises DataError if a robot was not stopped.
    """
    times: list[float] = []
    progress(0, trials)
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="tg"))
        sockets = {**os.environ, OTHER_PLACE: folder}
        start = partial(subprocess.Popen, env=sockets, text=True, stdout=subprocess.PIPE)
        press = stack.enter_context(WAYS[method][1](start))
        for trial in range(trials):
            times.append(_once(press, start, trial))
            progress(trial + 1, trials)
    return times


def _once(press: Press, start: Start, seed: int) -> float:
    """A robot that is pressed and stopped: the time in ms."""
    with ExitStack() as stack:
        robot = stack.enter_context(ServedRobot(seed))
        # As from a terminal: a group of its own. What it says of its stop is not for here.
        words = [sys.executable, "-c", _PRESS, robot.port]
        program = stack.enter_context(
            start(words, start_new_session=True, stderr=subprocess.DEVNULL)
        )
        stack.callback(program.kill)
        if program.stdout is None or program.stdout.readline() != "pressing\n":
            raise DataError("the program that presses has ended", "see `thigmo watch`")
        return robot.off_ms(lambda: press(robot, program.pid))
