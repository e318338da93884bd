"""What `localize` answers: contacts, how sure, by which model and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Status = Literal["localized", "ambiguous", "below detection", "no contact"]
Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Contact:
    """One contact. Arc in the caller's unit, force over EI in that unit to the power -2.

    Attributes:
        arc: place along the body: median of the posterior, or of its heaviest mode.
        force: normal force over EI, positive towards positive curvature, at `arc`.
        interval: shortest arc interval that holds 95 % of the posterior.
        status: `localized` (one mode, interval no wider than the limit), `ambiguous`, or
            `below detection` (a contact that was asked for, but is not in the readings).
        intervals: the 95 % highest-density set; more than one piece if there are several modes.
        force_deviation: posterior standard deviation of the force.
        end_offset: where a contact on the end of the body bears, left of the centreline (its force
            pushes the end back as well: `tangential_force` of the result's parameters); None for a
            contact on the side.
    """

    arc: float
    force: float
    interval: Range
    status: Status
    intervals: tuple[Range, ...] = ()
    force_deviation: float = 0.0
    end_offset: float | None = None


@dataclass(slots=True)
class LocalizeResult:
    """Contacts felt in one set of readings.

    Attributes:
        status: the worst of the contacts' statuses; `no contact` without any.
        contacts: base to tip.
        model: which model explains the readings, and why it was chosen.
        message: one sentence for the operator.
        noise: the noise of one reading that was used or found (1/length).
        log_odds: natural log of the evidence ratio: these contacts against none.
        arcs: (M,) nodes of the posterior over the arc of the (most distal) contact.
        density: (M,) posterior density at them (1/length).
        outliers: indices of readings taken for outliers.
        parameters: further parameters of the model, e.g. `fold_angle` or `tip_moment`.
    """

    status: Status
    contacts: tuple[Contact, ...]
    model: str
    message: str
    noise: float
    log_odds: float
    arcs: Array
    density: Array
    outliers: tuple[int, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    _shape: Callable[[], Array] | None = None
    _bend: Array | None = None
    _solve: Callable[[int], tuple[float, tuple[tuple[Range, ...], ...]]] | None = None
    _solved: tuple[float, tuple[tuple[Range, ...], ...]] | None = None

    def _exact(self) -> tuple[float, tuple[tuple[Range, ...], ...]]:
        if self._solved is None:
            self._solved = (0.0, ()) if self._solve is None else self._solve(len(self.contacts))
        return self._solved

    @property
    def bend(self) -> Array:
        """(K, 2) arc, and curvature above the free one that the contacts cause there, without the
        fold: the body's shape under the model; (0, 2) where nothing was found.
        """
        if self._bend is None:
            self._bend = np.zeros((0, 2)) if self._shape is None else self._shape()
        return self._bend

    @property
    def objective(self) -> float:
        """Global minimum of the 1-norm (thesis, equation 2.10) for this number of contacts."""
        return self._exact()[0]

    @property
    def optimum_set(self) -> tuple[tuple[Range, ...], ...]:
        """For each contact the arc ranges over which that minimum is attained."""
        return self._exact()[1]
