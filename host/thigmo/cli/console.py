"""The terminal: a progress bar of what the robot does, results, and the operator's prompts."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING

import typer

from thigmo.cli import ending
from thigmo.errors import DataError, ThigmoError

if TYPE_CHECKING:
    from rich.progress import Progress

    from thigmo.exploration import ExplorationResult
    from thigmo.operator_prompts import Dowel, Viewers

Show = Callable[[str, float], None]
_ANSWER_S = 0.1  # between two looks whether somebody has answered
# What is written to a pipe; a terminal sees every state.
_LOGGED = ("growing", "sweeping", "mapping", "drawing")


class Console:
    """What a command shows, and the person beside the robot whom it asks (an `Operator`).

    Everything but results goes to stderr; with `quiet`, prompts only. The viewers of a run are
    asked as well, and the first answer counts. Where nobody sits at a terminal, the
    first question ends the command, unless it is one that `asks_viewers`.
    """

    def __init__(self, *, quiet: bool, asks_viewers: bool = False) -> None:
        from rich.console import Console as RichConsole

        self.quiet = quiet
        self._asks_viewers = asks_viewers
        self.viewers: Viewers | None = None
        self.meanwhile: Callable[[float], None] | None = None
        self.out = RichConsole()
        self.err = RichConsole(stderr=True)
        self._bar: Progress | None = None

    @contextmanager
    def progress(self) -> Iterator[Show]:
        """A bar while the robot works; on a pipe, one line for each thing that it does."""
        if self.quiet:
            yield lambda doing, done: None
            return
        if not self.err.is_terminal:
            yield self._line()
            return
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

        bar = Progress(
            BarColumn(24), TaskProgressColumn(), TextColumn("{task.description}"),
            console=self.err, transient=True,
        )  # fmt: skip
        with bar:
            self._bar = bar
            task = bar.add_task("connecting", total=1.0)
            try:
                yield lambda doing, done: bar.update(task, description=doing, completed=done)
            finally:
                self._bar = None

    @contextmanager
    def interruptible(self, url: str) -> Iterator[None]:
        """Say in one line how Ctrl-C or a termination leaves the robot at an address, and end with
        its status."""
        try:
            yield
        except (KeyboardInterrupt, SystemExit) as stopped:
            from thigmo.link.transport import emulated

            notes = "".join(f" ({note})" for note in getattr(stopped, "__notes__", []))
            status = stopped.code if isinstance(stopped, SystemExit) else ending.status()
            left = (
                "the emulated robot has ended with this command"
                if emulated(url)
                else "the robot is vented and braked and keeps its length; `thigmo clear` lets it "
                "move again, then `thigmo retract` winds it in"
            )
            self.err.print(
                f"thigmo: interrupted; {left}{notes}",
                highlight=False,
                soft_wrap=True,
                markup=False,
            )
            raise typer.Exit(int(status or 0)) from None

    def _line(self) -> Show:
        last = ""

        def show(doing: str, fraction: float) -> None:
            nonlocal last
            doing = doing.partition(": ")[0]
            if doing != last and doing.startswith(_LOGGED):
                self.err.print(f"{fraction:4.0%} {doing}", highlight=False)
                last = doing

        return show

    def ask(self, question: str, unit: str = "") -> str:
        """Ask the operator; the bar stands still meanwhile, and the robot is read on.

        `unit` is that of the number that is asked for, if it is one.

        Raises:
            DataError: nobody is there to answer.
            RobotFaultError: the robot was stopped, or latched a fault: the question is void.
        """
        return self._answer(question, question, unit)

    def confirm(self, request: str) -> None:
        """Ask the operator to do something, and wait until it is done; raises as `ask`."""
        self._answer(request, f"{request} Then press Enter.", "")

    def _answer(self, question: str, at_terminal: str, unit: str) -> str:
        """The answer to a question, which viewers read without what concerns a terminal."""
        terminal = sys.stdin.isatty()
        if not terminal and not (self.viewers and self._asks_viewers):
            raise DataError(
                f"nobody can answer: {question}", "run it in a terminal, beside the robot"
            )
        if self._bar:
            self._bar.stop()
        try:
            if terminal:
                self.err.print(f"[bold]{at_terminal}[/bold] ", end="")
            if self.viewers:
                self.viewers.ask(question, unit)
            while not (terminal and self._typed()):
                if self.viewers and (answer := self.viewers.answer()) is not None:
                    if terminal:
                        self.err.print(answer, highlight=False, markup=False)
                    return answer.strip()
                if self.meanwhile:
                    self.meanwhile(_ANSWER_S)
            return input().strip()
        except (EOFError, OSError):  # OSError: of a terminal that was closed
            raise DataError(f"no answer to: {question}", "run it again, and answer") from None
        except ThigmoError:
            if terminal:
                self.err.print()  # the error is a line of its own
            raise
        finally:
            if self.viewers:
                self.viewers.ask("")
            if self._bar:
                self._bar.start()

    def _typed(self) -> bool:
        """Whether a line can be read; where nothing goes on meanwhile, it waits for a while.

        Windows cannot tell, and always waits for the line: it says so to the robot's port.
        """
        if sys.platform == "win32":
            from thigmo.link.serial_port import waits_for_operator

            waits_for_operator()
            return True
        return bool(select.select([sys.stdin], [], [], 0 if self.meanwhile else _ANSWER_S)[0])

    def result(self, result: ExplorationResult) -> None:
        """Say what an exploration found, where it is kept, and what to do next."""
        from rich.table import Table

        from thigmo.link.transport import emulated

        say, document = partial(self.out.print, highlight=False), result.document
        if not document.contacts:
            swept = ", ".join(f"{stage.everted_length_cm:.0f}" for stage in document.stages)
            say(f"[bold]No contact[/bold]{f' in sweeps at {swept} cm' if swept else ', no sweep'}.")
        else:
            known = any(c.force_n is not None for c in document.contacts)
            force = "force, N" if known else "force / EI"
            heads = ("x, cm", "y, cm", "arc, cm", "95 %, cm", force, "status")
            for status_ends in ("; ", ";\n"):  # a contact a line, if that fits
                table = Table(*heads, box=None, padding=(0, 1, 0, 0))
                for c in document.contacts:
                    table.add_row(
                        f"{c.x_cm:.1f}", f"{c.y_cm:.1f}", c.along_text.removesuffix(" cm"),
                        c.interval_text.removesuffix(" cm"),
                        c.force_text.removesuffix(" N").removesuffix(" 1/cm² (over EI)"),
                        c.certainty_text.replace("; ", status_ends),
                    )  # fmt: skip
                wide = self.out.options.update_width(1000)
                if self.out.measure(table, options=wide).maximum <= self.out.width:
                    break
            say(table)
        if document.error_x_cm is not None:
            say(
                f"Against the room's truth: |x error| {document.error_x_cm:.2f} cm, in the plane "
                f"{document.error_cm:.2f} cm."
            )
        for m in document.missed or []:
            say(f"Missed: x {m.x_cm:.1f} cm, y {m.y_cm:.1f} cm ({m.source}): {m.reason}.")
        for false in document.false or []:
            say(f"False: x {false.x_cm:.1f} cm, y {false.y_cm:.1f} cm: {false.reason}.")
        ratio = document.robot_time_s / max(document.wall_time_s, 1e-9)
        say(
            f"{document.robot_time_s:.0f} s of robot time in {document.wall_time_s:.1f} s "
            f"({ratio:.0f} times real time). Ended: {document.outcome}."
        )
        if document.stall is not None and document.stall.words not in document.outcome:
            say(f"On its way {document.stall.words}.")
        if document.skips:
            say(f"Effort {document.effort}: {document.skips}.")
        # Paths and commands are copied: no line of theirs is broken.
        planners = "for planners: obstacles.json and map.yaml beside it."
        drawn = "map.png" if (result.folder / "map.png").exists() else "contacts.json"
        typer.echo(f"Map: {result.folder / drawn}; {planners}")
        if not emulated(document.url):  # that one has ended with its run
            typer.echo(
                f"The robot is vented and keeps its length of {result.length_cm:.1f} cm. "
                f"To retract it: thigmo retract --robot {document.url}"
            )

    def everted_length_cm(self) -> float:
        """Ask for the everted length until it is a number."""
        hint = ""
        while True:
            answer = self.ask(f"{hint}Measure the everted length. How many cm?", "cm")
            try:
                length_cm = float(answer.replace(",", ".").removesuffix("cm"))
            except ValueError:
                length_cm = -1.0
            if isfinite(length_cm) and length_cm >= 0:
                return length_cm
            hint = f"{answer!r} is not a length in cm. " if answer else "The number is missing. "

    def set_body_pressure(self, pressure_psi: float) -> None:
        """Ask for the body pressure to be set."""
        self.confirm(
            f"Set the body pressure to {pressure_psi:g} psi ({pressure_psi * 6.895:.1f} kPa)."
        )

    def warn(self, danger: str) -> None:
        """Say what is dangerous about the robot."""
        self.err.print(f"Warning: {danger}", highlight=False, soft_wrap=True, markup=False)

    def place_pegs(self, pegs: Sequence[Dowel]) -> None:
        """Ask for the dowels to be placed."""
        places = "; ".join(
            f"{2 * peg.radius:.1f} cm thick at x = {peg.x:.1f}, y = {peg.y:.1f} cm" for peg in pegs
        )
        self.confirm(f"Take all dowels away, then place: {places or 'none'}.")

    def push_tip(self, y_cm: float | None) -> None:
        """Ask for the tip to be pushed aside and held, or let go."""
        if y_cm is None:
            self.confirm("Let go of the tip and lay the robot straight.")
            return
        side = "left" if y_cm > 0 else "right"
        self.confirm(f"Push the tip {abs(y_cm):.1f} cm to the {side} and hold it there.")
