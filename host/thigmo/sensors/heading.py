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
RAD_PER_OHM = 1e-4  # by which the board's reader of IMUs says a turn


class HeadingSensor(AnySensor):
    """What the body turns by from one IMU to the next; or from its base, where the span begins.

    The board's reader of IMUs says the turn as a divider would: by a resistance.
    """

    wrinkles = False
    imu_inputs = 1
    fault_words = {  # noqa: RUF012
        "A flex sensor's circuit is open": "An IMU does not answer",
        "its wire": "the IMUs at both its ends, and their bus",
    }
    kind: Literal["heading"]  # the turn between two IMUs
    span_cm: Positive  # from one IMU to the other
    scale: Positive = 1.0  # turn over what the IMUs say: how they lie, and their gain
    scale_se: NonNegative = 0.05  # one sigma of it, relative
    zero_rad: Finite = 0.0  # turn that they say of the straight body
    heading_se_rad: NonNegative = 3e-3  # of either IMU: what it drifts by from zeroing to reading
    noise: Positive = 1e-4  # 1/cm, white, of an averaged reading
    # Of the IMU at the span's far end: the multiplexer's channel, and its address; 0 = not stated.
    mux_channel: Annotated[int, Field(ge=0, le=7)] = 0
    i2c_address: Annotated[int, Field(ge=0, le=127)] = 0  # on that channel

    bend_sign: ClassVar[int] = 0
    straight_ohm: ClassVar[float] = 12_000.0  # that the reader says for no turn

    def rescale(self, factor: float) -> None:
        """Let it stand for so much more curvature."""
        self.scale *= factor

    @property
    def raw_zero(self) -> float:
        """What the reader says of the straight body."""
        return self.straight_ohm + self.zero_rad / RAD_PER_OHM

    @property
    def raw_scale(self) -> float:
        """Curvature (1/cm) for each ohm that the reader says."""
        return self.scale * RAD_PER_OHM / self.span_cm

    @property
    def ends_cm(self) -> tuple[float, float]:
        """Places of its IMUs; 0 is the base, which does not turn."""
        return self.center_cm - self.span_cm / 2, self.center_cm + self.span_cm / 2

    @property
    def reading_se(self) -> float:
        """One sigma of an averaged reading, 1/cm: noise, and what its IMUs drift by."""
        imus = 1 if self.ends_cm[0] < SAME_IMU_CM else 2
        return hypot(self.noise, self.heading_se_rad * imus**0.5 / self.span_cm)

    @classmethod
    def shared_errors(cls, sensors: Sequence[Self]) -> Floats:
        """An IMU stands between two turns: what it drifts by is in both, with opposite signs."""
        places, imus = imus_of(sensors)
        columns = np.zeros((len(sensors), len(places)))
        for row, (sensor, ends) in enumerate(zip(sensors, imus, strict=True)):
            columns[row, ends] = np.array([-1.0, 1.0]) * sensor.heading_se_rad / sensor.span_cm
        return columns[:, places > SAME_IMU_CM]

    @property
    def passes_at(self) -> Passage:
        """Its farther IMU must not lie in the fold.

        An IMU whose turn the board reads as a divider's, not over the bus, looks like a flex sensor
        that swings from where its span begins, up to a whole span early: it shows no tip.
        """
        return Passage(self.ends_cm[1], IMU_CM, self.center_se_cm, seen=self.i2c_address != 0)


def imus_of(sensors: Sequence[HeadingSensor]) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Places (k,) of IMUs, cm, and the numbers (n, 2) of those where each span begins and ends.

    Spans that meet share one. A place of 0 is the base, which does not turn, and no IMU.
    """
    ends = np.array([sensor.ends_cm for sensor in sensors]).reshape(-1, 2)
    ascending = np.sort(ends, axis=None)
    places = ascending[np.diff(ascending, prepend=-np.inf) > SAME_IMU_CM]
    return places, np.searchsorted(places, ends + SAME_IMU_CM) - 1


def imu_ends(sensors: Sequence[AnySensor | None]) -> tuple[list[int], list[int]]:
    """The IMUs where the span on each input begins and ends, as `imu_from` and `imu_to` hold them.

    0 is the base, and no IMU. An IMU has the address of the sensor that ends with it: a span that
    begins where none ends has no address there, and does not count as read over the bus.
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
