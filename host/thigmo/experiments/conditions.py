"""The thesis's three static experiments as trials on a specimen."""

from __future__ import annotations

import numpy as np

from thigmo.config import RobotConfig
from thigmo.experiments import thesis
from thigmo.experiments.specimen import DOWEL_CM, Specimen, Trial
from thigmo.mechanics import Peg, Tube, solve

_SEED_SIGN = (-1.0, 1.0)


def single_contact(specimen: Specimen, trials: int, rng: np.random.Generator) -> list[Trial]:
    """Section 3.2: one contact at L, 3L/4, L/2; high force (the base folds) and low force."""
    found = []
    for level in ("high force", "low force"):
        for arc in thesis.SINGLE_ARCS_CM:
            for _ in range(trials):
                sign = float(rng.choice(_SEED_SIGN))
                moment = thesis.CRITICAL * (1.0 if level == "high force" else thesis.LOW_LEVEL)
                # Hands do not press twice alike: five per cent.
                moment *= 1.0 if level == "high force" else 1.0 + 0.05 * rng.standard_normal()
                fold = sign * specimen.constants.fold_rad if level == "high force" else 0.0
                found.append(specimen.press(level, (arc,), (sign * moment / arc,), fold_rad=fold))
    return found


def two_contacts(specimen: Specimen, trials: int, rng: np.random.Generator) -> list[Trial]:
    """Section 3.3: a distal contact at the tip, an opposed one a gap away from it.

    The forces are unstated. Here the distal one bends the body by three quarters of the critical
    moment at the proximal contact, and the proximal one pushes the base back to as much of the
    other sign: both are then well visible, and nothing folds.
    """
    found = []
    for gap in thesis.GAPS_CM:
        proximal = thesis.LENGTH_CM - gap
        for _ in range(trials):
            sign = float(rng.choice(_SEED_SIGN))
            distal = sign * 0.75 * thesis.CRITICAL / gap
            base = distal * thesis.LENGTH_CM
            wanted = -sign * 0.75 * thesis.CRITICAL
            found.append(
                specimen.press(
                    f"{gap:g} cm apart",
                    (proximal, thesis.LENGTH_CM),
                    ((wanted - base) / proximal, distal),
                )
            )
    return found


def actuated(specimen: Specimen, trials: int) -> list[Trial]:
    """Section 3.4: the left muscle bends the robot into a dowel that it just touches at 6 psi.

    Only the right column reads. Where along the body the dowel bears at 10 and 14 psi, and whether
    on the side or on the tip's corner, is for the mechanics to say.
    """
    tube = Tube(thesis.DIAMETER_CM, thesis.CRITICAL)
    muscle = RobotConfig().actuators.left.maps[-1].inflate
    touch = muscle.curvature(thesis.TOUCH_PSI)
    found = []
    for level, pressure in thesis.ACTUATED_PSI.items():
        free = muscle.curvature(pressure)
        for arc in thesis.ACTUATED_ARCS_CM:
            heading = touch * arc
            reach = tube.radius_cm + DOWEL_CM
            peg = Peg(
                float(np.sin(heading)) / touch - reach * float(np.sin(heading)),
                float(1 - np.cos(heading)) / touch + reach * float(np.cos(heading)),
                DOWEL_CM,
            )
            body = solve(free, thesis.LENGTH_CM, tube=tube, pegs=[peg])
            found += [
                specimen.observe(f"{level} force", body, free=free, one_side=True)
                for _ in range(trials)
            ]
    return found


def gap_of(trial: Trial) -> float:
    """Distance of a two-contact trial's contacts, cm."""
    return trial.arcs_cm[1] - trial.arcs_cm[0]
