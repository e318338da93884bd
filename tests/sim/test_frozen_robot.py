"""The thesis's robot answers as it did before: a kept session, replayed.

The session (confirm, arm, grow, zero, sweep) was recorded at the virtual board's edge: the stored
configuration, conversions, encoder, and the host's commands as messages. Fed again, the board must
say the same telemetry and the same snapshots, number for number. A change that means to alter the
controller records it again: `python tests/sim/test_frozen_robot.py`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link.client import Client
from thigmo.link.framing import Decoder, encode
from thigmo.link.message import MESSAGES, Message
from thigmo.link.protocol import SCHEMA_HASH, Hello, Snapshot, Telemetry
from thigmo.robot.robot import Robot

KEPT = Path(__file__).parent.parent / "data" / "thesis_robot_session.npz"
BOOT_MS = 840
SLOTS = 8
BY_NAME = {kind.NAME: kind for kind in MESSAGES.values()}
KINDS = (Telemetry, Snapshot)

Sent = list[tuple[int, str, dict[str, Any], int, int]]  # step, message, fields, seq, session
Trace = npt.NDArray[np.int64]


def said(board: VirtualBoard, sent: Sent, encoder: npt.NDArray[np.float64]) -> list[Message]:
    """Telemetry and snapshots of a board that is fed the session's commands and encoder."""
    board.step(BOOT_MS)
    queue = list(sent)
    for step, places in enumerate(encoder):
        while queue and queue[0][0] == step:
            _, name, fields, seq, session = queue.pop(0)
            message = BY_NAME[name](
                **{k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
            )
            if isinstance(message, Hello):
                message = replace(message, schema_hash=SCHEMA_HASH)
            board.write(encode(message, seq, session))
        for place in places:
            board.set_encoder(place, place)
            board.step(1)
    frames = Decoder().feed(board.read())
    return [frame.message() for frame in frames if MESSAGES[frame.id] in KINDS]


def numbers(messages: list[Message], kind: type[Message]) -> Trace:
    """A kind's messages as rows of integers, fields in order."""
    rows = [
        [n for v in vars(message).values() for n in (v if isinstance(v, tuple) else (int(v),))]
        for message in messages
        if isinstance(message, kind)
    ]
    return np.array(rows, np.int64)


def _trace(counts: npt.NDArray[np.uint16], channels: npt.NDArray[np.uint8]) -> Trace:
    """Conversions (tick, channel, count) of counts in order, `SLOTS` a tick from tick 0 on."""
    tick = np.arange(len(counts)) // SLOTS
    return np.column_stack([tick, np.resize(channels, len(counts)), counts]).astype(np.int64)


def test_telemetry_and_snapshots_are_those_of_before() -> None:
    kept = np.load(KEPT)
    board = VirtualBoard(5, kept["store"].tobytes())
    board.feed_trace(_trace(kept["counts"], kept["channels"]))
    messages = said(board, json.loads(kept["sent"].item()), kept["encoder"])
    assert len(kept["telemetry"]) > 1000
    assert len(kept["snapshot"]) >= 10
    for kind in KINDS:
        np.testing.assert_array_equal(numbers(messages, kind), kept[kind.NAME], kind.NAME)


def record() -> None:
    from test_same_trace import MEGA, session  # run from this folder

    scene = Scene.load("default").model_copy(update={"start_length_cm": 51.5})
    stored = VirtualBoard(1)
    transport = EmulatorTransport(scene, stored, seed=1)
    Robot(Client(transport)).configure(transport.config)
    steps, trace = session(scene, stored.eeprom, MEGA)
    sent: Sent = []
    decoder = Decoder()
    for index, step in enumerate(steps):
        for frame in decoder.feed(step.sent):
            fields = {
                k: list(v) if isinstance(v, tuple) else int(v)
                for k, v in vars(frame.message()).items()
            }
            sent.append((index, type(frame.message()).NAME, fields, frame.seq, frame.session))
    encoder = np.array([step.encoder for step in steps])
    counts, channels = trace[:, 2].astype(np.uint16), trace[: 2 * SLOTS, 1].astype(np.uint8)
    assert (_trace(counts, channels) == trace).all()
    board = VirtualBoard(5, stored.eeprom)
    board.feed_trace(trace)
    messages = said(board, sent, encoder)
    KEPT.parent.mkdir(exist_ok=True)
    np.savez_compressed(
        KEPT, store=np.frombuffer(stored.eeprom, np.uint8), counts=counts, channels=channels,
        encoder=encoder, sent=json.dumps(sent),
        **{kind.NAME: numbers(messages, kind) for kind in KINDS},
    )  # fmt: skip


if __name__ == "__main__":
    record()
