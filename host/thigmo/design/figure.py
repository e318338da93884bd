"""The figure of `thigmo design`: what a sensor layout can feel, find and tell apart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from thigmo.contact_status import WIDTH_SHARE
from thigmo.display.axes import INK, MUTED, small

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from thigmo.design.bounds import Identifiability


def draw_design(layout: Identifiability, position: npt.ArrayLike, span: npt.ArrayLike) -> Figure:
    """Bound of one contact over place and moment, with the sensors; bounds of two over distance.

    Sensors have centres (N,) and spans, one or (N,), in cm.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 3.9), layout="constrained")
    first, two = figure.subplots(1, 2, sharey=True)
    # Moments are ordered: so are their shades, in colour and in grey.
    colors = [colormaps["cividis"](share) for share in np.linspace(0.9, 0.0, len(layout.moment))]
    centers = np.atleast_1d(np.asarray(position, dtype=np.float64))
    for m, (moment, detected, bound) in enumerate(
        zip(layout.moment, layout.detected, layout.bound, strict=True)
    ):
        felt_bound, weak_bound = (
            np.where(detected, bound, np.nan),
            np.where(detected, np.nan, bound),
        )
        first.plot(layout.arc, felt_bound, color=colors[m], label=f"{moment:.4f} 1/cm")
        first.plot(layout.arc, weak_bound, ":", color=colors[m])
        two.plot(layout.separation, layout.pair_bound[m, :, 0], "--", color=colors[m])
        two.plot(layout.separation, layout.pair_bound[m, :, 1], color=colors[m])
    half = np.broadcast_to(np.asarray(span, dtype=np.float64) / 2, centers.shape)
    first.hlines(np.full(centers.size, 0.115), centers - half, centers + half, INK, linewidth=4)
    limit = layout.length * WIDTH_SHARE / 3.92
    first.axhline(limit, color=MUTED, linewidth=1, linestyle=(0, (1, 1)))
    first.set(
        xlabel="arc of the contact (cm)", xlim=(0, layout.length), title="One contact",
        ylabel="bound of its arc, one standard deviation (cm)",
    )  # fmt: skip
    two.set(
        xlabel="separation of two opposed contacts (cm)",
        title="Two opposed contacts (no line: cannot be separated)",
        xlim=(layout.separation[0], layout.separation[-1]),
    )
    for axis in (first, two):
        axis.set(yscale="log", ylim=(0.1, 50))
        axis.yaxis.set_major_formatter("{x:g}")
        small(axis)
    for style, label, color, width in (
        (":", "too weak to be reported", INK, None),
        ("-", "sensors", INK, 4),
        ((0, (1, 1)), "localized below this line", MUTED, None),
        ("--", "two contacts: the proximal one", INK, None),
        ("-", "two contacts: the distal one, at the tip", INK, None),
    ):
        first.plot([], [], linestyle=style, color=color, linewidth=width, label=label)
    figure.legend(
        *first.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7,
        frameon=False, title="colours: moment at the base over EI", title_fontsize=7,
    )  # fmt: skip
    return figure
