"""Heading sensors: the turn of the body from one IMU to the next."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field

from thigmo.sensors.sensor import AnySensor, Floats, Passage
from thigmo.toml_model import Finite, NonNegative, Positive

IMU_CM = 1.2  # length of an IMU's board along the body
SAME_IMU_CM = 0.05  # places that are nearer are one IMU's
RAD_PER_OHM = 1e-4  # of a turn, in the resistance that the board reports for it


class HeadingSensor(AnySensor):
    """The turn of the body from one IMU to the next, or from its base to the first one.

    The board reads the IMUs and reports the turn as a resistance, as for an input with a divider.
    """

    wrinkles = False
    imu_inputs = 1
    calibrated_by_file = True
    fault_words = {  # noqa: RUF012
        "A flex sensor's circuit is open": "An IMU does not answer",
        "its wire": "the IMUs at both its ends, and their bus",
    }
    kind: Literal["heading"]  # the turn between two IMUs
    span_cm: Positive  # from one IMU to the other
    scale: Positive = 1.0  # true turn over the measured one: mounting and gain of the IMUs
    scale_se: NonNegative = 0.05  # one sigma of it, relative
    zero_rad: Finite = 0.0  # turn that is measured on the straight body
    heading_se_rad: NonNegative = 3e-3  # drift of either IMU from zeroing to reading, one sigma
    noise: Positive = 1e-4  # 1/cm, white, of an averaged reading
    # Of the IMU at the span's far end: the multiplexer's channel, and its address; 0 = not stated.
    mux_channel: Annotated[int, Field(ge=0, le=7)] = 0
    i2c_address: Annotated[int, Field(ge=0, le=127)] = 0  # on that channel

    bend_sign: ClassVar[int] = 0
    straight_ohm: ClassVar[float] = 12_000.0  # that the board reports for no turn

    def rescale(self, factor: float) -> None:
        """Multiply the curvature of every reading by a factor."""
        self.scale *= factor

    @property
    def raw_zero(self) -> float:
        """The raw reading of the straight body, ohm."""
        return self.straight_ohm + self.zero_rad / RAD_PER_OHM

    @property
    def raw_scale(self) -> float:
        """Curvature (1/cm) per ohm."""
        return self.scale * RAD_PER_OHM / self.span_cm

    @property
    def ends_cm(self) -> tuple[float, float]:
        """Arcs of the IMUs at both ends of its span, cm; 0 is the base, which does not turn."""
        return self.center_cm - self.span_cm / 2, self.center_cm + self.span_cm / 2

    @property
    def reading_se(self) -> float:
        """One sigma of an averaged reading, 1/cm: its noise and the drift of its IMUs."""
        imus = 1 if self.ends_cm[0] < SAME_IMU_CM else 2
        return hypot(self.noise, self.heading_se_rad * imus**0.5 / self.span_cm)

    @classmethod
    def shared_errors(cls, sensors: Sequence[Self]) -> Floats:
        """(n, k) effect of one sigma of each IMU's drift: opposite signs in the two spans at it."""
        places, imus = imus_of(sensors)
        columns = np.zeros((len(sensors), len(places)))
        for row, (sensor, ends) in enumerate(zip(sensors, imus, strict=True)):
            columns[row, ends] = np.array([-1.0, 1.0]) * sensor.heading_se_rad / sensor.span_cm
        return columns[:, places > SAME_IMU_CM]

    @property
    def passes_at(self) -> Passage:
        """The IMU at its far end, which must not lie in the fold.

        A turn that does not come over the bus swings as soon as the tip reaches the beginning of
        the span, up to a whole span early, so it does not show where the tip is.
        """
        return Passage(self.ends_cm[1], IMU_CM, self.center_se_cm, seen=self.i2c_address != 0)


def imus_of(sensors: Sequence[HeadingSensor]) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Arcs (k,) of the IMUs, cm, and indices (n, 2) of those where each span begins and ends.

    Spans that meet share an IMU. An arc of 0 is the base, which does not turn and has no IMU.
    """
    ends = np.array([sensor.ends_cm for sensor in sensors]).reshape(-1, 2)
    ascending = np.sort(ends, axis=None)
    places = ascending[np.diff(ascending, prepend=-np.inf) > SAME_IMU_CM]
    return places, np.searchsorted(places, ends + SAME_IMU_CM) - 1


def imu_ends(sensors: Sequence[AnySensor | None]) -> tuple[list[int], list[int]]:
    """Addresses of the IMUs where the span on each input begins and ends.

    They are the values of the parameters `imu_from` and `imu_to`. 0 stands for the base, which has
    no IMU. Each IMU has the address of the sensor whose span ends at it. A span that begins where
    no other ends has no address there, and is not read over the bus.
    """
    addresses = [
        (sensor.ends_cm[1], sensor.mux_channel << 7 | sensor.i2c_address)
        for sensor in sensors
        if isinstance(sensor, HeadingSensor) and sensor.i2c_address
    ]
    begins, ends = [0] * len(sensors), [0] * len(sensors)
    for number, sensor in enumerate(sensors):
        if not isinstance(sensor, HeadingSensor):
            continue
        start = sensor.ends_cm[0]
        nearest_cm, address = min(
            addresses, key=lambda entry: abs(entry[0] - start), default=(0.0, 0)
        )
        based = start < SAME_IMU_CM
        if sensor.i2c_address and (based or abs(nearest_cm - start) < SAME_IMU_CM):
            begins[number] = 0 if based else address
            ends[number] = sensor.mux_channel << 7 | sensor.i2c_address
    return begins, ends
