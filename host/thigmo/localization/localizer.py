"""`Localizer` finds contacts, with intervals, in a frame of readings or in a table of frames.

Its `options` are checked once (`validation`). Each frame is checked and normalised (`input.h`).
Explanations are weighed (`hypotheses.h`) and mixed into an answer (`answer.h`): one posterior over
everything that may have bent the body, with every stated error. Nothing is discarded silently.
`localize` and `localize_batch` make a `Localizer` and use it once.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from thigmo.contact_status import WIDTH_SHARE
from thigmo.errors import DataError
from thigmo.localization import _posterior, priors
from thigmo.localization.batch import BatchResult
from thigmo.localization.options import Body, Errors, Priors, Sensors
from thigmo.localization.result import LocalizeResult
from thigmo.localization.space import in_space
from thigmo.localization.validation import (
    Array,
    bending_stiffness,
    check_layout,
    columns,
    contact_count,
    correlation,
    everted_length,
    grip,
    positive,
    refusal,
    share,
    share_of_length,
    stated,
    vector,
    white_noise,
)

_MOST_CONTACTS = 3
METHODS = ("posterior", "thesis")
_PARTS = {"body": Body, "sensors": Sensors, "errors": Errors, "priors": Priors}
_PART_OF = {option.name: name for name, part in _PARTS.items() for option in fields(part)}


@dataclass(frozen=True, eq=False, repr=False)
class Localizer:
    """Finds the contacts on a body. Immutable; the options are checked when it is made.

    Each stated error widens the intervals. For an error that is not stated, usual mistakes are
    weighed; state 0 for one that the readings do not have.

    Args:
        body: the body.
        sensors: where its sensors are.
        errors: standard errors of their readings.
        priors: prior knowledge, and what counts as localized.
        method: "posterior", or "thesis", whose answers have no intervals and the status
            `point estimate`. It is the thesis's alternating fit, with its remedies for a folded
            base if `critical_curvature` is given; lengths must be in cm. It fits the number of
            contacts given, one for "auto", and ignores the errors (source:
            `thigmo.localization.thesis`).

    Raises:
        DataError: a number is impossible, or lengths look like another unit.

    Example:
        >>> body = thigmo.Body(length=53.0, critical_curvature=0.011)
        >>> sensors = thigmo.Sensors(position=[5, 15, 25, 35, 45], span=5.5)
        >>> errors = thigmo.Errors(noise=6e-4, map_error=0.03, offset_error=2e-4)
        >>> localizer = thigmo.Localizer(body, sensors, errors)
        >>> round(localizer.localize([0.0059, 0.0042, 0.0021, 0.0006, 0.0]).contacts[0].arc, 1)
        38.3
        >>> localizer.localize_batch([[0.0059, 0.0042, 0.0021, 0.0006, 0.0], [0.0] * 5])
        BatchResult(2 rows: 1 no contact, 1 ambiguous)

    References:
        The mechanics: S. S. Antman, Nonlinear Problems of Elasticity, 2nd ed., chapters 4 and 8.
        Evidence and model comparison: D. J. C. MacKay, Information Theory, Inference, and
        Learning Algorithms, chapter 28. The method, with its equations: docs/methods.md.
    """

    body: Body
    sensors: Sensors
    errors: Errors = field(default_factory=Errors)
    priors: Priors = field(default_factory=Priors)
    method: str = "posterior"
    _compiled: _posterior.Localizer = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_compiled", self._checked())

    @classmethod
    def of(cls, *, method: str = "posterior", **options: Any) -> Localizer:
        """Make a localizer from options by name: the fields of `Body`, `Sensors`, and so on.

        Raises:
            TypeError: an option is unknown, or `position` or `length` is missing.
            DataError: as for the constructor.
        """
        given: dict[str, dict[str, Any]] = {name: {} for name in _PARTS}
        for name, value in options.items():
            if name not in _PART_OF:
                raise TypeError(f"{name!r} is no option; options are {', '.join(_PART_OF)}")
            given[_PART_OF[name]][name] = value
        parts = {name: part(**given[name]) for name, part in _PARTS.items()}
        return cls(**parts, method=method)

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle: the compiled part is made again."""
        return Localizer, (self.body, self.sensors, self.errors, self.priors, self.method)

    @property
    def length(self) -> float:
        """Everted length of the body."""
        return self._compiled.length

    def localize(
        self,
        curvature: npt.ArrayLike,
        *,
        free_curvature: npt.ArrayLike | None = None,
        body_curvature: npt.ArrayLike | None = None,
    ) -> LocalizeResult:
        """Find the contacts in one frame.

        Args:
            curvature: (N,) readings, average curvature over each sensor; NaN if one is missing.
            free_curvature: scalar or (N,) reading of each sensor without contact; 0 for a body that
                nothing actuates. None, not given, differs from 0: unless `map_error` is stated, a
                body is weighed that bends without contact, too.
            body_curvature: scalar or (N,) curvature of the free body at the sensors, if it differs
                from `free_curvature`.

        Returns:
            Contacts with 95 % intervals, probabilities, status, and the likeliest explanation.

        Raises:
            DataError: readings cannot be used as given, or look like another unit.
        """
        k = vector(curvature, "curvature")
        count = self._compiled.count
        if k.size != count:
            raise DataError(
                "position and curvature differ in length", "give one position for each reading"
            )
        free = self._free(free_curvature)
        body = free if free.size else np.zeros(1)
        body = body if body_curvature is None else vector(body_curvature, "body_curvature", count)
        answer = self._compiled.localize(k, free, body)
        if answer.problem:
            raise refusal(answer.problem, answer.shows, self.length)
        if self.method != "posterior":
            return self._point_estimate(k - free if free.size else k)
        return LocalizeResult.of(
            answer, k, self.length, self.body.stiffness, noise_stated=self.errors.noise is not None
        )

    def _free(self, free_curvature: npt.ArrayLike | None) -> Array:
        if free_curvature is None:
            return np.zeros(0)
        return vector(free_curvature, "free_curvature", self._compiled.count)

    def localize_batch(
        self,
        curvature: npt.ArrayLike,
        *,
        free_curvature: npt.ArrayLike | None = None,
        body_curvature: npt.ArrayLike | None = None,
        residuals: bool = False,
        jobs: int = 1,
    ) -> BatchResult:
        """Find the contacts in each row of a table, with the same numbers as `localize`.

        The rows are processed in compiled code.

        Args:
            curvature: (M, N) readings; NaN if one is missing.
            free_curvature: scalar, (N,), (M, 1) or (M, N) readings without contact; None as in
                `localize`.
            body_curvature: as `localize` takes it, in the same shapes.
            residuals: whether the result has `predicted` and `residuals`, (M, N).
            jobs: number of threads.

        Raises:
            DataError: as for `localize`, with the number of the row. No row is skipped.
        """
        if self.method != "posterior":
            raise DataError(f"{self.method} takes no rows", "give its frames one by one")
        width = self._compiled.count
        table = np.ascontiguousarray(curvature, dtype=np.float64)
        if table.ndim != 2 or table.shape[1] != width:
            raise DataError(
                f"curvature has shape {table.shape}", f"give (M, {width}), a column for each sensor"
            )
        count = len(table)

        def rows_of(values: npt.ArrayLike | None, name: str, default: Array) -> Array:
            if values is None:
                return default
            array = np.asarray(values, dtype=np.float64)
            if array.ndim < 2:
                array = vector(array, name, width)[None, :]
            if array.shape[0] not in (1, count) or array.shape[1] not in (1, width):
                raise DataError(
                    f"{name} has shape {array.shape}", "give a scalar, (N,), (M, 1) or (M, N)"
                )
            return array

        free = rows_of(free_curvature, "free_curvature", np.zeros((1, 0)))
        body = rows_of(body_curvature, "body_curvature", free if free.size else np.zeros((1, 1)))
        parts = np.array_split(np.arange(count), max(min(jobs, count), 1))

        def run(rows: npt.NDArray[np.int64]) -> tuple[Array, Array, list[str], Array]:
            rows_of_chunk = (
                values if len(values) == 1 else values[rows] for values in (free, body)
            )
            free_rows, body_rows = (np.ascontiguousarray(values) for values in rows_of_chunk)
            return self._compiled.localize_rows(table[rows], free_rows, body_rows, residuals)

        with ThreadPoolExecutor(len(parts)) as pool:
            chunks = list((pool.map if len(parts) > 1 else map)(run, parts))
        of_row, of_contact, names, left = zip(*chunks, strict=True)
        rest = np.concatenate(left) if residuals else None
        return BatchResult.of(
            np.concatenate(of_row),
            np.concatenate(of_contact),
            [name for part in names for name in part],
            self.length,
            noise_stated=self.errors.noise is not None,
            sensors=np.isfinite(table).sum(axis=1),
            predicted=None if rest is None else table - rest,
            residuals=rest,
        )

    def __repr__(self) -> str:
        return f"Localizer({self._compiled.count} sensors, body of {self.length:g}, {self.method})"

    def _checked(self) -> _posterior.Localizer:
        body, errors, known = self.body, self.errors, self.priors
        x, total = vector(self.sensors.position, "position"), everted_length(body.length)
        count = x.size
        white = white_noise(errors.noise, count)
        widths = vector(self.sensors.span, "span", count)
        sensor_errors = {
            "zero_error": vector(errors.zero_error, "zero_error", count),
            "gain_error": vector(
                0.0 if errors.gain_error is None else errors.gain_error, "gain_error", count
            ),
        }
        odds = vector(known.bad_reading_odds, "bad_reading_odds", count)
        check_layout(x, widths, total, noise=white, bad_reading_odds=odds, **sensor_errors)
        if white.size:
            white = np.hypot(white, sensor_errors["zero_error"])
        check_method(self.method)
        least = 0 if self.method == "posterior" else 1
        contacts = contact_count(known.contacts, self.method, least, _MOST_CONTACTS)
        radius, limit = priors.TUBE_RADIUS * total, WIDTH_SHARE
        if body.tube_radius is not None:
            radius = max(positive(body.tube_radius, "tube_radius"), 1e-6 * total)
        critical, moment = body.critical_curvature, math.inf
        if critical is not None and critical != math.inf:
            moment = max(positive(critical, "critical_curvature") * total, 1e-6)
        if known.width_limit is not None:
            limit = positive(known.width_limit, "width_limit") / total
        bending_stiffness(body.stiffness)
        face = known.end_face_odds
        held, held_odds = grip(known.held_end)
        slack = positive(body.critical_curvature_error, "critical_curvature_error")
        space = in_space(body, self.sensors, x, widths)
        if space.axis.size and self.method != "posterior":
            raise DataError(f"{self.method} knows no angles", "leave it out, or the method")
        if space.axis.size and moment < math.inf:
            raise DataError(
                "critical_curvature is given, and no fold is weighed in space", "leave it out"
            )
        return _posterior.Localizer(
            position=x,
            span=widths,
            noise=white,
            gain=sensor_errors["gain_error"],
            bad_odds=odds,
            shared=columns(errors.shared_errors, count),
            offset=stated(errors.offset_error, "offset_error"),
            map_scale=stated(errors.map_error, "map_error"),
            base_fold=stated(errors.base_fold_error, "base_fold_error"),
            correlation=correlation(errors.noise_correlation),
            largest_noise=math.inf
            if errors.largest_noise_factor is None
            else positive(errors.largest_noise_factor, "largest_noise_factor"),
            couple_odds=priors.COUPLE_ODDS
            if known.contact_couple_odds is None
            else positive(known.contact_couple_odds, "contact_couple_odds"),
            length=total,
            radius=radius / total,
            critical=moment,
            critical_error=max(slack, 1e-3),
            folds_perhaps=critical is None,
            held_end=held,
            end_odds=math.nan if face is None else positive(face, "end_face_odds"),
            held_odds=held_odds,
            contacts=contacts,
            within=share_of_length(known.within, total),
            width_limit=limit,
            number_level=share(known.number_level, "number_level"),
            **space._asdict(),
            priors=priors.compiled(),
        )

    def _point_estimate(self, excess: Array) -> LocalizeResult:
        """The answer of "thesis" for checked readings (N,) less the free curvature."""
        from thigmo.localization import thesis  # its optimiser takes a tenth of a second to import

        read = np.isfinite(excess)
        x = vector(self.sensors.position, "position")[read]
        spans = np.broadcast_to(vector(self.sensors.span, "span", excess.size), excess.size)[read]
        count = 1 if self.priors.contacts == "auto" else int(self.priors.contacts)
        critical = self.body.critical_curvature or math.inf
        problem = thesis.ThesisProblem(excess[read], x, spans, self.length, count, critical)
        arcs, forces = thesis.coupled(problem)
        rest = thesis.objective(thesis.at_centres(problem), arcs, forces)
        return LocalizeResult.of_point_estimate(arcs, forces, self.method, rest, self.length)


def check_method(method: str) -> None:
    """Raises DataError if there is no such method."""
    if method not in METHODS:
        raise DataError(f"unknown method {method!r}", f"use one of {', '.join(METHODS)}")


def localize(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    free_curvature: npt.ArrayLike | None = None,
    body_curvature: npt.ArrayLike | None = None,
    **options: Any,
) -> LocalizeResult:
    """Find the contacts in one frame, with a `Localizer` that is used once.

    Args:
        curvature: (N,) readings, average curvature over each sensor; NaN if one is missing.
        position: (N,) sensor centres along the body, 0 at the base.
        length: everted length.
        free_curvature: as in `Localizer.localize`.
        body_curvature: as in `Localizer.localize`.
        options: any other fields of `Body`, `Sensors`, `Errors` and `Priors`, and `method`.

    Raises:
        DataError: as for `Localizer` and `Localizer.localize`.
        TypeError: an option is unknown.

    Example:
        >>> position = [5, 15, 25, 35, 45]
        >>> reading = [0.0059, 0.0042, 0.0021, 0.0006, 0.0]
        >>> thigmo.localize(reading, position, length=53, span=5.5, noise=6e-4)
        LocalizeResult(ambiguous, one contact: arc 38.42, 28.71 to 50.35; body of 53)
        >>> thigmo.localize(reading, position, length=53, span=5.5, noise=1e-4, contacts=1)
        LocalizeResult(localized, one contact: arc 37.76, 36.11 to 39.31; body of 53)
    """
    localizer = Localizer.of(position=position, length=length, **options)
    return localizer.localize(
        curvature, free_curvature=free_curvature, body_curvature=body_curvature
    )


def localize_batch(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    free_curvature: npt.ArrayLike | None = None,
    body_curvature: npt.ArrayLike | None = None,
    residuals: bool = False,
    jobs: int = 1,
    **options: Any,
) -> BatchResult:
    """Find the contacts in each row of a table, as `Localizer.localize_batch` does.

    Args:
        curvature: (M, N) readings; NaN if one is missing.
        position: (N,) sensor centres.
        length: everted length.
        free_curvature, body_curvature, residuals: as in `Localizer.localize_batch`.
        jobs: number of threads.
        options: as in `localize`, the same for all rows.

    Raises:
        DataError: as for `localize`, with the number of the row. No row is skipped.
        TypeError: an option is unknown.
    """
    localizer = Localizer.of(position=position, length=length, **options)
    return localizer.localize_batch(
        curvature,
        free_curvature=free_curvature,
        body_curvature=body_curvature,
        residuals=residuals,
        jobs=jobs,
    )
