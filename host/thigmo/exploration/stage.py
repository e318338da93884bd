"""One stage of an exploration, from its sweep to its entry in contacts.json.

Shared by the live run and the replay of a record, so that both say the same.
"""

from __future__ import annotations

from collections.abc import Sequence

from thigmo.config import RobotConfig
from thigmo.exploration.feel import Feeling, feel
from thigmo.exploration.workspace import Bend, centreline
from thigmo.record import Shape, Stage, Trigger
from thigmo.robot import SweepFrame, SweepResult

_SHAPES_A_SIDE = 12


def feel_sweep(sweep: SweepResult, config: RobotConfig, zone: int) -> list[Feeling]:
    """Localize at the peak of each side on which the board's trigger fired."""
    fired = {trigger.side for trigger in sweep.triggers}
    return [feel(peak, config, zone) for peak in sweep.peaks if peak.side in fired]


def stage_entry(
    length_cm: float,
    body_pressure_psi: float,
    t_s: float,
    sweep: SweepResult,
    feelings: Sequence[Feeling],
) -> Stage:
    """The stage's entry in contacts.json."""
    by_side = {feeling.shape.side: feeling.result for feeling in feelings}
    return Stage(
        everted_length_cm=length_cm,
        body_pressure_psi=body_pressure_psi,
        t_s=t_s,
        shapes=[*_free_shapes(length_cm, sweep.frames), *(f.shape for f in feelings)],
        triggers=[
            Trigger(
                t.side,
                t.t_s,
                t.excess_per_cm,
                by_side[t.side].status if t.side in by_side else "no peak",
                by_side[t.side].message if t.side in by_side else "",
            )
            for t in sweep.triggers
        ],
    )


def _free_shapes(length_cm: float, frames: Sequence[SweepFrame]) -> list[Shape]:
    """A dozen shapes of each half sweep, as far as nothing was touched."""
    shapes = []
    for side in ("left", "right"):
        free = [f for f in frames if f.side == side and not f.touched]
        top = max((f.pressure_psi for f in free), default=0.0)
        kept = 0
        for frame in sorted(free, key=lambda f: f.pressure_psi):
            if frame.pressure_psi >= top * (kept + 1) / _SHAPES_A_SIDE:
                poses = centreline(Bend(length_cm, frame.free_curvature)).poses(1.0)
                shapes.append(Shape(side, frame.pressure_psi, poses))
                kept += 1
    return shapes
