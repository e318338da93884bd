"""Faults that a scene injects, from a moment or a condition on, for a while or for good.

What `value` means: over_pressure, psi (default 30); pressure_stuck, psi (default: where it is).
Those are the air's; of the sensor are pressure_frozen, psi (default: what it reads), pressure_gain
(default 0.75), pressure_offset, psi (default -3), and pressure_noisy, psi of one sigma (default 1).
flex_noisy, counts of one sigma (default 40); motor_shorted, duty (default 800);
spool_slip, cm/s of line to which a failing brake lets it run (default 2); brown_out, mV (default
3800); power_cut_saving, bytes written before the cut (default 100). host_silent mutes the host: its
bytes and heartbeats are lost.
power_cut takes the board's power for `duration_s` (default 1 s).
"""

from __future__ import annotations

import math

from thigmo.config import SIDES
from thigmo.emulator.board import FLEX_RIGHT, Board
from thigmo.emulator.plant import Plant
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.link.protocol import ResetCause

_POWER_OFF_S = 1.0


class FaultInjector:
    """Watches the plant and starts and ends the scene's faults.

    Attributes:
        host_silent: the host's bytes and heartbeats are to be dropped.
        powered: the board runs.
        active: kinds of the faults that hold now.
    """

    def __init__(self, scene: Scene) -> None:
        self.host_silent = False
        self.powered = True
        self.active: set[str] = set()
        self._supply = scene.supply.millivolt
        self._waiting = list(scene.faults)
        self._running: list[tuple[float, FaultTable]] = []

    def inject(self, fault: FaultTable) -> None:
        """Add a fault while running (tests do)."""
        self._waiting.append(fault)

    def update(self, plant: Plant, board: Board) -> None:
        """Start and end what is due. Called before each plant step."""
        if self._running:
            for end, fault in list(self._running):
                if plant.t_s >= end:
                    self._running.remove((end, fault))
                    self._set(fault, plant, board, on=False)
        if self._waiting:
            for fault in list(self._waiting):
                if self._begins(fault, plant, board):
                    self._waiting.remove(fault)
                    self._set(fault, plant, board, on=True)
                    lasts = fault.duration_s
                    if fault.kind == "power_cut" and lasts is None:
                        lasts = _POWER_OFF_S
                    self._running.append((plant.t_s + (lasts or math.inf), fault))

    @staticmethod
    def _begins(fault: FaultTable, plant: Plant, board: Board) -> bool:
        return (
            (fault.at_s is None or plant.t_s >= fault.at_s)
            and (fault.above_length_cm is None or plant.length_cm > fault.above_length_cm)
            and (
                fault.above_pressure_psi is None or max(plant.muscle_psi) > fault.above_pressure_psi
            )
            and (not fault.while_motor_runs or board.motor != 0)
        )

    @staticmethod
    def _hold(where: dict[int, float], sensor: int, value: float, on: bool) -> None:
        if on:
            where[sensor] = value
        else:
            where.pop(sensor, None)

    def _set(self, fault: FaultTable, plant: Plant, board: Board, *, on: bool) -> None:
        side = SIDES.index(fault.side)
        sensor = FLEX_RIGHT * side + fault.sensor
        value = fault.value
        (self.active.add if on else self.active.discard)(fault.kind)
        match fault.kind:
            case "flex_wire_cut":
                (plant.cut.add if on else plant.cut.discard)(sensor)
            case "flex_frozen":
                self._hold(plant.flex_frozen, sensor, float(plant.analog[sensor, 1]), on)
            case "flex_noisy":
                self._hold(plant.flex_noise, sensor, 40.0 if value is None else value, on)
            case "pressure_short":
                (plant.pressure_shorted.add if on else plant.pressure_shorted.discard)(side)
            case "pressure_frozen":
                here = plant.pressure_seen[side] if value is None else value
                plant.pressure_frozen[side] = here if on else math.nan
            case "pressure_gain":
                plant.pressure_gain[side] = (0.75 if value is None else value) if on else 1.0
            case "pressure_offset":
                plant.pressure_offset[side] = (-3.0 if value is None else value) if on else 0.0
            case "pressure_noisy":
                plant.pressure_noise[side] = (1.0 if value is None else value) if on else 0.0
            case "motor_lost":
                plant.windings_open = on
            case "motor_shorted":
                plant.motor_forced = int(800 if value is None else value) if on else None
            case "encoder_lost":
                plant.encoder_lost = on
            case "flex_short":
                (plant.shorted.add if on else plant.shorted.discard)(sensor)
            case "pressure_wire_cut":
                (plant.pressure_cut.add if on else plant.pressure_cut.discard)(side)
            case "pressure_stuck":
                here = plant.muscle_psi[side] if value is None else value
                plant.forced_outlet[side] = here if on else math.nan
            case "over_pressure":
                plant.forced_outlet[side] = (30.0 if value is None else value) if on else math.nan
            case "air_lost":
                plant.forced_outlet[:] = 0.0 if on else math.nan
            case "spool_stall":
                plant.spool_stuck = on
            case "spool_slip":
                plant.slip_cm_s = (2.0 if value is None else value) if on else 0.0
            case "host_silent":
                self.host_silent = on
            case "brown_out":
                board.set_supply_mv(int(3800 if value is None else value) if on else self._supply)
            case "power_cut":
                self.powered = not on
                if not on:
                    board.reset(int(ResetCause.POWER_ON))
            case "power_cut_saving":
                if on:
                    board.cut_power_after(int(100 if value is None else value))
                else:
                    board.reset(int(ResetCause.POWER_ON))
            case "estop":
                board.set_estop(on)
            case "hang":
                if on:
                    board.hang()
