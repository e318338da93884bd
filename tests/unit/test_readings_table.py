"""A CSV of readings: what is good is read, what is bad is named with its line."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from thigmo.errors import DataError
from thigmo.record import read_frames, read_readings


def _write(path: Path, text: str) -> Path:
    (path / "r.csv").write_text(text)
    return path / "r.csv"


def test_columns_are_found_by_name_in_any_order(tmp_path: Path) -> None:
    file = _write(tmp_path, "# lab\nspan, note, Curvature ,position\n5.5,a,0.01,5\n4,b,-0.02,15\n")
    table = read_readings(file)
    assert table.position.tolist() == [5, 15]
    assert table.curvature.tolist() == [0.01, -0.02]
    assert table.span is not None
    assert table.span.tolist() == [5.5, 4]
    assert table.lines == (3, 4)
    assert read_readings(_write(tmp_path, "position,curvature\n1,2\n")).span is None


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "is empty"),
        ("position,curvature\n", "no rows"),
        ("position,bend\n5,0.01\n", "no column `curvature`"),
        ("5,0.01\n15,0.01\n", "no column `position`"),
        ("position,curvature\nnan,0.01\n", "line 2: position is nan"),
        ("position,curvature\n5,0.01\n15,inf\n", "line 3: curvature is inf"),
        ("position,curvature\n5,wide\n", "line 2: curvature is 'wide'"),
        ("position,curvature\n5\n", "line 2: 1 cells for 2 columns"),
        ("position;curvature\n5;0,01,2\n", "'0,01,2', not a number"),
        ('position,curvature\n5,"0,01"\n', "points in numbers, not commas"),
        ("position,curvature\n5,0,01\n", "as decimal commas would give"),
        ("position,curvature\n5,\n15,\n", "`curvature` is empty"),
        ("position,curvature\n5,0.01\n,0.02\n", "line 3: position is nan"),
        ("position,curvature\n" + "5,0.01\n" * 3000, "more than 2000 rows"),
        ("position,Position,curvature\n5,5,0.01\n", "'position' appears twice"),
        ("position|curvature\n5|0.01\n", "by bars"),
        ("position,curvature\n5,0.01,7\n", "line 2: 3 cells for 2 columns"),
        ('position,curvature\n5,"0.01\n15,0.02\n25,0.03\n', r"'0.01\n15,0.02"),
        ("position,curvature\n5,0x1F\n", "'0x1F', not a number"),
        ("# only a comment\n", "is empty"),
        ("position,curvature,span\n5,0.01,many\n", "line 2: span"),
    ],
)
def test_a_bad_table_is_named_in_one_line(tmp_path: Path, text: str, named: str) -> None:
    with pytest.raises(DataError) as caught:
        read_readings(_write(tmp_path, text))
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "; " in str(caught.value)  # what to do next


def test_what_spreadsheets_add_does_no_harm(tmp_path: Path) -> None:
    """A byte order mark, lines that end in CR LF, quotation marks, empty lines at the end."""
    file = tmp_path / "r.csv"
    file.write_bytes(b'\xef\xbb\xbfposition,curvature\r\n"5","0.01"\r\n15,-2e-2\r\n,\r\n\r\n')
    table = read_readings(file)
    assert table.position.tolist() == [5, 15]
    assert table.curvature.tolist() == [0.01, -0.02]


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    # 40 MB; only its first rows are parsed, and the rest is not even text.
    with (tmp_path / "huge.csv").open("wb") as file:
        file.write(b"position,curvature\n" + b"5,0.01\n" * 20_000 + bytes(40_000_000))
    with pytest.raises(DataError, match="more than 2000 rows; cut out those of one frame"):
        read_readings(tmp_path / "huge.csv")


def test_files_that_are_no_text_are_named(tmp_path: Path) -> None:
    for data in (b"\xff\xfe\x00\x80", "position,kr\u00fcmmung\n".encode("latin-1")):
        (tmp_path / "b.csv").write_bytes(data)
        with pytest.raises(DataError, match="not a text file"):
            read_readings(tmp_path / "b.csv")
    with pytest.raises(DataError, match="cannot read"):
        read_readings(tmp_path / "none.csv")


@pytest.mark.parametrize(
    "text",
    [
        "position;curvature;span\n5;0,0104;5,5\n15;0.0083;5,5\n",
        "# of a spreadsheet\n\nposition\tcurvature\tspan\n5\t0,0104\t5.5\n15\t0,0083\t5,5\n",
    ],
)
def test_semicolons_tabs_and_decimal_commas_are_read(tmp_path: Path, text: str) -> None:
    table = read_readings(_write(tmp_path, text))
    assert table.position.tolist() == [5.0, 15.0]
    assert table.curvature.tolist() == [0.0104, 0.0083]
    assert table.span is not None
    assert table.span.tolist() == [5.5, 5.5]
    assert table.lines[-1] == text.count("\n")


def test_a_sensor_that_was_not_read_is_nan(tmp_path: Path) -> None:
    table = read_readings(_write(tmp_path, "position,curvature\n5,0.01\n15,\n25,nan\n"))
    assert np.isnan(table.curvature).tolist() == [False, True, True]


def test_the_standard_input_is_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("position,curvature\n5,0.01\n15,0.02\n"))
    assert read_readings("-").curvature.tolist() == [0.01, 0.02]
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(DataError, match="the standard input is empty"):
        read_readings("-")


def test_frames_stand_in_rows(tmp_path: Path) -> None:
    file = _write(tmp_path, "t_s;K0;k1;note\n0,5;0,01;0,02;a\n1;0,03;;b\n")
    frames = read_frames(file, {"k1": 15.0, "K0": 5.0})
    assert frames.position.tolist() == [15.0, 5.0]
    assert frames.time_s is not None
    assert frames.time_s.tolist() == [0.5, 1.0]
    assert np.isnan(frames.curvature[1, 0])
    assert frames.curvature[:, 1].tolist() == [0.01, 0.03]
    with pytest.raises(DataError, match="no column `k2`"):
        read_frames(file, {"k2": 25.0})


TOA5 = """"TOA5","CR1000X","1000X","12345","Std.05","CPU:vine.CR1X","54321","Table1"
"TIMESTAMP","RECORD","k0","k1"
"TS","RN","1/cm","1/cm"
"","","Avg","Avg"
"2026-11-01 10:00:00",0,0.001,"NAN"
"2026-11-01 10:00:01",1,0.011,0.005
"2026-11-01 10:00:02",2,0.0
"""
MONITOR = """12:01:02.123 -> vine ready
12:01:02.223 -> position,curvature
12:01:02.323 -> 5,0.01
12:01:02.423 -> position,curvature
12:01:02.523 -> 15,0.004
"""


def test_a_logger_s_file_is_read_and_says_what_was_skipped(tmp_path: Path) -> None:
    frames = read_frames(_write(tmp_path, TOA5), {"k0": 5.0, "k1": 15.0})
    np.testing.assert_array_equal(frames.curvature, [[0.001, np.nan], [0.011, 0.005]])
    assert frames.lines == (5, 6)
    above, units, torn = frames.remarks
    assert "line 1 was skipped: above the header" in above
    assert "lines 3 to 4 were skipped: no number below the header" in units
    assert "the last line, 7, was cut off and left out: it has 3 of 4 cells" in torn


def test_the_stamps_of_a_serial_monitor_are_not_readings(tmp_path: Path) -> None:
    table = read_readings(_write(tmp_path, MONITOR))
    assert table.position.tolist() == [5, 15]
    assert table.curvature.tolist() == [0.01, 0.004]
    assert table.lines == (3, 5)
    assert [remark.split(": ", 1)[1] for remark in table.remarks] == [
        "line 1 was skipped: above the header",
        "line 4 was skipped: the header again",
    ]


def test_notes_with_as_many_commas_as_the_header_are_no_header(tmp_path: Path) -> None:
    text = "Vine 3, Monday\nby Ada, in the lab\nposition,curvature\ncm,1/cm\n5,0.01\n"
    table = read_readings(_write(tmp_path, text))
    assert table.curvature.tolist() == [0.01]
    assert len(table.remarks) == 2


def test_a_line_with_too_few_cells_is_torn_only_at_the_end(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="line 3: 1 cells for 2 columns"):
        read_readings(_write(tmp_path, "position,curvature\n5,0.01\n15\n25,0.01\n"))


def test_a_column_that_is_not_used_is_named(tmp_path: Path) -> None:
    path = _write(tmp_path, "position,direction,curvature\n5,90,0.01\n")
    (remark,) = read_readings(path).remarks
    assert "not used: direction; the columns of readings are position, curvature" in remark


def test_a_plain_table_has_no_remarks(tmp_path: Path) -> None:
    assert read_readings(_write(tmp_path, "# lab\nposition,curvature\n5,0.01\n")).remarks == ()
