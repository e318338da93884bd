"""Readings that several steps share, row by row; the fits come later.

Each plans its rows, leaves out those that the folder already holds, and stores each one as it
comes, so that a stopped command goes on where it was.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np

from thigmo.calibrate.bench import READ_S, STEADY_S, Bench, Row
from thigmo.config import SIDES, Side

_PUSHES = 3  # at one place, if the tip goes to the other side
_ASIDE_CM = 1.0  # a tip nearer to the straight robot is on neither side
# Slow, because an overshoot would turn the muscle over to its other branch.
_RAMP_PSI_S = 1.0


def growth_rows(bench: Bench) -> list[Row]:
    """Grow from where the robot is; at each stop counts and length, and 30 s of creep."""
    spool, held = bench.config.spool, bench.session.rows("growth")

    def stop(length: float) -> None:
        key = f"stop {length:g}"
        if key in held:
            return
        began = bench.robot.read(0.05).t_s
        records = [bench.robot.record(0.25) for _ in range(round(bench.plan.creep_s / 0.25))]
        reading = bench.robot.read(0.5)
        seen = bench.seen(
            lambda: {"seen_cm": bench.eyes.axis(free_bend=True).length_cm}, {"seen_cm": None}
        )
        bench.session.add("growth", {
            "key": key, "counts": reading.length_cm * spool.counts_per_cm * spool.payout_ratio,
            "encoder_cm": reading.length_cm, "speed_cm_s": spool.max_speed_cm_s,
            "t_s": [float(r.t_s.mean()) - began for r in records],
            "ohm": [bench.mean_ohm(r) for r in records], **seen,
        })  # fmt: skip

    bench.bring_to(bench.config.body.length_cm, stop)
    return list(bench.session.rows("growth").values())


def bend_set_points(bench: Bench, side: Side) -> list[tuple[str, float]]:
    """Branch and pressure, up and down."""
    top = bench.config.actuators.side(side).max_pressure_psi
    up = [*np.arange(0.0, top, bench.plan.step_psi).tolist(), top]
    return [("inflate", p) for p in up] + [("deflate", p) for p in reversed(up[:-1])]


def bend_rows(bench: Bench, zones: Iterable[int]) -> list[Row]:
    """Free bends of both muscles at full length, for each body pressure."""
    length = bench.config.body.length_cm

    def shot() -> Row:
        axis = bench.eyes.axis(free_bend=True, length_cm=length)
        return {"k": axis.coefficients[2], "k_se": float(axis.covariance[2, 2] ** 0.5)}

    def take(key: str, asked: Row) -> Row:
        if asked["psi"] == 0.0:
            bench.robot.vent()
        else:
            bench.press(asked["side"], asked["psi"], _RAMP_PSI_S)
        bench.robot.wait(STEADY_S + bench.plan.step_psi / _RAMP_PSI_S)
        reading = bench.robot.read(READ_S)
        seen = bench.seen(shot, {"k": None, "k_se": None})
        return {
            **asked, "psi": getattr(reading, f"{asked['side']}_psi"), "ohm": bench.ohm(reading),
            "rest": bench.rest, "t_s": reading.t_s, **seen,
        }  # fmt: skip

    rows: list[Row] = []
    for zone in zones:
        body = bench.config.body.zones[zone].pressure_psi
        planned = {
            f"zone {zone} trial {trial} {side} {branch} {psi:g}": {
                "zone": zone, "body_psi": body, "trial": trial, "side": side, "branch": branch,
                "psi": psi,
            }
            for trial in range(bench.plan.trials)
            for side in SIDES
            for branch, psi in bend_set_points(bench, side)
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
            bench.robot.wait(STEADY_S)
            reading = bench.robot.read(2 * READ_S)
            seen = _tip_seen(bench)
            y = seen["tip"][1]
            if wanted is None or y is None or y * wanted > 0 or abs(y) < _ASIDE_CM:
                break
            stood, side = ("left", "right") if y > 0 else ("right", "left")
            bench.say(f"{key}: the tip stands {abs(y):.1f} cm to the {stood}: push it to the "
                      f"{side} (if it is there, the camera's +y is not the robot's left: mend the "
                      "cards' places in the sheet file)")  # fmt: skip
        return {
            "kind": key.split()[0], "asked": wanted, "ohm": bench.ohm(reading),
            "rest": bench.rest, "t_s": reading.t_s, **seen,
        }  # fmt: skip

    rows = bench.rows("tips", planned, take)
    bench.hand.push_tip(None)
    return rows


def bow_rows(bench: Bench) -> list[Row]:
    """Pictures of the body with its tip far aside, sides in turn."""
    reach, half = _tip_reach_cm(bench), bench.plan.pictures // 2
    asked = [sign * y for y in np.linspace(0.6 * reach, reach, half) for sign in (1, -1)]

    def take(key: str, y_cm: float) -> Row:
        bench.hand.push_tip(y_cm)
        bench.robot.wait(STEADY_S)
        return _tip_seen(bench)

    rows = bench.rows("bows", {f"bow {n}": y for n, y in enumerate(asked)}, take)
    bench.hand.push_tip(None)
    return rows


def _tip_reach_cm(bench: Bench) -> float:
    body = bench.config.body  # just short of the fold
    return 0.85 * body.critical_curvature * body.length_cm**2 / 3


def _tip_seen(bench: Bench) -> Row:
    """The tip and the axis by the camera; None where it does not see the robot."""

    def shot() -> Row:
        axis = bench.eyes.axis(free_bend=False, length_cm=bench.config.body.length_cm)
        return {"tip": list(axis.tip_cm), "points": axis.points_cm}

    return bench.seen(shot, {"tip": [None, None], "points": None})
