"""The robot as an object: connect, configure, grow, sweep, zero, read.

What `thigmo.connect` returns. Units are cm, psi, 1/cm and s; the board's integers stay inside.
"""

from thigmo.operator_prompts import Operator
from thigmo.robot.creep import CreepWatch
from thigmo.robot.curvature import SensorTable, in_mask, mask_of
from thigmo.robot.fibre import FibreReading
from thigmo.robot.idle_pressure import VENTED_PSI
from thigmo.robot.retraction import Retraction
from thigmo.robot.robot import JOG_CM, WITHOUT_BRAKE, Robot, connect
from thigmo.robot.state import (
    ContactTrigger,
    Peak,
    Reading,
    RobotStatus,
    SweepFrame,
    SweepResult,
    mean_peak,
)
from thigmo.robot.strains import Strains
from thigmo.robot.sweep import FRAME_SPACING_S, TRIGGER_PER_CM, rising_period_s, sweep_period_s
from thigmo.robot.watchers import GrowthWatcher, Profile, SweepWatcher, peak_frame
from thigmo.robot.zeroing import zero_when_steady

__all__ = [
    "FRAME_SPACING_S",
    "JOG_CM",
    "TRIGGER_PER_CM",
    "VENTED_PSI",
    "WITHOUT_BRAKE",
    "ContactTrigger",
    "CreepWatch",
    "FibreReading",
    "GrowthWatcher",
    "Operator",
    "Peak",
    "Profile",
    "Reading",
    "Retraction",
    "Robot",
    "RobotStatus",
    "SensorTable",
    "Strains",
    "SweepFrame",
    "SweepResult",
    "SweepWatcher",
    "connect",
    "in_mask",
    "mask_of",
    "mean_peak",
    "peak_frame",
    "rising_period_s",
    "sweep_period_s",
    "zero_when_steady",
]
