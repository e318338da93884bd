"""`thigmo runs`, `replay`, `info` and `export`: what runs leave behind, what a board reports."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thigmo.cli.output import (
    JsonOption,
    method_option,
    print_json,
    robot_option,
    show,
    visible,
)
from thigmo.contact_status import SAME_CONTACT_CM

if TYPE_CHECKING:
    from thigmo.record import MapContact, RunDocument

_OF_THE_RUN = ("name", "url", "started", "thigmo", "outcome")
# In a record's metadata; the rest is the board's.
_OF_THE_HOST = ("thigmo", "url", "seed", "started", "protocol", "effort")


def runs(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(help="A folder of runs (runs if omitted), or two run folders to compare."),
    ] = None,
    find: Annotated[
        str, typer.Option(help="Only runs with this text in folder, robot, outcome or effort.")
    ] = "",
    within: Annotated[
        float, typer.Option(help="Contacts of two runs that are farther apart are not one, cm.")
    ] = SAME_CONTACT_CM,
    as_json: JsonOption = False,
) -> None:
    """List the runs in a folder, or compare the contacts of two of them.

    `thigmo runs` lists what is in runs/, the oldest first.

    `thigmo runs --find "peg ahead"` lists those that stopped before a peg.

    `thigmo runs RUN RUN` puts the contacts of two runs beside each other.
    """
    from thigmo.errors import DataError
    from thigmo.record.listing import is_run

    given = folders or [Path("runs")]
    if len(given) == 2 and all(map(is_run, given)):
        _compare(given[0], given[1], within, as_json)
        return
    if len(given) != 1 or is_run(given[0]):
        raise DataError(
            "runs lists a folder of runs, or compares two",
            "give one folder of runs, or two run folders; `thigmo info RUN` describes one",
        )
    _list(given[0], find, as_json)


def _list(parent: Path, find: str, as_json: bool) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from thigmo.record.listing import list_runs

    listed = [run for run in list_runs(parent) if run.matches(find)]
    if as_json:
        print_json([
            {"run": str(run.path), "problem": run.problem}
            | ({} if run.document is None else _listed_facts(run.document))
            for run in listed
        ])  # fmt: skip
        return
    if not listed:
        typer.echo(f"no run{f' with {find!r}' * bool(find)} in {parent}")
        return
    table = Table("run", "effort", "outcome", "contacts", "time", "error", box=None)
    for run in listed:
        if (document := run.document) is None:
            table.add_row(*map(Text, (run.path.name, "", visible(run.problem), "", "", "")))
            continue
        error = "" if document.error_cm is None else f"{document.error_cm:.1f} cm"
        cells = (
            run.path.name, document.effort, document.outcome, str(len(document.contacts)),
            f"{document.robot_time_s:.0f} s", error,
        )  # fmt: skip
        table.add_row(*(Text(visible(cell)) for cell in cells))
    Console().print(table)


def _listed_facts(document: RunDocument) -> dict[str, Any]:
    names = ("name", "url", "started", "outcome", "effort", "method", "robot_time_s", "error_cm")
    return {name: getattr(document, name) for name in names} | {"contacts": len(document.contacts)}


def _compare(first: Path, second: Path, within_cm: float, as_json: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    from thigmo.record import RunFolder
    from thigmo.record.listing import compare_contacts

    documents = [RunFolder(path).read_document() for path in (first, second)]
    compared = compare_contacts(documents[0].contacts, documents[1].contacts, within_cm)
    if as_json:
        print_json({
            "runs": [{"run": str(path)} | _listed_facts(document)
                     for path, document in zip((first, second), documents, strict=True)],
            "contacts": [
                {"first": _place(pair.first), "second": _place(pair.second),
                 "distance_cm": pair.distance_cm}
                for pair in compared
            ],
        })  # fmt: skip
        return

    def shown(contact: MapContact | None) -> str:
        if contact is None:
            return "not found"
        return f"x {contact.x_cm:.1f}, y {contact.y_cm:.1f} cm, {contact.certainty_text}"

    for letter, path, document in zip("AB", (first, second), documents, strict=True):
        typer.echo(visible(
            f"{letter}: {path}, {document.effort}, {document.outcome}, "
            f"{document.robot_time_s:.0f} s"
        ))  # fmt: skip
    if not compared:
        typer.echo("neither has a contact")
        return
    table = Table("A", "B", "apart", box=None)
    for pair in compared:
        apart = "" if pair.distance_cm is None else f"{pair.distance_cm:.1f} cm"
        table.add_row(shown(pair.first), shown(pair.second), apart)
    Console().print(table)


def _place(contact: MapContact | None) -> dict[str, Any] | None:
    if contact is None:
        return None
    return {name: getattr(contact, name) for name in ("x_cm", "y_cm", "probability", "status")}


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
            **{name: getattr(document, name) for name in _OF_THE_RUN},
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
