"""Where obstacles stand beside the body: one fit to every frame of all sweeps of a side.

A frame's localizer (`thigmo.localization`) knows no forces and one shape; here obstacles stand
still in the plane, and share all frames with calibration's errors. The core takes arrays
(`readings`) and knows the mechanics; `sweeps` makes them of a robot's sweeps and its robot.toml.
Called by the exploration for its map; docs/methods.md has the model.
"""

from thigmo.field.answer import FieldContact, contacts
from thigmo.field.atlas import Atlas
from thigmo.field.expected import ExpectedSweeps, expected_sweeps
from thigmo.field.partial import PartialAnswer, partial_answer
from thigmo.field.readings import Errors, Readings, Stage
from thigmo.field.sweeps import Swept, fold_moment, read, stated

__all__ = [
    "Atlas",
    "Errors",
    "ExpectedSweeps",
    "FieldContact",
    "PartialAnswer",
    "Readings",
    "Stage",
    "Swept",
    "contacts",
    "expected_sweeps",
    "fold_moment",
    "partial_answer",
    "read",
    "stated",
]
