"""Board and plant in lockstep: the one loop that all emulated connections turn.

The plant advances in steps of 10 ms; within one, the board runs in exchanges (10 ms for the virtual
board, 1 ms for the simulated Mega) with analog levels and encoder linear in between. The board's
outputs at the end of one step drive the plant in the next.
"""

from __future__ import annotations

from thigmo.emulator.board import EmulatedBoard
from thigmo.emulator.faults import FaultInjector
from thigmo.emulator.plant import STEP_MS, Plant
from thigmo.emulator.scene import Scene
from thigmo.errors import ConfigError


class Lockstep:
    """A board inside a scene's plant, both random by `seed` (None takes the scene's).

    The board runs `exchange_ms` between exchanges, which divides 10.
    """

    def __init__(
        self,
        scene: Scene,
        board: EmulatedBoard,
        *,
        seed: int | None = None,
        exchange_ms: int = STEP_MS,
    ) -> None:
        if exchange_ms < 1 or STEP_MS % exchange_ms:
            raise ConfigError(f"an exchange of {exchange_ms} ms does not divide {STEP_MS} ms")
        self.scene = scene
        self.board = board
        self.plant = Plant(scene, seed)
        self.faults = FaultInjector(scene)
        self._exchange_ms = exchange_ms
        board.set_adc_noise(self.plant.adc_noise())
        board.set_supply_mv(scene.supply.millivolt)
        board.set_estop(False)

    @property
    def t_s(self) -> float:
        """Virtual time since the start."""
        return self.plant.t_s

    def advance(self) -> None:
        """One plant step of 10 ms."""
        plant, board = self.plant, self.board
        self.faults.update(plant, board)
        if not self.faults.powered:
            muscles = len(plant.muscle_psi)
            plant.step((0,) * muscles, (False,) * muscles, 0, True)
            return
        plant.step(
            board.drive, board.drive_enabled, board.motor, board.braked, board.air,
            board.motor_enables,
        )  # fmt: skip
        board.set_motor_power(plant.motor_power)
        if self._exchange_ms == STEP_MS:
            board.set_analog(plant.analog)
            board.set_encoder(*plant.encoder)
            board.step(STEP_MS)
            return
        begin, change = plant.analog[:, :1], plant.analog[:, 1:] - plant.analog[:, :1]
        start, end = plant.encoder
        for offset_ms in range(0, STEP_MS, self._exchange_ms):
            a, b = offset_ms / STEP_MS, (offset_ms + self._exchange_ms) / STEP_MS
            levels = begin + change * [[a, b]]
            board.set_analog(levels)
            board.set_encoder(start + a * (end - start), start + b * (end - start))
            board.step(self._exchange_ms)
