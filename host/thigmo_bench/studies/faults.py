"""Single failures in each state: how they are detected, and how soon the robot is safe.

The firmware runs on the virtual board in the emulated body, at the body pressure that pulls hardest
at the tail. A failure begins in the middle of a motion and persists; true pressure, true length and
the board's outputs are recorded. A failure that no signal shows is listed with the hardware that
covers it. The same cases run on the real image (tests/sim/mega).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any, Literal

import numpy as np

from thigmo.config import RobotConfig
from thigmo.emulator.board import EmulatedBoard, virtual_board
from thigmo.emulator.reach import room_for
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import CommandRefusedError, RobotFaultError
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.framing import Decoder
from thigmo.robot import Robot
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record
from thigmo_bench.studies.gallery import gallery_robot

# max_pressure_cpsi of robot.toml, with its margin: of the vines' 18 psi, of the catheter's 28
MAX_PSI, CATHETER_MAX_PSI = 18.5, 28.5
_COMMANDED_PSI = 18.0  # highest pressure of the commands in `STATES`
START_CM = 20.0
LASTS_S = 13.0
STEADY_S = 2.0  # end of the failure over which steady values are taken
_LIVE_ZERO = 320  # of 1599: 4 mA
EMPTIED_CM = 12.0  # travel of the spool in a second at full speed, while the body empties
FILL_S = 15.0  # for the body, through its throttle
QUIET_S = 0.5  # outputs that have been off for this time stay off
RECOVERY_S = 4.0
_SEED = 5

SAFE_CM = 2.0  # of growth after a single failure, where a brake is fitted
RATING_N = 100.0  # of the line

Fit = Literal["bare", "valves", "brake"]

RELIEF = "supply regulator and relief valve bound the pressure; the e-stop drops the air enable"
NO_DRIVE = "none needed: nothing is driven"
BRAKE = "the brake, or venting the body"
SHORT = "the brake and the contacts in the motor's supply; else the e-stop empties the body"
PULLS = SHORT + "; a line that holds 271 N"
SNAPPED = "valve Y3 empties the body; a line of a rating that nothing reaches"
BY_TOUCH = "none needed: homing ends at the base, by touch; else no motor is driven"
NO_HARM = "none needed: outputs are sound; the localizer weighs such readings"


@dataclass(frozen=True)
class Failure:
    """A failure of one part."""

    name: str  # for the table
    # kind, options: as a scene's `[[faults]]` has them
    kind: str
    options: dict[str, Any] = field(default_factory=dict, hash=False)
    valve: bool = False  # the air itself fails: no output of the board changes the pressure
    # spool: the spool itself or its supply fails: the board's duty does not change its motion, or
    # nothing but what passes the tip shows how far it moves
    spool: bool = False
    covered: str = ""  # hardware that covers it if no signal shows it or the firmware cannot act


FAILURES = (
    Failure("pressure sensor open", "pressure_wire_cut"),
    Failure("pressure sensor short", "pressure_short"),
    Failure("pressure sensor frozen where it is", "pressure_frozen", covered=NO_HARM),
    Failure("pressure sensor frozen at 0.3 psi", "pressure_frozen", {"value": 0.3},
            covered=NO_DRIVE),
    Failure("pressure sensor frozen at 17 psi", "pressure_frozen", {"value": 17.0}),
    Failure("pressure sensor gain 0.75", "pressure_gain", {"value": 0.75}, covered=NO_HARM),
    Failure("pressure sensor gain 1.3", "pressure_gain", {"value": 1.3}, covered=NO_HARM),
    Failure("pressure sensor offset -3 psi", "pressure_offset", {"value": -3.0}, covered=NO_HARM),
    Failure("pressure sensor offset +3 psi", "pressure_offset", {"value": 3.0}, covered=NO_HARM),
    Failure("pressure sensor noisy, 1 psi", "pressure_noisy", {"value": 1.0}, covered=NO_HARM),
    Failure("pressure sensor shows at most 2 psi, but for moments", "pressure_flickers",
            {"value": 2.0}, covered=NO_DRIVE),
    Failure("pressure sensor shows at most 16 psi, but for moments", "pressure_flickers",
            {"value": 16.0}, covered=NO_HARM),
    Failure("pressure sensor's wire chatters", "pressure_chatters"),
    Failure("flex sensor open", "flex_wire_cut"),
    Failure("flex sensor short", "flex_short"),
    Failure("flex sensor frozen", "flex_frozen", covered=NO_HARM),
    Failure("flex sensor noisy", "flex_noisy", covered=NO_HARM),
    Failure("valve stuck open, or its MOSFET short", "over_pressure", valve=True, covered=RELIEF),
    Failure("valve stuck shut", "pressure_stuck", {"value": 0.0}, valve=True,
            covered="none needed: no air"),
    Failure("valve stuck where it is", "pressure_stuck", valve=True, covered=RELIEF),
    Failure("valve leaks, 1.2 psi", "pressure_stuck", {"value": 1.2}, valve=True, covered=RELIEF),
    Failure("air lost", "air_lost", valve=True, covered="none needed: no air"),
    Failure("motor unpowered, windings open", "motor_lost", spool=True, covered=BRAKE),
    Failure("motor jammed", "spool_stall", covered=NO_DRIVE),
    Failure("motor driver short, full speed out", "motor_shorted", {"value": 800}, spool=True,
            covered=SHORT),
    Failure("motor driver short, full speed in", "motor_shorted", {"value": -800}, spool=True,
            covered=PULLS),
    Failure("encoder dead", "encoder_lost", covered=NO_DRIVE),
    Failure("encoder loses three counts of ten", "encoder_share", {"value": 0.7}, spool=True,
            covered=BY_TOUCH),
    Failure("encoder shows twice its counts", "encoder_share", {"value": 2.0}, spool=True,
            covered=BY_TOUCH),
    Failure("line snapped", "line_snapped", spool=True, covered=SNAPPED),
    Failure("tail jammed", "tail_jam", covered=NO_DRIVE),
    Failure("brake stuck open", "brake_open",
            covered="each arming proves the brake; the contacts still cut the motor's supply"),
    Failure("brake stuck closed", "brake_closed", covered=NO_DRIVE),
    Failure("contact in the motor's supply welded", "contact_welded", spool=True,
            covered="the driver obeys; the brake"),
    Failure("converter's reference 20 % low", "reference_off"),
    Failure("converter's reference 5 % low", "reference_off", {"value": 0.95}, covered=NO_HARM),
    Failure("brake slips, 2 cm/s of line", "spool_slip", spool=True, covered=BRAKE),
    Failure("supply dip, 3.8 V", "brown_out"),
    Failure("board's power lost for 1 s", "power_cut", {"duration_s": 1.0}),
    Failure("host silent", "host_silent"),
    Failure("firmware hangs", "hang"),
    Failure("e-stop pressed", "estop"),
)  # fmt: skip

# What a start must notice; the rows are of the state "starting".
AT_START = (
    Failure("flipped bit of the newest configuration", "flipped_bit"),
    Failure("reset while a fault is latched", "latched_reset"),
)
STARTING = "starting"
_NEWER_SLOT = 1032  # in the store, once it has been saved twice (firmware/core/config/store.h)
_FLIPPED_BYTE = 40  # of the slot

# Commands before the failure, and the time from them to the failure.
STATES: dict[str, tuple[tuple[wire.Command[Any], ...], float]] = {
    "safe": ((wire.Disarm(),), 0.5),
    "ready": ((), 0.5),
    "growing": ((wire.GrowTo(530_000, 0),), 2.0),
    "retracting": ((wire.RetractTo(0, 0),), 2.0),
    "homing": ((wire.Home(),), 2.0),
    "sweeping": ((wire.Sweep((1800, 1800), 30_000, 1, 0),), 5.0),
    "pressing": ((wire.SetPressure((1800, 0), 0),), 6.0),
}
QUICK = ("ready", "growing", "pressing")
Built = Literal["two muscles", "one muscle", "four muscles", "catheter"]
# Directions of the muscles of vines. Of four, the base sensors at 90 and 270 degrees guard two
# each: a sweep takes guarded muscles only.
BUILT: dict[str, tuple[float, ...]] = {
    "one muscle": (90.0,),
    "two muscles": (90.0, 270.0),
    "four muscles": (45.0, 135.0, 225.0, 315.0),
}
# Of the muscles' relief valve, by the range of the robot's air (docs/hardware/air.md).
RELIEF_PSI = {20.0: 30.0, 30.0: 40.0}
OF_BRAKE = ("brake_open", "brake_closed", "contact_welded")
OF_SPOOL = (
    *OF_BRAKE, "motor_lost", "spool_stall", "motor_shorted", "encoder_lost", "encoder_share",
    "line_snapped", "tail_jam", "spool_slip",
)  # fmt: skip
BENDING = ("sweeping", "pressing")  # what differs with the muscles and their pressure


@dataclass(frozen=True)
class Case:
    """A failure in a state; and a second one.

    `fit`: without valves that empty the robot, with them, or with them and a brake at the spool.
    """

    failure: Failure
    state: str
    fit: Fit = "bare"
    second: Failure | None = None
    robot: Built = "two muscles"


@dataclass(frozen=True)
class Visit:
    """The effects of a failure."""

    noticed: str  # faults by which the board stopped, "reset", or "" if it did not notice
    # time from the failure until the outputs are off for good; None if they stay on
    safe_s: float | None
    # peak_psi, steady_psi: highest true muscle pressure, and that of the last two seconds
    peak_psi: float
    steady_psi: float
    moved_cm: float  # largest growth of the tip after the failure began
    # largest excess of the true length over both the length at the failure and the encoder's
    beyond_cm: float
    pull_n: float  # largest pull on the line
    recovers: bool  # whether faults clear and the robot arms after the failure, without a reset
    driven: int  # largest number of muscles driven at once, above the transducers' live zero


BoardFor = Callable[[bytes], EmulatedBoard]


def _scene(fit: Fit = "bare", robot: Built = "two muscles") -> Scene:
    if robot == "catheter":
        return _catheter_scene()
    scene = Scene.load("empty").model_copy(update={"start_length_cm": START_CM})
    scene.belief = type(scene.belief)()
    scene.enables = scene.enables.model_copy(update={"fitted": fit != "bare"})
    scene.robot = scene.robot.model_copy(deep=True)
    scene.robot.spool.brake = fit == "brake"
    first, *_ = scene.robot.muscles
    if len(BUILT[robot]) != len(scene.robot.muscles):
        scene.robot.muscles = [
            first.model_copy(deep=True, update={"name": f"{lies:g} deg", "angle_deg": lies})
            for lies in BUILT[robot]
        ]
    return scene


def _catheter_scene() -> Scene:
    config = gallery_robot("catheter")
    scene = room_for(config, _SEED, peg=False)
    scene.start_length_cm = config.body.length_cm
    scene.belief = type(scene.belief)()
    return scene


@cache
def stored(fit: Fit = "bare", robot: Built = "two muscles") -> bytes:
    """The stored configuration (EEPROM) of a board."""
    scene = _scene(fit, robot)
    transport = EmulatorTransport(scene, virtual_board(scene.robot, _SEED), seed=_SEED)
    Robot(Client(transport)).configure(transport.config)
    return transport.lockstep.board.eeprom


def _start(case: Case) -> Visit:
    """Start a board whose newest configuration is damaged, or one that has a fault latched."""
    scene = _scene(case.fit, case.robot)
    board = virtual_board(scene.robot, _SEED, stored(case.fit, case.robot))
    transport = EmulatorTransport(scene, board, seed=_SEED)
    robot = Robot(Client(transport))
    if case.failure.kind == "flipped_bit":
        robot.set_parameter("max_pressure_cpsi", [1000])
        robot.save()
        store = bytearray(board.eeprom)
        store[_NEWER_SLOT + _FLIPPED_BYTE] ^= 1
        board = virtual_board(scene.robot, _SEED, bytes(store))
        transport = EmulatorTransport(scene, board, seed=_SEED)
    else:
        robot.arm()
        table = {"kind": "pressure_wire_cut", "at_s": transport.now(), "duration_s": QUIET_S}
        transport.lockstep.faults.inject(FaultTable.model_validate(table))
        transport.pass_time(2 * QUIET_S)
        board.reset(int(wire.ResetCause.EXTERNAL))
        transport.pass_time(2 * QUIET_S)
    robot = Robot(Client(transport))
    robot.wait(QUIET_S, despite_faults=True)
    noticed = ", ".join(robot.status().faults)
    refused = not _arms(robot)
    if case.failure.kind == "flipped_bit":
        robot.configure(transport.config)
    robot.clear_faults()
    return Visit(
        noticed=noticed, safe_s=0.0 if refused else None, peak_psi=0.0, steady_psi=0.0,
        moved_cm=0.0, beyond_cm=0.0, pull_n=0.0, recovers=_arms(robot), driven=0,
    )  # fmt: skip


def _arms(robot: Robot) -> bool:
    try:
        robot.arm()
    except (CommandRefusedError, RobotFaultError):
        return False
    return True


def visit(case: Case, board_for: BoardFor | None = None, exchange_ms: int = 10) -> Visit:
    """Break one part in one state and record the effects, on the virtual board by default."""
    if case.state == STARTING:
        return _start(case)
    scene = _scene(case.fit, case.robot)
    make_board = board_for or partial(virtual_board, scene.robot, _SEED)
    board = make_board(stored(case.fit, case.robot))
    transport = EmulatorTransport(scene, board, seed=_SEED, exchange_ms=exchange_ms)
    lockstep, plant = transport.lockstep, transport.lockstep.plant
    client = Client(transport)
    robot = Robot(client)
    robot.wait(0.5)
    robot.set_parameter("trigger_e5", [10_000])
    robot.arm()
    if case.fit != "bare":
        robot.wait(FILL_S)
    robot.confirm_length(scene.start_length_cm, settled=True)
    robot.select_body_pressure(0)
    robot.zero()
    commands, lead_s = STATES[case.state]
    for command in commands:
        client.request(_of_muscles(command, scene.robot, client.capacity.muscles))
    begins = transport.now() + lead_s
    for failure in filter(None, (case.failure, case.second)):
        table = {"kind": failure.kind, "at_s": begins, "duration_s": LASTS_S} | failure.options
        if failure.kind == "over_pressure":
            table["value"] = RELIEF_PSI[scene.robot.board.pressure_range_psi]
        lockstep.faults.inject(FaultTable.model_validate(table))
    transport.pass_time(lead_s)
    decoder, length = Decoder(), plant.length_cm
    shown_cm, allowed_cm = length, length  # by the encoder
    faults, announced = 0, False
    rows = []
    while transport.now() < begins + LASTS_S - 0.02:
        t_s = transport.now()
        for frame in decoder.feed(transport.read(0.01)):
            message = frame.message()
            announced |= isinstance(message, wire.Announce)
            if isinstance(message, wire.Telemetry):
                faults |= message.faults
                shown_cm = message.length_um / 1e4
        allowed_cm = max(allowed_cm, shown_cm if not faults else allowed_cm)
        unsafe = board.motor != 0 or any(board.drive_enabled)
        grown = plant.length_cm
        psi_now = max(plant.muscle_psi)
        driven = sum(
            output_on and level > _LIVE_ZERO
            for output_on, level in zip(board.drive_enabled, board.drive, strict=True)
        )
        row = (
            t_s - begins,
            unsafe,
            psi_now,
            grown - length,
            grown - allowed_cm,
            plant.line_n,
            driven,
        )
        rows.append(row)
    after_s, output_on, psi, moved_cm, beyond_cm, pull_n, at_once = np.array(rows).T
    last_s = float(after_s[output_on > 0].max(initial=0.0))
    noticed = ", ".join(f.key for f in wire.Fault.from_mask(faults))
    noticed = noticed or ("reset" if announced else "")
    return Visit(
        noticed=noticed,
        safe_s=round(last_s, 2) if noticed and last_s < LASTS_S - QUIET_S else None,
        peak_psi=float(psi.max()),
        steady_psi=float(psi[after_s > LASTS_S - STEADY_S].max()),
        moved_cm=float(moved_cm.max(initial=0.0)),
        beyond_cm=float(beyond_cm.max(initial=0.0)),
        pull_n=float(pull_n.max()),
        recovers=_recovers(transport),
        driven=int(at_once.max()),
    )


def _of_muscles(command: wire.Command[Any], robot: RobotConfig, outputs: int) -> wire.Command[Any]:
    """A command of two muscles of 18 psi, for a robot on a board with a number of outputs."""
    key = {wire.Sweep: "amplitude_cpsi", wire.SetPressure: "set_cpsi"}.get(type(command))
    if key is None:
        return command
    share = robot.muscles[0].max_pressure_psi / _COMMANDED_PSI
    first, second = (round(share * cpsi) for cpsi in getattr(command, key))
    muscles = len(robot.muscles)
    tops = [first, *[second] * (muscles - 1), *[0] * (outputs - muscles)]
    return replace(command, **{key: tuple(tops)})


def _recovers(transport: EmulatorTransport) -> bool:
    """Whether the robot can be used again, by commands alone."""
    transport.pass_time(RECOVERY_S)
    client = Client(transport)
    client.poll(0.5)
    client.request(wire.Disarm())
    client.poll(RECOVERY_S)
    if client.request(wire.ClearFaults(0xFFFF)).detail:
        return False
    try:
        client.request(wire.Arm())
    except CommandRefusedError:
        return False
    return True


def run(context: Context) -> Outcome:
    """The campaign: every failure in every state (bare, with valves, with valves and brake), and
    the damage that a start must notice.

    Quick: in three of the states, and in growth with valves and brake.
    """
    quick = context.scale == "quick"
    states, fitted = (QUICK, ("growing",)) if quick else (tuple(STATES), tuple(STATES))
    cases = [
        Case(failure, state, fit)
        for fit in ("bare", "valves", "brake")
        for failure in FAILURES
        for state in (states if fit == "bare" else fitted)
        if fit == "brake" or failure.kind not in OF_BRAKE
    ]
    cases += [
        Case(failure, state, robot=robot)
        for robot in ("one muscle", "four muscles")
        for failure in FAILURES
        for state in (BENDING[-1:] if quick else BENDING)
        if failure.kind not in OF_BRAKE
    ]
    cases += [
        Case(failure, state, robot="catheter")
        for failure in FAILURES
        for state in (BENDING[-1:] if quick else BENDING)
        if failure.kind not in OF_SPOOL
    ]
    cases += [Case(failure, STARTING) for failure in AT_START]
    return outcome(cases, context.map(visit, cases, "failures"))


def _line(case: Case, result: Visit) -> Record:
    failure = case.failure
    bare = not result.noticed or failure.valve or failure.spool
    return {
        "failure": failure.name, "state": case.state, "noticed_as": result.noticed or "not noticed",
        "safe_s": "" if result.safe_s is None else result.safe_s,
        "peak_psi": round(result.peak_psi, 1), "steady_psi": round(result.steady_psi, 1),
        "grown_cm": round(result.moved_cm, 2), "pull_n": round(result.pull_n),
        "covered_by": failure.covered if bare else "",
    }  # fmt: skip


def outcome(cases: list[Case], visits: list[Visit]) -> Outcome:
    """Tables and claims of visits."""
    pairs = list(zip(cases, visits, strict=True))
    tables: dict[str, Sequence[Record]] = {}
    for case, result in pairs:
        name = {
            "bare": "failures", "valves": "failures_with_valves",
            "brake": "failures_with_valves_and_brake",
        }[case.fit]  # fmt: skip
        if case.robot != "two muscles":
            name = f"failures_of_{case.robot.replace(' ', '_')}"
        tables[name] = [*tables.get(name, ()), _line(case, result)]
    noticed = [(c, v) for c, v in pairs if v.noticed]
    braked = [(c, v) for c, v in pairs if c.fit == "brake"]
    obeys = [v for c, v in pairs if c.failure.kind != "motor_shorted"]
    host = [v for c, v in pairs if c.failure.kind in ("host_silent", "hang")]
    without_encoder = [v for c, v in pairs if c.failure.kind == "encoder_lost"]
    unnoticed = [c for c, v in pairs if not v.noticed and c.state not in ("safe", "ready")]
    claims: tuple[tuple[str, Sequence[float], float, str], ...] = (
        *_pressure_claims("", [pair for pair in pairs if pair[0].robot != "catheter"], MAX_PSI),
        *_pressure_claims(
            ", of the catheter", [pair for pair in pairs if pair[0].robot == "catheter"],
            CATHETER_MAX_PSI,
        ),
        ("growth after host or firmware dies", [v.moved_cm for v in host], 2.0, "cm"),
        ("growth after the encoder dies", [v.moved_cm for v in without_encoder], 2.0, "cm"),
        ("growth after a noticed failure, where valves empty the body",
         [v.moved_cm for c, v in noticed if c.fit == "valves" and c.failure.kind != "line_snapped"],
         EMPTIED_CM, "cm"),
        ("growth that was not asked for, where a brake is fitted and the line whole",
         [v.beyond_cm for c, v in braked if c.failure.kind != "line_snapped"], SAFE_CM, "cm"),
        ("pull on the line where the driver obeys", [v.pull_n for v in obeys], RATING_N, "N"),
        ("time to safe of a noticed failure whose spool works",
         [v.safe_s or 0.0 for c, v in noticed if not c.failure.spool], 8.0, "s"),
        ("time to safe of a noticed failure of the spool, some of which only a motion's end shows",
         [v.safe_s or 0.0 for c, v in noticed if c.failure.spool], LASTS_S - QUIET_S, "s"),
        ("muscles driven at once", [v.driven for v in visits], 1, ""),
        ("noticed failures after which an output stays on",
         [sum(v.safe_s is None for _, v in noticed)], 0, ""),
        ("failures in motion that nothing notices and nothing covers",
         [sum(not c.failure.covered for c in unnoticed)], 0, ""),
        ("failures after whose end only a reset would help",
         [sum(not v.recovers for v in visits)], 0, ""),
    )  # fmt: skip
    return Outcome(
        tables,
        claims=[
            Claim(t, max(values, default=0.0), limit, unit=u) for t, values, limit, u in claims
        ],
    )


def _pressure_claims(
    suffix: str, pairs: list[tuple[Case, Visit]], most_psi: float
) -> tuple[tuple[str, list[float], float, str], ...]:
    """Promises of the true pressure, of robots whose board allows `most_psi`."""
    steady_psi = [
        result.steady_psi
        for case, result in pairs
        if result.noticed and (not case.failure.valve or case.fit != "bare")
    ]
    peak_psi = [result.peak_psi for case, result in pairs if not case.failure.valve]
    limit_psi = most_psi + 1.5
    return (
        (
            f"steady true pressure of a noticed failure whose valve works, or is emptied{suffix}",
            steady_psi, limit_psi, "psi",
        ),
        (
            f"true pressure at its highest, where the valve works{suffix}",
            peak_psi, limit_psi, "psi",
        ),
    )  # fmt: skip
