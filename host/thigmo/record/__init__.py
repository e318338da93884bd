"""Run folders: what a run leaves behind, and how it is read again.

A run folder holds `run.mcap` (every frame of the link, raw, with its time), `contacts.json` (what
was found), `map.png` and `robot.toml` as used. All of it stays readable when the run is cut short.
"""

from thigmo.record.document import (
    MapContact,
    Pose,
    RunDocument,
    Shape,
    Stage,
    Trigger,
    TrueContact,
    TruePeg,
    Truth,
)
from thigmo.record.folder import RunFolder
from thigmo.record.log import Entry, Log, LogWriter, read_log
from thigmo.record.readings_table import ReadingsTable, read_readings

__all__ = [
    "Entry",
    "Log",
    "LogWriter",
    "MapContact",
    "Pose",
    "ReadingsTable",
    "RunDocument",
    "RunFolder",
    "Shape",
    "Stage",
    "Trigger",
    "TrueContact",
    "TruePeg",
    "Truth",
    "read_log",
    "read_readings",
]
