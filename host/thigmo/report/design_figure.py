"""The figure of `thigmo design`: what a sensor layout can feel, find and tell apart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from thigmo.localization import Identifiability


def draw_design(found: Identifiability, position: npt.ArrayLike, span: npt.ArrayLike) -> Figure:
    """Bound of one contact over place and moment, with the sensors; bounds of two over distance.

    Args:
        found: the bounds, lengths in cm.
        position: (N,) sensor centres, cm.
        span: scalar or (N,) active lengths, cm.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 4.6), layout="constrained")
    one, two = figure.subplots(1, 2)
    colors = [f"C{index}" for index in range(len(found.moment))]
    for m, moment in enumerate(found.moment):
        felt = found.detected[m]
        one.plot(
            found.arc,
            np.where(felt, found.bound[m], np.nan),
            color=colors[m],
            label=f"{moment:.4f} 1/cm",
        )
        one.plot(found.arc, np.where(felt, np.nan, found.bound[m]), ":", color=colors[m])
    centers = np.atleast_1d(np.asarray(position, dtype=np.float64))
    widths = np.broadcast_to(np.asarray(span, dtype=np.float64), centers.shape)
    for center, width in zip(centers, widths, strict=True):
        one.plot([center - width / 2, center + width / 2], [0.106, 0.106], "k", linewidth=3)
    one.set(
        xlabel="arc of the contact (cm)",
        ylabel="bound of its arc, one standard deviation (cm)",
        yscale="log",
        ylim=(0.1, 50),
        xlim=(0, found.length),
        title="One contact (dotted: too weak to be reported; black: sensors)",
    )
    one.axhline(found.length * 10 / 53 / 3.92, color="gray", linewidth=1, linestyle="--")
    one.text(0.01 * found.length, found.length * 10 / 53 / 3.92, "localized below", va="bottom")
    for m in range(len(found.moment)):
        two.plot(found.separation, found.pair_bound[m, :, 0], "--", color=colors[m])
        two.plot(found.separation, found.pair_bound[m, :, 1], color=colors[m])
    two.plot([], [], "k--", label="proximal")
    two.plot([], [], "k", label="distal (at the tip)")
    two.set(
        xlabel="separation of two opposed contacts (cm)",
        ylabel="bound, one standard deviation (cm)",
        yscale="log",
        ylim=(0.1, 50),
        title="Two contacts (no line: the readings cannot tell)",
    )
    for axis in (one, two):
        axis.grid(which="both", alpha=0.2)
        axis.yaxis.set_major_formatter("{x:g}")
    one.legend(title="base moment / EI", fontsize=7, title_fontsize=8, loc="upper right")
    two.legend(fontsize=8)
    return figure
