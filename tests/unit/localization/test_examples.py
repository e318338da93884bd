"""The examples in the localizer's docstrings give what they say."""

from __future__ import annotations

import doctest

import thigmo
from thigmo.localization import localizer


def test_the_examples_give_what_they_say() -> None:
    outcome = doctest.testmod(localizer, extraglobs={"thigmo": thigmo})
    assert outcome.attempted >= 8
    assert outcome.failed == 0
