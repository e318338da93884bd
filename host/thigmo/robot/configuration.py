"""Parameters and maps on the board: sent, read back, stored.

The board ends up holding exactly what robot.toml says, or the operator is told which value it
does not take.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from thigmo.config import RobotConfig
from thigmo.errors import CommandRefusedError, ConfigError
from thigmo.link import protocol as wire
from thigmo.robot.settings import map_settings, parameter_settings

if TYPE_CHECKING:
    from thigmo.link.client import Client


def send_config(client: Client, config: RobotConfig) -> bool:
    """Make the board's parameters and maps those of robot.toml; whether any of them changed.

    Raises ConfigError for a value that the board cannot hold or does not give back,
    CommandRefusedError if an output is energised.
    """
    wanted_values = parameter_settings(config)
    differing = {n: v for n, v in wanted_values.items() if get_parameter(client, n) != v}
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
            got = client.request(where).curvature_e5
            what = f"the map of zone {setting.zone}, {setting.side.key}"
            _verify(what, got, setting.curvature_e5)
    return changed


def get_parameter(client: Client, name: str) -> list[int]:
    """A parameter as the board holds it, in its wire unit, one value for each element.

    Raises ConfigError if the schema has no such parameter.
    """
    entry = _named(name)
    return [client.request(wire.GetParameter(entry.index + i)).value for i in range(entry.count)]


def set_parameters(client: Client, wanted: dict[str, list[int]]) -> None:
    """Set parameters in the board's memory; all of them run from then on, or none.

    They are in wire units, by the schema's names: one value for each element, or one for all.

    Raises:
        ConfigError: no such parameter, a wrong number of values, one out of range, or values that
            contradict each other or those that the board holds.
    """
    for name, values in wanted.items():
        _stage(client, name, values)
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


def _stage(client: Client, name: str, values: list[int]) -> None:
    """Have the board check and keep a parameter until it is applied."""
    entry = _named(name)
    if len(values) not in (1, entry.count):
        raise ConfigError(
            f"{name} holds {entry.count} values, and {len(values)} were given",
            "give one for all, or all of them",
        )
    for value in values:
        if not entry.low <= value <= entry.high:
            raise ConfigError(
                f"{name} must lie in {entry.low}..{entry.high} {entry.unit}".rstrip()
                + f", not {value}",
                "correct the value that it comes from, in robot.toml or on the command line",
            )
    spread = values * entry.count if len(values) == 1 else values
    for index, value in enumerate(spread, start=entry.index):
        client.request(wire.SetParameter(index, value))


def _named(name: str) -> wire.Parameter:
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
