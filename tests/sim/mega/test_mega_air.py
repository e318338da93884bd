"""The air enables of the real image: pins 24 and 26 toggle while air is wanted."""

from __future__ import annotations

from rig import open_rig

from thigmo.emulator.scene import Scene
from thigmo.link import protocol as wire


def test_pins_toggle_only_while_air_is_wanted(full_length: Scene, stored_config: bytes) -> None:
    rig = open_rig(full_length, stored_config)
    rig.robot.wait(0.3)
    assert rig.board.air == (False, False)
    rig.client.request(wire.Arm())
    rig.pass_ms(50)
    assert rig.board.air == (True, False)
    rig.client.request(wire.BodyAir(1))
    rig.pass_ms(50)
    assert rig.board.air == (True, True)
    edges, before = 0, rig.board.chip.output("A", 4)
    for _ in range(20):
        rig.board.step(1)
        level = rig.board.chip.output("A", 4)
        edges, before = edges + (level != before), level
    assert edges >= 10  # one a tick; a look a millisecond misses pairs of them
    rig.board.hang()
    rig.pass_ms(70)
    assert rig.board.air == (False, False)
    rig.pass_ms(2000)
    assert rig.board.air == (False, False)  # restarted by the watchdog, and not armed
