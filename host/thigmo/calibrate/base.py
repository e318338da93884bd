"""Compliance of the base: the angle by which it turns for each unit of moment over EI there.

No sensor on the body sees this turn, and no sweep tells it from an obstacle that yields. So the tip
is pushed aside by two known amounts to either side, with vented muscles and below the fold. Each
picture gives the moment and the turn, and the compliance is the slope of a line through them. A lab
without a camera gives moments or forces, and the base's turn or the tip's place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from thigmo.calibrate.axis import FEWEST_POINTS, AxisPoints, fit_axis, pictures_of
from thigmo.calibrate.bench import DEEPEST_LEAN, Bench, lean_rows
from thigmo.calibrate.columns import Array
from thigmo.calibrate.regression import LinearFit, Mask, fit_linear
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import critical_moment, push, push_tip
from thigmo.record.table import Table

COLUMNS = (
    "picture, x_cm, y_cm [force_arc_cm]; or turn_deg or tip_y_cm, with force_n [force_se] or "
    "moment [moment_se] [force_arc_cm]"
)
_FEWEST = 4  # pushes
_TURN_SE = 5e-4  # rad, least error of one turn
_MOST_TURN, _MOST_ASIDE = 2.0, 0.75  # moment times arc over EI; share of the reach
_LEAST_MOMENT = 0.25  # between the smallest and the largest push, of the moment that folds the base
_FOLDED = 0.95  # of that moment: beyond it, the fold may begin
# Error of the tip's way aside by the base's turn, over that by the body's own bend. Explorations
# of a base that is taken for rigid err more from 0.05 on, so half of that is good enough; or a
# tenth of the compliance.
_GOOD_BEND, _GOOD_SHARE = 0.025, 0.1
_TWO_SIZES = 0.2  # least difference of two sizes of push, of the larger one
_DOUBT = 3.0  # standard errors beyond which a number has the wrong sign, or a line is bent
# Share of the turn, and rad, by which a line must be bent at the largest push to count.
_BENT_SHARE, _BENT_RAD = 0.2, 0.01
# Stiffness at the base over that at the tip, relative: no step measures it.
_TAPER_SE = 0.1
_LOAD_SE = 0.05  # of forces and moments whose file states none, relative


class Pushes(NamedTuple):
    """Moments and turns of t pushes."""

    moment: Array  # (t,) at the base, over EI, 1/cm
    turn: Array  # (t,) of the base, rad
    covariance: Array  # (t, 2, 2) of turn and moment


@dataclass(frozen=True)
class BaseResult(StepResult):
    """Compliance of the base."""

    EVIDENCE = ("used",)

    compliance_cm: float  # rad for each 1/cm of moment over EI; not below 0
    compliance_se_cm: float  # its standard error
    moment: Array  # (t,) over EI of each push, 1/cm
    turn_rad: Array  # (t,) of the base, less that of the straight robot
    verdict: Verdict
    used: Mask = field(default_factory=lambda: np.zeros(0, bool))  # (t,) pushes that count

    def write(self, config: RobotConfig) -> None:
        """Put in the compliance and its error."""
        config.body.base_compliance_cm = self.compliance_cm
        config.body.base_compliance_se_cm = self.compliance_se_cm


def guided(bench: Bench) -> BaseResult:
    """Fit pictures of the tip pushed aside by two amounts to either side."""
    points = [row["points"] for row in lean_rows(bench)]
    length = bench.config.body.length_cm
    return fit_pictures(
        [AxisPoints(np.array(axis, float), length) for axis in points if axis is not None],
        bench.config,
    )


def of_csv(table: Table, config: RobotConfig) -> BaseResult:
    """Fit a CSV of points along the axis by picture, or of pushes with known forces or moments."""
    length = config.body.length_cm
    if "picture" in table:
        return fit_pictures(pictures_of(table, length), config)
    arc = table.numbers("force_arc_cm", length)
    if "moment" in table:
        moment, load_se = table.numbers("moment"), table.numbers("moment_se", _LOAD_SE)
        force = np.array([_force(*pair) for pair in zip(moment, _arcs(arc, length), strict=True)])
    else:
        newtons, load_se = table.numbers("force_n"), table.numbers("force_se", _LOAD_SE)
        if config.body.stiffness is None:
            raise DataError(
                "robot.toml has no bending stiffness, without which force_n gives no moment",
                "give a column moment (over EI, 1/cm), or run `thigmo calibrate stiffness` first",
            )
        stiffness, stiffness_se = config.body.stiffness
        force, load_se = newtons / stiffness, np.hypot(load_se, stiffness_se)
    if not (np.isfinite(load_se).all() and (load_se >= 0).all()):
        raise DataError("a force_se or moment_se is negative or missing", "give 0.02 for 2 %")
    if "turn_deg" in table:
        turn, tip = np.radians(table.numbers("turn_deg")), None
        if np.nanmax(np.abs(turn), initial=0.0) > 1.0:
            raise DataError(
                "a turn_deg is beyond 57 degrees", "give degrees from the straight robot"
            )
    else:
        turn, tip = None, table.numbers("tip_y_cm")
    return fit_pushes(
        force, _arcs(arc, length), config, turn_rad=turn, tip_y_cm=tip,
        load_se=float(load_se.mean()),
    )  # fmt: skip


def fit_pictures(pictures: Sequence[AxisPoints], config: RobotConfig) -> BaseResult:
    """Compliance of the base from pictures of the pushed body."""
    fine = np.arange(0.0, config.body.length_cm + 1e-9, 0.1)
    enough = [picture for picture in pictures if len(picture.points_cm) >= FEWEST_POINTS]
    notes = []
    if len(enough) < len(pictures):
        notes.append(f"{len(pictures) - len(enough)} picture(s) omitted: too few points")

    def pushes(taper: float) -> Pushes:
        softness = 1.0 + taper * (fine / fine[-1] - 0.5)
        fits = [fit_axis(picture, fine, softness=softness) for picture in enough]
        return Pushes(
            np.array([fit.moment for fit in fits]),
            np.array([fit.turn_rad for fit in fits]),
            np.array([fit.covariance[:2, :2] for fit in fits]).reshape(-1, 2, 2),
        )

    return _fit(pushes, _TAPER_SE, config, notes)


def fit_pushes(
    force: Array,
    arc_cm: Array,
    config: RobotConfig,
    *,
    turn_rad: Array | None = None,
    tip_y_cm: Array | None = None,
    load_se: float = _LOAD_SE,
) -> BaseResult:
    """Compliance of the base from t pushes with known forces.

    Args:
        force: (t,) forces over EI, 1/cm^2, positive to the left.
        arc_cm: (t,) arcs at which they act.
        config: the robot.
        turn_rad: (t,) turns of the base; or
        tip_y_cm: (t,) places of the tip.
        load_se: relative standard error that all forces over EI share.

    Raises:
        DataError: fewer than four pushes, of too little force, or beyond the body's reach.
    """
    length = config.body.length_cm

    def pushes(error: float) -> Pushes:
        moment, turn = np.full((2, len(force)), np.nan)
        for number, (over_ei, arc) in enumerate(zip(force * (1.0 + error), arc_cm, strict=True)):
            if not np.isfinite(over_ei):
                continue
            body = push(float(over_ei), float(arc), free_curvature=0.0, length=length)
            moment[number] = body.base_moment
            if turn_rad is not None:
                turn[number] = turn_rad[number]
            elif tip_y_cm is not None:
                turn[number] = _turn_to(float(tip_y_cm[number]), *body.tip[:2])
        finite = np.isfinite(moment) & np.isfinite(turn)
        return Pushes(moment[finite], turn[finite], np.zeros((int(finite.sum()), 2, 2)))

    return _fit(pushes, load_se, config, [])


def _fit(
    pushes: Callable[[float], Pushes], common_se: float, config: RobotConfig, notes: list[str]
) -> BaseResult:
    """Fit turn over moment.

    `pushes` gives the pushes for a value of the error that all of them share, whose standard error
    is `common_se`.
    """
    body = config.body
    fold = body.push_curvature
    if body.folds:
        fold = critical_moment(fold, body.critical_pressure_psi, body.pressures[-1].pressure_psi)
    taken = pushes(0.0)
    bent = np.abs(taken.moment) > _FOLDED * fold
    if body.folds and bent.any():
        notes.append(f"{int(bent.sum())} push(es) omitted: so far that the base may fold")
    else:
        bent[:] = False
    moment = np.where(bent, np.nan, taken.moment)
    count = int((~bent).sum())
    if count < _FEWEST:
        raise DataError(
            f"{count} usable pushes",
            f"push {_FEWEST} times or more, to both sides, by less than {_aside(config):.0f} cm",
        )
    spread = float(np.nanmax(moment) - np.nanmin(moment))
    if spread < _LEAST_MOMENT * fold:
        raise DataError(
            f"the moments at the base differ by {spread:.4f} 1/cm only, and it folds at {fold:.4f}",
            f"push the tip {_aside(config) / 2:.0f} and {_aside(config):.0f} cm aside, both ways",
        )
    line = _line(moment, taken)
    compliance = float(line.coefficients[1])
    used = line.used & ~bent
    if outliers := int((~line.used & ~bent).sum()):
        notes.append(f"{outliers} push(es) omitted as outliers")
    # Few pushes estimate their scatter poorly, as Student's t has it.
    random_se = line.se(1) * float(student.ppf(0.975, used.sum() - 2) / norm.ppf(0.975))
    shifted = pushes(common_se)
    shifted_line = _line(np.where(used, shifted.moment, np.nan), shifted)
    shift = float(shifted_line.coefficients[1]) - compliance
    error = float(np.hypot(random_se, shift))
    zero = float(line.coefficients[0])
    second_order = _second_order(moment, taken, used)
    if not np.isfinite(second_order[1]):
        notes.append(
            "nothing shows that the turn is proportional to the moment: push five times or more, "
            "by two amounts"
        )
    limit_cm = max(_GOOD_BEND * body.length_cm / 3, _GOOD_SHARE * compliance)
    good, reason = _judged(compliance, error, second_order, fold, limit_cm)
    return BaseResult(
        max(compliance, 0.0), error, taken.moment, taken.turn - zero,
        Verdict(good, reason, tuple(notes)), used,
    )  # fmt: skip


def _judged(
    compliance: float,
    error: float,
    second_order: tuple[float, float],
    fold: float,
    limit_cm: float,
) -> tuple[bool, str]:
    """Whether the compliance may be used, and why; `second_order` is in rad at the largest push."""
    turn, turn_se = compliance * fold, error * fold
    verb = "turns" if abs(turn) > 2 * turn_se else "holds: it turns"
    measured = f"the base {verb} by {turn:.4f} +- {turn_se:.4f} rad at {fold:.4f} 1/cm"
    if compliance < -_DOUBT * error:
        return False, (
            f"{measured}, against the push: check signs, and the arc at which the force acts"
        )
    bend, bend_se = second_order
    if abs(bend) > max(_DOUBT * bend_se, _BENT_SHARE * abs(turn), _BENT_RAD):
        return False, (
            f"the base's turn is not proportional to the moment ({bend:+.3f} rad off at the "
            "largest): it slips, or folds; clamp it, or push less, and take the pushes again"
        )
    if error > limit_cm:
        return False, (
            f"{measured}: more uncertain than {limit_cm * fold:.4f} rad; take more pushes, or "
            "measure the base's turn by pictures"
        )
    return True, f"{measured}, {max(compliance, 0.0):.2f} +- {error:.2f} cm"


def _line(moment: Array, pushes: Pushes) -> LinearFit:
    """The line of turn over moment, with the errors of both."""
    design, slope = np.column_stack([np.ones(len(moment)), moment]), 0.0
    for _ in range(2):
        across = np.array([1.0, -slope])
        known_se = np.sqrt(_TURN_SE**2 + across @ pushes.covariance @ across)
        line = fit_linear(design, pushes.turn, known_se)
        slope = float(line.coefficients[1])
    return line


def _second_order(moment: Array, pushes: Pushes, used: Mask) -> tuple[float, float]:
    """How far the turn at the largest moment leaves the line of small ones, and the error, rad."""
    sizes = np.abs(moment[used])
    if len(sizes) < _FEWEST + 1 or np.ptp(sizes) < _TWO_SIZES * sizes.max():
        return 0.0, np.inf
    kept = np.where(used, moment, np.nan)
    bend = kept * np.abs(kept)
    design = np.column_stack([np.ones(len(kept)), kept, bend])
    fit = fit_linear(design, pushes.turn, _TURN_SE, reject=False)
    largest = float(np.nanmax(np.abs(bend)))
    return float(fit.coefficients[2]) * largest, fit.se(2) * largest


def _aside(config: RobotConfig) -> float:
    """How far the tip may be pushed aside, cm."""
    body = config.body
    return push_tip(DEEPEST_LEAN * body.push_curvature, body.length_cm).tip[1]


def _arcs(arc_cm: Array, length_cm: float) -> Array:
    if not ((arc_cm > 0) & (arc_cm <= length_cm)).all():
        raise DataError("a force_arc_cm is off the body", "give where it acts, from the base")
    return arc_cm


def _force(moment: float, arc_cm: float) -> float:
    """Force normal to the body at an arc that gives a moment at the base, over EI, 1/cm^2."""
    if not np.isfinite(moment) or moment == 0.0:
        return moment
    if abs(moment) * arc_cm > _MOST_TURN:
        raise DataError(f"a moment of {moment:g} 1/cm bends the body back", "give 1/cm, over EI")
    bent = push_tip(abs(moment), arc_cm)
    return float(np.copysign(bent.contacts[0].normal, moment))


def _turn_to(tip_y_cm: float, x_cm: float, y_cm: float) -> float:
    """Angle about the base that brings a point (x, y) to a y, rad."""
    reach = float(np.hypot(x_cm, y_cm))
    if abs(tip_y_cm) > _MOST_ASIDE * reach:
        raise DataError(f"the tip cannot stand {tip_y_cm:.1f} cm aside", "give cm, left positive")
    return float(np.arcsin(tip_y_cm / reach) - np.arctan2(y_cm, x_cm))
