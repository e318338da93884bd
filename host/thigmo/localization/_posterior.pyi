from typing import Any

import numpy as np
import numpy.typing as npt

_Array = npt.NDArray[np.float64]

class Priors:
    def __init__(self, values: dict[str, Any]) -> None: ...

class Answer:
    status: int
    problem: int
    shows: float
    number: list[float]
    discarded: int
    end_open: bool
    number_open: bool
    noise: float
    log_odds: float
    log_evidence: float
    mistakes: list[float]
    kinked: float
    residual: _Array
    misfit: float
    freedom: int
    correlation: float
    weighed: list[tuple[str, int, float]]
    hypothesis: str
    hypotheses: dict[str, float]
    def contacts(self, length: float) -> list[tuple[Any, ...]]: ...
    def parameters(self, length: float) -> dict[str, float]: ...
    touched: float
    masses: list[tuple[_Array, _Array, _Array, _Array]]
    end_load: list[float]
    joint: tuple[_Array, _Array, _Array] | None
    bend: _Array

class Localizer:
    length: float
    count: int
    def __init__(self, **options: Any) -> None: ...
    def localize(self, curvature: _Array, free: _Array, body: _Array) -> Answer: ...
    def localize_rows(
        self, curvature: _Array, free: _Array, body: _Array, residuals: bool
    ) -> tuple[_Array, _Array, list[str], _Array]: ...
