"""Predicts by mechanics what a described robot will do; each finding has its number.

Findings are about growth against the tail's friction, the pull on the spool, bend and fold, the
contacts that each muscle's sweep can detect and localize, how often each channel is read, and
values that the board cannot store.

The contact considered is a peg just beside the straight body that presses as hard as it can: a
cantilever of free curvature g that is propped at an arc has a base moment over EI of 3/2 g, or the
base folds.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, hypot, pi

import numpy as np
import numpy.typing as npt

from thigmo.config import (
    SAME_PRESSURE,
    SIGN,
    BoardSensor,
    Body,
    Muscle,
    RobotConfig,
    Sensor,
    Side,
    Spool,
)
from thigmo.contact_status import WIDTH_SHARE
from thigmo.design.bounds import FEWEST_READINGS, arc_bounds
from thigmo.design.finding import Finding
from thigmo.design.units import unit_questions
from thigmo.errors import ConfigError
from thigmo.exploration.growth import stage_lengths
from thigmo.link.protocol import PARAMETERS, parameters
from thigmo.mechanics import critical_moment, phi, rest_turn, traced
from thigmo.robot import TRIGGER_PER_CM
from thigmo.robot.configuration import out_of_range, parameter_settings
from thigmo.wiring import Wiring, beyond_board

_ENABLE_DECAY_S = 0.03  # of the brake's enable (docs/hardware/electronics.md), as the board has it
_QUANTILES = 3.92  # width of a 95 % interval over its standard deviation
_CLOSED_RAD = 2 * pi
_PROPPED = 1.5  # base moment over EI of a propped cantilever, over its free curvature
_COUNTS = 1024  # counts of the converter
_TICKS_HZ = 1000  # rate of the board's control loop
# I2C in fast mode, with nine bits a byte, plus start and stop. For an IMU behind a multiplexer, the
# channel is written and read back, then 21 bytes of a BNO085's packet with a game rotation vector
# are read (kTurnBits of firmware/core/sensing/imu_string.h).
_BUS_HZ, IMU_BITS = 400_000, 9 * (2 + 2 + 1 + 21) + 3 * 2
_REPORTS_HZ = 50  # reports of each IMU
_TRIGGER_SIGMAS = 5.0  # a trigger threshold below this many standard deviations fires by noise
_STEPS = 200
_PUSHED_RAD = 0.5  # turn of the tip, under a push that `feel` is asked about
# Of the body, in percent: below this the answer "somewhere" is the rule. The thesis's robot has 34.
_LOCALIZED_LEAST = 15.0
_CURE_PLACES = 25  # where one more sensor is tried
_ORDINALS = {2: "half", 3: "third", 5: "fifth", 10: "tenth", 20: "twentieth"}
# Errors after a calibration (scenes/default.toml): of a sensor's scale, relative, and in 1/cm.
_CALIBRATED_GAIN, _CALIBRATED_OFFSET = 0.02, 5e-4

Floats = npt.NDArray[np.float64]


def judge(config: RobotConfig) -> list[Finding]:
    """All findings: first whether it explores, then the board's."""
    limitations = beyond_board(config)
    wiring = None if limitations else Wiring.laid_out(config)  # findings of the inputs need one
    findings = []
    if wiring and (limitation := wiring.unexplorable):
        text = f"{limitation.problem}: `thigmo explore` refuses; {limitation.cure}"
        findings.append(Finding("explore", "warning", text))
    if wiring:
        findings += [
            Finding("board", "bad", f"{problem}: correct what it comes from in robot.toml")
            for problem in _values_out_of_range(wiring)
        ] or [Finding("board", "ok", _board(wiring))]
    else:
        findings += [Finding("board", "bad", f"{problem}; {cure}") for problem, cure in limitations]
    try:
        stages = stage_lengths(config)
        lengths = ", ".join(f"{length:g}" for length in stages)
        findings.append(Finding("stages", "ok", f"{lengths} cm"))
    except ConfigError as error:
        findings.append(Finding("stages", "bad", str(error)))
    growth = _growth(config) if config.body.grows else ()
    findings += [*growth, *_bends(config, wiring), *_folds(config)]
    findings += _preformed(config)
    explores = bool(config.muscles) and not config.body.rest_curvature
    if not explores:
        findings += _touches(config)
    if wiring:
        for side in config.sides if explores else ():
            findings += _contacts(wiring, side)
        findings += _inputs(wiring)
    findings += [*_resolution(config), *_signs(config), *unit_questions(config)]
    if wiring:
        findings += _rates(wiring)
    return [*findings, *_imus(config), *_fibre(config)]


def _values_out_of_range(wiring: Wiring) -> list[str]:
    """Values beyond the range of the board's parameters."""
    rows = parameters(**wiring.size.capacity)
    settings = parameter_settings(wiring).items()
    return [problem for name, values in settings for problem in out_of_range(rows[name], values)]


def _board(wiring: Wiring) -> str:
    """The board that the robot needs, and its capacity, as text."""
    board = wiring.size
    return (
        f"{board.name}: {board.muscles} muscles, {board.sensors} sensors and "
        f"{board.body_pressures} body pressures"
    )


def _inputs(wiring: Wiring) -> Iterator[Finding]:
    """The board's inputs of each column, with the names that page, record and export use."""
    for column in wiring.columns:
        inputs = ", ".join(map(str, column.inputs))
        text = f"base first on the inputs {inputs}" if len(column.inputs) > 1 else f"input {inputs}"
        yield Finding(f"column {column.name}", "ok", text)


def _growth(config: RobotConfig) -> Iterator[Finding]:
    body, spool = config.body, config.spool
    for pressure in body.pressures:
        part = f"{pressure.pressure_psi:g} psi, to {pressure.until_cm:g} cm"
        end = min(pressure.until_cm, body.length_cm)
        needed = body.growth_psi + body.growth_psi_per_cm * end
        if pressure.pressure_psi > needed:
            yield Finding(part, "ok", f"grows: {needed:.2f} psi are needed at its end")
        else:
            yield Finding(
                part,
                "bad",
                f"does not grow to its end, which needs {needed:.2f} psi: raise this pressure",
            )
        pull = body.pull_n(pressure.pressure_psi)
        pull_text = f"the body pulls {pull:.1f} N at the spool at rest"
        if spool.brake:
            yield _braked(part, pull_text, spool, pull)
        elif pull <= spool.holding_n:
            yield Finding(part, "ok", f"{pull_text}, and friction holds {spool.holding_n:g} N")
        else:
            holds = pressure.pressure_psi * spool.holding_n / pull
            yield Finding(
                part,
                "bad",
                f"{pull_text}, and friction holds {spool.holding_n:g} N: it slips (spool_slip). "
                f"Fit a brake, or stay below {holds:.2f} psi",
            )


def _braked(part: str, pull_text: str, spool: Spool, pull_n: float) -> Finding:
    """Whether the brake holds before a stopped spool has turned too far.

    Until it has closed, the shorted windings alone slow what friction does not hold.
    """
    excess_n = max(pull_n - spool.holding_n, 0.0)
    line_cm_s = spool.line_speed_cm_s * excess_n / (spool.stall_n - spool.holding_n)
    closed_s = spool.brake_closes_s + _ENABLE_DECAY_S
    run_out_mm = 10 * line_cm_s * closed_s / spool.payout_ratio
    allowed_mm = PARAMETERS["slip_um"].defaults[0] / 1e3
    text = (
        f"{pull_text}. At a stop the tip runs on by {run_out_mm:.1f} mm until its brake holds, "
        f"{closed_s * 1e3:.0f} ms later; {allowed_mm:g} mm are allowed (slip_um)"
    )
    if run_out_mm <= allowed_mm:
        return Finding(part, "ok", text)
    return Finding(
        part, "bad", f"{text}: it slips (spool_slip). Fit a faster brake, or lower this pressure"
    )


def _bends(config: RobotConfig, wiring: Wiring | None) -> Iterator[Finding]:
    body = config.body
    for muscle in config.muscles:
        top = muscle.most_bend
        angle = _most_turned(body, top * (SIGN[muscle.side] if muscle.side else 0.0))
        text = f"bends the whole body by {degrees(angle):.0f} degrees at {top:.4f} 1/cm"
        if not all(muscle_map.calibrated for muscle_map in muscle.maps):
            text += " (not calibrated)"
        if angle < _CLOSED_RAD:
            yield Finding(f"muscle {muscle.name}", "ok", text)
        else:
            curvature_limit = _CLOSED_RAD / body.length_cm
            yield Finding(
                f"muscle {muscle.name}",
                "bad",
                f"{text}: it runs into itself; lower max_pressure_psi until g is "
                f"{curvature_limit:.4f}",
            )
        yield from _maps(config, muscle)
        if muscle.side is None and wiring:
            yield from _out_of_plane(wiring, muscle)


def _most_turned(body: Body, free: float) -> float:
    """Largest angle (rad) between two places of the body at rest or at a free curvature, 1/cm."""
    arcs = np.linspace(0.0, body.length_cm, _STEPS + 1)
    return float(np.ptp(rest_turn(body.rest_pieces, arcs) + free * arcs))


def _preformed(config: RobotConfig) -> Iterator[Finding]:
    """Where the tip lies at rest, of a body that is curved there."""
    body = config.body
    if not body.rest_curvature:
        return
    arcs = np.linspace(0.0, body.length_cm, _STEPS + 1)
    heading = rest_turn(body.rest_pieces, arcs)
    x, y = traced(heading, arcs[1])
    side = "left" if heading[-1] >= 0.0 else "right"
    text = (
        f"curved at rest: the tip lies at x = {x[-1]:.1f}, y = {y[-1]:.1f} cm and points "
        f"{abs(degrees(heading[-1])):.0f} degrees to the {side}"
    )
    if np.ptp(heading) < _CLOSED_RAD:
        yield Finding("body", "ok", text)
    else:
        yield Finding("body", "bad", f"{text}; it runs into itself: is rest_curvature in 1/cm?")


def _folds(config: RobotConfig) -> Iterator[Finding]:
    """Whether the base folds before a contact is felt."""
    if not config.body.folds:
        return
    for pressure, moment in zip(config.body.pressures, _fold_moments(config), strict=True):
        part = f"{pressure.pressure_psi:g} psi, to {pressure.until_cm:g} cm"
        if moment > TRIGGER_PER_CM:
            yield Finding(part, "ok", f"the base folds at a contact moment of {moment:.4f} 1/cm")
        else:
            yield Finding(
                part,
                "bad",
                f"the base folds at {moment:.4f} 1/cm, before the trigger's {TRIGGER_PER_CM:g}: "
                "raise this pressure",
            )


def _out_of_plane(wiring: Wiring, muscle: Muscle) -> Iterator[Finding]:
    """What measures and what guards the bends of a muscle that the camera does not see."""
    part = f"muscle {muscle.name}"
    if not any(wired.sound for wired in wiring.sensors_reading(muscle)):
        text = (
            "cannot be calibrated: no healthy sensor reads a bend towards "
            f"{muscle.angle_deg:g} degrees, and the camera sees the plane only"
        )
        yield Finding(part, "warning", text)
    if not (bases := wiring.trigger_sensors(muscle)):
        text = (
            "no base sensor on the board's trigger reads its bends: the board refuses a sweep "
            "towards it, and `Robot.press` bends the body without feeling a contact"
        )
        yield Finding(part, "warning", text)
        return
    share = abs(bases[0].share)
    names = " and ".join(f"{base.sensor.angle_deg:g} degrees" for base in bases)
    text = (
        f"the base sensor at {names} guards its bends and reads {100 * share:.0f} % of them, so "
        f"a contact is felt from {TRIGGER_PER_CM / share:.4f} 1/cm on"
    )
    yield Finding(part, "ok", text)


def _maps(config: RobotConfig, muscle: Muscle) -> Iterator[Finding]:
    """Maps of a muscle that were measured at another body pressure than they are used at."""
    for pressure, muscle_map in zip(config.body.pressures, muscle.maps, strict=True):
        apart_psi = abs(muscle_map.body_pressure_psi - pressure.pressure_psi)
        if apart_psi > SAME_PRESSURE * pressure.pressure_psi:
            text = (
                f"its map for {pressure.pressure_psi:g} psi is of {muscle_map.body_pressure_psi:g} "
                "psi: correct body_pressure_psi, or measure it (`thigmo calibrate actuator`)"
            )
            yield Finding(f"muscle {muscle.name}", "bad", text)


def _fold_moments(config: RobotConfig) -> list[float]:
    body = config.body
    return [
        critical_moment(body.critical_curvature, body.critical_pressure_psi, pressure.pressure_psi)
        for pressure in body.pressures
    ]


def _contacts(wiring: Wiring, side: Side) -> Iterator[Finding]:
    """Where a sweep towards a side detects and localizes a contact, at the full length."""
    config = wiring.config
    muscle, body = config.muscle(side), config.body
    part = f"sweep of {muscle.name}"
    sign = SIGN[side]
    sensors = config.sensors_for(side)
    column = [s for s in sensors if s.healthy and s.bend_sign in (0, sign)]
    wired = any(isinstance(sensor, BoardSensor) for sensor in sensors)
    bases = wiring.trigger_sensors(muscle)
    if not column or (wired and not bases):
        guarded_muscles = [m for m in config.muscles if m.side and wiring.trigger_sensors(m)]
        text = (
            "feels nothing: the trigger works on a base sensor that this muscle does not wrinkle, "
            "and there is none that is healthy and answers to this bend"
        )
        if guarded_muscles:
            names = " and ".join(guarded.name for guarded in guarded_muscles)
            text += f". `thigmo explore` sweeps {names} only, and finds what lies on that side"
        yield Finding(part, "warning" if guarded_muscles else "bad", text)
        return
    free = muscle.maps[-1].inflate.curvature(muscle.max_pressure_psi)
    moment = min(_PROPPED * free, _fold_moments(config)[-1])
    arcs = np.linspace(0.0, body.length_cm, _STEPS + 1)[1:]
    base = bases[0].sensor if wired else column[0]
    deficit = moment * phi(arcs, base.center_cm, base.span_cm) / arcs
    detected = arcs[deficit > TRIGGER_PER_CM]
    if not wired:
        text = "the board refuses it: it sees no base sensor (no_base_sensor)"
        yield Finding(part, "warning", text)
    elif detected.size:
        ends = f"{detected[0]:.1f} to {body.length_cm:g} cm"
        yield Finding(part, "ok", f"feels contacts from {ends}; blind nearer to the base")
    else:
        yield Finding(part, "bad", f"feels nothing: contacts hold back {deficit.max():.4f} 1/cm")
        return
    width = f"{WIDTH_SHARE * body.length_cm:.1f} cm"
    stated, calibrated = (
        100 * _localized(config, column, arcs, moment, min(muscle.offset_se, offset), gain).mean()
        for offset, gain in ((np.inf, np.inf), (_CALIBRATED_OFFSET, _CALIBRATED_GAIN))
    )
    uncalibrated = f"on {stated:.0f} % before" if stated >= 0.5 else "nowhere before"
    text = (
        f"a contact pressed as hard as the base allows is localized to {width} on "
        f"{calibrated:.0f} % of the body once calibrated, {uncalibrated}"
    )
    if calibrated >= _LOCALIZED_LEAST:
        yield Finding(part, "ok", text)
        return
    yield Finding(part, "warning", f"{text}: {_cure(config, column, arcs, moment, muscle)}")


def _touches(config: RobotConfig) -> Iterator[Finding]:
    """Where `thigmo feel` localizes a contact that pushes a body aside at rest."""
    column = [sensor for sensor in config.sensors if sensor.usable and sensor.side]
    if not column:
        yield Finding("feel", "bad", "no healthy sensor reads bends in the plane: add one")
        return
    length_cm = config.body.length_cm
    arcs = np.linspace(0.0, length_cm, _STEPS + 1)[1:]
    # A force at the tip turns it by half of its moment at the base times the length.
    moment = min(2 * _PUSHED_RAD / length_cm, *_fold_moments(config))
    sensors = sorted(column, key=lambda sensor: sensor.center_cm)
    localized = 100 * _localized(config, sensors, arcs, moment, 0.0, _CALIBRATED_GAIN).mean()
    text = (
        f"a push that turns the tip by {degrees(moment * length_cm / 2):.0f} degrees is localized "
        f"to {WIDTH_SHARE * length_cm:.1f} cm on {localized:.0f} % of the body (`thigmo feel`)"
    )
    yield Finding("feel", "ok" if localized >= _LOCALIZED_LEAST else "warning", text)


def _cure(
    config: RobotConfig, column: list[Sensor], arcs: Floats, moment: float, muscle: Muscle
) -> str:
    """Where one more sensor helps most, or else which noise the sensors would need."""

    def share(sensors: list[Sensor]) -> float:
        offset = min(muscle.offset_se, _CALIBRATED_OFFSET)
        rows = _localized(config, sensors, arcs, moment, offset, _CALIBRATED_GAIN)
        return float(100 * rows.mean())

    half = column[0].span_cm / 2
    free = [
        float(place)
        for place in np.linspace(half, config.body.length_cm - half, _CURE_PLACES)
        if all(abs(place - s.center_cm) >= half + s.span_cm / 2 for s in column)
    ]
    added = {
        place: share([*column, column[0].model_copy(update={"center_cm": place})]) for place in free
    }
    if added:
        place = max(added, key=lambda arc: added[arc])
        if added[place] >= _LOCALIZED_LEAST:
            return f"one more sensor at {place:.0f} cm would make it {added[place]:.0f} %"
    for factor in (2, 3, 5, 10, 20):
        quieter = [sensor.quieter(factor) for sensor in column]
        if share(quieter) >= _LOCALIZED_LEAST:
            worst_se = max(sensor.reading_se for sensor in quieter)
            return (
                f"no one more sensor is enough; readings known to {worst_se:.1e} 1/cm (noise and "
                f"zero a {_ORDINALS[factor]} of what they are) would make it {share(quieter):.0f} %"
            )
    return "neither one more sensor nor less noise is enough; the base folds, or bends too little"


def _localized(
    config: RobotConfig,
    column: list[Sensor],
    arcs: Floats,
    moment: float,
    offset: float,
    most_gain: float,
) -> npt.NDArray[np.bool_]:
    """(n,) whether the 95 % interval of a contact at each arc is narrow enough, and checked.

    The intervals are Cramer-Rao bounds for small deflections.
    """
    if len(column) < FEWEST_READINGS:
        return np.zeros(len(arcs), bool)
    gains = [min(s.gain_error, most_gain) * moment * (1 - s.center_cm / arcs[-1]) for s in column]
    noise = [hypot(s.reading_se, gain) for s, gain in zip(column, gains, strict=True)]
    centers, spans = ([getattr(s, key) for s in column] for key in ("center_cm", "span_cm"))
    bounds = [
        arc_bounds([a], [moment / a], centers, spans, noise, config.body.length_cm, offset)[0]
        for a in arcs
    ]
    return np.asarray(_QUANTILES * np.array(bounds) < WIDTH_SHARE * config.body.length_cm)


def _resolution(config: RobotConfig) -> Iterator[Finding]:
    """Sensors whose bends the converter resolves too coarsely: 1024 counts are the supply."""
    board, coarse = config.board, {}
    for name, sensor in _healthy_on_board(config):
        per_count = sensor.count_curvature(board.divider_ohm, _COUNTS)
        if per_count > TRIGGER_PER_CM:
            coarse[name] = per_count, sensor.raw_zero
    if coarse:
        name, (per_count, zero_ohm) = max(coarse.items(), key=lambda item: item[1])
        suffix = f" and {len(coarse) - 1} more" if len(coarse) > 1 else ""
        text = (
            f"a count of the converter is {per_count:.2g} 1/cm, more than the trigger's "
            f"{TRIGGER_PER_CM:g}, at zero_ohm = {zero_ohm:g} and divider_ohm = "
            f"{board.divider_ohm:g}: correct the one that is wrong; they are usually alike"
        )
        yield Finding(f"sensor {name}{suffix}", "bad", text)


def _signs(config: RobotConfig) -> Iterator[Finding]:
    """Sensors whose scale is likely to have the wrong sign."""
    for name, sensor in _healthy_on_board(config):
        if sensor.raw_scale * sensor.bend_sign < 0:
            text = (
                f"its resistance falls in the only bends that it answers to: scale_per_ohm = "
                f"{sensor.raw_scale:g} and bend_sign = {sensor.bend_sign} differ "
                "in sign; correct one of them, or measure both (`thigmo calibrate flex`)"
            )
            yield Finding(f"sensor {name}", "warning", text)
    scales: dict[tuple[str, float], list[float]] = {}
    for sensor_of_column in config.sensors:
        if not sensor_of_column.bend_sign:
            key = sensor_of_column.kind, sensor_of_column.angle_deg
            scales.setdefault(key, []).append(sensor_of_column.raw_scale)
    for (kind, angle_deg), column in scales.items():
        minority, sign = min((sum(s > 0 for s in column), 1), (sum(s < 0 for s in column), -1))
        if minority:
            places = ", ".join(str(k) for k, s in enumerate(column) if s * sign > 0)
            text = (
                f"scales of both signs: those of {kind} {places} (0 = at the base) differ from the "
                "others'; correct them, unless these sensors lie the other way up"
            )
            yield Finding(f"column {config.column_name(angle_deg)}", "warning", text)


def _healthy_on_board(config: RobotConfig) -> list[tuple[str, BoardSensor]]:
    """The healthy sensors that the board reads, by name."""
    count_by_angle: dict[float, int] = {}
    healthy = []
    for sensor in config.board_sensors:
        angle_deg = sensor.angle_deg
        k = count_by_angle[angle_deg] = count_by_angle.get(angle_deg, -1) + 1
        if sensor.healthy:
            healthy.append((f"{config.column_name(angle_deg)} {k}", sensor))
    return healthy


def _rates(wiring: Wiring) -> Iterator[Finding]:
    """The rate of each kind of channel, by the schedule of firmware/core/board.h."""
    conversions = 2 ** PARAMETERS["oversample_log2"].defaults[0]
    base_hz, other_hz = _TICKS_HZ / conversions, _TICKS_HZ / 2 / conversions
    wired = len(wiring.config.board_sensors)
    if not wired:
        return
    base_count = len(wiring.base_inputs)
    text = f"base sensors ({base_count}) {base_hz:.1f} Hz, "
    if other_count := wired - base_count:
        text += f"the others ({other_count}) {other_hz:.1f} Hz, "
    yield Finding("rates", "ok", f"{text}pressures {_TICKS_HZ} Hz")


def _imus(config: RobotConfig) -> Iterator[Finding]:
    """The load of the IMUs' bus, and whether the first IMU can serve the contact trigger."""
    imus = [sensor for sensor in config.sensors if sensor.imu_inputs]
    if not imus:
        return
    imu_ms = 1e3 * IMU_BITS / _BUS_HZ
    busy = len(imus) * imu_ms * _REPORTS_HZ / 1e3
    text = (
        f"{len(imus)} IMUs behind a multiplexer, {imu_ms:.2f} ms each at {_BUS_HZ // 1000} kHz: "
        f"all in {len(imus) * imu_ms:.1f} ms, so {_REPORTS_HZ} reports a second of each keep the "
        f"bus busy for {100 * busy:.0f} % of the time"
    )
    yield Finding("bus", "ok" if busy < 1.0 else "bad", text)
    base = min(imus, key=lambda sensor: sensor.center_cm)
    if any(config.sensors_for(side)[:1] == [base] for side in config.sides):
        contact_rad, error_rad = TRIGGER_PER_CM * base.span_cm, base.reading_se * base.span_cm
        clear = contact_rad / error_rad >= _TRIGGER_SIGMAS
        text = (
            f"works on the turn of the first {base.span_cm:g} cm: a contact takes "
            f"{degrees(contact_rad):.1f} degrees of it, and its IMU is known to "
            f"{degrees(error_rad):.2f}"
        )
        yield Finding("trigger", "ok" if clear else "bad", text)


def _fibre(config: RobotConfig) -> Iterator[Finding]:
    """The error of a fibre's readings beside the contact trigger's threshold."""
    if not config.gratings:
        return
    worst = max(config.gratings, key=lambda sensor: sensor.reading_se)
    text = (
        f"{len(config.gratings)} readings, each known to {worst.reading_se:.1e} 1/cm, of which "
        f"{worst.temperature_se:.1e} are the temperature's, in all alike; a contact of "
        f"{TRIGGER_PER_CM:g} 1/cm strains by {TRIGGER_PER_CM / abs(worst.raw_scale):.0f} "
        "microstrain"
    )
    yield Finding("fibre", "ok", text)
