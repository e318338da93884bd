"""Trigger latency against false alarms over the board's averaging and debounce.

Empty rooms are swept with each of the three parts of the sensors' noise (docs/methods.md: white,
hysteresis, offset at each eversion), alone and together, at multiples of the default scene's. Each
report there is a false alarm. Latency is measured in three ways with all three parts at their
default: from steps of base curvature of 1.5 and of 2 times the threshold, and from the moment at
which the true contact curvature at the base exceeds the threshold in a sweep into a peg. The
trigger is the firmware's own, on the virtual board.

The defaults in protocol/schema.yaml are chosen by this rule. 50 Hz hum of ten thresholds must not
alarm, and at most 1 of 100 empty sweeps with all three noise parts at twice their default. Of the
remaining settings, those within 10 ms of the shortest latency in 90 % of sweeps into pegs count as
equal, and the shortest latency for 95 % of the steps of 1.5 times the threshold decides.

No scene has mains hum, because its size is unknown before the robot is wired. But the hum that a
setting tolerates is known (`hum_borne`), and the rule requires ten thresholds. Neither an average
of 32 samples nor a debounce of 9 ms tolerates that alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from matplotlib.figure import Figure

from thigmo.config import SIDES
from thigmo.display.axes import CYCLE
from thigmo.emulator.board import Floats
from thigmo.emulator.reach import random_peg
from thigmo.emulator.scene import PegTable, Scene
from thigmo.link.protocol import PARAMETERS
from thigmo_bench.studies import charts
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record
from thigmo_bench.studies.trigger_sessions import (
    Setting,
    false_alarms,
    halves_of,
    latencies,
    record,
    replay,
)

WHITE = ("white_counts", "pressure_counts")
PARTS: dict[str, tuple[str, ...]] = {
    "white": WHITE,
    "hysteresis": ("hysteresis",),
    "offset per eversion": ("per_eversion",),
    "all three": (*WHITE, "hysteresis", "per_eversion"),
}
LEVELS = (2.0, 4.0)  # multiples of the default scene's noise
FILTERS = (0, 2, 3, 4, 5, 6)
DEBOUNCES_MS = (1, 3, 6, 9, 12)
STEPS = (1.5, 2.0)  # of the threshold
PEGS = 0.0  # in place of a step: a sweep into a peg
DECIDING = ("all three", 2.0)
ALLOWED_PER_100 = 1.0
HUM_PER_MS = 0.05  # 50 Hz; every setting here tolerates at least as much of 60 Hz
LEAST_HUM = 10.0  # thresholds
EQUAL_MS = 10.0
DEAD_TIME_MS = 63.0  # of valve and muscle: a faster trigger stops the muscle no sooner
_SWEEPS = 10  # both sides each, a session

DEFAULT = Setting(
    *(PARAMETERS[f"trigger_{name}"].defaults[0] for name in ("filter_log2", "debounce_ms", "e5"))
)
THRESHOLD = DEFAULT.threshold_e5 * 1e-5
_TRIED = (Setting(f, d, DEFAULT.threshold_e5) for f, d in product(FILTERS, DEBOUNCES_MS))
SETTINGS = tuple(dict.fromkeys((*_TRIED, DEFAULT)))


def room(part: str, level: float) -> Scene:
    """An empty room at full length with only that part of the noise, and exact calibration."""
    scene = Scene.load("default").model_copy(deep=True)
    scene.pegs = []
    scene.start_length_cm = scene.robot.body.length_cm
    for name in type(scene.belief).model_fields:
        setattr(scene.belief, name, 0.0)
    for name in PARTS["all three"]:
        value = getattr(scene.noise, name) * level if name in PARTS[part] else 0.0
        setattr(scene.noise, name, value)
    return scene


def sweep_empty(task: tuple[str, float, int]) -> Floats:
    """False alarms (settings,) in empty sweeps under a multiple of one part of the noise."""
    part, level, seed = task
    session = record(room(part, level), seed, halves_of([0, 1] * _SWEEPS), threshold=THRESHOLD)
    return np.array(
        [false_alarms(session, replay(session, setting)) for setting in SETTINGS], dtype=float
    )


def touch(task: tuple[float, int]) -> Floats:
    """Latencies (ms), (settings, touches), of steps of `step` thresholds, or a sweep into a peg."""
    step, seed = task
    rng = np.random.default_rng([seed, 0x7016])
    scene = room("all three", 1.0)
    if step != PEGS:
        touch_ms = rng.integers(100, 350, 2 * _SWEEPS) * 10
        halves = halves_of([0, 1] * _SWEEPS, touch_ms.tolist())
    else:
        peg, contact = random_peg(scene.robot, rng)
        scene.pegs = [PegTable(x=peg.x, y=peg.y, radius=peg.radius)]
        scene.start_length_cm = contact.length_cm
        halves = halves_of([SIDES.index(contact.side)])
    session = record(scene, seed, halves, step=step * THRESHOLD, threshold=THRESHOLD)
    return np.array([latencies(session, replay(session, setting)) for setting in SETTINGS])


def run(context: Context) -> Outcome:
    """False alarms, latencies, the chart of one against the other, and what the rule chooses."""
    usual_count, deciding_count = context.count(1, 2), context.count(2, 15)
    sessions = {
        (p, k): deciding_count if (p, k) == DECIDING else usual_count for p in PARTS for k in LEVELS
    }
    tasks = [(*noise, seed) for noise, count in sessions.items() for seed in range(1, 1 + count)]
    counted = iter(context.map(sweep_empty, tasks, "empty sweeps", lambda task: 2 * _SWEEPS))
    alarms = {
        noise: 100 * np.mean([next(counted) for _ in range(count)], axis=0) / _SWEEPS
        for noise, count in sessions.items()
    }
    touches = {**dict.fromkeys(STEPS, context.count(1, 4)), PEGS: context.count(3, 30)}
    touched = [(step, seed) for step, count in touches.items() for seed in range(1, 1 + count)]
    sizes = {**dict.fromkeys(STEPS, 2 * _SWEEPS), PEGS: 1}
    timed = iter(context.map(touch, touched, "touches", lambda task: sizes[task[0]]))
    latency_ms = {
        step: np.concatenate([next(timed) for _ in range(count)], axis=1)
        for step, count in touches.items()
    }
    claims = _claims(alarms[DECIDING].tolist(), latency_ms)
    return Outcome(
        {"settings": _table(alarms, latency_ms)}, {"chart": _figure(alarms, latency_ms)}, claims
    )


def quantile(values: Floats, share: float, *, early: bool) -> float:
    """A quantile of latencies (ms); missed contacts are infinite.

    A report before the touch counts if `early` (a peg bends the base before the threshold is
    exceeded); otherwise it is a false alarm and omitted (nothing precedes a step). NaN if false
    alarms preceded every touch.
    """
    good = np.sort(values if early else values[values >= 0])
    return float(good[min(int(np.ceil(share * len(good))), len(good)) - 1]) if len(good) else np.nan


def _deciding_ms(late: dict[float, Floats]) -> tuple[list[float], list[float]]:
    """Latencies of each setting: 95 % of steps of 1.5 thresholds, 90 % of sweeps into pegs."""
    return (
        [quantile(row, 0.95, early=False) for row in late[STEPS[0]]],
        [quantile(row, 0.9, early=True) for row in late[PEGS]],
    )


def hum_borne(setting: Setting) -> float:
    """Largest amplitude (thresholds) of 50 Hz hum without a false alarm; may be infinite.

    The average of n samples passes a share of the hum. An alarm needs this share to exceed the
    threshold for as many successive samples as the debounce takes.
    """
    samples = 2**setting.filter_log2
    averaged = abs(np.sin(np.pi * HUM_PER_MS * samples)) / (samples * np.sin(np.pi * HUM_PER_MS))
    debounced = np.cos(np.pi * HUM_PER_MS * min(setting.debounce_ms - 1, 0.5 / HUM_PER_MS))
    return float(1.0 / (averaged * debounced)) if debounced > 1e-9 else np.inf


def allowed(settings: Sequence[Setting], alarms: Sequence[float]) -> list[int]:
    """Indices of the settings among which the rule chooses."""
    return [
        n
        for n, (setting, rate) in enumerate(zip(settings, alarms, strict=True))
        if hum_borne(setting) >= LEAST_HUM and rate <= ALLOWED_PER_100
    ]


def best_setting(candidates: Sequence[int], steps: Sequence[float], pegs: Sequence[float]) -> int:
    """Index of the setting that the rule chooses of those that it allows, from their latencies."""
    shortest = min(pegs[n] for n in candidates)
    return min((n for n in candidates if pegs[n] < shortest + EQUAL_MS), key=lambda n: steps[n])


def _table(alarms: dict[tuple[str, float], Floats], late: dict[float, Floats]) -> list[Record]:
    """A line a setting: false alarms in 100 empty sweeps, and latencies."""
    rows: list[Record] = []
    for n, setting in enumerate(SETTINGS):
        row: dict[str, float] = setting._asdict()
        for (part, level), rates in alarms.items():
            row[f"alarms_per_100, {part}, {level:g} times"] = round(float(rates[n]), 2)
        for step, values in late.items():
            name = "peg" if step == PEGS else f"step_{step:g}_threshold"
            for label, share in (("median", 0.5), ("90", 0.9), ("95", 0.95)):
                late_ms = quantile(values[n], share, early=step == PEGS)
                row[f"{name}_{label}_ms"] = round(late_ms, 1)
            row[f"{name}_missed"] = int(np.isinf(values[n]).sum())
        rows.append(row)
    return rows


def _claims(rates: list[float], late: dict[float, Floats]) -> list[Claim]:
    steps, pegs = _deciding_ms(late)
    candidates = allowed(SETTINGS, rates)
    ours, best = SETTINGS.index(DEFAULT), best_setting(candidates, steps, pegs)
    fastest = min(pegs[n] for n in candidates)
    return [
        Claim(f"default trigger: {text}", value, limit, unit=unit)
        for text, value, limit, unit in (
            ("false alarms in 100 empty sweeps at twice the noise", rates[ours], ALLOWED_PER_100,
             ""),
            ("90 % of sweeps into pegs, behind the fastest setting allowed", pegs[ours] - fastest,
             EQUAL_MS, "ms"),
            ("95 % of steps of 1.5 thresholds, behind the setting the rule chooses",
             steps[ours] - steps[best], 0.0, "ms"),
            ("95 % of steps of 1.5 thresholds (limit: the muscle's dead time)", steps[ours],
             DEAD_TIME_MS, "ms"),
        )
    ]  # fmt: skip


def _figure(alarms: dict[tuple[str, float], Floats], late: dict[float, Floats]) -> Figure:
    """A row of panels a kind of touch, a column a part of the noise that ever alarms."""
    loud = [part for part in PARTS if any(alarms[part, level].any() for level in LEVELS)]
    silent = [part for part in PARTS if part not in loud]
    figure, axes = charts.panels(
        2, len(loud), size=(4, 3.4), share=True,
        title="Contact trigger: latency against false alarms. Noise at 2 (full line) and 4 times "
        f"its default (dotted).\nPoints along a line: debounce of "
        f"{', '.join(map(str, DEBOUNCES_MS))} ms. Star: the board's default. Grey: at most "
        f"{ALLOWED_PER_100:g} in 100.\n"
        f"Noise without false alarms: {', '.join(silent) or 'none'}.",
    )  # fmt: skip
    labels = (
        ("latency of 95 % of steps of 1.5 thresholds (ms)", (0.0, 70.0)),
        ("latency of 90 % of sweeps into pegs (ms)", (-60.0, 150.0)),
    )
    kinds = zip(_deciding_ms(late), labels, ("{}", ""), strict=True)
    for axis, ((latency, (label, limits), title), part) in zip(
        axes, product(kinds, loud), strict=True
    ):
        points = np.array(latency)
        axis.axhspan(-0.4, ALLOWED_PER_100, color="0.9", zorder=0)
        for level, line, size, star in zip(LEVELS, ("o-", "o:"), (5, 3), (15, 9), strict=True):
            rates, first = alarms[part, level], level == LEVELS[0]
            for color, log2 in zip(CYCLE, FILTERS, strict=False):
                same_filter = [setting.filter_log2 == log2 for setting in SETTINGS]
                axis.plot(
                    points[same_filter], rates[same_filter], line, color=color, markersize=size,
                    markerfacecolor=color if first else "white",
                    label=f"{2**log2}" if first else None,
                )  # fmt: skip
            ours = SETTINGS.index(DEFAULT)
            axis.plot(points[ours], rates[ours], "*", color="black", markersize=star, zorder=5)
        axis.set_yscale("symlog", linthresh=1.0)
        axis.set_yticks([0, 1, 10, 100], ["0", "1", "10", "100"])
        axis.set(ylim=(-0.4, 300), xlim=limits, xlabel=label, title=title.format(part))
    for axis in axes[:: len(loud)]:
        axis.set_ylabel("false alarms in 100 empty sweeps")
    charts.legend_below(figure, title="samples averaged")
    return figure
