"""The calibration folder: every reading as it was taken, every result, and where to go on.

    calibration/NAME/
      robot.toml            constants so far (with numbered backups)
      camera.json sheet.toml
      ROWS.jsonl            readings of a procedure, one line each, written as they come
      STEP.json STEP.png    result and figure of a step

A guided command that was stopped goes on after its last line; a step that is done is not repeated
unless asked for.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from thigmo.calibrate.verdict import StepResult, plain
from thigmo.config import MuscleMap, RobotConfig, Sensor
from thigmo.errors import DataError
from thigmo.files import DATA_BYTES, read_file, write_whole
from thigmo.sensors import BoardSensor

_FULL = "free some space, then run it again"


class Session:
    """One calibration folder; DataError where it cannot be made or written."""

    def __init__(self, folder: str | os.PathLike[str], config: RobotConfig | None = None) -> None:
        self.folder = Path(folder)
        with DataError.from_os(f"cannot make {self.folder}", "choose another folder"):
            self.folder.mkdir(parents=True, exist_ok=True)
        self.robot_file = self.folder / "robot.toml"
        if self.robot_file.exists():
            self.config = RobotConfig.load(self.robot_file)
        else:
            self.config = config or RobotConfig()
            self.config.save(self.robot_file)

    def rows(self, procedure: str) -> dict[str, dict[str, Any]]:
        """Readings taken so far, by key, in order; a repeated reading replaces the earlier one.

        A last line that a crash cut off is dropped; any other damage raises DataError.
        """
        path = self.folder / f"{procedure}.jsonl"
        if not path.exists():
            return {}
        steps: dict[str, dict[str, Any]] = {}
        with DataError.from_os(f"cannot read {path}", "delete it, and take its readings again"):
            lines = read_file(path, DATA_BYTES).decode(errors="replace").splitlines()
        for number, line in enumerate(lines, start=1):
            try:
                row = json.loads(line)
                steps.pop(row["key"], None)
                steps[row["key"]] = row
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                if number == len(lines):
                    break
                raise DataError(
                    f"{path}, line {number} is damaged", "correct or delete that line"
                ) from error
        return steps

    def add(self, procedure: str, row: dict[str, Any]) -> None:
        """Append a reading, which must have a `key`. It is on disk when this returns."""
        path = self.folder / f"{procedure}.jsonl"
        if path.exists():
            text = path.read_bytes()
            if text and not text.endswith(b"\n"):  # what a full disk did not take
                os.truncate(path, text.rfind(b"\n") + 1)
        with DataError.from_os(f"cannot write {path}", _FULL), path.open("a") as file:
            file.write(json.dumps(plain(row)) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def forget(self, procedure: str) -> None:
        """Set readings aside (kept as `.old`), to take them again."""
        path = self.folder / f"{procedure}.jsonl"
        if path.exists():
            path.replace(path.with_suffix(".jsonl.old"))

    def good_result(self, step: str) -> dict[str, Any] | None:
        """The stored result of a step, if it was good."""
        data = self._result(step)
        return data if data is not None and data["verdict"]["good"] else None

    def failed(self, step: str) -> bool:
        """Whether the stored result of a step is not good."""
        data = self._result(step)
        return data is not None and not data["verdict"]["good"]

    def _result(self, step: str) -> dict[str, Any] | None:
        path = self.folder / f"{step}.json"
        if not path.exists():
            return None
        try:
            data: dict[str, Any] = json.loads(read_file(path, DATA_BYTES))
            _ = data["verdict"]["good"]
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise DataError(
                f"{path} is damaged", f"delete it, and run `thigmo calibrate {step}` again"
            ) from error
        return data

    def figure(self, step: str) -> Path:
        """The file of a step's figure."""
        return self.folder / f"{step}.png"

    def keep(self, step: str, result: StepResult) -> list[str]:
        """Store a result, and put a good one into robot.toml. Returns messages."""
        file = self.folder / f"{step}.json"
        with DataError.from_os(f"cannot write {file}", _FULL):
            write_whole(file, json.dumps(result.as_data(), indent=1))
        good, reason, notes = result.verdict.good, result.verdict.reason, result.verdict.notes
        messages = [
            f"{step}: {'good' if good else 'BAD'}: {reason}",
            *(f"  {note}" for note in notes),
        ]
        config = result.apply(self.config) if good else self.config
        if config != self.config:
            self.config = config
            if (backup := config.save(self.robot_file)) is not None:
                messages.append(f"  {self.robot_file} updated; the one before is {backup.name}")
        return messages


def blank(config: RobotConfig) -> RobotConfig:
    """An uncalibrated robot of this geometry: where calibration begins."""
    blank_config, defaults = config.model_copy(deep=True), RobotConfig()
    blank_config.sensors = [_blank_sensor(sensor) for sensor in config.sensors]
    for muscle in blank_config.muscles:
        muscle.lag_s = defaults.muscles[0].lag_s
        muscle.offset_se = defaults.muscles[0].offset_se
        muscle.maps = [
            MuscleMap(body_pressure_psi=pressure.pressure_psi)
            for pressure in blank_config.body.pressures
        ]
    if blank_config.body.folds:
        blank_config.body.critical_curvature = defaults.body.critical_curvature
        blank_config.body.critical_curvature_se = defaults.body.critical_curvature_se
    blank_config.body.base_compliance_cm = defaults.body.base_compliance_cm
    blank_config.body.base_compliance_se_cm = defaults.body.base_compliance_se_cm
    blank_config.body.stiffness_n_cm2 = None
    blank_config.spool.counts_per_cm = defaults.spool.counts_per_cm
    for pressure in blank_config.body.pressures:
        pressure.pull_duty = 0.0
    return blank_config


def _blank_sensor(sensor: Sensor) -> Sensor:
    """A sensor before its calibration.

    The board's sensors out of the plane keep their constants, because no step measures them.
    """
    if sensor.side is None and isinstance(sensor, BoardSensor):
        return sensor.model_copy()
    return sensor.uncalibrated()
