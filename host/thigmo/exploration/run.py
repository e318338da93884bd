"""The exploration itself: walks the state table with a robot, and leaves a run folder.

One method for each state, returning the outcome that the table names. Whatever happens (an error,
Ctrl-C, a termination signal, a pulled cable), the robot is left vented and braked and the run
folder is closed and readable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import CommandRefusedError
from thigmo.exploration.deflection import Deflection, deflection
from thigmo.exploration.eversion import Stall, stall
from thigmo.exploration.feel import Feeling
from thigmo.exploration.live import Live, RunControl
from thigmo.exploration.map import ContactMap, peg_ahead
from thigmo.exploration.measuring import (
    held_now,
    held_sides,
    measuring_pressure,
    pressed_enough,
)
from thigmo.exploration.missed import judged, met_ahead
from thigmo.exploration.obstacles import export_obstacles
from thigmo.exploration.plan import growth_target, growth_zone, next_stage, stage_lengths
from thigmo.exploration.prior import PriorMap
from thigmo.exploration.stage import Interpreter, placed, stage_entry
from thigmo.exploration.states import State, next_state
from thigmo.record import LogWriter, RunDocument, RunFolder, Truth, read_ros_map
from thigmo.robot import (
    SENSORS,
    TRIGGER_PER_CM,
    GrowthWatcher,
    Robot,
    SensorTable,
    SweepResult,
    rising_period_s,
    sweep_period_s,
)
from thigmo.robot.readings import Floats

_MOST_ZERO_TRIES = 5
_ALL = (1 << SENSORS) - 1
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


class Exploration:
    """Drives one robot through the state table.

    Args:
        robot: connected, not yet configured.
        config: robot.toml.
        folder: the run folder, made.
        log: its record, open.
        document: what is known at the start; kept up to date, and written after each stage.
        progress: called at each state and while waiting.
        protocol: how a contact is measured.
        prior: a map of the room.
        control: whether viewers want it to wait.
    """

    def __init__(
        self,
        robot: Robot,
        config: RobotConfig,
        folder: RunFolder,
        log: LogWriter,
        document: RunDocument,
        progress: Progress,
        protocol: Protocol = "measure",
        prior: PriorMap | None = None,
        control: RunControl | None = None,
    ) -> None:
        self.robot = robot
        self.live = Live(robot)
        self.control = control or RunControl()
        self.config = config
        self.folder = folder
        self.log = log
        self.document = document
        self.progress = progress
        self.state = State.CONFIGURE
        self.length_cm = 0.0
        self.stage_cm = 0.0
        self.zone = 0
        self.body_psi: float | None = None  # what the operator last set
        self.swept = False
        self.protocol = protocol
        self.prior = prior
        self.interpreter = Interpreter(config, prior)
        self.map = ContactMap(config, prior)
        self.sweep: SweepResult | None = None
        self.measuring: SweepResult | None = None
        self.feelings: list[Feeling] = []
        self._start_cm = 0.0  # length at which the stage's growth began
        self._growth = GrowthWatcher()
        self._stall: Stall | None = None
        self._deflection: Deflection | None = None
        self._straight_cm = 0.0  # up to this length the body is known not to be held bent
        self._known: set[Side] = set()  # sides whose contact the sweep that found it has placed
        self._zero_tries = 0
        self._lengths = stage_lengths(config)
        self._actions: dict[State, Callable[[], str]] = {
            State.CONFIGURE: self._configure,
            State.CONFIRM: self._confirm,
            State.ARM: self._arm,
            State.PLAN: self._plan,
            State.PRESSURIZE: self._pressurize,
            State.GROW: self._grow,
            State.BACK_OFF: self._back_off,
            State.SETTLE: self._settle,
            State.ZERO: self._zero,
            State.SWEEP: self._sweep,
            State.REST: self._rest,
            State.MEASURE: self._measure,
            State.LOCALIZE: self._localize,
            State.MAP: self._map,
            State.VENT: self._vent,
            State.FINISH: self._finish,
        }

    def run(self) -> None:
        """Walk the table to its end.

        Raises:
            ThigmoError: the robot, the link or the operator stopped it; the document says where.
        """
        while self.state is not State.DONE:
            if self.state is State.PLAN:
                self._pause()
            self._tell()
            outcome = self._actions[self.state]()
            after = next_state(self.state, outcome)
            self.log.note(
                "state", self.robot.now(), state=self.state.name, outcome=outcome, next=after.name
            )
            self.state = after

    def _tell(self, waiting: str = "", *, paused: bool = False) -> None:
        words = self.state.value
        if self.stage_cm:
            words += f" at {self.stage_cm:g} cm"
        words += f": {waiting}" if waiting else ""
        done = sum(stage.everted_length_cm for stage in self.document.stages) / sum(self._lengths)
        self.progress(words, done)
        self.live.state(
            self.state, words, self.stage_cm, done, paused=paused, outcome=self.document.outcome
        )

    def _pause(self) -> None:
        """Wait, vented, as long as a viewer wants."""
        if not self.control.paused:
            return
        self.robot.vent()
        self._tell("paused", paused=True)
        while self.control.paused:
            if self.robot.virtual:  # its time would rush by
                self.control.wait(_PAUSE_S)
            self.robot.wait(_PAUSE_S)

    # Before the first stage.

    def _configure(self) -> str:
        self.robot.configure(self.config)
        return "verified"

    def _confirm(self) -> str:
        self.live.log("the operator measures the everted length")
        length = self.robot.operator.everted_length_cm()
        self.robot.confirm_length(length)
        self.length_cm = length
        return "length known"

    def _arm(self) -> str:
        self.robot.arm()
        if self.protocol == "measure":
            self.robot.follow_settling()
        return "ready"

    # Each stage.

    def _plan(self) -> str:
        stage = next_stage(self.config, self.length_cm, swept=self.swept)
        if stage is None:
            self.document = replace(self.document, outcome="full length")
            return "fully deployed"
        grows = stage > self.length_cm + 0.1
        radius = self.config.body.radius_cm
        if grows and peg_ahead(self.document.contacts, self.length_cm, radius):
            self.document = replace(self.document, outcome="peg ahead")
            return "peg ahead"
        self.stage_cm, self.swept, self._zero_tries = stage, False, 0
        self._start_cm, self._growth = self.length_cm, GrowthWatcher()
        return "grow" if grows else "sweep here"

    def _pressurize(self) -> str:
        self.zone = growth_zone(self.config, self.length_cm, self.stage_cm)
        pressure = self.config.body.zones[self.zone].pressure_psi
        if self.protocol == "thesis" or pressure != self.body_psi:
            self.live.log(f"the operator sets the body pressure to {pressure:g} psi")
            self.robot.operator.set_body_pressure(pressure)
            self.body_psi = pressure
        self.robot.select_zone(self.zone)
        return "pressure set"

    def _grow(self) -> str:
        target = growth_target(self.config, self.length_cm, self.stage_cm)
        if target > self.length_cm + 0.1:
            self.length_cm = self.robot.grow_to(target, self._growth)
            self._stall = stall(*self._grown(), SensorTable.of(self.config))
            if self._stall is not None:
                return "no eversion"
        return "whole pitch" if target == self.stage_cm else "pressure boundary"

    def _grown(self) -> tuple[Floats, Floats]:
        """Lengths of the stage's growth, and what the sensors read at each."""
        return self._growth.profile(SensorTable.of(self.config), self.robot.oversample)

    def _back_off(self) -> str:
        """Wind in until the tip is clear of what stopped or bent it.

        There every sensor is where the encoder says. A tip that was stopped is told by the encoder,
        and a body that is held bent by sensors only: those are asked again.
        """
        truth = self.robot.truth()
        if truth is not None:
            known = self.document.truth.contacts if self.document.truth else []
            met = met_ahead(truth.pegs, self._stall.tip_cm) if self._stall else truth.contacts
            self.document = replace(self.document, truth=Truth(truth.pegs, [*known, *met]))
        clear = min(self._start_cm, self._deflection.clear_cm if self._deflection else math.inf)
        self.length_cm = self.robot.retract_to(clear)
        if self._deflection is not None:
            return "clear of what held it"
        if self._stall is not None:
            self.map.add_ahead(self._stall)
        self._end_at_peg()
        return "peg ahead"

    def _end_at_peg(self) -> None:
        self.document = replace(self.document, outcome="peg ahead")
        self._judge()

    def _settle(self) -> str:
        if self.protocol == "thesis":
            self._wait_settled()
            return "settled"
        # Sensors that have just everted are not needed to feel a contact, only to measure it.
        self._wait_settled(_BASE)
        status = self.robot.status()
        self.robot.set_aside(status.everted & ~status.settled)
        return "settled"

    def _wait_settled(self, sensors: int = _ALL) -> None:
        self.robot.wait_settled(lambda left_s: self._tell(f"{left_s:.0f} s left"), sensors)

    def _zero(self) -> str:
        if not self._zeroed():
            return "drifting"
        if self._deflection is not None:
            return self._released(self._deflection)
        if self.swept:
            return "zeroed after sweep"
        if self.stage_cm > self._straight_cm:
            table = SensorTable.of(self.config)
            self._deflection = deflection(*self._grown(), *self.robot.zeros(), table)
        return "zeroed after growth" if self._deflection is None else "held bent"

    def _released(self, held: Deflection) -> str:
        """Whether the body was held bent, now that its tip is clear; the peg goes on the map."""
        self._deflection = None
        if held.released(*self.robot.zeros()):
            self.map.add_leaning(held)
            self._end_at_peg()
            return "straight again: peg ahead"
        self.swept, self._straight_cm = True, held.length_cm
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
        actuators = self.config.actuators
        thesis = self.protocol == "thesis"
        self._known = set()
        self.sweep = self.robot.sweep(
            left_psi=actuators.left.max_pressure_psi,
            right_psi=actuators.right.max_pressure_psi,
            period_s=sweep_period_s(self.config, self.zone)
            if thesis
            else rising_period_s(self.config, self.zone),
            rising_only=not thesis,
            enough=None if thesis else self._enough,
        )
        self.swept = True
        self.measuring = None
        fired = held_sides(self.sweep)
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
        feeling = self.interpreter.so_far(so_far, self.zone)
        if feeling is not None and self.live.due:
            self.live.feels(self.length_cm, feeling, sweeping=True)
        if feeling is not None and placed(feeling):
            self._known.add(side)
            return True
        return pressed_enough(held, self.config, self.zone)

    def _tell_feeling(self, so_far: SweepResult) -> bool:
        """Tell viewers what a measurement feels so far; it goes on to its end."""
        if self.live.due and (feeling := self.interpreter.so_far(so_far, self.zone)) is not None:
            self.live.feels(self.length_cm, feeling, sweeping=True)
        return False

    def _rest(self) -> str:
        """Let the young sensors stand still until what they rest at is known well enough."""
        aside = self.robot.aside
        if not aside:
            return "every sensor known"
        self.robot.vent()
        noise = SensorTable.of(self.config).noise
        young = [n for n in range(SENSORS) if aside >> n & 1]
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
        assert self.sweep is not None
        fired = held_sides(self.sweep) - self._known
        left, right = (
            measuring_pressure(self.sweep.frames, side, self.config, self.zone)
            if side in fired
            else 0.0
            for side in SIDES
        )
        self.robot.vent()
        self.measuring = self.robot.sweep(
            left_psi=left,
            right_psi=right,
            period_s=sweep_period_s(self.config, self.zone, top_psi=max(left, right)),
            rising_only=True,
            enough=self._tell_feeling,
        )
        return "measured"

    def _localize(self) -> str:
        assert self.sweep is not None
        self.feelings = self.interpreter.feel(self.sweep, self.measuring, self.zone)
        self.live.felt(self.length_cm, self.feelings)
        return "contact" if any(f.felt for f in self.feelings) else "none"

    def _map(self) -> str:
        for feeling in self.feelings:
            for felt in feeling.felt:
                self.map.add(felt)
        self.document = replace(self.document, contacts=self.map.contacts)
        self.live.contacts(self.document.contacts)
        return "mapped"

    def _vent(self) -> str:
        self.robot.vent()
        self._keep_stage()
        return "vented, thesis protocol" if self.protocol == "thesis" else "vented"

    def _keep_stage(self) -> None:
        """Put the stage into the document, and the document on the disk."""
        assert self.sweep is not None
        stage = stage_entry(
            self.length_cm, self.robot.now(), self.sweep, self.feelings, self.config, self.zone
        )
        self.document = replace(
            self.document, stages=[*self.document.stages, stage], truth=self._truth()
        )
        self._judge()

    def _judge(self) -> None:
        """Say what is known of the contacts felt so far, and put it on the disk."""
        document = replace(self.document, contacts=self.map.contacts)
        self.document = judged(document, self.config, self.prior)
        self.keep()

    def _truth(self) -> Truth | None:
        """The room's truth so far, with each side's contacts when it was measured."""
        assert self.sweep is not None
        if self.sweep.truth is None:
            return self.document.truth
        known = self.document.truth.contacts if self.document.truth else []
        again = self.measuring.truth if self.measuring else None
        sides = {peak.side for peak in self.measuring.peaks} if self.measuring else set()
        looked = [c for c in self.sweep.truth.contacts if c.side not in sides]
        measured = again.contacts if again else []
        return Truth(self.sweep.truth.pegs, [*known, *looked, *measured])

    def keep(self) -> None:
        """Put what is known on the disk and tell it: contacts.json, obstacles.json and the grid."""
        self.folder.write_document(self.document)
        export_obstacles(
            self.folder, self.document, radius_cm=self.config.body.radius_cm, prior=self.prior
        )
        self.live.contacts(self.document.contacts)
        self.live.grid(read_ros_map(self.folder.path / "map.yaml"))

    # The end.

    def _finish(self) -> str:
        self.robot.disarm()
        self.restore()
        return "safe"

    def end(self) -> None:
        """Tell those who watch how it ended."""
        self._tell()

    def restore(self) -> None:
        """Leave the board with every healthy sensor in use, as robot.toml says."""
        self.robot.set_aside(0)
