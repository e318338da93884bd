"""A run that says what a test has it say, on a real stream."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from contacts import CONTACT, a_telemetry

from thigmo.closing import Closing
from thigmo.stream import (
    BodyShape,
    Command,
    Contacts,
    Event,
    Hello,
    Hub,
    Posterior,
    Question,
    RunState,
    Server,
)


class ScriptedRun(Closing):
    """A run with a hub and a socket, and nothing behind them. A context manager.

    Attributes:
        asked: commands that viewers have sent.
        answers: what they have answered.
    """

    def __init__(
        self,
        *,
        name: str = "scripted",
        folder: str = "",
        virtual: bool = True,
        url: str = "emulator://scripted",
        pid: int = 0,
    ) -> None:
        self.hub = Hub()
        self.asked: list[Command] = []
        self.answers: list[str] = []
        self.heard = threading.Event()
        self.t_s = 0.0
        self._began_s = time.time()
        pid = pid or os.getpid()
        hello = Hello(*self._now(), url, name, folder, pid, "0", virtual)
        self._server = Server(self.hub, hello, self._command)

    def close(self) -> None:
        self._server.close()
        self.hub.close()

    def _command(self, command: Command, text: str) -> None:
        self.asked.append(command)
        if command == "answer":
            self.answers.append(text)
        self.heard.set()

    def _now(self) -> tuple[float, float]:
        return self.t_s, self._began_s + self.t_s

    def state(self, **changes: object) -> None:
        """Say what it does: by default a sweep at 40 cm."""
        state = RunState(*self._now(), "SWEEP", "sweeping", 40.0, 0.5)
        self.hub.publish(replace(state, **changes))  # type: ignore[arg-type]

    def event(self, name: str, severity: str, message: str, what_next: str = "") -> None:
        self.hub.publish(Event(*self._now(), name, severity, message, what_next))  # type: ignore[arg-type]

    def bend(self, curvature_per_cm: float) -> None:
        """Tell how the body lies: 40 cm of it, bent to the left."""
        half = 0.5 * curvature_per_cm
        poses = tuple((float(x), half * x * x, 2 * half * x) for x in range(0, 41, 2))
        self.hub.publish(BodyShape(*self._now(), poses, 1.75))

    def ask(self, question: str, unit: str = "") -> None:
        self.hub.publish(Question(*self._now(), question, unit))

    def believe(
        self,
        *,
        sweeping: bool,
        status: str = "localized",
        message: str = "",
        places: Sequence[float] = tuple(0.25 + 0.5 * n for n in range(80)),
        weights: Sequence[float] = (),
    ) -> None:
        """Tell a posterior; without weights, one of a contact at 31.2 cm."""
        weights = weights or [math.exp(-0.5 * ((place - 31.2) / 1.1) ** 2) for place in places]
        self.hub.publish(
            Posterior(
                *self._now(), "left", 40.0, tuple(places), tuple(w / sum(weights) for w in weights),
                status, "one contact", message, 0.97, sweeping,
            )
        )  # fmt: skip

    def feel(self, **said: Any) -> None:
        """Tell the bent body, and a contact with its place; `said` are other fields of it."""
        self.bend(0.014)
        self.believe(sweeping=False)
        self.hub.publish(Contacts(*self._now(), (replace(CONTACT, **said),)))

    def read(self, count: int, *, faults: tuple[str, ...] = ()) -> None:
        for _ in range(count):
            self.t_s += 0.005
            pressure = 9.0 * math.sin(self.t_s) ** 2
            bend = 0.03 * math.tanh(pressure / 9.0)
            known = (bend,) * 4 + (math.nan,)
            reading = replace(
                a_telemetry(), pressure_psi=(pressure, 0.0), demand_psi=(pressure, 0.0),
                drive_ma=(4.0 + pressure, 0.0), curvature_per_cm=known + known,
                expected_per_cm=(math.nan,) * 5 + known, base_per_cm=bend, free_per_cm=bend,
                length_cm=40.0, motor=0.0, state="fault" if faults else "moving",
                activity="sweep", faults=faults,
            )  # fmt: skip
            t_s, epoch_s = self._now()
            self.hub.publish(replace(reading, t_s=t_s, epoch_s=epoch_s, device_s=self.t_s))
