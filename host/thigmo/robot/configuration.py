"""robot.toml in the board's own units, sent to the board, read back and stored.

The board ends up holding exactly what robot.toml says, or the operator hears which value it
does not take.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, radians, sin
from typing import TYPE_CHECKING

from thigmo.errors import CommandRefusedError, ConfigError
from thigmo.link import protocol as wire
from thigmo.sensors import imu_ends
from thigmo.wiring import Wiring

if TYPE_CHECKING:
    from thigmo.link.client import Client

_BOARD_DIVIDER_OHM = 22_000.0  # the divider that the firmware's arithmetic assumes
_AT_REST = 1 << 7  # of trigger_when: while no muscle bends the body
_PRESSURE_MARGIN_PSI = 0.5  # regulation overshoots; the set point itself never exceeds the muscle's


def parameter_settings(wiring: Wiring) -> dict[str, list[int]]:
    """The schema's parameters that robot.toml decides, by name, in wire units.

    One value for each sensor's input, and the first ones of other arrays.
    """
    config, flex = wiring.config, wiring.sensors
    board, spool, body = config.board, config.spool, config.body
    pulls = [round(pressure.pull_duty) for pressure in body.pressures]
    highest_psi = max((muscle.max_pressure_psi for muscle in config.muscles), default=0.0)
    limit_psi = min(highest_psi + _PRESSURE_MARGIN_PSI, board.pressure_range_psi)
    # Resistance is proportional to the divider's resistor, so another divider is another scale.
    ratio = board.divider_ohm / _BOARD_DIVIDER_OHM
    muscles = config.muscles
    begins, ends = imu_ends(flex)
    imus = {"imu_from": begins, "imu_to": ends} if wiring.size.imus else {}
    return imus | {
        "flex_enabled": [int(s is not None and s.healthy) for s in flex],
        "flex_center_um": [round(s.passes_at.center_cm * 1e4) if s else 0 for s in flex],
        "flex_center_se_um": [round(s.passes_at.center_se_cm * 1e4) if s else 0 for s in flex],
        "unseen_mask": [sum(1 << n for n, s in enumerate(flex) if s and not s.passes_at.is_shown)],
        "flex_span_um": [round(s.passes_at.span_cm * 1e4) if s else 0 for s in flex],
        "flex_scale": [round(s.raw_scale * ratio * 1e9) if s else 0 for s in flex],
        "settle_ms": [round(board.settle_s * 1e3)],
        "max_pressure_cpsi": [
            max(round(limit_psi * 100), wire.PARAMETERS["max_pressure_cpsi"].low)
        ],
        "over_pressure_cpsi": [round(board.over_pressure_psi * 100)],
        "pressure_full_cpsi": [round(board.pressure_sensor_psi * 100)],
        "drive_20ma_cpsi": [round(board.transducer_psi * 100)],
        "map_top_cpsi": [round(board.pressure_range_psi * 100)],
        "grows": [int(body.grows)],
        "lag_ms": [round(m.lag_s * 1e3) for m in muscles],
        "reversal_cpsi": [round(m.reversal_psi * 100) for m in muscles],
        "full_length_um": [round(body.length_cm * 1e4)],
        "counts_per_m": [round(spool.counts_per_cm * 100)],
        "payout_q8": [round(spool.payout_ratio * 256)],
        "spool_speed_um_s": [round(spool.max_speed_cm_s * 1e4)],
        "spool_accel_um_s2": [round(spool.acceleration_cm_s2 * 1e4)],
        "line_speed_um_s": [round(spool.line_speed_cm_s * 1e4)],
        "pull_duty": pulls,
        "body_pull_n": [ceil(max(body.pull_n(entry.pressure_psi) for entry in body.pressures))],
        "fold_swing_e5": [_limited("fold_swing_e5", body.fold_swing * 1e5)],
        "motor_stall_n": [round(spool.stall_n)],
        "line_rating_n": [round(spool.line_rating_n)],
        "brake_fitted": [int(body.grows and spool.brake)],
        "brake_closes_ms": [round(spool.brake_closes_s * 1e3)],
        "muscle_fitted": [1] * len(muscles),
        "trigger_when": [
            _counts_while(wiring, number) if number in wiring.base_inputs else 0
            for number in range(len(flex))
        ],
    }


def _limited(name: str, value: float) -> int:
    """A parameter's value, within its limits."""
    row = wire.PARAMETERS[name]
    return min(max(round(value), row.low), row.high)


def _counts_while(wiring: Wiring, base_input: int) -> int:
    """Bits of trigger_when of a base sensor: at rest, and while a muscle that it guards bends."""
    guarded = (
        1 << number
        for number, muscle in enumerate(wiring.config.muscles)
        if any(base.number == base_input for base in wiring.trigger_sensors(muscle))
    )
    return _AT_REST | sum(guarded)


def map_settings(wiring: Wiring) -> list[wire.SetMap]:
    """The free-curvature maps of robot.toml: body pressure x muscle x branch, signed.

    The board compares a bend with the base sensors that guard it, so its maps are the share that
    these read; of a muscle that none guards, the share in the plane.
    """
    points = range(wire.MAP_POINTS)
    top_psi = wiring.config.board.pressure_range_psi
    pressures_psi = [top_psi * point / points[-1] for point in points]
    settings = []
    for body_pressure in range(len(wiring.config.body.pressures)):
        for number, muscle in enumerate(wiring.config.muscles):
            shares = [base.share for base in wiring.trigger_sensors(muscle)]
            share = shares[0] if shares else sin(radians(muscle.angle_deg))
            for branch in wire.Branch:
                curve = getattr(muscle.maps[body_pressure], branch.key)
                wired = tuple(round(share * curve.curvature(p) * 1e5) for p in pressures_psi)
                settings.append(wire.SetMap(body_pressure, number, branch, wired))
    return settings


def send_config(client: Client, wiring: Wiring) -> bool:
    """Make the board's parameters and maps those of robot.toml; whether any of them changed.

    Raises ConfigError for another board than the robot needs, and for a value that the board cannot
    hold or does not give back.
    """
    has, size, muscles = client.capacity, wiring.size, wiring.config.muscles
    if (has.muscles, has.sensors, has.body_pressures, has.imus) != (*size.capacity.values(),):
        raise ConfigError(
            f"the board is built for {has.muscles} muscles, {has.sensors} sensors and "
            f"{has.body_pressures} body pressures, and this robot needs one for {size.muscles}, "
            f"{size.sensors} and {size.body_pressures} ({size.name})",
            "use that board, or another robot.toml: see `thigmo robot check robot.toml`",
        )
    wanted = {
        name: [*values, *[0] * (client.parameters[name].count - len(values))]
        for name, values in parameter_settings(wiring).items()
    }
    # What hangs on no output keeps what it has.
    for name in ("lag_ms", "reversal_cpsi"):
        wanted[name][len(muscles) :] = get_parameter(client, name)[len(muscles) :]
    differing = {name: v for name, v in wanted.items() if get_parameter(client, name) != v}
    if differing:
        set_parameters(client, differing)
        for name, values in differing.items():
            _verify(f"parameter {name}", get_parameter(client, name), values)
    changed = bool(differing)
    for setting in map_settings(wiring):
        where = wire.GetMap(setting.zone, setting.muscle, setting.branch)
        if client.request(where).curvature_e5 != setting.curvature_e5:
            changed = True
            client.request(setting)
            muscle_name = muscles[setting.muscle].name
            map_name = f"the map of body pressure {setting.zone}, muscle {muscle_name}"
            _verify(map_name, client.request(where).curvature_e5, setting.curvature_e5)
    return changed


def get_parameter(client: Client, name: str) -> list[int]:
    """A parameter as the board holds it, in its wire unit, one value for each element."""
    entry = _row(client, name)
    return [client.request(wire.GetParameter(entry.index + i)).value for i in range(entry.count)]


def set_parameters(client: Client, wanted: dict[str, list[int]]) -> None:
    """Set parameters in the board's memory; all of them run from then on, or none.

    They are in wire units, by the schema's names: one value for each element, or one for all.
    Raises ConfigError for a wrong name or number of values, one out of range, or values that
    contradict each other or those that the board holds.
    """
    for name, values in wanted.items():
        entry = _row(client, name)
        if len(values) not in (1, entry.count):
            raise ConfigError(
                f"{name} holds {entry.count} values, and {len(values)} were given",
                "give one for all, or all of them",
            )
        for problem in out_of_range(entry, values):
            raise ConfigError(
                problem,
                "correct the value that it comes from, in robot.toml or on the command line",
            )
        for element in range(entry.count):
            value = values[element % len(values)]
            client.request(wire.SetParameter(entry.index + element, value))
    try:
        client.request(wire.ApplyParameters())
    except CommandRefusedError as error:
        if error.reason != wire.Reason.CONTRADICTION.key:
            raise
        name = next(
            n for n, p in client.parameters.items() if p.index <= error.detail < p.index + p.count
        )
        raise ConfigError(
            f"{name} contradicts other parameters, and nothing was changed",
            f"see what bounds it: {client.parameters[name].doc.rstrip('.')}",
        ) from error


def out_of_range(entry: wire.Parameter, values: Sequence[int]) -> list[str]:
    """What a parameter of the board cannot hold of these values, which are in its wire unit."""
    limits = f"{entry.low}..{entry.high} {entry.unit}".rstrip()
    return [
        f"{entry.name} must lie in {limits}, not {value}"
        for value in values
        if not entry.low <= value <= entry.high
    ]


def check_name(name: str) -> None:
    """Raise ConfigError unless some board has a parameter of that name."""
    if name not in wire.PARAMETER_NAMES.values():
        raise ConfigError(
            f"no parameter {name!r}", "see `thigmo params --robot URL` for their names"
        )


def _row(client: Client, name: str) -> wire.Parameter:
    """Its row in the board's table; ConfigError if this board has none of that name."""
    check_name(name)
    if name not in client.parameters:
        raise ConfigError(
            f"this board has no parameter {name}: it is built for a robot without that part",
            "see `thigmo params --robot URL` for those that it has",
        )
    return client.parameters[name]


def _verify(subject: str, got: object, wanted: object) -> None:
    if got != wanted:
        raise ConfigError(
            f"the board holds {got} instead of {wanted} for {subject}",
            "check that firmware and host are of the same version",
        )
