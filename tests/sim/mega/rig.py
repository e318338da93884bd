"""A robot on the simulated Mega, ready to be harmed."""

from __future__ import annotations

from dataclasses import dataclass

from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.emulator.usb_bridge import UsbBridge
from thigmo.link.client import Client
from thigmo.robot.robot import Robot


@dataclass
class Rig:
    """Board, connection and robot."""

    mega: SimulatedMega
    transport: EmulatorTransport
    client: Client
    robot: Robot

    def pass_ms(self, milliseconds: int) -> None:
        """Let time pass; what the board says is kept for the client."""
        self.transport.pass_time(milliseconds / 1000)

    def until_off(self, limit_ms: int) -> int:
        """Milliseconds (in steps of 10) until valves carry nothing and the motor is braked."""
        for waited in range(0, limit_ms, 10):
            if self.off:
                return waited
            self.pass_ms(10)
        raise AssertionError(f"outputs are on after {limit_ms} ms")

    @property
    def off(self) -> bool:
        """Valves at true zero, motor braked."""
        mega = self.mega
        return mega.drive_enabled == (False, False) and mega.drive == (0, 0) and mega.braked


def open_rig(
    scene: Scene, eeprom: bytes, *, usb: UsbBridge | None = None, baud: int = 250_000
) -> Rig:
    """Connected; nothing asked of it yet."""
    mega = SimulatedMega(7, eeprom, usb=usb, baud=baud)
    transport = EmulatorTransport(scene, mega, seed=7, exchange_ms=1)
    client = Client(transport)
    return Rig(mega, transport, client, Robot(client))


def prepare(rig: Rig) -> None:
    """Length and zone known, armed, zeroed."""
    robot = rig.robot
    robot.wait(0.3)
    robot.set_parameter("drift_limit_e5", [5000])
    robot.set_parameter("zero_ms", [200])
    robot.confirm_length(rig.transport.lockstep.plant.length_cm, settled=True)
    robot.select_zone(2)
    robot.arm()
    robot.zero()
