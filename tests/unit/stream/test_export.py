"""Tables of a run's messages, as pandas and spreadsheets read them."""

from __future__ import annotations

import csv
from math import nan
from pathlib import Path

import pytest
from contacts import CONTACT, a_telemetry
from test_hub import ONE_OF_EACH
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.design import draft
from thigmo.errors import DataError, RunFolderError
from thigmo.record import LogWriter
from thigmo.stream import Hub, recording
from thigmo.stream.recorded import export_csv, export_parquet


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    hub = Hub()
    with LogWriter(folder / "run.mcap", {}, epoch_s=1.7e9) as log, recording(hub, log):
        hub.publish(a_telemetry(0.5, supply_v=nan))
        for message in ONE_OF_EACH:
            hub.publish(message)
    return folder


def _table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_channel_but_the_grid_has_its_table(run: Path, tmp_path: Path) -> None:
    files = export_csv(run, tmp_path / "deep" / "tables")
    assert sorted(path.stem for path in files) == [
        "contacts", "event", "log", "posterior", "shape", "state", "telemetry",
    ]  # fmt: skip
    assert all(path.exists() for path in files)


def test_telemetry_has_a_column_for_each_number(run: Path, tmp_path: Path) -> None:
    export_csv(run, tmp_path)
    unknown, known = _table(tmp_path / "telemetry.csv")
    assert (unknown["supply_v"], known["supply_v"]) == ("", "5")
    assert float(known["epoch_s"]) == 1.7e9 + 1.0
    assert (known["pressure_psi_left"], known["pressure_psi_right"]) == ("1.5", "0")
    assert [known[f"flex_sum_right_{n}"] for n in range(5)] == ["5", "6", "7", "8", "9"]
    assert known["curvature_per_cm_left_0"] == "0.01"
    assert (known["state"], known["faults"]) == ("ready", "stopped")


def test_a_list_becomes_rows(run: Path, tmp_path: Path) -> None:
    export_csv(run, tmp_path)
    assert [row["x_cm"] for row in _table(tmp_path / "shape.csv")] == ["0", "1"]
    cells = _table(tmp_path / "posterior.csv")
    assert {(row["contact_probability"], row["sweeping"]) for row in cells} == {("0.9", "True")}
    assert [(row["place_cm"], row["probability"]) for row in cells] == [
        ("1", "0.25"),
        ("2", "0.75"),
    ]
    (contact,) = _table(tmp_path / "contacts.csv")
    assert (contact["interval_low_cm"], contact["interval_high_cm"]) == ("29.8", "32.7")
    assert (contact["variance_x_cm2"], contact["variance_y_cm2"]) == ("0.7", "0.4")
    assert contact["known"] == ""
    in_frame = CONTACT.to_row({"left": "left"})
    assert list(contact) == ["t_s", "epoch_s", "contact", *in_frame]


def test_tables_call_muscles_by_their_names(run: Path, tmp_path: Path) -> None:
    robot = draft(53, 5, 2)
    for muscle, name in zip(robot.muscles, ("upper", "lower"), strict=True):
        muscle.name = name
    (tmp_path / "run.mcap").write_bytes((run / "run.mcap").read_bytes())
    robot.save(tmp_path / "robot.toml")
    export_csv(tmp_path, tmp_path)
    assert {row["muscle"] for row in _table(tmp_path / "posterior.csv")} == {"upper"}
    (contact,) = _table(tmp_path / "contacts.csv")
    assert contact["muscle"] == {"left": "upper", "right": "lower"}[CONTACT.side]


def test_parquet_holds_the_same_tables_with_nulls(run: Path, tmp_path: Path) -> None:
    from pyarrow.parquet import read_table

    tables = {path.stem: _table(path) for path in export_csv(run, tmp_path)}
    files = export_parquet(run, tmp_path)
    assert [path.stem for path in files] == list(tables)
    for file in files:
        held = read_table(file)
        assert held.num_rows == len(tables[file.stem])
        assert held.column_names == list(tables[file.stem][0])
    assert read_table(tmp_path / "telemetry.parquet")["pressure_psi_left"].to_pylist() == [1.5, 1.5]
    assert read_table(tmp_path / "contacts.parquet")["known"].to_pylist() == [None]


def test_the_command_names_its_files_and_asks_for_a_folder(run: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["export", str(run), "--csv", str(tmp_path)])
    assert str(tmp_path / "telemetry.csv") in done.output.split()
    with pytest.raises(DataError, match="--csv FOLDER or --parquet FOLDER"):
        CliRunner().invoke(app, ["export", str(run)], catch_exceptions=False)


def test_a_folder_that_cannot_be_written_is_named(run: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RunFolderError, match="choose another folder"):
        export_csv(run, tmp_path / "file")


def test_columns_have_the_names_of_the_robot_that_was_used(run: Path, tmp_path: Path) -> None:
    """Sensors of one column stand base first, also those that hang on the other's inputs."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.mcap").write_bytes((run / "run.mcap").read_bytes())
    draft(120.0, 8, 1).save(tmp_path / "run" / "robot.toml")
    export_csv(tmp_path / "run", tmp_path)
    (_, known) = _table(tmp_path / "telemetry.csv")
    assert [name for name in known if name.startswith("pressure")] == ["pressure_psi_left"]
    inputs = [known[f"flex_sum_270deg_{place}"] for place in range(8)]
    assert inputs == ["5", "6", "7", "8", "9", "1", "2", "3"]
    assert not any("right" in name or name.endswith("left_0") for name in known)
