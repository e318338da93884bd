"""Everything at once: random commands, faults and telemetry, and every promise watched.

    python tools/soak.py                        nine seeds of 0.1 h of robot time each, on the
                                                simulated Mega
    python tools/soak.py --board virtual        the portable core alone, in a few minutes; it looks
                                                at its line four times a millisecond, and so gives
                                                up a telemetry frame in a crowd of events
    python tools/soak.py --hours 0.05 --seed 2 --seeds 1 --json
    python tools/soak.py --connect /dev/ttyACM0?baud=500000
                                                a real board over a real cable, questions only

Commands are all of the schema's, with valid, impossible and meaningless contents, of wrong sizes
and unknown numbers: moves, sweeps, presses, zeroing, parameters, maps, saves (one in two minutes,
for the EEPROM's sake). Wires break, air fails, the spool sticks, the emergency stop is pressed; now
and then the host says hello again. Exit code 1 when a promise is broken. Of several seeds, counts
are added up, and of everything else the worst is given, unrounded. A run depends on its seed alone;
ctrl-C ends it early, with the figures so far. tools/budgets.py paints the stack under the same mix.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import statistics
import sys
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace

from mega_rig import RAM, Figure, Rig, painted_stack, scene, static_ram

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.board import EmulatedBoard
from thigmo.emulator.chip import CYCLES_PER_MS
from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.emulator.scene import FaultTable
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import BoardResetError, CommandRefusedError, CommandTimeoutError
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.inbox import ReceivedEvent
from thigmo.link.transport import open_transport
from thigmo.robot.robot import Robot

WARM_UP_S = 60.0
RECOVER_S = 25.0
SAVE_S = 120.0
HELLO_S = 300.0
CLOCK_S = 1.0
# What the mix must not do at random: end the session, or swallow events that were not delivered.
OWN = (wire.Hello, wire.AckEvent, wire.SaveConfig)
# These answer when they are done, and are repeated until then.
LONG = (wire.SaveConfig.ID, wire.LoadDefaults.ID, wire.ApplyParameters.ID)
COMMANDS = [m for m in wire.MESSAGES.values() if issubclass(m, wire.Command) and m not in OWN]
FAULTS = (
    "flex_wire_cut", "flex_short", "pressure_wire_cut", "pressure_stuck", "over_pressure",
    "air_lost", "spool_stall", "spool_slip", "brown_out", "estop",
)  # fmt: skip
ALL_FAULTS = sum(fault.mask for fault in wire.Fault)
WORST = {"loop load, worst 5 ms": 5, "loop load, worst 100 ms": 100}
ELEMENTS = {row.index + i: row for row in wire.PARAMETERS.values() for i in range(row.count)}
TELEMETRY_MS = wire.PARAMETERS["telemetry_ms"].index


class Raw(wire.Command[wire.Message]):
    """A command of any number and any bytes."""

    DEADLINE_S = 2.0

    def __init__(self, number: int, payload: bytes) -> None:
        self.ID = number  # type: ignore[misc]
        self.NAME = f"raw_{number:02x}"  # type: ignore[misc]
        self._payload = payload

    def pack(self) -> bytes:
        """The payload."""
        return self._payload


# The client looks for the type of a reply in the command's class.
RAW = {c.REPLY: type("Raw", (Raw,), {"REPLY": c.REPLY}) for c in COMMANDS}


class SoakRig(Rig):
    """A simulated Mega that keeps the worst loads only, for an hour has many milliseconds."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.worst = dict.fromkeys(WORST, 0)
        self._recent = {name: deque([0] * width, width) for name, width in WORST.items()}
        self._sum = dict.fromkeys(WORST, 0)
        self._chip_run = self.chip.run
        self.chip.run = self._run  # type: ignore[method-assign]

    def forget(self) -> None:
        """What was busy so far does not count."""
        self.worst = dict.fromkeys(WORST, 0)

    def step(self, ticks: int) -> None:
        """Run for a number of milliseconds."""
        SimulatedMega.step(self, ticks)

    def _run(self, cycle: int) -> bool:
        """A millisecond of the chip."""
        chip = self.chip
        start_cycle, asleep = chip.cycle, chip.asleep_cycles
        alive = self._chip_run(cycle)
        busy = chip.cycle - start_cycle - (chip.asleep_cycles - asleep)
        for name, recent in self._recent.items():
            self._sum[name] += busy - recent[0]
            recent.append(busy)
            self.worst[name] = max(self.worst[name], self._sum[name])
        return alive


class Soak:
    """One conversation under the mix.

    Args:
        client: connected.
        seed: of the mix.
        transport: of an emulated robot; None on a real board, which is asked questions only.
    """

    def __init__(
        self,
        client: Client,
        seed: int,
        transport: EmulatorTransport | None = None,
    ) -> None:
        self.client = client
        self.transport = transport
        self.random = random.Random(seed)
        self.count: Counter[str] = Counter()
        self.raised: Counter[str] = Counter()
        self.latency_ms = 0.0
        self._rig = transport.lockstep.board if transport else None
        self._sent_cycle = 0
        self._sent_s = 0.0
        self._next = dict.fromkeys(("recover", "save", "hello", "clock"), client.now())
        self._clock: list[float] = []
        client.on_event.append(self._note_event)
        client.taps.append(self._note_frame)
        if transport is not None:
            self.robot = Robot(client)
            self.robot.configure(transport.config)
            self.robot.set_parameter("drift_limit_e5", [5000])
            self.robot.set_parameter("zero_ms", [200])
            self.target_parameters = [
                client.request(wire.GetParameter(i)).value for i in range(wire.PARAMETER_COUNT)
            ]
            self.board_parameters = list(self.target_parameters)

    # --- what is noted --------------------------------------------------------------------------
    def _note_event(self, received: ReceivedEvent) -> None:
        event = received.message
        self.count[f"event {wire.EventCode(event.code).key}"] += 1
        if event.code is wire.EventCode.FAULT:
            self.raised[wire.Fault(event.arg).key] += 1

    def _note_frame(self, direction: str, data: bytes, _: float) -> None:
        if direction == "tx" and data[1] != wire.Heartbeat.ID:
            self._sent_s = self.client.now()
            if isinstance(self._rig, Rig):
                self._sent_cycle = self._rig.chip.cycle
                self._rig.forget_frames()

    def _note_latency(self) -> None:
        """From handing the command to the line to the reply's last byte on it."""
        took = (self.client.now() - self._sent_s) * 1e3
        if isinstance(self._rig, Rig):
            replies = [
                cycle for message, cycle in self._rig.frames() if isinstance(message, wire.Reply)
            ]
            if not replies:
                return  # lost
            took = (replies[-1] - self._sent_cycle) / CYCLES_PER_MS
        self.latency_ms = max(self.latency_ms, took)

    # --- asking ---------------------------------------------------------------------------------
    def ask(self, command: wire.Command[wire.Message]) -> wire.Message | None:
        """Send a command; None when it was refused or lost."""
        self.count["sent"] += 1
        reply: wire.Message | None = None
        repeats = self.client.stats.repeats
        try:
            reply = self.client.request(command)
            self.count["replied"] += 1
        except CommandRefusedError:
            self.count["replied"] += 1
            self.count["refused"] += 1
        except CommandTimeoutError:
            pass  # the client counts it
        except BoardResetError:
            self.count["restarts"] += 1
            self.client.connect()
        if command.ID not in LONG:
            self._note_latency()
            self.count["repeated"] += self.client.stats.repeats - repeats
        return reply

    def run(self, seconds: float) -> None:
        """Keep on for so long."""
        end_s = self.client.now() + seconds
        try:
            while self.client.now() < end_s:
                self.step()
        except KeyboardInterrupt:
            print("stopped; the figures are of the time so far", file=sys.stderr)

    def step(self) -> None:
        """One command or one of the things that are due, and a pause."""
        chance = self.random
        due = {name for name, due_s in self._next.items() if self.client.now() >= due_s}
        if "clock" in due:
            self._again("clock", CLOCK_S)
            self._note_clock()
        if "hello" in due:
            self._again("hello", HELLO_S)
            self.client.connect()
            self.count["hellos"] += 1
        if self.transport is None:
            self.ask(self._question())
        elif "recover" in due:
            self._recover()
            self._again("recover", RECOVER_S)
        elif "save" in due:
            self.ask(wire.Disarm())
            self.ask(wire.SaveConfig())
            self._again("save", SAVE_S)
        else:
            self._at_random()
        if chance.random() < 0.7:
            self.client.poll(chance.choice((0.005, 0.02, 0.1)))
        self.client.events.clear()  # a full inbox acknowledges nothing

    def _again(self, name: str, after_s: float) -> None:
        self._next[name] = self.client.now() + after_s

    def _at_random(self) -> None:
        chance = self.random
        pick = chance.random()
        if pick < 0.35:
            self.ask(self._question())
        elif pick < 0.65:
            self.ask(self._order())
        elif pick < 0.85:
            self.ask(self._junk())
        elif pick < 0.97:
            self._set()
        else:
            self._break_something()

    def _question(self) -> wire.Command[wire.Message]:
        chance = self.random
        questions: list[wire.Command[wire.Message]] = [
            wire.GetStatus(),
            wire.GetSensor(chance.randrange(10)),
            wire.GetParameter(chance.randrange(wire.PARAMETER_COUNT)),
            wire.GetMap(
                chance.randrange(3),
                chance.randrange(2),
                chance.choice(list(wire.Branch)),
            ),
            wire.GetSnapshot(chance.choice((*range(10), 255))),
            wire.GetLinkStats(),
        ]
        return chance.choice(questions)

    def _side(self) -> int:
        return self.random.randrange(2)

    def _branch(self) -> wire.Branch:
        return self.random.choice(list(wire.Branch))

    def _order(self) -> wire.Command[wire.Message]:
        """A sensible one, whether or not its time is right."""
        chance = self.random
        cpsi, cpsi_2 = chance.randrange(200, 1851), chance.choice((0, chance.randrange(1851)))
        sides = chance.choice(((cpsi, 0), (0, cpsi)))
        length = round(1e4 * chance.uniform(45.0, 53.0))
        assert self.transport is not None
        true_um = round(1e4 * self.transport.lockstep.plant.length_cm)
        orders: list[tuple[int, wire.Command[wire.Message]]] = [
            (6, wire.Sweep(tuple(chance.sample((cpsi, cpsi_2), 2)), chance.randrange(1000, 6000),
                           chance.randrange(1, 3), chance.randrange(2))),
            (5, wire.SetPressure(sides, chance.choice((0, 300, 3000)))),
            (2, wire.SetPressure((0, 0), 0)),
            (5, wire.GrowTo(length, chance.choice((0, 5000, 25000)))),
            (3, wire.RetractTo(length, chance.choice((0, 5000, 25000)))),
            (1, wire.Home()),
            (3, wire.Vent()),
            (1, wire.Disarm()),
            (2, wire.Arm()),
            (2, wire.ZeroSensors(chance.choice((0x3FF, 0x021, chance.randrange(1, 0x400))))),
            (1, wire.ConfirmLength(max(true_um, 0), chance.randrange(2))),
            (1, wire.SelectZone(chance.choice((0, 1, 2, 255)))),
            (1, wire.ClearFaults(chance.randrange(ALL_FAULTS + 1))),
        ]  # fmt: skip
        weights, commands = zip(*orders, strict=True)
        return chance.choices(commands, weights)[0]

    def _junk(self) -> wire.Command[wire.Message]:
        """Bytes without meaning: in a command's size, in another, or under an unknown number."""
        chance = self.random
        command = chance.choice(COMMANDS)
        size = command.SIZE
        if chance.random() < 0.3:
            size = chance.randrange(80)
        number, reply = command.ID, command.REPLY
        if chance.random() < 0.2:
            used_numbers = [*wire.MESSAGES]
            number = chance.choice([n for n in range(1, 256) if n not in used_numbers])
            reply = wire.Ack
        if command is wire.LoadDefaults and size == 0:
            self.board_parameters = [row.defaults[i - row.index] for i, row in ELEMENTS.items()]
        payload = chance.randbytes(size)
        if command is wire.SetParameter and number == command.ID and size == command.SIZE:
            # Never a valid row by accident: what the board holds is kept count of.
            payload = (wire.PARAMETER_COUNT + chance.randrange(1000)).to_bytes(2, "little")
            payload += chance.randbytes(4)
        return RAW[reply](number, payload)

    def _set(self) -> None:
        """A parameter anywhere in its range, or a map."""
        chance = self.random
        if chance.random() < 0.2:
            values = tuple(chance.randrange(-9000, 9000) for _ in range(11))
            self.ask(wire.SetMap(chance.randrange(3), self._side(), self._branch(), values))
            return
        index = chance.randrange(wire.PARAMETER_COUNT)
        row = ELEMENTS[index]
        low = 5 if index == TELEMETRY_MS else row.low  # what the line and the loop are made for
        value = chance.choice((low, row.high, chance.randint(low, row.high)))
        if chance.random() < 0.1:
            value = chance.choice((row.low - 1, row.high + 1))
        if self.ask(wire.SetParameter(index, value)) is not None:
            self.board_parameters[index] = value
            self.ask(wire.ApplyParameters())

    def _break_something(self) -> None:
        chance, transport = self.random, self.transport
        assert transport is not None
        fault = FaultTable.model_validate(
            {
                "kind": chance.choice(FAULTS),
                "at_s": transport.now(),
                "duration_s": chance.uniform(0.1, 2.0),
                "side": chance.choice(("left", "right")),
                "sensor": chance.randrange(5),
            }
        )
        transport.lockstep.faults.inject(fault)
        self.count["things broken"] += 1

    def _recover(self) -> None:
        """Back to an armed, zeroed robot with its own configuration, as far as that goes."""
        transport = self.transport
        assert transport is not None
        self.ask(wire.Disarm())
        self.client.poll(2.5)
        for _ in range(10):
            status = self.ask(wire.GetStatus())
            if isinstance(status, wire.StatusReport):
                vented = status.conditions & wire.Condition.VENTED.mask
                if vented:
                    break
            self.client.poll(0.5)
        for index, (value, target) in enumerate(
            zip(self.board_parameters, self.target_parameters, strict=True)
        ):
            if value != target and self.ask(wire.SetParameter(index, target)) is not None:
                self.board_parameters[index] = target
        self.ask(wire.ApplyParameters())
        self.client.poll(0.2)
        previous = self.ask(wire.GetStatus())
        left = self.ask(wire.ClearFaults(ALL_FAULTS))
        if isinstance(previous, wire.StatusReport) and isinstance(left, wire.Ack):
            self.count["faults cleared"] += (previous.faults & ~left.detail).bit_count()
        length_um = max(round(1e4 * transport.lockstep.plant.length_cm), 0)
        self.ask(wire.ConfirmLength(min(length_um, 530000), 1))
        self.ask(wire.SelectZone(self.random.randrange(3)))
        self.ask(wire.Arm())
        if self.random.random() < 0.5:
            self.client.poll(4.5)  # two windows of drift
        status = self.ask(wire.GetStatus())
        if isinstance(status, wire.StatusReport):
            self.ask(wire.ZeroSensors(status.settled_mask or 1))
            self.client.poll(2.5)
            self.count["recoveries"] += 1

    def _note_clock(self) -> None:
        """How far the map of the board's clock to the host's is off the host's clock, us."""
        if self._rig is not None and self.client.clock.synchronised:
            mapped_s = self.client.clock.to_host(self._rig.now_us)
            self._clock.append((self.client.now() - mapped_s) * 1e6)

    # --- what came of it ------------------------------------------------------------------------
    def figures(self) -> list[Figure]:
        """Figures, with the promises as limits."""
        stats, client = self.client.stats, self.client
        board = client.request(wire.GetLinkStats())
        figures = [
            Figure("commands sent", self.count["sent"], ""),
            Figure("commands replied", self.count["replied"], ""),
            Figure("commands refused, as they should be", self.count["refused"], ""),
            Figure("commands lost", stats.timeouts, "", 0),
            Figure("commands repeated (that answer at once)", self.count["repeated"], "", 0),
            Figure("reply, worst (of those)", self.latency_ms, "ms", 20),
            Figure("telemetry frames", stats.telemetry, ""),
            Figure("telemetry frames given up for events", board.tx_dropped, "",
                   None if client.hello.board is wire.BoardKind.VIRTUAL else 0),
            Figure("telemetry frames lost", max(stats.telemetry_lost - board.tx_dropped, 0), "", 0),
            Figure("bytes lost or damaged", board.rx_overruns + board.rx_bad + stats.bad_frames,
                   "", 0),
            Figure("unexpected resets", self.count["restarts"], "", 0),
            Figure("faults raised", sum(self.raised.values()), ""),
            Figure("kinds of fault raised", len(self.raised), ""),
            Figure("faults cleared", self.count["faults cleared"], ""),
        ]  # fmt: skip
        if self._clock:
            settled = self._clock[len(self._clock) // 10 :]
            # One reading is as good as the bridge's latency is steady: a drift is of many.
            window = max(len(settled) // 5, 1)
            drift = statistics.fmean(settled[-window:]) - statistics.fmean(settled[:window])
            figures += [
                Figure("clock map, drift", abs(drift), "us", 500),
                Figure("clock map, spread", max(settled) - min(settled), "us", 1000),
            ]
        return figures


def simulated(board: str, seed: int, hours: float) -> list[Figure]:
    """The soak on a simulated board."""
    rig = SoakRig(seed) if board == "mega-sim" else None
    depth = painted_stack(rig) if rig else None
    static = static_ram() if rig else 0  # now: an hour later the image may be another
    used: EmulatedBoard = rig or VirtualBoard(seed)
    transport = EmulatorTransport(scene(pegs=True), used, seed=seed)
    client = Client(transport)
    soak = Soak(client, seed, transport)
    boots = used.boots  # type: ignore[attr-defined]
    if rig:
        rig.forget()  # starting, the firmware reads its store without pause
    soak.run(WARM_UP_S)
    early = depth() if depth else 0
    soak.run(max(hours * 3600 - WARM_UP_S, 0))
    figures = [Figure("robot time", round(transport.now() / 3600, 3), "h"), *soak.figures()]
    restarted = used.boots - boots  # type: ignore[attr-defined]
    figures.append(Figure("restarts of the firmware", restarted, "", 0))
    if rig and depth:
        stack = depth()
        figures += [
            Figure("RAM with the stack, after a minute", static + early, "byte"),
            Figure("RAM with the stack, at the end", static + stack, "byte", 0.75 * RAM),
            Figure("EEPROM bytes written", rig.chip.eeprom_writes, ""),
        ]
        figures += [
            Figure(name, 100 * rig.worst[name] / (width * CYCLES_PER_MS), "%", 50)
            for name, width in WORST.items()
        ]
    return figures


def together(runs: Sequence[list[Figure]]) -> list[Figure]:
    """The figures of several seeds: counts and times added up, the worst of everything else."""
    totals = []
    for of_seeds in zip(*runs, strict=True):
        values = [figure.value for figure in of_seeds]
        added = of_seeds[0].unit in ("", "h")
        totals.append(replace(of_seeds[0], value=sum(values) if added else max(values)))
    return totals


def over_a_cable(url: str, seed: int, hours: float) -> list[Figure]:
    """The soak of a real board: questions only, for it must not move."""
    with Client(open_transport(url)) as client:
        soak = Soak(client, seed)
        began = client.now()
        soak.run(hours * 3600)
        elapsed = (client.now() - began) / 3600
        return [Figure("time", round(elapsed, 3), "h"), *soak.figures()]


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=0.1, help="of robot time; default 0.1")
    parser.add_argument("--seed", type=int, default=1, help="the first; default 1")
    parser.add_argument("--seeds", type=int, default=9, help="how many; default 9")
    parser.add_argument("--board", choices=("mega-sim", "virtual"), default="mega-sim")
    parser.add_argument("--connect", metavar="PORT", help="a real board: questions only")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    # A shell that starts it in the background has interrupts ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if options.seeds < 1:
        parser.error(f"--seeds {options.seeds} is no run; give 1 or more")
    if options.hours <= 0:
        parser.error(f"--hours {options.hours:g} is no time; give more than 0")
    if options.connect:
        figures = over_a_cable(options.connect, options.seed, options.hours)
    else:
        seeds = range(options.seed, options.seed + options.seeds)
        figures = together([simulated(options.board, seed, options.hours) for seed in seeds])
    if options.json:
        print(json.dumps({f.name: f.row for f in figures}, indent=2))
    else:
        for f in figures:
            print(f.line)
    return 0 if all(f.within_limit for f in figures) else 1


if __name__ == "__main__":
    sys.exit(main())
