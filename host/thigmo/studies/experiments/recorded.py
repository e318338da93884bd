"""A folder of trials taken with a robot: resumed, kept through every kind of end, evaluated again.

    OUT/EXPERIMENT/
      robot.toml    the robot's constants as used
      trials.csv    a line a trial, on disk as soon as it is judged
      run-1.mcap    every frame of the first session's link, run-2.mcap of the next

The same command goes on after the last line. Lists in a cell are separated by semicolons, and the
readings at the pressures on the way by slashes. Tables of earlier versions end before these; such
trials are evaluated by their last reading alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thigmo import __version__
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.exploration.reference import FreeResponse, scale_errors
from thigmo.record import LogWriter
from thigmo.robot import SensorTable
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.procedure import Planned, Row, Say, plan, prepare, take
from thigmo.studies.experiments.trial import Floats, Passed, Trial
from thigmo.studies.experiments.trial_table import TrialTable

if TYPE_CHECKING:
    from thigmo.robot import Robot
    from thigmo.studies.experiments.attendant import Attendant

COLUMNS = (
    "key", "experiment", "condition", "place", "number", "side", "state", "arcs_cm",
    "pressure_psi", "t_s", "length_cm", "left_psi", "right_psi", "zeroed", "curvature",
    "dowel_x_cm", "dowel_y_cm", "true_arcs_cm", "true_forces", "true_contact_x_cm",
    "passed_psi", "passed_curvature",
)  # fmt: skip
_EARLIER = COLUMNS[:-2]
_PLACE_SE_CM = 0.1  # of a sensor's centre, by a ruler; robot.toml does not state it
_LEAST_GAIN_SE = 1e-3


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
        self._table = TrialTable(
            self.path, config, COLUMNS, things="trials", done="taken", earlier=_EARLIER
        )
        self.config = self._table.config

    def rows(self) -> dict[str, dict[str, str]]:
        """Lines so far, by key, as `TrialTable.rows`."""
        return self._table.rows()

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
        self._table.add([_cell(cells.get(name, "")) for name in COLUMNS])

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
            shown = _shown_gains(kept, self.config)
            return [_trial(row, self.config, shown) for row in kept]
        except (ValueError, IndexError) as error:
            raise DataError(
                f"{self._table.path} is damaged: {error}", "mend or delete that line"
            ) from (error)


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
        inner = " / " if value and isinstance(value[0], list) else ";"
        return inner.join(_cell(part) for part in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(";")) if text else ()


def _frames(row: dict[str, str]) -> Floats:
    """(T, 10) readings at the pressures on the way."""
    text = row["passed_curvature"]
    return np.array([_numbers(part) for part in text.split("/")] if text else [], dtype=np.float64)


def _shown_gains(
    rows: Sequence[dict[str, str]], config: RobotConfig
) -> dict[Side, tuple[Floats, Floats]]:
    """What the untouched robot showed of its sensors' gains at 6 psi, and their errors, (10,) each.

    As `Specimen.learn_gains`; but what a reading errs by on a real robot (its zero, its hysteresis)
    is much the same in all trials, so that many of them tell no more than one.
    """
    made: dict[Side, tuple[Floats, Floats]] = {}
    table = SensorTable.of(config)
    for side in SIDES:
        muscle = config.actuators.side(side)
        first = [(_numbers(r["passed_psi"])[0], _frames(r)[0]) for r in rows
                 if r["side"] == side and r["passed_psi"]]  # fmt: skip
        curve = muscle.maps[-1].inflate
        spread = np.hypot(scale_errors(config), curve.amplitude_se / curve.amplitude)
        spread = np.maximum(spread, _LEAST_GAIN_SE)
        gain, error = np.ones(spread.size), spread
        if first:
            sign = 1 if side == "left" else -1
            believed = np.mean([sign * curve.curvature(psi) for psi, _ in first])
            departure = np.mean([readings for _, readings in first], axis=0) - believed
            variance = table.noise**2 + muscle.offset_se**2
            precision = 1 / spread**2 + believed**2 / variance
            gain = 1 + np.nan_to_num(believed * departure / variance / precision)
            error = precision**-0.5
        made[side] = gain, error
    return made


def _trial(
    row: dict[str, str], config: RobotConfig, shown: dict[Side, tuple[Floats, Floats]]
) -> Trial:
    """A line of the table as a trial: usable sensors only, free curvature by the map."""
    table = SensorTable.of(config)
    curvature = np.array(_numbers(row["curvature"]))
    side: Side = "left" if row["side"] == "left" else "right"
    muscle = config.actuators.side(side)
    free = 0.0
    gain, gain_se = np.ones(curvature.size), np.zeros(curvature.size)
    if float(row["pressure_psi"]) > 0:
        measured = float(row["left_psi"] if side == "left" else row["right_psi"])
        free = muscle.maps[-1].inflate.curvature(measured) * (1 if side == "left" else -1)
        use = table.usable(side, int(row["zeroed"]))
    else:
        use = table.healthy & (table.direction * curvature >= 0)
    use = use & np.isfinite(curvature)
    passed = None
    if row["passed_psi"]:
        gain, gain_se = shown[side]
        on_the_way = [muscle.maps[-1].inflate.curvature(psi) for psi in _numbers(row["passed_psi"])]
        passed = Passed(
            _frames(row)[:, use], np.copysign(on_the_way, free), float(np.median(gain_se[use])),
            _PLACE_SE_CM,
        )  # fmt: skip
    scale_se = scale_errors(config)
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
        gain[use],
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
        passed=passed,
    )
