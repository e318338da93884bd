"""Write docs/faults.md: what each single failure does in each state, from the emulator.

    python tools/fault_table.py             all of it, four minutes of a core
    python tools/fault_table.py --jobs 2    on two cores
    python tools/fault_table.py --quick     the states that CI looks at, and the page says so

The rows are those of `thigmo bench faults`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from thigmo_bench.studies.engine import Context, Scale
from thigmo_bench.studies.faults import run

PAGE = Path(__file__).parents[1] / "docs/faults.md"
SUMMARY = "@SUMMARY@"
HEAD = """\
# What single failures do

Written by `python tools/fault_table.py`; do not edit. Each row is a run of the firmware on the
virtual board in the emulated body, at the body pressure that pulls hardest at the tail (1.47 psi,
4.9 N). The failure begins in the middle of the motion and lasts 13 s. Muscles may be pressed to
18.5 psi (`max_pressure_cpsi`).

@SUMMARY@

What is not noticed in time is covered by hardware that the last column of the tables names; growth
and pull are highest where nothing else ends them.

The first table is of the thesis's robot: its muscles empty only through the transducers, at 0 mA.
In the second one, valves empty muscles and body as soon as the board stops
([air](hardware/air.md)). In the third one, a brake also holds the spool, and contacts cut the
motor's supply ([electronics](hardware/electronics.md)). The last three are of robots with one
muscle (on the Mega's firmware; its second output stays free) and with four (on the large virtual
board), while they bend; and of the gallery's catheter, which has no spool. Its file states
`pressure_range_psi = 30`: `over_pressure` is 33 psi, and a valve that is stuck open meets a relief
valve of 40 psi.

- *noticed as*: the faults by which the board stopped; `reset`: the board restarted, outputs off.
- *safe*: seconds from the failure until both valves carry 0 mA and the motor is braked.
- *peak*, *steady*: highest true muscle pressure, and that of the last two seconds.
- *grown*: how far the tip grew after the failure. Growth that nothing stops goes on.
- *pull*: highest pull on the line, in newtons.
- *covered by*: the hardware that must act where no signal shows the failure, or where no output of
  the board can end it.

A sensor that flickers shows at most a pressure, but the truth for 20 ms of each second; a wire that
chatters is open for half of the time, at random. The rows of the state "starting" are of a board
that starts with a bit flipped in its newest configuration, an older one whole beside it, or whose
port is opened while a fault is latched: arming is refused until a host has stored the configuration
again, or somebody has cleared the fault.

The friction of motor and gearbox holds a pull of 11 N on the line [G: `dead_zone`, `holding_n`];
a stronger one is slowed by the shorted windings, not held, and becomes `spool_slip`.

A line that snaps no longer holds the body, and nothing at the spool does. In growth, sensors that
pass the tip too early reveal it. While the spool winds in, two sensors reveal it that lie in the
tail and are passed by a tip that runs outwards, or two that the tip was to meet on its way back
and has not met; that takes up to two pitches of growth, or of winding in
(`tests/sim/test_retraction.py`). IMUs show only that they were not met, which a short retraction
may miss. The valve that empties the body then ends the growth. While the spool stands, the encoder
shows what it must, and nothing is noticed: the emergency stop ends that growth, by the same valve.
A shorted driver that winds in pulls with 254 N if there is no brake. No duty limits that, so a line
for such a robot must hold 300 N.

The board alone detects an encoder that loses counts, by three signs: the motor's speed at its duty,
jumps of the encoder's signals, and two sensors that pass the tip before they may, judged by the
length or by the place where the two before them passed. One that shows too much is detected by a
speed that motor and body cannot have, and by two sensors that pass the tip too late.

For factors of 0.5 to 2.0 the tip of the thesis's robot then is within 3 cm of the length shown, or
within half a pitch where that is more, in growth; and in retraction for factors below 1. An encoder
off by 5 % may go unnoticed in growth; over the whole length that is less than 3 cm. A tip that too
little pressure moves too slowly passes its sensors late as well, and ends the growth by the same
fault.

A retraction with an encoder that shows too much ends too far out. Two sensors that pass the tip
late are a fault, and the length is unknown then. Where no two have passed, the retraction says
which sensor confirmed the length last, where, and how far out the tip may be beyond what is shown
if the encoder shows up to twice its way since then (`thigmo retract`, the page, the log of a run;
`farther_cm` with `--json`). `tests/sim/test_retraction.py` holds the tip to that for factors of 0.9
to 2.0. Where an encoder shows too little, the body may be home before the length shown is 0: the
base ends the motion, as `spool_stall`. The speed of winding in is limited so that line and tail
bear that, also if the spool turns twice as fast as it shows.

Bodies of 7 and 10 cm with a pitch of 14.5 cm are within half a pitch, 7.25 cm, for factors of 0.5
to 2.0 in growth once `thigmo calibrate encoder` has measured how hard they pull
(`tests/sim/test_lost_counts.py`, which allows a tenth more). Without it, one of 10 cm may be 10 cm
off at factor 1.7: a tip that is held back looks the same until it reaches its next sensor, a pitch
away. The fold bends a sensor in inverse proportion to the body's diameter, so that a thicker body's
sensors are seen to pass by a smaller swing (`fold_swing_e5`).

The host only provides a calibration:
`thigmo calibrate encoder` measures how much duty the body's pull saves at each body pressure
(`pull_duty`). The board judges the speed with it while a sensor's swing shows that the tip moves.
`tests/sim/test_lost_counts.py` holds the tip to 2.2 cm beyond what was counted with 9, 8, 7, 5 and
3 counts of 10. Without that calibration, 8 of 10 reach 3.2 cm; with it, 82 to 87 of 100 reach 3 cm.

A further failure beside that of the encoder or of a flex sensor does no more harm than the two
alone (`tests/sim/test_fault_campaign.py`). But the firmware cannot handle two failures at once if
one of them is a sensor whose wrong reading hides the other. Only hardware covers these:

- A pressure sensor that is frozen, and a valve that sticks open: the supply regulator and the
  relief valve bound the pressure.
- A dead encoder, and a passive brake that slips, or a driver that is shorted: the brake BR1, or the
  emergency stop, which empties the body.

A welded contact in the motor's supply changes nothing while the motor may have its supply. The
board notices it at the end of the motion, when the contact ought to open.

The promises, over all rows of all tables:

"""
SOME = "Not every state is in this page: `python tools/fault_table.py` writes them all."
TITLES = (
    "Without valves, as in the thesis",
    "With the valves that empty muscles and body",
    "With valves, and with the brake and the contacts of the motor's supply",
    "One muscle, without valves",
    "Four muscles, without valves",
    "Catheter of 28 psi with air for 30, without valves",
)


def main() -> None:
    """Run the campaign and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    scale: Scale = "quick" if options.quick else "full"
    outcome = run(Context(scale=scale, jobs=options.jobs, progress=_count))
    names = [
        "failure", "state", "noticed as", "safe, s", "peak, psi", "steady, psi", "grown, cm",
        "pull, N", "covered by",
    ]  # fmt: skip
    cells = [
        [[str(cell) for cell in row.values()] for row in table] for table in outcome.tables.values()
    ]
    lines = [f"- {claim}" for claim in outcome.claims]
    if options.quick:
        lines += ["", SOME]
    for title, table in zip(TITLES, outcome.tables.values(), strict=True):
        lines += ["", f"## {title}", ""]
        lines += ["| " + " | ".join(names) + " |", "| --- " * len(names) + "|"]
        lines += ["| " + " | ".join(str(cell) for cell in row.values()) + " |" for row in table]
    PAGE.write_text(HEAD.replace(SUMMARY, summary(cells)) + "\n".join(lines) + "\n")
    for claim in outcome.claims:
        print(claim)


def summary(tables: Sequence[Sequence[Sequence[str]]]) -> str:
    """A row for each robot: how many failures are noticed, and the worst that comes of any.

    Args:
        tables: of each robot, the rows of its table as cells.
    """
    head = (
        "robot", "failures in a state", "noticed", "not noticed, and covered",
        "safe at the latest, s",
        "highest pressure, psi", "most growth, cm", "hardest pull, N",
    )  # fmt: skip
    lines = [f"| {' | '.join(head)} |", "| --- " * len(head) + "|"]
    for title, rows in zip(TITLES, tables, strict=True):
        silent = [row for row in rows if row[2] == "not noticed"]
        covered = sum(bool(row[8]) for row in silent)
        worst = [max(float(row[column] or 0) for row in rows) for column in (3, 4, 6, 7)]
        cells = (
            title, len(rows), len(rows) - len(silent), f"{len(silent)}, {covered}",
            *(f"{value:g}" for value in worst),
        )  # fmt: skip
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def _count(part: str, done: int, total: int) -> None:
    end = "" if done < total else "\n"
    print(f"\r{part}: {done} of {total}", end=end, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
