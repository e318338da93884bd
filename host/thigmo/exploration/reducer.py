"""What a run knows, step by step: one reducer for the live run, its replay and its resumption.

The live run tells it each step with what the sensors gave. A replay takes the same steps off the
run's notes, and the same readings off the frames of its link (`recorded`). So a replay knows at
each moment what the run knew, and a run that is resumed goes on from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thigmo.config import SAME_LENGTH_CM, RobotConfig
from thigmo.exploration.methods import FIELD
from thigmo.exploration.stage import Interpreter, SideAnswer
from thigmo.exploration.stall import Lean, Obstruction, lean, stall
from thigmo.record import Obstacle, Stage, Stall
from thigmo.robot import Profile, SensorTable, SweepResult
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring


class Reducer:
    """Takes a run's steps in their order.

    Attributes:
        found: what the sweeps have shown, and the map.
        stages: those that were swept to their end.
        looked: the stage's sweep for contacts.
        measured: the sweeps that measured one; None without.
        answers: of the stage's sweeps.
        obstruction: of growth, not yet on the map.
        tried: the stall that is tried again at a higher body pressure.
        raised: zone of the body pressure that growth has needed since it stalled.
        straight_cm: up to this length the body is known not to be held bent.
    """

    def __init__(
        self, config: RobotConfig, prior: Sequence[Obstacle] = (), method: str = FIELD
    ) -> None:
        self._table = SensorTable.of(Wiring.of(config))
        self._board = self._table.board  # its zeros last from stage to stage
        self._zone = self._measured_zone = 0
        self.found = Interpreter(config, prior, method)
        self.stages: list[Stage] = []
        self.looked = SweepResult()
        self.measured: SweepResult | None = None
        self.answers: list[SideAnswer] = []
        self.obstruction: Obstruction | None = None
        self.tried: Obstruction | None = None
        self.raised: int | None = None
        self.straight_cm = 0.0

    # Growth.

    def grown(self, profile: Profile) -> Obstruction | None:
        """The stage has grown so far: what has stopped the tip, if anything."""
        self.obstruction = stall(profile.length_cm, profile.bend, self._table)
        return self.obstruction

    def leans(self, profile: Profile) -> bool:
        """Whether a growth whose sensors have no zero yet looks as if the body were held bent."""
        unknown = np.full(self._board.inputs, np.nan)
        return lean(self._by_board(profile), unknown, unknown, self._board) is not None

    def zeroed(self, profile: Profile, zeros: tuple[Floats, Floats]) -> Obstruction | None:
        """The stage has grown, and its sensors are zeroed: what holds the body bent, if anything.

        `zeros`: before and after.
        """
        self.obstruction = lean(self._by_board(profile), *zeros, self._board)
        return self.obstruction

    def _by_board(self, profile: Profile) -> Profile:
        return profile._replace(bend=profile.bend[:, : self._board.inputs])

    def let_go(self, zeros: tuple[Floats, Floats]) -> bool:
        """The tip was wound in from what held the body bent, and the sensors were zeroed again.

        Whether the body is straight again; if not, the zeros have moved by themselves.
        """
        held = self.obstruction
        assert isinstance(held, Lean)
        if held.released(*zeros):
            return True
        self.obstruction, self.straight_cm = None, held.length_cm
        return False

    def tries_more_pressure(self, zone: int) -> None:
        """What stopped the tip is tried again, at the body pressure of a zone."""
        self.tried, self.obstruction, self.raised = self.obstruction, None, zone

    def gives_up_trial(self) -> None:
        """Nobody was there to raise the body pressure: what stopped the tip stays unknown."""
        self.obstruction, self.tried, self.raised = self.tried, None, None

    def moved_on(self) -> None:
        """At the higher pressure the stage has grown to its end."""
        if self.tried is not None:
            self.found.map.tried(self.tried, moved_on=True)
        self.tried = None

    def ended_at_obstruction(self) -> Stall | None:
        """The run has ended at an obstruction, which goes on the map; what a stall may be."""
        obstruction, self.obstruction = self.obstruction, None
        if obstruction is None:
            return None
        if self.tried is None or isinstance(obstruction, Lean):
            self.found.map.add_obstruction(obstruction)
        else:
            self.found.map.tried(obstruction, moved_on=False)
        return None if isinstance(obstruction, Lean) else self.found.map.stall

    # A stage's sweeps.

    def has_looked(self, sweep: SweepResult, zone: int) -> None:
        """A sweep for contacts has ended, in a zone of body pressure."""
        self.looked, self.measured, self.answers, self._zone = sweep, None, [], zone
        self.found.take(sweep, zone)

    def has_measured(self, sweep: SweepResult, zone: int) -> None:
        """The sides with a contact were swept again, for the first time or once more, in a zone."""
        self.found.take(sweep, zone)
        if self.measured:
            sweep = replace(SweepResult.joined([self.measured, sweep]), truth=sweep.truth)
        self.measured, self._measured_zone = sweep, zone

    def localized(self) -> list[SideAnswer]:
        """Localize the stage's contacts."""
        self.answers = self.found.localize(
            self.looked, self.measured, self._zone, self._measured_zone
        )
        return self.answers

    def mapped(self) -> None:
        """What was felt goes on the map."""
        self.found.add(self.answers)

    def ended(self, t_s: float, length_cm: float) -> None:
        """The stage is over, at a length."""
        t_s = round(t_s, 6)  # a record's times are whole nanoseconds
        entry = self.found.entry(t_s, length_cm, self.looked, self.answers, self._zone)
        self.stages.append(entry)
        self.looked, self.measured, self.answers = SweepResult(), None, []

    def swept(self, length_cm: float) -> bool:
        """Whether a stage at this length was swept to its end."""
        return any(
            abs(each.everted_length_cm - length_cm) <= SAME_LENGTH_CM for each in self.stages
        )
