"""The studies run, and write what they promise; tests/oracles holds their truth to others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.emulator.reach import stages, sweep_once
from thigmo.emulator.scene import Scene
from thigmo.errors import RunFolderError
from thigmo.mechanics import Peg
from thigmo.record import MapContact, RunDocument, TrueContact, TruePeg, Truth
from thigmo_bench.cli.studies import lines
from thigmo_bench.studies import STUDIES, Context, Outcome, load
from thigmo_bench.studies.attempt import attempt
from thigmo_bench.studies.engine import Claim, Explorations, write
from thigmo_bench.studies.exploration import (
    KINDS,
    Explored,
    Room,
    judged,
    pairs,
    rooms,
    visit,
)
from thigmo_bench.studies.random_rooms import random_pair, random_slipped
from thigmo_bench.studies.speed_accuracy import SCENES, Row, pareto
from thigmo_bench.studies.stability import DEFAULT


def test_every_scene_is_found_by_the_default_method() -> None:
    for name, draw in SCENES.items():
        errors = [attempt(draw(np.random.default_rng([7, i])), DEFAULT)[0] for i in range(8)]
        assert np.median(errors) < 6.0, name


def test_the_pareto_front_holds_what_nothing_beats() -> None:
    def score(method: str, time: float, error: float) -> Row:
        return {"method": method, "time_us": time, "mean_cm": error}

    front = pareto([score("a", 1, 5), score("b", 2, 6), score("c", 3, 2), score("d", 9, 2)])
    assert [s["method"] for s in front] == ["a", "c"]


def test_an_outcome_is_written_whole(tmp_path: Path) -> None:
    outcome = Outcome({"t": [{"x": 1, "y": 2.5}, {"x": 2, "y": 3.5}]}, {}, [Claim("c", 1.0, 2.0)])
    write(outcome, "study", tmp_path / "new")
    assert (tmp_path / "new/study-t.csv").read_text().splitlines() == ["x,y", "1,2.5", "2,3.5"]
    assert json.loads((tmp_path / "new/study-claims.json").read_text())[0]["holds"] is True
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(RunFolderError, match="--out"):
        write(outcome, "study", blocked / "below")


def test_claims_of_any_kind_of_number_are_json() -> None:
    for number in (np.float64(4.0), np.int64(4), 4):
        record = json.loads(json.dumps(Claim("fast", number, 5).record()))
        assert (record["value"], record["limit"], record["holds"]) == (4.0, 5.0, True)
        assert "standard_error" not in record
    assert Claim("fast", 4.0, 5.0, standard_error=0.5).record()["standard_error"] == 0.5


def test_work_goes_to_processes_in_order() -> None:
    assert Context(jobs=2).map(abs, [-3, 2, -1], "numbers") == [3, 2, 1]


def test_a_stopped_study_leaves_its_finished_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(context: Context) -> Outcome:
        context.map(abs, [-1, 2], "first")
        context.save(Outcome({"first": [{"x": 1}]}, {}, [Claim("c", 1.0, 2.0)]))
        raise KeyboardInterrupt

    monkeypatch.setattr("thigmo_bench.studies.load", lambda name: stopped)
    done = CliRunner().invoke(app, ["bench", "loads", "--out", str(tmp_path), "--json"])
    assert done.exit_code == 130
    assert f"finished parts are in {tmp_path}/loads-*" in done.stderr
    assert "loads, first: 2/2" in done.stderr
    assert json.loads((tmp_path / "loads-first.json").read_text()) == [{"x": 1}]
    assert json.loads((tmp_path / "loads-claims.json").read_text())[0]["value"] == 1.0


def test_progress_on_a_pipe_is_a_line_now_and_then_with_what_is_left() -> None:
    now, shown = 0.0, []
    tell = lines(shown.append, lambda: now)
    for done in range(101):
        now = 0.5 * done
        tell("part", done, 100)
    assert shown[:3] == [
        "part: 0/100, 0 s",
        "part: 20/100, 10 s, about 40 s to go",
        "part: 40/100, 20 s, about 30 s to go",
    ]
    assert shown[-1] == "part: 100/100, 50 s"
    assert len(shown) == 6
    tell("counted from one", 1, 3)
    assert shown[-1] == "counted from one: 1/3, 0 s, about 0 s to go"


@pytest.mark.parametrize("name", list(STUDIES))
def test_every_study_named_can_be_loaded(name: str) -> None:
    assert callable(load(name))


def test_a_trigger_before_the_pressure_has_risen_does_not_end_the_run() -> None:
    """At four times the noise the base fires in this room before the sweep has a frame."""
    assert visit(Room("empty, 4 times the noise", 16))[0].status == "silent"


def test_a_robot_beside_its_calibration_is_explored_and_judged() -> None:
    run, mapped = visit(Room("base turns to 0.05 rad", 2))
    assert run.touched == 1
    assert run.ellipses == 1
    outcome = judged([(run, mapped)])
    (row,) = outcome.tables["rows"]
    assert row["kind"] == "base turns to 0.05 rad"
    assert row["error_cm"] == run.error_cm
    claims = {claim.text: claim.value for claim in outcome.claims}
    assert claims["95 % ellipses without the truth, all kinds"] == 100.0 * run.ellipses_missed


def test_a_chosen_setting_is_tried_in_every_room_of_the_chosen_kinds() -> None:
    chosen = Explorations(("empty", "as calibrated"), ("quick", "100 s"), "thesis")
    chosen_rooms = [
        room for batch in rooms(Context(3, most=2, explorations=chosen)) for room in batch
    ]
    whole = {room[:2] for batch in rooms(Context(3, most=2)) for room in batch}
    assert len(chosen_rooms) == 2 * 2 * 2
    assert {(room.kind, room.setting, room.method) for room in chosen_rooms} == {
        (kind, setting, "thesis") for kind in chosen.kinds for setting in chosen.settings
    }
    assert {room[:2] for room in chosen_rooms} <= whole  # the seeds of the study of all kinds


def _contact(arc_cm: float, x_cm: float, y_cm: float, gave_way: float | None = None) -> MapContact:
    return MapContact(
        arc_cm=arc_cm, x_cm=x_cm, y_cm=y_cm, force_per_cm2=-2e-4,
        interval_cm=(arc_cm - 2.0, arc_cm + 2.0), status="localized", everted_length_cm=53.0,
        side="left", normal_rad=1.6, covariance_cm2=((1.0, 0.0), (0.0, 0.1)), track=[],
        model="peg", readings=5, gave_way_per_cm=gave_way,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("arc_cm", "y_cm", "counts"),
    [
        (31.0, 0.3, (1, 0, 0)),  # the set holds the truth
        (34.0, 0.3, (1, 1, 0)),  # it does not, but the contact stands beside it
        (34.0, 4.0, (1, 1, 1)),
    ],
)
def test_a_contact_is_localized_wrong_where_it_stands_over_a_radius_beside_what_its_set_lacks(
    arc_cm: float, y_cm: float, counts: tuple[int, int, int]
) -> None:
    contact = _contact(arc_cm, 30.0, y_cm)
    truth = Truth(
        pegs=[TruePeg(30.0, 1.0, 1.0)], contacts=[TrueContact(30.0, 0.0, 30.0, 53.0, 0, "left")]
    )
    explored = Explored("as calibrated", 1)
    explored.judge(RunDocument("", "", "", "", contacts=[contact], truth=truth))
    assert (explored.contacts_localized, explored.sets_missed, explored.contacts_wrong) == counts


@pytest.mark.parametrize(
    ("places", "placed"),
    [
        ([(20.0, 0.1), (40.0, -0.1)], 1),
        ([(20.0, 0.1)], 0),  # the other is not listed
        ([(20.0, 0.1), (20.5, 0.1)], 0),
        ([(20.0, 0.1), (42.1, 0.0)], 0),  # in the ellipse, and 2.1 cm off
        ([(20.0, 0.1), (40.0, 1.0)], 0),  # near, and the ellipse lacks it
    ],
)
def test_a_pair_is_placed_where_each_of_two_contacts_is_near_its_truth_and_its_ellipse_holds_it(
    places: list[tuple[float, float]], placed: int
) -> None:
    truth = Truth(
        [TruePeg(20.0, 1.0, 1.0), TruePeg(40.0, 1.0, 1.0)],
        [TrueContact(x, 0.0, x, 53.0, n, "left") for n, x in enumerate((20.0, 40.0))],
    )
    explored = Explored("two pegs on a side", 1)
    contacts = [_contact(x, x, y) for x, y in places]
    explored.judge(RunDocument("", "", "", "", contacts=contacts, truth=truth))
    assert (explored.pairs, explored.pairs_placed) == (1, placed)
    alone = Truth(truth.pegs, truth.contacts[:1])
    explored.judge(RunDocument("", "", "", "", contacts=contacts, truth=alone))
    assert (explored.pairs, explored.pairs_placed) == (0, 0)


@pytest.mark.parametrize(
    ("gone", "said", "counts"),
    [
        (True, 0.02, (1, 1, 0, 0)),
        (True, None, (1, 0, 0, 1)),  # called a peg that stands, where none was touched last
        (False, 0.02, (0, 0, 1, 1)),
    ],
)
def test_what_is_said_to_have_given_way_is_compared_with_the_pegs_that_did(
    gone: bool, said: float | None, counts: tuple[int, int, int, int]
) -> None:
    explored = Explored("pegs that give way", 1)
    truth = Truth([TruePeg(30.0, 1.0, 1.0, gone)], [])
    contact = _contact(30.0, 30.0, 0.1, said)
    explored.judge(RunDocument("", "", "", "", contacts=[contact], truth=truth))
    said_and_done = explored.gave_way, explored.gave_way_said
    assert (*said_and_done, explored.standing_gone, explored.far) == counts


def test_rooms_of_pairs_and_of_slipped_pegs_touch_as_they_say_and_repeat_with_the_seed() -> None:
    robot = Scene.load("default").robot
    first, second = (Peg(peg.x, peg.y, peg.radius) for peg in random_pair(2, 0.0))
    assert (first.y > 0) == (second.y > 0)
    side = "left" if first.y > 0 else "right"
    # The emulator's own walk, at the peak of the whole sweep or before.
    touched = sweep_once(robot, [first, second], robot.body.length_cm, side)
    assert touched is not None
    assert random_pair(2, 0.0) == random_pair(2, 0.0)
    slipped = random_slipped(0, 0.0)
    assert slipped == random_slipped(0, 0.0)
    peg = Peg(slipped.x, slipped.y, slipped.radius)
    way = "left" if peg.y > 0 else "right"
    felt = [sweep_once(robot, [peg], length, way) for length in stages(robot)]
    assert any(touch is not None and not touch.contacts for touch in felt)


def test_runs_are_compared_room_by_room() -> None:
    before = [Explored("empty", seed, best_cm=cm) for seed, cm in ((1, 2.0), (2, 3.0), (4, 9.0))]
    after = [Explored("empty", seed, best_cm=cm) for seed, cm in ((1, 1.0), (2, 0.0), (3, 9.0))]
    before[0].touched_missed, after[1].contacts_wrong = 1, 2
    (row,) = pairs([vars(explored) for explored in before], [vars(explored) for explored in after])
    assert (row["rooms"], row["placed"]) == (2, 2)
    assert (row["error_before_cm"], row["error_cm"]) == (2.5, 0.5)
    assert row["change_cm"] == pytest.approx(-2.0)  # of -1 and -3
    assert row["change_se_cm"] == pytest.approx(1.0)
    assert (row["missed_before"], row["missed"]) == (1, 0)
    assert (row["wrong_before"], row["wrong"]) == (0, 2)


def test_a_study_is_compared_with_the_table_that_an_earlier_one_wrote(tmp_path: Path) -> None:
    arguments = ["bench", "exploration", "--scale", "quick", "--kind", "empty", "--json"]
    arguments += ["--setting", "100 s", "--seed", "5"]
    first = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "first")])
    assert first.exit_code == 0, first.output
    earlier = str(tmp_path / "first" / "exploration-runs.json")
    again = CliRunner().invoke(
        app, [*arguments, "--out", str(tmp_path / "again"), "--against", earlier]
    )
    (comparison,) = json.loads(again.stdout)
    (row,) = comparison["pairs"]
    assert (row["kind"], row["setting"], row["rooms"]) == ("empty", "100 s", 1)
    assert (row["false_before"], row["false"]) == (0, 0)
    refused = CliRunner().invoke(app, ["bench", "loads", "--against", earlier])
    assert "thigmo bench exploration" in str(refused.exception)
    refused = CliRunner().invoke(app, ["bench", "exploration", "--kind", "nonsense"])
    assert f"choose from {', '.join(KINDS)}" in str(refused.exception)


def test_the_most_cases_of_a_group_are_those_asked_for() -> None:
    assert Context(most=2).count(1, 60) == 1 + 1
    assert Context(scale="quick", most=2).count(1, 60) == 1
