"""The hub: everybody hears all that he keeps up with, and nobody keeps the publisher waiting."""

from __future__ import annotations

from math import isnan, nan

import pytest
from contacts import CONTACT, a_telemetry

from thigmo.errors import DataError
from thigmo.stream import (
    CHANNELS,
    BodyShape,
    Contacts,
    Dropped,
    Event,
    Grid,
    Hello,
    Hub,
    Log,
    Message,
    Posterior,
    Question,
    RunState,
    Telemetry,
    from_json,
    to_json,
)


def an_event(t_s: float = 1.0) -> Event:
    return Event(t_s, t_s, "contact", "info", "the trigger fired", "")


def a_state(t_s: float = 1.0, doing: str = "growing") -> RunState:
    return RunState(t_s, t_s, "GROW", doing, 20.0, 0.25)


ONE_OF_EACH = [
    Hello(0.0, 1.7e9, "emulator://default", "default", "/run", 7, "0.1.0", True),
    Dropped(1.0, 1.7e9, 12),
    a_telemetry(),
    an_event(),
    a_state(),
    BodyShape(1.0, 2.0, ((0.0, 0.0, 0.0), (1.0, 0.1, 0.2)), 1.75),
    Posterior(1.0, 2.0, "left", 40.0, (1.0, 2.0), (0.25, 0.75), "localized", "one", "", 0.9, True),
    Contacts(1.0, 2.0, (CONTACT,)),
    Grid(1.0, 2.0, 0.5, (-1.0, -2.0, 0.0), 3, 2, (0, 100, -1, 0, 0, 0)),
    Log(1.0, 2.0, "warning", "the record is cut short"),
    Question(1.0, 2.0, "How many cm?"),
]  # fmt: skip


def test_every_kind_of_message_is_tried_here() -> None:
    assert {message.CHANNEL for message in ONE_OF_EACH} == set(CHANNELS)


@pytest.mark.parametrize("message", ONE_OF_EACH, ids=lambda message: message.CHANNEL)
def test_json_gives_the_same_message_back(message: Message) -> None:
    assert from_json(to_json(message)) == message


def test_what_is_not_known_is_null_in_json_and_nan_again() -> None:
    data = to_json(a_telemetry(supply_v=nan))
    assert b'"supply_v":null' in data
    back = from_json(data)
    assert isinstance(back, Telemetry)
    assert isnan(back.supply_v)


@pytest.mark.parametrize("data", [b"", b"[]", b"{}", b'{"channel":"x"}', b'{"channel":"log"}'])
def test_anything_else_is_refused(data: bytes) -> None:
    with pytest.raises(DataError, match="same version"):
        from_json(data)


def test_a_listener_hears_its_channels_in_order() -> None:
    hub = Hub()
    with hub.subscribe({"event", "state"}) as heard:
        hub.publish(a_telemetry())
        hub.publish(an_event(1.0))
        hub.publish(a_state(2.0))
        hub.close()
        assert [message.t_s for message in heard] == [1.0, 2.0]


def test_a_listener_that_does_not_listen_loses_the_oldest_and_can_tell_how_many() -> None:
    hub = Hub()
    with hub.subscribe(size=3) as heard:
        for t_s in range(10):
            hub.publish(a_telemetry(float(t_s)))
        hub.close()
        assert [message.t_s for message in heard] == [7.0, 8.0, 9.0]
        assert heard.dropped == 7


def test_a_late_listener_gets_the_last_of_each_slow_channel_and_the_events() -> None:
    hub = Hub()
    hub.publish(a_state(1.0))
    hub.publish(a_state(2.0))
    hub.publish(an_event(1.5))
    hub.publish(a_telemetry(3.0))
    with hub.subscribe() as heard:
        hub.close()
        assert list(heard) == [a_state(2.0), an_event(1.5)]


def test_nobody_wants_what_nobody_listens_to() -> None:
    hub = Hub()
    assert not hub.wanted(Telemetry)
    with hub.subscribe({"telemetry"}):
        assert hub.wanted(Telemetry)
        assert not hub.wanted(BodyShape)
    assert not hub.wanted(Telemetry)


def test_a_subscription_to_a_closed_hub_ends_at_once() -> None:
    hub = Hub()
    hub.publish(a_state())
    hub.close()
    with hub.subscribe() as heard:
        assert list(heard) == [a_state()]
