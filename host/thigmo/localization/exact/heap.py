"""A binary heap in a table, for the boxes of the branch and bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums

Floats = NDArray[np.float64]


@compiled_sums
def heap_push(heap: Floats, size: int, key: float, item: int) -> int:
    """Add to a binary heap of rows (key, item), least key first; returns the new size."""
    k = size
    while k > 0:
        parent = (k - 1) >> 1
        if heap[parent, 0] <= key:
            break
        heap[k, 0] = heap[parent, 0]
        heap[k, 1] = heap[parent, 1]
        k = parent
    heap[k, 0] = key
    heap[k, 1] = item
    return size + 1


@compiled_sums
def heap_pop(heap: Floats, size: int) -> tuple[float, int]:
    """Take the least of `size` entries."""
    top = heap[0, 0]
    item = int(heap[0, 1])
    key = heap[size - 1, 0]
    last = heap[size - 1, 1]
    n = size - 1
    k = 0
    while True:
        child = 2 * k + 1
        if child >= n:
            break
        if child + 1 < n and heap[child + 1, 0] < heap[child, 0]:
            child += 1
        if heap[child, 0] >= key:
            break
        heap[k, 0] = heap[child, 0]
        heap[k, 1] = heap[child, 1]
        k = child
    heap[k, 0] = key
    heap[k, 1] = last
    return top, item


@compiled_sums
def grown(array: Floats) -> Floats:
    """A copy with twice the rows."""
    rows, columns = array.shape
    out = np.empty((2 * rows, columns))
    for r in range(rows):
        for k in range(columns):
            out[r, k] = array[r, k]
    return out
