"""What is done with the robot on the bench, reading by reading; the fits come later.

Each procedure plans its rows, leaves out those that the folder already holds, and stores each one
as it comes, so that a stopped command goes on where it was.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.bench import Bench, Row
from thigmo.calibrate.check import CheckReadings
from thigmo.calibrate.lag import later_s
from thigmo.config import SIDES, Side

Array = NDArray[np.float64]

_STEADY_S = 2.5  # from a new set point to a bend at rest: lag, swing, and a good margin
_READ_S = 1.0
_PEAK_S = 0.05
_PUSHES = 3  # at one place, if the tip goes to the other side
_ASIDE_CM = 1.0  # a tip nearer to the straight robot is on neither side
# Slow, because an overshoot would turn the muscle over to its other branch.
_RAMP_PSI_S = 1.0
# Ramps up and down, for the lag of 0.2..0.4 s: an error of pressure or map looks like a lag that is
# the longer the slower the ramp, a lag is the same in all.
_RAMPS_S = (0.7, 0.7, 2.1) * 5
_RAMP_STOP_S = 1.5
_RAMP_END_PSI = 2.5  # just above the transducer's live zero
_RAMP_FRAME_S = 0.02


def growth_rows(bench: Bench) -> list[Row]:
    """Grow from where the robot is; at each stop counts and length, and 30 s of creep."""
    per_cm = bench.config.spool.counts_per_cm * bench.config.spool.payout_ratio
    speed = bench.config.spool.max_speed_cm_s
    held = bench.session.rows("growth")

    def stop(length: float) -> None:
        key = f"stop {length:g}"
        if key in held:
            return
        began = bench.robot.read(0.05).t_s
        records = [bench.robot.record(0.25) for _ in range(round(bench.plan.creep_s / 0.25))]
        reading = bench.robot.read(0.5)
        blank = {"seen_cm": None}
        seen = bench.seen(lambda: {"seen_cm": bench.eyes.axis(free_bend=True).length_cm}, blank)
        bench.session.add(
            "growth",
            {
                "key": key, "counts": reading.length_cm * per_cm, "encoder_cm": reading.length_cm,
                "speed_cm_s": speed,
                "t_s": [float(r.t_s.mean()) - began for r in records],
                "ohm": [bench.mean_ohm(r).tolist() for r in records],
                **seen,
            },
        )  # fmt: skip

    bench.bring_to(bench.config.body.length_cm, stop)
    return list(bench.session.rows("growth").values())


def _press(bench: Bench, side: str, psi: float, ramp_psi_s: float = 0.0) -> None:
    """Bring one muscle to a pressure."""
    bench.robot.press(**{f"{side}_psi": psi, "ramp_psi_s": ramp_psi_s})


def bend_set_points(bench: Bench, side: Side) -> list[tuple[str, float]]:
    """Branch and pressure, up and down."""
    top = bench.config.actuators.side(side).max_pressure_psi
    up = [*np.arange(0.0, top, bench.plan.step_psi).tolist(), top]
    return [("inflate", p) for p in up] + [("deflate", p) for p in reversed(up[:-1])]


def bend_rows(bench: Bench, zones: Iterable[int]) -> list[Row]:
    """Free bends of both muscles at full length, for each body pressure."""
    rows: list[Row] = []
    for zone in zones:
        body = bench.config.body.zones[zone].pressure_psi
        planned = {
            f"zone {zone} trial {trial} {side} {branch} {psi:g}": (trial, side, branch, psi)
            for trial in range(bench.plan.trials)
            for side in SIDES
            for branch, psi in bend_set_points(bench, side)
        }

        def take(
            key: str, asked: tuple[int, Side, str, float], zone: int = zone, body: float = body
        ) -> Row:
            trial, side, branch, psi = asked
            if psi == 0.0:
                bench.robot.vent()
            else:
                _press(bench, side, psi, _RAMP_PSI_S)
            bench.robot.wait(_STEADY_S + bench.plan.step_psi / _RAMP_PSI_S)
            reading = bench.robot.read(_READ_S)

            def shot() -> Row:
                axis = bench.eyes.axis(free_bend=True, length_cm=bench.config.body.length_cm)
                return {"k": axis.coefficients[2], "k_se": float(axis.covariance[2, 2] ** 0.5)}

            seen = bench.seen(shot, {"k": None, "k_se": None})
            return {
                "zone": zone, "body_psi": body, "trial": trial, "side": side, "branch": branch,
                "psi": getattr(reading, f"{side}_psi"),
                "ohm": bench.ohm(reading).tolist(), "rest": bench.rest, "t_s": reading.t_s,
                **seen,
            }  # fmt: skip

        rows.extend(bench.rows("bends", planned, take, partial(bench.ready_to_bend, zone)))
        bench.robot.vent()
    return rows


def tip_rows(bench: Bench) -> list[Row]:
    """Straight rows, and the tip held at places on both sides."""
    plan, reach = bench.plan, _tip_reach_cm(bench)
    half = plan.places // 2
    far = [reach * (n + 1) / half for n in range(half)]
    # Out and back, sides in turn: neither a loop nor a shift looks like a side.
    asked = [sign * y for y in (*far[::2], *reversed(far[1::2])) for sign in (1, -1)]
    planned: dict[str, float | None] = {f"straight {n}": None for n in range(plan.straight)}
    planned |= {f"tip {n}": y for n, y in enumerate(asked)}

    def take(key: str, wanted: float | None) -> Row:
        for _ in range(_PUSHES):
            bench.hand.push_tip(wanted)
            bench.robot.wait(_STEADY_S)
            reading = bench.robot.read(2 * _READ_S)
            seen = _tip_seen(bench)
            y = seen["tip"][1]
            if wanted is None or y is None or y * wanted > 0 or abs(y) < _ASIDE_CM:
                break
            stood, side = ("left", "right") if y > 0 else ("right", "left")
            bench.say(f"{key}: the tip stands {abs(y):.1f} cm to the {stood}: push it to the "
                      f"{side} (if it is there, the camera's +y is not the robot's left: mend the "
                      "cards' places in the sheet file)")  # fmt: skip
        return {
            "kind": key.split()[0], "asked": wanted, "ohm": bench.ohm(reading).tolist(),
            "rest": bench.rest, "t_s": reading.t_s, **seen,
        }  # fmt: skip

    rows = bench.rows("tips", planned, take, bench.ready_to_bend)
    bench.hand.push_tip(None)
    return rows


def bow_rows(bench: Bench) -> list[Row]:
    """Pictures of the body with its tip far aside, sides in turn."""
    reach, half = _tip_reach_cm(bench), bench.plan.pictures // 2
    asked = [sign * y for y in np.linspace(0.6 * reach, reach, half) for sign in (1, -1)]

    def take(key: str, y_cm: float) -> Row:
        bench.hand.push_tip(y_cm)
        bench.robot.wait(_STEADY_S)
        return _tip_seen(bench)

    planned = {f"bow {n}": y for n, y in enumerate(asked)}
    rows = bench.rows("bows", planned, take, bench.ready_to_bend)
    bench.hand.push_tip(None)
    return rows


def _tip_reach_cm(bench: Bench) -> float:
    body = bench.config.body
    return bench.plan.tip_reach_cm or 0.85 * body.critical_curvature * body.length_cm**2 / 3


def _tip_seen(bench: Bench) -> Row:
    """The tip and the axis by the camera; None where it does not see the robot."""

    def shot() -> Row:
        axis = bench.eyes.axis(free_bend=False, length_cm=bench.config.body.length_cm)
        x, y = axis.tip_cm
        return {"tip": [x, y], "points": axis.points_cm.tolist()}

    return bench.seen(shot, {"tip": [None, None], "points": None})


def push_rows(bench: Bench) -> list[Row]:
    """Hard pushes at the tip, sides in turn, each with its own straight reading."""
    config = bench.config
    reach = 1.7 * config.body.critical_curvature * config.body.length_cm**2 / 3

    def take(key: str, y_cm: float) -> Row:
        bench.hand.push_tip(None)
        bench.robot.wait(_STEADY_S)
        straight = bench.robot.read(_READ_S)
        bench.hand.push_tip(y_cm)
        bench.robot.wait(_STEADY_S)
        pushed = bench.robot.read(2 * _READ_S)
        bench.hand.push_tip(None)
        return {"rest": bench.ohm(straight).tolist(), "ohm": bench.ohm(pushed).tolist()}

    planned = {f"push {n}": (-1) ** n * reach for n in range(bench.plan.pushes)}
    return bench.rows("pushes", planned, take, bench.ready_to_bend)


def rest_rows(bench: Bench) -> list[Row]:
    """Readings of the resting robot."""

    def take(key: str, _: None) -> Row:
        # As long as a sweep's peak is averaged.
        reading = bench.robot.read(_PEAK_S)
        bench.robot.wait(0.5)
        return {"t_s": reading.t_s, "ohm": bench.ohm(reading).tolist()}

    planned = {f"rest {n}": None for n in range(bench.plan.rest_readings)}
    return bench.rows("rest", planned, take, bench.ready_to_bend)


def ramp(bench: Bench, side: Side, zone: int) -> tuple[Array, Array, Array] | None:
    """Time, pressure and curvature (mean of the inactive side) of ramps up and down.

    The readings of all sensors are moved to be as late as the base sensor's. None where no sensor
    of that side is healthy.
    """
    top = 0.9 * bench.config.actuators.side(side).max_pressure_psi
    other: Side = "right" if side == "left" else "left"
    sensors = bench.config.sensors.column(other)

    def take(key: str, _: None) -> Row:
        parts = []
        for seconds in _RAMPS_S:
            for target in (top, _RAMP_END_PSI):
                _press(bench, side, target, top / seconds)
                parts.append(bench.robot.record(seconds + _RAMP_STOP_S))
        bench.robot.vent()
        t = np.concatenate([p.t_s for p in parts])
        psi = np.concatenate([getattr(p, f"{side}_psi") for p in parts])
        far = len(bench.config.sensors.left) if side == "left" else 0
        ohm = np.concatenate([bench.ohm(p)[:, far : far + len(sensors)] for p in parts])
        step = max(1, round(_RAMP_FRAME_S / float(np.median(np.diff(t)))))
        return {"t_s": t[::step].tolist(), "psi": psi[::step].tolist(),
                "ohm": ohm[::step].tolist()}  # fmt: skip

    ready = partial(bench.ready_to_bend, zone)
    row = bench.rows("lag", {f"ramp {side} zone {zone}": None}, take, ready)[0]
    t, ohm = np.array(row["t_s"], float), np.array(row["ohm"], float)
    later = later_s(1 << bench.robot.parameter("oversample_log2")[0])
    bends = [
        np.interp(t + (later if n else 0.0), t, ohm[:, n]) * sensor.scale_per_ohm
        for n, sensor in enumerate(sensors)
        if sensor.healthy
    ]
    return (t, np.array(row["psi"], float), np.mean(bends, axis=0)) if bends else None


def check_readings(bench: Bench) -> CheckReadings:
    """Rest, one bend and one hold for each muscle."""
    bench.ready_to_bend()
    config = bench.config
    rest = np.array([bench.ohm(bench.robot.read(0.25)) for _ in range(8)])
    top = 0.7 * config.actuators.left.max_pressure_psi
    bent: dict[Side, Array] = {}
    seen: dict[Side, float] = {}
    held: dict[Side, Array] = {}
    for side in SIDES:
        _press(bench, side, top)
        bench.robot.wait(_STEADY_S)
        record = bench.robot.record(4.0)
        held[side] = np.column_stack([record.t_s - record.t_s[0], getattr(record, f"{side}_psi")])
        bent[side] = bench.mean_ohm(record)
        shot = bench.seen(
            lambda: {"k": float(bench.eyes.axis(free_bend=True).coefficients[2])}, {"k": None}
        )
        if shot["k"] is not None:
            seen[side] = shot["k"]
        bench.robot.vent()
        bench.robot.wait(1.0)
    zone = len(config.body.zones) - 1
    return CheckReadings(rest, bent, top, seen, held, zone=zone)
