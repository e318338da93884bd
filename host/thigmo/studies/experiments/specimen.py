"""Simulated robots of the thesis: what an imperfect robot reads when dowels press on it.

Truth is the large-deflection rod (`thigmo.mechanics.push`); what spoils it are four constants,
each apart: white noise of an averaged reading, spread of the sensors' gains, errors of their
places, and the angle of the base's fold at high force. `fit.py` finds them once, from section 3.2;
everything else is then prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from thigmo.config import RobotConfig, TanhMap
from thigmo.emulator.scene import Scene
from thigmo.mechanics import Solution, Tube, peg_for, push
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.trial import Passed, Trial
from thigmo.studies.rod import Floats

_STEP_CM = 1e-3


@dataclass(frozen=True)
class Constants:
    """What the thesis does not state, and its results imply."""

    noise: float  # standard deviation of an averaged reading, 1/cm
    gain_spread: float  # relative standard deviation of the sensors' gains
    position_cm: float  # standard deviation of the sensors' places
    fold_rad: float  # angle of the base's fold under the high force


@cache
def emulated_robot() -> RobotConfig:
    """The robot of the emulator's default scene: the thesis publishes no map of its muscles."""
    return Scene.load("default").robot


def pushed(
    arcs_cm: Sequence[float],
    forces: Sequence[float],
    *,
    free: float = 0.0,
    fold_rad: float = 0.0,
    length_cm: float = thesis.LENGTH_CM,
    diameter_cm: float = thesis.DIAMETER_CM,
) -> Solution:
    """A body under normal forces (1/cm^2) at arcs, with a fold of the base."""
    return push(
        np.array(forces),
        np.array(arcs_cm),
        free_curvature=free,
        length=length_cm,
        tube=Tube(diameter_cm),
        fold_angle=fold_rad,
    )


class Specimen:
    """One robot as built: its gains and places are drawn once and stay.

    Args:
        constants: how imperfect it is.
        rng: draws the robot, then the noise of its trials.
        muscle: the left one's map; None takes the emulated robot's.
        map_error: relative error of the free curvature that the lab believes.

    Attributes:
        gain_sigma: relative standard deviation of what is still unknown of a gain.
    """

    def __init__(
        self,
        constants: Constants,
        rng: np.random.Generator,
        muscle: TanhMap | None = None,
        map_error: float = 0.0,
    ) -> None:
        self.constants = constants
        self.muscle = muscle or emulated_robot().actuators.left.maps[-1].inflate
        self.map_error = map_error
        self.believed: Floats = np.tile(thesis.CENTERS_CM, 2)
        count = self.believed.size
        half = thesis.SPAN_CM / 2
        true = self.believed + constants.position_cm * rng.standard_normal(count)
        self._true = np.clip(true, min(half, self.believed.min()), thesis.LENGTH_CM - half)
        self._gain = 1.0 + constants.gain_spread * rng.standard_normal(count)
        self._shown = np.ones(count)
        self.gain_sigma = constants.gain_spread
        self._rng = rng

    def learn_gains(self, readings: Floats, believed: float) -> None:
        """Take readings of the untouched robot, bent by its muscle: all sensors bend alike there.

        Readings are (R, N) of the first N sensors; the map says that they are `believed`.
        """
        noise, spread = max(self.constants.noise, 1e-9), max(self.constants.gain_spread, 1e-9)
        # The calibrated gain, 1 to within its spread, and these readings (Bayesian regression).
        precision = 1 / spread**2 + len(readings) * (believed / noise) ** 2
        departure = believed / noise**2 * (readings - believed).sum(axis=0)
        self._shown[: readings.shape[1]] = 1 + departure / precision
        self.gain_sigma = float(precision**-0.5)

    def press(
        self,
        condition: str,
        place: str,
        arcs_cm: Sequence[float],
        forces: Sequence[float],
        *,
        free: float = 0.0,
        fold_rad: float = 0.0,
    ) -> Trial:
        """Readings while normal forces (1/cm^2) press at arcs, base first."""
        body = pushed(arcs_cm, forces, free=free, fold_rad=fold_rad)
        return self.observe(condition, place, body, self.read(body), free=free)

    def read(self, body: Solution, one_side: bool = False) -> Floats:
        """Readings of a body in a known equilibrium, (N,)."""
        count = self.believed.size // 2 if one_side else self.believed.size
        clean = body.averages(self._true[:count], thesis.SPAN_CM)
        # Zeroing takes the straight robot as zero, so a gain error scales the reading only.
        return np.asarray(
            self._gain[:count] * clean + self.constants.noise * self._rng.standard_normal(count)
        )

    def observe(
        self,
        condition: str,
        place: str,
        body: Solution,
        noisy: Floats,
        *,
        free: float = 0.0,
        passed: Passed | None = None,
    ) -> Trial:
        """A trial from noisy readings (`read`) of a body, and what was read on the way."""
        contacts = sorted(body.contacts, key=lambda contact: contact.arc)
        count = len(noisy)
        at = self._true[:count]
        clean = body.averages(at, thesis.SPAN_CM)
        slope = (body.averages(at + _STEP_CM, thesis.SPAN_CM) - clean) / _STEP_CM
        return Trial(
            condition,
            place,
            noisy,
            self.believed[:count],
            np.full(count, thesis.SPAN_CM),
            free,
            self.constants.noise,
            self._shown[:count],
            # A lab knows how well it calibrated, not the errors themselves.
            self._deviation(noisy, _slope(self.believed[:count], noisy)),
            self._deviation(clean, slope),
            tuple(contact.arc for contact in contacts),
            tuple(contact.normal for contact in contacts),
            tuple(peg_for(contact, thesis.DOWEL_CM).x for contact in contacts),
            tuple(contact.x for contact in contacts),
            passed=passed,
        )

    def _deviation(self, curvature: Floats, slope: Floats) -> Floats:
        """Standard deviation of readings over robots: noise, gain and place together.

        Of a gain what is still unknown counts.
        """
        c = self.constants
        variance = c.noise**2 + (self.gain_sigma * curvature) ** 2 + (c.position_cm * slope) ** 2
        return np.asarray(np.sqrt(variance))


def _slope(position: Floats, curvature: Floats) -> Floats:
    """Change of the readings along the body (1/cm^2) at each sensor, both columns together."""
    places, index = np.unique(position, return_inverse=True)
    mean = np.bincount(index, curvature) / np.bincount(index)
    slope: Floats = np.gradient(mean, places)[index]
    return slope
