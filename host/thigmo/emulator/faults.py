"""Faults that a scene injects, from a moment or a condition on, for a while or for good.

What `value` means stands beside its defaults below. pressure_stuck and over_pressure are faults of
the air, the other ones of pressure are the sensor's: one that flickers shows at most `value`, but
the truth for 20 ms of each second; the wire of one that chatters is open for that share of time.
imu_hung is of the IMU at a span's far end: no span that begins or ends there is read. The `sensor`
of a grating is its reading's number, base first. host_silent mutes the host: its bytes and
heartbeats are lost. power_cut takes the board's power for `duration_s` (default 1 s).
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
                self._set(fault, plant, board, on=False)
        for fault in list(self._waiting):
            if self._begins(fault, plant, board):
                self._waiting.remove(fault)
                self._set(fault, plant, board, on=True)
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
    def _hold(where: dict[int, float], channel: int, value: float, on: bool) -> None:
        if on:
            where[channel] = value
        else:
            where.pop(channel, None)

    def _set(self, fault: FaultTable, plant: Plant, board: EmulatedBoard, *, on: bool) -> None:
        (self.active.add if on else self.active.discard)(fault.kind)
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
                self._hold(plant.stuck, channel, OPEN_COUNT, on)
            case "flex_short" | "pressure_short":
                self._hold(plant.stuck, channel, SHORT_COUNT, on)
            case "flex_frozen":
                self._hold(plant.stuck, channel, float(plant.analog[channel, 1]), on)
            case "flex_noisy":
                self._hold(plant.flex_noise, channel, value, on)
            case "imu_hung":
                end_cm = robot.column(fault.side)[fault.sensor].passes_at.center_cm
                (plant.imus.hung.add if on else plant.imus.hung.discard)(plant.imus.imu_at(end_cm))
            case "grating_lost":
                lost = plant.fibre.lost_gratings
                (lost.add if on else lost.discard)(fault.sensor)
            case "grating_noisy":
                self._hold(plant.fibre.noisy, fault.sensor, value, on)
            case "interrogator_silent":
                plant.fibre.silent = on
            case "pressure_frozen":
                level = plant.pressure_reading[muscle] if fault.value is None else value
                plant.pressure_frozen[muscle] = level if on else math.nan
            case "pressure_gain" | "pressure_offset" | "pressure_noisy":
                neutral = 1.0 if fault.kind == "pressure_gain" else 0.0
                getattr(plant, fault.kind)[muscle] = value if on else neutral
            case "pressure_flickers":
                plant.pressure_most[muscle] = value if on else math.inf
            case "pressure_chatters":
                self._hold(plant.chatters, channel, value, on)
            case "pressure_stuck":
                level = plant.muscle_psi[muscle] if fault.value is None else value
                plant.forced_outlet[muscle] = level if on else math.nan
            case "over_pressure":
                plant.forced_outlet[muscle] = value if on else math.nan
            case "air_lost":
                plant.forced_outlet[:] = 0.0 if on else math.nan
            case "motor_shorted":
                plant.motor_forced = int(value) if on else None
            case "motor_lost" | "spool_stall":
                setattr(plant, fault.kind, on)
            case "encoder_lost" | "encoder_share":
                plant.encoder_share = value if on else 1.0
            case "tail_jam":
                plant.tail_jammed = on
            case "line_snapped":
                plant.line_snapped = on
            case "brake_open" | "brake_closed":
                plant.brake_stuck = (fault.kind == "brake_open") if on else None
            case "contact_welded":
                plant.contact_welded = on
            case "reference_off":
                # The supply is measured by the same converter, and seems less by as much.
                plant.reference = value if on else 1.0
                board.set_supply_mv(round(self._supply * plant.reference))
            case "spool_slip":
                plant.slip_cm_s = value if on else 0.0
            case "host_silent":
                self.host_silent = on
            case "brown_out":
                board.set_supply_mv(int(value) if on else self._supply)
            case "power_cut":
                self.powered = not on
                if not on:
                    board.reset(int(ResetCause.POWER_ON))
            case "power_cut_saving" if on:
                board.cut_power_after(int(value))
            case "power_cut_saving":
                board.reset(int(ResetCause.POWER_ON))
            case "estop":
                board.set_estop(on)
                plant.estop = on
            case "hang" if on:
                board.hang()
