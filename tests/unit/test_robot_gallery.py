"""The robots of docs/robots: described, checked, and explorable as the check says."""

from __future__ import annotations

from pathlib import Path

import pytest

from thigmo.config import RobotConfig
from thigmo.design import judge
from thigmo.wiring import Wiring
from thigmo_bench.studies.gallery import GALLERY

FILES = sorted(GALLERY.glob("*.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_robot_of_the_gallery_is_good_and_nothing_is_asked(file: Path) -> None:
    robot = RobotConfig.load(file)
    findings = judge(robot)
    assert [
        finding for finding in findings if finding.mark == "bad" or finding.part == "units"
    ] == []
    refused = Wiring.laid_out(robot).unexplorable is not None
    assert (findings[0].part == "explore") is refused
    assert refused is (file.stem in ("three-muscles", "whisker", "tendon", "preformed"))


def test_the_gallery_names_every_file() -> None:
    page = (GALLERY.parent / "robots.md").read_text()
    assert [file.name for file in FILES if f"<robots/{file.name}>" not in page] == []
