"""Asks about values of robot.toml that are likely in another unit than the file's.

Each entry alone may have almost any value; together they obey physics. A tube folds where the
moment reaches that of its pressure, so its stiffness follows from radius, pressure and fold. A
flex sensor's resistance doubles in about a right angle, whatever its size. A muscle must be able to
reach the pressures of its transducer, and a spool's counts those of encoders that are sold. What
lies beyond is asked about; the bands are wide enough for every robot that was described so far.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

from thigmo.config import RobotConfig
from thigmo.design.finding import Finding
from thigmo.link.protocol import PARAMETERS
from thigmo.robot import TRIGGER_PER_CM
from thigmo.sensors.flex import FlexSensor

_N_CM2_PER_PSI = 0.6894757  # N per cm2
# Strain of the tube's wall where it folds, critical curvature times radius: 2 % of the thesis's.
_FOLD_STRAIN = (0.004, 0.15)
_STIFFNESS = 4.0  # times more or less than fold, pressure and radius say
# Turn in which a flex sensor's resistance doubles: about 90 degrees (docs/hardware/facts.md).
_DOUBLING_RAD = (0.5, 8.0)
# x4 counts per cm of line: encoders of 240 to 840 counts a turn on spools of 2 to 4 cm.
_COUNTS_PER_CM = (25.0, 200.0)
_PRESSURES = 4.0  # between the fold's pressure and the nearest that is set
_PROOF_N = 20.0  # with which the motor tries the brake (firmware/core/controller.h)


def _psi(name: str) -> float:
    """The board's default of a parameter in 0.01 psi."""
    return PARAMETERS[name].defaults[0] / 100


def unit_questions(config: RobotConfig) -> Iterator[Finding]:
    """A warning for each entry that is likely in another unit, with what it should be near."""
    yield from _body(config)
    yield from _muscles(config)
    yield from _sensors(config)
    if config.body.grows:
        yield from _spool(config)


def _question(entry: str, value: float, says: str, unit: str) -> Finding:
    text = f"{entry} = {value:g}: {says}; is it in {unit}?"
    return Finding("units", "warning", text)


def _body(config: RobotConfig) -> Iterator[Finding]:
    if config.body.folds:
        yield from _fold(config)
    body = config.body
    if body.grows and not body.radius_cm <= body.pitch_cm <= body.length_cm:
        says = f"a pouch is longer than the tube's radius and shorter than {body.length_cm:g} cm"
        yield _question("body.pitch_cm", body.pitch_cm, says, "cm")


def _fold(config: RobotConfig) -> Iterator[Finding]:
    body = config.body
    strain = body.critical_curvature * body.radius_cm
    if not _FOLD_STRAIN[0] <= strain <= _FOLD_STRAIN[1]:
        says = (
            f"the wall would be strained by {100 * strain:.2g} % where the tube of "
            f"{body.diameter_cm:g} cm folds, and tubes fold at {100 * _FOLD_STRAIN[0]:g} to "
            f"{100 * _FOLD_STRAIN[1]:g} %"
        )
        yield _question("body.critical_curvature", body.critical_curvature, says, "1/cm")
    elif body.stiffness_n_cm2 is not None:
        # At the fold EI times its curvature is the moment of the pressure, pi p r^3.
        pressure = _N_CM2_PER_PSI * body.critical_pressure_psi
        expected = pi * pressure * body.radius_cm**3 / body.critical_curvature
        if not expected / _STIFFNESS <= body.stiffness_n_cm2 <= expected * _STIFFNESS:
            says = (
                f"diameter_cm = {body.diameter_cm:g}, critical_pressure_psi = "
                f"{body.critical_pressure_psi:g} and critical_curvature = "
                f"{body.critical_curvature:g} together say about {expected:.2g} N cm2"
            )
            unit = "N cm2, and are those in cm (the diameter, not the radius), psi and 1/cm"
            yield _question("body.stiffness_n_cm2", body.stiffness_n_cm2, says, unit)
    set_psi = [pressure.pressure_psi for pressure in body.pressures]
    if not min(set_psi) / _PRESSURES <= body.critical_pressure_psi <= max(set_psi) * _PRESSURES:
        says = f"the body is set to {min(set_psi):g} to {max(set_psi):g} psi"
        yield _question("body.critical_pressure_psi", body.critical_pressure_psi, says, "psi")


def _muscles(config: RobotConfig) -> Iterator[Finding]:
    live_zero_psi = _psi("live_zero_cpsi")
    for number, muscle in enumerate(config.muscles):
        name = f"muscle[{number}]"
        if muscle.max_pressure_psi <= 2 * live_zero_psi:
            says = (
                f"a transducer reaches nothing below {live_zero_psi:g} psi, so nothing would bend"
            )
            yield _question(f"{name}.max_pressure_psi", muscle.max_pressure_psi, says, "psi")
        for place, muscle_map in enumerate(muscle.maps):
            scale = muscle_map.inflate.scale_psi
            if scale <= live_zero_psi / 2:
                says = (
                    f"its bend would be complete below the {live_zero_psi:g} psi of the "
                    "transducer's zero"
                )
                yield _question(f"{name}.map[{place}].inflate.scale_psi", scale, says, "psi")
            top = muscle_map.inflate.curvature(muscle.max_pressure_psi)
            if 0 < top < TRIGGER_PER_CM:
                says = (
                    f"the widest bend, {top:.2g} 1/cm, is less than the {TRIGGER_PER_CM:g} by "
                    "which a contact is felt"
                )
                entry = f"{name}.map[{place}].inflate.amplitude"
                yield _question(entry, muscle_map.inflate.amplitude, says, "1/cm")


def _sensors(config: RobotConfig) -> Iterator[Finding]:
    flex = [
        (f"sensor[{number}]", sensor)
        for number, sensor in enumerate(config.sensors)
        if isinstance(sensor, FlexSensor) and sensor.healthy
    ]
    implausible = []
    for name, sensor in flex:
        doubling = abs(sensor.scale_per_ohm) * sensor.zero_ohm * sensor.span_cm
        if sensor.span_cm and not _DOUBLING_RAD[0] <= doubling <= _DOUBLING_RAD[1]:
            implausible.append((name, sensor, doubling))
    if implausible:
        name, sensor, doubling = implausible[0]
        suffix = f" (and of {len(implausible) - 1} more)" if len(implausible) > 1 else ""
        says = (
            f"with zero_ohm = {sensor.zero_ohm:g} and span_cm = {sensor.span_cm:g} its resistance "
            f"would double in {doubling:.2g} rad, and flex sensors' does in about 1.6"
        )
        unit = "1/cm per ohm, and are those in ohm and cm"
        yield _question(f"{name}.scale_per_ohm{suffix}", sensor.scale_per_ohm, says, unit)
    negative = [name for name, sensor in flex if sensor.scale_per_ohm < 0]
    if len(flex) > 1 and len(negative) == len(flex):
        text = (
            f"the scale_per_ohm of all {len(flex)} flex sensors is negative: does the resistance "
            "of each fall when the body bends to the left (towards 90 degrees)? Readings must be "
            "positive there"
        )
        yield Finding("units", "warning", text)
    noisy = [n for n, s in enumerate(config.sensors) if s.healthy and s.noise >= TRIGGER_PER_CM]
    if noisy:
        says = f"a contact is felt from {TRIGGER_PER_CM:g} 1/cm on"
        yield _question(f"sensor[{noisy[0]}].noise", config.sensors[noisy[0]].noise, says, "1/cm")
    yield from _places(config, [sensor for _, sensor in flex])


def _places(config: RobotConfig, flex: list[FlexSensor]) -> Iterator[Finding]:
    """Whether every flex sensor would lie better if its centre were its start."""
    pitch = config.body.pitch_cm

    def crosses(start: float, span: float) -> bool:
        first, last = start + 1e-6, start + span - 1e-6
        return first < 0 or int(first // pitch) != int(last // pitch)

    fitting = [sensor for sensor in flex if sensor.span_cm < pitch]
    if len(fitting) < 2 or not config.body.grows:
        return
    if all(crosses(s.center_cm - s.span_cm / 2, s.span_cm) for s in fitting) and not any(
        crosses(s.center_cm, s.span_cm) for s in fitting
    ):
        says = (
            f"every flex sensor would cross an edge between two pouches of {pitch:g} cm, and none "
            "would if these were their starts"
        )
        yield _question("sensor[0].center_cm", fitting[0].center_cm, says, "cm, and the centre")


def _spool(config: RobotConfig) -> Iterator[Finding]:
    spool = config.spool
    low, high = _COUNTS_PER_CM
    if not low <= spool.counts_per_cm <= high:
        says = f"x4 counts per cm of line are usually {low:g} to {high:g}"
        unit = "counts per cm (not per turn), all four edges counted"
        yield _question("spool.counts_per_cm", spool.counts_per_cm, says, unit)
    top = spool.line_speed_cm_s / spool.payout_ratio
    if not top / 100 <= spool.max_speed_cm_s <= top:
        says = f"at full duty the tip moves at {top:.3g} cm/s (line_speed_cm_s over payout_ratio)"
        yield _question("spool.max_speed_cm_s", spool.max_speed_cm_s, says, "cm/s")
    if spool.payout_ratio < 1:
        says = "a tip that grows by 1 cm takes at least 1 cm of line, and 2 where the base feeds it"
        yield _question("spool.payout_ratio", spool.payout_ratio, says, "cm per cm")
    if spool.stall_n < _PROOF_N:
        says = f"the motor tries its brake with {_PROOF_N:g} N"
        yield _question("spool.stall_n", spool.stall_n, says, "N")
