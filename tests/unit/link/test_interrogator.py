"""Lines of an interrogator: what is read, and what of it is old, cut, garbage or lost."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from thigmo.errors import InterrogatorError
from thigmo.link.interrogator import MAX_AGE_S, Interrogator, TcpSource

ALL = np.ones(3, dtype=np.bool_)


class _Lab:
    """A clock and a source of bytes, in place of a network."""

    name = "lab"

    def __init__(self) -> None:
        self.t_s = 100.0
        self.bytes = b""
        self.gone = False
        self.heard = Interrogator(self, 3, lambda: self.t_s)

    def read(self) -> bytes:
        if self.gone:
            raise ConnectionResetError("reset by peer")
        read, self.bytes = self.bytes, b""
        return read

    def close(self) -> None:
        pass

    def send(self, stamp_s: float, *strain: float) -> None:
        self.bytes += (",".join(map(str, (stamp_s, *strain))) + "\n").encode()

    def run(self, seconds: float, lost: int = -1) -> None:
        """Lines every 20 ms, 5 ms on their way."""
        for _ in range(round(seconds / 0.02)):
            self.t_s += 0.02
            strain = [self.t_s % 7, 2.0, 3.0]
            if lost >= 0:
                strain[lost] = float("nan")
            self.send(self.t_s - 95.005, *strain)
            self.heard.take()


@pytest.fixture
def lab() -> _Lab:
    made = _Lab()
    made.run(1.0)
    made.heard.require(ALL)
    return made


def test_lines_have_the_host_time_at_which_they_were_measured() -> None:
    lab = _Lab()
    lab.bytes = b"# t_s, strains\r\n1.0, 10.5 -2 nan\r\n1.0"
    assert not lab.heard.heard
    lab.t_s += 0.5
    lab.bytes = b"2e1,7,8,9\n"  # the other half of a line: 1.02e1
    (first, strain), (second, _) = lab.heard.lines_since(0.0)
    assert first == pytest.approx(100.0 + 0.5 - 9.2, abs=0.01)  # the least delay is the last one's
    assert second - first == pytest.approx(9.2)
    assert strain == pytest.approx([10.5, -2.0, np.nan], nan_ok=True)
    assert lab.heard.heard
    assert len(lab.heard.lines_since(99.0)) == 1


@pytest.mark.parametrize(
    ("garbage", "why"),
    [
        (b"5.9,1,2\n", "has 2 strains, and robot.toml 3"),
        (b"\xff\x00volts\n", "is no line of numbers"),
        (b"0.5,1,2,3\n", "does not rise"),
        (b"6.0,1,2,", ""),  # half a line
        (b"7" * 70_000, "sends no end of a line"),
        (b"inf,1,2,3\n", "does not rise"),
    ],
)
def test_garbage_is_no_reading_and_good_lines_beside_it_are(
    lab: _Lab, garbage: bytes, why: str
) -> None:
    before = len(lab.heard.lines_since(0.0))
    lab.bytes = garbage
    lab.heard.require(ALL)  # one bad line, while the last good one is young
    assert len(lab.heard.lines_since(0.0)) == before
    lab.t_s += MAX_AGE_S + 0.02
    with pytest.raises(InterrogatorError, match=rf"newest line is 0.2\d s old.*{why}"):
        lab.heard.require(ALL)
    lab.bytes = b"\n"
    lab.run(0.1)
    lab.heard.require(ALL)


def test_lines_that_waited_are_as_old_as_they_are(lab: _Lab) -> None:
    for n in range(50):  # a second of lines, held back by the network for half a second more
        lab.send(lab.t_s - 95.005 + 0.02 * n, n, 2.0, 3.0)
    lab.t_s += 1.5
    with pytest.raises(InterrogatorError, match=r"newest line is 0.5\d s old"):
        lab.heard.require(ALL)
    assert not lab.heard.lines_since(lab.t_s - 0.5)
    lab.run(0.02)
    lab.heard.require(ALL)


def test_a_slow_interrogator_is_refused(lab: _Lab) -> None:
    lab.t_s += 0.19
    lab.heard.require(ALL)
    lab.t_s += 0.02
    with pytest.raises(InterrogatorError, match=r"old \(limit 0\.2\)"):
        lab.heard.require(ALL)


def test_a_clock_that_drifts_by_the_rate_of_poor_crystals_is_followed() -> None:
    lab = _Lab()
    for _ in range(30_000):  # ten minutes; the interrogator loses 60 ms in each
        lab.t_s += 0.02
        lab.send(lab.t_s * (1 - 1e-4), lab.t_s, 2.0, 3.0)
        lab.heard.require(ALL)


def test_a_cut_line_ends_it_and_says_so(lab: _Lab) -> None:
    lab.gone = True
    with pytest.raises(InterrogatorError, match="is lost: reset by peer; look at"):
        lab.heard.require(ALL)


def test_a_lost_grating_is_named_and_a_dropped_peak_or_a_dead_one_is_not(lab: _Lab) -> None:
    lab.run(0.1, lost=1)
    lab.heard.require(ALL)
    lab.run(0.2, lost=1)
    with pytest.raises(InterrogatorError, match="has lost strain_1; look at the fibre"):
        lab.heard.require(ALL)
    lab.heard.require(np.array([True, False, True]))


def test_strains_that_stay_the_same_to_the_last_digit_are_no_readings(lab: _Lab) -> None:
    for _ in range(60):
        lab.t_s += 0.02
        lab.send(lab.t_s - 95.005, 1.0, 2.0, 3.0)
    with pytest.raises(InterrogatorError, match=r"repeats the same strains for 1.\d s"):
        lab.heard.require(ALL)


def test_nothing_but_silence_is_refused() -> None:
    lab = _Lab()
    with pytest.raises(InterrogatorError, match="sends no lines of strains"):
        lab.heard.require(ALL)


def test_a_socket_is_read_without_waiting_until_it_is_closed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        source = TcpSource(address)
        assert source.read() == b""
        accepted, _ = server.accept()
        with accepted:
            accepted.sendall(b"1,2,3\n")
            source._socket.setblocking(True)
            assert source._socket.recv(6, socket.MSG_PEEK)
            source._socket.setblocking(False)
            assert source.read() == b"1,2,3\n"
        source._socket.setblocking(True)
        source._socket.recv(1, socket.MSG_PEEK)
        with pytest.raises(EOFError):
            source.read()
        source.close()
    with pytest.raises(InterrogatorError, match=f"no interrogator answers at {address}"):
        TcpSource(address)
