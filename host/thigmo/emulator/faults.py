"""Faults that a scene injects, from a moment or a condition on, for a while or for good.

The defaults below say what `value` means. pressure_stuck and over_pressure are faults of the air;
the other pressure faults are of the sensor. A sensor that flickers shows at most `value`, except
for 20 ms of each second, in which it shows the truth. The wire of one that chatters is open for the
share `value` of the time. imu_hung stops the IMU at a span's far end, so no span that begins or
ends there is read. For a grating, `sensor` is the number of its reading, base first. host_silent
loses the host's bytes and heartbeats. power_cut takes the board's power for `duration_s` (default
1 s).
"""

from __future__ import annotations

import math

from thigmo.emulator.board import EmulatedBoard
from thigmo.emulator.plant import OPEN_COUNT, SHORT_COUNT, Plant
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.link.protocol import ResetCause

_POWER_OFF_S = 1.0
# `value` where a scene gives none. Of pressure_stuck and pressure_frozen it is the pressure there.
_DEFAULTS = {
    "over_pressure": 30.0,  # psi
    "pressure_gain": 0.75,
    "pressure_offset": -3.0,  # psi
    "pressure_noisy": 1.0,  # psi, one sigma
    "pressure_flickers": 2.0,  # psi
    "pressure_chatters": 0.5,  # of the time
    "flex_noisy": 40.0,  # counts, one sigma
    "grating_noisy": 200.0,  # microstrain, one sigma
    "motor_shorted": 800.0,  # duty
    "encoder_share": 0.7,  # of the counts are seen
    "reference_off": 0.8,  # of the converter's reference remains
    "spool_slip": 2.0,  # cm/s of line to which a failing brake lets it run
    "brown_out": 3800.0,  # mV
    "power_cut_saving": 100.0,  # bytes written before the cut
}


class FaultInjector:
    """Watches the plant and starts and ends the scene's faults."""

    def __init__(self, scene: Scene) -> None:
        self.host_silent = False  # the host's bytes and heartbeats are to be dropped
        self.powered = True  # the board runs
        self.active: set[str] = set()  # kinds of the faults that hold now
        self._supply = scene.supply.millivolt
        self._waiting = list(scene.faults)
        self._running: list[tuple[float, FaultTable]] = []

    def inject(self, fault: FaultTable) -> None:
        """Add a fault while running."""
        self._waiting.append(fault)

    def update(self, plant: Plant, board: EmulatedBoard) -> None:
        """Start and end the faults that are due. Call before each plant step."""
        for end, fault in list(self._running):
            if plant.t_s >= end:
                self._running.remove((end, fault))
                self._set(fault, plant, board, present=False)
        for fault in list(self._waiting):
            if self._begins(fault, plant, board):
                self._waiting.remove(fault)
                self._set(fault, plant, board, present=True)
                lasts = fault.duration_s
                if fault.kind == "power_cut" and lasts is None:
                    lasts = _POWER_OFF_S
                self._running.append((plant.t_s + (lasts or math.inf), fault))

    @staticmethod
    def _begins(fault: FaultTable, plant: Plant, board: EmulatedBoard) -> bool:
        return (
            (fault.at_s is None or plant.t_s >= fault.at_s)
            and (fault.above_length_cm is None or plant.length_cm > fault.above_length_cm)
            and (
                fault.above_pressure_psi is None or max(plant.muscle_psi) > fault.above_pressure_psi
            )
            and (not fault.while_motor_runs or board.motor != 0)
        )

    @staticmethod
    def _hold(where: dict[int, float], channel: int, value: float, present: bool) -> None:
        if present:
            where[channel] = value
        else:
            where.pop(channel, None)

    def _set(self, fault: FaultTable, plant: Plant, board: EmulatedBoard, *, present: bool) -> None:
        (self.active.add if present else self.active.discard)(fault.kind)
        robot = plant.scene.robot
        muscle = next((n for n, m in enumerate(robot.muscles) if m.side == fault.side), 0)
        flex = fault.kind.startswith("flex")
        channel = (
            plant.wiring.inputs[fault.side, fault.sensor]
            if flex
            else plant.pressure_channel + muscle
        )
        value = _DEFAULTS.get(fault.kind, 0.0) if fault.value is None else fault.value
        match fault.kind:
            case "flex_wire_cut" | "pressure_wire_cut":
                self._hold(plant.stuck, channel, OPEN_COUNT, present)
            case "flex_short" | "pressure_short":
                self._hold(plant.stuck, channel, SHORT_COUNT, present)
            case "flex_frozen":
                self._hold(plant.stuck, channel, float(plant.analog[channel, 1]), present)
            case "flex_noisy":
                self._hold(plant.flex_noise, channel, value, present)
            case "imu_hung":
                end_cm = robot.column(fault.side)[fault.sensor].passes_at.center_cm
                (plant.imus.hung.add if present else plant.imus.hung.discard)(
                    plant.imus.imu_at(end_cm)
                )
            case "grating_lost":
                lost = plant.fibre.lost_gratings
                (lost.add if present else lost.discard)(fault.sensor)
            case "grating_noisy":
                self._hold(plant.fibre.noisy, fault.sensor, value, present)
            case "interrogator_silent":
                plant.fibre.silent = present
            case "pressure_frozen":
                level = plant.pressure_reading[muscle] if fault.value is None else value
                plant.pressure_frozen[muscle] = level if present else math.nan
            case "pressure_gain" | "pressure_offset" | "pressure_noisy":
                neutral = 1.0 if fault.kind == "pressure_gain" else 0.0
                getattr(plant, fault.kind)[muscle] = value if present else neutral
            case "pressure_flickers":
                plant.pressure_most[muscle] = value if present else math.inf
            case "pressure_chatters":
                self._hold(plant.chatters, channel, value, present)
            case "pressure_stuck":
                level = plant.muscle_psi[muscle] if fault.value is None else value
                plant.forced_outlet[muscle] = level if present else math.nan
            case "over_pressure":
                plant.forced_outlet[muscle] = value if present else math.nan
            case "air_lost":
                plant.forced_outlet[:] = 0.0 if present else math.nan
            case "motor_shorted":
                plant.motor_forced = int(value) if present else None
            case "motor_lost" | "spool_stall":
                setattr(plant, fault.kind, present)
            case "encoder_lost" | "encoder_share":
                plant.encoder_share = value if present else 1.0
            case "tail_jam":
                plant.tail_jammed = present
            case "line_snapped":
                plant.line_snapped = present
            case "brake_open" | "brake_closed":
                plant.brake_stuck = (fault.kind == "brake_open") if present else None
            case "contact_welded":
                plant.contact_welded = present
            case "reference_off":
                # The supply is measured by the same converter, and seems less by as much.
                plant.reference = value if present else 1.0
                board.set_supply_mv(round(self._supply * plant.reference))
            case "spool_slip":
                plant.slip_cm_s = value if present else 0.0
            case "host_silent":
                self.host_silent = present
            case "brown_out":
                board.set_supply_mv(int(value) if present else self._supply)
            case "power_cut":
                self.powered = not present
                if not present:
                    board.reset(int(ResetCause.POWER_ON))
            case "power_cut_saving" if present:
                board.cut_power_after(int(value))
            case "power_cut_saving":
                board.reset(int(ResetCause.POWER_ON))
            case "estop":
                board.set_estop(present)
                plant.estop = present
            case "hang" if present:
                board.hang()
