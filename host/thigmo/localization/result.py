"""The result of `localize`: contacts, their intervals, and the explanations that were weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from math import isnan, nan
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.contact_status import POINT_ESTIMATE, interval_text
from thigmo.display.bars import Bar
from thigmo.display.html import body_strip, html_card, html_table
from thigmo.extras import data_frame
from thigmo.localization import _posterior, priors
from thigmo.localization.doubts import doubts, reduced, remarks
from thigmo.localization.newtons import Newtons, newtons
from thigmo.localization.validation import Range

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

Array = npt.NDArray[np.float64]
ContactStatus = Literal["localized", "ambiguous", "below detection", "no contact", "point estimate"]
STATUSES: tuple[ContactStatus, ...] = ("no contact", "below detection", "ambiguous", "localized")
UNCHECKED = (
    "there are no more readings than a contact has numbers, so nothing checks the place: "
    "read one more sensor"
)
_BEND_POINTS = 107  # along a body bent by a point fit; every 0.5 cm of 53
_COLUMNS = ("arc", "interval", "force / EI, or N", "probability", "status")


@dataclass(frozen=True, slots=True)
class Contact:
    """One contact. The arc is in the caller's unit, the force over EI in that unit to the power -2.

    Attributes:
        arc: best point along the body: the median of the posterior or, if a single contact's
            `intervals` are several, that of the interval that holds most.
        force: normal force over EI if the contact is at `arc`, positive towards positive curvature.
        interval: hull of `intervals`; the whole body if the status is `point estimate`.
        status: `localized` (the interval is no wider than the limit, and the probability that there
            is a contact is at least 95 %, whatever the number of contacts), `ambiguous`, or
            `point estimate` (the method "thesis" gives no error).
        intervals: densest set of places that holds the contact nearest to `arc` with 95 %, over all
            numbers of contacts and for each number that is likelier than 5 %. It has several pieces
            if the posterior has several modes, and none for a `point estimate`.
        force_deviation: posterior standard deviation of the force over all of `intervals`.
        probability: probability that a contact lies nearer to `arc` than to the arc of any other
            listed contact; NaN for a `point estimate`.
        end_offset: for a contact on the end of the body, the offset of its point from the
            centreline towards +y; None for one on the side.
        vector: in space, the force over EI across the body by the likeliest explanation, with
            components along the body at its base, towards angle 0, and towards a quarter turn
            from it. `force` is then its magnitude. None in a plane.
        newtons: the load in newtons if the body's `stiffness` is given; else None.
    """

    arc: float
    force: float
    interval: Range
    status: ContactStatus
    intervals: tuple[Range, ...] = ()
    force_deviation: float = 0.0
    probability: float = 1.0
    end_offset: float | None = None
    vector: tuple[float, float, float] | None = None
    newtons: Newtons | None = None

    def __repr__(self) -> str:
        return f"Contact({self._place}, {self.status})"

    def _repr_html_(self) -> str:
        return html_table(_COLUMNS, [self._cells])

    @property
    def _place(self) -> str:
        return f"arc {self.arc:.4g}, {self.interval_text}"

    @property
    def interval_text(self) -> str:
        """The interval as text."""
        return interval_text(self.status, self.interval, ".4g")

    @property
    def probability_text(self) -> str:
        """The probability as text."""
        return "unknown" if isnan(self.probability) else f"{self.probability:.3g}"

    @property
    def force_text(self) -> str:
        """The force as text, in newtons if the stiffness was given, else over EI."""
        if self.newtons is not None:
            along = "" if self.newtons.along is None else f", along {self.newtons.along} N"
            return f"{self.newtons.across} N{along}"
        deviation = f" ± {self.force_deviation:.2g}" if self.force_deviation > 0.0 else ""
        return f"{self.force:.3g}{deviation}"

    @property
    def _cells(self) -> list[str]:
        return [
            f"{self.arc:.4g}", self.interval_text, self.force_text, self.probability_text,
            self.status,
        ]  # fmt: skip

    @property
    def _bar(self) -> Bar:
        """The contact as it is drawn on the body."""
        if self.status == POINT_ESTIMATE:
            return Bar(self.arc, (), self.status, f"{self.arc:.4g}  ({self.interval_text})")
        words = (
            f"{self.arc:.4g}  ({self.interval_text}, 95 %)\n"
            f"probability {self.probability:.3g}, {self.status}"
        )
        return Bar(self.arc, self.intervals or (self.interval,), self.status, words)


class Marginal(NamedTuple):
    """Posterior of one contact's place, in M cells along the body."""

    edges: Array  # (M + 1,) edges of the cells, as arcs
    mass: Array  # (M,) posterior mass in each cell
    force: Array  # (M,) mean force over EI of a contact in the cell
    force_deviation: Array  # (M,) standard deviation of that force


class Joint(NamedTuple):
    """Joint posterior of the places of two contacts."""

    near_edges: Array  # (M + 1,) edges of the proximal contact's cells, as arcs
    far_edges: Array  # (K + 1,) edges of the distal contact's cells
    mass: Array  # (M, K) posterior mass of each pair of cells


class OfBody(NamedTuple):
    """Posterior and bend of a body of length one."""

    masses: Sequence[tuple[Array, Array, Array, Array]] = ()  # a `Marginal` of each contact
    bend: Array = np.zeros(0)  # curvature that the loads cause, at evenly spaced arcs
    joint: tuple[Array, Array, Array] | None = None  # the fields of a `Joint`


_NOTHING = OfBody()


@dataclass(slots=True)
class LocalizeResult:
    """Contacts found in one frame of readings.

    Attributes:
        status: the worst status of all contacts; `no contact` or `below detection` if none is
            listed.
        contacts: the contacts, from base to tip.
        hypothesis: the likeliest explanation of the readings.
        message: one sentence for the operator.
        noise: standard deviation of a reading's white noise, given or estimated, 1/length.
        log_odds: log posterior odds of any contact against none.
        hypotheses: posterior probability of each explanation that was weighed.
        discarded: indices of the readings that the likeliest explanation takes for bad.
        parameters: further parameters of the likeliest explanation: `fold_angle`, `hinge_arc`,
            `push_back` (force on the end, towards the base), `tip_moment`, `end_offset`.
        objective: 1-norm of the residual for `thesis`, 1/length; else None.
        touched: probability of any contact.
        doubts: probability of each mistake in the readings that was weighed because its error is
            not stated, or its noise may be larger; the rest is `as stated`. Mistakes that are
            hopeless for these readings are left out. Empty if the readings as stated are those of a
            free body, or all errors are stated.
        remarks: what to check in the readings or in what was stated of them.
        predicted: (N,) readings that the likeliest explanation predicts, with its mistake and the
            likeliest size of all shared errors, 1/length; NaN where one is missing. Empty for a
            `point estimate`, as are `residuals`.
        residuals: (N,) readings less `predicted`.
        reduced_chi2: squared residual over its errors for each degree of freedom: about 1 if the
            errors are as stated. NaN if there are as many numbers as readings.
        correlation: correlation of neighbouring residuals in standard errors; NaN in space. Above
            2, with many sensors, the noise of neighbours is correlated.
        log_evidence: log density of the readings over all explanations, in the caller's unit.
            Differences of it compare descriptions of the body or of the errors.
        number: (4,) probabilities that no, one, two or three contacts move the readings by at least
            three standard errors. A weaker contact can never be excluded.
        length: length of the body.
    """

    status: ContactStatus
    contacts: tuple[Contact, ...]
    hypothesis: str
    message: str
    noise: float
    log_odds: float
    hypotheses: dict[str, float]
    discarded: tuple[int, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    objective: float | None = None
    number: tuple[float, ...] = ()
    touched: float = nan
    doubts: dict[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    predicted: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Array = field(default_factory=lambda: np.zeros(0))
    reduced_chi2: float = nan
    correlation: float = nan
    log_evidence: float = nan
    length: float = 1.0
    _body: _posterior.Answer | OfBody = _NOTHING

    @classmethod
    def of(
        cls,
        answer: _posterior.Answer,
        curvature: Array,
        length: float,
        stiffness: tuple[float, float] | None,
        *,
        noise_stated: bool,
    ) -> LocalizeResult:
        """The compiled code's answer to readings (N,), converted to the caller's units."""
        status = STATUSES[answer.status]
        contacts = tuple(Contact(*values) for values in answer.contacts(length))
        if stiffness is not None:
            # A load on the end belongs to the most distal contact.
            loads = [(nan,) * 4] * (len(contacts) - 1) + [tuple(answer.end_load)]
            contacts = tuple(
                replace(contact, newtons=newtons(stiffness, *cells[1:], load, length))
                for contact, cells, load in zip(contacts, answer.masses, loads, strict=False)
            )
        looks = remarks(
            answer.mistakes, answer.misfit, answer.freedom, answer.correlation,
            sensors=int(np.isfinite(curvature).sum()), noise_stated=noise_stated,
        )  # fmt: skip
        residuals = answer.residual
        return cls(
            status,
            contacts,
            answer.hypothesis,
            message(
                status,
                len(contacts),
                answer.number,
                answer.touched,
                end_open=answer.end_open,
                number_open=answer.number_open,
                discarded=answer.discarded >= 0,
                kinked=answer.kinked,
                freedom=answer.freedom,
                looks=looks,
            ),
            answer.noise,
            answer.log_odds,
            answer.hypotheses,
            () if answer.discarded < 0 else (answer.discarded,),
            answer.parameters(length),
            number=tuple(answer.number),
            touched=answer.touched,
            doubts=doubts(answer.mistakes),
            remarks=looks,
            predicted=curvature - residuals,
            residuals=residuals,
            reduced_chi2=reduced(answer.misfit, answer.freedom),
            correlation=answer.correlation,
            log_evidence=answer.log_evidence,
            length=length,
            _body=answer,
        )

    @classmethod
    def of_point_estimate(
        cls, arcs: Array, forces: Array, method: str, objective: float, length: float
    ) -> LocalizeResult:
        """The result of a method without errors: places and forces, (k,) each.

        Each contact's interval is the whole body.
        """
        bend = np.maximum(arcs - np.linspace(0.0, length, _BEND_POINTS)[:, None], 0.0) @ forces
        return cls(
            POINT_ESTIMATE,
            tuple(
                Contact(arc, force, (0.0, length), POINT_ESTIMATE, (), nan, nan)
                for arc, force in zip(arcs.tolist(), forces.tolist(), strict=True)
            ),
            f"{arcs.size} contact{'s' * (arcs.size > 1)}, {method}",
            f"{method} gives no interval: it cannot say how far off the place is, nor whether "
            "there is a contact at all",
            nan,
            nan,
            {},
            objective=objective,
            length=length,
            _body=OfBody(bend=bend * length),
        )

    def __repr__(self) -> str:
        places = "; ".join(contact._place for contact in self.contacts)
        return (
            f"LocalizeResult({self.status}, {self.hypothesis}{': ' if places else ''}{places}; "
            f"body of {self.length:.4g})"
        )

    def _repr_html_(self) -> str:
        if not self.contacts:
            return html_card(self._title, self.message)
        bars = [contact._bar for contact in self.contacts]
        strip = body_strip(self.length, self.edges.tolist(), self.mass.tolist(), bars)
        table = html_table(_COLUMNS, [contact._cells for contact in self.contacts])
        return html_card(self._title, self.message, strip, table)

    @property
    def _title(self) -> str:
        return f"{self.status}: {self.hypothesis}"

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle: the compiled answer becomes plain arrays."""
        *values, body = (getattr(self, field.name) for field in fields(self))
        return LocalizeResult, (*values, OfBody(body.masses, body.bend, body.joint))

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON or a data frame's row, without the posterior along the body."""
        return {
            "status": self.status,
            "contacts": [asdict(contact) for contact in self.contacts],
            "hypothesis": self.hypothesis,
            "hypotheses": dict(self.hypotheses),
            "parameters": dict(self.parameters),
            "noise": self.noise,
            "log_odds": self.log_odds,
            "discarded": list(self.discarded),
            "message": self.message,
            "touched": self.touched,
            "doubts": dict(self.doubts),
            "remarks": list(self.remarks),
            "reduced_chi2": self.reduced_chi2,
            "correlation": self.correlation,
            "log_evidence": self.log_evidence,
        }

    def to_frame(self) -> DataFrame:
        """A pandas data frame with a row for each contact, base to tip; needs `thigmo[tables]`."""
        return data_frame(
            [
                {
                    "arc": c.arc, "low": c.interval[0], "high": c.interval[1], "force": c.force,
                    "force_deviation": c.force_deviation, "probability": c.probability,
                    "status": c.status,
                }
                for c in self.contacts
            ]
        )  # fmt: skip

    def plot(self, axes: Axes | None = None, *, unit: str = "") -> Axes:
        """Draw the posterior along the body, and each contact with its interval.

        Args:
            axes: the axes to draw on; None makes a new figure with matplotlib's pyplot.
            unit: name of the unit of length, for the labels.

        Returns:
            The axes.
        """
        from thigmo.display.posterior import draw_posterior

        bars = [contact._bar for contact in self.contacts]
        return draw_posterior(
            self.length, self.edges, self.mass, bars, self._title, self.message,
            axes=axes, unit=unit,
        )  # fmt: skip

    @property
    def marginals(self) -> tuple[Marginal, ...]:
        """For each contact, the place of the one nearest to its `arc`, by all explanations."""
        per = self.length**-2
        return tuple(
            Marginal(edges * self.length, mass, force * per, spread * per)
            for edges, mass, force, spread in self._body.masses
        )

    @property
    def joint(self) -> Joint | None:
        """Joint places of two contacts by the likeliest explanation; None for another number."""
        if self._body.joint is None or len(self.contacts) != 2:
            return None
        near, far, mass = self._body.joint
        return Joint(near * self.length, far * self.length, mass)

    @property
    def edges(self) -> Array:
        """(M + 1,) edges of the cells of the most distal contact, as arcs; empty without one."""
        masses = self._body.masses
        return masses[-1][0] * self.length if masses else np.zeros(0)

    @property
    def places(self) -> Array:
        """(M,) middles of the cells between `edges`."""
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    @property
    def mass(self) -> Array:
        """(M,) posterior mass of the most distal contact in each of these cells."""
        masses = self._body.masses
        return masses[-1][1] if masses else np.zeros(0)

    @property
    def bend(self) -> Array:
        """(K, 2) arcs, and the curvature that the loads add to the free one there.

        A fold is left out. In space (K, 3), with the curvatures towards angle 0 and towards a
        quarter turn from it. Without contacts there are no rows.
        """
        above = self._body.bend[: None if self.contacts else 0] / self.length
        if not any(contact.vector for contact in self.contacts):
            return np.column_stack([np.linspace(0.0, self.length, above.size), above])
        about = above.reshape(-1, 2)  # normal and binormal, in the middle of each cell
        arc = (np.arange(len(about)) + 0.5) / max(len(about), 1) * self.length
        return np.column_stack([arc, about[:, 1], -about[:, 0]])


def message(
    status: ContactStatus, count: int, number: Sequence[float], touched: float, *,
    end_open: bool, number_open: bool, discarded: bool, kinked: float, freedom: int,
    looks: Sequence[str],
) -> str:  # fmt: skip
    """One sentence for the operator.

    Args:
        status: of the frame.
        count: number of contacts listed.
        number: (4,) probabilities of each number of contacts.
        touched: probability of any contact.
        end_open: whether only what may hold the end leaves a place open.
        number_open: whether only another number of contacts leaves a place open.
        discarded: whether a reading is taken for bad.
        kinked: probability of a kink or a fold.
        freedom: how many readings there are beyond the numbers of the likeliest explanation.
        looks: remarks on the readings.
    """
    more = ""
    if discarded:  # a kink under a sensor looks much the same
        more = "; one reading looks bad (see `discarded`)"
        if kinked > priors.EXCLUDED:
            more += f", or the body is kinked there (probability {kinked:.2f})"
    more += "".join(f"; {look}" for look in looks)
    if status == "no contact":
        return "the readings are those of the free body" + more
    if status == "below detection":
        return (
            "a contact is not certain; average more readings, bend further or give `noise`" + more
        )
    contacts = f"{count} contact{'s' * (count > 1)}"
    likely_count = f"the probability of {contacts} is {number[count]:.2f}"
    if count < len(number) - 1:
        likely_count += f", of more {sum(number[count + 1 :]):.2f}"
    if status == "localized":
        return f"{likely_count}; the intervals allow for any number{more}"
    if touched < 1.0 - priors.EXCLUDED:
        return f"a contact has probability {touched:.2f}; {likely_count}{more}"
    if end_open:
        return f"something may hold the end: give held_end; {likely_count}{more}"
    if number_open:
        return (
            "another number of contacts would lie elsewhere: give `contacts` if you know it; "
            f"{likely_count}{more}"
        )
    if freedom <= 0:
        return f"{UNCHECKED}; {likely_count}{more}"
    return f"several places explain the readings, and the intervals hold them; {likely_count}{more}"
