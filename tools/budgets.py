"""What the Mega's image costs, measured on the simulated chip: memory, cycles, delays, throughput.

    python tools/budgets.py             a table
    python tools/budgets.py --json      one JSON object
    python tools/budgets.py --check     compare with tools/budgets.json; exit 1 if worse
    python tools/budgets.py --update    write tools/budgets.json

Cycles are exact and the same in each run, so the ratchet is tight: a figure may not be worse than
the committed one by more than its slack, nor beyond its limit. A figure that got better by more
than that asks for `--update`, so that what was won stays won.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from mega_rig import RAM, Figure, Rig, painted_stack, scene, sections, static_ram
from soak import Soak

from thigmo.emulator.chip import CHANNELS, CYCLES_PER_MS, NO_COUNT
from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.framing import encode
from thigmo.robot.robot import Robot

RATCHET = Path(__file__).with_suffix(".json")
FLASH = 253_952
MIX_S = 90.0  # of the soak's mix, for the deepest stack
TASKS = ("receive", "sense", "control", "decide", "telemetry", "store", "transmit")
INTERRUPTS = {
    "encoder A": 5, "encoder B": 6, "tick": 17, "sampling": 19, "receive": 25, "transmit": 26,
}  # fmt: skip
US = 16  # cycles
SEED = 3


def start() -> Figure:
    """From a reset to the first tick, boot loader aside: the check of the image, then setup."""
    mega = SimulatedMega(SEED, boot_loader=False)
    mega.run_to_tick()
    ms = round(mega.chip.tick_origin / CYCLES_PER_MS, 1)
    return Figure("start, with the check of the image", ms, "ms", 300)


def session(rig: Rig) -> tuple[Robot, Client]:
    """A configured, armed, zeroed robot at 53 cm."""
    transport = EmulatorTransport(scene(), rig, seed=SEED, exchange_ms=1)
    client = Client(transport)
    robot = Robot(client)
    robot.configure(transport.config)
    robot.set_parameter("drift_limit_e5", [5000])
    robot.set_parameter("zero_ms", [300])
    robot.wait(0.3)
    robot.clear_faults()
    robot.confirm_length(51.5, settled=True)
    robot.select_body_pressure(2)
    robot.arm()
    return robot, client


def memory() -> list[Figure]:
    size = sections()
    return [
        Figure("flash", size[".text"] + size.get(".data", 0), "byte", FLASH),
        Figure("static RAM", static_ram(), "byte"),
    ]


def tasks(rig: Rig) -> list[Figure]:
    """Cycles from a task's mark to the next, interrupts within included."""
    marks = rig.take_marks()
    spent = np.diff(marks["cycle"]).astype(np.int64)
    kind = marks["value"][:-1]
    figures = []
    for number, name in enumerate(TASKS, 1):
        task_cycles = spent[kind == number]
        if number == 1:  # a pass of which the host wants nothing only looks
            task_cycles = task_cycles[task_cycles > np.median(task_cycles)]
        figures.append(Figure(f"task {name}, median", float(np.median(task_cycles)), "cycle"))
        figures.append(Figure(f"task {name}, worst", int(task_cycles.max()), "cycle"))
    sense = marks["cycle"][marks["value"] == 2].astype(np.int64)
    # A tick's conversions are complete 832 us into it.
    late = (sense - rig.chip.tick_origin - 832 * US) % CYCLES_PER_MS
    figures.append(Figure("control step after its readings, worst", late.max() / US, "us", 500))
    figures.append(Figure("control step's jitter", (late.max() - late.min()) / US, "us"))
    return figures


def busy_robot(rig: Rig) -> list[Figure]:
    """Grow, zero, sweep, with telemetry at 200 Hz, heartbeats and commands all the time."""
    robot, client = session(rig)
    chip = rig.chip
    chip.record_trace(True)
    chip.record_marks(True)
    chip.measure_again()
    rig.busy.clear()
    stamps: list[int] = []
    client.on_telemetry.append(lambda frame: stamps.append(frame.device_us))
    robot.grow_to(53.0)
    robot.confirm_length(53.0, settled=True)
    robot.zero()
    robot.sweep({"left": 14.0, "right": 14.0}, period_s=2.0)
    for number in range(100):
        client.request(wire.GetParameter(number % wire.PARAMETER_COUNT))
    robot.vent()
    stats = client.request(wire.GetLinkStats())
    trace = chip.take_trace()
    figures = []
    spacing = np.diff(trace["sampled"][trace["channel"] == 10].astype(np.int64))
    figures.append(Figure("sampling jitter", np.ptp(spacing) / US, "us", 20))
    for name, channel in (("pressure and base", 0), ("other flex", 1)):
        spacing = np.diff(trace["sampled"][trace["channel"] == channel].astype(np.int64))
        figures.append(Figure(f"scan rate, {name}", round(16e6 / float(spacing.mean()), 1), "Hz"))
    load = np.convolve(rig.busy, np.ones(5), "valid") / (5 * CYCLES_PER_MS)
    figures.append(Figure("loop load, mean", round(100 * float(np.mean(load)), 2), "%"))
    sustained = np.convolve(rig.busy, np.ones(100), "valid").max() / (100 * CYCLES_PER_MS)
    figures.append(Figure("loop load, worst 100 ms", 100 * float(sustained), "%", 50))
    figures.append(Figure("loop load, worst 5 ms", 100 * float(load.max()), "%", 50))
    figures += tasks(rig)
    for name, vector in INTERRUPTS.items():
        cost = chip.interrupt(vector)
        figures.append(Figure(f"interrupt {name}, worst", cost.longest, "cycle", 20 * US))
    # Frames that arrived, over the board's time from the first to the last of them.
    rate = 1e6 * (len(stamps) - 1) / (stamps[-1] - stamps[0])
    figures.append(Figure("telemetry rate", round(rate, 2), "Hz", 200, least=True))
    lost = stats.tx_dropped + client.stats.telemetry_lost + stats.rx_overruns
    figures.append(Figure("telemetry frames or bytes lost", lost, "", 0))
    return figures


def throughput(rig: Rig) -> list[Figure]:
    """Both directions full at once: telemetry each millisecond, heartbeats back to back."""
    transport = EmulatorTransport(scene(), rig, seed=SEED, exchange_ms=1)
    client = Client(transport)
    robot = Robot(client)
    robot.wait(0.2)
    robot.set_parameter("telemetry_ms", [1])
    robot.wait(0.1)
    transport.stop_heartbeat()
    old_stats = client.request(wire.GetLinkStats())
    sent, counter = 0, 1_000_000
    rig.wire.clear()
    start = rig.chip.cycle
    while rig.chip.cycle - start < 1000 * CYCLES_PER_MS:
        room = 200 - rig.chip.line_backlog
        while room > 0:
            counter += 1
            frame = encode(wire.Heartbeat(counter), 0, client.hello.session)
            transport.write(frame)
            room -= len(frame)
            sent += 1
        transport.read(0.005)
    seconds = (rig.chip.cycle - start) / 16e6
    up = sum(len(part) for part, _ in rig.wire) / seconds
    transport.pass_time(0.05)
    new_stats = client.request(wire.GetLinkStats())
    down = new_stats.rx_frames - old_stats.rx_frames
    return [
        Figure("link up, both ways full", round(up), "byte/s"),
        Figure("link down, both ways full", round(down / seconds), "frame/s"),
        Figure(
            "frames lost at that",
            sent + 1 - down + new_stats.rx_overruns - old_stats.rx_overruns,
            "",
            0,
        ),
    ]


def commands(rig: Rig) -> list[Figure]:
    """One command after the other, at each tick of a control period, telemetry at 200 Hz.

    A reply waits for the telemetry that lies ahead of it, whose 56 bytes take 2.2 ms: its time is
    that of the tick in which its command came.
    """
    transport = EmulatorTransport(scene(), rig, seed=SEED, exchange_ms=1)
    client = Client(transport)
    Robot(client).wait(0.2)
    times = []
    for number in range(60):
        if number % 12 == 0:
            rig.step(1)  # commands come every 10 ms: from here on, in the next tick of a period
        rig.forget_frames()
        sent = rig.chip.cycle
        client.request(wire.GetParameter(number % wire.PARAMETER_COUNT))
        reply = next(
            cycle for message, cycle in rig.frames() if isinstance(message, wire.ParameterValue)
        )
        times.append((reply - sent) / US / 1000)
    return [
        Figure("command to reply on the wire, median", round(float(np.median(times)), 3), "ms"),
        Figure("command to reply on the wire, worst", round(max(times), 3), "ms"),
    ]


def move_starts(rig: Rig) -> list[Figure]:
    """Moves that start at each tick of a control period, telemetry at 200 Hz.

    Command, acknowledgement, telemetry and the spool's first step must not meet in one millisecond.
    """
    robot, client = session(rig)
    robot.confirm_length(40.0, settled=True)
    rig.busy.clear()
    length_um = 400_000
    for _ in range(20):
        client.poll(0.05)
        rig.step(1)
        length_um += 2_000
        client.request(wire.GrowTo(length_um, 25_000))
        robot.wait(0.5)
    worst = max(rig.busy) / CYCLES_PER_MS
    load = np.convolve(rig.busy, np.ones(5), "valid").max() / (5 * CYCLES_PER_MS)
    return [
        Figure("load where a move starts, worst 1 ms", round(100 * worst, 2), "%"),
        Figure("load where a move starts, worst 5 ms", 100 * float(load), "%", 50),
    ]


JUNK_BYTES, JUNK_MS = 79, 24


def junk(rig: Rig) -> list[Figure]:
    """A fast retraction while the line brings junk: noise, and whole frames with a flipped bit."""
    robot, client = session(rig)
    transport = client.transport
    assert isinstance(transport, EmulatorTransport)
    for name, value in (("line_rating_n", 2000), ("touch_n_s_m", 0)):
        robot.set_parameter(name, [value])
    robot.confirm_length(50.0, settled=True)
    chance = np.random.default_rng(SEED)
    longest = wire.SetMap(0, 0, wire.Branch.INFLATE, (7,) * wire.MAP_POINTS)
    spoiled = bytearray(encode(longest, 1, client.hello.session))
    spoiled[-3] ^= 16
    frames = bytes(spoiled) * (JUNK_BYTES // len(spoiled))
    rig.busy.clear()
    client.request(wire.RetractTo(0, 25_000))
    for number in range(60):
        noise = bytes(chance.integers(1, 256, JUNK_BYTES - 1, np.uint8)) + b"\0"
        transport.write(noise if number % 2 else frames)
        transport.read(JUNK_MS / 1000)
    load = np.convolve(rig.busy, np.ones(5), "valid").max() / (5 * CYCLES_PER_MS)
    return [
        Figure("load in a retraction, junk on the line, worst 5 ms", 100 * float(load), "%", 50)
    ]


STEP_COUNTS = 20


def _step_run(with_step: bool) -> tuple[Rig, int, int, list[tuple[int, int]]]:
    """A sweep in an empty room; the inactive side's base sensor may jump by 20 counts."""
    rig = Rig(SEED)
    robot, client = session(rig)
    robot.grow_to(53.0)
    robot.confirm_length(53.0, settled=True)
    robot.zero()
    chip = rig.chip
    chip.record_trace(True)
    # Left muscle first: the right base sensor (channel 5) is the one that counts.
    client.request(wire.Sweep((1400, 0), 8000, 1, wire.SweepOption.HOLD_ON_CONTACT.mask))
    robot.wait(1.2)
    trace = chip.take_trace()
    last = int(trace["tick"][-1])
    level = round(float(np.mean(trace["count"][trace["channel"] == 5][-50:])))
    first = last + 8
    if with_step:
        table = np.full((400, CHANNELS), NO_COUNT, dtype=np.uint16)
        table[:, 5] = level + STEP_COUNTS
        chip.feed_trace(table, first)
    step_cycle = chip.tick_origin + first * CYCLES_PER_MS + 3 * 1664 + 192  # slot 3, its sample
    rig.forget_frames()
    drives = []
    transport = client.transport
    assert isinstance(transport, EmulatorTransport)
    original = rig.step

    def watched(ticks: int) -> None:
        original(ticks)
        drives.append((chip.cycle, rig.drive[0]))

    rig.step = watched  # type: ignore[method-assign]
    transport.pass_time(0.12)
    return rig, step_cycle, first, drives


def trigger_latency() -> list[Figure]:
    """From a step of the base sensor's voltage to the event's last byte, and to the valve."""
    rig, step_cycle, first, drives = _step_run(with_step=True)
    _, _, _, calm = _step_run(with_step=False)
    event, on_wire = next(
        (message, cycle)
        for message, cycle in rig.frames()
        if isinstance(message, wire.Event) and message.code is wire.EventCode.CONTACT
    )
    decided_ms = event.t_us / 1000 - (first + 0.832)  # ticks of filter and debounce
    reacted = next(a[0] for a, b in zip(drives, calm, strict=True) if a[1] != b[1])
    total = (on_wire - step_cycle) / US / 1000
    return [
        Figure("trigger's filter and debounce", round(decided_ms, 3), "ms"),
        Figure("trigger: step to event on the wire", round(total, 3), "ms"),
        Figure("trigger: beyond filter and debounce", round(total - decided_ms, 3), "ms", 5),
        Figure(
            "trigger: step to the valve's reaction",
            round((reacted - step_cycle) / US / 1000, 1),
            "ms",
        ),
    ]


def measure() -> list[Figure]:
    """All figures."""
    figures = [*memory(), start()]
    rig = Rig(SEED)
    depth = painted_stack(rig)
    figures += busy_robot(rig)
    # Every message, saves and faults as well: the mix of tools/soak.py, on the same painted RAM.
    transport = EmulatorTransport(scene(pegs=True), rig, seed=SEED, exchange_ms=1)
    Soak(Client(transport), SEED, transport).run(MIX_S)
    stack = depth()
    figures.insert(2, Figure("stack, worst", stack, "byte"))
    figures.insert(3, Figure("RAM with the worst stack", static_ram() + stack, "byte", 0.75 * RAM))
    figures += throughput(Rig(SEED, rig.eeprom))
    figures += commands(Rig(SEED, rig.eeprom))
    figures += move_starts(Rig(SEED, rig.eeprom))
    figures += junk(Rig(SEED, rig.eeprom))
    figures += trigger_latency()
    return figures


def slack(committed: float) -> float:
    """How far a figure may move before the ratchet notices: 1 %, and never less than 2."""
    return max(2.0, 0.01 * abs(committed))


def compare(figures: list[Figure], committed: dict[str, float]) -> list[str]:
    """What is wrong with the figures."""
    wrong = [
        f"{f.name}: {f.value:g} {f.unit}, the limit is {f.limit:g}"
        for f in figures
        if not f.within_limit
    ]
    for f in figures:
        if f.name not in committed:
            wrong.append(f"{f.name} is not in {RATCHET.name}: run tools/budgets.py --update")
            continue
        was = committed[f.name]
        worse = was - f.value if f.least or f.unit in ("byte/s", "frame/s", "Hz") else f.value - was
        if worse > slack(was):
            wrong.append(f"{f.name}: {f.value:g} {f.unit}, was {was:g}")
        elif -worse > 5 * slack(was):
            wrong.append(
                f"{f.name} improved from {was:g} to {f.value:g}: run --update to keep that"
            )
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--check", action="store_true", help="compare with the committed figures")
    parser.add_argument("--update", action="store_true", help="write the committed figures")
    options = parser.parse_args()
    figures = measure()
    if options.json:
        print(json.dumps({f.name: f.row for f in figures}, indent=2))
    else:
        for f in figures:
            print(f.line)
    if options.update:
        RATCHET.write_text(json.dumps({f.name: f.value for f in figures}, indent=2) + "\n")
    if options.check:
        wrong = compare(figures, json.loads(RATCHET.read_text()))
        for line in wrong:
            print(line, file=sys.stderr)
        return 1 if wrong else 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
