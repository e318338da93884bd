"""Opens the page of a robot's runs beside a command that drives the robot."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

from thigmo.extras import require
from thigmo.live.starting import explore_options


def open_page(url: str, out: Path, config: Path | None) -> None:
    """Serve and open the page of a robot's runs beside this command, as long as it is of use.

    Raises NotInstalledError if the page's packages are missing.
    """
    require("live", "--watch")
    page = subprocess.Popen(
        [sys.executable, "-m", "thigmo", "watch", url, "--leave", *explore_options(out, config)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )

    # The page must not hold this command's own stderr open, which others may read to its end.
    def tell_address() -> None:
        assert page.stderr is not None
        sys.stderr.write(page.stderr.readline())
        sys.stderr.flush()

    threading.Thread(target=tell_address, daemon=True).start()
