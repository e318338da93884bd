"""What `localize` answers: contacts, how sure, by which hypothesis and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.localization import _posterior
from thigmo.localization.readings import Range

Array = npt.NDArray[np.float64]
Status = Literal["localized", "ambiguous", "below detection", "no contact"]


@dataclass(frozen=True, slots=True)
class Contact:
    """One contact. Arc in the caller's unit, force over EI in that unit to the power -2.

    Attributes:
        arc: place along the body: median of the posterior.
        force: normal force over EI, positive towards positive curvature, at `arc`.
        interval: hull of the 95 % highest-density set of the arc.
        status: `localized` (the interval is no wider than the limit, and the number of contacts
            is certain to 95 %), or `ambiguous`.
        intervals: that set; more than one piece if there are several modes.
        force_deviation: posterior standard deviation of the force.
        probability: that there is such a contact at all.
        end_offset: where a contact on the end of the body bears, left of the centreline; None for
            one on the side.
    """

    arc: float
    force: float
    interval: Range
    status: Status
    intervals: tuple[Range, ...] = ()
    force_deviation: float = 0.0
    probability: float = 1.0
    end_offset: float | None = None


@dataclass(slots=True)
class LocalizeResult:
    """Contacts felt in one set of readings.

    Attributes:
        status: the worst of the contacts' statuses; `no contact` or `below detection` without any.
        contacts: base to tip.
        hypothesis: the likeliest explanation of the readings.
        message: one sentence for the operator.
        noise: standard deviation of one reading's white noise, as given or found (1/length).
        log_odds: log posterior odds of any contact against none.
        hypotheses: posterior probability of each explanation that was weighed.
        discarded: indices of readings that the likeliest explanation takes for bad.
        parameters: further numbers of that explanation: `fold_angle`, `hinge_arc`, `half_width`,
            `push_back` (force on the end, towards the base), `tip_moment`, `end_offset`.
        objective: minimum of the norm of the residual, of the point fits `l1` and `l2` only.
        optimum_set: for each contact the arcs at which that minimum is attained.
        length: of the body.
        bent: arcs, and curvature above the free one there, where `bend` is not the posterior's.
    """

    status: Status
    contacts: tuple[Contact, ...]
    hypothesis: str
    message: str
    noise: float
    log_odds: float
    hypotheses: dict[str, float]
    discarded: tuple[int, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    objective: float | None = None
    optimum_set: tuple[tuple[Range, ...], ...] = ()
    length: float = 1.0
    bent: tuple[Array, Array] | None = None
    _answer: _posterior.Answer | None = None

    @property
    def edges(self) -> Array:
        """(M + 1,) edges of cells of the most distal contact's arc; none without a contact."""
        return np.zeros(0) if self._answer is None else self._answer.edges * self.length

    @property
    def places(self) -> Array:
        """(M,) middles of these cells."""
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    @property
    def probability(self) -> Array:
        """(M,) posterior mass in each of `places`."""
        return np.zeros(0) if self._answer is None else self._answer.mass

    @property
    def bend(self) -> Array:
        """(K, 2) arc, and curvature above the free one that the loads cause there, without a fold.

        (0, 2) where no contact is listed.
        """
        if self.bent is not None:
            return np.column_stack(self.bent)
        if self._answer is None or not self.contacts:
            return np.zeros((0, 2))
        above = self._answer.bend / self.length
        return np.column_stack([np.linspace(0.0, self.length, above.size), above])
