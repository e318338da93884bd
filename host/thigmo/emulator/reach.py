"""Where pegs can be felt: the noise-free answer that explorations are judged by.

Sweeps the quasi-static body (no lags, no noise, the true maps) through every growth stage and says
at which stage and side the base contact curvature first passes the trigger's threshold. Also makes
random rooms in which that happens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thigmo.config import SIGN, RobotConfig, Side
from thigmo.emulator.scene import PegTable, Scene
from thigmo.mechanics import Peg, PegContact, Rod, Tube, critical_moment, rest_mean

TRIGGER = 0.005  # 1/cm
_STEP_PSI = 0.25
_LEAST_PSI = 4.0  # well above a transducer's live zero
_PRESSED = 1.2  # over the pressure at which a peg is felt


@dataclass(frozen=True, slots=True)
class Felt:
    """A contact that passes the threshold."""

    length_cm: float  # growth stage
    side: Side  # of the active muscle
    pressure_psi: float  # at which the threshold is passed
    peak: float  # largest |base contact curvature| of that sweep (1/cm)
    contacts: tuple[PegContact, ...]  # touching pegs at the sweep's peak


def stages(robot: RobotConfig) -> list[float]:
    """Everted lengths at which a robot that grows by whole pitches sweeps, the last one full."""
    full, pitch = robot.body.length_cm, robot.body.pitch_cm
    if not robot.body.grows:
        return [full]
    pitches = [pitch * n for n in range(1, int(full / pitch) + 1) if pitch * n < full - 1e-6]
    return [*pitches, full]


def first_felt(robot: RobotConfig, pegs: Sequence[Peg]) -> Felt | None:
    """The first growth stage and side whose full sweep is felt at the base, or None.

    The base contact curvature is the base sensor's mean curvature (fold included) less the free
    curvature. At each stage the first muscle's half of the sweep comes first.
    """
    sweeps = (
        sweep_once(robot, pegs, length, side) for length in stages(robot) for side in robot.sides
    )
    return next((touch for touch in sweeps if touch is not None and touch.peak >= TRIGGER), None)


def pressed(robot: RobotConfig, pegs: Sequence[Peg]) -> str:
    """Muscle and pressure, as `left=6`, that press the whole robot against a peg where it can."""
    full = robot.body.length_cm
    touches = [sweep for side in robot.sides if (sweep := sweep_once(robot, pegs, full, side))]
    best = max(touches, key=lambda sweep: sweep.peak, default=None)
    muscle = robot.muscle(best.side if best else robot.sides[0])
    psi = max(_PRESSED * best.pressure_psi, _LEAST_PSI) if best else np.inf
    return f"{muscle.name}={min(psi, muscle.max_pressure_psi):g}"


def sweep_once(
    robot: RobotConfig, pegs: Sequence[Peg], length_cm: float, side: Side
) -> Felt | None:
    """Inflate one muscle from zero to its highest pressure; None if nothing is felt.

    That is, where no peg is touched, or no sensor answers to the muscle.
    """
    body = robot.body
    body_pressure = body.pressure_number(length_cm)
    muscle = robot.muscle(side)
    crit = critical_moment(
        body.critical_curvature,
        body.critical_pressure_psi,
        body.pressures[body_pressure].pressure_psi,
    )
    tube = Tube(body.diameter_cm, crit, rest_curvature=body.rest_pieces)
    model = Rod(tube, pegs, model="auto")
    model.step(0.0, length_cm)
    if not (sensors := robot.sensors_for(side)):
        return None
    base = sensors[0]
    center, span, mean = np.array([base.center_cm]), np.array([base.span_cm]), np.zeros(1)
    at_rest = rest_mean(body.rest_pieces, center, span)
    sign = SIGN[side]
    touches: list[tuple[float, float]] = []  # pressure and base contact curvature while it touches
    top = muscle.max_pressure_psi
    for pressure in np.linspace(0.0, top, max(2, round(top / _STEP_PSI) + 1))[1:].tolist():
        g = sign * muscle.maps[body_pressure].inflate.curvature(pressure)
        model.step(g, length_cm)
        if model.touching:
            model.averages_into(center, span, mean)
            touches.append((pressure, abs(float(mean[0] - at_rest[0]) - g)))
    if not touches:
        return None
    trigger_psi = next((pressure for pressure, excess in touches if excess >= TRIGGER), 0.0)
    peak = max(excess for _, excess in touches)
    return Felt(length_cm, side, trigger_psi, peak, model.contacts())


def random_peg(
    robot: RobotConfig, rng: np.random.Generator, *, radius: tuple[float, float] = (0.4, 1.0)
) -> tuple[Peg, Felt]:
    """A peg beside the path of growth that the exploration must feel, and where it first does.

    Only pegs that still hold the body at the peak of that sweep are made: a body that slips past
    its peg (contacts are frictionless) has nothing to measure there.
    """
    full = robot.body.length_cm
    while True:
        r = float(rng.uniform(*radius))
        clear = robot.body.radius_cm + r + 0.3
        x = float(rng.uniform(5.0, full))
        y = float(rng.choice([-1.0, 1.0]) * rng.uniform(clear, 0.8 * full))
        peg = Peg(round(x, 3), round(y, 3), round(r, 3))
        touch = first_felt(robot, [peg])
        if touch is not None and touch.contacts:
            return peg, touch


def room_for(robot: RobotConfig, seed: int, *, peg: bool = True) -> Scene:
    """A room for a robot, with a peg that it feels or without; else as `scenes/default.toml`.

    The push at which a tip stalls is half of pressure times section over EI, which goes with the
    third power of the radius.
    """
    scene = Scene.load("empty")
    usual = scene.robot.body.radius_cm
    scene.name, scene.extends, scene.robot = robot.name, None, robot
    scene.body.growth_force *= usual / robot.body.radius_cm
    scene.transducer.at_20ma_psi = robot.board.transducer_psi
    scene.transducer.sensor_full_psi = robot.board.pressure_sensor_psi
    if peg:
        scene.about = "A room with one peg that the robot feels."
        touched, _ = random_peg(robot, np.random.default_rng([seed, 0x9E6]))
        scene.pegs = [PegTable(x=touched.x, y=touched.y, radius=touched.radius)]
    return scene
