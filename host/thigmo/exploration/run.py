"""The exploration itself: walks the state table with a robot, and leaves a run folder.

One method for each state, returning the outcome that the table names. Whatever happens (an error,
Ctrl-C, a termination signal, a pulled cable), the robot is left vented and braked and the run
folder is closed and readable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import CommandRefusedError
from thigmo.exploration.feel import Feeling
from thigmo.exploration.live import Live, RunControl
from thigmo.exploration.map import peg_ahead
from thigmo.exploration.measuring import held_now, held_sides, measuring_pressure, pressed_enough
from thigmo.exploration.met import Lean, Met, lean, stall
from thigmo.exploration.missed import met_ahead
from thigmo.exploration.obstacles import export_obstacles
from thigmo.exploration.plan import (
    growth_target,
    growth_zone,
    next_stage,
    stage_lengths,
    trial_zone,
)
from thigmo.exploration.stage import Interpreter
from thigmo.exploration.states import NEXT, State
from thigmo.record import LogWriter, Obstacle, RunDocument, RunFolder, Truth, read_ros_map
from thigmo.robot import (
    SENSORS,
    TRIGGER_PER_CM,
    GrowthWatcher,
    Robot,
    SensorTable,
    SweepResult,
    in_mask,
    rising_period_s,
    sweep_period_s,
)
from thigmo.robot.readings import Floats
from thigmo.robot.state import together
from thigmo.stream import Contacts, Grid, Log, Posterior, RunState

_MOST_ZERO_TRIES = 5
_BASE = 1 | 1 << SENSORS // 2  # the first sensor of each side: what the trigger works on

# A young sensor counts once its rest is known to so many times its noise.
_YOUNG_NOISE = 1.0
_STAND_S = 0.5  # between two looks at that
_PAUSE_S = 0.1

# "measure" sweeps a side with a contact again, to the pressure at which it is felt best; "thesis"
# takes the readings at the full sweep's peak.
Protocol = Literal["measure", "thesis"]
# Told what the robot does, in words, and the share of the run that is done.
Progress = Callable[[str, float], None]


@dataclass
class Exploration:
    """Drives one robot through the state table."""

    robot: Robot  # connected, not yet configured
    config: RobotConfig  # robot.toml
    folder: RunFolder  # made
    log: LogWriter  # its record, open
    # what is known at the start; kept up to date, and written after each stage
    document: RunDocument
    progress: Progress  # called at each state and while waiting
    protocol: Protocol = "measure"  # how a contact is measured
    prior: Sequence[Obstacle] = ()  # obstacles of a map of the room
    control: RunControl = field(default_factory=RunControl)  # whether viewers want it to wait
    state: State = State.CONFIGURE
    length_cm: float = 0.0  # everted length
    _stage_cm: float = 0.0
    _start_cm: float = 0.0  # length at which the stage's growth began
    _straight_cm: float = 0.0  # up to this length the body is known not to be held bent
    _zone: int = 0
    _body_psi: float | None = None  # what the operator last set
    _swept: bool = False
    _looked: SweepResult = field(default_factory=SweepResult)  # for contacts
    _measured: SweepResult | None = None
    _feelings: list[Feeling] = field(default_factory=list)
    _known: set[Side] = field(default_factory=set)  # of contacts that the first sweep has placed
    _growth: GrowthWatcher = field(default_factory=GrowthWatcher)
    _met: Met | None = None  # by growth, and not yet on the map
    _zero_tries: int = 0
    _raised: int | None = None  # zone whose pressure growth has needed since it stalled
    _tried: Met | None = None  # the stall that is tried again at that pressure

    def __post_init__(self) -> None:
        self.live = Live(self.robot)
        self._found = Interpreter(self.config, self.prior, self.document.method)
        self._table = SensorTable.of(self.config)
        self._whole_cm = sum(stage_lengths(self.config))

    def run(self) -> None:
        """Walk the table to its end; each state has the method of its name.

        Raises ThigmoError if robot, link or operator stopped it; the document says where.
        """
        while self.state is not State.DONE:
            if self.state is State.PLAN:
                self._pause()
            self.tell()
            outcome: str = getattr(self, f"_{self.state.name.lower()}")()
            after = NEXT[self.state, outcome]
            self.log.note(
                "state", self.robot.now(), state=self.state.name, outcome=outcome, next=after.name
            )
            self.state = after

    def tell(self, waiting: str = "", *, paused: bool = False) -> None:
        """Tell those who watch what it does, or how it ended."""
        words = self.state.value
        if self._stage_cm:
            words += f" at {self._stage_cm:g} cm"
        words += f": {waiting}" if waiting else ""
        done = sum(stage.everted_length_cm for stage in self.document.stages) / self._whole_cm
        self.progress(words, done)
        outcome = self.document.outcome
        self.live.tell(RunState, self.state.name, words, self._stage_cm, done, paused, outcome)

    def _note(self, **known: Any) -> None:
        """Keep in the document what is known now."""
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

    def _configure(self) -> str:
        self.robot.configure(self.config)
        return "verified"

    def _confirm(self) -> str:
        self.live.tell(Log, "info", "the operator measures the everted length")
        self.length_cm = self.robot.operator.everted_length_cm()
        self.robot.confirm_length(self.length_cm)
        return "length known"

    def _arm(self) -> str:
        self.robot.arm()
        if self.protocol == "measure":
            self.robot.follow_settling()
        return "ready"

    # Each stage.

    def _plan(self) -> str:
        stage = next_stage(self.config, self.length_cm, swept=self._swept)
        if stage is None:
            self._note(outcome="full length")
            return "fully deployed"
        grows = stage > self.length_cm + 0.1
        if grows and peg_ahead(self.document.contacts, self.length_cm, self.config.body.radius_cm):
            self._note(outcome="peg ahead")
            return "peg ahead"
        self._stage_cm, self._swept, self._zero_tries = stage, False, 0
        self._start_cm, self._growth = self.length_cm, GrowthWatcher()
        return "grow" if grows else "sweep here"

    def _pressurize(self) -> str:
        self._zone = growth_zone(self.config, self.length_cm, self._stage_cm)
        zones = self.config.body.zones
        if self._raised is not None and (
            zones[self._raised].pressure_psi > zones[self._zone].pressure_psi
        ):
            self._zone = self._raised
        pressure = self.config.body.zones[self._zone].pressure_psi
        if self.protocol == "thesis" or pressure != self._body_psi:
            self.live.tell(Log, "info", f"the operator sets the body pressure to {pressure:g} psi")
            self.robot.operator.set_body_pressure(pressure)
            self._body_psi = pressure
        self.robot.select_zone(self._zone)
        return "pressure set"

    def _grow(self) -> str:
        target = growth_target(self.config, self.length_cm, self._stage_cm)
        if target > self.length_cm + 0.1:
            self.length_cm = self.robot.grow_to(target, self._growth)
            self._met = stall(*self._grown(), self._table)
            if self._met is not None:
                return "no eversion"
            if self._tried is not None and target == self._stage_cm:
                self._found.map.tried(self._tried, moved_on=True)
                self._note(stall=self._found.map.stall)
                self._tried = None
        return "whole pitch" if target == self._stage_cm else "pressure boundary"

    def _grown(self) -> tuple[Floats, Floats]:
        """Lengths of the stage's growth, and what the sensors read at each."""
        return self._growth.profile(SensorTable.of(self.config, self.robot.oversample))

    def _back_off(self) -> str:
        """Wind in until the tip is clear of what stopped or bent it.

        There every sensor is where the encoder says. A tip that was stopped is told by the encoder,
        and a body that is held bent by sensors only: those are asked again.
        """
        met, truth = self._met, self.robot.truth()
        assert met is not None
        leaning = isinstance(met, Lean)
        if truth is not None:
            ahead = truth.contacts if leaning else met_ahead(truth.pegs, met, self.config)
            self._note(truth=together([self.document.truth, Truth(truth.pegs, ahead)]))
        clear_cm = met.clear_cm if isinstance(met, Lean) else self._start_cm
        self.length_cm = self.robot.retract_to(min(self._start_cm, clear_cm))
        if leaning:
            return "clear of what held it"
        if self._tried is None and (higher := trial_zone(self.config, self._zone)) is not None:
            self._raised, self._tried, self._growth = higher, met, GrowthWatcher()
            self._met = None
            self.live.tell(Log, "info", "growth stalled: it is tried at a higher body pressure")
            return "stalled: more pressure"
        self._end_at(met)
        return "stalled"

    def _end_at(self, met: Met) -> None:
        if self._tried is None or isinstance(met, Lean):
            self._found.map.add_met(met)
        else:
            self._found.map.tried(met, moved_on=False)
        stalled = None if isinstance(met, Lean) else self._found.map.stall
        self._note(outcome="peg ahead" if stalled is None else stalled.words)
        self._judge()

    def _settle(self) -> str:
        thesis = self.protocol == "thesis"
        # Sensors that have just everted are not needed to feel a contact, only to measure it.
        needed = (1 << SENSORS) - 1 if thesis else _BASE
        self.robot.wait_settled(lambda left_s: self.tell(f"{left_s:.0f} s left"), needed)
        if not thesis:
            status = self.robot.status()
            self.robot.set_aside(status.everted & ~status.settled)
        return "settled"

    def _zero(self) -> str:
        if not self._zeroed():
            return "drifting"
        if isinstance(self._met, Lean):
            return self._released(self._met)
        if self._swept:
            return "zeroed after sweep"
        if self._stage_cm > self._straight_cm:
            self._met = lean(*self._grown(), *self.robot.zeros(), self._table)
        return "zeroed after growth" if self._met is None else "held bent"

    def _released(self, held: Lean) -> str:
        """Whether the body was held bent, now that its tip is clear; the peg goes on the map."""
        self._met = None
        if held.released(*self.robot.zeros()):
            self._end_at(held)
            return "straight again: peg ahead"
        self._swept, self._straight_cm = True, held.length_cm
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
        self._known = set()
        self._looked = self.robot.sweep(
            left_psi=self.config.actuators.left.max_pressure_psi,
            right_psi=self.config.actuators.right.max_pressure_psi,
            period_s=period_s(self.config, self._zone),
            rising_only=not thesis,
            enough=None if thesis else self._enough,
        )
        self._swept, self._measured = True, None
        fired = held_sides(self._looked)
        if not fired:
            return "no contact"
        if thesis:
            return "contact, thesis protocol"
        return "contact" if fired - self._known else "contact, and its place"

    def _enough(self, so_far: SweepResult) -> bool:
        """Whether a side's sweep can stop: its contact's place is known, or the base near its fold.

        The latter is measured again, slowly, with every sensor.
        """
        side = so_far.peaks[-1].side
        held = held_now(so_far.frames, side)
        if held <= TRIGGER_PER_CM:
            return False
        feeling = self._found.so_far(so_far, self._zone)
        if feeling is not None and self.live.due:
            self.live.feels(self.length_cm, feeling, sweeping=True)
        if feeling is None or not self._found.placed(feeling):
            return pressed_enough(held, self.config, self._zone)
        self._known.add(side)
        return True

    def _tell_feeling(self, so_far: SweepResult) -> bool:
        """Tell viewers what a measurement feels so far; it goes on to its end."""
        if self.live.due and (feeling := self._found.so_far(so_far, self._zone)) is not None:
            self.live.feels(self.length_cm, feeling, sweeping=True)
        return False

    def _rest(self) -> str:
        """Let the young sensors stand still until what they rest at is known well enough."""
        aside = self.robot.aside
        if not aside:
            return "every sensor known"
        self.robot.vent()
        noise, young = self._table.noise, in_mask(aside)
        if (self.robot.young_noise()[young] <= _YOUNG_NOISE * noise[young]).all():
            return "every sensor known"
        if aside & ~self.robot.status().settled:
            self.robot.wait(_STAND_S)
            return "young"
        self.robot.set_aside(0)  # settled meanwhile: zeroed like any other
        if not self._zeroed():
            self.robot.set_aside(aside)
            return "young"
        return "every sensor known"

    def _measure(self) -> str:
        fired = held_sides(self._looked) - self._known
        frames = self._looked.frames
        left, right = (
            measuring_pressure(frames, side, self.config, self._zone) if side in fired else 0.0
            for side in SIDES
        )
        self.robot.vent()
        self._measured = self.robot.sweep(
            left_psi=left,
            right_psi=right,
            period_s=sweep_period_s(self.config, self._zone, top_psi=max(left, right)),
            rising_only=True,
            enough=self._tell_feeling,
        )
        return "measured"

    def _localize(self) -> str:
        self._feelings = self._found.feel(self._looked, self._measured, self._zone)
        for feeling in self._feelings:
            self.live.feels(self.length_cm, feeling)
        if not self._feelings:
            nothing = "nothing was felt at this stage"
            self.live.tell(Posterior, "", self.length_cm, (), (), "no contact", "", nothing)
        return "contact" if any(feeling.felt for feeling in self._feelings) else "none"

    def _map(self) -> str:
        self._found.add(self._feelings)
        self._note(contacts=self._found.map.contacts)
        self.live.tell(Contacts, tuple(self.document.contacts))
        return "mapped"

    def _vent(self) -> str:
        self.robot.vent()
        stage = self._found.entry(
            self.robot.now(), self.length_cm, self._looked, self._feelings, self._zone
        )
        self._note(stages=[*self.document.stages, stage], truth=self._truth())
        self._judge()
        return "vented, thesis protocol" if self.protocol == "thesis" else "vented"

    def _truth(self) -> Truth | None:
        """The room's truth so far, with each side's contacts when it was measured."""
        looked, measured = self._looked.truth, self._measured
        if looked is None:
            return self.document.truth
        sides = {peak.side for peak in measured.peaks} if measured else set()
        first = Truth(looked.pegs, [c for c in looked.contacts if c.side not in sides])
        return together([self.document.truth, first, measured.truth if measured else None])

    def _judge(self) -> None:
        """Say what is known of the contacts felt so far, and put it on the disk."""
        self.document = self._found.judged(self.document)
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
        self.robot.disarm()
        self.restore()
        return "safe"

    def restore(self) -> None:
        """Leave the board with every healthy sensor in use, as robot.toml says."""
        self.robot.set_aside(0)
