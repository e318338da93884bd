"""The result of `localize_batch`: the contacts of each row, as arrays."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from thigmo.display.bars import Bar
from thigmo.errors import DataError
from thigmo.extras import data_frame
from thigmo.localization.doubts import MISTAKES, remarks
from thigmo.localization.result import STATUSES, Array, ContactStatus, message
from thigmo.localization.validation import refusal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame


@dataclass(frozen=True, slots=True)
class BatchResult:
    """Contacts of M rows of readings, in the caller's units, ordered from base to tip.

    Each row has room for three contacts; entries beyond its last contact are NaN or False.

    Names mean what they mean in `LocalizeResult` and `Contact`.

    Attributes:
        status: (M,) status of each row.
        message: (M,) one sentence for the operator.
        hypothesis: (M,) likeliest explanation.
        count: (M,) number of contacts listed.
        arc, force: (M, 3) place of each contact, and its force over EI.
        low, high: (M, 3) ends of its 95 % interval.
        localized: (M, 3) whether its status is `localized`.
        probability: (M, 3) probability that a contact lies nearer to it than to the others.
        touched: (M,) probability of any contact.
        log_odds: (M,) log odds of any contact against none.
        log_evidence: (M,) log density of the readings over all explanations.
        doubts: probabilities (M,) of each mistake in the readings, by its name.
        reduced_chi2: (M,) squared residual over its errors for each degree of freedom.
        correlation: (M,) correlation of neighbouring residuals in standard errors.
        noise: (M,) standard deviation of a reading's white noise.
        discarded: (M,) index of the reading taken for bad; -1 if there is none.
        predicted, residuals: (M, N) if they were asked for; else None.
        length: length of the body.
    """

    status: list[ContactStatus]
    message: list[str]
    hypothesis: list[str]
    count: npt.NDArray[np.int64]
    arc: Array
    force: Array
    low: Array
    high: Array
    localized: npt.NDArray[np.bool_]
    probability: Array
    touched: Array
    log_odds: Array
    log_evidence: Array
    doubts: dict[str, Array]
    reduced_chi2: Array
    correlation: Array
    noise: Array
    discarded: npt.NDArray[np.int64]
    predicted: Array | None = None
    residuals: Array | None = None
    length: float = 1.0

    def __len__(self) -> int:
        return len(self.arc)

    def to_frame(self) -> DataFrame:
        """A pandas data frame with a line for each contact of each row of readings.

        A row without a contact has one line, with NaN for the contact. Needs `thigmo[tables]`.
        """
        listed = np.maximum(self.count, 1)
        row = np.repeat(np.arange(len(self)), listed)
        number = np.arange(row.size) - np.repeat(np.cumsum(listed) - listed, listed)
        of_contact = ("arc", "low", "high", "force", "localized", "probability")
        return data_frame(
            {
                "row": row,
                "contact": number,
                "status": np.asarray(self.status)[row],
                **{name: getattr(self, name)[row, number] for name in of_contact},
                "touched": self.touched[row],
                "hypothesis": np.asarray(self.hypothesis)[row],
                "reduced_chi2": self.reduced_chi2[row],
                "message": np.asarray(self.message)[row],
                "discarded": self.discarded[row],
            }
        )

    def plot(
        self,
        axes: Axes | None = None,
        *,
        moments: npt.ArrayLike | None = None,
        label: str = "row",
        unit: str = "",
    ) -> Axes:
        """Draw the contacts of all rows with their 95 % intervals.

        Args:
            axes: the axes to draw on; None makes a new figure with matplotlib's pyplot.
            moments: (M,) where to draw each row, such as times; None for the numbers of the rows.
            label: what the moments are.
            unit: name of the unit of length, for the label.

        Returns:
            The axes.
        """
        from thigmo.display.series import draw_series

        numbers = np.arange(len(self))
        positions = numbers if moments is None else np.asarray(moments, dtype=np.float64)
        if positions.shape != (len(self),):
            raise DataError(
                f"moments has shape {positions.shape}",
                f"give one number for each of {len(self)} rows",
            )
        bars = [
            [
                Bar(
                    float(self.arc[row, n]),
                    ((float(self.low[row, n]), float(self.high[row, n])),),
                    "localized" if self.localized[row, n] else self._other_status(row),
                    "",
                )
                for n in range(self.count[row])
            ]
            for row in range(len(self))
        ]
        return draw_series(positions.tolist(), bars, self.length, label, axes=axes, unit=unit)

    def _other_status(self, row: int) -> ContactStatus:
        """Status of a contact that is not localized."""
        return "below detection" if self.status[row] == "below detection" else "ambiguous"

    def __repr__(self) -> str:
        count = Counter(self.status)
        parts = ", ".join(f"{count[status]} {status}" for status in STATUSES if count[status])
        return f"BatchResult({len(self)} rows{': ' if parts else ''}{parts})"

    @classmethod
    def of(
        cls, of_row: Array, of_contact: Array, hypothesis: list[str], length: float, *,
        noise_stated: bool, sensors: npt.NDArray[np.int64],
        predicted: Array | None, residuals: Array | None,
    ) -> BatchResult:  # fmt: skip
        """The result from the compiled code's arrays of rows and of contacts.

        Raises:
            DataError: a row cannot be used; the message has its number.
        """
        numbers = dict(zip(_OF_ROW, of_row.T, strict=True))
        wrong = np.flatnonzero(numbers["problem"])
        if wrong.size:
            row = int(wrong[0])
            shows = float(numbers["shows"][row])
            error = refusal(int(numbers["problem"][row]), shows, length)
            raise DataError(f"row {row}: {error.problem}", error.next_step)
        arc, force, low, high, localized, probability = np.moveaxis(of_contact, 2, 0)
        status = [STATUSES[int(code)] for code in numbers["status"].tolist()]
        count = numbers["count"].astype(np.int64)
        mistakes = np.column_stack([numbers[name] for name in MISTAKES])
        number = np.column_stack([numbers[name] for name in _NUMBER])
        freedom = numbers["freedom"]
        messages = [
            message(
                status[row], int(count[row]), number[row].tolist(), float(numbers["touched"][row]),
                end_open=bool(numbers["end_open"][row]),
                number_open=bool(numbers["number_open"][row]),
                discarded=bool(numbers["discarded"][row] >= 0.0),
                kinked=float(numbers["kinked"][row]), freedom=int(freedom[row]),
                looks=remarks(
                    mistakes[row].tolist(), float(numbers["misfit"][row]), int(freedom[row]),
                    float(numbers["correlation"][row]), sensors=int(sensors[row]),
                    noise_stated=noise_stated,
                ),
            )
            for row in range(len(of_row))
        ]  # fmt: skip
        with np.errstate(invalid="ignore", divide="ignore"):
            chi2 = np.where(freedom > 0.0, numbers["misfit"] / freedom, np.nan)
        return cls(
            status, messages, hypothesis, count,
            arc, force, low, high, localized == 1.0, probability,
            numbers["touched"], numbers["log_odds"], numbers["log_evidence"],
            {name: numbers[name] for name in MISTAKES},
            chi2, numbers["correlation"], numbers["noise"],
            numbers["discarded"].astype(np.int64), predicted, residuals, length,
        )  # fmt: skip


_NUMBER = ("none", "one", "two", "three")
# In the order in which module.cpp writes them.
_OF_ROW = (
    "status", "count", "problem", "shows", "touched", "log_odds", "discarded", "noise", "end_open",
    "number_open", "kinked", "misfit", "freedom", "correlation", "log_evidence", *_NUMBER,
    *MISTAKES,
)  # fmt: skip
