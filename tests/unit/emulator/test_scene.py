"""Scene files: those that come along, merging, errors, and what the host believes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thigmo.config import SIDES, SIGN
from thigmo.emulator.reach import first_felt, random_peg, stages, sweep_once
from thigmo.emulator.scene import SCENES, Scene
from thigmo.errors import ConfigError
from thigmo.mechanics import Peg, Rod, Tube, solve

ALL = sorted(path.stem for path in SCENES.glob("*.toml"))


@pytest.mark.parametrize("name", ALL)
def test_every_scene_loads_and_says_what_it_is(name: str) -> None:
    scene = Scene.load(name)
    assert scene.name == name
    assert scene.about
    assert scene.robot == Scene.load("default").robot


def test_default_scene_states_every_key() -> None:
    # Also keeps the file's values and the models' defaults of what ails the robot in step.
    given = Scene.load("default").model_dump(exclude_unset=True)
    for part in ("noise", "transducer", "muscle", "body", "flex", "spool", "operator", "plant"):
        model = Scene.model_fields[part].default_factory
        assert model is not None
        assert set(given[part]) == set(model().model_dump())  # type: ignore[call-arg]
        if part != "belief":
            assert given[part] == model().model_dump()  # type: ignore[call-arg]


def test_default_peg_is_touched_at_6_psi_by_the_tip_at_full_length() -> None:
    scene = Scene.load("default")
    (peg,) = scene.peg_list()
    g = scene.robot.muscle("left").maps[-1].inflate.curvature(6.0)
    gap, arc = solve(g, 53.0).locate(peg)
    assert gap == pytest.approx(0.0, abs=1e-3)
    assert arc == pytest.approx(53.0, abs=1e-3)
    x, y, heading = solve(g, 53.0).tip
    beside = 1.75 + peg.radius
    assert (peg.x, peg.y) == pytest.approx(
        (x - beside * np.sin(heading), y + beside * np.cos(heading)), abs=2e-3
    )
    assert 0.025 <= scene.robot.muscle("left").maps[-1].inflate.curvature(18.0) <= 0.05


def test_default_peg_still_holds_the_tip_at_the_sweeps_peak() -> None:
    scene = Scene.load("default")
    felt = first_felt(scene.robot, scene.peg_list())
    assert felt is not None
    assert (felt.length_cm, felt.side) == (53.0, "left")
    assert felt.contacts
    assert felt.pressure_psi < 10


def test_empty_room_is_never_felt() -> None:
    scene = Scene.load("empty")
    assert first_felt(scene.robot, scene.peg_list()) is None


def test_both_pegs_of_the_opposed_scene_press() -> None:
    scene = Scene.load("two_pegs")
    felt = sweep_once(scene.robot, scene.peg_list(), 53.0, "left")
    assert felt is not None
    assert len(felt.contacts) == 2


def test_growth_stages_are_whole_pitches_and_the_full_length() -> None:
    assert stages(Scene().robot) == [10.0, 20.0, 30.0, 40.0, 50.0, 53.0]


def test_random_pegs_are_felt_where_they_say_and_repeat_with_the_seed() -> None:
    robot = Scene.load("default").robot
    peg, felt = random_peg(robot, np.random.default_rng(7))
    again, _ = random_peg(robot, np.random.default_rng(7))
    assert peg == again
    assert felt.peak >= 0.005
    assert felt.contacts
    # An independent walk: the rod itself, at that stage and pressure.
    body_pressure = robot.body.pressure_number(felt.length_cm)
    scale = robot.body.pressures[body_pressure].pressure_psi / robot.body.critical_pressure_psi
    curve = robot.muscle(felt.side).maps[body_pressure].inflate
    sign = SIGN[felt.side]

    def excess(pressure: float) -> float:
        rod = Rod(Tube(3.5, robot.body.critical_curvature * scale), [peg])
        rod.step(0.0, felt.length_cm)
        g = sign * curve.curvature(pressure)
        rod.step(g, felt.length_cm)
        return float(abs(rod.solution().averages([5.0], 5.5)[0] - g))

    assert excess(felt.pressure_psi) >= 0.005 - 1e-6
    assert excess(felt.pressure_psi - 0.25) < 0.005 + 1e-6
    for length in (n for n in stages(robot) if n < felt.length_cm):
        for side in ("left", "right"):
            earlier = sweep_once(robot, [peg], length, side)
            assert earlier is None or earlier.peak < 0.005


def test_extending_merges_tables_and_replaces_lists(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        'extends = "default"\n[[pegs]]\nx=30\ny=-9\nradius=0.5\n[noise]\nwhite_counts=2.5\n'
    )
    (tmp_path / "other.toml").write_text('extends = "mine.toml"\nseed = 4\n')
    scene = Scene.load(tmp_path / "other.toml")
    assert scene.peg_list() == (Peg(30.0, -9.0, 0.5),)
    assert scene.noise.white_counts == 2.5
    assert scene.noise.pressure_counts == 0.5
    assert scene.robot == Scene.load("default").robot
    assert (scene.name, scene.seed, scene.about) == ("other", 4, "")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pegs = 3", "pegs"),
        ("[[pegs]]\nx = 1\ny = 1\nradius = 5", "overlaps the robot's base"),
        ("[[pegs]]\nx = nan\ny = 1\nradius = 5", "pegs.0.x"),
        ("colour = 'red'", "colour"),
        ("[noise]\nwhite_counts = -1", "noise.white_counts"),
        ("[[faults]]\nkind = 'estop'", "beginning"),
        ("[[faults]]\nkind = 'gremlin'\nat_s = 1", "faults.0.kind"),
        ("start_length_cm = 60", "start_length_cm"),
        ("extends = 'nowhere'", "no scene named"),
        ("extends = 'bad.toml'", "extends itself"),
        ("name = ", "not valid TOML"),
        ("[[pegs]]\nx = 30\ny = 9", "pegs.0.radius"),
        ("[robot.body]\nlength_cm = -5", "robot.body.length_cm"),
    ],
)
def test_malformed_scene_names_the_entry(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        Scene.load(path)


def test_unknown_scene_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="default"):
        Scene.load("nowhere")
    with pytest.raises(ConfigError, match="cannot read"):
        Scene.load("nowhere.toml")


def test_belief_differs_from_truth_by_what_the_scene_says() -> None:
    scene = Scene.load("default")
    scene.belief.gain_spread = 0.05
    gains, places, maps = [], [], []
    for seed in range(200):
        config = scene.believed(seed)
        for side in SIDES:
            for said, true in zip(config.column(side), scene.robot.column(side), strict=True):
                gains.append(said.scale_per_ohm / true.scale_per_ohm - 1)
                places.append(said.center_cm - true.center_cm)
                assert said.scale_se == 0.05
                assert said.center_se_cm == 0.1
                assert said.zero_se >= scene.noise.hysteresis
            for muscle_map, right in zip(
                config.muscle(side).maps, scene.robot.muscle(side).maps, strict=True
            ):
                maps.append(muscle_map.inflate.amplitude / right.inflate.amplitude - 1)
    assert np.std(gains) == pytest.approx(0.05, rel=0.1)
    assert np.std(places) == pytest.approx(0.1, rel=0.1)
    assert np.std(maps) == pytest.approx(0.01, rel=0.15)
    assert scene.believed(3) == scene.believed(3)
    assert scene.believed(3) != scene.believed(4)


def test_without_errors_the_host_believes_the_truth() -> None:
    scene = Scene()
    known, true = scene.believed(), scene.robot
    assert [s.scale_per_ohm for s in known.column("left")] == [
        s.scale_per_ohm for s in true.column("left")
    ]
    assert known.muscle("left").maps[0].inflate == true.muscle("left").maps[0].inflate
    assert known.body.critical_curvature == true.body.critical_curvature
    # And it knows that it does.
    assert {s.scale_se for s in known.column("left")} == {0.0}
    assert {s.center_se_cm for s in known.column("left")} == {0.0}
    assert {muscle_map.scale_se for muscle_map in known.muscle("left").maps} == {0.0}
    assert known.body.critical_curvature_se == 0.0
