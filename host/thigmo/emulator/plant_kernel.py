"""The compiled steps of the plant: air, spool and sensors over one plant step of 10 ms.

Quasi-static mechanics stand between `air` (which yields the free curvature) and `sense` (which
turns the body's curvature into ADC counts). State lives in plain arrays owned by `plant.py`.
"""

from __future__ import annotations

from math import cos, exp, fabs, isnan, sin, tanh

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled

Floats = npt.NDArray[np.float64]

# Columns of the muscles' state (one row a side).
OUTLET, BEND_PRESSURE, DEFLATING, PLAY = 0, 1, 2, 3
MUSCLE_STATE = 4
# Entries of the air's constants.
(
    AT_4MA, SPAN_PSI, LAG, DELAY, PLAY_PSI, SLEW, SUPPLY, INFLATE_TAU, DEFLATE_TAU, MUSCLE_DELAY, DT
) = range(11)  # fmt: skip
AIR_CONSTANTS = 11
RING = 32  # plant steps of delay that can be held
# Entries of the spool's state and constants.
LINE, SPEED = 0, 1
(
    DAMPING, MOTOR_LAG, STALL, SLIDING, HOLDING, SPOOL_DT
) = range(6)  # fmt: skip
STICKING_CM_S = 0.5  # line speed over which friction falls from holding to sliding [G]
OPEN_WINDINGS = 0.1  # damping that is left without a closed circuit: bearings and brushes [G]
# Columns of the sensors' constants (one row a sensor).
(
    SCALE, ZERO, DIRECTION, LOOP, CREEP_TAU, STOWED, PHASE_1, PHASE_2, CENTER, SPAN
) = range(10)  # fmt: skip
SENSOR_CONSTANTS = 10
# Columns of the sensors' state.
TURN, BENT, OFFSET, CREEP, EVERTED_AT, EVERTED = 0, 1, 2, 3, 4, 5
SENSOR_STATE = 6
# Entries of what ails all sensors.
(
    LOOP_WIDTH, WRONG_GAIN, WRINKLE, WRINKLE_START, WRINKLE_FULL, FOLD_BEND, DIVIDER
) = range(7)  # fmt: skip


@compiled
def air(
    current_ma: Floats,
    state: Floats,
    drive_ring: Floats,
    outlet_ring: Floats,
    head: int,
    constants: Floats,
    gain: Floats,
    maps: Floats,
    reversal: Floats,
    forced: Floats,
) -> float:
    """Advance transducers and muscles by one step; returns the free curvature.

    current_ma (2,) is the drive; forced (2,) overrides a transducer's output where not nan.
    maps (side, branch, (amplitude, scale, offset)). Rings hold past inputs, `head` is now.
    """
    dt = constants[DT]
    total = 0.0
    for side in range(2):
        level = current_ma[side]
        psi = constants[AT_4MA] + (level - 4.0) / 16.0 * constants[SPAN_PSI]
        psi = min(max(psi * gain[side], 0.0), constants[SUPPLY]) if level > 0.0 else 0.0
        drive_ring[side, head] = psi
        goal = _past(drive_ring[side], head, constants[DELAY] / dt)
        # Play between command and output.
        if goal <= 0.0:
            state[side, PLAY] = 0.0
        elif goal > state[side, PLAY] + constants[PLAY_PSI]:
            state[side, PLAY] = goal - constants[PLAY_PSI]
        elif goal < state[side, PLAY] - constants[PLAY_PSI]:
            state[side, PLAY] = goal + constants[PLAY_PSI]
        goal = state[side, PLAY]
        if not isnan(forced[side]):
            goal = forced[side]
        change = (goal - state[side, OUTLET]) * (1.0 - exp(-dt / constants[LAG]))
        most = constants[SLEW] * dt
        state[side, OUTLET] += min(max(change, -most), most)
        if goal == 0.0 and state[side, OUTLET] < 1e-6:
            state[side, OUTLET] = 0.0
        outlet_ring[side, head] = state[side, OUTLET]
        seen = _past(outlet_ring[side], head, constants[MUSCLE_DELAY] / dt)
        before = state[side, BEND_PRESSURE]
        tau = constants[INFLATE_TAU] if seen > before else constants[DEFLATE_TAU]
        now = before + (seen - before) * (1.0 - exp(-dt / tau))
        if seen == 0.0 and now < 1e-6:
            now = 0.0
        state[side, BEND_PRESSURE] = now
        branch = state[side, DEFLATING] - (now - before) / reversal[side]
        if now == 0.0:
            branch = 0.0
        branch = min(max(branch, 0.0), 1.0)
        state[side, DEFLATING] = branch
        g = (1.0 - branch) * _curve(now, maps[side, 0]) + branch * _curve(now, maps[side, 1])
        total += g if side == 0 else -g
    return total


@compiled
def _past(ring: Floats, head: int, steps: float) -> float:
    """Value so many steps ago, linear in between."""
    whole = int(steps)
    part = steps - whole
    a = ring[(head - whole) % RING]
    b = ring[(head - whole - 1) % RING]
    return float(a + part * (b - a))


@compiled
def _curve(pressure: float, shape: Floats) -> float:
    """amplitude * (tanh((p - p0) / scale) - tanh(-p0 / scale))."""
    turn = tanh((pressure - shape[2]) / shape[1]) - tanh(-shape[2] / shape[1])
    return float(shape[0] * turn)


@compiled
def swing(x: Floats, target: float, transition: Floats) -> None:
    """Second-order body: x = (curvature, rate) follows target by an exact step."""
    d = x[0] - target
    v = x[1]
    x[0] = target + transition[0, 0] * d + transition[0, 1] * v
    x[1] = transition[1, 0] * d + transition[1, 1] * v
    if fabs(x[0] - target) < 1e-10 and fabs(x[1]) < 1e-9:
        x[0] = target
        x[1] = 0.0


@compiled
def spool(
    state: Floats, duty: int, shorted: bool, stuck: bool, pull: float, constants: Floats
) -> None:
    """Advance motor and line by one step. pull: the tail's tension, N, which pays out.

    Windings that are shorted (braked, or between the pulses of the drive) damp: they take as much
    force as the line is fast, and none at rest. What holds at rest is friction; it falls from
    HOLDING to SLIDING as the line begins to move.
    """
    dt = constants[SPOOL_DT]
    sliding = constants[SLIDING]
    drive = constants[STALL] * duty / 800.0 + pull
    speed = state[SPEED]
    friction = sliding + (constants[HOLDING] - sliding) * exp(-fabs(speed) / STICKING_CM_S)
    if speed == 0.0 and fabs(drive) <= friction:
        return
    way = speed if speed != 0.0 else drive
    damping = constants[DAMPING] * (1.0 if shorted else OPEN_WINDINGS)
    lag = constants[MOTOR_LAG] * constants[DAMPING] / damping
    goal = (drive - (friction if way > 0.0 else -friction)) / damping
    state[SPEED] = goal + (speed - goal) * exp(-dt / lag)
    if state[SPEED] * way <= 0.0 and fabs(drive) <= constants[HOLDING]:
        state[SPEED] = 0.0
    if stuck:
        state[SPEED] = 0.0
    state[LINE] += state[SPEED] * dt
    if state[LINE] < 0.0:
        # The tail is home: pulled tight against the base.
        state[LINE] = 0.0
        state[SPEED] = 0.0


@compiled
def sense(
    curvature: Floats,
    length: float,
    t: float,
    muscle: Floats,
    sensors: Floats,
    state: Floats,
    ailments: Floats,
    counts: Floats,
) -> None:
    """Ideal ADC counts of the flex sensors from their mean curvature.

    curvature (N,) over the everted part; sensors (N, 10); state (N, 6); counts (N,) is filled.
    Sensors in the left half of N belong to the left side.
    """
    n = curvature.size
    for i in range(n):
        side = 0 if i < n // 2 else 1
        low = sensors[i, CENTER] - 0.5 * sensors[i, SPAN]
        high = sensors[i, CENTER] + 0.5 * sensors[i, SPAN]
        span = max(high - low, 1e-9)
        out = min(max((length - low) / span, 0.0), 1.0)
        u = curvature[i]
        sign = sensors[i, DIRECTION]
        if sign != 0.0 and u * sign < 0.0:
            u *= ailments[WRONG_GAIN]
        # Dahl's model of the loop: the lag saturates after LOOP_WIDTH of bending.
        change = curvature[i] - state[i, BENT]
        state[i, BENT] = curvature[i]
        if change != 0.0:
            w = ailments[LOOP_WIDTH]
            z = state[i, TURN]
            d = 1.0 if change > 0.0 else -1.0
            state[i, TURN] = d + (z - d) * exp(-fabs(change) / w)
        value = u - sensors[i, LOOP] * state[i, TURN]
        # Garbage while this side's muscle wrinkles the wall under it.
        p = muscle[side, BEND_PRESSURE]
        w = (p - ailments[WRINKLE_START]) / (ailments[WRINKLE_FULL] - ailments[WRINKLE_START])
        w = min(max(w, 0.0), 1.0)
        if w > 0.0:
            garbage = 0.3 * value + ailments[WRINKLE] * (
                sin(sensors[i, PHASE_1] + 0.9 * p) + 0.6 * sin(sensors[i, PHASE_2] + 3.1 * p)
            )
            value += w * w * (3.0 - 2.0 * w) * (garbage - value)
        if state[i, EVERTED] > 0.0:
            value += state[i, OFFSET]
            age = t - state[i, EVERTED_AT]
            if age < 12.0 * sensors[i, CREEP_TAU]:
                value += state[i, CREEP] * exp(-age / sensors[i, CREEP_TAU])
        else:
            # In the tail, or passing through the tip's fold.
            turn = sign if sign != 0.0 else 1.0
            fold = turn * ailments[FOLD_BEND] * (1.0 - cos(6.283185307179586 * out)) * 0.5
            value = out * value + (1.0 - out) * sensors[i, STOWED] + fold
        ohm = max(sensors[i, ZERO] + value / sensors[i, SCALE], 500.0)
        counts[i] = 1024.0 * ailments[DIVIDER] / (ailments[DIVIDER] + ohm)
