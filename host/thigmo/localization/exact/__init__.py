"""Exact global fits of point contacts to curvature readings.

Model (shared by every solver here): a contact at arc a with normal force f over EI adds
`f * phi(a; x, l)` to the average curvature that a sensor centred at x with span l reads, where phi
is 0 up to the span, (a - x + l/2)^2 / (2 l) inside it and a - x beyond it. Readings are curvature
above the free curvature. The objective is the sum over sensors of |r| (`norm=1`) or r^2 (`norm=2`)
with r = weight * (reading - model); weight = 1 / sigma makes it a likelihood's. All lengths share
one unit, curvature its inverse, force its inverse square: results scale with the unit.

Nothing here starts from a guess: every function returns the global optimum, and the set of arcs
at which it is attained, because with sensors at the same place on both sides it often is a range.

`one_contact` and `one_contact_batch` enumerate (any number of sensors; beyond a few dozen they
switch to the walk for dense sensing); `several_contacts` is a branch and bound over one to three
contacts that returns its proven gap.
"""

from __future__ import annotations

from thigmo.localization.exact.solve import (
    BatchSolution,
    Solution,
    one_contact,
    one_contact_batch,
    several_contacts,
)

__all__ = ["BatchSolution", "Solution", "one_contact", "one_contact_batch", "several_contacts"]
