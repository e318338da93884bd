"""Exact point fits: the global least misfit of one or two contacts, in the 1- or the 2-norm.

A contact at arc a with force f over EI adds f times a sensor's `response` to what it reads. The
objective is the sum of |residual| ("l1", the thesis's equation 2.10) or of residual^2 ("l2"); a
force may have either sign. Everything is in units of the length: arcs from 0 to 1, curvature times
the length. Nothing starts from a guess.

What is proven. One contact: every piece of the profile of the objective over the arc is enumerated
and minimised in closed form ("l2": its stationary points are all found); the minimum is global up
to rounding, and the 1-norm's optimum set is that of the closed forms. Two contacts: branch and
bound, with bounds that any multipliers of the dual give; the minimum is global to 1e-9 of the
objective without contact, which `gap` states, over forces of at most 20 times the largest reading.
That limit is part of the problem: two opposed contacts that merge into a couple of endless force
can fit better than any true pair. The optimum set of two contacts is, by contact, the connected
range around the one found: its ends and the ends of spans in it attain the minimum. "l2" has none.
"""

from thigmo.localization.point_fits.fits import PointFit, fit, fit_rows

__all__ = ["PointFit", "fit", "fit_rows"]
