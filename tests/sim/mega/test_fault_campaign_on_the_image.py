"""A sample of the fault campaign on the real image: it notices and stops as the core does."""

from __future__ import annotations

import pytest

from thigmo.emulator.mega_sim import SimulatedMega
from thigmo_bench.studies.faults import FAILURES, Case, visit

pytestmark = pytest.mark.ci

# The growth of the campaign's robot while it is told to grow. The image and the core stop at
# another phase of the 100 ms between heartbeats, and grow on for the difference.
GROWTH_CM_S = 2.0

SAMPLE = [
    ("host silent", "growing"),
    ("pressure sensor frozen at 17 psi", "pressing"),
]


@pytest.mark.parametrize(("name", "state"), SAMPLE, ids=lambda value: value.replace(" ", "-"))
def test_the_image_fails_as_safely_as_the_core(name: str, state: str) -> None:
    case = Case(next(f for f in FAILURES if f.name == name), state)
    core = visit(case)
    image = visit(case, lambda eeprom: SimulatedMega(5, eeprom), exchange_ms=1)
    assert image.noticed == core.noticed != ""
    assert image.safe_s is not None
    assert core.safe_s is not None
    assert image.safe_s == pytest.approx(core.safe_s, abs=0.15)
    assert image.peak_psi == pytest.approx(core.peak_psi, abs=0.3)
    later_cm = GROWTH_CM_S * (image.safe_s - core.safe_s) if core.moved_cm > 0.1 else 0.0
    assert image.moved_cm == pytest.approx(core.moved_cm + later_cm, abs=0.1)
    assert image.recovers
