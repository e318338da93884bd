"""One prediction about a described robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Finding:
    """One prediction."""

    what: str
    mark: Literal["ok", "warning", "bad"]
    text: str
