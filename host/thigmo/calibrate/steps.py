"""The steps of the calibration, from readings of bench or CSV to verdicts and robot.toml.

    growth   -> encoder, hysteresis        bends -> actuator, and free bends for flex
    leans    -> base                       pushes -> buckling
    tips     -> flex; stiffness with bows  rest   -> noise
    pressure, check

Each is a module with `guided`, which takes the readings that are missing and fits them, `of_csv`
for readings that a lab already has, and the fit. Order on a new robot: that of `STEPS`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, cast

from thigmo.calibrate import (
    actuator,
    base,
    bending,
    buckling,
    check,
    encoder,
    fibre,
    flex,
    heading,
    hysteresis,
    noise,
    pressure,
    stiffness,
    thesis,
)
from thigmo.calibrate.bench import Bench
from thigmo.calibrate.columns import sensors_of
from thigmo.calibrate.commands import commands_of
from thigmo.calibrate.verdict import StepResult
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import MissingColumnError, Table
from thigmo.wiring import table_key

_STRAIGHT: Final = "straight shape at rest"
_ON_BOARD: Final = "sensor on the board"
Need = Literal["growth", "muscles", "fold", "straight shape at rest", "sensor on the board"]


@dataclass(frozen=True)
class Step:
    """One step of the calibration."""

    guided: Callable[..., StepResult]  # takes a Bench, and optionally another fit
    of_csv: Callable[..., StepResult] | None = None  # takes a Table, a RobotConfig, a fit
    columns: str = ""  # columns of its CSV; those in brackets may be omitted
    rows: tuple[str, ...] = ()  # names of the tables of readings that only this step uses
    # whether later steps would measure nonsense if this one failed
    needed: bool = False
    thesis: Callable[..., StepResult] | None = None  # the thesis's fit of the same readings
    kind: str = ""  # kind of the sensors that it calibrates; empty for any
    # Of the body. The camera's steps fit bends from a body that is straight at rest.
    needs: tuple[Need, ...] = ()
    # Besides, where the step takes the readings itself: others may bend the body for a file.
    live_needs: tuple[Need, ...] = (_ON_BOARD,)

    def lacking(self, config: RobotConfig, *, in_file: bool = False) -> str:
        """What a robot lacks that the step needs; empty if nothing.

        `in_file`: the readings come from a file, not from the step.
        """
        body = config.body
        has = {
            "growth": body.grows,
            "muscles": bool(config.muscles),
            "fold": body.folds,
            _STRAIGHT: not body.rest_curvature,
            _ON_BOARD: bool(config.board_sensors),
        }
        needs = self.needs if in_file else self.needs + self.live_needs
        if missing := [need for need in needs if not has[need]]:
            return f"no {missing[0]}"
        if self.kind and self.kind not in {sensor.kind for sensor in config.sensors}:
            return f"no {self.kind} sensors"
        return ""

    def other_fit(self, method: str | None) -> tuple[Callable[..., StepResult], ...]:
        """The argument of `guided` and `of_csv` for another method; none for the step's own."""
        return (self.thesis,) if method == "thesis" and self.thesis else ()


_CURVATURES = "curvature_SENSOR of each sensor"
STEPS = {
    "pressure": Step(
        pressure.guided, pressure.of_csv, "NAME_count of each muscle", needed=True,
        needs=("muscles",), live_needs=(),
    ),
    "encoder": Step(
        encoder.guided, encoder.of_csv, "counts, length_cm", ("growth", "drive"), needed=True,
        needs=("growth", _STRAIGHT),
    ),
    "actuator": Step(
        actuator.guided, actuator.of_csv,
        "muscle (or side), body_pressure_psi, pressure_psi, curvature "
        "[curvature_se, branch, trial]",
        ("bends", "unseen_bends", "lag"), needed=True, needs=("muscles", _STRAIGHT),
    ),
    "base": Step(base.guided, base.of_csv, base.COLUMNS, ("leans",), needs=(_STRAIGHT,)),
    "flex": Step(
        flex.guided, flex.of_csv,
        "kind (straight, tip, bend), tip_x_cm, tip_y_cm, curvature, ohm_SENSOR of each sensor "
        "[t_s, curvature_se, active, length_cm, intended_y_cm, block, name]",
        ("tips",), needed=True, thesis=thesis.fit_flex, kind="flex",
        needs=(_STRAIGHT,),
    ),
    "heading": Step(
        heading.guided, heading.of_csv, "t_s, curvature, ohm_SENSOR of each sensor",
        needed=True, kind="heading", needs=(_STRAIGHT,), live_needs=(_ON_BOARD, "muscles"),
    ),
    "fibre": Step(
        fibre.guided, fibre.of_csv, "t_s, curvature, strain_0 .. strain_N (microstrain)",
        needed=True, kind="fibre", needs=(_STRAIGHT,), live_needs=(_ON_BOARD, "muscles"),
    ),
    "hysteresis": Step(
        hysteresis.guided, hysteresis.of_csv, "sensor, t_s, curvature [eversion]", ("growth",),
        needs=("growth",),
    ),
    "buckling": Step(
        buckling.guided, buckling.of_csv, f"{_CURVATURES} [body_pressure_psi, length_cm]",
        ("pushes",), thesis=thesis.fit_buckling, needs=("fold", _STRAIGHT),
    ),
    "stiffness": Step(
        stiffness.guided, stiffness.of_csv,
        f"picture, x_cm, y_cm [force_arc_cm]; or {bending.COLUMNS}", ("bows",),
        needs=(_STRAIGHT,),
    ),
    "noise": Step(noise.guided, noise.of_csv, f"t_s, {_CURVATURES}", ("rest",)),
    "check": Step(check.guided, needs=("muscles",)),
}  # fmt: skip


def steps_of(config: RobotConfig) -> list[str]:
    """The names of the steps that take their readings from such a robot."""
    return [name for name, step in STEPS.items() if not step.lacking(config)]


def _require(step: str, config: RobotConfig, *, in_file: bool = False) -> None:
    """Raise DataError for a step of what the robot does not have."""
    if not (lacking := STEPS[step].lacking(config, in_file=in_file)):
        return
    if STEPS[step].of_csv and not STEPS[step].lacking(config, in_file=True):
        cure = f"give readings as a file: `thigmo calibrate {step} --csv FILE`"
    else:
        cure = f"use {', '.join(steps_of(config))}"
    raise DataError(f"the robot has {lacking}", cure)


def run(bench: Bench, step: str, *, again: bool = False, method: str | None = None) -> StepResult:
    """Run a guided step of `STEPS`. `again` repeats its readings; `method` is as in `fit_csv`."""
    _require(step, bench.config)
    if again:
        for procedure in STEPS[step].rows:
            bench.session.forget(procedure)
    if step == "pressure":
        bench.configure()  # no length is taken from a robot that does not look vented
    else:
        bench.start()
    result = STEPS[step].guided(bench, *STEPS[step].other_fit(method))
    from thigmo.calibrate.step_figures import draw  # takes Matplotlib with it

    draw(result, bench.session.figure(step))
    bench.finish(step, result)
    return result


def run_all(
    bench: Bench, *, again: bool = False, method: str | None = None
) -> dict[str, StepResult]:
    """Run every step that the robot has something for and that has no good result yet.

    It ends at the last step, or at a needed one that is not good. `again` repeats good ones.
    """
    if not steps_of(bench.config):
        files = ", ".join(f"`{command}`" for command in commands_of(bench.config, "URL"))
        raise DataError(
            "no step can take readings from this robot: nothing on the board bends it or reads it",
            f"give them as a file: {files}",
        )
    results: dict[str, StepResult] = {}
    for name in steps_of(bench.config):
        if not again and bench.session.good_result(name):
            bench.say(f"{name}: done before; `thigmo calibrate {name} --again` repeats it")
            continue
        results[name] = run(bench, name, again=again, method=method)
        if not results[name].verdict.good and STEPS[name].needed:
            break
    return results


def fit_csv(
    step: str, path: str | os.PathLike[str], config: RobotConfig, method: str | None = None
) -> StepResult:
    """Fit a step of `STEPS` to readings in a CSV, without robot or camera.

    The method "thesis" fits flex and buckling as the thesis did; None is the step's own method.
    Raises DataError for an unknown step, a step without CSV, or unusable readings.
    """
    fits = {
        name: (fitted.of_csv, fitted.columns) for name, fitted in STEPS.items() if fitted.of_csv
    }
    if step not in fits:
        raise DataError(
            f"there is no fit '{step}' for a CSV", f"use one of {', '.join(sorted(fits))}"
        )
    _require(step, config, in_file=True)
    fit, columns = fits[step]
    try:
        table = Table.read(path)
        result = fit(table, config, *STEPS[step].other_fit(method))
    except MissingColumnError as error:
        error.add_note(f"columns of {step}: {columns}; those in brackets may be omitted")
        if "SENSOR" in columns or "sensor" in columns:
            names = ", ".join(map(table_key, sensors_of(config)))
            error.add_note(f"sensors of this robot: {names}")
        raise
    verdict = replace(result.verdict, notes=(*table.remarks, *result.verdict.notes))
    return cast(StepResult, replace(cast(Any, result), verdict=verdict))
