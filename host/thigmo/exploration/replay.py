"""Localizes a run's contacts again from its raw record, the frames that crossed the link.

Nothing is taken from contacts.json: the run's steps and its readings are read off the record
(`recorded`), and the run's knowledge is rebuilt from them (`run_knowledge`). So a newer localizer
can be tried on an old run, and a doubtful result can be checked.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

from thigmo.errors import RunFolderError
from thigmo.exploration.methods import FIELD, check_exploration_method
from thigmo.exploration.obstacles import export_obstacles
from thigmo.exploration.prior import kept_prior
from thigmo.exploration.recorded import RecordedRun
from thigmo.record import NamedMuscle, RunDocument, RunFolder
from thigmo.report import draw_map
from thigmo.version import VERSION


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """What a replay found."""

    document: RunDocument  # contacts and triggers found again; the truth is the run's own
    sweeps: int  # how many the record holds
    bad_frames: int  # frames that could not be decoded
    truncated: bool  # the record is cut short
    gaps: int  # places at which the record is damaged
    missing: str  # the same in words, for the operator; empty if the record is whole

    def to_dict(self) -> dict[str, Any]:
        """The document without its shapes, as plain data: what `thigmo replay --json` prints."""
        facts = asdict(self)
        document = facts.pop("document")
        del facts["missing"]
        for stage in document["stages"]:
            del stage["shapes"]
        return {**document, **facts}


def replay(run: str | os.PathLike[str], *, method: str | None = None) -> ReplayResult:
    """Localize a run's contacts again from its raw record.

    Writes `replay.json`, `replay.png`, `replay-obstacles.json`, and `replay-map.yaml` with its
    picture, into the run folder.

    Args:
        run: the run folder.
        method: as for `thigmo.explore`; None takes the run's own.

    Returns:
        The document with the contacts found again, and what is missing from the record.

    Raises:
        RunFolderError: there is no record, or it is of another protocol schema.
        ConfigError: the folder's robot.toml cannot be read.
    """
    folder = RunFolder(run)
    logs = folder.read_logs()  # first: a folder that is no run has none, and says so
    config, prior = folder.read_config(), kept_prior(folder)
    if method is not None:
        check_exploration_method(method)
    known: RunDocument | None = None
    with suppress(RunFolderError):  # it was cut short before it knew anything
        known = folder.read_document()
    used = method or (known.method if known else FIELD)
    recorded, log = RecordedRun(folder, logs, config, prior, used), logs[-1]
    if known is None:
        url, started = (log.metadata.get(name, "") for name in ("url", "started"))
        known = RunDocument(VERSION, folder.path.name, url, started, "cut short")
    document = replace(
        known,
        thigmo=VERSION,
        outcome=f"replayed; {known.outcome}",
        stages=recorded.knowledge.stages,
        robot_time_s=log.entries[-1].t_s - log.entries[0].t_s if log.entries else 0.0,
        wall_time_s=0.0,
        method=used,
        muscles=NamedMuscle.all_of(config),
        version=2,
    )
    document = recorded.knowledge.interpreter.judged(document)
    radius = config.body.radius_cm
    folder.write_document(document, "replay.json")
    export_obstacles(folder, document, radius_cm=radius, prior=prior, prefix="replay-")
    draw_map(document, folder.path / "replay.png", radius_cm=radius, prior=prior)
    gaps = sum(record.gaps for record in logs)
    return ReplayResult(
        document,
        len(recorded.sweeps),
        recorded.bad,
        log.truncated,
        gaps,
        "; ".join(record.missing for record in logs if record.missing),
    )
