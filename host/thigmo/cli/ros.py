"""`thigmo ros`: runs on ROS 2."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thigmo.cli.output import named
from thigmo.errors import DataError

if TYPE_CHECKING:
    from thigmo.live.relay import Relay
    from thigmo.live.ros import RosNode


def ros(
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN|URL",
            callback=named,
            help="A run folder (its map is published) or the address of a robot. If omitted: "
            "the run that is under way, or the next one.",
        ),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of the topics.")] = "thigmo",
    frame: Annotated[
        str,
        typer.Option(
            help="Frame of the map; its origin is the robot's base. Give thigmo_base if a "
            "transform of your own places the robot."
        ),
    ] = "map",
    domain: Annotated[
        int, typer.Option(envvar="ROS_DOMAIN_ID", help="ROS domain.", min=0, max=232)
    ] = 0,
    run: Annotated[
        int | None, typer.Option(help="Process id of the run to follow, if several are under way.")
    ] = None,
    interface: Annotated[
        str | None,
        typer.Option(help="Network interface, by name or address; this machine alone if omitted."),
    ] = None,
) -> None:
    """Publish maps, contacts and the body on ROS 2; a message to a topic stops the robot."""
    from thigmo.cli.watch import finished_run
    from thigmo.extras import require

    require("ros", "ROS 2")
    from thigmo.live.ros import RosNode

    past = finished_run(target)
    stop = threading.Event()
    with RosNode(
        stop.set, namespace=namespace, frame=frame, domain=domain, interface=interface
    ) as node:
        where = f"domain {domain}, {interface or 'this machine alone'}"
        typer.echo(f"ROS topics are under /{namespace} ({where}); Ctrl-C ends them.", err=True)
        try:
            if past is not None:
                _publish_folder(node, past)
                threading.Event().wait()
            else:
                _relay(node, target, run, stop)
        except KeyboardInterrupt:
            raise typer.Exit from None


def _publish_folder(node: RosNode, folder: Path) -> None:
    """Publish the map and contacts of a finished run, which listeners get whenever they come."""
    import time

    from thigmo.record import RunFolder, read_ros_map
    from thigmo.stream import Contacts, Grid

    now = time.time()
    document = RunFolder(folder).read_document()
    node.publish(Grid.of(read_ros_map(folder / "map.yaml"), 0.0, now))
    node.publish(Contacts(0.0, now, tuple(document.contacts)))


def _relay(node: RosNode, url: str | None, pid: int | None, stop: threading.Event) -> None:
    from thigmo.live.relay import Relay, Watched

    watched = Watched(url, pid)
    if pid is None and len(runs := watched.runs()) > 1:
        watched.close()
        listed = "; ".join(f"--run {run.pid}: {run.name} at {run.url}" for run in runs)
        raise DataError(f"{len(runs)} runs are under way", f"choose one: {listed}")
    relay = Relay(watched)
    # A stop waits for the board; neither DDS nor the messages may wait with it.
    threading.Thread(target=_obey, args=(relay, stop), daemon=True).start()
    try:
        relay.run(node)
    finally:
        relay.close()


def _obey(relay: Relay, stop: threading.Event) -> None:
    """Thread: stops, one after the other."""
    while True:
        stop.wait()
        stop.clear()
        typer.echo(f"Stop from ROS: {relay.stop()}", err=True)
