"""Run folders: what a run leaves behind, and how it is read again.

A run folder holds `run.mcap` (every frame of the link, raw, with its time), `contacts.json` (what
was found), `obstacles.json` and the grid `map.pgm` with `map.yaml` (the same for who plans with
it), `map.png`, `robot.toml` as used, and `prior.json` if the run was given a map. All of it stays
readable when the run is cut short.
"""

from thigmo.record.document import (
    RUNNING,
    Explanation,
    FalseContact,
    MapContact,
    MissedContact,
    NamedMuscle,
    Pose,
    RunDocument,
    Shape,
    Stage,
    Stall,
    Trigger,
    TrueContact,
    TruePeg,
    Truth,
)
from thigmo.record.folder import RunFolder, write_whole
from thigmo.record.log import Entry, FibreLine, Log, LogWriter, Note, read_log
from thigmo.record.obstacles import (
    OBSTACLES_FILE,
    PRIOR_FILE,
    Ellipse,
    FreeArea,
    Obstacle,
    ObstacleMap,
    read_obstacles,
    write_obstacles,
)
from thigmo.record.occupancy import OccupancyGrid, read_ros_map, write_ros_map
from thigmo.record.swept_shapes import outline, passed
from thigmo.record.table import FramesTable, ReadingsTable, read_frames, read_readings

__all__ = [
    "OBSTACLES_FILE",
    "PRIOR_FILE",
    "RUNNING",
    "Ellipse",
    "Entry",
    "Explanation",
    "FalseContact",
    "FibreLine",
    "FramesTable",
    "FreeArea",
    "Log",
    "LogWriter",
    "MapContact",
    "MissedContact",
    "NamedMuscle",
    "Note",
    "Obstacle",
    "ObstacleMap",
    "OccupancyGrid",
    "Pose",
    "ReadingsTable",
    "RunDocument",
    "RunFolder",
    "Shape",
    "Stage",
    "Stall",
    "Trigger",
    "TrueContact",
    "TruePeg",
    "Truth",
    "outline",
    "passed",
    "read_frames",
    "read_log",
    "read_obstacles",
    "read_readings",
    "read_ros_map",
    "write_obstacles",
    "write_ros_map",
    "write_whole",
]
