"""The muscle's map from pressure to curvature, measured and fitted as in figure 2.4c.

Eleven pressures from 0 to 20 psi, three trials, each read by a camera of calibration's accuracy;
`thigmo.calibrate` fits them as it fits a lab's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from thigmo.calibrate.actuator import BendReadings, fit_actuator
from thigmo.studies import charts
from thigmo.studies.experiments.conditions import emulated_robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PRESSURES_PSI = np.arange(0.0, 20.1, 2.0)
_TRIALS = 3
_CAMERA_SE = 2e-4  # 1/cm, of one picture
_BETWEEN_TRIALS = 2e-4  # 1/cm: the robot never lies quite straight


def figure(seed: int) -> Figure:
    """Curvature by camera against pressure, the fitted tanh, and the emulator's true map."""
    zone = emulated_robot().actuators.left.maps[-1]
    rng = np.random.default_rng([seed, 24])
    psi = np.tile(_PRESSURES_PSI, _TRIALS)
    trial = np.repeat(np.arange(_TRIALS), _PRESSURES_PSI.size)
    seen = np.array([zone.inflate.curvature(p) for p in psi])
    seen += (_BETWEEN_TRIALS * rng.standard_normal(_TRIALS))[trial]
    seen += _CAMERA_SE * rng.standard_normal(psi.size)
    result = fit_actuator(
        BendReadings(
            "left", zone.body_pressure_psi, psi, seen, np.full(psi.size, _CAMERA_SE),
            ("inflate",) * psi.size, trial,
        )
    )  # fmt: skip
    made, (axis,) = charts.panels(
        title=f"Left muscle at {zone.body_pressure_psi:g} psi body pressure (thesis, figure 2.4c)"
    )
    for number, marker in enumerate("os^"):
        mine = trial == number
        axis.plot(psi[mine], seen[mine], marker, markersize=5, label=f"trial {number + 1}")
    fine = np.linspace(0.0, 20.0, 200)
    for curve, style, label in (
        (result.zone.inflate, "k", "hyperbolic tangent, fitted"),
        (zone.inflate, "r--", "the emulator's own"),
    ):
        axis.plot(fine, [curve.curvature(p) for p in fine], style, label=label)
    axis.set(xlabel="actuator pressure (psi)", ylabel="free curvature (1/cm)")
    axis.legend(fontsize=8)
    return made
