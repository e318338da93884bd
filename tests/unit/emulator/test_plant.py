"""The emulated robot: air, motion, sensors and growth, each against what it claims to be."""

from __future__ import annotations

from math import exp
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thigmo.emulator.plant import OPEN_COUNT, SHORT_COUNT, STEP_S, Plant
from thigmo.emulator.scene import PegTable, Scene


def quiet(**changes: object) -> Scene:
    """The default robot without noise, unit-to-unit errors or creep."""
    scene = Scene.load("default")
    scene.pegs = []
    for part in (scene.noise,):
        part.white_counts = part.pressure_counts = part.hysteresis = part.per_eversion = 0.0
    scene.transducer.gain_error = scene.transducer.sensor_zero_error_psi = 0.0
    scene.transducer.hysteresis_psi = 0.0
    scene.flex.creep = scene.flex.stowed = 0.0
    for name, value in changes.items():
        setattr(scene, name, value)
    return scene


def run(
    plant: Plant, seconds: float, *, left: float = 0.0, right: float = 0.0, motor: int = 0
) -> None:
    """Hold currents (mA) and motor duty."""
    drive = (round(left / 20 * 1599), round(right / 20 * 1599))
    for _ in range(round(seconds / STEP_S)):
        plant.step(drive, (left > 0, right > 0), motor, motor == 0)


def ramp(plant: Plant, psi: float, seconds: float = 6.0) -> None:
    """Raise the left muscle slowly, as a sweep does, so that the swing stays small."""
    for u in np.linspace(0.0, 1.0, round(seconds / STEP_S)):
        run(plant, STEP_S, left=current_for(2.0 + u * (psi - 2.0)))


def out(length: float, **changes: object) -> Plant:
    return Plant(quiet(start_length_cm=length, **changes))


def current_for(psi: float) -> float:
    return 4.0 + 16.0 * (psi - 2.0) / 58.0


def curvature_read(plant: Plant, sensor: int) -> float:
    """What a host with true constants makes of a sensor's ideal count, less its flat resistance."""
    side, index = divmod(sensor, 5)
    column = plant.scene.robot.column("left" if side == 0 else "right")[index]
    count = plant.analog[sensor, 1]
    ohm = 22_000.0 * (1024.0 - count) / count
    return float(column.scale_per_ohm * (ohm - column.zero_ohm))


def test_transducer_has_a_live_zero() -> None:
    plant = out(30.0)
    run(plant, 3.0, left=4.0)
    assert plant.muscle_psi[0] == pytest.approx(2.0, abs=0.02)
    run(plant, 3.0, left=3.0)
    assert plant.muscle_psi[0] == pytest.approx(0.0, abs=0.02)
    run(plant, 3.0, left=20.0)
    assert plant.muscle_psi[0] == pytest.approx(60.0, abs=0.01)
    run(plant, 6.0)
    assert plant.muscle_psi == (0.0, 0.0)


def test_disconnected_output_is_true_zero_whatever_the_duty() -> None:
    plant = out(30.0)
    for _ in range(300):
        plant.step((1599, 1599), (False, False), 0, True)
    assert plant.muscle_psi == (0.0, 0.0)


def test_pressure_follows_with_delay_lag_and_slew_limit() -> None:
    plant = out(30.0)
    pressures = []
    for _ in range(100):
        run(plant, STEP_S, left=current_for(3.0))
        pressures.append(plant.muscle_psi[0])
    assert pressures[1] == 0.0  # 30 ms of delay
    assert pressures[2] == 0.0
    after = 0.15
    at = round((0.03 + after) / STEP_S)
    assert pressures[at] == pytest.approx(3.0 * (1 - exp(-after / 0.15)), abs=0.25)
    fast = out(30.0)
    run(fast, 1.0, left=20.0)
    assert fast.muscle_psi[0] <= 30.0


def test_a_long_delay_is_kept() -> None:
    scene = quiet(start_length_cm=30.0)
    scene.transducer.delay_s = 0.5
    plant = Plant(scene)
    run(plant, 0.5, left=current_for(3.0))
    assert plant.muscle_psi[0] == 0.0
    run(plant, 0.1, left=current_for(3.0))
    assert plant.muscle_psi[0] > 0.5


def test_pressure_sensor_is_ratiometric_and_its_broken_wire_reads_zero() -> None:
    plant = out(30.0)
    run(plant, 4.0, right=current_for(12.0))
    assert plant.analog[10, 1] == pytest.approx(1024 * 0.1)
    assert plant.analog[11, 1] == pytest.approx(1024 * (0.1 + 0.8 * 12.0 / 60), abs=0.5)
    plant.stuck[11] = OPEN_COUNT
    run(plant, 0.1, right=current_for(12.0))
    assert plant.analog[11, 1] == 0.0


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_steady_bend_is_the_inflating_map_then_the_deflating_one(side: str, sign: float) -> None:
    plant = out(53.0)
    maps = plant.scene.robot.muscle(side).maps[-1]  # type: ignore[arg-type]
    for psi in (3.0, 6.0):
        run(plant, 5.0, **{side: current_for(psi)})
    assert plant.free_curvature == pytest.approx(sign * maps.inflate.curvature(6.0), rel=5e-4)
    run(plant, 5.0, **{side: current_for(12.0)})
    run(plant, 5.0, **{side: current_for(6.0)})
    assert plant.free_curvature == pytest.approx(sign * maps.deflate.curvature(6.0), rel=5e-4)
    assert maps.deflate.curvature(6.0) == pytest.approx(1.1 * maps.inflate.curvature(6.0), rel=0.03)
    run(plant, 8.0)
    assert plant.free_curvature == pytest.approx(0.0, abs=1e-6)


def test_body_pressure_changes_the_map_and_the_fold() -> None:
    plant = out(53.0)
    run(plant, 6.0, left=current_for(10.0))
    soft = plant.free_curvature
    plant.set_body_pressure(1.47)
    run(plant, 3.0, left=current_for(10.0))
    assert plant.free_curvature == pytest.approx(soft * 0.026 / 0.030, rel=1e-6)
    assert plant.body.critical_moment == pytest.approx(3 * 0.01108)


def test_swing_overshoots_as_its_damping_says() -> None:
    scene = quiet(start_length_cm=53.0)
    scene.muscle.inflate_tau_s = scene.transducer.lag_s = 1e-3
    scene.transducer.slew_psi_s = 1e5
    plant = Plant(scene)
    top = 0.0
    for _ in range(200):
        run(plant, STEP_S, left=current_for(10.0))
        top = max(top, plant.free_curvature)
    overshoot = top / plant.free_curvature - 1
    assert overshoot == pytest.approx(exp(-np.pi * 0.5 / np.sqrt(0.75)), abs=2e-3)


def test_line_is_paid_out_twice_as_fast_as_the_tip_grows() -> None:
    plant = Plant(quiet())
    before = plant.encoder[1]
    run(plant, 5.0, motor=200)
    line = (plant.encoder[1] - before) / 76.0
    assert line == pytest.approx(2 * plant.length_cm, rel=1e-6)
    # A quarter of 147 N, 4.9 N of the body's pull, 11 N of friction, damped by what brings 147 N to
    # 23.6 cm/s; after a lag of 0.07 s.
    moving = 147 / 4 + 4.88 - 147 * 60 / 800
    assert line == pytest.approx(moving / (147 * 740 / 800) * 23.6 * (5.0 - 0.07), rel=2e-3)


def test_duty_that_friction_holds_and_the_brake_move_nothing() -> None:
    """11 N at rest: with the pull's 4.9 N, 33 of 800 to pay out and 87 to wind in."""
    plant = out(20.0)
    for motor in (33, -86, 0):
        run(plant, 2.0, motor=motor)
    assert plant.length_cm == 20.0
    run(plant, 0.5, motor=-90)
    assert plant.length_cm < 20.0


def test_winding_in_ends_at_the_base() -> None:
    plant = out(5.0)
    run(plant, 10.0, motor=-300)
    assert plant.length_cm == 0.0
    assert plant.encoder == (0.0, 0.0)


def test_tail_ends_at_full_length_and_the_rest_is_slack() -> None:
    plant = out(52.0)
    run(plant, 5.0, motor=300)
    assert plant.length_cm == 53.0
    assert plant.encoder[1] > 2 * 53.0 * 76.0 + 100
    run(plant, 1.0, motor=-300)  # takes in slack first
    assert plant.length_cm == 53.0


def test_too_little_body_pressure_does_not_evert() -> None:
    plant = out(20.0)
    plant.set_body_pressure(0.2)
    run(plant, 3.0, motor=300)
    assert plant.length_cm == 20.0
    plant.set_body_pressure(0.49)
    run(plant, 3.0, motor=0)
    assert plant.length_cm > 25.0  # the slack that lay ready


def test_tip_stalls_against_a_peg_that_pushes_too_hard() -> None:
    scene = Scene.load("ahead")
    scene.start_length_cm = 25.0
    scene.pegs = [PegTable(x=36.0, y=0.5, radius=3.0)]
    scene.body.growth_force = 1e-4
    plant = Plant(scene)
    run(plant, 8.0, motor=200)
    assert plant.length_cm == pytest.approx(33.0, abs=0.05)
    scene.body.growth_force = 1.0
    free = Plant(scene)
    run(free, 8.0, motor=200)
    assert free.length_cm > 36.0


def test_quiet_sensors_of_the_passive_side_read_the_bend() -> None:
    plant = out(53.0)
    run(plant, 6.0, left=current_for(12.0))
    for sensor in range(5, 10):
        assert curvature_read(plant, sensor) == pytest.approx(plant.free_curvature, abs=2e-8)
    assert plant.sensor_curvature == pytest.approx(np.full(10, plant.free_curvature))


def test_active_side_wrinkles_into_garbage() -> None:
    plant = out(53.0)
    run(plant, 6.0, left=current_for(12.0))
    errors = [abs(curvature_read(plant, i) - plant.free_curvature) for i in range(5)]
    assert max(errors) > 0.01
    assert np.std([curvature_read(plant, i) for i in range(5)]) > 0.001


def test_sensor_answers_weakly_against_its_direction() -> None:
    scene = quiet(start_length_cm=53.0)
    scene.flex.wrinkle_start_psi, scene.flex.wrinkle_full_psi = 50.0, 60.0
    plant = Plant(scene)
    run(plant, 6.0, left=current_for(12.0))
    for sensor in range(5):
        assert curvature_read(plant, sensor) == pytest.approx(0.6 * plant.free_curvature)


def test_sensor_loop_is_half_a_width_off_on_each_way() -> None:
    scene = quiet(start_length_cm=53.0)
    scene.noise.hysteresis = 1e-3
    plant = Plant(scene, seed=5)
    for psi in np.arange(2.5, 15.0, 0.02):
        run(plant, STEP_S, left=current_for(float(psi)))
    up = np.array([curvature_read(plant, i) for i in range(5, 10)]) - plant.free_curvature
    for psi in np.arange(15.0, 2.5, -0.02):
        run(plant, STEP_S, left=current_for(float(psi)))
    down = np.array([curvature_read(plant, i) for i in range(5, 10)]) - plant.free_curvature
    assert np.abs(up).max() > 2e-4
    assert down == pytest.approx(-up, abs=0.25 * np.abs(up).max())


def test_fresh_sensor_creeps_to_rest_with_its_time_constant() -> None:
    scene = quiet(start_length_cm=30.0)
    scene.flex.creep = 0.02
    plant = Plant(scene, seed=1)
    run(plant, 5.0)
    old = curvature_read(plant, 5)
    assert old == pytest.approx(0.0, abs=1e-9)  # rested at the start
    while plant.length_cm < 37.75:
        run(plant, STEP_S, motor=200)
    run(plant, 0.5)
    first = curvature_read(plant, 8)
    run(plant, 9.6)
    second = curvature_read(plant, 8)
    assert abs(first) > 1e-3
    assert second / first == pytest.approx(exp(-1), rel=1e-6)  # settle_tau_s = 9.6
    run(plant, 40.0)
    assert abs(curvature_read(plant, 8)) < 0.02 * abs(first)


def test_each_eversion_draws_another_offset() -> None:
    scene = quiet(start_length_cm=20.0)
    scene.noise.per_eversion = 2e-3
    plant = Plant(scene, seed=2)
    first = curvature_read(plant, 1)
    while plant.length_cm > 16.0:
        run(plant, STEP_S, motor=-300)
    while plant.length_cm < 20.0:
        run(plant, STEP_S, motor=300)
    run(plant, 60.0)
    second = curvature_read(plant, 1)
    assert first != 0.0
    assert abs(first - second) > 1e-5


def test_sensor_passing_the_tips_fold_reads_a_tight_bend() -> None:
    plant = Plant(quiet(start_length_cm=10.0))
    peak = 0.0
    while plant.length_cm < 20.0:
        run(plant, STEP_S, motor=200)
        peak = max(peak, abs(curvature_read(plant, 6)))
    assert peak > 0.1
    assert abs(curvature_read(plant, 6)) < 1e-9


def test_cut_and_shorted_sensors_read_the_ends_of_the_scale() -> None:
    plant = out(53.0)
    plant.stuck = {2: OPEN_COUNT, 7: SHORT_COUNT}
    run(plant, 0.1)
    assert plant.analog[2, 1] == 0.0
    assert plant.analog[7, 1] > 1023.0


def test_contact_moves_the_base_sensor_of_the_passive_side() -> None:
    scene = Scene.load("default")
    scene.start_length_cm = 53.0
    plant = Plant(scene)
    ramp(plant, 14.0)
    moment = plant.truth()
    (contact,) = moment.contacts
    assert contact.arc == 53.0
    assert contact.kind in ("corner", "face")
    base = plant.sensor_curvature[5]
    assert base - plant.free_curvature < -0.005
    assert plant.body.model == "elastica"


@pytest.mark.parametrize("model", ["auto", "arc", "beam", "elastica"])
def test_a_scene_file_chooses_its_mechanics_or_leaves_the_choice(
    tmp_path: Path, model: str
) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(f'extends = "default"\nstart_length_cm = 53.0\n[plant]\nmodel = "{model}"\n')
    plant = Plant(Scene.load(file))
    ramp(plant, 14.0)
    used = {name for name, steps in plant.body.counts.items() if steps > 0}
    assert used == ({"arc", "elastica"} if model == "auto" else {model})
    assert (len(plant.truth().contacts) > 0) == (model != "arc")


def test_a_scenes_tolerance_decides_between_beam_and_elastica() -> None:
    def last_model(tolerance: float) -> str:
        scene = quiet(start_length_cm=53.0, pegs=[PegTable(x=30.0, y=2.6, radius=0.6)])
        scene.plant.tolerance_cm = tolerance
        plant = Plant(scene)
        ramp(plant, 2.4)
        assert plant.truth().contacts
        return plant.body.model

    assert last_model(5.0) == "beam"
    assert last_model(1e-3) == "elastica"


def test_truth_is_the_room_and_how_the_body_lies_in_it() -> None:
    scene = Scene.load("default")
    scene.start_length_cm = 53.0
    plant = Plant(scene)
    ramp(plant, 14.0)
    run(plant, 20.0, left=current_for(14.0))
    truth = plant.truth()
    assert truth.pegs == scene.peg_list()
    assert [contact.peg for contact in truth.contacts] == [0]
    assert truth.length_cm == 53.0
    arc, *_, x, y = truth.centreline.T
    assert arc[-1] == pytest.approx(53.0)
    assert np.hypot(np.diff(x), np.diff(y)).sum() == pytest.approx(53.0, rel=1e-3)
    assert plant.body.counts["arc"] > 0
    assert plant.body.counts["elastica"] > 0


def test_same_seed_same_levels_and_another_seed_others() -> None:
    def levels(seed: int) -> list[bytes]:
        plant = Plant(Scene.load("default"), seed=seed)
        snapshots = []
        for _ in range(40):
            run(plant, 0.25, motor=250)
            snapshots.append(plant.analog.tobytes())
        return snapshots

    assert levels(3) == levels(3)
    assert levels(3) != levels(4)


@pytest.mark.sim
@given(
    commands=st.lists(
        st.tuples(
            st.integers(0, 1599), st.integers(0, 1599), st.booleans(), st.booleans(),
            st.integers(-800, 800), st.floats(0.05, 1.5),
        ),
        min_size=1, max_size=8,
    ),
    name=st.sampled_from(["default", "wall", "two_pegs", "ahead"]),
)  # fmt: skip
def test_no_command_breaks_the_plant(
    commands: list[tuple[int, int, bool, bool, int, float]], name: str
) -> None:
    scene = Scene.load(name)
    scene.start_length_cm = 38.0
    plant = Plant(scene)
    for left, right, a, b, motor, seconds in commands:
        for _ in range(round(seconds / STEP_S)):
            plant.step((left, right), (a, b), motor, False)
            assert np.isfinite(plant.analog).all()
            assert (plant.analog >= 0).all()
            assert (plant.analog < 1024).all()
            assert 0 <= plant.length_cm <= 53.0


# The tail's pull: half of body pressure times section, 4.9 N at 1.47 psi.


def test_the_tail_pulls_with_half_the_tips_force_while_it_is_taut() -> None:
    plant = out(20.0)
    for psi, newton in ((1.47, 4.88), (0.49, 1.63)):
        plant.set_body_pressure(psi)
        assert plant.pull_n == pytest.approx(newton, abs=0.01)
    plant.set_body_pressure(0.2)  # too little to evert: what is paid out lies slack
    run(plant, 1.0, motor=300)
    assert plant.pull_n == 0.0


def test_friction_holds_the_usual_pull_and_shorted_windings_only_slow_a_stronger_one() -> None:
    speeds = []
    for holding_n, shorted in ((6.0, True), (4.0, True), (4.0, False)):
        scene = quiet(start_length_cm=20.0)
        scene.robot.spool.holding_n = holding_n
        scene.spool.dead_zone = 15.0  # 2.8 N of sliding friction
        plant = Plant(scene)
        plant.motor_lost = not shorted
        plant.set_body_pressure(1.47)
        run(plant, 1.0)
        before = plant.length_cm
        run(plant, 1.0)
        speeds.append(plant.length_cm - before)
    held, damped, free = speeds
    assert held == 0.0
    assert 0.02 < damped < 1.0  # cm/s of the tip, without end
    assert free > 3 * damped


def test_the_body_drives_the_spool_while_it_grows() -> None:
    plant = out(20.0)
    plant.set_body_pressure(0.49)
    run(plant, 3.0, motor=150)
    slow = plant.length_cm
    helped = out(20.0)
    helped.set_body_pressure(1.47)
    run(helped, 3.0, motor=150)
    assert helped.length_cm > slow + 0.7


def test_a_braked_spool_comes_to_rest_soon_under_the_usual_pull() -> None:
    plant = out(20.0)
    plant.set_body_pressure(1.47)
    run(plant, 2.0, motor=150)
    at = plant.length_cm
    run(plant, 0.5)
    assert plant.length_cm - at < 0.3
    at = plant.length_cm
    run(plant, 5.0)
    assert plant.length_cm == at


def test_a_tail_that_is_stopped_bears_the_motors_pull_and_its_momentum() -> None:
    plant = out(20.0)
    plant.set_body_pressure(0.0)
    run(plant, 0.3, motor=-400)
    plant.tail_jammed = True
    line_cm = plant.line_cm
    run(plant, STEP_S, motor=-400)
    hit_n = plant.line_n
    run(plant, 1.0, motor=-400)
    assert plant.line_n == pytest.approx(147 / 2)
    assert hit_n - plant.line_n == pytest.approx(450 * 0.11, rel=0.2)  # 11 cm/s of line
    assert plant.line_cm == line_cm
    run(plant, 1.0, motor=-800)
    assert plant.line_n == pytest.approx(147)
