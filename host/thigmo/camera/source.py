"""Sources of pictures: a live camera, a video, stills, or a function (the emulator's room).

Each gives one picture at a time and keeps at most one in memory.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from thigmo.camera.exceptions import PictureError
from thigmo.camera.model import Picture

_STILLS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
_WARM_UP = 5  # pictures that a webcam needs to settle its exposure


@dataclass(frozen=True)
class PictureSource:
    """Anything that yields pictures."""

    # The newest (live) or next (recorded) picture, (h, w, 3) BGR; PictureError if there is none.
    read: Callable[[], Picture]
    close: Callable[[], None] = lambda: None  # lets go of the device or file
    live: bool = False  # whether a picture shows the present


def _stills(paths: Sequence[Path]) -> PictureSource:
    """Picture files, in that order."""
    remaining = iter(paths)

    def read() -> Picture:
        path = next(remaining, None)
        if path is None:
            used_up = f"all {len(paths)} stills have been used"
            raise PictureError(used_up, "add the missing pictures")
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if picture is None:
            raise PictureError(f"{path} is not a readable picture", "check the file")
        return np.asarray(picture, np.uint8)

    return PictureSource(read)


def _capture(device: int | str) -> PictureSource:
    """A live camera or a video file, through OpenCV."""
    live = isinstance(device, int)
    name = f"camera {device}" if live else device
    # Failures are reported below, in one line.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    capture = cv2.VideoCapture(device)
    if not capture.isOpened():
        raise PictureError(
            f"{name} cannot be opened",
            "check the cable and that no other program uses it" if live
            else "check the path and the video's format",
        )  # fmt: skip
    if live:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, 1920)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, 1080)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        for _ in range(_WARM_UP):
            capture.grab()

    def read() -> Picture:
        if live:
            # A driver may buffer an old picture: drop it.
            capture.grab()
        good, picture = capture.read()
        if not good or picture is None:
            raise PictureError(
                f"{name} gives no {'picture' if live else 'further picture'}",
                "check the cable" if live else "the video has ended; record a longer one",
            )
        return np.asarray(picture, np.uint8)

    return PictureSource(read, capture.release, live)


def open_source(where: str | os.PathLike[str]) -> PictureSource:
    """A source by name: `0` or `camera:0` (live), a video file, a still, or a folder of stills.

    Raises PictureError if there is nothing readable.
    """
    text = os.fspath(where)
    number = text.removeprefix("camera:")
    if number.isdigit():
        return _capture(int(number))
    path = Path(text)
    if path.is_dir():
        stills = sorted(p for p in path.iterdir() if p.suffix.lower() in _STILLS)
        if not stills:
            raise PictureError(f"{path} holds no pictures", f"put {', '.join(_STILLS)} files there")
        return _stills(stills)
    if not path.exists():
        raise PictureError(
            f"{path} does not exist", "give a picture, a folder, a video, or camera:0"
        )
    return _stills([path]) if path.suffix.lower() in _STILLS else _capture(text)
