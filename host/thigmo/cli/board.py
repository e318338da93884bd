"""`thigmo stop`, `thigmo clear`, `thigmo retract`, `thigmo params`: single commands to a board."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from thigmo.cli import signals
from thigmo.cli.dead_man_switch import ByPageOption, dead_man_switch, shown
from thigmo.cli.output import (
    JsonOption,
    RobotOption,
    SentConfigOption,
    print_json,
    robot_option,
    show,
)


def stop(
    robot: Annotated[
        str | None,
        robot_option("Its address, such as /dev/ttyACM0; if omitted, every robot in use."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Stop a robot at once, whatever program drives it; `thigmo clear` ends the stop.

    The command ends with status 0 only if the robot's board has confirmed the stop.
    """
    from thigmo.errors import LinkError
    from thigmo.robot.stopping import failure, nobody, stop_all, stop_robot, way_to

    try:
        robots = stop_all() if robot is None else stop_robot(robot)
    except KeyboardInterrupt:
        warning = "thigmo: NOT confirmed: interrupted before the board confirmed; "
        typer.echo(f"{warning}use the emergency stop", err=True)
        raise typer.Exit(signals.status()) from None
    if not robots:
        way_out = "stop the one that does with Ctrl-C"
        unused = nobody() if robot is None else LinkError(way_to(robot)[1], way_out)
        raise LinkError(f"NOT stopped: {failure(unused)}")
    failed = [result for result in robots if result.failure]
    stopped = [result for result in robots if not result.failure]
    show(
        as_json,
        {
            "stopped": [result.robot for result in stopped],
            "robots": [asdict(result) for result in robots],
        },
        *(
            f"Stopped: {result.robot}, confirmed by {result.confirmed_by}.{_next(result.robot)}"
            for result in stopped
        ),
    )
    for result in failed:
        prefix = f"{result.robot}: " if robot is None else ""  # which else has been given
        typer.echo(f"thigmo: NOT stopped: {prefix}{result.failure}", err=True)
    if failed:
        raise typer.Exit(1)


def _next(url: str) -> str:
    """How a stop ends; an emulated robot ends with the program that runs it."""
    from thigmo.link.transport import emulated

    return "" if emulated(url) else f" `thigmo clear --robot {url}` ends the stop."


def params(
    robot: RobotOption,
    name: Annotated[str | None, typer.Argument(help="Name of one parameter.")] = None,
    value: Annotated[
        list[int] | None,
        typer.Argument(help="New value, or values, in the parameter's unit on the wire."),
    ] = None,
    save: Annotated[
        bool, typer.Option("--save", help="Store it in the board, so that it survives a power cut.")
    ] = False,
    load_defaults: Annotated[
        bool,
        typer.Option(
            "--load-defaults", help="First reset all parameters to their defaults, and store them."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Show all of the board's parameters, or show or set one."""
    from thigmo.robot import connect
    from thigmo.robot.configuration import check_name

    if name is not None:
        check_name(name)
    with connect(robot) as machine:
        if load_defaults:
            machine.load_defaults()
        if name is not None and value:
            machine.set_parameter(name, value)
        if save:
            machine.save()
        rows = machine.parameters
        names = [name] if name is not None else list(rows)
        values = {parameter_name: machine.parameter(parameter_name) for parameter_name in names}
        stored = machine.stored_configuration()
    if stored.generation and stored.remark:
        cure = f"`thigmo params --robot {robot} --save` stores all"
        typer.echo(f"thigmo: {stored.remark}; {cure}", err=True)
    if name is not None and value and not save:
        note = f"thigmo: {name} is not stored and ends with this connection; keep it with --save"
        typer.echo(note, err=True)
    if as_json:
        facts = {}
        for parameter_name, held in values.items():
            entry = rows[parameter_name]
            facts[parameter_name] = {
                "value": held if entry.count > 1 else held[0],
                "unit": entry.unit,
                "range": [entry.low, entry.high],
                "default": entry.defaults if entry.count > 1 else entry.defaults[0],
                "doc": entry.doc,
            }
        print_json(facts)
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None)
    # In 80 columns as well: a name stays whole, for it is copied, and all else takes more lines.
    table.add_column("parameter", no_wrap=True)
    table.add_column("value", max_width=15)
    table.add_column("range", max_width=14)
    table.add_column("meaning")
    for parameter_name, held in values.items():
        entry = rows[parameter_name]
        same = held[:1] if len(set(held)) == 1 and len(held) > 1 else held
        shown = " ".join(map(str, same)) + (f" (x{len(held)})" if same is not held else "")
        table.add_row(parameter_name, shown, f"{entry.low}.. {entry.high} {entry.unit}", entry.doc)
    Console().print(table)


def clear(robot: RobotOption, by_page: ByPageOption = False, as_json: JsonOption = False) -> None:
    """End a stop, clear faults whose cause is gone, and list those that remain."""
    from thigmo.link.protocol import Fault
    from thigmo.robot import connect

    stopped = Fault.STOPPED.key
    with connect(robot) as machine:
        latched = machine.status().faults
        # A page that shows the robot as stopped sees it cleared, whoever clears it.
        with shown(machine, "clear", by_page or stopped in latched):
            machine.clear_stop()  # the operator's word: who types this command has looked
            remaining = machine.clear_faults()
            cleared = [fault for fault in latched if fault not in remaining]
            faults = ", ".join(fault for fault in cleared if fault != stopped)
            outcome = f"Cleared: {faults}." if faults else "No fault was cleared."
            if stopped in cleared:
                outcome = f"The stop has ended. {outcome}" if faults else "The stop has ended."
            show(
                as_json,
                {"cleared": cleared, "remaining": list(remaining)},
                outcome if latched else "No fault is latched.",
            )
            machine.raise_faults()


def retract(
    robot: RobotOption,
    kept_cm: Annotated[
        float, typer.Option("--to", help="Everted length to keep, cm.", min=0.0)
    ] = 0.0,
    length: Annotated[
        float | None,
        typer.Option(
            help="Measured everted length, cm; needed only if the board does not know it."
        ),
    ] = None,
    config: SentConfigOption = None,
    by_page: ByPageOption = False,
    as_json: JsonOption = False,
) -> None:
    """Vent the muscles, wait until they are below 0.5 psi (a bent body buckles), and wind in."""
    from thigmo.cli.console import Console
    from thigmo.config import RobotConfig
    from thigmo.robot import connect

    console = Console(quiet=as_json)
    with connect(robot, operator=console) as machine, dead_man_switch(machine, "retract", by_page):
        if config is not None:
            machine.configure(RobotConfig.load(config))
        elif machine.known_config is not None:
            machine.configure(machine.known_config)
        if length is not None:
            machine.confirm_length(length)
        else:
            machine.known_length_cm()
        machine.arm()
        retraction = machine.retract_to(kept_cm)
    show(as_json, asdict(retraction), retraction.words)
