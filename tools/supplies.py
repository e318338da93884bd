"""Size the supplies and fuses of docs/hardware for a motor, a brake and valves.

    python tools/supplies.py --stall 5.0 --brake 0.8

A supply bears its loads with a stalled motor, cold and on 5 % more voltage, so that a stall pulls
nothing else down. A fuse carries its loads at work, and a motor that stalls, warm, melts it: a
time-lag fuse of 5 x 20 mm does so at 2.1 times its rating within two minutes, and carries 1.5 times
for an hour (IEC 60127-2, sheet 3, as in Littelfuse's data sheets of the 213 and 218 series).
"""

from __future__ import annotations

import argparse
import sys

RATINGS_A = (0.5, 0.63, 0.8, 1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3)
COLD = 9 / 8  # more current than the data sheet's: a cold winding, and 5 % more supply
WARM = 6 / 7  # less: a winding 40 K warmer
MELTS = 2.1
SPARE = 1.5
DUTY = 0.75 * 100 / (147 * COLD)  # the firmware's most, by the line's rating and the stall's pull


def motor_supply(stall_a: float, brake_a: float) -> float:
    """Least current of PS2, A."""
    return COLD * stall_a + brake_a


def working(stall_a: float, brake_a: float) -> float:
    """Most current that the 12 V give while the firmware drives the motor, stalled or not, A."""
    return DUTY**2 * COLD * stall_a + brake_a


def motor_fuse(stall_a: float, brake_a: float) -> float:
    """Rating of F2, A: the largest that a stall melts; ValueError where it does not carry work."""
    fit = [rating for rating in RATINGS_A if MELTS * rating <= WARM * stall_a + brake_a]
    if not fit or fit[-1] < working(stall_a, brake_a):
        raise ValueError("no fuse both carries the work and melts in a stall: take a weaker brake")
    return fit[-1]


def air_fuse(load_a: float) -> float:
    """Rating of F1, A: the smallest with half to spare."""
    return next(rating for rating in RATINGS_A if rating >= SPARE * load_a)


def main(words: list[str] | None = None) -> int:
    """Print what fits."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--stall", type=float, default=5.0, help="motor's stall current, A")
    parser.add_argument("--brake", type=float, default=0.8, help="brake's current, A; 0: none")
    parser.add_argument("--air", type=float, default=0.64, help="load of the 24 V, A")
    options = parser.parse_args(words)
    if options.stall <= 0 or options.brake < 0 or not 0 < options.air <= RATINGS_A[-1] / SPARE:
        parser.error("currents are in ampere and positive; the 24 V bear 4 A")
    try:
        fuse = motor_fuse(options.stall, options.brake)
    except ValueError as error:
        parser.error(str(error))
    print(f"PS2  12 V, {motor_supply(options.stall, options.brake):.1f} A or more")
    print(
        f"F2   {fuse:g} A slow; "
        f"the work takes {working(options.stall, options.brake):.1f} A at most"
    )
    print(f"PS1  24 V, {SPARE * options.air:.1f} A or more")
    print(f"F1   {air_fuse(options.air):g} A slow")
    return 0


if __name__ == "__main__":
    sys.exit(main())
