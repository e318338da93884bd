"""The figure of `thigmo design`: what a sensor layout can feel, find and tell apart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from thigmo.report.axes import INK, MUTED

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
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 3.9), layout="constrained")
    one, two = figure.subplots(1, 2, sharey=True)
    # Moments are ordered: so are their shades, in colour and in grey.
    colors = [colormaps["cividis"](share) for share in np.linspace(0.9, 0.0, len(found.moment))]
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
        one.plot([center - width / 2, center + width / 2], [0.115, 0.115], color=INK, linewidth=4)
    one.set(
        xlabel="arc of the contact (cm)",
        ylabel="bound of its arc, one standard deviation (cm)",
        yscale="log",
        ylim=(0.1, 50),
        xlim=(0, found.length),
        title="One contact",
    )
    limit = found.length * 10 / 53 / 3.92
    one.axhline(limit, color=MUTED, linewidth=1, linestyle=(0, (1, 1)))
    for m in range(len(found.moment)):
        two.plot(found.separation, found.pair_bound[m, :, 0], "--", color=colors[m])
        two.plot(found.separation, found.pair_bound[m, :, 1], color=colors[m])
    two.set(
        xlabel="separation of two opposed contacts (cm)",
        yscale="log",
        ylim=(0.1, 50),
        title="Two opposed contacts (no line: not told apart)",
        xlim=(found.separation[0], found.separation[-1]),
    )
    for axis in (one, two):
        axis.grid(which="both", alpha=0.2)
        axis.yaxis.set_major_formatter("{x:g}")
        axis.tick_params(labelsize=7)
        axis.title.set_fontsize(9)
        axis.xaxis.label.set_fontsize(8)
        axis.yaxis.label.set_fontsize(8)
    one.plot([], [], ":", color=INK, label="too weak to be reported")
    one.plot([], [], color=INK, linewidth=4, label="sensors")
    one.plot([], [], color=MUTED, linestyle=(0, (1, 1)), label="localized below this line")
    one.plot([], [], "--", color=INK, label="two contacts: the proximal one")
    one.plot([], [], color=INK, label="two contacts: the distal one, at the tip")
    figure.legend(
        *one.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7,
        frameon=False, title="colours: moment at the base over EI", title_fontsize=7,
    )  # fmt: skip
    return figure
