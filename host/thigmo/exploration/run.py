"""The exploration itself: walks the state table with a robot, and leaves a run folder.

One method for each state, returning the outcome that the table names. Whatever happens (an error,
Ctrl-C, a termination signal, a pulled cable), the robot stays vented and braked and the run
folder is closed and readable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

from thigmo.config import SAME_LENGTH_CM, RobotConfig, Side
from thigmo.errors import CommandRefusedError, DataError
from thigmo.exploration.effort import Plan, Planner
from thigmo.exploration.growth import (
    growth_body_pressure,
    growth_target,
    short_of,
    stage_lengths,
    trial_body_pressure,
)
from thigmo.exploration.map import peg_ahead
from thigmo.exploration.measuring import (
    held_now,
    measuring_pressure,
    pressed_enough,
    pressing_body_pressure,
)
from thigmo.exploration.obstacles import export_obstacles
from thigmo.exploration.prior import obstacle_ahead
from thigmo.exploration.run_control import Live, RunControl
from thigmo.exploration.run_knowledge import RunKnowledge
from thigmo.exploration.scoring import true_obstruction
from thigmo.exploration.stall import HeldBent
from thigmo.exploration.states import NEXT, State
from thigmo.record import LogWriter, Obstacle, RunDocument, RunFolder, Truth, read_ros_map
from thigmo.robot import (
    TRIGGER_PER_CM,
    GrowthWatcher,
    Profile,
    Robot,
    SensorTable,
    SweepResult,
    in_mask,
    rising_period_s,
    sweep_period_s,
)
from thigmo.robot.state import together
from thigmo.stream import Contacts, Grid, Log, Posterior, RunState
from thigmo.wiring import Wiring

_MOST_ZERO_TRIES = 5
_HANGS = "the body hangs on a peg that a sweep slipped past: it winds in until its end is free"
_STAND_S = 0.5  # between two checks of it
_PAUSE_S = 0.1

# "measure" sweeps a side with a contact again, to the pressure at which it is felt best; "thesis"
# takes the readings at the full sweep's peak.
Protocol = Literal["measure", "thesis"]
# Called with what the robot does, in words, and the share of the run that is done.
Progress = Callable[[str, float], None]


@dataclass
class Exploration:
    """Drives one robot through the state table."""

    robot: Robot  # connected, not yet configured
    wiring: Wiring  # of its robot.toml
    folder: RunFolder  # made
    log: LogWriter  # its record, open
    # what is known at the start; kept up to date, and written after each stage
    document: RunDocument
    progress: Progress  # called at each state and while waiting
    planner: Planner  # where it sweeps
    protocol: Protocol = "measure"  # how a contact is measured
    prior: Sequence[Obstacle] = ()  # obstacles of a map of the room
    control: RunControl = field(default_factory=RunControl)  # whether viewers want it to wait
    knowledge: RunKnowledge | None = None  # of the run that this one resumes
    state: State = State.CONFIGURE
    length_cm: float = 0.0  # everted length
    _stage_cm: float = 0.0
    _start_cm: float = 0.0  # length at which the stage's growth began
    _body_pressure: int = 0
    _measured_body_pressure: int = 0  # at which the stage's contacts are measured
    _body_psi: float | None = None  # what the operator last set
    # sides with a contact that the stage's first sweep has not placed well enough
    _unplaced: set[Side] = field(default_factory=set)
    _growth: GrowthWatcher = field(default_factory=GrowthWatcher)
    _zero_tries: int = 0
    _measurements: int = 0  # sweeps that have measured the stage's contacts
    _plan_ahead: Plan = field(default_factory=lambda: Plan((), 0))  # from the stage on
    _ends_s: float = 0.0  # robot time at which the run is expected to end; 0 before a plan
    _done: float = 0.0  # share of the run

    def __post_init__(self) -> None:
        self.live = Live(self.robot)
        self._knowledge = self.knowledge or RunKnowledge(
            self.wiring, self.prior, self.document.method
        )
        self._knowledge.journal = self._note_step
        self._interpreter = self._knowledge.interpreter
        self._interpreter.map.fits.meanwhile = self._mind_the_robot
        self._table = SensorTable.laid_out(self.wiring)
        self._base = sum(1 << number for number in self.wiring.base_inputs)
        self.planner = Planner(self._short_of_the_map(), self.planner.effort)

    @property
    def config(self) -> RobotConfig:
        """robot.toml."""
        return self.wiring.config

    def run(self) -> None:
        """Walk the table to its end; each state has the method of its name.

        Raises ThigmoError if robot, link or operator stopped it; the document says where.
        """
        while self.state is not State.DONE:
            if self.state is State.PLAN:
                self._pause()
            self.tell()
            outcome: str = getattr(self, f"_{self.state.name.lower()}")()
            next_state = NEXT[self.state, outcome]
            self.log.note(
                "state",
                self.robot.now(),
                state=self.state.name,
                outcome=outcome,
                next=next_state.name,
            )
            self.state = next_state

    def tell(self, waiting: str = "", *, paused: bool = False) -> None:
        """Publish what the run does, or how it ended."""
        words = self.state.value
        if self._stage_cm:
            words += f" at {self._stage_cm:g} cm"
        words += f": {waiting}" if waiting else ""
        if self.state is State.DONE:
            self._done = 1.0
        elif self._ends_s > 0.0:  # what takes longer than expected is not over
            self._done = max(self._done, min(self.robot.elapsed_s / self._ends_s, 0.99))
        self.progress(words, self._done)
        self.live.tell(
            RunState, self.state.name, words, self._stage_cm, self._done, paused,
            self.document.outcome,
        )  # fmt: skip

    def _note_step(self, step: str, numbers: Mapping[str, object]) -> None:
        """Put a step of what the run knows into its record, for the replay."""
        self.log.note("step", self.robot.now(), step=step, numbers=dict(numbers))

    def _mind_the_robot(self) -> None:
        """Read what has come from the board during a fit.

        A fault and a viewer's stop end the fit; and a robot whose host reads nothing for 30 s is
        stopped (`link/port_process.py`), which a fit can take on a slow computer.
        """
        if not self.robot.virtual:
            self.robot.wait(0.0)

    def _note(self, **known: Any) -> None:
        self.document = replace(self.document, **known)

    def _pause(self) -> None:
        """Wait, vented, as long as a viewer wants."""
        if not self.control.paused:
            return
        self.robot.vent()
        self.tell("paused", paused=True)
        while self.control.paused:
            if self.robot.virtual:  # its time would rush by
                self.control.wait(_PAUSE_S)
            self.robot.wait(_PAUSE_S)

    # Before the first stage.

    def _short_of_the_map(self) -> Wiring:
        """The robot as it is planned for: it ends short of an obstacle that the map has ahead."""
        ahead = obstacle_ahead(self.prior, self.config.body.radius_cm)
        if ahead is None or not self.config.body.grows or ahead[1] >= self.config.body.length_cm:
            return self.wiring
        planned = short_of(self.config, ahead[1])
        text = (
            f"it ends at {planned.body.length_cm:.1f} cm, short of what the map has in its path at "
            f"x {ahead[0]:.1f} cm, so obstacles farther out are not felt"
        )
        self._note(skips="; ".join(filter(None, [self.document.skips, text])))
        return replace(self.wiring, config=planned)

    def _configure(self) -> str:
        if self.document.skips:
            self.live.tell(Log, "info", f"effort {self.document.effort}: {self.document.skips}")
        self.robot.configure(self.config)
        return "verified"

    def _confirm(self) -> str:
        if self.config.body.grows:
            self.live.tell(Log, "info", "the operator measures the everted length")
        self.length_cm = self.robot.measure_length()
        return "length known"

    def _arm(self) -> str:
        self.robot.arm()
        if self.protocol == "measure":
            self.robot.follow_settling()
        return "ready"

    # Each stage.

    def _plan(self) -> str:
        spent_s = self.robot.elapsed_s
        settles_s = self.robot.settles_s(self._base)
        behind = tuple(stage.everted_length_cm for stage in self._knowledge.stages)
        plan = self.planner.plan(self.length_cm, spent_s, behind, settles_s)
        expected_s = self.planner.expected_s(Plan(behind, plan.measurements))
        pace = spent_s / expected_s if behind else 1.0
        self._ends_s = spent_s + pace * self.planner.expected_s(plan, self.length_cm, settles_s)
        self._plan_ahead = plan
        if not plan.stops:
            longest_cm = self.planner.config.body.length_cm
            full = self.length_cm > longest_cm - SAME_LENGTH_CM
            if full and longest_cm < self.config.body.length_cm:
                self._note(outcome="peg ahead")
                return "peg ahead"
            self._note(outcome="full length" if full else f"time is up at {self.length_cm:.1f} cm")
            return "fully deployed" if full else "time is up"
        stage = plan.stops[0]
        grows = stage > self.length_cm + 0.1
        if grows and peg_ahead(self.document.contacts, self.length_cm, self.config.body.radius_cm):
            self._note(outcome="peg ahead")
            return "peg ahead"
        self._stage_cm, self._zero_tries = stage, 0
        self._start_cm = self.length_cm
        self._begin_growth()
        return "grow" if grows else "sweep here"

    def _pressurize(self) -> str:
        self._body_pressure = growth_body_pressure(self.config, self.length_cm, self._stage_cm)
        pressures = self.config.body.pressures
        raised = self._knowledge.raised
        planned_psi = pressures[self._body_pressure].pressure_psi
        if raised is not None and pressures[raised].pressure_psi > planned_psi:
            self._body_pressure = raised
        pressure = pressures[self._body_pressure].pressure_psi
        if self.protocol == "thesis" or pressure != self._body_psi:
            try:
                self._set_body_pressure(self._body_pressure)
            except DataError:
                if self._knowledge.tried is None:
                    raise
                self._knowledge.gives_up_trial()
                self._end_at_obstruction()
                return "stalled, nobody to ask"
        else:
            self.robot.select_body_pressure(self._body_pressure)
        return "pressure set"

    def _set_body_pressure(self, body_pressure: int) -> None:
        """Ask for a body pressure, and tell the board which it is.

        Raises DataError if nobody is there to set it.
        """
        pressure = self.config.body.pressures[body_pressure].pressure_psi
        if pressure:
            self.live.tell(Log, "info", f"the operator sets the body pressure to {pressure:g} psi")
        self.robot.pressurize(body_pressure)
        self._body_psi = pressure

    def _grow(self) -> str:
        target = growth_target(self.config, self.length_cm, self._stage_cm)
        if target > self.length_cm + 0.1:
            self.length_cm = self.robot.grow_to(target, self._growth)
            grown = self._grown()
            zeros = self.robot.zeros()
            if self._knowledge.stall(grown, zeros) is not None:
                self._knowledge.growth_stalled(grown, zeros)
                return "no eversion"
            whole = [length_cm for length_cm in stage_lengths(self.config) if length_cm >= target]
            if not self._knowledge.stages and self._knowledge.leans(grown):
                self._stage_cm = whole[0]  # what it leans on is passed no farther
            elif target < self._stage_cm and target == whole[0]:
                self._start_cm = target
            if self._knowledge.tried is not None and target == self._stage_cm:
                self._knowledge.moved_on()
                self._note(stall=self._interpreter.map.stall)
        return "whole pitch" if target == self._stage_cm else "pressure boundary"

    def _begin_growth(self) -> None:
        self._knowledge.growth_begins()
        self._growth = GrowthWatcher(strains=self.robot.strains)

    def _grown(self) -> Profile:
        """Lengths of the stage's growth, and what the sensors read at each."""
        return self._growth.profile(SensorTable.laid_out(self.wiring, self.robot.oversample))

    def _back_off(self) -> str:
        """Wind in until the tip is clear of what stopped or bent it.

        There every sensor is where the encoder says. The encoder shows a tip that was stopped; only
        the sensors show a body that is held bent, so they are asked again.
        """
        obstruction, truth = self._knowledge.obstruction, self.robot.truth()
        assert obstruction is not None
        held_bent = isinstance(obstruction, HeldBent)
        if truth is not None:
            ahead = (
                truth.contacts if held_bent else true_obstruction(truth, obstruction, self.config)
            )
            self._note(truth=together([self.document.truth, Truth(truth.pegs, ahead)]))
        if self._knowledge.hangs:
            self.live.tell(Log, "info", _HANGS)
        clear_cm = obstruction.clear_cm if isinstance(obstruction, HeldBent) else self._start_cm
        retraction = self.robot.retract_to(min(self._start_cm, clear_cm))
        self.length_cm = retraction.length_cm
        self.live.tell(Log, "warning" if retraction.late else "info", retraction.words)
        if held_bent:
            return "clear of what held it"
        higher = trial_body_pressure(self.config, self._body_pressure)
        if self._knowledge.tried is None and higher is not None:
            self._knowledge.tries_more_pressure(body_pressure=higher)
            self._begin_growth()
            self.live.tell(Log, "info", "growth stalled: it is tried at a higher body pressure")
            return "stalled: more pressure"
        self._end_at_obstruction()
        return "stalled"

    def _end_at_obstruction(self) -> None:
        stalled = self._knowledge.ended_at_obstruction()
        self._note(outcome="peg ahead" if stalled is None else stalled.words)
        self._judge()

    def _settle(self) -> str:
        thesis = self.protocol == "thesis"
        # Sensors that have just everted are not needed to feel a contact, only to measure it.
        self.robot.wait_settled(
            lambda rest_s: self.tell(f"{rest_s:.0f} s to go"), -1 if thesis else self._base
        )
        if not thesis:
            status = self.robot.status()
            self.robot.set_aside(status.everted & ~status.settled)
        return "settled"

    def _zero(self) -> str:
        if not self._zeroed():
            return "drifting"
        if isinstance(self._knowledge.obstruction, HeldBent):
            return self._released()
        if self._knowledge.swept(self.length_cm):
            return "zeroed after sweep"
        if self._stage_cm > self._knowledge.straight_cm:
            grown, zeros = self._grown(), self.robot.zeros()
            if self._knowledge.detect_held_bent(grown, zeros) is not None:
                self._knowledge.held_bent(grown, zeros)
                return "held bent"
        return "zeroed after growth"

    def _released(self) -> str:
        """Whether the body was held bent, now that its tip is clear.

        A peg that bent the growth aside goes on the map; one that a sweep slipped past stands
        beside the path of growth.
        """
        if self._knowledge.released(self.robot.zeros()):
            if self._knowledge.hangs:
                self._knowledge.let_go()
                return "straight again: grown once more"
            self._end_at_obstruction()
            return "straight again: peg ahead"
        self._knowledge.zeros_moved()
        return "as before: the zeros moved"

    def _zeroed(self) -> bool:
        """Zero the sensors; False after a pause if they drift."""
        try:
            self.robot.zero()
        except CommandRefusedError as error:
            self._zero_tries += 1
            if error.reason not in ("drifting", "not_settled") or (
                self._zero_tries > _MOST_ZERO_TRIES
            ):
                raise
            self.robot.wait(2.0)
            return False
        return True

    def _sweep(self) -> str:
        thesis = self.protocol == "thesis"
        period_s = sweep_period_s if thesis else rising_period_s
        self._measurements = 0
        looked = self.robot.sweep(
            {
                muscle.name: muscle.max_pressure_psi
                for muscle in self.config.muscles
                if muscle not in self.wiring.unguarded_muscles
            },
            period_s=period_s(self.config, self._body_pressure),
            rising_only=not thesis,
            enough=None if thesis else self._enough,
        )
        self._knowledge.has_looked(looked, body_pressure=self._body_pressure)
        looked = self._knowledge.looked
        touched = self._interpreter.felt_sides(looked)
        if thesis:
            return "contact, thesis protocol" if touched else "no contact"
        placed = self._interpreter.placed_sides(looked)
        self._unplaced = (touched | self._interpreter.unsure_sides(looked)) - placed
        measures = self.planner.measures(self._plan_ahead, self._stage_cm, self.robot.elapsed_s)
        if self._unplaced and measures and not self._interpreter.hangs(looked):
            return "contact"
        return "contact, and its place" if touched else "no contact"

    def _enough(self, so_far: SweepResult) -> bool:
        """Whether a side's sweep can stop, because the base is near its fold."""
        held = held_now(so_far.frames, so_far.peaks[-1].side)
        if held > TRIGGER_PER_CM:
            self.live.sweeping(self._interpreter, so_far, self._body_pressure, self.length_cm)
        return pressed_enough(held, self.config, self._body_pressure)

    def _measured_enough(self, so_far: SweepResult) -> bool:
        """Whether a measurement at a raised body pressure can stop: the base is near its fold."""
        body_pressure = self._measured_body_pressure
        self.live.sweeping(self._interpreter, so_far, body_pressure, self.length_cm)
        held = held_now(so_far.frames, so_far.peaks[-1].side)
        return body_pressure != self._body_pressure and pressed_enough(
            held, self.config, body_pressure
        )

    def _rest(self) -> str:
        """Let the young sensors stand still until what they rest at is known well enough."""
        aside = self.robot.aside
        if not aside:
            return "every sensor known"
        self.robot.vent()
        noise, young = self._table.noise, in_mask(aside)
        enough = self.planner.effort.rest_noise * noise[young]
        if (self.robot.young_noise()[young] <= enough).all():
            return "every sensor known"
        if aside & ~self.robot.status().settled:
            self.robot.wait(_STAND_S)
            return "young"
        self.robot.set_aside(0)  # settled meanwhile: zeroed like any other
        if not self._zeroed():
            self.robot.set_aside(aside)
            return "young"
        return "every sensor known"

    def _press(self) -> str:
        """Raise the body pressure if contacts can be pressed harder with it."""
        self._measured_body_pressure = self._body_pressure
        body_pressure = pressing_body_pressure(
            self._knowledge.looked.frames, self._unplaced, self.config, self._body_pressure
        )
        if body_pressure == self._body_pressure or not self.planner.raises(self._stage_cm):
            return "pressure as it is"
        self.robot.vent()
        try:
            self._set_body_pressure(body_pressure)
        except DataError:
            return "nobody to ask"
        self._measured_body_pressure = body_pressure
        return "pressure set"

    def _measure(self) -> str:
        frames, body_pressure = self._knowledge.looked.frames, self._measured_body_pressure
        tops: dict[str | float, float] = {
            muscle.name: measuring_pressure(frames, muscle.side, self.config, body_pressure)
            if body_pressure == self._body_pressure
            else muscle.max_pressure_psi
            for muscle in self.config.muscles
            if muscle.side in self._unplaced
        }
        self.robot.vent()
        measured = self.robot.sweep(
            tops,
            period_s=sweep_period_s(self.config, body_pressure, top_psi=max(tops.values())),
            rising_only=True,
            enough=self._measured_enough,
        )
        self._measurements += 1
        self._knowledge.has_measured(measured, body_pressure=body_pressure)
        again = self._measurements < self._plan_ahead.measurements
        return "once more" if again else "measured"

    def _localize(self) -> str:
        answers = self._knowledge.localized()
        for answer in answers:
            self.live.posterior(self.length_cm, answer)
        if not answers:
            nothing = "nothing was felt at this stage"
            self.live.tell(Posterior, "", self.length_cm, (), (), "no contact", "", nothing)
        return "contact" if answers else "none"

    def _map(self) -> str:
        self._knowledge.mapped()
        self._note(contacts=self._interpreter.map.contacts)
        self.live.tell(Contacts, tuple(self.document.contacts))
        return "mapped"

    def _vent(self) -> str:
        self.robot.vent()
        truth = self._truth()
        self._knowledge.ended(t_s=self.robot.now(), length_cm=self.length_cm)
        self._note(stages=list(self._knowledge.stages), truth=truth)
        self._judge()
        return "vented, thesis protocol" if self.protocol == "thesis" else "vented"

    def _truth(self) -> Truth | None:
        """The room's truth so far, with each side's contacts when it was measured."""
        looked, measured = self._knowledge.looked.truth, self._knowledge.measured
        if looked is None:
            return self.document.truth
        sides = {peak.side for peak in measured.peaks} if measured else set()
        first = Truth(looked.pegs, [c for c in looked.contacts if c.side not in sides])
        return together([self.document.truth, first, measured.truth if measured else None])

    def _judge(self) -> None:
        """Say what is known of the contacts felt so far, and put it on the disk."""
        self.document = self._interpreter.judged(self.document)
        self.keep()

    def keep(self) -> None:
        """Put what is known on the disk and tell it: contacts.json, obstacles.json and the grid."""
        self.folder.write_document(self.document)
        radius_cm = self.config.body.radius_cm
        export_obstacles(self.folder, self.document, radius_cm=radius_cm, prior=self.prior)
        self.live.tell(Contacts, tuple(self.document.contacts))
        self.live.tell(partial(Grid.of, read_ros_map(self.folder.path / "map.yaml")))

    # The end.

    def _finish(self) -> str:
        if (stalled := self.document.stall) is not None:  # a later bend may have shown its cause
            self.live.tell(Log, "info", stalled.words)
        self.robot.disarm()
        self.restore()
        return "safe"

    def restore(self) -> None:
        """Leave the board with every healthy sensor in use, as robot.toml says."""
        self.robot.set_aside(0)
