"""Files are whole or absent."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from thigmo.files import whole_file, write_whole


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "map.txt"
    write_whole(path, "a\r\nµ")
    assert path.read_bytes() == "a\r\nµ".encode()
    write_whole(path, b"\0")
    assert path.read_bytes() == b"\0"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
@pytest.mark.parametrize("before", [b"before", None])
def test_what_fails_leaves_what_was_there(
    tmp_path: Path, failure: BaseException, before: bytes | None
) -> None:
    path = tmp_path / "map.txt"
    if before is not None:
        path.write_bytes(before)

    def fail() -> None:
        with whole_file(path) as file:
            file.write(b"half")
            raise failure

    with pytest.raises(type(failure)):
        fail()
    assert [left.read_bytes() for left in tmp_path.iterdir()] == ([before] if before else [])
