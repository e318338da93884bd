"""Free curvature of a muscle against its pressure: the thesis's tanh fit (section 3.1) with errors.

Rows are free bends: pressure (measured), curvature by camera, branch (inflating or deflating) and
trial. The camera does not see a bend out of the plane: the sensors that read at least half of it
measure it, to the error of their scales. A muscle without such a sensor is named as not calibrated.
Each branch gets its own tanh map. The robot never lies quite straight, so each trial has an offset;
the spread of these offsets becomes `offset_se`, the common error that the localizer marginalises
and re-estimates from frames without contact. A muscle also bends the body a little more or less in
every trial: that spread, with the error of the fit, is the map's `scale_se`. Errors that the rows
of a trial share appear as differences between trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import norm

from thigmo.calibrate.bench import Bench, Row, bend_rows, unseen_bend_rows
from thigmo.calibrate.columns import Array, column, grouped, sides_of
from thigmo.calibrate.lag import Lag, fit_lag, ramp, tanh_curve
from thigmo.calibrate.overhead import CAMERA_SCALE_SE
from thigmo.calibrate.regression import Mask
from thigmo.calibrate.verdict import StepResult, Verdict, listed
from thigmo.config import SAME_PRESSURE, SIGN, Muscle, MuscleMap, RobotConfig, TanhMap
from thigmo.errors import DataError
from thigmo.record.table import Table
from thigmo.wiring import WiredSensor, Wiring

Branch = Literal["inflate", "deflate"]
BRANCHES: tuple[Branch, ...] = get_args(Branch)

_REJECT = 4.0
_PICTURE_SE = 2e-4  # 1/cm, standard error of a curvature by camera if none is stated
_LAG_SE_S = 0.1  # largest standard error of a lag that is used
_ONE_TRIAL_SE = 5e-4  # 1/cm, error of the common offset after a single trial
_DAYS_SE = 2e-4  # 1/cm, difference between days, which one session cannot show [a guess]
# Prior standard deviation of a trial's gain [a guess], and its weight in trials.
_TRIAL_GAIN, _TRIAL_GAIN_COUNT = 0.015, 2
_MOST_SE = 0.02  # largest standard error of g, as a share of full scale
_MOST_OVER = 1.25  # times max_pressure_psi: a calibration goes a little above what sweeps use
_LEAST_BEND = 1e-3  # 1/cm, that the upper half of the pressures must reach
_MOST_MISFIT = 0.05  # of full scale, by which a map may miss the bends at some pressure


@dataclass(frozen=True)
class BendReadings:
    """Free bends of one muscle at one body pressure."""

    muscle: str  # its name
    body_pressure_psi: float  # set by hand
    pressure_psi: Array  # (n,) measured muscle pressure
    curvature: Array  # (n,) towards the muscle, 1/cm; nan where the body was not seen
    curvature_se: Array  # (n,) standard error, 1/cm
    branch: tuple[str, ...]  # (n,) "inflate" or "deflate"
    trial: NDArray[np.int64]  # (n,) trial numbers
    scale_se: float = CAMERA_SCALE_SE  # relative error of curvature, common to all rows
    sensors: int = 0  # number of sensors that measured the bends; 0 if the camera did

    def __post_init__(self) -> None:
        unknown = set(self.branch) - set(BRANCHES)
        if unknown:
            raise DataError(f"unknown branch '{unknown.pop()}'", "use inflate or deflate")

    def names(self) -> list[str]:
        """Name of each bend for the operator."""
        columns = zip(self.trial.tolist(), self.branch, self.pressure_psi.tolist(), strict=True)
        return [f"trial {trial} {branch} {psi:.1f} psi" for trial, branch, psi in columns]

    @classmethod
    def read_all(cls, table: Table, config: RobotConfig) -> list[BendReadings]:
        """The bends of each muscle and body pressure in a CSV.

        Muscles are given by name, or by side if they bend in the camera's plane. Curvature is
        positive to the left in the plane, and towards the muscle out of it.
        """
        if "muscle" in table:
            muscles = [config.muscles[config.muscle_number(n)] for n in table.words("muscle")]
        else:
            muscles = [config.muscle(side) for side in sides_of(table)]
        keys = [muscle.name for muscle in muscles], table.numbers("body_pressure_psi").tolist()
        branch = table.words("branch", "inflate")
        sign = np.array([SIGN[muscle.side] if muscle.side else 1.0 for muscle in muscles])
        p, k = table.numbers("pressure_psi"), sign * table.numbers("curvature")
        _check_units(table.name, p, k, max(m.max_pressure_psi for m in muscles), config)
        e, trial = table.numbers("curvature_se", _PICTURE_SE), table.integers("trial", 0)
        return [
            cls(
                name,
                body,
                p[rows_of_map],
                k[rows_of_map],
                e[rows_of_map],
                tuple(branch[r] for r in rows_of_map),
                trial[rows_of_map],
            )
            for (name, body), rows_of_map in grouped(zip(*keys, strict=True))
            if np.isfinite(body)
        ]


def _check_units(
    name: str, psi: Array, curvature: Array, most_psi: float, config: RobotConfig
) -> None:
    """Raise DataError for pressures or curvatures that no muscle of this robot reaches."""
    highest = float(np.nanmax(psi, initial=0.0))
    if highest > _MOST_OVER * most_psi:
        raise DataError(
            f"{name}: pressure_psi reaches {highest:.4g}, and max_pressure_psi is {most_psi:g}",
            f"divide kPa by 6.895 (then {highest / 6.895:.3g} psi), or raise max_pressure_psi in "
            "robot.toml",
        )
    tightest = float(np.nanmax(np.abs(curvature), initial=0.0))
    if tightest * config.body.radius_cm >= 1.0:
        raise DataError(
            f"{name}: curvature reaches {tightest:.4g} 1/cm, tighter than the body's radius of "
            f"{config.body.radius_cm:g} cm",
            f"divide 1/m by 100 (then {tightest / 100:.3g} 1/cm), or correct diameter_cm in "
            "robot.toml",
        )


@dataclass(frozen=True)
class ActuatorResult(StepResult):
    """One muscle at one body pressure."""

    readings: BendReadings  # what was fitted
    muscle_map: MuscleMap  # the maps, ready for the configuration
    g_se: float  # largest standard error of g, both branches, up to highest_psi, 1/cm
    highest_psi: float  # largest pressure that was measured
    full_scale: float  # g at that pressure, 1/cm
    offset_se: float  # standard error of a trial's offset and the map's shape together, 1/cm
    used: Mask  # (n,) rows that were kept
    verdict: Verdict  # in words
    lag: Lag | None = None  # pressure to bend, if a ramp was recorded at this body pressure
    EVIDENCE: ClassVar = ("readings", "used")

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "muscle": self.readings.muscle,
            **super().as_data(),
            "rows": len(self.used),
            "rows_left_out": np.flatnonzero(~self.used).tolist(),
        }

    def ends_early(self, config: RobotConfig) -> bool:
        """Whether no bend was measured near the muscle's largest pressure."""
        muscle = config.muscles[config.muscle_number(self.readings.muscle)]
        return self.highest_psi < (1 - SAME_PRESSURE) * muscle.max_pressure_psi

    def write(self, config: RobotConfig) -> None:
        """Store the map as that of its body pressure (within 10 %).

        A muscle that was measured to less than its largest pressure is pressed to that much only.
        """
        actuator = config.muscles[config.muscle_number(self.readings.muscle)]
        # A body that does not grow may have no pressure.
        apart_psi = [
            abs(self.muscle_map.body_pressure_psi - pressure.pressure_psi)
            for pressure in config.body.pressures
        ]
        body_pressure = int(np.argmin(apart_psi))
        nearest = config.body.pressures[body_pressure]
        if apart_psi[body_pressure] > SAME_PRESSURE * nearest.pressure_psi:
            raise DataError(
                f"no body pressure is {self.muscle_map.body_pressure_psi:g} psi",
                "correct body.pressure in robot.toml",
            )
        actuator.maps[body_pressure] = self.muscle_map
        if self.ends_early(config):
            actuator.max_pressure_psi = round(self.highest_psi, 2)
        actuator.offset_se = self.offset_se
        if self.lag is not None:
            # The board has one constant, and looks for contacts while pressure rises.
            actuator.lag_s = self.lag.inflate_s


@dataclass(frozen=True)
class ActuatorResults(StepResult):
    """Results of all muscles at all body pressures that were measured."""

    maps: tuple[ActuatorResult, ...]
    verdict: Verdict
    not_calibrated: tuple[str, ...] = ()  # muscles that nothing measures; their maps are kept
    EVIDENCE: ClassVar = ("maps",)

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {"maps": [result.as_data() for result in self.maps], **super().as_data()}

    def write(self, config: RobotConfig) -> None:
        """Put in all maps, and the largest offset error of each muscle."""
        for result in sorted(self.maps, key=lambda fit: fit.offset_se):
            result.write(config)


def together(fits: Sequence[ActuatorResult], unmeasured: Sequence[Muscle] = ()) -> ActuatorResults:
    """Combine maps under one verdict, which names the muscles that nothing measures."""
    bad: list[str] = []
    notes: list[str] = []
    for r in fits:
        name = f"{r.readings.muscle} at {r.readings.body_pressure_psi:g} psi"
        (notes if r.verdict.good else bad).append(f"{name}: {r.verdict.reason}")
        notes += [f"{name}: {text}" for text in r.verdict.notes]
    worst = max(
        np.hypot(r.g_se / max(r.full_scale, 1e-9), r.readings.scale_se if r.readings.sensors else 0)
        for r in fits
    )
    good = f"{len(fits)} maps, g to {100 * worst:.2f} % or better"
    names = tuple(muscle.name for muscle in unmeasured)
    if names:
        good += f"; not calibrated: {' and '.join(names)}"
        notes += [_unmeasured_text(muscle) for muscle in unmeasured]
    return ActuatorResults(tuple(fits), Verdict(not bad, [*bad, good][0], tuple(notes)), names)


def _unmeasured_text(muscle: Muscle) -> str:
    return (
        f"muscle {muscle.name} is not calibrated: no healthy sensor reads a bend towards "
        f"{muscle.angle_deg:g} degrees, and the camera sees the plane only; put a sensor at "
        f"{(muscle.angle_deg + 180) % 360:g} degrees"
    )


def _map_values(p: Array, log_amplitude: Array, log_scale: Array, offset: Array) -> Array:
    return tanh_curve(p, np.exp(log_amplitude), np.exp(log_scale), offset)


def guided(bench: Bench) -> ActuatorResults:
    """Measure and fit maps and lags of all measurable muscles at the planned body pressures."""
    config, wiring = bench.config, bench.wiring
    body_pressures = bench.plan.body_pressures or tuple(range(len(config.body.pressures)))
    unmeasured = [m for m in config.muscles if not m.side and not _healthy_sensors(wiring, m)]
    measured = [m for m in config.muscles if m not in unmeasured]
    if not measured:
        raise DataError(*_unmeasured_text(unmeasured[0]).split("; "))
    rows = bend_rows(bench, body_pressures)
    for muscle in measured:
        if muscle.side is None:
            rows += unseen_bend_rows(bench, body_pressures, muscle)
    ramps = {muscle.name: ramp(bench, muscle, body_pressures[-1]) for muscle in measured}
    fits: list[ActuatorResult] = []
    for body_pressure, muscle in product(body_pressures, measured):
        muscle_rows = [
            r for r in rows
            if r["body_pressure"] == body_pressure
            and (r.get("side") == muscle.side if muscle.side else r.get("muscle") == muscle.name)
        ]  # fmt: skip
        result = fit_actuator(readings_of(muscle_rows, wiring, muscle, body_pressure))
        record = ramps[muscle.name]
        if result.verdict.good and body_pressure == body_pressures[-1] and record is not None:
            lag = fit_lag(*record, result.muscle_map, muscle.reversal_psi)
            if lag.inflate_se_s < _LAG_SE_S:
                result = replace(result, lag=lag)
        fits.append(result)
    return together(fits, unmeasured)


def _healthy_sensors(wiring: Wiring, muscle: Muscle) -> list[WiredSensor]:
    return [wired for wired in wiring.sensors_reading(muscle) if wired.sound]


def readings_of(
    rows: Sequence[Row], wiring: Wiring, muscle: Muscle, body_pressure: int
) -> BendReadings:
    """Bends of one muscle at one body pressure, by camera if it can see them, else by sensors."""
    if muscle.side:
        k = SIGN[muscle.side] * column(rows, "k")
        error = np.nan_to_num(column(rows, "k_se"), nan=_PICTURE_SE)
        scale_se, sensors = CAMERA_SCALE_SE, 0
    else:
        sound = _healthy_sensors(wiring, muscle)
        k, error, scale_se = curvature_by_sensors(column(rows, "ohm"), sound)
        sensors = len(sound)
    branch, trial = tuple(r["branch"] for r in rows), np.array([r["trial"] for r in rows], np.int64)
    psi, body_psi = column(rows, "psi"), wiring.config.body.pressures[body_pressure].pressure_psi
    return BendReadings(muscle.name, body_psi, psi, k, error, branch, trial, scale_se, sensors)


def curvature_by_sensors(ohm: Array, sensors: Sequence[WiredSensor]) -> tuple[Array, Array, float]:
    """Curvature (n,) towards a muscle, its standard error (n,), and the scale's relative error.

    `ohm` (n, inputs) holds the changes of resistance from the straight body. The curvature is a
    weighted least-squares fit to all sensors that were read. Errors of their scales are
    independent.
    """
    share = np.array([wired.share for wired in sensors])
    scale = [wired.sensor.raw_scale for wired in sensors]
    readings = ohm[:, [wired.number for wired in sensors]] * scale
    weight = np.isfinite(readings) / np.array([wired.sensor.reading_se for wired in sensors]) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        power = weight @ share**2
        k = (weight * np.nan_to_num(readings)) @ share / power
        gain = weight * share**2 / power[:, None] * [w.sensor.gain_error for w in sensors]
    scale_se = float(np.nanmax(np.hypot.reduce(gain, axis=1), initial=0.0))
    return k, np.where(power > 0, power, np.inf) ** -0.5, scale_se


def of_csv(table: Table, config: RobotConfig) -> ActuatorResults:
    """Fit the bends of one or more muscles from a CSV."""
    results = [fit_actuator(readings) for readings in BendReadings.read_all(table, config)]
    if not results:
        raise DataError(f"{table.name} holds no bends", "give one line for each bend")
    return together([
        replace(result, verdict=_note_end_of_map(result.verdict, result.highest_psi))
        if result.ends_early(config) else result
        for result in results
    ])  # fmt: skip


def _note_end_of_map(verdict: Verdict, highest_psi: float) -> Verdict:
    note = (
        f"no bend was measured above {highest_psi:.2f} psi: max_pressure_psi is lowered to it, so "
        "that no sweep goes beyond; measure further, and raise it, for larger sweeps"
    )
    return replace(verdict, notes=(*verdict.notes, note)) if verdict.good else verdict


def fit_actuator(readings: BendReadings) -> ActuatorResult:
    """Fit tanh maps of both branches, with an offset for each trial."""
    p, k, error = readings.pressure_psi, readings.curvature, readings.curvature_se
    finite = np.isfinite(p) & np.isfinite(k)
    total = int(finite.sum())
    if total < 8 or np.ptp(p[finite]) < 0.5 * p[finite].max():
        raise DataError(
            f"{total} usable bends of the {readings.muscle} muscle",
            "take ten pressures from 0 to the highest that a sweep shall use, three trials",
        )
    notes: list[str] = []
    if not finite.all():
        missed = listed(readings.names(), np.flatnonzero(~finite).tolist())
        cause = "the camera lost the body; clear the view"
        if readings.sensors:
            cause = "no sensor was read; check their wires"
        notes.append(f"omitted {missed}: {cause} to take it again")
    highest = float(p[finite].max())
    bend = float(np.median(k[finite & (p > 0.5 * highest)]))
    if bend < _LEAST_BEND:
        verdict = Verdict(False, _wrong_bend_reason(readings, bend), tuple(notes))
        muscle_map = MuscleMap(body_pressure_psi=readings.body_pressure_psi)
        return ActuatorResult(readings, muscle_map, np.inf, highest, 0.0, np.inf, finite, verdict)
    branches = [b for b in BRANCHES if b in np.array(readings.branch)[finite]]
    branch = np.array([branches.index(b) if b in branches else 0 for b in readings.branch])
    trials = np.unique(readings.trial[finite])
    slot = np.minimum(np.searchsorted(trials, readings.trial), len(trials) - 1)
    used = finite.copy()
    top = float(np.quantile(np.abs(k[finite]), 0.9))
    sigma, offset_sigma = 0.03 * max(top, 1e-3), _ONE_TRIAL_SE
    maps = 3 * len(branches)

    def curve(x: Array) -> Array:
        return _map_values(p, *x[:maps].reshape(-1, 3)[branch].T)

    def residuals(x: Array, rows: Mask, spread: float, loose: float) -> Array:
        scaled = (k - curve(x) - x[maps:][slot]) / np.hypot(spread, error)
        # Weak priors bound a saturation that the data do not reach.
        priors = [(x[2:maps:3] - 4.0) / 8.0, (x[1:maps:3] - np.log(10.0)) / 1.5]
        return np.concatenate([scaled[rows], x[maps:] / loose, *priors])

    def unknowns(parts: list[float], offset: float) -> Array:
        return np.append(np.tile(parts, len(branches)), np.full(len(trials), offset))

    size = float(np.log(max(top, 1e-3)))
    best = unknowns([size, np.log(8.0), 4.0], 0.0)
    bounds = (unknowns([size - 1.5, 0.0, -10.0], -0.05), unknowns([size + 2.0, 4.0, 25.0], 0.05))
    # The camera has the same error in all pictures of a place, so it does not average out.
    camera_se = float(np.median(error[finite]))
    for attempt in range(8):
        # A Cauchy loss first, so that a tenth of wild readings does not affect the start.
        fit = least_squares(
            residuals, best, args=(used, sigma, offset_sigma), bounds=bounds,
            loss="cauchy" if attempt < 2 else "linear", f_scale=2.0, x_scale="jac",
        )  # fmt: skip
        best, offsets = fit.x, fit.x[maps:]
        residual = k - curve(best) - offsets[slot]
        freedom = max(1, int(used.sum()) - maps - len(trials))
        robust = float(np.median(np.abs(residual[finite])) / norm.ppf(0.75))
        scatter = robust if attempt < 3 else float(np.sqrt(np.sum(residual[used] ** 2) / freedom))
        sigma = float(np.sqrt(max(scatter**2 - camera_se**2, (0.2 * camera_se) ** 2, 1e-12)))
        if len(trials) > 1:
            offset_sigma = float(max(2e-4, np.sqrt(np.mean(offsets**2))))
        inliers = finite & (np.abs(residual) < _REJECT * np.hypot(sigma, error))
        if attempt > 3 and (inliers == used).all():
            break
        if inliers.sum() >= maps + len(trials) + 3:
            used = inliers
    jacobian = np.asarray(fit.jac, float)
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    fitted_maps, (fit_se, top_se, shape_se) = _maps(best[:maps], covariance, branches, highest)
    g_se = float(np.hypot(fit_se, camera_se))
    trial_se = _trial_gain(residual, curve(best), slot, used, len(trials))
    scale_se = float(np.sqrt(
        top_se**2 + trial_se**2 * (1 + 1 / len(trials)) + readings.scale_se**2
    ))  # fmt: skip
    if len(branches) == 1:
        notes.append(f"only the {branches[0]} branch was measured; used for both")
    inflate, deflate = fitted_maps[branches[0]], fitted_maps[branches[-1]]
    outliers = np.flatnonzero(finite & ~used).tolist()
    if outliers:
        names = listed(readings.names(), outliers)
        notes.append(f"omitted {len(outliers)} of {total} bends as outliers ({names})")
    spread = float(np.std(offsets, ddof=1)) if len(trials) > 1 else offset_sigma
    shifted_trials = trials[np.abs(offsets - np.median(offsets)) > 3e-3]
    full_scale = float(inflate.curvature(highest))
    notes += _misfit_notes(p[used], residual[used], full_scale)
    if len(shifted_trials):
        names = ", ".join(map(str, shifted_trials.tolist()))
        notes.append(f"trial {names} is bent by a constant against the others")
    good, reason = _judge(
        readings,
        len(shifted_trials) > 0,
        len(outliers) / total,
        g_se / max(full_scale, 1e-9),
        full_scale,
    )
    muscle_map = MuscleMap(
        body_pressure_psi=readings.body_pressure_psi, scale_se=scale_se, inflate=inflate,
        deflate=deflate,
    )  # fmt: skip
    offset_se = float(np.hypot(max(spread, _DAYS_SE), np.hypot(shape_se, camera_se)))
    verdict = Verdict(good, reason, tuple(notes))
    return ActuatorResult(readings, muscle_map, g_se, highest, full_scale, offset_se, used, verdict)


def _maps(
    best: Array, covariance: Array, branches: Sequence[str], highest: float
) -> tuple[dict[str, TanhMap], Array]:
    """The map of each branch, and the largest standard errors of these maps, (3,).

    The errors are that of the curvature at any pressure up to `highest` (1/cm), the relative one
    at that pressure, and that of the shape, which the map's scale does not account for (1/cm).
    """
    grid, errors, built = np.linspace(0.0, highest, 37), np.zeros(3), {}
    for name, places in zip(branches, np.arange(best.size).reshape(-1, 3), strict=True):
        x, values = best[places], _map_values(grid, *best[places])
        slopes = np.array([
            (_map_values(grid, *(x + step)) - _map_values(grid, *(x - step))) / 2e-5
            for step in 1e-5 * np.eye(3)
        ])  # fmt: skip
        variance = np.einsum("pg,pq,qg->g", slopes, covariance[np.ix_(places, places)], slopes)
        share = np.interp(highest, grid, np.sqrt(variance) / np.maximum(values, 1e-9))
        shape = np.maximum(variance - (share * values) ** 2, 0.0)
        errors = np.maximum(errors, [np.sqrt(variance.max()), share, np.sqrt(shape.max())])
        amplitude, scale = np.exp(x[:2]).tolist()
        built[name] = TanhMap(amplitude=amplitude, scale_psi=scale, offset_psi=float(x[2]))
    return built, errors


def _misfit_notes(pressure_psi: Array, residual: Array, full_scale: float) -> list[str]:
    """Where the bends of all trials leave the map, which is a tanh; more trials do not help."""
    bins = np.digitize(pressure_psi, np.linspace(0.0, pressure_psi.max(), 9)[1:-1])
    levels = [bins == number for number in np.unique(bins)]
    misfits = [float(np.median(residual[level])) for level in levels]
    worst = int(np.argmax(np.abs(misfits)))
    share = abs(misfits[worst]) / max(full_scale, 1e-9)
    if share < _MOST_MISFIT:
        return []
    near_psi = float(np.median(pressure_psi[levels[worst]]))
    return [
        f"near {near_psi:.1f} psi the muscle bends {100 * share:.0f} % of full scale "
        f"{'more' if misfits[worst] > 0 else 'less'} than its map, a tanh, in all trials: measure "
        "only the pressures that sweeps use, or expect larger errors there"
    ]


def _wrong_bend_reason(readings: BendReadings, bend: float) -> str:
    """The likely reason why a muscle does not bend the body towards itself."""
    name = readings.muscle
    if bend > -_LEAST_BEND:
        return (
            f"the robot does not bend when the {name} muscle is inflated: check its air, and its "
            "angle_deg and that of the sensors"
        )
    cause = "the camera's picture is mirrored"
    if readings.sensors:
        cause = "scale_per_ohm of the sensors has the wrong sign"
    return (
        f"the robot bends to the other side when the {name} muscle is inflated: the muscles' tubes "
        f"are swapped, or {cause}; exchange and repeat"
    )


def _judge(
    readings: BendReadings, shifted: bool, left_out: float, share: float, full: float
) -> tuple[bool, str]:
    """Whether the maps may be used, and why.

    `left_out` is the share of bends omitted, `share` the error of g over full scale.
    """
    if shifted and readings.sensors:
        return False, "the sensors' zeros moved between trials; let them settle, then repeat those"
    if shifted:
        return False, (
            "the camera or the base moved between trials; fix it, run `thigmo camera locate` "
            "and repeat those trials"
        )
    if left_out > 0.3:
        return False, "a third of the bends disagree with any smooth map"
    # More trials do not help beyond the error of the sensors' scales.
    if share > max(_MOST_SE, readings.scale_se):
        taken = len(np.unique(readings.trial))  # the error falls with the root of it
        least = int(np.ceil(taken * (share / max(_MOST_SE, readings.scale_se)) ** 2))
        return False, (
            f"g is known to {100 * share:.1f} % of full scale only; add trials, to {least} at least"
        )
    reason = f"g known to {100 * share:.2f} % of full scale ({full:.4f} 1/cm)"
    if readings.sensors:
        reason += (
            f" as {readings.sensors} sensor{'s'[: readings.sensors > 1]} read it, with scales "
            f"known to {100 * readings.scale_se:.0f} %"
        )
    return True, reason


def _trial_gain(
    residual: Array, bend: Array, slot: NDArray[np.intp], used: Mask, trials: int
) -> float:
    """Relative standard deviation of the gain by which a trial's bends exceed the map.

    Arrays are (n,): `rest` is the residual after map and offset, `bend` the map's curvature, and
    `slot` the number of the trial.
    """
    squares, noise_squares = 0.0, 0.0
    for trial in range(trials):
        pick = used & (slot == trial)
        lever = bend[pick] - bend[pick].mean() if pick.any() else np.zeros(0)
        power = float(lever @ lever)
        if pick.sum() < 4 or power < 1e-12:
            continue
        gain = float(lever @ residual[pick]) / power
        unexplained = residual[pick] - residual[pick].mean() - gain * lever
        squares += gain**2
        noise_squares += float(unexplained @ unexplained) / (pick.sum() - 2) / power
    gain_squares = max(squares - noise_squares * (trials - 1) / trials, 0.0)
    count = trials - 1 + _TRIAL_GAIN_COUNT
    return float(np.sqrt((gain_squares + _TRIAL_GAIN_COUNT * _TRIAL_GAIN**2) / count))
