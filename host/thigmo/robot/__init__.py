"""The robot as an object: connect, configure, grow, sweep, zero, read.

What `thigmo.connect` returns. Units are cm, psi, 1/cm and s; the board's integers stay inside.
"""

from thigmo.robot.growing import GrowthWatcher
from thigmo.robot.operator import Operator
from thigmo.robot.peaks import SweepConditions, average_peak, snapshot_reading
from thigmo.robot.readings import SENSORS, SensorTable, other_side
from thigmo.robot.robot import Robot, connect
from thigmo.robot.standing import StandingWatch
from thigmo.robot.state import (
    ContactTrigger,
    Peak,
    Reading,
    SnapshotReading,
    Status,
    SweepFrame,
    SweepResult,
)
from thigmo.robot.sweep import TRIGGER_PER_CM, rising_period_s, sweep_period_s
from thigmo.robot.sweeping import SweepWatcher

__all__ = [
    "SENSORS",
    "TRIGGER_PER_CM",
    "ContactTrigger",
    "GrowthWatcher",
    "Operator",
    "Peak",
    "Reading",
    "Robot",
    "SensorTable",
    "SnapshotReading",
    "StandingWatch",
    "Status",
    "SweepConditions",
    "SweepFrame",
    "SweepResult",
    "SweepWatcher",
    "average_peak",
    "connect",
    "other_side",
    "rising_period_s",
    "snapshot_reading",
    "sweep_period_s",
]
