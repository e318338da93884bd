#!/usr/bin/env python3
"""A robot's action and services on ROS 2: explore, stop, clear.

Each runs the command of `thigmo` with the same name, which may be installed in an environment of
its own; progress is that of the diagnostics that `thigmo ros` publishes. If this node ends, a run
that is under way goes on, and `thigmo stop` still stops it.
"""

import json
import shlex
import signal
import subprocess
import threading
from contextlib import suppress

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger
from thigmo_ros.action import Explore

_M_PER_CM = 0.01
_THREADS = 4  # the action, its cancellation, a stop, and diagnostics: none waits for another


class Robot(Node):
    """Serves one robot, that of the parameter `robot`."""

    def __init__(self) -> None:
        super().__init__("robot")
        self._url = self._parameter("robot", "emulator://default")
        self._thigmo = self._parameter("thigmo", "thigmo")  # the command
        self._options = self._parameter("options", "")  # of `thigmo explore`
        self._busy = threading.Lock()
        self._goal = None
        anywhere = ReentrantCallbackGroup()
        self.create_subscription(
            DiagnosticArray, "/diagnostics", self._feed, 10, callback_group=anywhere
        )
        self.create_service(Trigger, "stop", self._stop, callback_group=anywhere)
        self.create_service(Trigger, "clear", self._clear, callback_group=anywhere)
        self._explorations = ActionServer(
            self, Explore, "explore", self._explore, callback_group=anywhere,
            goal_callback=lambda goal: (
                GoalResponse.REJECT if self._busy.locked() else GoalResponse.ACCEPT
            ),
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )  # fmt: skip

    def _parameter(self, name: str, default: str) -> str:
        return self.declare_parameter(name, default).value

    def _stop(self, request, response):
        return self._command(response, "stop")

    def _clear(self, request, response):
        return self._command(response, "clear")

    def _command(self, response, name: str):
        """Succeeds only if the board has confirmed the command."""
        done = subprocess.run(
            [self._thigmo, name, "--robot", self._url], capture_output=True, text=True
        )
        response.success = done.returncode == 0
        response.message = (done.stdout if response.success else done.stderr).strip()
        return response

    def _explore(self, goal):
        result = Explore.Result()
        if not self._busy.acquire(blocking=False):  # two goals came at once
            result.outcome = "another exploration is under way"
            goal.abort()
            return result
        wanted = goal.request
        options = shlex.split(self._options)
        options += ["--name", wanted.name] if wanted.name else []
        options += ["--effort", wanted.effort] if wanted.effort else []
        options += ["--time", str(wanted.time)] if wanted.time else []
        try:
            run = subprocess.Popen(
                [self._thigmo, "explore", "--json", "--robot", self._url, *options],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
            self._goal = goal
            said = self._wait(run, goal)
        finally:
            self._goal = None
            self._busy.release()
        if run.returncode == 0:
            summary = json.loads(said[0])
            result.outcome, result.folder = summary["outcome"], summary["run"]
            result.contacts = len(summary["contacts"])
            result.length = summary["length_cm"] * _M_PER_CM
            goal.succeed()
            return result
        result.outcome = said[1].strip()
        if goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    def _wait(self, run, goal):
        """What the command printed; one that is cancelled vents the robot first."""
        asked = False
        while True:
            if goal.is_cancel_requested and not asked:
                run.send_signal(signal.SIGINT)
                asked = True
            try:
                return run.communicate(timeout=0.1)
            except subprocess.TimeoutExpired:
                continue

    def _feed(self, diagnostics: DiagnosticArray) -> None:
        for status in diagnostics.status:
            if status.name == "thigmo: run" and status.hardware_id == self._url:
                values = {pair.key: pair.value for pair in status.values}
                goal = self._goal
                if goal is not None and values.get("under way") == "true":
                    goal.publish_feedback(
                        Explore.Feedback(
                            doing=status.message,
                            done=float(values["done"]),
                            stage=float(values["stage (m)"]),
                        )
                    )


rclpy.init()
executor = MultiThreadedExecutor(_THREADS)
executor.add_node(Robot())
with suppress(KeyboardInterrupt, ExternalShutdownException):
    executor.spin()
