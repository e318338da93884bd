"""`localize` on known truths: places, intervals, numbers of contacts, statuses, units."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

import thigmo
from thigmo.design import arc_bounds
from thigmo_bench.studies.rod import readings as true_readings
from thigmo_bench.studies.rod import solve
from thigmo_bench.studies.scenes import STATED

LENGTH, SPAN, SIGMA = 53.0, 5.5, 6e-4
COLUMN = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
BOTH = np.tile(COLUMN, 2)


def felt(arcs, forces, position=BOTH, **scene):
    return true_readings(
        np.atleast_1d(arcs), np.atleast_1d(forces), position, length=LENGTH, span=SPAN, **scene
    )


def find(curvature, position=BOTH, **options):
    robot = STATED | {"length": LENGTH, "span": SPAN, "tube_radius": 1.75, "held_end": False}
    options = robot | {"noise": SIGMA, "critical_curvature": math.inf} | options
    return thigmo.localize(curvature, position, **options)


@pytest.mark.parametrize("arc", [20.0, 30.0, 40.0, 50.0, 53.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_one_contact_without_noise_is_found_where_it_is(arc, sign):
    force = sign * 0.008 / arc
    result = find(felt(arc, force))
    (contact,) = result.contacts
    low, high = contact.interval
    assert low <= arc <= high
    # The posterior of a 6e-4 noise, on clean readings: well within its own deviation.
    assert abs(contact.arc - arc) < 2.0
    assert contact.force * sign > 0.0


def test_no_end_of_a_set_moves_by_more_than_rounding_does():
    # Grids of several explanations cut each other's cells into equally dense parts, one of which
    # may complete a set: that all enter leaves no choice to the last digit of a sum.
    rng = np.random.default_rng(18)
    for _ in range(100):
        arcs = np.array([rng.uniform(18.0, 30.0), rng.uniform(45.0, LENGTH)])
        forces = rng.choice([-1.0, 1.0]) * np.array([-1.0, 1.5]) * rng.uniform(0.003, 0.011) / arcs
        frame = felt(arcs, forces) + SIGMA * rng.standard_normal(10)

        def ends(frame: np.ndarray, odds: float) -> list[float]:
            answer = find(frame, bad_reading_odds=odds)
            return [end for c in answer.contacts for piece in c.intervals for end in piece]

        before = ends(frame, 1e-3)
        for _ in range(4):
            frame_off, odds_off = 1e-13 * rng.uniform(-1.0, 1.0, (2, 10))
            after = ends(frame * (1.0 + frame_off), 1e-3 * (1.0 + odds_off[0]))
            assert after == pytest.approx(before, abs=1e-6)


def test_clean_and_fine_readings_fix_the_place():
    result = find(felt(37.0, 2e-4), noise=1e-7)
    assert result.status == "localized"
    assert result.contacts[0].arc == pytest.approx(37.0, abs=0.1)
    assert result.contacts[0].force == pytest.approx(2e-4, rel=0.01)


def test_free_body_has_no_contact():
    result = find(np.zeros(10))
    assert result.status == "no contact"
    assert result.contacts == ()


def test_false_contacts_stay_below_one_in_a_hundred(many):
    rng = np.random.default_rng(11)
    for position, noise, scenes in ((BOTH, SIGMA, 1200), (COLUMN, SIGMA, 600), (BOTH, None, 200)):
        false = sum(
            bool(find(SIGMA * rng.standard_normal(len(position)), position, noise=noise).contacts)
            for _ in range(many(scenes))
        )
        # Three deviations above 1 %.
        assert false <= 0.01 * many(scenes) + 3.0 * np.sqrt(0.01 * many(scenes))


@pytest.mark.sim
def test_false_second_contacts_stay_below_one_in_twenty(many):
    rng = np.random.default_rng(12)
    counts = Counter()
    for _ in range(many(300)):
        arc = rng.uniform(15.0, LENGTH)
        force = rng.choice([-1.0, 1.0]) * rng.uniform(0.004, 0.011) / arc
        result = find(felt(arc, force) + SIGMA * rng.standard_normal(10))
        counts[len(result.contacts)] += 1
    assert (counts[2] + counts[3]) / counts.total() <= 0.05
    assert counts[0] / counts.total() <= 0.05


@pytest.mark.sim
def test_intervals_cover_what_they_claim_and_the_estimate_is_efficient(many):
    """Scenes of a stated prior; errors against the Cramer-Rao bound inside the body."""
    rng = np.random.default_rng(13)
    inside = confident = wrong = 0
    scaled = []
    scenes = many(500)
    for _ in range(scenes):
        arc = rng.uniform(10.0, LENGTH)
        moment = rng.uniform(0.004, 0.011)
        result = find(felt(arc, moment / arc) + SIGMA * rng.standard_normal(10), contacts=1)
        (contact,) = result.contacts
        low, high = contact.interval
        covered = low - 1e-9 <= arc <= high + 1e-9
        inside += covered
        if contact.status == "localized":
            confident += 1
            wrong += not covered
        (bound,) = arc_bounds(arc, moment / arc, BOTH, SPAN, SIGMA, LENGTH)
        if bound < 2.0 and 12.25 + 3 * bound < arc < LENGTH - 2 * bound:
            scaled.append((contact.arc - arc, bound))
    assert 0.92 <= inside / scenes <= 0.98
    assert wrong / confident <= 0.08
    errors, bounds = np.array(scaled).T
    assert np.sqrt(np.mean(errors**2) / np.mean(bounds**2)) <= 1.2


def test_one_gross_outlier_is_named_and_costs_little():
    rng = np.random.default_rng(14)
    clean, dirty = [], []
    named = 0
    for _ in range(200):
        arc = rng.uniform(25.0, 50.0)
        curvature = felt(arc, 0.009 / arc) + SIGMA * rng.standard_normal(10)
        clean.append(find(curvature, contacts=1).contacts[0].arc - arc)
        victim = int(rng.integers(10))
        curvature[victim] += rng.choice([-1.0, 1.0]) * SIGMA * rng.uniform(8.0, 20.0)
        result = find(curvature, contacts=1)
        dirty.append(result.contacts[0].arc - arc)
        named += victim in result.discarded
    assert np.sqrt(np.mean(np.square(dirty))) <= 1.5 * np.sqrt(np.mean(np.square(clean)))
    assert named >= 150


def test_two_opposed_contacts_are_told_apart_at_18_5_cm():
    rng = np.random.default_rng(15)
    truth = (LENGTH - 18.5, LENGTH)
    clean = felt(truth, (-0.02 / truth[0], 0.03 / truth[1]))
    errors, found_both, localized = [], 0, 0
    for _ in range(200):
        frame = clean + SIGMA * rng.standard_normal(10)
        result = find(frame)
        found_both += len(result.contacts) == 2
        if len(result.contacts) != 2:
            continue
        errors.append([c.arc - t for c, t in zip(result.contacts, truth, strict=True)])
        localized += find(frame, contacts=2).status == "localized"
    assert found_both >= 190
    assert np.sqrt(np.mean(np.square(errors))) < 2.5
    assert localized >= 100


def test_two_contacts_that_no_sensor_parts_are_not_placed_wrongly():
    """13 cm apart between centres 5..45: one sensor sees the region between them."""
    rng = np.random.default_rng(16)
    truth = (LENGTH - 13.0, LENGTH)
    wrong = 0
    for moments in ((-0.016, 0.02), (-0.02, 0.03)):
        clean = felt(truth, (moments[0] / truth[0], moments[1] / truth[1]))
        for _ in range(15):
            result = find(clean + SIGMA * rng.standard_normal(10))
            wrong += any(
                contact.status == "localized"
                and not any(contact.interval[0] <= arc <= contact.interval[1] for arc in truth)
                for contact in result.contacts
            )
    assert wrong <= 1


def test_a_contact_before_the_second_sensor_is_an_interval():
    """Only the product of force and lever is known there."""
    result = find(felt(10.0, 0.01 / 5.0), noise=2e-4)
    (contact,) = result.contacts
    assert contact.interval[0] <= 10.0 <= contact.interval[1]
    assert contact.interval[1] - contact.interval[0] > 7.0


def test_two_informative_readings_are_enough():
    position = np.array([5.0, 15.0])
    result = find(felt(40.0, 3e-4, position), position, noise=1e-5)
    (contact,) = result.contacts
    assert contact.interval[0] <= 40.0 <= contact.interval[1]
    assert contact.arc == pytest.approx(40.0, abs=1.0)
    missing = np.full(10, np.nan)
    missing[[0, 6]] = felt(40.0, 3e-4)[[0, 6]]
    again = find(missing, noise=1e-5)
    assert again.contacts[0].arc == pytest.approx(contact.arc, abs=1e-6)


@pytest.mark.parametrize("unit", [10.0, 0.01])
@pytest.mark.parametrize("noise", [SIGMA, None])
def test_units_of_length_do_not_matter(unit, noise):
    rng = np.random.default_rng(17)
    curvature = felt((30.0, LENGTH), (-6e-4, 5e-4)) + SIGMA * rng.standard_normal(10)
    rest = 0.05 * BOTH / LENGTH  # of a body that is curved along its length
    single = find(curvature, noise=noise, free_curvature=0.01, body_curvature=rest)
    scaled = thigmo.localize(
        curvature / unit,
        BOTH * unit,
        length=LENGTH * unit,
        span=SPAN * unit,
        noise=None if noise is None else noise / unit,
        free_curvature=0.01 / unit,
        body_curvature=rest / unit,
        tube_radius=1.75 * unit,
        held_end=False,
        critical_curvature=math.inf,
        **STATED,
    )
    assert (scaled.status, scaled.hypothesis) == (single.status, single.hypothesis)
    for contact, scaled_contact in zip(single.contacts, scaled.contacts, strict=True):
        assert scaled_contact.arc / unit == pytest.approx(contact.arc, abs=1e-4)
        assert scaled_contact.force * unit**2 == pytest.approx(contact.force, rel=1e-4)
        assert np.array(scaled_contact.interval) / unit == pytest.approx(
            np.array(contact.interval), abs=1e-4
        )


def test_a_common_offset_widens_the_interval_beyond_the_last_sensor():
    curvature = felt(50.0, 0.008 / 50.0) + 5e-4
    plain = find(curvature, contacts=1).contacts[0].interval
    wary = find(curvature, contacts=1, offset_error=5e-4).contacts[0].interval
    assert wary[1] - wary[0] > plain[1] - plain[0] + 1.0
    assert wary[0] <= 50.0 <= wary[1]


@pytest.mark.parametrize("seed", [1989, 6278])
def test_a_push_on_the_end_that_is_all_but_impossible_is_no_error(seed: int) -> None:
    # So strong a bend that hardly any place on the end can push: its weight came to nothing.
    rng = np.random.default_rng((0, seed))
    arc = rng.uniform(0.0, LENGTH)
    moment = rng.normal(0.0, (0.4, 1.5)[rng.choice(2, p=(0.92, 0.08))]) / LENGTH
    clean = felt(arc, moment / max(arc, 0.5))
    assert find(clean + SIGMA * rng.standard_normal(10)).contacts


@pytest.mark.parametrize("seed", [4, 9, 10, 42, 51])
def test_three_contacts_are_not_one_and_a_row_of_outliers(seed: int) -> None:
    # Two explain less than one, a tip moment and ten outliers; three explain all.
    rng = np.random.default_rng([31, seed])
    arcs = np.sort([rng.uniform(10, 17), rng.uniform(26, 34), rng.uniform(44, 53)])
    side = rng.choice([-1, 1])
    forces = np.array([side, -side, side]) * rng.uniform(0.008, 0.02, 3) / arcs
    position = np.linspace(2.5, 50.5, 20)
    clean = true_readings(arcs, forces, position, length=53.0, span=2.0)
    result = thigmo.localize(
        clean + 1e-4 * rng.standard_normal(20), position, length=53.0, span=2.0, noise=1e-4,
        **STATED,
    )  # fmt: skip
    assert result.status == "localized"
    assert [contact.arc for contact in result.contacts] == pytest.approx(arcs, abs=1.0)


def test_three_contacts_are_left_out_of_frames_that_hardly_have_them():
    rng = np.random.default_rng(7)
    fine = np.linspace(2.75, 50.25, 20)

    def weighed(position, arcs, forces):
        noisy = felt(arcs, forces, position) + SIGMA * rng.standard_normal(position.size)
        return "three contacts" in find(noisy, position).hypotheses

    single_contacts = [weighed(BOTH, [arc], [0.006 / arc]) for arc in rng.uniform(15.0, 53.0, 200)]
    three = [weighed(fine, [20.0, 35.0, 50.0], [9e-4, -6e-4, 3e-4]) for _ in range(50)]
    assert np.mean(single_contacts) < 0.5
    assert np.mean(three) > 0.9


def test_number_and_places_of_two_bent_contacts_are_two_claims():
    # One contact explains these readings too, 500 times worse: a gate on misfit missed the second.
    x, arcs, forces = np.linspace(2.75, 50.25, 20), [22.9, 45.8], [-2.68e-4, -2.03e-4]
    body = solve(np.array([arcs]), np.array([forces]), length=LENGTH, free_curvature=0.0031)
    clean = body.readings(x, SPAN)[0]
    for seed in range(20):
        noisy = clean + SIGMA * np.random.default_rng(seed).standard_normal(20)
        answer = find(noisy, x, free_curvature=0.0031)
        assert sum(answer.number) == pytest.approx(1.0)
        assert answer.number[2] + answer.number[3] > 0.3
        for contact in answer.contacts:
            low, high = contact.interval
            assert contact.status != "localized" or any(low <= arc <= high for arc in arcs)


def test_two_contacts_that_one_explains_are_seldom_placed_between_them():
    # Near each other and to the same side they bend the body as one between them does, to within
    # the noise. One is likelier, and its densest places hold neither.
    x = np.linspace(2.75, 50.25, 20)
    pairs = {(31.0, 41.5): 0.02, (26.0, 36.0): 0.012, (35.0, 47.0): 0.012, (38.0, 50.0): 0.018}
    localized = wrong = said = 0
    for arcs, moment in pairs.items():
        clean = felt(arcs, moment / np.array(arcs), x)
        for seed in range(40):
            answer = find(clean + SIGMA * np.random.default_rng(seed).standard_normal(20), x)
            placed = [contact for contact in answer.contacts if contact.status == "localized"]
            localized += bool(placed)
            wrong += any(
                not any(low <= arc <= high for low, high in contact.intervals for arc in arcs)
                for contact in placed
            )
            said += "give `contacts`" in answer.message
    assert localized >= 80
    assert wrong <= 0.18 * localized
    assert said >= 20


def test_a_number_that_is_not_certain_enough_localizes_nothing_if_asked():
    frame = felt(47.0, 4e-4) + SIGMA * np.random.default_rng(4).standard_normal(10)
    answer = find(frame)
    assert answer.status == "localized"
    assert find(frame, number_level=answer.number[1] - 0.01).status == "localized"
    assert find(frame, number_level=answer.number[1] + 0.01).status == "ambiguous"


def test_every_contact_has_its_mass_and_two_have_a_joint_one():
    clean = felt(20.0, -9e-4) + felt(48.0, 5e-4)
    answer = find(clean + SIGMA * np.random.default_rng(3).standard_normal(10))
    assert len(answer.contacts) == len(answer.marginals) == 2
    for contact, (edges, mass, *_) in zip(answer.contacts, answer.marginals, strict=True):
        assert mass.sum() == pytest.approx(1.0)
        assert (edges[0], edges[-1]) == (0.0, pytest.approx(LENGTH))
        low, high = contact.interval
        inside = mass[(edges[:-1] >= low - 1e-9) & (edges[1:] <= high + 1e-9)].sum()
        assert inside >= 0.95
    assert answer.joint is not None
    assert 0.9 < answer.joint.mass.sum() <= 1.0 + 1e-9
    near = 0.5 * (answer.joint.near_edges[1:] + answer.joint.near_edges[:-1])
    assert answer.joint.mass.sum(axis=1) @ near == pytest.approx(answer.contacts[0].arc, abs=2.0)
    assert find(felt(40.0, 2e-4)).joint is None


def test_a_marginal_has_every_cell_of_the_grid_and_nothing_beyond():
    only = {"contacts": 1, "end_face_odds": 0.0, "held_end": False, "critical_curvature": math.inf}
    edges, mass, *_ = find(felt(30.0, 9e-4), bad_reading_odds=1e-12, **only).marginals[0]
    assert (mass > 0.0).sum() == 60
    assert mass[0] == mass[-1] == 0.0
    assert np.ptp(np.diff(edges)[mass > 0.0]) < 1e-9


def test_what_a_contact_explains_is_listed_even_if_sensors_are_said_to_be_bad():
    free = 0.03
    reading = felt(10.0, -8e-4, COLUMN, free_curvature=free)  # 7 deviations at the first sensor
    result = find(reading, COLUMN, free_curvature=free, bad_reading_odds=1e3)
    (contact,) = result.contacts
    assert contact.probability < 0.5
    assert result.status == "ambiguous"


@pytest.mark.parametrize("force", [2.2e-4, 3e-4])  # bends of 0.26 and 0.36 rad
def test_a_bent_rod_may_be_held_at_its_end_unless_it_is_said_not_to_be(force):
    reading = felt(49.0, force, COLUMN)
    free, any_rod = find(reading, COLUMN), find(reading, COLUMN, held_end=None)
    assert free.status == "localized"
    assert any_rod.status == "ambiguous"
    assert any_rod.hypotheses["end wrench"] > 0.005
    assert "give held_end" in any_rod.message
    unlikely = find(reading, COLUMN, held_end=1e-4)
    assert unlikely.hypotheses.get("end wrench", 0.0) < 0.1 * any_rod.hypotheses["end wrench"]


@pytest.mark.parametrize("force", [-2e-4, -4e-4])
@pytest.mark.parametrize("sensor", [1, 2, 3])
@pytest.mark.parametrize("angle", [0.3, 0.5])
def test_a_kink_under_a_sensor_is_told_from_a_bad_reading_or_beside_it(force, sensor, angle):
    arcs, forces, kink = [COLUMN[sensor], 50.0], [0.0, force], np.array([[angle, 0.0]])
    answer = find(
        felt(arcs, forces, COLUMN, free_curvature=0.03, kink=kink), COLUMN, free_curvature=0.03
    )
    share = answer.hypotheses["one contact, hinge"]
    if angle == 0.5:
        assert answer.hypothesis == "one contact, hinge"
        assert share > 0.8
    else:
        assert answer.discarded == (sensor,)
        assert f"or the body is kinked there (probability {share:.2f})" in answer.message
        assert share > 0.3


def test_a_fold_at_a_moment_that_nobody_gives_is_weighed_and_none_is_not():
    clean = felt(40.0, 2.5e-4) + np.tile([0.3 / SPAN, 0.0, 0.0, 0.0, 0.0], 2)
    noisy = clean + SIGMA * np.random.default_rng(5).standard_normal(10)
    unsaid = find(noisy, critical_curvature=None)
    assert unsaid.hypotheses["one contact, hinge"] > 0.5
    low, high = unsaid.contacts[-1].interval
    assert low < 40.0 < high
    plain = 2e-4 * np.maximum(16.6 - BOTH, 0.0)
    assert find(plain).hypotheses.get("one contact, hinge", 0.0) < 0.01


def test_an_empty_frame_of_two_sensors_has_no_contact():
    rng = np.random.default_rng(6)
    two = COLUMN[:2]
    statuses = Counter(find(SIGMA * rng.standard_normal(2), two).status for _ in range(200))
    assert statuses["no contact"] > 180


def test_one_reading_of_unknown_noise_is_not_called_free():
    assert find([0.004], [25.0], noise=None).status == "below detection"


@pytest.mark.parametrize("contacts", ["auto", 1])
def test_forces_are_no_surer_than_they_may_be(contacts, many):
    rng = np.random.default_rng(11)
    off, off_where_it_is = [], []
    for _ in range(many(100)):
        arc = rng.uniform(25.0, 50.0)
        force = 0.008 / arc
        answer = find(felt(arc, force) + SIGMA * rng.standard_normal(10), contacts=contacts)
        contact, marginal = answer.contacts[0], answer.marginals[0]
        cell = np.searchsorted(marginal.edges, arc) - 1
        off.append((contact.force - force) / contact.force_deviation)
        off_where_it_is.append((marginal.force[cell] - force) / marginal.force_deviation[cell])
    for distances in (off, off_where_it_is):
        assert 0.2 < np.sqrt(np.mean(np.square(distances))) < 1.2


def test_a_weak_touch_near_the_tip_is_not_put_far_from_it(many):
    rng = np.random.default_rng(12)
    off = []
    for _ in range(many(150)):
        arc = rng.uniform(45.0, LENGTH)
        force = rng.choice([-1.0, 1.0]) * 0.0011 / arc
        reading = felt(arc, force) + SIGMA * rng.standard_normal(10)
        off += [abs(contact.arc - arc) for contact in find(reading).contacts[-1:]]
    assert np.mean(off) < 10.5  # least squares is 9.5 cm off, a prior even over the body 12.0


def test_an_answer_is_the_same_whatever_was_answered_before():
    whole, lost = felt(30.0, 3e-4), felt(30.0, 3e-4)
    lost[3] = math.nan
    calls = (
        lambda: find(whole),
        lambda: find(lost),
        lambda: find(whole, span=2.0),
        lambda: find(felt(37.0, 2e-4, BOTH + 1.0), BOTH + 1.0),
        lambda: find(felt(37.0, 2e-4, COLUMN), COLUMN),
        lambda: find(whole + 0.03, free_curvature=0.03),
        lambda: find(felt([20.0, 45.0], [9e-4, -9e-4])),
    )
    first = [call() for call in calls]
    for k in (6, 0, 5, 2, 0, 1, 1, 3, 4, 2, 6, 3, 5, 4):
        again = calls[k]()
        assert again.hypotheses == first[k].hypotheses
        assert again.contacts == first[k].contacts


def test_couple_on_a_held_end_bends_the_whole_body():
    noise = SIGMA * np.random.default_rng(5).standard_normal(10)
    answer = find(0.01 + noise, held_end=True)
    assert answer.hypothesis == "end wrench"
    assert answer.bend[:, 0] == pytest.approx(np.linspace(0.0, LENGTH, len(answer.bend)))
    assert answer.bend[:, 1] == pytest.approx(0.01, abs=4.0 * SIGMA)
