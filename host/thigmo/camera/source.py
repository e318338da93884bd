"""Where pictures come from: a live camera, a video, stills, or a function (the emulator's room).

All are iterated or asked for one picture at a time; none keeps more than one in memory.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from thigmo.camera.errors import PictureError
from thigmo.camera.model import Picture

_STILLS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
_WARM_UP = 5  # pictures that a webcam needs to settle its exposure


class PictureSource(ABC):
    """Anything that yields pictures."""

    @abstractmethod
    def read(self) -> Picture:
        """The newest (live) or next (recorded) picture, (h, w, 3) BGR.

        Raises:
            PictureError: there is none.
        """

    def close(self) -> None:  # noqa: B027 (most have nothing to let go of)
        """Let go of the device or file."""


class Stills(PictureSource):
    """Picture files in the order of their names (or as listed)."""

    def __init__(self, paths: list[Path]) -> None:
        self._count, self._left = len(paths), iter(paths)

    def read(self) -> Picture:
        """The next file's picture."""
        path = next(self._left, None)
        if path is None:
            raise PictureError(
                f"all {self._count} stills have been used", "add the missing pictures"
            )
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if picture is None:
            raise PictureError(f"{path} is not a readable picture", "check the file")
        return np.asarray(picture, np.uint8)


class Capture(PictureSource):
    """A live camera or a video file, through OpenCV."""

    def __init__(self, device: int | str) -> None:
        self._live = isinstance(device, int)
        self._name = f"camera {device}" if self._live else device
        # What fails is said below, in one line.
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
        self._capture = cv2.VideoCapture(device)
        if not self._capture.isOpened():
            raise PictureError(
                f"{self._name} cannot be opened",
                "check the cable and that no other program uses it"
                if self._live
                else "check the path and the video's format",
            )
        if self._live:
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, 1920)
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, 1080)
            self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
            for _ in range(_WARM_UP):
                self._capture.grab()

    def read(self) -> Picture:
        """The newest picture of a camera, the next of a video."""
        if self._live:
            # A driver may hold one old picture: let it go.
            self._capture.grab()
        good, picture = self._capture.read()
        if not good or picture is None:
            raise PictureError(
                f"{self._name} gives no {'picture' if self._live else 'further picture'}",
                "check the cable" if self._live else "the video has ended; record a longer one",
            )
        return np.asarray(picture, np.uint8)

    def close(self) -> None:
        """Release the device or file."""
        self._capture.release()


class Painted(PictureSource):
    """Pictures from a function, each call a new one: the emulator's room."""

    def __init__(self, paint: Callable[[], Picture]) -> None:
        self._paint = paint

    def read(self) -> Picture:
        """A new picture."""
        return self._paint()


def open_source(where: str | os.PathLike[str]) -> PictureSource:
    """A source by name: `0` or `camera:0` (live), a video file, a still, or a folder of stills.

    Raises:
        PictureError: nothing there, or nothing readable.
    """
    text = os.fspath(where)
    number = text.removeprefix("camera:")
    if number.isdigit():
        return Capture(int(number))
    path = Path(text)
    if path.is_dir():
        stills = sorted(p for p in path.iterdir() if p.suffix.lower() in _STILLS)
        if not stills:
            raise PictureError(f"{path} holds no pictures", f"put {', '.join(_STILLS)} files there")
        return Stills(stills)
    if not path.exists():
        raise PictureError(
            f"{path} does not exist", "give a picture, a folder, a video, or camera:0"
        )
    if path.suffix.lower() in _STILLS:
        return Stills([path])
    return Capture(text)


def pictures(source: PictureSource) -> Iterator[Picture]:
    """All pictures of a recorded source."""
    while True:
        try:
            yield source.read()
        except PictureError:
            return
