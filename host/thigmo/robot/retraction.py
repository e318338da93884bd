"""The end of a retraction: the length by the encoder, and how far out the tip may be beyond it.

Two sensors that pass the tip too early or too late are a fault (`sensing/fold_watch.h`). Beyond the
last sensor that passed the tip, and where one passed it alone, the encoder stands alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from thigmo.link import protocol as wire
from thigmo.wiring import Wiring

# An encoder shows at most twice its counts: what both edges of both signals give where one signal's
# were meant, or half of the gear that was meant.
_MOST_FACTOR = 2.0
_NO_SENSOR = 255
_PLACE_CM = 0.8  # by which a place and the moment of passing it are in doubt (kDoubtUm)
_LATE_CM = 2.0  # beyond which a sensor passes the tip late (kLateUm)


@dataclass(frozen=True, slots=True)
class Retraction:
    """Where a retraction ended, and what confirms it."""

    length_cm: float  #: everted length by the encoder
    farther_cm: float  #: most that the tip is farther out, if the encoder shows up to twice its way
    seen_cm: float  #: length that was shown where the tip was last confirmed
    seen_by: str  #: sensor that passed the tip there; empty where the way in began
    late: bool  #: that sensor passed the tip later than any tip lags behind a sound encoder
    sees: bool  #: whether the robot has sensors that show where the tip passes

    @classmethod
    def of(cls, tip: wire.TipReport, wiring: Wiring, length_cm: float) -> Retraction:
        """Judge a retraction that has just ended at a length, by the board's report."""
        seen_cm = tip.length_um / 1e4
        sensor = None if tip.sensor == _NO_SENSOR else wiring.sensors[tip.sensor]
        late_cm = sensor.passes_at.center_cm - seen_cm if sensor else 0.0
        way_cm = seen_cm - length_cm
        farther_cm = _PLACE_CM + max(late_cm, 0.0) + way_cm * (1.0 - 1.0 / _MOST_FACTOR)
        if sensor and late_cm > _PLACE_CM:  # then its swing may have only begun
            farther_cm += sensor.passes_at.span_cm / 2
        return cls(
            length_cm=length_cm,
            farther_cm=farther_cm,
            seen_cm=seen_cm,
            seen_by=wiring.sensor_name(tip.sensor) if sensor else "",
            late=late_cm > _LATE_CM,
            sees=any(s.healthy and s.passes_at.is_shown for s in wiring.config.board_sensors),
        )

    @property
    def words(self) -> str:
        """For the operator."""
        reached = f"Retracted to {self.length_cm:.1f} cm by the encoder"
        if not self.sees:
            return f"{reached} alone: no sensor of this robot shows where its tip is."
        last = (
            f"the last sensor that confirmed it was {self.seen_by}, at {self.seen_cm:.1f} cm"
            if self.seen_by
            else f"no sensor has confirmed it since {self.seen_cm:.1f} cm"
        )
        words = (
            f"{reached}; {last}, so the tip may be up to {self.farther_cm:.1f} cm farther out if "
            "the encoder is wrong."
        )
        if self.late:
            words += (
                " That sensor was late: look at the tip. If it is farther out, check the encoder "
                "(J5) and its coupling, measure the length, and give it: "
                "`thigmo retract --length CM`."
            )
        return words
