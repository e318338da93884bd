"""`thigmo watch` opens a browser without telling other users of the computer the page's token."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest
from served import comes

pytestmark = pytest.mark.realtime

BROWSER = '#!/bin/sh\nprintf %s "$1" > "{0}.partial" && mv "{0}.partial" "{0}"\n'


@pytest.fixture
def given(tmp_path: Path) -> Path:
    """Where a browser writes the address that it is given."""
    return tmp_path / "given"


@pytest.fixture
def page(given: Path, tmp_path: Path, own_sockets: None) -> Iterator[subprocess.Popen[str]]:
    """`thigmo watch` of somebody with that browser and a home folder."""
    browser = tmp_path / "browser"
    browser.write_text(BROWSER.format(given))
    browser.chmod(0o700)
    watch = subprocess.Popen(
        [sys.executable, "-m", "thigmo", "watch", "--port", "0"],
        env={**os.environ, "BROWSER": str(browser), "HOME": str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    )
    yield watch
    watch.kill()
    watch.wait()


def test_the_browser_is_given_a_file_that_only_the_user_can_read(
    page: subprocess.Popen[str], given: Path
) -> None:
    assert page.stderr is not None
    address = re.search(r"http://\S+", page.stderr.readline())
    assert address is not None
    assert "?token=" in address[0]
    assert comes(given.exists)
    url = urlparse(given.read_text())
    assert url.scheme == "file"
    file = Path(unquote(url.path))
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert f'url={address[0]}"' in file.read_text()
    page.terminate()
    page.wait()
    assert not file.exists()
