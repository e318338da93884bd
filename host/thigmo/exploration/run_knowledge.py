"""What a run knows, step by step, for the live run, its replay and its resumption alike.

The live run calls a step with what the sensors gave. Each call is noted in the run's record, with
its numbers. A replay makes the same calls, with the readings of the frames that crossed the link
(`recorded`). So a replay knows at each moment what the run knew, and a run that is resumed goes on
from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import wraps
from inspect import signature
from typing import Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np

from thigmo.config import SAME_LENGTH_CM
from thigmo.exploration.methods import FIELD
from thigmo.exploration.stage import Interpreter, SideAnswer
from thigmo.exploration.stall import HeldBent, Obstruction, detect_held_bent, stall
from thigmo.record import Obstacle, Stage, Stall
from thigmo.robot import Profile, SensorTable, SweepResult
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

_P = ParamSpec("_P")
_R = TypeVar("_R")

# Called with the name of a step and its numbers.
Journal = Callable[[str, Mapping[str, object]], None]


class Step(NamedTuple):
    """The names of what a step takes."""

    readings: tuple[str, ...]  # which the record's frames hold
    numbers: tuple[str, ...]  # which the journal keeps


STEPS: dict[str, Step] = {}  # by name


def _step(
    method: Callable[Concatenate[RunKnowledge, _P], _R],
) -> Callable[Concatenate[RunKnowledge, _P], _R]:
    """Mark a method as a step of the run, which the journal keeps.

    Its positional arguments are readings, its keyword arguments are numbers.
    """
    name = method.__name__
    _, *parameters = signature(method).parameters.values()
    numbers = tuple(p.name for p in parameters if p.kind is p.KEYWORD_ONLY)
    STEPS[name] = Step(tuple(p.name for p in parameters if p.name not in numbers), numbers)

    @wraps(method)
    def noted(self: RunKnowledge, /, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        self.journal(name, kwargs)
        return method(self, *args, **kwargs)

    return noted


class RunKnowledge:
    """Takes a run's steps in their order.

    Attributes:
        journal: called with each step before it is taken.
        interpreter: of the sweeps, with the map.
        stages: those that were swept to their end.
        looked: the stage's sweep for contacts.
        measured: the sweeps that measured one; None without.
        answers: of the stage's sweeps.
        obstruction: of growth, not yet on the map.
        tried: the stall that is tried again at a higher body pressure.
        raised: number of the body pressure that growth has needed since it stalled.
        straight_cm: up to this length the body is known not to be held bent.
    """

    def __init__(self, wiring: Wiring, prior: Sequence[Obstacle] = (), method: str = FIELD) -> None:
        self._table = SensorTable.laid_out(wiring)
        self._board = self._table.board  # its zeros last from stage to stage
        self._body_pressure = self._measured_body_pressure = 0
        self._stage_looked = False
        self.journal: Journal = lambda step, numbers: None
        self.interpreter = Interpreter(wiring, prior, method)
        self.stages: list[Stage] = []
        self.looked = SweepResult()
        self.measured: SweepResult | None = None
        self.answers: list[SideAnswer] = []
        self.obstruction: Obstruction | None = None
        self.tried: Obstruction | None = None
        self.raised: int | None = None
        self.straight_cm = 0.0

    # Growth.

    @_step
    def growth_begins(self) -> None:
        """A stage's growth begins, or is tried again."""
        self.obstruction = None

    def stall(self, profile: Profile, zeros: tuple[Floats, Floats]) -> Obstruction | None:
        """What has stopped the tip in the stage's growth so far, if anything.

        `zeros`: before the sensors were zeroed last, and after.
        """
        straight = np.full(len(self._table.healthy), np.nan)
        straight[: self._board.inputs] = zeros[1]
        return stall(profile.length_cm, profile.bend, self._table, straight)

    @_step
    def growth_stalled(self, profile: Profile, zeros: tuple[Floats, Floats]) -> None:
        """Something has stopped the tip."""
        self.obstruction = self.stall(profile, zeros)

    def leans(self, profile: Profile) -> bool:
        """Whether a growth whose sensors have no zero yet looks as if the body were held bent."""
        unknown = np.full(self._board.inputs, np.nan)
        return detect_held_bent(self._by_board(profile), unknown, unknown, self._board) is not None

    def detect_held_bent(self, profile: Profile, zeros: tuple[Floats, Floats]) -> HeldBent | None:
        """What holds the body bent after the stage's growth, if anything.

        `zeros`: before the sensors were zeroed, and after.
        """
        return detect_held_bent(self._by_board(profile), *zeros, self._board)

    @_step
    def held_bent(self, profile: Profile, zeros: tuple[Floats, Floats]) -> None:
        """Something holds the body bent."""
        self.obstruction = self.detect_held_bent(profile, zeros)

    def _by_board(self, profile: Profile) -> Profile:
        return profile._replace(bend=profile.bend[:, : self._board.inputs])

    def released(self, zeros: tuple[Floats, Floats]) -> bool:
        """Whether the body is straight again, now that the tip was wound in from what held it.

        If not, the zeros have moved by themselves. `zeros`: before the last zeroing, and after.
        """
        return isinstance(self.obstruction, HeldBent) and self.obstruction.released(*zeros)

    @property
    def hangs(self) -> bool:
        """Whether the body hangs on a peg that a sweep slipped past."""
        return isinstance(self.obstruction, HeldBent) and self.obstruction.hangs

    @_step
    def let_go(self) -> None:
        """Wound in, the body no longer hangs on what a sweep slipped past."""
        self.obstruction = None

    @_step
    def zeros_moved(self) -> None:
        """Nothing holds the body bent up to this length: the zeros have moved by themselves."""
        if self.obstruction is not None:
            self.straight_cm = self.obstruction.length_cm
        self.obstruction = None

    @_step
    def tries_more_pressure(self, *, body_pressure: int) -> None:
        """What stopped the tip is tried again, at a higher body pressure."""
        self.tried, self.obstruction, self.raised = self.obstruction, None, body_pressure

    @_step
    def gives_up_trial(self) -> None:
        """Nobody was there to raise the body pressure: what stopped the tip stays unknown."""
        self.obstruction, self.tried, self.raised = self.tried, None, None

    @_step
    def moved_on(self) -> None:
        """At the higher pressure the stage has grown to its end."""
        if self.tried is not None:
            self.interpreter.map.tried(self.tried, moved_on=True)
        self.tried = None

    @_step
    def ended_at_obstruction(self) -> Stall | None:
        """The run has ended at an obstruction, which goes on the map; what a stall may be."""
        obstruction, self.obstruction = self.obstruction, None
        if obstruction is None:
            return None
        if self.tried is None or isinstance(obstruction, HeldBent):
            self.interpreter.map.add_obstruction(obstruction)
        else:
            self.interpreter.map.tried(obstruction, moved_on=False)
        return None if isinstance(obstruction, HeldBent) else self.interpreter.map.stall

    # A stage's sweeps.

    @_step
    def has_looked(self, sweep: SweepResult, *, body_pressure: int) -> None:
        """A sweep for contacts has ended, at a body pressure."""
        self.looked, self.measured, self.answers = sweep, None, []
        self._body_pressure = body_pressure
        self._stage_looked = True
        self.interpreter.take(sweep, body_pressure)

    @_step
    def has_measured(self, sweep: SweepResult, *, body_pressure: int) -> None:
        """The sides with a contact were swept again, for the first time or once more."""
        self.interpreter.take(sweep, body_pressure)
        if self.measured:
            sweep = replace(SweepResult.joined([self.measured, sweep]), truth=sweep.truth)
        self.measured, self._measured_body_pressure = sweep, body_pressure

    @_step
    def localized(self) -> list[SideAnswer]:
        """Localize the stage's contacts."""
        self.answers = self.interpreter.localize(
            self.looked, self.measured, self._body_pressure, self._measured_body_pressure
        )
        return self.answers

    @_step
    def mapped(self) -> None:
        """What was felt goes on the map."""
        self.interpreter.add(self.answers)

    @_step
    def ended(self, *, t_s: float, length_cm: float) -> None:
        """The stage is over, at a robot time and a length.

        A stage whose sweep a damaged record has lost is none.
        """
        if self._stage_looked:
            t_s = round(t_s, 6)  # a record's times are whole nanoseconds
            self.stages.append(
                self.interpreter.entry(
                    t_s, length_cm, self.looked, self.answers, self._body_pressure
                )
            )
        self.looked, self.measured, self.answers = SweepResult(), None, []
        self._stage_looked = False

    def swept(self, length_cm: float) -> bool:
        """Whether a stage at this length was swept to its end."""
        return any(
            abs(stage.everted_length_cm - length_cm) <= SAME_LENGTH_CM for stage in self.stages
        )
