"""Frames survive whatever a serial line does to them, in bounded memory."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, FrameError, decode, encode

FRAMES = [
    encode(wire.Heartbeat(7), 0, 3),
    encode(wire.Ack(wire.Status.OK, wire.Reason.NONE, 0), 9, 3),
    encode(wire.Telemetry(1, (0,) * 10, *((0, 0),) * 3, 0, 0, 0, 0, 0, 0), 4, 3),
    encode(wire.MapValues(wire.Status.OK, 0, 0, wire.Branch.INFLATE, (-1,) * 11), 1, 1),
]


def test_a_frame_comes_back_as_it_went() -> None:
    (frame,) = Decoder().feed(encode(wire.SetParameter(3, -5), 0xABCD, 0x1234))
    assert (frame.seq, frame.session) == (0xABCD, 0x1234)
    assert frame.message() == wire.SetParameter(3, -5)
    assert decode(frame.wire) == frame


@pytest.mark.parametrize("message", wire.MESSAGES.values(), ids=lambda m: m.NAME)
def test_no_message_exceeds_the_wire(message: type[wire.Message]) -> None:
    assert message.SIZE <= wire.MAX_PAYLOAD
    worst = b"\xff" * message.SIZE  # no zero at all gives the most stuffing

    class Raw(wire.Message):
        ID = message.ID

        def pack(self) -> bytes:
            return worst

    assert len(encode(Raw(), 0xFFFF, 0xFFFF)) <= (24 if message is wire.Event else wire.MAX_WIRE)


@given(st.lists(st.sampled_from(FRAMES)), st.lists(st.integers(1, 40), min_size=1))
def test_frames_do_not_depend_on_how_the_stream_is_cut(
    frames: list[bytes], cuts: list[int]
) -> None:
    stream = b"".join(frames)
    whole = [f.wire + b"\0" for f in Decoder().feed(stream)]
    decoder, pieces, at = Decoder(), [], 0
    for number in range(len(stream)):
        step = cuts[number % len(cuts)]
        pieces += decoder.feed(stream[at : at + step])
        at += step
    assert whole == frames == [f.wire + b"\0" for f in pieces]
    assert decoder.bad == 0


@given(st.lists(st.binary(max_size=300), max_size=30))
def test_garbage_is_counted_and_never_kept(chunks: list[bytes]) -> None:
    decoder = Decoder()
    for chunk in chunks:
        decoder.feed(chunk)
        assert len(decoder._incomplete) < wire.MAX_WIRE
    good = encode(wire.Heartbeat(1), 0, 1)
    assert [f.wire + b"\0" for f in decoder.feed(b"\0" + good)][-1] == good


@given(st.binary(max_size=200), st.sampled_from(FRAMES))
def test_the_frame_after_the_next_zero_is_found(garbage: bytes, frame: bytes) -> None:
    decoder = Decoder()
    decoder.feed(garbage + b"\0")
    bad = decoder.garbage
    assert [f.wire + b"\0" for f in decoder.feed(frame)] == [frame]
    assert bad <= len(garbage)


@given(st.sampled_from(FRAMES), st.data())
def test_no_small_damage_goes_unseen(frame: bytes, data: st.DataObject) -> None:
    """CRC-16 finds every burst of up to 16 bits inside the frame's bytes."""
    bit = data.draw(st.integers(0, 8 * (len(frame) - 1) - 1))
    broken = bytearray(frame)
    broken[bit // 8] ^= 1 << bit % 8
    assert all(f.wire + b"\0" != frame for f in Decoder().feed(bytes(broken)))
    assert [f.message() for f in Decoder().feed(bytes(broken))] == []


def test_endless_bytes_without_a_zero_are_one_bad_frame() -> None:
    decoder = Decoder()
    for _ in range(1000):
        assert decoder.feed(b"\x55" * 1000) == []
        assert len(decoder._incomplete) < wire.MAX_WIRE
    assert decoder.feed(b"\0" + FRAMES[0])[0].wire + b"\0" == FRAMES[0]
    assert decoder.bad == 1
    assert decoder.bad_bytes >= 999_000


def test_random_bytes_rarely_pass_the_check() -> None:
    rng = random.Random(1)
    decoder = Decoder()
    decoder.feed(rng.randbytes(2_000_000))
    assert decoder.frames <= 3  # about 8000 pieces, of which one in 65 536 passes
    assert decoder.bad > 1000


def test_an_unknown_id_and_a_bad_size_are_errors() -> None:
    frame = Decoder().feed(FRAMES[0])[0]
    with pytest.raises(FrameError, match="unknown message id 0x7F"):
        frame._replace(id=0x7F).message()
    with pytest.raises(FrameError, match="2 bytes of payload, 4 expected"):
        frame._replace(payload=b"ab").message()
    with pytest.raises(FrameError, match="9 is not a valid Status"):
        frame._replace(id=wire.Ack.ID, payload=b"\x09\0\0\0\0\0").message()
