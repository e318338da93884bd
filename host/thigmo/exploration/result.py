"""What an exploration found: returned by `explore`, or read from its run folder again."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thigmo.config import RobotConfig
from thigmo.display.html import html_card, html_table
from thigmo.exploration.prior import kept_prior
from thigmo.extras import data_frame
from thigmo.record import (
    OBSTACLES_FILE,
    MapContact,
    ObstacleMap,
    OccupancyGrid,
    RunDocument,
    RunFolder,
    read_obstacles,
    read_ros_map,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame


@dataclass(frozen=True, slots=True)
class ExplorationResult:
    """What an exploration found.

    Attributes:
        document: the contents of contacts.json.
        folder: the run folder.
    """

    document: RunDocument
    folder: Path

    def __repr__(self) -> str:
        return f"ExplorationResult({self.document.name}: {self._said()}; {self.folder})"

    def _repr_html_(self) -> str:
        rows = [
            (
                c.place_text,
                c.along_text,
                c.interval_text,
                c.force_text,
                c.status,
            )
            for c in self.contacts
        ]
        columns = ("place", "along the body", "95 % interval", "force", "status")
        table = html_table(columns, rows) if rows else ""
        return html_card(self.document.name, f"{self._said()}; {self.folder}", table)

    def _said(self) -> str:
        document = self.document
        error = document.error_cm
        return (
            f"{document.outcome}; {_counted(len(document.contacts), 'contact')}, "
            f"{_counted(len(document.stages), 'stage')}, "
            f"{document.robot_time_s:.0f} s of robot time"
            + ("" if error is None else f"; error in the plane {error:.2f} cm")
        )

    @property
    def contacts(self) -> list[MapContact]:
        """One for each obstacle that was touched, in the order of their discovery."""
        return self.document.contacts

    @property
    def length_cm(self) -> float:
        """Everted length at the end, which the robot keeps."""
        return self.document.length_cm

    @property
    def config(self) -> RobotConfig:
        """robot.toml as it was used. Raises ConfigError if it is missing or malformed."""
        return RunFolder(self.folder).read_config()

    @property
    def map(self) -> OccupancyGrid:
        """The map as a grid of cells: free, occupied or unknown. RunFolderError without one."""
        return read_ros_map(self.folder / "map.yaml")

    @property
    def obstacles(self) -> ObstacleMap:
        """The map as obstacles with their ellipses, and outlines of the space swept freely.

        Raises RunFolderError without one.
        """
        return read_obstacles(self.folder / OBSTACLES_FILE)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the map: the robot's bends, the swept space, the contacts, and the truth if known.

        Draws on `axes`, or on a new figure of matplotlib's pyplot. Raises ConfigError or
        RunFolderError if the folder's robot.toml or prior.json cannot be read.
        """
        from thigmo.report import plot_map

        radius, prior = self.config.body.radius_cm, kept_prior(RunFolder(self.folder))
        return plot_map(self.document, axes, radius_cm=radius, prior=prior)

    def to_dict(self) -> dict[str, Any]:
        """The document as plain data, for JSON: what `thigmo explore --json` prints.

        As contacts.json has it, without the stages' `shapes` and the contacts' `track`, and with
        three entries more: `run`, the folder; `robot_per_wall_time`, robot time over wall time; and
        each contact's `first_felt_cm`, the everted length at which it was felt first. Its
        `everted_length_cm` is the one at which it was measured last.
        """
        plain = asdict(self.document)
        for stage in plain["stages"]:
            del stage["shapes"]
        for contact in plain["contacts"]:
            del contact["track"]
            contact["first_felt_cm"] = min([contact["everted_length_cm"], *contact["merged"]])
        wall = max(self.document.wall_time_s, 1e-9)
        return {
            **plain,
            "robot_per_wall_time": self.document.robot_time_s / wall,
            "run": str(self.folder),
        }

    def to_frame(self) -> DataFrame:
        """A pandas data frame with a row for each contact, in the order of their discovery.

        Its columns are those of the `contacts.csv` that `thigmo export` writes, without the times;
        `everted_length_cm` is the length at which the contact was measured last. Raises
        NotInstalledError without the extra: `thigmo[tables]`.
        """
        muscles = {muscle.side: muscle.name for muscle in self.document.muscles}
        return data_frame([contact.to_row(muscles) for contact in self.contacts])


def open_run(path: str | os.PathLike[str]) -> ExplorationResult:
    """Open a run folder, as the result that `explore` returned.

    Raises RunFolderError if it holds no contacts.json, or a malformed one.
    """
    folder = RunFolder(path)
    return ExplorationResult(folder.read_document(), folder.path)


def _counted(number: int, thing: str) -> str:
    return f"{number or 'no'} {thing}{'' if number == 1 else 's'}"
