"""Options and fixtures that several folders of tests share."""

from __future__ import annotations

import signal

import pytest


def pytest_configure() -> None:
    # A shell without job control starts what it puts in the background with SIGINT ignored, and
    # every child inherits that; the tests that send it mean programs which were started by hand.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--robot",
        metavar="PORT",
        help="run the conformance suite against this port too (its configuration is put back)",
    )
