"""A folder of trials taken with a robot: resumed, kept through every kind of end, evaluated again.

    OUT/EXPERIMENT/
      robot.toml    the robot's constants as used
      trials.csv    a line a trial, on disk as soon as it is judged
      run-1.mcap    every frame of the first session's link, run-2.mcap of the next

The same command goes on after the last line. Lists in a cell are separated by semicolons.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thigmo import __version__
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import DataError, RunFolderError
from thigmo.experiments import thesis
from thigmo.experiments.procedure import Planned, Row, Say, plan, prepare, take
from thigmo.experiments.trial import Trial
from thigmo.exploration.reference import FreeResponse
from thigmo.record import LogWriter
from thigmo.robot import SensorTable

if TYPE_CHECKING:
    from thigmo.experiments.attendant import Attendant
    from thigmo.robot import Robot

COLUMNS = (
    "key", "experiment", "condition", "place", "number", "side", "state", "arcs_cm",
    "pressure_psi", "t_s", "length_cm", "left_psi", "right_psi", "zeroed", "curvature",
    "dowel_x_cm", "dowel_y_cm", "true_arcs_cm", "true_forces", "true_contact_x_cm",
)  # fmt: skip


class TrialFolder:
    """One experiment's trials on disk.

    Args:
        path: the folder.
        config: of the robot; None where trials are only read.

    Raises:
        RunFolderError: the folder cannot be made.
        DataError: its trials were taken with another robot.toml.
    """

    def __init__(self, path: str | os.PathLike[str], config: RobotConfig | None = None) -> None:
        self.path = Path(path)
        self._table = self.path / "trials.csv"
        robot_file = self.path / "robot.toml"
        if config is None:
            self.config = RobotConfig.load(robot_file)
            return
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunFolderError(
                f"cannot make {self.path}: {error.strerror}", "choose another --out"
            ) from error
        if robot_file.exists() and self._table.exists():
            if RobotConfig.load(robot_file) != config:
                raise DataError(
                    f"the trials in {self.path} were taken with another robot.toml",
                    f"use {robot_file} again, or choose another --out",
                )
        else:
            config.save(robot_file)
        self.config = config

    def rows(self) -> dict[str, dict[str, str]]:
        """Lines so far, by key; a line that a crash cut off is left out.

        Raises:
            DataError: a damaged line other than the last, or another table.
        """
        if not self._table.exists():
            return {}
        found: dict[str, dict[str, str]] = {}
        with self._table.open(newline="") as file:
            lines = list(csv.reader(file))
        if not lines or tuple(lines[0]) != COLUMNS:
            raise DataError(
                f"{self._table} is no table of trials", "move it away, or choose another --out"
            )
        for number, line in enumerate(lines[1:], start=2):
            if len(line) == len(COLUMNS):
                found[line[0]] = dict(zip(COLUMNS, line, strict=True))
            elif number != len(lines):
                raise DataError(f"{self._table}, line {number} is damaged", "mend or delete it")
        return found

    def add(self, trial: Planned, row: Row) -> None:
        """Append a trial that was kept, or (with an empty row) skipped; on disk on return.

        Raises:
            RunFolderError: the folder cannot be written.
        """
        cells: dict[str, Any] = {
            "key": trial.key,
            **{name: getattr(trial, name) for name in COLUMNS[1:6]},
            "state": "kept" if row else "skipped",
            "arcs_cm": list(trial.arcs_cm),
            "pressure_psi": trial.pressure_psi,
            **row,
        }
        try:
            self._drop_cut_line()
            fresh = not self._table.exists()
            with self._table.open("a", newline="") as file:
                writer = csv.writer(file)
                if fresh:
                    writer.writerow(COLUMNS)
                writer.writerow([_cell(cells.get(name, "")) for name in COLUMNS])
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise RunFolderError(
                f"cannot write {self._table}: {error.strerror}", "free some space, then run again"
            ) from error

    def _drop_cut_line(self) -> None:
        """A last line without its end was never whole."""
        text = self._table.read_bytes() if self._table.exists() else b""
        if text and not text.endswith(b"\n"):
            self._table.write_bytes(text[: text.rfind(b"\n") + 1])

    @contextmanager
    def recording(self, robot: Robot) -> Iterator[LogWriter]:
        """Keep every frame of the link in the next `run-N.mcap`."""
        number = 1 + len(list(self.path.glob("run-*.mcap")))
        facts = {"thigmo": __version__, "url": robot.url, **robot.identity}
        with LogWriter(self.path / f"run-{number}.mcap", facts) as log:
            robot.record_frames(log.frame)
            yield log

    def trials(self) -> list[Trial]:
        """The kept trials, for `evaluate`.

        Raises:
            DataError: a damaged line.
        """
        kept = [row for row in self.rows().values() if row["state"] == "kept"]
        try:
            return [_trial(row, self.config) for row in kept]
        except (ValueError, IndexError) as error:
            raise DataError(f"{self._table} is damaged: {error}", "mend or delete that line") from (
                error
            )


def run_trials(
    robot: Robot,
    attendant: Attendant,
    folder: TrialFolder,
    experiment: str,
    trials: int,
    say: Say = lambda text: None,
) -> bool:
    """Take the planned trials that the folder does not hold yet.

    Args:
        robot: connected.
        attendant: places dowels, measures them, judges.
        folder: with the robot's constants.
        experiment: one of `procedure.STATIC`.
        trials: for each place and condition.
        say: told what happens.

    Returns:
        Whether all are done; False if the attendant stopped.

    Raises:
        ThigmoError: as the robot raises. What was taken is kept in every case.
    """
    planned = plan(experiment, folder.config, trials)
    held = folder.rows()
    missing = [trial for trial in planned if trial.key not in held]
    if len(missing) < len(planned):
        say(f"{experiment}: {len(planned) - len(missing)} of {len(planned)} trials are there")
    if not missing:
        return True
    with folder.recording(robot) as log:
        try:
            prepare(robot, folder.config, say)
            for number, trial in enumerate(missing, start=len(planned) - len(missing) + 1):
                say(f"{experiment} {number} of {len(planned)}: {trial.key}")
                log.note("trial", robot.now(), key=trial.key)
                if not _one(robot, attendant, folder, trial):
                    return False
            attendant.clear()
        except (KeyboardInterrupt, SystemExit) as stopped:
            kept = len(folder.rows())
            stopped.add_note(f"{kept} trials are in {folder.path}, the same command goes on")
            raise
    return True


def _one(robot: Robot, attendant: Attendant, folder: TrialFolder, trial: Planned) -> bool:
    """Take a trial until it is kept or skipped; False if the attendant stops."""
    while True:
        row = take(robot, attendant, trial)
        base = np.array(row["curvature"], float)[
            [0, SensorTable.of(folder.config).healthy.size // 2]
        ]
        summary = f"base sensors read {base[0]:+.4f} (left) and {base[1]:+.4f} 1/cm (right)"
        verdict = attendant.verdict(trial, summary)
        if verdict == "keep":
            folder.add(trial, row)
            return True
        if verdict == "skip":
            folder.add(trial, {})
            return True
        if verdict == "quit":
            return False


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return ";".join(f"{number:.9g}" for number in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(";")) if text else ()


def _trial(row: dict[str, str], config: RobotConfig) -> Trial:
    """A line of the table as a trial: usable sensors only, free curvature by the map."""
    table = SensorTable.of(config)
    curvature = np.array(_numbers(row["curvature"]))
    side: Side = "left" if row["side"] == "left" else "right"
    muscle = config.actuators.side(side)
    free = 0.0
    if float(row["pressure_psi"]) > 0:
        measured = float(row["left_psi"] if side == "left" else row["right_psi"])
        free = muscle.maps[-1].inflate.curvature(measured) * (1 if side == "left" else -1)
        use = table.usable(side, int(row["zeroed"]))
    else:
        use = table.healthy & (table.direction * curvature >= 0)
    use = use & np.isfinite(curvature)
    scale_se = np.zeros(curvature.size)
    for first, name in zip((0, curvature.size // 2), SIDES, strict=True):
        for index, sensor in enumerate(config.sensors.column(name), start=first):
            scale_se[index] = sensor.scale_se
    _, error = FreeResponse(config).expected(side, free)
    sigma = np.sqrt(table.noise**2 + (scale_se * (curvature - free)) ** 2)
    if free:
        sigma = np.hypot(sigma, error)
    arcs = _numbers(row["true_arcs_cm"]) or _numbers(row["arcs_cm"])
    unknown = (float("nan"),) * len(arcs)
    return Trial(
        row["condition"],
        row["place"],
        curvature[use],
        table.center_cm[use],
        table.span_cm[use],
        free,
        float(np.median(table.noise[use])),
        np.ones(int(use.sum())),
        sigma[use],
        sigma[use],
        arcs,
        _numbers(row["true_forces"]) or unknown,
        _numbers(row["dowel_x_cm"]),
        _numbers(row["true_contact_x_cm"]) or unknown,
        offset_sigma=muscle.offset_se,
        length_cm=float(row["length_cm"]),
        critical=config.body.critical_curvature,
        radius_cm=config.body.radius_cm,
        dowel_cm=thesis.DOWEL_CM,
    )
