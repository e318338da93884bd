"""robot.toml in the board's own units: which parameters and maps a configuration asks for.

Pure arithmetic between `RobotConfig` (cm, psi, 1/cm, ohm) and the integers of the protocol. The
robot object sends the result and reads it back; the emulator's tests compare both ends.
"""

from __future__ import annotations

from thigmo.config import SIDES, RobotConfig
from thigmo.link import protocol as wire
from thigmo.robot.readings import in_board_order

BOARD_DIVIDER_OHM = 22_000.0  # the divider that the firmware's arithmetic assumes
MAP_PRESSURES_PSI = tuple(float(p) for p in range(0, 21, 2))
_PRESSURE_MARGIN_PSI = 0.5  # regulation overshoots; the set point itself never exceeds the muscle's


def parameter_settings(config: RobotConfig) -> dict[str, list[int]]:
    """The schema's parameters that robot.toml decides, by name, in wire units.

    Raises ConfigError if there are more sensors than the board has channels for.
    """
    sensors, spool, body = config.sensors, config.spool, config.body
    flex = in_board_order(config)
    # Resistance is proportional to the divider's resistor, so another divider is another scale.
    ratio = sensors.divider_ohm / BOARD_DIVIDER_OHM
    muscles = [config.actuators.side(side) for side in SIDES]
    return {
        "flex_enabled": [int(s is not None and s.healthy) for s in flex],
        "flex_center_um": [round(s.center_cm * 1e4) if s else 0 for s in flex],
        "flex_span_um": [round(s.span_cm * 1e4) if s else 0 for s in flex],
        "flex_scale": [round(s.scale_per_ohm * ratio * 1e9) if s else 0 for s in flex],
        "settle_ms": [round(sensors.settle_s * 1e3)],
        "max_pressure_cpsi": [
            round((max(m.max_pressure_psi for m in muscles) + _PRESSURE_MARGIN_PSI) * 100)
        ],
        "lag_ms": [round(m.lag_s * 1e3) for m in muscles],
        "reversal_cpsi": [round(m.reversal_psi * 100) for m in muscles],
        "full_length_um": [round(body.length_cm * 1e4)],
        "pitch_um": [round(sensors.pitch_cm * 1e4)],
        "counts_per_m": [round(spool.counts_per_cm * 100)],
        "payout_q8": [round(spool.payout_ratio * 256)],
        "spool_speed_um_s": [round(spool.max_speed_cm_s * 1e4)],
        "spool_accel_um_s2": [round(spool.acceleration_cm_s2 * 1e4)],
    }


def map_settings(config: RobotConfig) -> list[wire.SetMap]:
    """The free-curvature maps of robot.toml: zone x side x branch, the right side negative."""
    found = []
    for zone in range(len(config.body.zones)):
        for side, sign in ((wire.Side.LEFT, 1), (wire.Side.RIGHT, -1)):
            maps = config.actuators.side(SIDES[side]).maps[zone]
            for branch, curve in enumerate((maps.inflate, maps.deflate)):
                curvature = tuple(round(sign * curve.curvature(p) * 1e5) for p in MAP_PRESSURES_PSI)
                found.append(wire.SetMap(zone, side, wire.Branch(branch), curvature))
    return found
