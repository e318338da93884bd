"""The page's address, handed to a browser by a file that only this user can read.

The address carries the token, and every user of a computer can read the command line of a browser.
So the browser is given a file that leads to the address, as Jupyter does. The file lies in the home
folder and is not hidden, because browsers that are installed as snaps can read nothing else.
"""

from __future__ import annotations

import os
import tempfile
from html import escape
from pathlib import Path

from thigmo.closing import Closing

_LEADS = (
    '<!doctype html><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
    '<meta http-equiv="refresh" content="0; url={0}"><title>thigmo</title>'
    '<a href="{0}">The page of the robot</a>\n'
)


class OpeningFile(Closing):
    """A file that leads a browser to an address, until it is closed. Raises OSError."""

    def __init__(self, address: str) -> None:
        home = Path.home()
        folder = home if os.access(home, os.W_OK) else None  # None: the one for temporary files
        # Mode 600, and no name that others could have taken before.
        descriptor, name = tempfile.mkstemp(".html", "thigmo-page-", folder)
        self._path = Path(name)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(_LEADS.format(escape(address)))

    @property
    def url(self) -> str:
        """What the browser is given."""
        return self._path.as_uri()

    def close(self) -> None:
        """Remove the file."""
        self._path.unlink(missing_ok=True)
