"""Simulated robots of the thesis: what an imperfect robot reads when dowels press on it.

The true shape is that of a large-deflection rod (`thigmo.mechanics.push`). Four constants describe
the imperfections, each of its own kind: the white noise of an averaged reading, the spread of the
sensors' gains, the errors of their places, and the angle of the base's fold at high force. `fit.py`
finds them once, from section 3.2; everything else is then a prediction.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from thigmo.config import RobotConfig, TanhMap
from thigmo.emulator.scene import Scene
from thigmo.mechanics import Peg, Solution, Tube, peg_for, push, solve
from thigmo_bench.experiments import thesis
from thigmo_bench.experiments.trial import Planned, Trial, arc_bound_cm, plan
from thigmo_bench.studies.rod import Floats

_STEP_CM = 1e-3
_BOUND_STEP_CM = 0.02  # of the differences that the bound is made of


@dataclass(frozen=True)
class Constants:
    """Constants that the thesis does not state but its results imply."""

    noise: float  # standard deviation of an averaged reading, 1/cm
    gain_spread: float  # relative standard deviation of the sensors' gains
    position_cm: float  # standard deviation of the sensors' places
    fold_rad: float  # angle of the base's fold under the high force


def frozen() -> Constants:
    """The constants that the experiments use."""
    stored = json.loads(files("thigmo_bench.experiments").joinpath("constants.json").read_text())
    return Constants(**stored["constants"])


@cache
def emulated_robot() -> RobotConfig:
    """The robot of the emulator's default scene: the thesis publishes no map of its muscles."""
    return Scene.load("default").robot


def pushed(
    arcs_cm: Sequence[float],
    forces: Sequence[float],
    *,
    fold_rad: float = 0.0,
    length_cm: float = thesis.LENGTH_CM,
    diameter_cm: float = thesis.DIAMETER_CM,
) -> Solution:
    """The body under normal forces (1/cm^2) at arcs, with its base folded."""
    return push(
        np.array(forces), np.array(arcs_cm), free_curvature=0.0, length=length_cm,
        tube=Tube(diameter_cm), fold_angle=fold_rad,
    )  # fmt: skip


@cache
def bent(arc_cm: float, touch: float, free: float) -> tuple[Solution, Peg]:
    """The body of free curvature `free`, and the dowel that it met at free curvature `touch`."""
    tube = Tube(thesis.DIAMETER_CM, thesis.CRITICAL)
    heading = touch * arc_cm
    reach = tube.radius_cm + thesis.DOWEL_CM
    peg = Peg(
        float(np.sin(heading)) / touch - reach * float(np.sin(heading)),
        float(1 - np.cos(heading)) / touch + reach * float(np.cos(heading)),
        thesis.DOWEL_CM,
    )
    return solve(free, thesis.LENGTH_CM, tube=tube, pegs=[peg]), peg


class Specimen:
    """One robot as built; the gains and places of its sensors are drawn once and stay.

    `rng` draws the robot, then the errors of the hands and the noise in its trials. The left
    muscle's map is the emulated robot's unless given. `map_error` is the relative error of the free
    curvature that the lab believes.
    """

    def __init__(
        self,
        constants: Constants,
        rng: np.random.Generator,
        muscle: TanhMap | None = None,
        map_error: float = 0.0,
    ) -> None:
        self.constants = constants
        self.gain_error = (
            constants.gain_spread
        )  # relative standard deviation of the unknown part of a gain
        self._muscle = muscle or emulated_robot().muscle("left").maps[-1].inflate
        self._map_error = map_error
        self._believed: Floats = np.tile(thesis.CENTERS_CM, 2)
        count, half = self._believed.size, thesis.SPAN_CM / 2
        true = self._believed + constants.position_cm * rng.standard_normal(count)
        self._true = np.clip(true, min(half, self._believed.min()), thesis.LENGTH_CM - half)
        self._gain = 1.0 + constants.gain_spread * rng.standard_normal(count)
        self._learnt_gain = np.ones(count)
        self._rng = rng

    def trials(self, experiment: str, count: int) -> list[Trial]:
        """The trials of each place and condition of a static experiment."""
        planned = plan(experiment, count)
        return self._bent(planned) if experiment == "actuated" else [*map(self.press, planned)]

    def press(self, planned: Planned) -> Trial:
        """Readings while dowels push as planned."""
        # Hands do not press twice alike: five per cent. A folded base presses evenly.
        low = planned.condition == thesis.LEVELS[1]
        hand = 1.0 + 0.05 * float(self._rng.standard_normal()) if low else 1.0
        forces = [hand * force for force in planned.forces]
        body = pushed(planned.arcs_cm, forces, fold_rad=planned.fold(self.constants.fold_rad))
        return self.observe(planned, body, self.read(body), 0.0)

    def _bent(self, plans: Sequence[Planned]) -> list[Trial]:
        """Section 3.4: the left muscle bends the robot into a dowel that it just touches at 6 psi.

        Only the right column reads. Each inflation passes 6 psi untouched, and the gains that the
        sensors show there are used in all of the robot's trials. The mechanics determine where on
        the body the dowel presses later, and whether that is the side or the end of the tip.
        """
        touch, scale = self._muscle.curvature(thesis.TOUCH_PSI), 1 + self._map_error
        untouched, read = [], []
        for planned in plans:
            untouched.append(self.read(bent(planned.arcs_cm[0], touch, touch)[0], one_side=True))
            free = self._muscle.curvature(planned.pressure_psi)
            body, peg = bent(planned.arcs_cm[0], touch, free)
            read.append((planned, body, self.read(body, one_side=True), free, peg))
        self.learn_gains(np.array(untouched), scale * touch)
        return [
            self.observe(
                planned, body, readings, scale * free,
                (obstacle_bound(peg, free, self.constants, self.gain_error),),
            )
            for planned, body, readings, free, peg in read
        ]  # fmt: skip

    def learn_gains(self, readings: Floats, believed: float) -> None:
        """Take readings (R, N) of the untouched robot, in which all sensors bend alike."""
        noise, spread = max(self.constants.noise, 1e-9), max(self.constants.gain_spread, 1e-9)
        # The calibrated gain, 1 to within its spread, and these readings (Bayesian regression).
        precision = 1 / spread**2 + len(readings) * (believed / noise) ** 2
        departure = believed / noise**2 * (readings - believed).sum(axis=0)
        self._learnt_gain[: readings.shape[1]] = 1 + departure / precision
        self.gain_error = float(precision**-0.5)

    def read(self, body: Solution, one_side: bool = False) -> Floats:
        """Noisy readings of a body in a known equilibrium, (N,)."""
        count = self._believed.size // 2 if one_side else self._believed.size
        clean = body.averages(self._true[:count], thesis.SPAN_CM)
        # Zeroing takes the straight robot as zero, so a gain error scales the reading only.
        return np.asarray(
            self._gain[:count] * clean + self.constants.noise * self._rng.standard_normal(count)
        )

    def observe(
        self,
        planned: Planned,
        body: Solution,
        readings: Floats,
        free: float,
        bound_cm: tuple[float, ...] | None = None,
    ) -> Trial:
        """A trial from readings (N,) of a body; the bound is that of its forces unless given."""
        contacts = sorted(body.contacts, key=lambda contact: contact.arc)
        arcs, forces = (tuple(getattr(c, field) for c in contacts) for field in ("arc", "normal"))
        count = readings.size
        believed, true = self._believed[:count], self._true[:count]
        span = np.full(count, thesis.SPAN_CM)
        if bound_cm is None:
            clean = body.averages(true, thesis.SPAN_CM)
            slope = (body.averages(true + _STEP_CM, thesis.SPAN_CM) - clean) / _STEP_CM
            spread = self._deviation(clean, slope)
            bound_cm = arc_bound_cm(arcs, forces, believed, span, spread, thesis.LENGTH_CM)
        # A lab knows how well it calibrated, not the errors themselves.
        sigma = self._deviation(readings, _slope(believed, readings))
        return Trial(
            planned.condition, planned.place, believed, span, readings, free,
            self._learnt_gain[:count], sigma, arcs, forces,
            tuple(peg_for(contact, thesis.DOWEL_CM).x for contact in contacts),
            tuple(contact.x for contact in contacts), bound_cm,
        )  # fmt: skip

    def _deviation(self, curvature: Floats, slope: Floats) -> Floats:
        """Standard deviation of readings over robots: noise, unknown part of the gains, places."""
        c = self.constants
        variance = c.noise**2 + (self.gain_error * curvature) ** 2 + (c.position_cm * slope) ** 2
        return np.asarray(np.sqrt(variance))


def _slope(position: Floats, curvature: Floats) -> Floats:
    """Slope of the readings along the body (1/cm^2) at each sensor, both columns together."""
    places, index = np.unique(position, return_inverse=True)
    mean = np.bincount(index, curvature) / np.bincount(index)
    slope: Floats = np.gradient(mean, places)[index]
    return slope


@cache
def obstacle_bound(peg: Peg, free: float, constants: Constants, gain_error: float) -> float:
    """Cramer-Rao bound for a dowel that a robot of a free curvature has bent into.

    The unknowns are the two coordinates of the dowel. Every reading has its noise and the errors
    of its sensor's gain and place. The bound is on the x of the contact, given as the mean absolute
    error (cm) of a Gaussian estimator; infinite if the information is singular.
    """
    tube = Tube(thesis.DIAMETER_CM, thesis.CRITICAL)
    centers, step = np.array(thesis.CENTERS_CM), _BOUND_STEP_CM

    def readings_with(dx: float, dy: float, ahead: float = 0.0) -> tuple[Floats, float]:
        """Readings without noise with the dowel moved, and x of the contact."""
        moved_peg = Peg(peg.x + dx, peg.y + dy, peg.radius)
        body = solve(free, thesis.LENGTH_CM, tube=tube, pegs=[moved_peg])
        x = body.contacts[-1].x if body.contacts else float("nan")
        return body.averages(centers + ahead, thesis.SPAN_CM), x

    readings = readings_with(0.0, 0.0)[0]
    slope = (readings_with(0.0, 0.0, step)[0] - readings) / step
    pairs = [
        (readings_with(dx, dy), readings_with(-dx, -dy)) for dx, dy in ((step, 0.0), (0.0, step))
    ]
    jacobian = np.array([(far - near) / (2 * step) for (far, _), (near, _) in pairs])
    gradient = np.array([(far_x - near_x) / (2 * step) for (_, far_x), (_, near_x) in pairs])
    errors = (gain_error * readings) ** 2 + (constants.position_cm * slope) ** 2
    variance = max(constants.noise, 1e-9) ** 2 + errors
    information = jacobian / variance @ jacobian.T
    if np.linalg.cond(information) > 1e12:
        return float("inf")
    return float(np.sqrt(2 / np.pi * gradient @ np.linalg.solve(information, gradient)))
