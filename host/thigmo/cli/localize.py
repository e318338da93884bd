"""`thigmo localize`: contacts from a CSV of readings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thigmo.cli.output import JsonOption, MethodOption, print_json

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from thigmo.localization import LocalizeResult
    from thigmo.mechanics.elastica import Floats
    from thigmo.record import FramesTable, ReadingsTable

# Readings to try the command on.
EXAMPLE = Path(__file__).parents[1] / "record" / "example.csv"


def localize(
    file: Annotated[
        Path,
        typer.Argument(
            help="CSV with columns position and curvature, and optionally span and (in space) "
            "angle_deg, around the body. `-` is the standard input; `example` is a file "
            "to try the command on."
        ),
    ],
    length: Annotated[float, typer.Option(help="Length of the body, in the CSV's length unit.")],
    span: Annotated[
        float, typer.Option(help="Active length of the sensors, if there is no column span.")
    ] = 0.0,
    free_curvature: Annotated[
        float | None,
        typer.Option(
            "--free-curvature",
            help="Curvature that the muscles alone give; 0 without any. If omitted, a body that "
            "bends by itself is weighed, too.",
        ),
    ] = None,
    noise: Annotated[
        float | None, typer.Option(help="Standard deviation of a reading; estimated if omitted.")
    ] = None,
    gain_error: Annotated[
        float | None, typer.Option(help="Relative standard deviation of each sensor's gain.")
    ] = None,
    offset_error: Annotated[
        float | None, typer.Option(help="Standard deviation of an offset that all readings share.")
    ] = None,
    map_error: Annotated[
        float | None,
        typer.Option(help="Relative standard deviation of the free curvature's scale."),
    ] = None,
    base_fold_error: Annotated[
        float | None,
        typer.Option(help="Standard deviation of the angle of a small fold at the base, rad."),
    ] = None,
    noise_correlation: Annotated[
        float | None, typer.Option(help="Correlation of neighbouring sensors' noise.")
    ] = None,
    critical_curvature: Annotated[
        float | None, typer.Option(help="Contact moment over EI at which the base folds.")
    ] = None,
    tube_radius: Annotated[
        float | None, typer.Option(help="Radius of the body; 1.75/53 of the length if omitted.")
    ] = None,
    held_end: Annotated[
        str | None,
        typer.Option(help="Whether something holds the end: yes, no, or the prior odds of that."),
    ] = None,
    end_face_odds: Annotated[
        float | None,
        typer.Option(help="Prior odds of a contact on the end's face; 0 rules it out."),
    ] = None,
    stiffness: Annotated[
        str | None,
        typer.Option(
            help="EI, in N times the length's unit squared, and its relative error: 500,0.1. "
            "Forces are then in newtons."
        ),
    ] = None,
    twist: Annotated[
        float | None, typer.Option(help="In space: ratio of bending to torsional stiffness, EI/GJ.")
    ] = None,
    weight: Annotated[
        str | None,
        typer.Option(
            help="In space: weight per length over EI, along the base, towards angle 0 and "
            "towards 90: 0,-0.5,0."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="Calibrated robot.toml, which has all these errors; other options override it."
        ),
    ] = None,
    muscle: Annotated[
        str | None,
        typer.Option("--muscle", "--side", help="Inflated muscle, by its name in --config."),
    ] = None,
    contacts: Annotated[str, typer.Option(help='"auto", or a number of contacts.')] = "auto",
    method: MethodOption = None,
    columns: Annotated[
        str | None,
        typer.Option(
            help="For a file with a frame in each row: its columns, and the positions of their "
            "sensors, k0=5,k1=15; in space also their angles, k0=5@0,k1=5@90. Prints CSV with "
            "a row for each contact, and for each frame without one. A column t_s is copied."
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="File for a figure of the posterior along the body; with --columns, of the "
            "answers over time."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say where a body is touched, from curvature readings along it."""
    import numpy as np

    import thigmo
    from thigmo.errors import DataError
    from thigmo.record import ReadingsTable, read_frames, read_readings

    if not length > 0 or length == float("inf"):
        raise DataError(f"--length is {length:g}", "give the body's length, above 0")
    if contacts != "auto" and not contacts.isdecimal():
        raise DataError(f"--contacts is {contacts!r}", "give `auto` or a number")
    if muscle is not None and config is None:
        raise DataError("--muscle needs the robot's file", "give --config robot.toml")
    if file == Path("example") and not file.exists():
        file = EXAMPLE
    named = {} if columns is None else _frames(columns)
    places = {name: place for name, (place, _) in named.items()}
    frames = None if columns is None else read_frames(file, places)
    if frames is None:
        table = read_readings(file)
    else:  # the sensors are the same in every row
        angles = [angle for _, angle in named.values() if angle is not None]
        if len(angles) not in (0, len(named)):
            raise DataError(
                "--columns has angles for some sensors", "give NAME=POSITION@DEGREES for all"
            )
        table = ReadingsTable(
            frames.position, frames.curvature[0], None, frames.lines[:1],
            np.deg2rad(angles) if angles else None, remarks=frames.remarks,
        )  # fmt: skip
    if table.strain is not None and config is None:
        raise DataError("the readings are strains", "give the robot's file: --config robot.toml")
    stated: dict[str, Any] = {}
    if config is not None:
        stated, table, rest = _calibrated(config, muscle, table, length)
        if rest.any():  # the readings are those since the zeros, at rest
            stated["body_curvature"] = rest + (free_curvature or 0.0)
    flags = {
        "noise": noise,
        "gain_error": gain_error,
        "offset_error": offset_error,
        "map_error": map_error,
        "base_fold_error": base_fold_error,
        "noise_correlation": noise_correlation,
        "critical_curvature": critical_curvature,
        "tube_radius": tube_radius,
        "held_end": _held(held_end),
        "end_face_odds": end_face_odds,
        "stiffness": _numbers(stiffness, "--stiffness", "EI,ERROR such as 500,0.1"),
        "twist": twist,
        "weight": _numbers(weight, "--weight", "three numbers, such as 0,-0.5,0"),
        "angle": table.angle,
    }
    stated |= {name: value for name, value in flags.items() if value is not None}
    if noise is not None:
        stated["zero_error"] = 0.0  # --noise is all of a reading's error
    stated |= {
        "span": span if table.span is None else table.span,
        "free_curvature": free_curvature,
        "contacts": "auto" if contacts == "auto" else int(contacts),
        "method": method or "posterior",
    }
    for remark in table.remarks:
        typer.echo(f"thigmo: {remark}", err=True)
    if frames is not None:
        _answer_rows(frames, plot, length, as_json, stated)
        return
    from thigmo.cli.hints import hints

    stated["length"] = length
    result = thigmo.localize(table.curvature, table.position, **stated)
    if plot is not None:
        _save(result.plot(), plot)
    looks = hints(result, table.curvature, table.position, **stated)
    if as_json:
        print_json(_facts(result, table) | {"hints": looks})
    else:
        _show(result, table)
        for hint in looks:
            typer.echo(f"thigmo: {hint}", err=True)


def _held(text: str | None) -> bool | float | None:
    """`yes`, `no` or odds."""
    from thigmo.errors import DataError

    if text in ("yes", "no"):
        return text == "yes"
    try:
        return None if text is None else float(text)
    except ValueError as error:
        raise DataError(f"--held-end is {text!r}", "give yes, no, or odds such as 0.1") from error


def _numbers(text: str | None, option: str, such_as: str) -> tuple[float, ...] | None:
    """Numbers with commas between them."""
    from thigmo.errors import DataError

    try:
        return None if text is None else tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise DataError(f"{option} is {text!r}", f"give {such_as}") from error


def _calibrated(
    path: Path, muscle: str | None, table: ReadingsTable, length_cm: float
) -> tuple[dict[str, Any], ReadingsTable, Floats]:
    """The errors of robot.toml, reading by reading: each is that of the sensor at its place.

    With them the table, in which a fibre's strains are curvatures, and the curvature (n,) of the
    body at rest at each reading.
    """
    import numpy as np

    from thigmo.config import RobotConfig, Sensor
    from thigmo.errors import DataError
    from thigmo.mechanics import rest_mean
    from thigmo.reading_errors import errors_of

    robot = RobotConfig.load(path)
    inflated = None
    if muscle is not None:
        pressed = robot.muscles[robot.muscle_number(muscle)]
        if (inflated := pressed.side) is None:
            raise DataError(f"{muscle} bends the body out of the plane", "leave --muscle out")
    # Flex sensors on the inflated side wrinkle and are not read.
    free = [s for s in robot.sensors if s.side and not (s.wrinkles and s.side == inflated)]
    sensors: list[Sensor] = []
    for position in table.position.tolist():
        near = min(free, key=lambda sensor: abs(sensor.center_cm - position), default=None)
        if near is None or abs(near.center_cm - position) > max(near.span_cm / 2, 0.5):
            raise DataError(
                f"{path} has no sensor for the reading at {position:g} cm",
                "give each position once, in cm, and --muscle if a muscle is inflated",
            )
        free.remove(near)
        sensors.append(near)
    body_pressure = robot.body.pressure_number(length_cm)
    if table.strain is not None:
        if any(sensor.on_board for sensor in sensors):
            raise DataError(
                "strains, but not only of a fibre", f"correct {path}, or give curvatures"
            )
        pairs = zip(sensors, table.strain.tolist(), strict=True)
        bends = [sensor.reading(strain_ue) for sensor, strain_ue in pairs]
        table = replace(table, curvature=np.array(bends))
    rest = rest_mean(robot.body.rest_pieces, table.position, [sensor.span_cm for sensor in sensors])
    return errors_of(robot, inflated, body_pressure, sensors).arguments(), table, rest


def _facts(result: LocalizeResult, table: ReadingsTable) -> dict[str, Any]:
    return result.to_dict() | {
        "discarded": [
            {"line": table.lines[reading], "position": float(table.position[reading])}
            for reading in result.discarded
        ]
    }


def _frames(columns: str) -> dict[str, tuple[float, float | None]]:
    """Columns by name, with the positions of their sensors, and their angles in degrees."""
    from thigmo.errors import DataError

    stated = {}
    for part in columns.split(","):
        name, _, place = part.rpartition("=")
        arc, _, angle = place.partition("@")
        try:
            stated[name.strip()] = float(arc), float(angle) if angle else None
        except ValueError:
            name = ""
        if not name.strip():
            raise DataError(
                f"--columns has {part!r}", "give NAME=POSITION for each sensor: k0=5,k1=15"
            )
    return stated


def _answer_rows(
    table: FramesTable, plot: Path | None, length: float, as_json: bool, options: dict[str, Any]
) -> None:
    """One answer for each frame, and a figure over time."""
    import numpy as np

    import thigmo
    from thigmo.errors import DataError

    free, shape = options.pop("free_curvature"), options.pop("body_curvature", None)
    localizer = thigmo.Localizer.of(position=table.position, length=length, **options)
    results: list[LocalizeResult | None] = []  # None: no sensor was read
    for line, row in zip(table.lines, table.curvature, strict=True):
        try:
            unread = np.isnan(row).all()
            results.append(
                None
                if unread
                else localizer.localize(row, free_curvature=free, body_curvature=shape)
            )
        except DataError as error:
            raise DataError(f"line {line}: {error.problem}", error.next_step) from error
    times = table.time_s.tolist() if table.time_s is not None else [None] * len(results)
    if plot is not None:
        from thigmo.display.bars import Bar
        from thigmo.display.series import draw_series

        moments = table.lines if table.time_s is None else table.time_s.tolist()
        label = "line of the file" if table.time_s is None else "time (s)"
        bars = [
            [Bar(contact.arc, contact.intervals, contact.status, "") for contact in result.contacts]
            if result
            else []
            for result in results
        ]
        _save(draw_series(moments, bars, localizer.length, label), plot)
    frames = list(zip(table.lines, times, results, strict=True))
    if as_json:
        unread_answer = {"status": "no reading", "contacts": []}
        print_json([
            {"line": line, "t_s": time, **(result.to_dict() if result else unread_answer)}
            for line, time, result in frames
        ])  # fmt: skip
        return
    newtons = "stiffness" in options
    head = "line,t_s,status,contacts,arc,low,high,force,probability"
    typer.echo(head + (",newtons,newtons_low,newtons_high" if newtons else ""))
    for line, time, result in frames:
        status, contacts = (result.status, result.contacts) if result else ("no reading", [])
        head = f"{line},{'' if time is None else f'{time:.9g}'},{status}"
        if not contacts:
            typer.echo(f"{head},0,,,,," + ",,," * newtons)
        for number, contact in enumerate(contacts, start=1):
            values = [contact.arc, *contact.interval, contact.force, contact.probability]
            if contact.newtons is not None:
                values += [contact.newtons.across.value, *contact.newtons.across.interval]
            cells = ("" if value != value else f"{value:.6g}" for value in values)
            typer.echo(f"{head},{number},{','.join(cells)}")


def _save(axes: Axes, path: Path) -> None:
    """Write the figure of these axes. Raises DataError if it cannot be written."""
    from thigmo.errors import DataError

    figure = axes.get_figure(root=True)
    if figure is None:
        raise AssertionError("axes without a figure")
    try:
        with DataError.from_os(f"cannot write {path}", "choose another folder"):
            figure.savefig(path)
    except ValueError as error:  # matplotlib names the formats that it knows
        raise DataError(f"cannot write {path}: {error}", "end its name in .png or .svg") from error


def _show(result: LocalizeResult, table: ReadingsTable) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(f"[bold]{result.status}[/bold] ({result.hypothesis})")
    if result.contacts:
        force = "force / EI" if result.contacts[0].newtons is None else "force, 95 % interval"
        rows = Table("arc", force, "95 % interval", "probability", "status", box=None)
        if in_space := any(contact.vector for contact in result.contacts):
            rows.add_column("vector")
        for contact in result.contacts:
            vector = " ".join(f"{part:.3g}" for part in contact.vector or ())
            rows.add_row(
                f"{contact.arc:.4g}", contact.force_text, contact.interval_text,
                contact.probability_text, contact.status, *([vector] * in_space),
            )  # fmt: skip
        console.print(rows)
    for reading in result.discarded:
        console.print(
            f"taken for bad: line {table.lines[reading]}, the sensor at {table.position[reading]:g}"
        )
    console.print(result.message)
