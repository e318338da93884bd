"""What a fit to a side's sweeps answers, for tests of what is made of it."""

from __future__ import annotations

import numpy as np

from thigmo.field import FieldContact
from thigmo.robot.curvature import Floats


def a_fit(
    arc_cm: float,
    length_cm: float = 53.0,
    *,
    width_cm: float = 2.0,
    x_cm: float = 40.0,
    y_cm: float = 20.0,
    felt_at_cm: tuple[float, ...] = (),
    kind: str = "peg",
    peg_radius_cm: float = 1.0,
    probability: float = 1.0,
    doubt: str = "",
    explanations: dict[str, float] | None = None,
) -> FieldContact:
    """A contact with a 95 % interval so wide, at a place in the side's plane."""
    arcs: Floats = arc_cm + width_cm / 3.92 * np.linspace(-2.0, 2.0, 41)
    weights = np.exp(-0.5 * np.linspace(-2.0, 2.0, 41) ** 2)
    return FieldContact(
        length_cm=length_cm,
        arc_cm=arc_cm,
        interval_cm=(arc_cm - width_cm / 2, arc_cm + width_cm / 2),
        x_cm=x_cm,
        y_cm=y_cm,
        covariance_cm2=np.array([[0.09, 0.02], [0.02, 0.04]]),
        normal_rad=1.2,
        force_per_cm2=2e-4,
        force_interval_per_cm2=(1.5e-4, 2.5e-4),
        track=np.array([[x_cm - 1.0, y_cm - 0.5], [x_cm, y_cm], [x_cm + 1.0, y_cm + 0.5]]),
        arcs=arcs,
        weights=weights / weights.sum(),
        probability=probability,
        places=not doubt,
        doubt=doubt,
        felt_at_cm=felt_at_cm or (length_cm,),
        log_odds=9.0,
        log_evidence=0.0,
        misfit=1.0,
        effective=80.0,
        kind=kind,
        face=np.array([[30.0, 18.0], [38.0, 19.0]]) if kind == "wall" else np.zeros((0, 2)),
        explanations=explanations or {kind: 1.0},
        peg_radius_cm=peg_radius_cm,
        friction=0.1,
        yield_cm=0.0,
        gave_way_at=None,
    )
