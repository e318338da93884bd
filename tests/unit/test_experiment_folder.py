"""The table of an experiment's folder, as its operator may have left it."""

from __future__ import annotations

from pathlib import Path

import pytest

from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.studies.experiments.explorations import ExplorationFolder

HEADER = ",".join(ExplorationFolder.columns) + "\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEADER + "our protocol | 1,measure,1\n", r"trials.csv, line 2: 3 cells for 7 columns; "),
        (HEADER, r"trials.csv has a header and no rows; add a row, or delete the file"),
        ("key,place\na,b\n", r"trials.csv is no table of explorations; move it away, or choose"),
    ],
)
def test_a_damaged_table_is_named(tmp_path: Path, text: str, said: str) -> None:
    folder = ExplorationFolder(tmp_path, RobotConfig())
    folder.table.write_text(text)
    with pytest.raises(DataError, match=said):
        folder.rows()


def test_lines_come_by_their_keys(tmp_path: Path) -> None:
    folder = ExplorationFolder(tmp_path, RobotConfig())
    assert folder.rows() == {}
    folder.table.write_text(HEADER + "our protocol | 1,measure,1,kept,runs/a,12.5,-3\n")
    (row,) = folder.kept()
    assert folder.rows() == {"our protocol | 1": row}
    assert (row["run"], row["dowel_y_cm"]) == ("runs/a", "-3")
