"""The study of a crowd: its connections never finish, go on, and come again."""

from __future__ import annotations

import socket

import pytest

from thigmo_bench.studies import crowd

pytestmark = pytest.mark.realtime


def test_the_crowd_begins_goes_on_and_comes_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crowd, "_BYTE_S", 0.01)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(60)
        with crowd._crowd(server.getsockname(), 1, 1):
            guests = [server.accept()[0] for _ in range(2)]
            said = [guest.recv(4096) for guest in guests]
            assert [words.split(b" ")[0] for words in said] == [b"POST", b"GET"]
            assert not any(b"\r\n\r\n" in words for words in said)
            dripping, half_open = guests
            while dripping.recv(1) != b"x":
                pass
            half_open.close()
            again, _ = server.accept()
            assert again.recv(4096) == said[1]
            for guest in (dripping, again):
                guest.close()
