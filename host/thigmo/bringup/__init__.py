"""The first power-up: is every wire where it belongs? Then jog and press, in small steps.

`BringUp` is docs/hardware's checklist as code: each stage asks the person beside the robot for one
thing, measures, and names what is wrong with the terminal to look at. `jog` and `press` drive one
output as it is; the board ends each push by itself within half a second.
"""

from thigmo.bringup.checks import STAGES, Attendant, BringUp, Finding, SpoolTurn
from thigmo.bringup.push import jog, press

__all__ = [
    "STAGES",
    "Attendant",
    "BringUp",
    "Finding",
    "SpoolTurn",
    "jog",
    "press",
]
