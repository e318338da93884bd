"""robot.toml in the board's own units, sent to the board, read back and stored.

The board ends up holding exactly what robot.toml says, or the operator is told which value it
does not take.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from thigmo import wiring
from thigmo.config import SIDES, SIGN, RobotConfig
from thigmo.errors import CommandRefusedError, ConfigError
from thigmo.link import protocol as wire

if TYPE_CHECKING:
    from thigmo.link.client import Client

_BOARD_DIVIDER_OHM = 22_000.0  # the divider that the firmware's arithmetic assumes
_MAP_PSI = [point * wire.MAP_STEP_CPSI / 100 for point in range(wire.MAP_POINTS)]
_PRESSURE_MARGIN_PSI = 0.5  # regulation overshoots; the set point itself never exceeds the muscle's


def parameter_settings(config: RobotConfig) -> dict[str, list[int]]:
    """The schema's parameters that robot.toml decides, by name, in wire units."""
    board, spool, body = config.board, config.spool, config.body
    flex = wiring.sensors(config)
    pulls = [round(zone.pull_duty) for zone in body.zones]
    # Resistance is proportional to the divider's resistor, so another divider is another scale.
    ratio = board.divider_ohm / _BOARD_DIVIDER_OHM
    # An output and input without a muscle has the settings of the other's.
    muscles = [config.muscle(side if side in config.sides else config.sides[0]) for side in SIDES]
    return {
        "flex_enabled": [int(s is not None and s.healthy) for s in flex],
        "flex_center_um": [round(s.center_cm * 1e4) if s else 0 for s in flex],
        "flex_span_um": [round(s.span_cm * 1e4) if s else 0 for s in flex],
        "flex_scale": [round(s.scale_per_ohm * ratio * 1e9) if s else 0 for s in flex],
        "settle_ms": [round(board.settle_s * 1e3)],
        "max_pressure_cpsi": [
            round((max(m.max_pressure_psi for m in muscles) + _PRESSURE_MARGIN_PSI) * 100)
        ],
        "lag_ms": [round(m.lag_s * 1e3) for m in muscles],
        "reversal_cpsi": [round(m.reversal_psi * 100) for m in muscles],
        "full_length_um": [round(body.length_cm * 1e4)],
        "counts_per_m": [round(spool.counts_per_cm * 100)],
        "payout_q8": [round(spool.payout_ratio * 256)],
        "spool_speed_um_s": [round(spool.max_speed_cm_s * 1e4)],
        "spool_accel_um_s2": [round(spool.acceleration_cm_s2 * 1e4)],
        "line_speed_um_s": [round(spool.line_speed_cm_s * 1e4)],
        "pull_duty": [*pulls, *[0] * (wire.PARAMETERS["pull_duty"].count - len(pulls))],
        "motor_stall_n": [round(spool.stall_n)],
        "line_rating_n": [round(spool.line_rating_n)],
        "brake_fitted": [int(spool.brake)],
    }


def map_settings(config: RobotConfig) -> list[wire.SetMap]:
    """The free-curvature maps of robot.toml: zone x side x branch, signed."""
    found = []
    for zone in range(len(config.body.zones)):
        for number, side in enumerate(SIDES):
            for branch in wire.Branch:
                curvature = [0.0] * len(_MAP_PSI)  # without a muscle nothing bends
                if side in config.sides:
                    curve = getattr(config.muscle(side).maps[zone], branch.key)
                    curvature = [SIGN[side] * curve.curvature(p) for p in _MAP_PSI]
                wired = tuple(round(each * 1e5) for each in curvature)
                found.append(wire.SetMap(zone, wire.Side(number), branch, wired))
    return found


def send_config(client: Client, config: RobotConfig) -> bool:
    """Make the board's parameters and maps those of robot.toml; whether any of them changed.

    Raises ConfigError for a value that the board cannot hold or does not give back.
    """
    wanted = parameter_settings(config)
    differing = {name: v for name, v in wanted.items() if get_parameter(client, name) != v}
    if differing:
        set_parameters(client, differing)
        for name, values in differing.items():
            _verify(f"parameter {name}", get_parameter(client, name), values)
    changed = bool(differing)
    for setting in map_settings(config):
        where = wire.GetMap(setting.zone, setting.side, setting.branch)
        if client.request(where).curvature_e5 != setting.curvature_e5:
            changed = True
            client.request(setting)
            what = f"the map of zone {setting.zone}, {setting.side.key}"
            _verify(what, client.request(where).curvature_e5, setting.curvature_e5)
    return changed


def get_parameter(client: Client, name: str) -> list[int]:
    """A parameter as the board holds it, in its wire unit, one value for each element."""
    entry = named(name)
    return [client.request(wire.GetParameter(entry.index + i)).value for i in range(entry.count)]


def set_parameters(client: Client, wanted: dict[str, list[int]]) -> None:
    """Set parameters in the board's memory; all of them run from then on, or none.

    They are in wire units, by the schema's names: one value for each element, or one for all.
    Raises ConfigError for a wrong name or number of values, one out of range, or values that
    contradict each other or those that the board holds.
    """
    for name, values in wanted.items():
        entry = named(name)
        if len(values) not in (1, entry.count):
            raise ConfigError(
                f"{name} holds {entry.count} values, and {len(values)} were given",
                "give one for all, or all of them",
            )
        for value in values:
            if not entry.low <= value <= entry.high:
                limits = f"{entry.low}..{entry.high} {entry.unit}".rstrip()
                raise ConfigError(
                    f"{name} must lie in {limits}, not {value}",
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
            n for n, p in wire.PARAMETERS.items() if p.index <= error.detail < p.index + p.count
        )
        raise ConfigError(
            f"{name} contradicts other parameters, and nothing was changed",
            f"see what bounds it: {wire.PARAMETERS[name].doc.rstrip('.')}",
        ) from error


def named(name: str) -> wire.Parameter:
    """A parameter's row in the schema; ConfigError if there is none of that name."""
    if name not in wire.PARAMETERS:
        raise ConfigError(
            f"no parameter {name!r}", "see `thigmo params --robot URL` for their names"
        )
    return wire.PARAMETERS[name]


def _verify(what: str, got: object, wanted: object) -> None:
    if got != wanted:
        raise ConfigError(
            f"the board holds {got} instead of {wanted} for {what}",
            "check that firmware and host are of the same version",
        )
