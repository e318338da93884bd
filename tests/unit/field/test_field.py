"""One fit to all sweeps of a side: its evidence, its search, and pegs of an independent rod."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from thigmo.field import (
    Atlas,
    Errors,
    FieldContact,
    Readings,
    Stage,
    contacts,
    partial_answer,
)
from thigmo.field.answer import SCARCE_WORDS, _widened
from thigmo.field.fit import ALIKE, FieldFit
from thigmo.field.hypotheses import (
    AHEAD,
    ARC,
    BEND,
    NOTHING,
    PEG,
    PEGS,
    SHARED_UNKNOWNS,
    WALL,
    Body,
    Hypothesis,
    faced,
    touched,
    untouched,
)
from thigmo.field.hypotheses import RADIUS as RADIUS_LOG
from thigmo.field.posterior import laplace
from thigmo.field.proposals import Bell
from thigmo.field.search import Search
from thigmo.mechanics import Peg, Rod, Tube
from thigmo_bench.studies.obstructed import Mechanics, Obstacles, Sweeper, Swept
from thigmo_bench.studies.pegs import inflate, press

RADIUS = 1.75
CENTERS = np.array([5.0, 16.0, 27.0, 38.0, 47.0])
SPANS = np.full(5, 5.5)
NOISE = 2e-4
LENGTHS = (40.0, 50.0, 53.0)
FREE = np.linspace(2e-3, 0.022, 12)


def _errors(sensors: int = 5, **given: float) -> Errors:
    stated = {"gain": 0.03, "place": 0.1, "zero": 2e-4, "zero_zeroing": 1e-4, "zero_sweep": 5e-5}
    columns = {name: np.full(sensors, sd) for name, sd in stated.items()}
    return replace(
        Errors(**columns, map_by_pressure=np.array([0.01]), map_offset=8e-4, fold=0.1), **given
    )


def _readings(rows: dict[float, np.ndarray], scale: float = 1.0) -> Readings:
    """Bins of one sweep at each everted length; `scale` makes a body that much longer."""
    lengths = sorted(rows)
    number = np.repeat(np.arange(len(lengths)), FREE.size)
    shape = number.size, CENTERS.size
    return Readings(
        curvature=np.concatenate([rows[length] for length in lengths]) / scale,
        noise=np.full(shape, NOISE / scale),
        bend=np.tile(FREE, len(lengths)) / scale,
        rate=np.full(number.size, 0.005 / scale),
        stage=number,
        sweep=number,
        zeroing=number,
        stages=tuple(Stage(length * scale, 0) for length in lengths),
        centers=CENTERS * scale,
        spans=SPANS * scale,
        fold_moment=np.array([0.2 / scale]),
        radius=RADIUS * scale,
    )


def _untouched(length: float, rng: np.random.Generator) -> np.ndarray:
    clean = np.tile(FREE[:, None], (1, CENTERS.size))
    clean[:, length < CENTERS + SPANS / 2] = np.nan
    return clean + NOISE * rng.standard_normal(clean.shape)


def _beside_peg(
    arc: float, bend: float, peg_radius: float, length: float, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[float, float, float]]:
    """Readings of the studies' rod, and its contact's arc and place at the sweep's end."""
    u, touch, radii = np.array([arc]), np.array([bend]), np.array([peg_radius])
    place, push = inflate(u, touch, FREE[:, None], radii, length)
    read = _untouched(length, rng)
    for k in np.flatnonzero(np.isfinite(place[:, 0])):
        bodies, _ = press(place[k], push[k], FREE[k : k + 1], radii, length)
        present = np.isfinite(read[k])
        (clean,) = bodies.readings(CENTERS, SPANS)
        read[k, present] = clean[present] + NOISE * rng.standard_normal(int(present.sum()))
    peg = touched(arc, bend, peg_radius, RADIUS)
    return read, (float(place[-1, 0]), peg.x, peg.y)


def _among(
    obstacles: Obstacles, rng: np.random.Generator
) -> tuple[dict[float, np.ndarray], dict[float, Swept]]:
    """Readings among obstacles (1, P) at each length, and the independent rod's sweeps."""
    rows, swept = {}, {}
    for length in LENGTHS:
        body = Mechanics.ideal(1, length=length, radius=RADIUS, critical=0.2)
        swept[length] = Sweeper(body, obstacles).sweep(FREE[:, None], CENTERS, float(SPANS[0]))
        assert not swept[length].ended.any()
        rows[length] = swept[length].readings[:, 0] + NOISE * rng.standard_normal(
            (FREE.size, CENTERS.size)
        )
        rows[length][:, length < CENTERS + SPANS / 2] = np.nan
    return rows, swept


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    return Atlas(53.0, 0.024)


def _one(answer: list[FieldContact]) -> FieldContact:
    (contact,) = answer
    return contact


def test_a_place_is_named_by_the_touch_of_the_free_body() -> None:
    peg = touched(30.0, 0.012, 1.0, RADIUS)
    bends = np.arange(0.0, 0.02, 5e-4)
    first = untouched(peg, 53.0, RADIUS, bends)
    assert bends[first] <= 0.012 <= bends[first + 2]
    rod = Rod(Tube(2 * RADIUS), [peg])
    rod.step(0.0119, 53.0)
    assert not rod.touching
    rod.step(0.0123, 53.0)
    (contact,) = rod.contacts()
    assert contact.arc == pytest.approx(30.0, abs=0.3)


@pytest.mark.parametrize(("arc", "bins"), [(34.0, 3), (34.0, 5), (22.0, 4)])
def test_a_peg_that_gives_way_is_found_with_its_place(atlas: Atlas, arc: float, bins: int) -> None:
    rng = np.random.default_rng(5)
    rows, (true_arc, x, y) = {}, (np.nan, np.nan, np.nan)
    for length in (40.0, 50.0):
        rows[length], place = _beside_peg(arc, 0.010, 0.6, length, rng)
        touched_from = int(np.argmax(FREE > 0.010))
        gone = touched_from + bins if length == 40.0 else 0
        rows[length][gone:] = _untouched(length, rng)[gone:]
        if length == 40.0:
            true_arc, x, y = place
    contact = _one(contacts(_readings(rows), _errors(), atlas))
    assert contact.gave_way_at == pytest.approx(FREE[touched_from + bins - 1], abs=0.002)
    assert contact.felt_at_cm == (40.0,)
    low, high = contact.interval_cm
    assert low - 0.3 < true_arc < high + 0.3
    away = float(np.hypot(contact.x_cm - x, contact.y_cm - y))
    assert away < 0.6 + 2.45 * np.sqrt(np.linalg.eigvalsh(contact.covariance_cm2)[-1])


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_a_peg_that_stands_has_not_given_way(atlas: Atlas, friction: float) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        arc, bend = rng.uniform(15.0, 48.0), rng.uniform(0.006, 0.016)
        peg = touched(arc, bend, 0.6, RADIUS)
        rows = {}
        for length in LENGTHS:
            rod = Rod(Tube(2 * RADIUS, 0.2), [peg], friction=friction)
            rows[length] = rod.sweep(FREE, length, CENTERS, SPANS).readings
            rows[length] = rows[length] + NOISE * rng.standard_normal(rows[length].shape)
            rows[length][:, length < CENTERS + SPANS / 2] = np.nan
        answer = contacts(_readings(rows), _errors(), atlas)
        assert all(contact.gave_way_at is None for contact in answer)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_prior_density_over_touches_is_even_over_the_plane(scale: float) -> None:
    body = Body(RADIUS * scale, 53.0 * scale, 0.03 / scale, 0.1, 1.0)
    small = 1e-4
    for arc, bend in ((20.0, 0.01), (45.0, 0.006), (30.0, 0.02)):
        a, b, r = arc * scale, bend / scale, np.log(0.5)
        q = PEG.columns((a, b, r), 0.0, 0.0, 0.0, 0.0)
        corner, along, onward = (
            touched(a + da, b + db, RADIUS * scale * 0.5, RADIUS * scale)
            for da, db in ((0.0, 0.0), (small * a, 0.0), (0.0, small * b))
        )
        swept = abs(
            (along.x - corner.x) * (onward.y - corner.y)
            - (along.y - corner.y) * (onward.x - corner.x)
        ) / (small * a * small * b)
        dense = PEG.log_prior(q, body) - np.log(swept)
        at_body = PEG.log_prior(
            PEG.columns((25.0 * scale, 0.012 / scale, r), 0.0, 0.0, 0.0, 0.0), body
        )
        turn = 25.0 * 0.012
        area = (1 - 1.5 * RADIUS * 0.012) * (1 - np.cos(turn)) / (0.012 / scale) ** 2
        assert dense == pytest.approx(at_body - np.log(area), abs=2e-3)


def test_the_evidence_is_the_integral_over_the_errors() -> None:
    rng = np.random.default_rng(2)
    readings = _readings({53.0: _untouched(53.0, rng)})
    none = np.zeros(5)
    errors = Errors(
        gain=none, place=none, zero=none, zero_zeroing=none, zero_sweep=none,
        map_by_pressure=np.zeros(1), map_offset=0.0, fold=0.1, map=0.05, sweep=0.0,
        sweep_offset=0.0, lag_s=0.0, bend_bin=0.0,
    )  # fmt: skip
    fit = FieldFit(readings, errors)
    evidence, best, _ = fit.evidence(fit.tables(NOTHING, np.zeros(0)), fit.free())
    # Of the map's scale alone, by the trapezoidal rule.
    xi = np.linspace(-6.0, 6.0, 4001)
    left = (readings.curvature - readings.bend[:, None])[None] - (
        0.05 * xi[:, None, None] * readings.bend[:, None]
    )
    log = -0.5 * np.sum((left / NOISE) ** 2, axis=(1, 2)) / ALIKE - 0.5 * xi**2
    dense = np.log(np.trapezoid(np.exp(log - log.max()), xi) / np.sqrt(2 * np.pi)) + log.max()
    assert evidence == pytest.approx(dense, abs=1e-3)
    assert best[0] == pytest.approx(float(xi[np.argmax(log)]), abs=5e-3)


def _first_bins(readings: Readings, count: int) -> Readings:
    """The first bins of all sweeps."""
    part = slice(count)
    return replace(
        readings, curvature=readings.curvature[part], noise=readings.noise[part],
        bend=readings.bend[part], rate=readings.rate[part], stage=readings.stage[part],
        sweep=readings.sweep[part], zeroing=readings.zeroing[part],
    )  # fmt: skip


@pytest.mark.parametrize(("arc", "bend"), [(33.0, 0.012), (45.0, 0.010), (51.0, 0.009)])
def test_a_sweep_that_goes_on_says_where_a_peg_is(arc: float, bend: float, atlas: Atlas) -> None:
    rng = np.random.default_rng(5)
    sweeps = {length: _beside_peg(arc, bend, 0.8, length, rng)[0] for length in LENGTHS}
    whole = _readings(sweeps)
    until = whole.bend.size - FREE.size + int(np.searchsorted(FREE, bend))  # the last one's touch
    answers = [
        partial_answer(_first_bins(whole, until + after), _errors(), atlas) for after in (2, 4)
    ]
    for answer in answers:
        assert answer.weights.sum() == pytest.approx(1.0)
        assert answer.probability > 0.95
        mean = answer.weights @ answer.arcs
        assert mean == pytest.approx(arc, abs=1.2 * answer.spacing_cm)


def test_a_sweep_that_has_touched_nothing_says_so(atlas: Atlas) -> None:
    rng = np.random.default_rng(6)
    readings = _readings({length: _untouched(length, rng) for length in LENGTHS})
    assert partial_answer(_first_bins(readings, 30), _errors(), atlas).probability < 0.5


def test_a_known_error_of_calibration_is_found() -> None:
    rng = np.random.default_rng(3)
    rows = {length: _untouched(length, rng) for length in LENGTHS}
    for read in rows.values():
        read[:, 1] *= 1.05
    fit = FieldFit(_readings(rows), _errors())
    value = fit.departures(fit.nothing().tables, fit.nothing().xi).value
    late = fit.readings.bend > 0.018
    apart = value[late, 1] / value[late, 2]
    assert apart.mean() == pytest.approx(1.05, abs=0.015)


@pytest.mark.parametrize(
    ("fold", "friction", "unknowns", "share"),
    [
        (0.01, 0.0, [ARC, BEND, RADIUS_LOG, 3, 5, 6], 1e-2),
        (1.0, 0.2, [4], 0.15),  # what slips has a history, which the solver's derivatives lack
    ],
)
def test_derivatives_are_those_of_the_readings(
    fold: float, friction: float, unknowns: list[int], share: float
) -> None:
    rng = np.random.default_rng(4)
    rows = {length: _untouched(length, rng) for length in LENGTHS}
    fit = FieldFit(replace(_readings(rows), fold_moment=np.array([fold])), _errors())
    q = PEG.columns((34.0, 0.009, -0.6), 0.05, friction, 0.3, 0.03)
    xi = 0.1 * rng.standard_normal(fit.count)
    tables = fit.tables(PEG, q)
    by_q = fit.by_q(tables, fit.departures(tables, xi))
    steps = PEG.columns((1e-2, 1e-6, 1e-3), 1e-3, 1e-3, 1e-3, 1e-4)
    for i in unknowns:
        ends = [
            fit.departures(fit.tables(PEG, q + sign * steps * (np.arange(q.size) == i)), xi).value
            for sign in (1, -1)
        ]
        differences = (ends[0] - ends[1]) / (2 * steps[i])
        size = np.nanmax(np.abs(differences))
        assert size > 0.0
        off = np.abs(by_q[..., i] - differences)
        # The row in which the base folds is another one for a moved peg.
        assert np.nanquantile(off, 0.9) < share * size


@pytest.mark.parametrize("way", [0.0, 0.3, 0.5, 0.8])
def test_a_bin_reads_the_mean_of_its_frames_across_a_touch(way: float) -> None:
    """The touch lies so far along the bin; readings turn there, so their mean is not the middle."""
    touch, half = 0.0095, 1.5e-3
    frames = touch + half * (np.linspace(-1.0, 1.0, 41) + 1 - 2 * way)
    peg = touched(30.0, touch, 0.8, RADIUS)
    rod = Rod(Tube(2 * RADIUS, 0.2), [peg])
    frame_readings = rod.sweep(frames, 53.0, CENTERS, SPANS).readings
    readings = replace(
        _readings({53.0: np.zeros((FREE.size, CENTERS.size))}),
        bend=np.full(FREE.size, frames.mean()), half_range=np.full(FREE.size, half),
    )  # fmt: skip
    fit = FieldFit(readings, _errors())
    tables = fit.tables(PEG, PEG.columns((30.0, touch, np.log(0.8 / RADIUS)), 0.0, 0.0, 0.0, 0.0))
    (mean,) = np.unique(fit.departures(tables, fit.free()).value, axis=0)
    assert mean == pytest.approx(frame_readings.mean(axis=0), abs=1e-4)
    if way == 0.5:  # as a single frame in the middle it would read far more
        at_mean = rod.sweep(frames[20:21], 53.0, CENTERS, SPANS).readings[0]
        assert np.abs(at_mean - mean).max() > 2e-4


@pytest.mark.parametrize(
    ("hypothesis", "q", "known"),
    [
        (PEGS, [22.0, 0.012, -0.6, 47.0, 0.007, -0.9, 0.05, 0.0, 0.3, 0.03], 6),
        (WALL, [0.006, 0.3, -0.8, 0.6, 0.05, 0.0, 0.2, 0.03], 2),
        # Touched at the end at the base's side, and at the other end, past which bodies slip.
        (WALL, [0.009, 0.2, -2.5, 0.6, 0.05, 0.0, 0.2, 0.03], 3),
        (WALL, [0.005, 0.2, -0.8, -0.12, 0.05, 0.0, 0.2, 0.03], 3),
    ],
)
def test_derivatives_by_two_pegs_and_by_a_wall(
    hypothesis: Hypothesis, q: list[float], known: int
) -> None:
    rng = np.random.default_rng(4)
    rows = {length: _untouched(length, rng) for length in LENGTHS}
    fit = FieldFit(replace(_readings(rows), fold_moment=np.array([0.01])), _errors())
    unknowns = np.array(q)
    assert hypothesis.possible(unknowns, fit.body)
    xi = fit.free()
    tables = fit.tables(hypothesis, unknowns)
    exact = fit.by_q(tables, fit.departures(tables, xi))
    steps = hypothesis.columns((1e-2, 1e-6, 1e-3), 1e-3, 1e-3, 1e-3, 1e-4, (1e-6, 1e-3, 1e-3, 1e-3))
    felt = list[float]()
    for i in range(hypothesis.unknowns - SHARED_UNKNOWNS):
        low, high = (
            fit.departures(
                fit.tables(hypothesis, unknowns + way * steps * (np.arange(unknowns.size) == i)), xi
            ).value
            for way in (-1.0, 1.0)
        )
        differences = (high - low) / (2 * steps[i])
        felt.append(np.abs(differences).max())
        # A wall that is touched in its middle does not show where it ends.
        off = np.abs(exact[..., i] - differences)
        assert np.quantile(off, 0.9) < 1e-2 * felt[-1] + 1e-12
    assert np.count_nonzero(np.array(felt) > 1e-9) == known


@pytest.mark.sim
@pytest.mark.parametrize(
    ("pegs", "explained_by"),
    [
        ([touched(24.0, 0.014, 0.8, RADIUS), touched(46.0, 0.009, 1.2, RADIUS)], {"two pegs"}),
        # Each is met at other lengths, and one peg between them leaves no more than is usual. A
        # wall through both is as good: which of the two it is, five sensors do not say.
        ([Peg(34.5, 13.5, 1.0), Peg(43.0, 16.0, 1.0)], {"two pegs", "wall"}),
    ],
)
def test_two_pegs_of_the_independent_rod_are_no_peg_between_them(
    pegs: list[Peg], explained_by: set[str], atlas: Atlas
) -> None:
    first, second = pegs
    obstacles = Obstacles(
        np.array([[first.x, second.x]]), np.array([[first.y, second.y]]),
        np.array([[first.radius, second.radius]]), np.full((1, 2), np.nan), np.zeros((1, 2)),
    )  # fmt: skip
    rows, swept = _among(obstacles, np.random.default_rng(5))
    answer = contacts(_readings(rows), _errors(), atlas)
    likeliest = max(answer[0].explanations, key=answer[0].explanations.__getitem__)
    assert likeliest in explained_by
    touched_pegs = []
    for contact in answer:
        touches = swept[contact.length_cm].contacts[-1, 0]
        off = touches[:, 1:] - [contact.x_cm, contact.y_cm]
        away = np.hypot(*off.T)
        assert np.nanmin(away) < 1.5
        touched_pegs.append(int(np.nanargmin(away)))
        nearest = off[touched_pegs[-1]]
        assert nearest @ np.linalg.solve(contact.covariance_cm2, nearest) < 9.0
    assert sorted(touched_pegs) == [0, 1] or likeliest == "wall"


@pytest.mark.sim
def test_two_pegs_are_followed_only_where_they_are_likelier_than_one_that_holds(
    atlas: Atlas,
) -> None:
    rng = np.random.default_rng(5)
    rows = {length: _beside_peg(30.0, 0.011, 1.0, length, rng)[0] for length in LENGTHS}
    search = Search(_readings(rows), _errors(), atlas)
    peg = min((mode for chain in search.ridges() for mode in chain), key=lambda mode: mode.cost)
    assert search.pairs(peg.q, holds=True) == []
    assert search.pairs(peg.q) != []


@pytest.mark.sim
def test_a_wall_of_the_independent_rod_is_likelier_than_pegs(atlas: Atlas) -> None:
    body = Body(RADIUS, 53.0, 0.03, 0.1, 1.0)
    wall = faced(np.array([0.007, 0.35, -0.7, 0.6]), body)
    angle = np.arctan2(wall.end_y - wall.y, wall.end_x - wall.x)
    obstacles = Obstacles(
        np.array([[wall.x]]), np.array([[wall.y]]), np.array([[wall.radius]]),
        np.array([[angle]]), np.zeros((1, 1)),
    )  # fmt: skip
    rows, swept = _among(obstacles, np.random.default_rng(5))
    search = Search(_readings(rows), _errors(), atlas)
    (wall_mode,), *_ = search.walls()
    pegs = [mode for chain in search.ridges() + search.pairs() for mode in chain]
    assert laplace(search, wall_mode) > max(laplace(search, peg) for peg in pegs) + 3.0
    assert wall_mode.q[:2] == pytest.approx([0.007, 0.35], rel=0.05)
    assert np.nanmin(swept[53.0].contacts[-1, 0, :, 0]) == pytest.approx(53.0)  # the end slides


@pytest.mark.sim
@pytest.mark.parametrize(
    ("bend", "ahead"),
    [(0.009, -0.06), (0.013, -0.06)],  # of the second, one peg leaves no more than is usual
)
def test_a_wall_that_longer_bodies_slip_past_ends_where_it_ends(
    bend: float, ahead: float, atlas: Atlas
) -> None:
    rng = np.random.default_rng(5)
    body = Body(RADIUS, 53.0, 0.03, 0.1, 1.0)
    wall = faced(np.array([bend, 0.45, -1.2, ahead]), body)
    rows, ends = {}, {}
    for length in LENGTHS:
        swept = Rod(Tube(2 * RADIUS, 0.2), [wall]).sweep(FREE, length, CENTERS, SPANS)
        ends[length] = swept.contacts[-1, 0, 0]
        rows[length] = swept.readings + NOISE * rng.standard_normal(swept.readings.shape)
        rows[length][:, length < CENTERS + SPANS / 2] = np.nan
    assert ends[40.0] == pytest.approx(40.0)
    assert ends[53.0] < 51.0
    contact = _one(contacts(_readings(rows), _errors(), atlas))
    assert contact.kind == "wall"
    assert contact.interval_cm[0] < ends[53.0] < contact.interval_cm[1]
    assert contact.arc_cm == pytest.approx(ends[53.0], abs=0.6)
    whole, short = Search(_readings(rows), _errors(), atlas).walls()
    assert short[0].q[AHEAD] == pytest.approx(ahead, abs=0.01)
    assert short[0].cost < whole[0].cost - 10.0


def test_whoever_waits_for_a_fit_is_called_before_each_of_its_mechanics(
    atlas: Atlas, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    sweep = Rod.sweep

    def counted(rod: Rod, *args: Any, **kwargs: Any) -> Any:
        calls.append("sweep")
        return sweep(rod, *args, **kwargs)

    rng = np.random.default_rng(5)
    rows = {53.0: _beside_peg(34.0, 0.012, 1.0, 53.0, rng)[0]}
    monkeypatch.setattr(Rod, "sweep", counted)
    contacts(_readings(rows), _errors(), atlas, meanwhile=lambda: calls.append("meanwhile"))
    fit = calls[calls.index("meanwhile") :]  # behind the atlas's
    assert len(fit) > 20
    assert set(fit[::2]) == {"meanwhile"}
    assert set(fit[1::2]) == {"sweep"}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_side_that_touched_nothing_is_empty(seed: int, atlas: Atlas) -> None:
    rng = np.random.default_rng(seed)
    rows = {
        length: _untouched(length, rng) * (1 + 0.04 * rng.standard_normal()) for length in LENGTHS
    }
    assert contacts(_readings(rows), _errors(), atlas) == []


@pytest.mark.sim
def test_a_peg_is_sought_on_both_sides_of_an_end(atlas: Atlas) -> None:
    rng = np.random.default_rng(5)
    rows = {length: _beside_peg(49.0, 0.012, 0.6, length, rng)[0] for length in (50.0, 53.0)}
    search = Search(_readings(rows), _errors(), atlas)
    arcs = [place.arc for place in search.places]
    assert any(arc < 50.0 for arc in arcs)
    assert any(50.0 < arc < 53.0 for arc in arcs)
    gains = [place.gain for place in search.places]
    assert gains == sorted(gains, reverse=True)


@pytest.mark.sim
@pytest.mark.parametrize(
    ("arc", "bend", "peg_radius"),
    [(34.0, 0.012, 1.0), (22.0, 0.01, 0.4), (45.0, 0.008, 2.0), (8.5, 0.012, 1.6)],
)
def test_a_peg_of_the_independent_rod_is_found_in_the_plane(
    arc: float, bend: float, peg_radius: float, atlas: Atlas
) -> None:
    rng = np.random.default_rng(5)
    rows = {}
    for length in LENGTHS:
        if arc < length:
            rows[length], (at, x, y) = _beside_peg(arc, bend, peg_radius, length, rng)
    contact = _one(contacts(_readings(rows), _errors(), atlas))
    assert contact.probability > 0.99
    assert contact.effective > 50
    assert contact.length_cm == 53.0
    low, high = contact.interval_cm
    assert low <= at <= high
    assert high - low < 6.0
    # The touched skin lies on the peg: the truth is the peg's surface.
    away = abs(np.hypot(contact.x_cm - x, contact.y_cm - y) - peg_radius)
    assert away < 0.6
    assert contact.misfit < 2.0


@pytest.mark.sim
def test_a_longer_body_with_all_else_in_proportion_has_the_same_answer() -> None:
    rows = {
        length: _beside_peg(34.0, 0.012, 1.0, length, np.random.default_rng(5))[0]
        for length in LENGTHS
    }
    contact = _one(contacts(_readings(rows), _errors(), Atlas(53.0, 0.024)))
    errors = _errors(
        place=np.full(5, 0.2), zero=np.full(5, 1e-4), zero_zeroing=np.full(5, 5e-5),
        zero_sweep=np.full(5, 2.5e-5), map_offset=4e-4, sweep_offset=1.5e-4, bend_bin=1.5e-4,
    )  # fmt: skip
    two = _one(contacts(_readings(rows, 2.0), errors, Atlas(106.0, 0.012)))
    assert two.arc_cm / 2 == pytest.approx(contact.arc_cm, abs=0.3)
    assert two.x_cm / 2 == pytest.approx(contact.x_cm, abs=0.3)


def test_a_proposal_whose_friction_and_yield_have_no_sign_has_a_density_of_one() -> None:
    rng = np.random.default_rng(8)
    widths = np.array([1.0, 1e-3, 0.5, 0.1, 0.2, 0.2, 0.02])
    # Both lie near no friction and no yield, so that half of what is drawn is mirrored.
    drawn_from = Bell(np.array([30.0, 0.01, -0.5, 0.0, 0.1, 0.05, 0.01]), np.diag(1.5 * widths**2))
    wide = Bell(np.array([30.0, 0.01, -0.5, 0.0, 0.15, 0.1, 0.0]), np.diag(widths**2))
    q = np.array([drawn_from.draw(rng) for _ in range(4000)])
    assert (q[:, 4:] >= 0.0).all()
    ratio = np.exp(wide.log_density(q) - drawn_from.log_density(q))
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)


def test_weights_of_few_samples_are_widened_until_enough_count() -> None:
    rng = np.random.default_rng(7)
    weight = np.exp(8 * rng.standard_normal(300))
    wide = _widened(weight / weight.sum())
    assert 1 / np.sum(wide**2) > 50
    even = np.full(300, 1 / 300)
    assert _widened(even) == pytest.approx(even)


@pytest.mark.sim
def test_a_contact_of_too_few_effective_samples_is_no_answer(
    atlas: Atlas, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(5)
    rows = {length: _beside_peg(34.0, 0.012, 1.0, length, rng)[0] for length in LENGTHS}
    assert _one(contacts(_readings(rows), _errors(), atlas)).places
    monkeypatch.setattr("thigmo.field.answer.ENOUGH", 1e4)
    contact = _one(contacts(_readings(rows), _errors(), atlas))
    assert not contact.places
    assert contact.doubt == SCARCE_WORDS


@pytest.mark.sim
def test_readings_that_no_peg_explains_place_nothing(atlas: Atlas) -> None:
    rng = np.random.default_rng(9)
    rows = {length: _beside_peg(34.0, 0.012, 1.0, length, rng)[0] for length in LENGTHS}
    for length, read in rows.items():  # a peg that has moved by the last sweep
        if length == 53.0:
            read[:], _ = _beside_peg(20.0, 0.016, 1.0, length, rng)
    answer = contacts(_readings(rows), _errors(), atlas)
    assert all(not contact.places and contact.doubt for contact in answer)
    assert all(contact.gave_way_at is None for contact in answer)


def _stuck(curvature: np.ndarray, rng: np.random.Generator) -> None:
    curvature[rng.integers(5, 20) :, rng.integers(5)] = 0.02


def _wired_backwards(curvature: np.ndarray, rng: np.random.Generator) -> None:
    curvature[:, rng.integers(5)] *= -1


def _out_of_order(curvature: np.ndarray, rng: np.random.Generator) -> None:
    curvature[:] = curvature[rng.permutation(len(curvature))]


def _spiked(curvature: np.ndarray, rng: np.random.Generator) -> None:
    curvature[rng.random(curvature.shape) < 0.05] += 0.05


def _shaken(curvature: np.ndarray, rng: np.random.Generator) -> None:
    curvature += 0.01 * np.sin(np.arange(len(curvature))[:, None] / 3 + np.arange(5))


@pytest.mark.parametrize("lie", [_stuck, _wired_backwards, _out_of_order, _spiked, _shaken])
def test_readings_that_lie_place_nothing_and_their_contact_lies_on_the_body(
    atlas: Atlas, lie: Callable[[np.ndarray, np.random.Generator], None]
) -> None:
    rng = np.random.default_rng(3)
    rows = {length: _beside_peg(34.0, 0.012, 1.0, length, rng)[0] for length in LENGTHS}
    readings = _readings(rows)
    lie(readings.curvature, rng)
    for contact in contacts(readings, _errors(), atlas):
        assert not contact.places
        low, high = contact.interval_cm
        assert 0.0 <= low <= contact.arc_cm <= high <= contact.length_cm
        assert high - low > 10.0
        least, most = np.sqrt(np.linalg.eigvalsh(contact.covariance_cm2))
        assert 0.0 < least <= most <= 0.501 * contact.length_cm
