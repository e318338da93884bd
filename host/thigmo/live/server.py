"""The page's server: what `thigmo watch` runs, in a process of its own.

It reads the run's stream (`watched`), passes it on to every page that looks (`viewer`), and takes
their stops, starts and pauses. It drives no robot: if it is killed, the run goes on.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import logging
import secrets
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from aiohttp import WSMsgType, web
from aiohttp.http_exceptions import HttpProcessingError

from thigmo.config import RobotConfig
from thigmo.errors import ThigmoError
from thigmo.link.protocol import Fault
from thigmo.link.transport import emulated, open_transport
from thigmo.live import page_data
from thigmo.live.guard import add_headers, guard
from thigmo.live.page_data import PastRun, board, body, pegs, row_text, thinned
from thigmo.live.page_request import PageRequest, parse
from thigmo.live.past_runs import PastRuns
from thigmo.live.relay import Target, Watched
from thigmo.live.starting import Parameter, Started, exploration
from thigmo.live.stop_http import Stop, StopHttp
from thigmo.live.viewer import Viewer
from thigmo.operator_prompts import Simulated
from thigmo.robot import JOG_CM
from thigmo.robot.stopping import Stopped, WayTo
from thigmo.stream import RETAINED, BodyShape, Event, Hello, Message, RunState, Telemetry
from thigmo.stream.recorded import wiring_in
from thigmo.wiring import Wiring

PAGE = Path(__file__).parent / "page"
PORT = 8421
_MOST_VIEWERS = 16
_LOOK_S = 2.0  # between two looks at which runs there are
_TICK_S = 0.03
_PULSE_S = 0.25  # the page calls its connection lost after six of them
_MOST_ROWS_A_TICK = 40  # an emulator at full speed makes more than a chart has pixels for
_MOST_SHAPES_A_TICK = 4
_HISTORY_S = 0.02  # between the rows that a page gets which comes later
_HISTORY_ROWS = 6000
_LEAVES_S = 60.0


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """What to watch, and for whom."""

    past: Path | None = None  # folder of a finished run to look back at; no other is watched
    # of a robot, if its runs only are to be watched; Start runs an exploration there
    url: str | None = None
    config: Path | None = None  # robot.toml of that robot
    runs: Path = Path("runs")  # folder of the runs that the page lists
    # what a robot's efforts, or a budget of robot time in s, are expected to take and to give
    expect: Callable[[RobotConfig, float | None], list[dict[str, Any]]] | None = None
    explore: tuple[str, ...] = ()  # further arguments of the exploration that Start runs
    parameters: tuple[Parameter, ...] = ()  # further ones that the operator may give on the page
    host: str = "127.0.0.1"  # address to listen at
    port: int | None = None  # None takes the usual one, or any that is free
    leaves: bool = False  # end when nothing runs and nobody looks any more


class _Run:
    """What is known of the run that is looked at, which is nothing of the one before."""

    def __init__(self, hello: Hello | None) -> None:
        folder = hello.folder if hello else ""
        self.hello = hello  # None before the first run
        self.motion: Hello | None = None  # that the page started after it, on the same robot
        self.over = asyncio.Event()
        self.pausing = False
        self.body = body(wiring_in(folder))
        self.length_cm: float | None = None  # everted before the run, where it is known
        self.pegs: list[dict[str, float]] = []
        # What a page that comes later has missed.
        self.held: dict[str, str] = {}
        self.events: deque[str] = deque(maxlen=500)
        self.history: deque[str] = deque(maxlen=_HISTORY_ROWS)
        self.history_s = float("-inf")
        self.board = ""
        self.read_s = float("-inf")  # when the last reading came

    @property
    def moving(self) -> Hello | None:
        """The run, or the motion after it, while it is under way."""
        return None if self.over.is_set() else self.motion or self.hello


class _Latch:
    """Whether the robot is stopped, by its board's word alone: its echo of a stop, its readings and
    its answer to `clear`."""

    def __init__(self) -> None:
        self.since_s: float | None = None  # UTC; None: it is not stopped
        self.by = ""  # who stopped it; empty if no page of this server
        self._confirmed_s = float("-inf")  # readings from before say nothing of it

    def confirm(self, at_s: float, by: str) -> None:
        """The board has echoed a stop that was pressed at a time."""
        self.since_s, self.by, self._confirmed_s = at_s, by, time.time()

    def read(self, reading: Telemetry, *, clears: bool) -> None:
        """Take a reading; `clears` if one without the fault may be of a board that was cleared."""
        if Fault.STOPPED.key in reading.faults:
            if self.since_s is None:
                self.since_s, self.by = reading.epoch_s, ""
        elif clears and reading.epoch_s > self._confirmed_s:
            self.clear()

    def clear(self) -> None:
        """The stop has ended."""
        self.since_s, self.by = None, ""


class PageServer:
    """Serves the page. Raises RunFolderError if there is no such finished run."""

    def __init__(self, options: WatchOptions) -> None:
        self.options = options
        self.token = secrets.token_urlsafe(16)
        self._watched = Watched(options.url) if options.past is None else None
        self._viewers: set[Viewer] = set()
        self._operator: Viewer | None = None  # the page that asked for something first
        self._run = _Run(None)
        past = options.past
        self._past = PastRun(past) if past else None
        self._past_runs = PastRuns(past.resolve().parent if past else options.runs)
        if past:
            self._past_runs.include(past.resolve())
        self._config = RobotConfig()
        self._started: Started | None = None  # the last command
        self._way: tuple[WayTo, str] = ("none", "")
        self._last_stop: dict[str, Any] | None = None  # it stays shown, whatever runs next
        self._latch = _Latch()
        self._choices: list[Hello] = []  # runs that could be looked at
        self._left_s = time.monotonic()  # when somebody last looked

    # The application.

    def application(self) -> web.Application:
        """The aiohttp application."""
        app = web.Application(middlewares=[guard(self.token)])
        app.on_response_prepare.append(add_headers)
        app.router.add_get("/", self._index)
        app.router.add_get("/stream", self._stream)
        app.router.add_get("/parameters.json", self._parameters)
        app.router.add_get("/efforts.json", self._efforts)
        app.router.add_routes(self._past_runs.routes())
        app.router.add_static("/", PAGE)
        app.cleanup_ctx.append(self._work)
        return app

    async def _index(self, request: web.Request) -> web.FileResponse:
        return web.FileResponse(PAGE / "index.html")

    async def _parameters(self, request: web.Request) -> web.Response:
        return web.json_response([asdict(parameter) for parameter in self.options.parameters])

    async def _efforts(self, request: web.Request) -> web.Response:
        """What each effort, or a budget of robot time, is expected to take and to give."""
        if self.options.expect is None:
            return web.json_response([])
        try:
            time_s = float(request.query["time"]) if request.query.get("time") else None
        except ValueError:
            return web.json_response({"problem": "A budget is a number of seconds."})
        try:
            return web.json_response(self.options.expect(self._config, time_s))
        except ThigmoError as error:
            return web.json_response({"problem": str(error)})

    async def _work(self, app: web.Application) -> AsyncIterator[None]:
        await asyncio.to_thread(self._look_ahead)
        tasks = [asyncio.create_task(self._pump()), asyncio.create_task(self._pulse())]
        if self._watched is not None:
            tasks.append(asyncio.create_task(self._look_around(self._watched)))
            tasks.append(asyncio.create_task(self._look_for_way()))
        yield
        for task in tasks:
            task.cancel()
        for viewer in list(self._viewers):
            await viewer.socket.close(code=1001)
        if self._watched is not None:
            await asyncio.to_thread(self._watched.close)
        if self._started is not None and self._started.runs:
            await asyncio.to_thread(self._started.end)

    def _look_ahead(self) -> None:
        """What is known of the robot, and of an emulated one's room, before the first run."""
        url, config, run = self.options.url, self.options.config, self._run
        if config is not None:
            self._know_robot(RobotConfig.load(config))
        if url is None or url.partition("://")[0] != "emulator":
            return
        with contextlib.suppress(ThigmoError):  # Start tells what is wrong with the scene
            room = open_transport(url)
            with contextlib.closing(room):
                if isinstance(room, Simulated):
                    known = room.truth()
                    if config is None:
                        self._know_robot(room.config)
                    run.length_cm = float(known.length_cm)
                    run.pegs = [
                        {"x_cm": peg.x, "y_cm": peg.y, "radius_cm": peg.radius}
                        for peg in known.pegs
                    ]

    def _know_robot(self, config: RobotConfig) -> None:
        """Show a robot's body before its first run."""
        self._config = config
        self._run.body = body(Wiring.laid_out(config))

    # From the run to the pages.

    async def _pump(self) -> None:
        while self._watched is not None:
            said: list[Message] = []  # of one run
            for message in self._watched.take():
                if isinstance(message, Hello):
                    self._begin(message)
                elif message is not None:
                    said.append(message)
                else:
                    self._pass_on(said)
                    said = []
                    self._run.over.set()
                    self._tell()
            self._pass_on(said)
            await asyncio.sleep(_TICK_S)

    def _begin(self, run: Hello) -> None:
        """Another run is under way, or a motion after the one that is shown, which stays shown."""
        started = self._started
        if started is not None and started.pid == run.pid:
            started.spoke = True
        if started is not None and started.on_robot and started.pid == run.pid and self._run.hello:
            self._run.motion = run
            self._run.over.clear()
            self._tell()
            return
        self._run = _Run(run)
        if run.folder:
            self._past_runs.include(Path(run.folder))
        if run.virtual:
            self._latch = _Latch()  # it was another board's
        if self._started is not None and not self._started.runs:
            self._started = None  # it was another one, and so was its failure
        for viewer in self._viewers:
            viewer.forget()
        self._tell()

    def _pass_on(self, messages: list[Message]) -> None:
        readings = [item for item in messages if isinstance(item, Telemetry)]
        if readings:
            self._pass_readings(readings)
        if any(isinstance(item, RunState) and item.outcome != "running" for item in messages):
            self._tell()  # of a stop, before the run says that it has ended
        shapes = [item for item in messages if isinstance(item, BodyShape)]
        others = [item for item in messages if not isinstance(item, Telemetry | BodyShape)]
        for message in [*shapes[thinned(len(shapes), _MOST_SHAPES_A_TICK)], *others]:
            if isinstance(message, RunState) and message.paused:
                self._run.pausing = False
            channel, text = message.CHANNEL, page_data.text(message).decode()
            if channel in RETAINED:
                self._run.held[channel] = text
            elif isinstance(message, Event):
                self._run.events.append(text)
            for viewer in self._viewers:
                viewer.add(channel, text)

    def _pass_readings(self, readings: list[Telemetry]) -> None:
        kept = readings[thinned(len(readings), _MOST_ROWS_A_TICK)]
        rows, run = [row_text(shown) for shown in kept], self._run
        for reading, row in zip(kept, rows, strict=True):
            if not 0 <= reading.t_s - run.history_s < _HISTORY_S:
                run.history.append(row)
                run.history_s = reading.t_s
        last = kept[-1]
        run.read_s = time.monotonic()
        lasts = run.moving is not None and not run.moving.virtual
        self._latch.read(last, clears=lasts)
        run.board = f'"epoch_s":{last.epoch_s!r},"board":{json.dumps(board(last))}'
        for viewer in self._viewers:
            viewer.add_rows(rows, run.board)

    async def _pulse(self) -> None:
        """Tell every page four times a second how things are; also that the server is there."""
        while True:
            if self._viewers:
                self._left_s = time.monotonic()
            run = self._run
            if run.moving is not None and run.hello is not None:
                run.pegs = await asyncio.to_thread(pegs, run.hello.folder)
            started, watched = self._started, self._watched
            in_vain = started.pid if started is not None and not started.runs else None
            if watched is not None and in_vain is not None and watched.chosen == in_vain:
                watched.choose(None)
            if started is not None and started.name == "clear" and started.said():
                self._latch.clear()  # the board's answer, where its readings were not seen
            self._tell()
            await asyncio.sleep(_PULSE_S)

    async def _look_around(self, watched: Watched) -> None:
        """See which runs there are, now and then: one that hangs keeps this waiting for seconds."""
        while True:
            self._choices = await asyncio.to_thread(watched.runs)
            await asyncio.sleep(_LOOK_S)

    async def _look_for_way(self) -> None:
        """See how a stop would reach the robot. A name service that hangs keeps this waiting."""
        while True:
            self._way = await asyncio.to_thread(self._target.way)
            await asyncio.sleep(_PULSE_S)

    @property
    def _target(self) -> Target:
        run = self._run
        return Target.of(
            self.options.url, run.moving or run.hello, under_way=run.moving is not None
        )

    def _tell(self) -> None:
        for viewer in self._viewers:
            viewer.add("page", json.dumps(self._page(viewer)))

    def _page(self, viewer: Viewer) -> dict[str, Any]:
        if self._past is not None:
            return {"channel": "page", "mode": "record", "stop": "none", **self._past.page()}
        run, url = self._run, self.options.url
        heard_s = self._watched.heard_s if self._watched else 0.0
        return {
            "channel": "page",
            "mode": "live" if run.hello else "idle",
            "run": _run_facts(run.hello) if run.hello else None,
            "ended": run.over.is_set(),
            "body": run.body,
            "truth": run.pegs,
            "length_cm": run.length_cm,
            "start": {"url": url, "virtual": emulated(url)} if url else None,
            "starting": self._starting,
            "busy": self._busy,
            "started": self._started_facts(),
            "robot": self._port,
            "jog_cm": JOG_CM,
            "latched": self._latch.since_s is not None,
            "stopped": {"at_s": self._latch.since_s, "by": self._latch.by},
            "age_s": round(time.monotonic() - run.read_s, 1) if run.board else None,
            "pausing": run.pausing,
            "operates": self._operator in (None, viewer),
            "viewers": len(self._viewers),
            "stop": self._way[0],
            "stop_why_not": self._way[1],
            "stop_robot": self._target.url,
            "last_stop": self._last_stop,
            "choices": [
                {"pid": choice.pid, "name": choice.name, "url": choice.url, "folder": choice.folder}
                for choice in self._choices
            ],
            "shown": run.moving.pid if run.moving else None,
            "silent_s": round(time.monotonic() - heard_s, 1),
        }

    @property
    def _busy(self) -> bool:
        """A command that was started is before its stream or after it: it has the robot's port."""
        started = self._started
        return started is not None and started.runs and self._run.moving is None

    @property
    def _starting(self) -> bool:
        """A command was started and has not spoken yet."""
        return self._busy and self._started is not None and not self._started.spoke

    def _started_facts(self) -> dict[str, Any] | None:
        """What became of the last command that a page started."""
        if (started := self._started) is None:
            return None
        return {
            "name": started.name, "runs": started.runs, "held": started.held,
            "said": started.said(), "failure": started.failure(),
        }  # fmt: skip

    @property
    def _port(self) -> str | None:
        """Where the robot is that can be cleared and moved while nothing runs.

        One that is emulated inside its run has gone with it.
        """
        run, url = self._run.hello, self.options.url
        if run is not None and not run.virtual:
            return run.url
        return url if url and not emulated(url) else None

    # Requests of the pages.

    async def _stream(self, request: web.Request) -> web.WebSocketResponse:
        if len(self._viewers) >= _MOST_VIEWERS:
            raise web.HTTPServiceUnavailable(text=f"{_MOST_VIEWERS} pages look already.")
        socket = web.WebSocketResponse(heartbeat=10.0, compress=False, max_msg_size=4096)
        viewer = Viewer(socket)
        self._viewers.add(viewer)  # it counts from now on
        sender: asyncio.Task[None] | None = None
        try:
            await socket.prepare(request)
            viewer.add("page", json.dumps(self._page(viewer)))
            self._give_past(viewer)
            sender = asyncio.create_task(viewer.send_on())
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    await self._obey(viewer, message.data)
        finally:
            if sender is not None:
                sender.cancel()
            self._viewers.remove(viewer)
            if self._operator is viewer:
                self._operator = None
                if self._started is not None:
                    self._started.let_go()
            self._tell()
        return socket

    def _give_past(self, viewer: Viewer) -> None:
        """What a page that comes later has missed."""
        run = self._run
        for channel, text in run.held.items():
            viewer.add(channel, text)
        for text in run.events:
            viewer.add(Event.CHANNEL, text)
        if run.history:
            viewer.add_rows(run.history, run.board, most=_HISTORY_ROWS)

    async def _obey(self, viewer: Viewer, text: str) -> None:
        if (request := parse(text)) is None:
            return
        command = request.command
        if self._operator is None and command not in (None, "hold"):
            self._operator = viewer
        operates = viewer is self._operator
        if request.ack is not None:
            viewer.acknowledged()
        elif command == "choose" and operates and self._watched is not None:
            if any(run.pid == request.pid for run in self._choices):
                self._watched.choose(request.pid)
        elif command == "hold" and operates and self._started is not None:
            self._started.hold()
            return
        elif command in ("start", "clear", "retract", "jog") and operates:
            if self._run.moving is None and not self._busy:
                await self._start(command, request)
        elif command in ("pause", "resume", "answer") and operates and self._watched is not None:
            with contextlib.suppress(ThigmoError):  # the run has just ended, which the page sees
                self._watched.send(command, request.text)
                self._run.pausing = command == "pause"
        if command:
            self._tell()

    async def _start(
        self, command: Literal["start", "clear", "retract", "jog"], request: PageRequest
    ) -> None:
        """Start an exploration, or what finishes the job of one that has ended."""
        url, port = self.options.url, self._port
        if command == "start" and url is not None:
            options = (*self.options.explore, *self._chosen(request.parameters))
            started = await asyncio.to_thread(exploration, url, options, realtime=request.realtime)
        elif command != "start" and port is not None:
            if (arguments := _motion(command, request)) is None:
                return  # this page sends all of them
            started = await asyncio.to_thread(Started, command, "--robot", port, *arguments)
        else:
            return
        self._started = started
        if self._watched is not None:
            self._watched.choose(started.pid)

    def _chosen(self, values: Mapping[str, str | float]) -> list[str]:
        """Options of the exploration that the operator gave on the page."""
        offered = (parameter.flag for parameter in self.options.parameters)
        return [f"{flag}={values[flag]}" for flag in offered if values.get(flag)]

    def stop(self, peer: str) -> dict[str, Any]:
        """Stop the robot for a computer at an address, from any thread, and wait for the board.

        What the page gets of it: each robot, and who has confirmed or why nobody has.
        """
        at_s, target = time.time(), self._target
        starting = self._started if self._starting else None
        robots = self._watched.stop(target) if self._watched else []
        if starting is not None:
            starting.end()  # it would move the robot after the stop
            if any(robot.failure for robot in robots) and self._watched:
                robots = self._watched.stop(target)  # it had the port
            ended = Stopped(str(target.url), f"the end of `thigmo {starting.name}` as it began")
            robots = robots or [ended]
        stopped = [robot.robot for robot in robots if not robot.failure]
        failed = "; ".join(f"{robot.robot}: {robot.failure}" for robot in robots if robot.failure)
        outcome = {
            "at_s": at_s, "stopped": stopped, "failed": failed,
            "robots": [asdict(robot) for robot in robots],
        }  # fmt: skip
        if stopped:
            self._latch.confirm(at_s, _named(peer))
        if robots:
            self._last_stop = {**outcome, "by": _named(peer)}
        return outcome

    def deserted(self) -> bool:
        """Whether nothing runs and nobody has looked for a while."""
        return self._run.moving is None and time.monotonic() - self._left_s > _LEAVES_S


def _motion(command: Literal["clear", "retract", "jog"], request: PageRequest) -> list[str] | None:
    """Arguments of a command that finishes the job; None if the request lacks some."""
    match command, request:
        case "clear", _:
            return []
        case "jog", PageRequest(way=str(way), cm=float(cm)):
            return [f"--{way}", f"{cm:g}"]
        case "retract", PageRequest(to=float(to), length=float(length)):
            return ["--to", f"{to:g}", "--length", f"{length:g}"]
    return None


def _named(peer: str) -> str:
    """Who is at an address."""
    return "this computer" if peer in ("127.0.0.1", "::1") else peer


def _run_facts(run: Hello) -> dict[str, Any]:
    facts = {name: getattr(run, name) for name in ("name", "url", "folder", "t_s", "virtual")}
    return {"id": f"{run.pid} {run.epoch_s}", **facts}


async def serve(options: WatchOptions, announce: Callable[[str], None]) -> None:
    """Serve the page until cancelled; `announce` is called with its address, once it can be opened.

    Raises RunFolderError if there is no such finished run, and ThigmoError if the address cannot be
    listened at.
    """
    server = PageServer(options)
    runner = web.AppRunner(
        server.application(), access_log=None, shutdown_timeout=1.0, logger=_REQUESTS
    )
    await runner.setup()
    assert runner.server is not None
    try:
        with _door(runner.server, server.stop, options) as door:
            announce(f"http://{_reached_at(options.host)}:{door.port}/?token={server.token}")
            while not (options.leaves and server.deserted()):
                await asyncio.sleep(1.0)
    finally:
        await runner.cleanup()


def _door(server: web.Server, stop: Stop, options: WatchOptions) -> StopHttp:
    ports = (PORT, 0) if options.port is None else (options.port,)
    for port in ports:
        try:
            return StopHttp((options.host, port), server, stop)
        except OSError as error:
            if error.errno != errno.EADDRINUSE or port == ports[-1]:
                raise ThigmoError(
                    f"cannot serve the page at {options.host}: {error.strerror}",
                    "choose another place with --host or --port",
                ) from error
    raise AssertionError("unreachable")


def _reached_at(host: str) -> str:
    """Where the page is opened: of all of this machine's addresses, the one that others reach."""
    if host in ("0.0.0.0", "::"):
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family, socket.SOCK_DGRAM) as asked:
            try:
                # Sends nothing, but chooses an address to send from (one for documentation).
                asked.connect(("2001:db8::1" if ":" in host else "192.0.2.1", 9))
                host = str(asked.getsockname()[0])
            except OSError:  # no network
                host = "localhost"
    return f"[{host}]" if ":" in host else host


def _of_the_server(record: logging.LogRecord) -> bool:
    """Whether a line of the log is of something that failed here: strangers' requests are not."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError)


_REQUESTS = logging.getLogger("thigmo.live.requests")
_REQUESTS.addFilter(_of_the_server)
