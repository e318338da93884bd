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
    noise: float
    log_odds: float
    objective: float
    gap: float
    weighed: list[tuple[int, int, float]]
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
    def __init__(
        self,
        *,
        position: _Array,
        span: _Array,
        noise: _Array,
        gain: _Array,
        bad_odds: _Array,
        shared: _Array,
        offset: float,
        map_scale: float,
        length: float,
        radius: float,
        critical: float,
        critical_error: float,
        folds_perhaps: bool,
        held_end: int,
        end_odds: float,
        held_odds: float,
        contacts: int,
        within: tuple[float, float],
        width_limit: float,
        number_level: float,
        norm: int,
        direction: _Array,
        curvature_map: _Array,
        compliance: _Array,
        weight: _Array,
        priors: Priors,
    ) -> None: ...
    def localize(self, curvature: _Array, free: _Array, body: _Array) -> Answer: ...
    def localize_rows(self, curvature: _Array, free: _Array) -> tuple[_Array, _Array]: ...
