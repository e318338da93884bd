"""`thigmo flash --robot PORT`: the firmware onto an Arduino Mega 2560 or a Raspberry Pi Pico."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from thigmo.cli.output import JsonOption, robot_option, show


def flash(
    robot: Annotated[
        str,
        robot_option(
            "Serial port of a Mega, such as /dev/ttyACM0; or `pico`, or the folder of a Pico's "
            "drive."
        ),
    ],
    image: Annotated[
        Path | None,
        typer.Option(help="Image (.hex, .uf2); if omitted, the one that comes with thigmo."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write the firmware, verify it, and wait until the board says hello.

    Plug a Pico in with BOOTSEL pressed. `--robot pico` finds its drive RPI-RP2; the Pico starts by
    itself once the image is written.
    """
    from thigmo.link import flash as flasher
    from thigmo.link import pico

    def tell(doing: str) -> None:
        if not as_json:
            typer.echo(doing, err=True)

    if robot == pico.PICO or Path(robot).is_dir():
        written = pico.flash_pico(robot, image)
        size = len(written.program)
        show(
            as_json,
            {"image": str(written.path), "bytes": size},
            f"{size} bytes are written: the Pico starts. Connect its serial cable and see who"
            " answers with `thigmo info --robot PORT`",
        )
        return
    done = flasher.flash(robot, image, tell=tell)
    version = ".".join(map(str, done.hello.firmware_version))
    kept = f"{done.stored.kept} stored parameters are kept" if done.stored.generation else ""
    facts = {
        "port": robot,
        "image": str(done.image.path),
        "bytes": len(done.image.program),
        "firmware": version,
        "schema_hash": f"{done.hello.schema_hash:08x}",
        "reset_cause": done.hello.reset_cause.name.lower(),
        "stored": asdict(done.stored),
    }
    runs = f"firmware {version} ({len(done.image.program)} bytes) runs on {robot}"
    show(as_json, facts, *filter(None, (runs, kept, done.stored.remark)))
