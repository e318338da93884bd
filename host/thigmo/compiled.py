"""The one place that calls numba's compiler, with types that mypy can follow.

Compiled functions are cached on disk beside their source. numba notices a change of a function's
own file only, so functions that call each other closely share a file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function on first use (nopython, cached on disk); its type is unchanged."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def compiled_parallel(function: F) -> F:
    """As `compiled`, with `numba.prange` loops spread over the cores."""
    return cast(F, numba.njit(cache=True, error_model="numpy", parallel=True)(function))


def compiled_sums(function: F) -> F:
    """As `compiled`, with sums in any order (so that they vectorise) and the GIL released."""
    compiler = numba.njit(
        cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "nsz"}
    )
    return cast(F, compiler(function))


def compiled_inner(function: F) -> F:
    """As `compiled_sums`, for what is called within a fit: it takes tuples of arrays at no cost.

    numba counts references to every array that crosses a call or leaves a tuple, which is a
    microsecond in a fit of a few; here it does not, because the caller holds them all. So such a
    function may neither make nor return an array.
    """
    return _inner(function, merged=False)


def compiled_part(function: F) -> F:
    """As `compiled_inner`, for a part that has one caller: it is merged into it."""
    return _inner(function, merged=True)


def _inner(function: F, merged: bool) -> F:
    options: dict[str, Any] = {"forceinline": merged, "_nrt": False}
    compiler = numba.njit(
        cache=True,
        error_model="numpy",
        nogil=True,
        fastmath={"reassoc", "contract", "nsz"},
        **options,
    )
    return cast(F, compiler(function))
