"""`thigmo replay`, `info` and `export`: what runs leave behind, and what a board reports."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from thigmo.cli.output import (
    JsonOption,
    method_option,
    print_json,
    robot_option,
    show,
    visible,
)

_OF_THE_RUN = ("name", "url", "started", "thigmo", "outcome")
# In a record's metadata; the rest is the board's.
_OF_THE_HOST = ("thigmo", "url", "seed", "started", "protocol", "effort")


def replay(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    method: Annotated[
        str | None, method_option("Default: the method of the run.", explores=True)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Localize a run's contacts again from its raw record; write replay.json and its maps."""
    from thigmo.exploration import replay as again

    result = again(run, method=method)
    lines = [f"{run}: {result.missing}"] if result.missing else []
    lines += [
        f"{contact.status}: {contact.arc_cm:.1f} cm of {contact.everted_length_cm:.1f} cm "
        f"({contact.interval_text}), x {contact.x_cm:.1f} cm, y {contact.y_cm:.1f} cm"
        for contact in result.document.contacts
    ]
    if not result.document.contacts:
        lines.append("no contact in what remains" if result.missing else "no contact")
    lines.append(f"{result.sweeps} sweeps; {run / 'replay.json'}")
    show(as_json, result.to_dict(), *lines)


def info(
    run: Annotated[Path | None, typer.Argument(help="Run folder.")] = None,
    robot: Annotated[
        str | None,
        robot_option("Address of a robot, instead of a run: /dev/ttyACM0, emulator://SCENE."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Describe a run folder, or a robot."""
    from thigmo.errors import DataError

    if (run is None) == (robot is None):
        raise DataError("info describes a run or a robot", "give a run folder, or --robot URL")
    facts = _robot_info(robot) if robot is not None else _run_info(Path(run or "."))
    if as_json:
        print_json(facts)
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")  # addresses and paths are copied: none is cut
    for name, value in facts.items():
        rows = value.items() if isinstance(value, dict) else [("", value)]
        for part, single in rows:
            label = f"{name} {part}".strip().replace("_", " ")
            table.add_row(*(Text(visible(text)) for text in (label, _shown(single))))
    Console().print(table)


def export(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    csv: Annotated[
        Path | None, typer.Option(help="Folder for CSV files, one for each channel.")
    ] = None,
    parquet: Annotated[
        Path | None, typer.Option(help="Folder for the same tables as Parquet files.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a run's telemetry, events, states, posteriors, contacts and shapes as tables."""
    from thigmo.errors import DataError
    from thigmo.stream.recorded import export_csv, export_parquet

    if csv is None and parquet is None:
        raise DataError("no folder is named", "give --csv FOLDER or --parquet FOLDER")
    files = [] if csv is None else export_csv(run, csv)
    files += [] if parquet is None else export_parquet(run, parquet)
    show(as_json, {"files": [str(file) for file in files]}, *files)


def _shown(value: Any) -> str:
    """A fact for people: numbers rounded, lists on one line."""
    if isinstance(value, list | tuple):
        return ", ".join(map(_shown, value)) or "none"
    if value is None:
        return "unknown"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _run_info(path: Path) -> dict[str, Any]:
    from thigmo.errors import RunFolderError
    from thigmo.record import RunFolder

    folder = RunFolder(path)
    facts: dict[str, Any] = {"run": str(path)}
    try:
        document = folder.read_document()
        facts |= {
            **{each: getattr(document, each) for each in _OF_THE_RUN},
            "stages_cm": [stage.everted_length_cm for stage in document.stages],
            "contacts": len(document.contacts),
            "length_cm": document.length_cm,
            "robot_time_s": document.robot_time_s,
            "wall_time_s": document.wall_time_s,
        }
    except RunFolderError as error:
        facts["document"] = str(error)
    log = folder.read_log()
    if log.missing:
        facts["missing"] = log.missing
    times = [entry.t_s for entry in log.entries]
    return facts | {
        "frames": len(log.entries),
        "frames_sent": sum(entry.direction == "tx" for entry in log.entries),
        "recorded_s": round(max(times) - min(times), 3) if times else 0.0,
        "truncated": log.truncated,
        "gaps": log.gaps,
        "record": {key: value for key, value in log.metadata.items() if key in _OF_THE_HOST},
        "board": {key: value for key, value in log.metadata.items() if key not in _OF_THE_HOST},
    }


def _robot_info(url: str) -> dict[str, Any]:
    from thigmo.robot import connect, in_mask

    with connect(url) as robot:
        status = asdict(robot.status())
        status["conditions"] = sorted(status["conditions"])
        for mask in ("everted", "settled", "zeroed"):
            status[mask] = in_mask(status[mask])
        return {"url": url, **robot.identity, **status, "link": robot.link_stats()}
