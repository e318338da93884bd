"""The person beside the robot, trial by trial: what to press where, where it stood, keep it or not.

With another attendant behind it (`--rehearse`, the emulator's), every prompt is asked and that one
does the work: a rehearsal of the lab's procedure.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from thigmo.cli.console import Console
    from thigmo.studies.experiments.attendant import Attendant, Known, Place
    from thigmo.studies.experiments.explorations import PlannedRun
    from thigmo.studies.experiments.folder import Verdict
    from thigmo.studies.experiments.plan import Planned

_WORDS: dict[str, Verdict] = {"": "keep", "r": "redo", "s": "skip", "q": "quit"}


class TerminalAttendant:
    """Asks a person; see `thigmo.studies.experiments.attendant.Attendant`.

    Args:
        console: to ask at.
        camera: measures the dowels' centres, base first; None = they are typed in.
        behind: does the work in a rehearsal.
    """

    def __init__(
        self,
        console: Console,
        camera: Callable[[], list[Place]] | None = None,
        behind: Attendant | None = None,
    ) -> None:
        self._console = console
        self._camera = camera
        self._behind = behind

    def clear(self) -> None:
        """Ask for a free robot."""
        self._console.ask("Take all dowels away and lay the robot straight, then press Enter.")
        if self._behind:
            self._behind.clear()

    def push_aside(self, trial: Planned) -> None:
        """Ask for the dowels to push."""
        parts = []
        for arc, y in zip(trial.arcs_cm, trial.pushes_cm, strict=True):
            # With two contacts each dowel stands on the side from which its own force comes.
            side, away = ("left", "right") if _pushes_right(trial, arc) else ("right", "left")
            where = f"y = {y:+.1f} cm"
            parts.append(
                f"a dowel at the robot's {side} side, {arc:.1f} cm along it from its base, and "
                f"push the robot's axis there to the {away} until it is at {where}"
            )
        fold = "; the base folds" if trial.folds else ""
        self._console.ask(f"{_label(trial)}: set {'; and '.join(parts)}{fold}. Then press Enter.")
        if self._behind:
            self._behind.push_aside(trial)

    def touch(self, trial: Planned) -> None:
        """Ask for a dowel beside the bent robot."""
        self._console.ask(
            f"{_label(trial)}: the robot is bent to the {trial.side}. Set a dowel firmly so that "
            f"it just touches the robot's {trial.side} side {trial.arcs_cm[0]:.1f} cm along it "
            "from its base. Then press Enter; the robot will bend on, against the dowel."
        )
        if self._behind:
            self._behind.touch(trial)

    def dowels(self, trial: Planned) -> list[Place]:
        """Ask for each dowel's place; the camera's is offered, if there is one."""
        seen = (
            self._camera() if self._camera else self._behind.dowels(trial) if self._behind else []
        )
        return [
            self.place(number, seen[number] if number < len(seen) else None, len(trial.arcs_cm))
            for number in range(len(trial.arcs_cm))
        ]

    def place(self, number: int, offered: Place | None, count: int) -> Place:
        """Ask for the centre of one dowel of so many, an offered one to take by Enter."""
        which = "the dowel's" if count == 1 else ("the first dowel's", "the second dowel's")[number]
        offer = "" if offered is None else f" (Enter: {offered[0]:.1f} {offered[1]:.1f})"
        again = ""
        while True:
            answer = self._console.ask(
                f"{again}x and y of {which} centre by the camera, cm, base first{offer}:"
            ).replace(",", " ").split()  # fmt: skip
            if not answer and offered is not None:
                return offered
            try:
                x, y = (float(part) for part in answer)
            except ValueError:
                again = "Give two numbers, as in 38.2 4.1. "
                continue
            return x, y

    def truth(self) -> Known:
        """In a rehearsal what the emulated room knows."""
        from thigmo.studies.experiments.attendant import Known

        return self._behind.truth() if self._behind else Known()

    def verdict(self, trial: Planned | PlannedRun, summary: str) -> Verdict:
        """Ask whether to keep what was just taken."""
        while True:
            answer = self._console.ask(
                f"{summary}. Enter = keep, r = redo, s = skip, q = stop here and go on later:"
            )
            word = answer.strip().lower()[:1]
            if word in _WORDS:
                return _WORDS[word]


class TerminalBystander:
    """Asks a person; see `thigmo.studies.experiments.explorations.Bystander`.

    Args:
        console: to ask at.
        camera: measures the dowel's centre; None = it is typed in.
    """

    def __init__(self, console: Console, camera: Callable[[], list[Place]] | None = None) -> None:
        self._console = console
        self._camera = camera
        self._asks = TerminalAttendant(console)

    def set_dowel(self, run: PlannedRun) -> None:
        """Ask for the dowel in its place."""
        self._console.ask(
            f"exploration {run.key}: the robot is in its base. Set one dowel firmly within its "
            "reach beside its path, for both protocols of a trial at the same place. Then press "
            "Enter; the robot grows and sweeps."
        )

    def dowel(self, run: PlannedRun, known: Place | None) -> Place:
        """Ask for the dowel's place; the camera's (in a rehearsal the room's) is offered."""
        seen = self._camera() if self._camera else []
        return self._asks.place(0, seen[0] if seen else known, 1)

    def verdict(self, run: PlannedRun, summary: str) -> Verdict:
        """Ask whether to keep the exploration, and for a robot that may be wound in."""
        return self._asks.verdict(
            run, f"{summary}. Take the dowel away if the robot leans on it: it is wound in next"
        )


def _label(trial: Planned) -> str:
    return f"{trial.experiment}, {trial.condition}, {trial.place}, trial {trial.number}"


def _pushes_right(trial: Planned, arc: float) -> bool:
    distal = arc == trial.arcs_cm[-1]
    return (trial.side == "left") == distal
