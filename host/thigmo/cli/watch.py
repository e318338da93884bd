"""`thigmo watch`: the page on which a run is seen, and can be stopped."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thigmo.cli import signals
from thigmo.cli.output import named

if TYPE_CHECKING:
    from thigmo.config import RobotConfig
    from thigmo.live.starting import Parameter

# On the page, and in `thigmo explore`.
_PARAMETERS = {
    "effort": "effort", "time": "time_s", "name": "name", "protocol": "protocol",
    "method": "method", "map of the room": "prior", "resume": "resume", "seed": "seed",
}  # fmt: skip


def watch(
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN|URL",
            callback=named,
            help="Folder of a finished run, or address of a robot, which the button Start then "
            "explores with. If omitted: the run that is under way, or the next one.",
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="Address to serve at. With 0.0.0.0, phones and other machines can open "
                     "the page, at an address that is printed, also as a QR code."),
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(help="Port to serve at; 0 takes any free one.", min=0, max=65535),
    ] = None,
    browser: Annotated[bool, typer.Option(help="Open a browser.")] = True,
    config: Annotated[
        Path | None, typer.Option(help="robot.toml for the explorations that Start begins.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for these runs.")] = Path("runs"),
    foxglove: Annotated[
        bool,
        typer.Option("--foxglove", help="Serve the run to Foxglove as well (thigmo\\[foxglove])."),
    ] = False,
    foxglove_port: Annotated[
        int, typer.Option(help="Port for Foxglove; 0 takes any free one.", min=0, max=65535)
    ] = 8765,
    leave: Annotated[
        bool, typer.Option("--leave", hidden=True)  # for `explore --watch`: ends when deserted
    ] = False,
) -> None:  # fmt: skip
    """Show a run in the browser (the robot in its room, signals, contacts), with a Stop button."""
    import asyncio

    from thigmo.errors import DataError
    from thigmo.extras import require

    require("live", "the page")
    from thigmo.live.server import WatchOptions, serve
    from thigmo.live.starting import explore_options

    past = finished_run(target)
    if past is not None and foxglove:
        raise DataError(
            f"--foxglove serves runs that are under way, and {past} has ended",
            f"open {past / 'run.mcap'} in Foxglove as a local file",
        )
    url = None if past else target
    exploring = explore_options(out, config)
    options = WatchOptions(
        past, url, config, out, expected_efforts, exploring, parameters(), host, port, leave
    )

    def announce(address: str) -> None:
        typer.echo(f"The page is at {address} (Ctrl-C ends the page).", err=True)
        if host not in ("127.0.0.1", "::1", "localhost"):
            _draw_code(address)
        if browser:
            _open_browser(afterwards, address)

    async def until_interrupted() -> None:
        loop, serving = asyncio.get_running_loop(), asyncio.ensure_future(serve(options, announce))
        signals.call(lambda: loop.call_soon_threadsafe(serving.cancel))
        try:
            with suppress(asyncio.CancelledError):
                await serving
        finally:
            signals.be_ready()

    with ExitStack() as afterwards:
        if foxglove:
            afterwards.enter_context(_foxglove(url, foxglove_port))
        try:
            asyncio.run(until_interrupted())
        except KeyboardInterrupt:
            raise typer.Exit from None


def expected_efforts(config: RobotConfig, time_s: float | None) -> list[dict[str, Any]]:
    """Expected time and accuracy of each effort, or of a budget of robot time (s)."""
    from thigmo.exploration import expectations

    return [asdict(expected) for expected in expectations(config, time_s)]


def parameters() -> tuple[Parameter, ...]:
    """Options of `thigmo explore` that an operator changes on the page, with the command's help."""
    from inspect import signature
    from typing import get_args

    from thigmo.cli.explore import explore
    from thigmo.live.starting import Parameter

    taken = signature(explore, eval_str=True).parameters
    kinds_found = []
    for label, name in _PARAMETERS.items():
        kind, option = get_args(taken[name].annotation)
        # typer has a first flag where a default would be.
        flag = option.default if isinstance(option.default, str) else f"--{name}"
        kinds = get_args(kind)
        choices = tuple(choice for value_kind in kinds for choice in get_args(value_kind))
        number = bool({int, float} & {*kinds})
        kinds_found.append(Parameter(flag, label, option.help or "", choices, number))
    return tuple(kinds_found)


def finished_run(target: str | None) -> Path | None:
    """The folder of a finished run; None if the target is a robot's address or a run under way.

    Raises RunFolderError if there is no such folder and no such port.
    """
    from thigmo.errors import RunFolderError

    if target is None or "://" in target or re.fullmatch(r"COM\d+", target):
        return None
    if not Path(target).exists():
        raise RunFolderError(f"no such run folder or port: {target}", "check its path")
    return Path(target) if Path(target).is_dir() else None


@contextmanager
def _foxglove(url: str | None, port: int) -> Iterator[None]:
    """Serve runs to Foxglove, from a thread beside the page."""
    import threading

    from thigmo.extras import require
    from thigmo.live.relay import Relay, Watched

    require("foxglove", "Foxglove")
    from thigmo.live.foxglove import FoxgloveServer

    relay = Relay(Watched(url))
    with closing(relay), FoxgloveServer(relay.stop, port) as server:
        typer.echo(f"For Foxglove, open {server.address}.", err=True)
        thread = threading.Thread(target=relay.run, args=(server,))
        thread.start()
        try:
            yield
        finally:
            relay.close()
            thread.join()


def _draw_code(address: str) -> None:
    import io

    import segno

    drawn = io.StringIO()
    segno.make(address, error="l").terminal(drawn, compact=True)
    typer.echo(drawn.getvalue(), err=True)


def _open_browser(afterwards: ExitStack, address: str) -> None:
    """Open the page in a browser, if there is one, from a process of its own: some never return.

    The file that leads to the page is removed when `afterwards` closes.
    """
    import subprocess

    from thigmo.live.opening_file import OpeningFile

    try:
        leads = afterwards.enter_context(OpeningFile(address))
    except OSError as error:
        reason = f"cannot write a file that leads to the page: {error.strerror}"
        typer.echo(f"No browser is opened ({reason}). Open the address above.", err=True)
        return
    subprocess.Popen(
        [sys.executable, "-m", "webbrowser", leads.url],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
