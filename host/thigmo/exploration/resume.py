"""A run that was cut short: what it had learnt, swept and felt, for the run that resumes it."""

from __future__ import annotations

import os
from dataclasses import dataclass

from thigmo.config import RobotConfig
from thigmo.errors import RunFolderError
from thigmo.exploration.prior import kept_prior
from thigmo.exploration.recorded import RecordedRun
from thigmo.exploration.run_knowledge import RunKnowledge
from thigmo.record import RUNNING, Obstacle, RunDocument, RunFolder

_ENDS = ("full length", "peg ahead", "growth stalled")


@dataclass(frozen=True, slots=True)
class Interrupted:
    """A run that was cut short."""

    folder: RunFolder
    document: RunDocument
    config: RobotConfig  # robot.toml, as it was used or as it is given now
    prior: list[Obstacle]  # the map that it was given
    knowledge: RunKnowledge  # at its end
    protocol: str  # how it measured contacts; empty if its record does not tell


def interrupted(run: str | os.PathLike[str], config: RobotConfig | None = None) -> Interrupted:
    """Read a run that was cut short; its record is localized again, by `config` if it is given.

    Raises:
        RunFolderError: it is under way or has come to its end, or its record cannot be read.
        ConfigError: its robot.toml cannot be read.
    """
    folder = RunFolder(run)
    document = folder.read_document()
    if document.outcome == RUNNING:
        raise RunFolderError(f"{folder.path} is under way", "end it first, as with `thigmo stop`")
    if document.outcome.startswith(_ENDS):
        raise RunFolderError(
            f"{folder.path} is finished ({document.outcome})", "begin a new exploration"
        )
    logs = folder.read_logs()
    used, prior = config or folder.read_config(), kept_prior(folder)
    recorded = RecordedRun(folder, logs, used, prior, document.method)
    protocol = logs[-1].metadata.get("protocol", "")
    return Interrupted(folder, document, used, prior, recorded.knowledge, protocol)
