"""The result of `localize_batch`: the contacts of each row, as arrays."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.extras import data_frame
from thigmo.localization.result import STATUSES, Array, Status
from thigmo.localization.validation import refusal

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, slots=True)
class BatchResult:
    """Contacts of M rows of readings, in the caller's units, ordered from base to tip.

    Each row has room for three contacts; entries beyond its last contact are NaN or False.

    Attributes:
        status: (M,) status of each row, as in `localize`.
        contacts: (M,) number of contacts listed.
        arc, force: (M, 3) place of each contact, and its force over EI.
        low, high: (M, 3) ends of its 95 % interval.
        localized: (M, 3) whether its status is `localized`.
        probability: (M,) probability that there is any contact.
        log_odds: (M,) log odds of any contact against none.
        discarded: (M,) index of the reading taken for bad; -1 if there is none.
    """

    status: list[Status]
    contacts: npt.NDArray[np.int64]
    arc: Array
    force: Array
    low: Array
    high: Array
    localized: npt.NDArray[np.bool_]
    probability: Array
    log_odds: Array
    discarded: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.arc)

    def to_frame(self) -> DataFrame:
        """A pandas data frame with a line for each contact of each row of readings.

        A row without a contact has one line, with NaN for the contact. Needs `thigmo[tables]`.
        """
        listed = np.maximum(self.contacts, 1)
        row = np.repeat(np.arange(len(self)), listed)
        number = np.arange(row.size) - np.repeat(np.cumsum(listed) - listed, listed)
        of_contact = ("arc", "low", "high", "force", "localized")
        return data_frame(
            {
                "row": row,
                "contact": number,
                "status": np.asarray(self.status)[row],
                **{name: getattr(self, name)[row, number] for name in of_contact},
                "probability": self.probability[row],
                "discarded": self.discarded[row],
            }
        )

    def __repr__(self) -> str:
        count = Counter(self.status)
        parts = ", ".join(f"{count[status]} {status}" for status in STATUSES if count[status])
        return f"BatchResult({len(self)} rows{': ' if parts else ''}{parts})"

    @classmethod
    def of(cls, of_row: Array, of_contact: Array, length: float) -> BatchResult:
        """The result from the compiled code's arrays of rows and of contacts.

        Raises:
            DataError: a row cannot be used; the message has its number.
        """
        status, contacts, problem, shows, probability, log_odds, discarded = of_row.T
        wrong = np.flatnonzero(problem)
        if wrong.size:
            row = int(wrong[0])
            error = refusal(int(problem[row]), float(shows[row]), length)
            raise DataError(f"row {row}: {error.what}", error.next_step)
        arc, force, low, high, localized = np.moveaxis(of_contact, 2, 0)
        return cls(
            [STATUSES[int(each)] for each in status.tolist()],
            contacts.astype(np.int64),
            arc, force, low, high, localized == 1.0,
            probability, log_odds, discarded.astype(np.int64),
        )  # fmt: skip
