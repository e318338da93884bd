"""`thigmo camera ...`: print the sheet, calibrate lens and place, and show what the camera sees."""

from __future__ import annotations

from contextlib import closing, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thigmo.cli.output import JsonOption, filled, show

if TYPE_CHECKING:
    from collections.abc import Iterator

    from thigmo.camera import Detection, Sheet
    from thigmo.camera.model import Picture

group = typer.Typer(
    help="Measure places to 0.3 cm with a webcam about 1 m above the table.\n\n"
    "1. `thigmo camera sheet` prints four cards, tip markers and a lens board, and writes "
    "sheet.toml, which says where the cards lie.\n\n"
    "2. `thigmo camera lens camera:0` (once for a camera): show the lens board in twelve poses. "
    "Instead, give the lens's height above the table in sheet.toml (camera_height_cm), or stand "
    "one card on a box (its z_cm).\n\n"
    "3. `thigmo camera locate camera:0` (again whenever the camera was touched) finds where it "
    "stands, and says how precisely that is known.\n\n"
    "4. `thigmo camera check camera:0` draws what it sees over the picture: look at check.png.\n\n"
    "Instead of camera:0, give a video, a picture or a folder of pictures.",
    no_args_is_help=True,
)

SourceArgument = Annotated[
    str, typer.Argument(help="camera:0, a video, a picture, or a folder of pictures.")
]
_LIVE_PICTURES = 12  # from a live camera, for the lens
_MOST_PICTURES = 200  # of a video or folder, for the lens
# In the folder in which the commands are run: where the cards lie, the lens, the camera's place.
SHEET_FILE, LENS_FILE, CAMERA_FILE = Path("sheet.toml"), Path("lens.json"), Path("camera.json")


@group.callback()
def _needs_camera() -> None:
    from thigmo.extras import require

    require("camera", "the camera")


def load_sheet(length_cm: float = 53.0) -> Sheet:
    """The sheet file; where none was made, the sheet of a robot of a length."""
    from thigmo.camera import Sheet

    return Sheet.load(SHEET_FILE) if SHEET_FILE.exists() else Sheet.of_length(length_cm)


@group.command()
def sheet(
    out: Annotated[Path, typer.Option(help="PDF, or PNG (a file for each page).")] = Path(
        "sheet.pdf"
    ),
    length: Annotated[
        float, typer.Option(help="Length of the robot, cm: the cards lie around its reach.", min=1)
    ] = 53.0,
) -> None:
    """Print the workspace cards, tip markers and lens board at true scale."""
    from thigmo.camera import print_sheet

    default_sheet = load_sheet(length)
    written = print_sheet(default_sheet, out)
    if not SHEET_FILE.exists():
        default_sheet.save(SHEET_FILE)
    for path in written:
        typer.echo(f"wrote {path}")
    next_steps = (
        "Print at 100 % and measure the 10 cm bar: its length over 10 is print_scale in "
        f"{SHEET_FILE}. Lay the cards' crosses where that file says (origin: the robot's base, "
        "x along the straight robot), or write where they lie. Then show the lens board "
        "(`thigmo camera lens`), or write the lens's height above the table (camera_height_cm), or "
        "stand one card on a box (its z_cm); then `thigmo camera locate`."
    )
    typer.echo(filled(next_steps))


def _one_picture(source: str | Path) -> Picture:
    from thigmo.camera import open_source

    with closing(open_source(source)) as opened:
        return opened.read()


def _keep_old(path: Path) -> None:
    """Set an earlier file aside as `.old`."""
    if path.exists():
        path.replace(path.with_name(f"{path.name}.old"))


@group.command()
def lens(
    source: SourceArgument,
    as_json: JsonOption = False,
) -> None:
    """Calibrate the lens from pictures of the lens board in several poses."""
    from thigmo.camera import PictureError, calibrate_lens, open_source

    shots: list[Picture] = []
    with closing(open_source(source)) as opened:
        if opened.live:
            for number in range(_LIVE_PICTURES):
                typer.prompt(
                    f"picture {number + 1} of {_LIVE_PICTURES}: hold the board in a new pose, "
                    "press Enter",
                    default="",
                    show_default=False,
                )
                shots.append(opened.read())
        else:
            with suppress(PictureError):
                while len(shots) < _MOST_PICTURES:
                    shots.append(opened.read())
    lens = calibrate_lens(shots, load_sheet())
    _keep_old(LENS_FILE)
    lens.save(LENS_FILE)
    facts = {"rms_px": lens.rms_px, "focal_px": lens.matrix[0][0], "file": str(LENS_FILE)}
    show(as_json, facts, f"lens good: {lens.rms_px:.2f} px remain; wrote {LENS_FILE}")


@group.command()
def locate(
    source: SourceArgument,
    as_json: JsonOption = False,
) -> None:
    """Find where the camera stands, from the workspace cards."""
    from thigmo.camera import Lens
    from thigmo.camera import locate as find
    from thigmo.camera.pose import GOOD_CM, what_helps

    picture = _one_picture(source)
    known = Lens.load(LENS_FILE) if LENS_FILE.exists() else None
    used = load_sheet()
    model = find(picture, used, known)
    _keep_old(CAMERA_FILE)
    model.save(CAMERA_FILE)
    advice = what_helps(model, used, known is not None)
    lines = [
        f"camera {model.eye_cm[2]:.1f} cm above the table; cards fit to {model.rms_px:.2f} px, "
        f"places to {model.accuracy_cm:.2f} cm (one sigma): {'poor' if advice else 'good'}; "
        f"wrote {CAMERA_FILE}"
    ]
    if advice:
        lines.append(f"for {GOOD_CM} cm or better: {advice}; then locate again")
    if model.hidden:
        lines.append(f"hidden cards: {', '.join(model.hidden)}")
    facts = {
        "rms_px": model.rms_px, "accuracy_cm": model.accuracy_cm,
        "height_cm": float(model.eye_cm[2]), "hidden": list(model.hidden),
        "good": not advice, "advice": advice, "file": str(CAMERA_FILE),
    }  # fmt: skip
    show(as_json, facts, *lines)


@group.command()
def check(
    source: SourceArgument,
    out: Annotated[
        Path, typer.Option(help="File for the picture with what was seen drawn on it.")
    ] = Path("check.png"),
    diameter: Annotated[float, typer.Option(help="Tube diameter, cm.")] = 3.5,
    length: Annotated[
        float | None,
        typer.Option(help="Everted length, cm, if known; an axis of another length is flagged."),
    ] = None,
    background: Annotated[
        Path | None, typer.Option(help="Picture of the empty table from the same camera.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show what the camera sees, drawn over the picture."""
    from thigmo.camera import CameraModel, DetectionRequest, detect, draw
    from thigmo.camera import locate as find
    from thigmo.camera.detection import write_picture

    picture = _one_picture(source)
    used = load_sheet()
    if CAMERA_FILE.exists():
        model = CameraModel.load(CAMERA_FILE)
    else:
        model = find(picture, used)
        if not as_json:
            typer.echo(f"no {CAMERA_FILE}: the camera is located from this very picture")
    wanted = DetectionRequest(diameter, length_cm=length)
    empty = None if background is None else _one_picture(background)
    detection = detect(picture, model, used, wanted, background=empty)
    write_picture(out, draw(picture, model, used, detection, wanted))
    show(as_json, {**_facts(detection), "picture": str(out)}, *_lines(detection), f"wrote {out}")


def _facts(detection: Detection) -> dict[str, Any]:
    tip, axis = detection.tip, detection.axis
    return {
        "tip": tip and {key: getattr(tip, key) for key in ("x_cm", "y_cm", "heading")},
        "axis": axis and {
            "length_cm": axis.length_cm,
            "mean_curvature": axis.curvature,
            "residual_cm": axis.residual_cm,
        },
        "obstacles": [asdict(obstacle) for obstacle in detection.obstacles],
        "hidden": list(detection.hidden),
        "problems": [str(problem) for problem in detection.problems],
    }  # fmt: skip


def _lines(detection: Detection) -> Iterator[str]:
    if detection.tip is not None:
        yield f"tip at x {detection.tip.x_cm:.2f}, y {detection.tip.y_cm:.2f} cm"
    if detection.axis is not None:
        length_cm, mean = detection.axis.length_cm, detection.axis.curvature
        yield f"body {length_cm:.1f} cm long, mean curvature {mean:+.5f} 1/cm"
    for o in detection.obstacles:
        yield f"obstacle at x {o.x_cm:.2f}, y {o.y_cm:.2f}, radius {o.radius_cm:.2f} cm"
    if detection.hidden:
        yield f"hidden cards: {', '.join(detection.hidden)}"
    yield from map(str, detection.problems)
