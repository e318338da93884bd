"""Options and fixtures that several folders of tests share."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--robot",
        metavar="PORT",
        help="run the conformance suite against this port too (its configuration is put back)",
    )
