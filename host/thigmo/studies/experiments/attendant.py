"""Whoever places the dowels, measures them and judges: a person who is asked, an emulated room.

A rehearsal is both: the person answers every prompt, the room does the work.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from thigmo.errors import DataError
from thigmo.mechanics import Peg
from thigmo.robot import Robot
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.plan import Planned

Place = tuple[float, float]
Verdict = Literal["keep", "redo", "skip", "quit"]

_CLEARANCE_CM = 0.01  # between skin and dowel that just touch
_WORDS: dict[str, Verdict] = {"": "keep", "r": "redo", "s": "skip", "q": "quit"}


class Attendant:
    """Beside a robot.

    Args:
        ask: puts a question to the person there; None: nobody is, and everything is kept.
        camera: measures the dowels' centres, base first; None: they are typed in.
        robot: an emulated one, whose room does what is asked for.
    """

    def __init__(
        self,
        ask: Callable[[str], str] | None = None,
        camera: Callable[[], list[Place]] | None = None,
        robot: Robot | None = None,
    ) -> None:
        self._ask = ask
        self._camera = camera
        self._robot = robot
        self._hands: Any = robot.operator if robot else None

    def _request(self, text: str) -> None:
        if self._ask:
            self._ask(text)

    def clear(self) -> None:
        """Take all dowels away; return when the robot lies free."""
        self._request("Take all dowels away and lay the robot straight, then press Enter.")
        if self._robot:
            self._hands.push_aside([], 0.0)
            self._hands.place_pegs([])

    def push_aside(self, trial: Planned, pushes_cm: Sequence[float]) -> None:
        """Push the robot's axis to those y (cm) where the trial's dowels touch it, and hold it."""
        parts = []
        for arc, y in zip(trial.arcs_cm, pushes_cm, strict=True):
            # With two contacts each dowel stands on the side from which its own force comes.
            from_left = (trial.side == "left") == (arc == trial.arcs_cm[-1])
            side, away = ("left", "right") if from_left else ("right", "left")
            parts.append(
                f"a dowel at the robot's {side} side, {arc:.1f} cm along it from its base, and "
                f"push the robot's axis there to the {away} until it is at y = {y:+.1f} cm"
            )
        fold = "; the base folds" if trial.folds else ""
        self._request(f"{trial.label}: set {'; and '.join(parts)}{fold}. Then press Enter.")
        if self._robot:
            pushes = list(zip(trial.arcs_cm, pushes_cm, strict=True))
            self._hands.push_aside(pushes, thesis.DOWEL_CM)

    def touch(self, trial: Planned) -> None:
        """Set a dowel that just touches the bent robot as planned; return when it stands."""
        (at,) = trial.arcs_cm
        self._request(
            f"{trial.label}: the robot is bent to the {trial.side}. Set a dowel firmly so that "
            f"it just touches the robot's {trial.side} side {at:.1f} cm along it from its base. "
            "Then press Enter; the robot will bend on, against the dowel."
        )
        if self._robot:
            arc, heading, _, x, y = self._robot.scenery().centreline.T
            radius = self._robot.config.body.radius_cm + thesis.DOWEL_CM + _CLEARANCE_CM
            normal = float(np.interp(at, arc, heading)) - trial.sign * np.pi / 2
            peg = Peg(
                float(np.interp(at, arc, x) + radius * np.cos(normal)),
                float(np.interp(at, arc, y) + radius * np.sin(normal)),
                thesis.DOWEL_CM,
            )
            self._hands.place_pegs([peg])

    def set_dowel(self, key: str) -> None:
        """Set the dowel for an exploration, at the same place for both protocols of a trial."""
        self._request(
            f"exploration {key}: the robot is in its base. Set one dowel firmly within its "
            "reach beside its path, for both protocols of a trial at the same place. Then press "
            "Enter; the robot grows and sweeps."
        )

    def dowels(self, count: int, known: Sequence[Place] = ()) -> list[Place]:
        """Centres of so many dowels, cm, base first.

        Args:
            count: of the dowels.
            known: what an emulated room says, if another robot than ours is in it.

        Raises:
            DataError: nobody is there to measure, and the room is empty.
        """
        if self._robot:
            known = [(float(peg.x), float(peg.y)) for peg in self._robot.scenery().pegs]
        seen = self._camera() if self._camera else known
        if self._ask:
            offered = (*seen, *[None] * count)
            return [self._place(number, offered[number], count) for number in range(count)]
        if len(seen) < count:
            raise DataError("the emulated room has no dowel", "name a scene with a peg")
        return list(seen[:count])

    def _place(self, number: int, offered: Place | None, count: int) -> Place:
        """Ask for the centre of one dowel of so many, an offered one to take by Enter."""
        assert self._ask
        which = "the dowel's" if count == 1 else ("the first dowel's", "the second dowel's")[number]
        offer = "" if offered is None else f" (Enter: {offered[0]:.1f} {offered[1]:.1f})"
        again = ""
        while True:
            answer = self._ask(f"{again}x and y of {which} centre by the camera, cm, base first"
                               f"{offer}:").replace(",", " ").split()  # fmt: skip
            if not answer and offered is not None:
                return offered
            try:
                x, y = (float(part) for part in answer)
            except ValueError:
                again = "Give two numbers, as in 38.2 4.1. "
                continue
            return x, y

    def truth(self) -> dict[str, list[float]]:
        """What an emulated room knows of the contacts, base first, as trials are kept with it."""
        touching = self._robot.scenery().contacts if self._robot else []
        return {
            "true_arcs_cm": [float(contact.arc) for contact in touching],
            "true_forces": [float(contact.normal) for contact in touching],
            "true_contact_x_cm": [float(contact.x) for contact in touching],
        }

    def verdict(self, summary: str) -> Verdict:
        """Whether to keep what was just taken."""
        if self._ask is None:
            return "keep"
        while True:
            answer = self._ask(
                f"{summary}. Enter = keep, r = redo, s = skip, q = stop here and go on later:"
            )
            word = answer.strip().lower()[:1]
            if word in _WORDS:
                return _WORDS[word]
