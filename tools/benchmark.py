"""Make the frames of the public benchmark, and answer them with our methods.

    python tools/benchmark.py make               its frames and truth, from the published seed
    python tools/benchmark.py make --held SEED   held-back frames; their truth goes to build/
    python tools/benchmark.py answer posterior --out answers.csv
    python tools/benchmark.py table              scores of every method, as JSON

Truth is the rod of `thigmo_bench.studies.rod` in the plane, and Kirchhoff's equations in space
below; no code of a method has a part in it. Answers are made from frames.csv and readings.csv
alone. Called by developers; docs/benchmark.md says how others enter.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from thigmo.errors import ThigmoError
from thigmo.localization import METHODS, Localizer
from thigmo.reading_errors import SETTLED
from thigmo_bench import benchmark
from thigmo_bench.baselines import BASELINES, BaselineProblem
from thigmo_bench.benchmark.score import score
from thigmo_bench.studies import contact_scenes, pegs
from thigmo_bench.studies.loads import DENSE, two
from thigmo_bench.studies.rod import Floats
from thigmo_bench.studies.scenes import BOTH, COLUMN, CRITICAL, LENGTH, RADIUS, SIGMA, SPAN
from thigmo_bench.studies.speed_accuracy import COMPARED, SLOW

ROOT = Path(__file__).resolve().parent.parent
FOLDER = Path(benchmark.__file__).parent
SEED = 2022
EACH = 100  # frames of a group
GAIN, OFFSET, MAP = 0.05, 1e-3, 0.05  # one sigma of a wrong calibration
EVERY = 20  # frames, of methods that take up to a second for one
THIRDS = 2 * np.pi / 3 * np.arange(3)
TWIST = 1.3  # EI / GJ
STEP_CM = 0.05


@dataclass(frozen=True)
class Frame:
    """What a method gets of one frame."""

    group: str
    position: Floats  # (N,)
    angle: Floats  # (N,) around the body, rad
    curvature: Floats  # (N,)
    free: float
    contacts: int | None  # None: not stated
    errors: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of gain, offset and map


Drawn = tuple[Frame, list[float]]  # with the true arcs


def planar(
    draw: contact_scenes.Draw,
    group: str,
    stated: bool,
    wrong: bool,
    rng: np.random.Generator,
    count: int,
) -> Iterator[Drawn]:
    """Frames in the plane, with noise and, if `wrong`, the errors of a calibration."""
    scenes = draw(rng, count)
    for clean, free, arcs in zip(scenes.curvature, scenes.free, scenes.arcs, strict=True):
        errors = (GAIN, OFFSET, MAP) if wrong else (0.0, 0.0, 0.0)
        readings = clean * (1.0 + errors[0] * rng.standard_normal(clean.size))
        readings = (
            readings + errors[1] * rng.standard_normal() + SIGMA * rng.standard_normal(clean.size)
        )
        believed = float(free) / (1.0 + errors[2] * rng.standard_normal())
        number = len(arcs) if stated else None
        angle = np.zeros(clean.size)
        yield (
            Frame(group, scenes.position, angle, readings, believed, number, errors),
            sorted(arcs.tolist()),
        )


def mixed(rng: np.random.Generator, count: int) -> Iterator[Drawn]:
    """None, one, two or three contacts on straight bodies, the number not stated."""
    three = partial(touches_three, DENSE)
    draws: list[contact_scenes.Draw] = [
        partial(contact_scenes.straight, DENSE), partial(touches_one, DENSE),
        partial(two, True, False, DENSE), three,
    ]  # fmt: skip
    for draw in draws:
        yield from planar(draw, "number unknown", False, False, rng, count // len(draws))


def touches_one(position: Floats, rng: np.random.Generator, count: int) -> contact_scenes.Scenes:
    """A clear contact on a straight body."""
    arc = rng.uniform(10.0, LENGTH, count)
    force = contact_scenes.signs(rng, count) * rng.uniform(0.3, 1.0, count) * CRITICAL / arc
    return contact_scenes.one_contact(arc, force, np.zeros(count), position)


def touches_three(position: Floats, rng: np.random.Generator, count: int) -> contact_scenes.Scenes:
    """Three contacts of alternating forces."""
    from thigmo_bench.studies.rod import solve

    arcs = np.array([20.0, 35.0, 50.0]) + rng.uniform(-1.5, 1.5, (count, 3))
    forces = contact_scenes.signs(rng, count)[:, None] * np.array([2.4, -1.6, 1.0]) * 0.6 * CRITICAL
    bodies = solve(arcs, forces / LENGTH, length=LENGTH)
    return contact_scenes.Scenes(bodies.readings(position, SPAN), position, np.zeros(count), arcs)


def walls(rng: np.random.Generator, count: int) -> contact_scenes.Scenes:
    """A bent body against a surface that is flat at its own scale: of a radius of 1 to 2 m."""
    room = pegs.rooms(
        rng,
        count,
        length=LENGTH,
        largest_free=contact_scenes.MOST_FREE,
        radius=(100.0, 200.0),
        moment=(0.2, 1.0),
    )
    side = contact_scenes.signs(rng, count)
    clean = side[:, None] * room.bodies(-1).readings(COLUMN, SPAN)
    return contact_scenes.Scenes(clean, COLUMN, side * room.free[-1], room.arc[-1][:, None])


def in_space(rng: np.random.Generator, count: int) -> Iterator[Drawn]:
    """A straight body in space, pressed twice, from any side: fifteen readings around it."""
    arcs = np.sort(
        STEP_CM * np.round(rng.uniform([15.0, 38.0], [28.0, LENGTH], (count, 2)) / STEP_CM)
    )
    moment = rng.uniform(0.4, 1.0, (count, 2)) * CRITICAL
    toward = rng.uniform(0.0, 2.0 * np.pi, (count, 2))
    nodes, bend = bent_in_space(arcs, moment / arcs, toward)
    position, angle = np.repeat(COLUMN, 3), np.tile(THIRDS, len(COLUMN))
    total = np.concatenate([np.zeros((count, 1, 2)), np.cumsum(bend[:, 1:] + bend[:, :-1], 1)], 1)
    total *= 0.5 * STEP_CM
    ends = [np.rint((position + half) / STEP_CM).astype(int) for half in (SPAN / 2, -SPAN / 2)]
    mean = (total[:, ends[0]] - total[:, ends[1]]) / SPAN
    clean = mean[..., 0] * np.cos(angle) + mean[..., 1] * np.sin(angle)
    assert nodes[-1] >= LENGTH - 1e-9
    for frame, true in zip(clean, arcs, strict=True):
        read = frame + SIGMA * rng.standard_normal(frame.size)
        yield Frame("space", position, angle, read, 0.0, 2), true.tolist()


def bent_in_space(arcs: Floats, force: Floats, toward: Floats) -> tuple[Floats, Floats]:
    """Nodes (M,) and curvature vectors (S, M, 2) of straight rods under two forces (S, 2).

    A force acts across the body at an arc, towards an angle in the section there; EI = 1, and
    GJ = 1 / TWIST. Integrated from the distal force, in whose section's frame all is written, to
    the base (Antman, Nonlinear Problems of Elasticity, chapter 8): an initial value problem.
    """
    nodes = np.arange(round(LENGTH / STEP_CM) + 1) * STEP_CM
    bodies = len(arcs)
    frame = np.tile(np.eye(3), (bodies, 1, 1))  # columns: the section's axes, its normal last
    moment, pull = np.zeros((2, bodies, 3))
    bend = np.zeros((bodies, nodes.size, 2))
    local = np.stack([force * np.cos(toward), force * np.sin(toward), 0.0 * force], axis=-1)
    index = np.rint(arcs / STEP_CM).astype(int)
    soft = np.array([1.0, 1.0, TWIST])

    def strain(frame: Floats, moment: Floats) -> Floats:
        return np.asarray(np.einsum("sij,si->sj", frame, moment) * soft)

    def slope(frame: Floats, moment: Floats) -> tuple[Floats, Floats]:
        u = strain(frame, moment)
        spin = np.zeros((bodies, 3, 3))
        spin[:, 0, 1], spin[:, 0, 2], spin[:, 1, 2] = -u[:, 2], u[:, 1], -u[:, 0]
        spin -= np.swapaxes(spin, 1, 2)
        return frame @ spin, -np.cross(frame[:, :, 2], pull)

    for node in reversed(range(nodes.size)):
        for load in (1, 0):
            loaded = index[:, load] == node
            pull[loaded] += np.einsum("sij,sj->si", frame[loaded], local[loaded, load])
        u = strain(frame, moment)
        bend[:, node] = np.stack([u[:, 1], -u[:, 0]], axis=-1)
        h = -STEP_CM
        a = slope(frame, moment)
        b = slope(frame + 0.5 * h * a[0], moment + 0.5 * h * a[1])
        c = slope(frame + 0.5 * h * b[0], moment + 0.5 * h * b[1])
        d = slope(frame + h * c[0], moment + h * c[1])
        frame = frame + h / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
        moment = moment + h / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
    return nodes, bend


GROUPS: dict[str, Callable[[np.random.Generator, int], Iterator[Drawn]]] = {
    name: partial(planar, draw, name, True, wrong)
    for name, draw, wrong in (
        ("one", partial(touches_one, BOTH), False),
        ("few sensors", partial(touches_one, COLUMN[[0, 2, 3]]), False),
        ("two", partial(two, True, False, BOTH), False),
        ("three", partial(touches_three, DENSE), False),
        ("bent", contact_scenes.bent, False),
        ("bent, two", partial(two, True, True, DENSE), False),
        ("wall", walls, False),
        ("friction", contact_scenes.rubbed, False),
        ("wrong calibration", contact_scenes.bent, True),
    )
} | {"number unknown": mixed, "space": in_space}


def make(seed: int, folder: Path, truth_folder: Path, prefix: str = "") -> None:
    """Write frames, readings and truth of a seed; `prefix` begins the frames' names."""
    for output_folder in (folder, truth_folder):
        output_folder.mkdir(parents=True, exist_ok=True)
    paths = (folder / "frames.csv", folder / "readings.csv", truth_folder / f"{prefix}truth.csv")
    opened = [path.open("w", newline="") for path in paths]
    frames, readings, truth = map(csv.writer, opened)
    frames.writerow([
        "frame", "group", "contacts", "length_cm", "tube_radius_cm", "free_curvature_per_cm",
        "noise_per_cm", "gain_error", "offset_error_per_cm", "map_error",
    ])  # fmt: skip
    readings.writerow(["frame", "position_cm", "span_cm", "direction_rad", "curvature_per_cm"])
    truth.writerow(["frame", "arc_cm"])
    number = 0
    for k, draw in enumerate(GROUPS.values()):
        for frame, arcs in draw(np.random.default_rng([seed, k]), EACH):
            number += 1
            name = f"{prefix}{number:04d}"
            count = "" if frame.contacts is None else frame.contacts
            frames.writerow([
                name, frame.group, count, f"{LENGTH:g}", f"{RADIUS:g}", f"{frame.free:.7g}",
                f"{SIGMA:g}", *(f"{output_folder:g}" for output_folder in frame.errors),
            ])  # fmt: skip
            for values in zip(frame.position, frame.angle, frame.curvature, strict=True):
                place, angle, read = values
                readings.writerow([name, f"{place:g}", f"{SPAN:g}", f"{angle:.5g}", f"{read:.6g}"])
            for arc in arcs or [None]:
                truth.writerow([name, "" if arc is None else f"{arc:.5f}"])
    for file in opened:
        file.close()


def frames_of(folder: Path) -> Iterator[tuple[dict[str, str], list[Floats]]]:
    """Each frame's row, and its readings as columns: position, span, angle, curvature."""
    rows: dict[str, list[list[float]]] = {}
    with (folder / "readings.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            values = [float(value) for name, value in row.items() if name != "frame"]
            rows.setdefault(row["frame"], []).append(values)
    with (folder / "frames.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            yield row, list(np.array(rows[row["frame"]]).T)


def in_plane(position: Floats, angle: Floats, curvature: Floats) -> tuple[Floats, Floats]:
    """Readings around the body as those of one plane: that in which the body bends most."""
    places = np.unique(position)
    vectors = []
    for place in places:
        same_place = position == place
        axes = np.stack([np.cos(angle[same_place]), np.sin(angle[same_place])], axis=1)
        vectors.append(np.linalg.lstsq(axes, curvature[same_place], rcond=None)[0])
    bends = np.array(vectors)
    main = np.linalg.svd(bends, full_matrices=False)[2][0]
    return places, bends @ main


def answer(method: str, row: dict[str, str], columns: list[Floats]) -> list[list[Any]]:
    """Rows of answers.csv to one frame; none where the method does not answer."""
    position, span, angle, curvature = columns
    noise = float(row["noise_per_cm"])
    around: dict[str, Any] = {}
    if angle.any() and method == METHODS[0]:
        around = {"angle": angle, "twist": TWIST, "critical_curvature": None}
    elif angle.any():
        (position, curvature), span = in_plane(position, angle, curvature), span[:1]
        noise *= float(np.sqrt(2.0 / 3.0))
    count, length = row["contacts"], float(row["length_cm"])
    free = float(row["free_curvature_per_cm"])
    try:
        if method in METHODS:
            contacts: Any = int(count) if count else "auto"
            if not count and method != METHODS[0]:
                return []
            options: dict[str, Any] = {
                "position": position, "length": length, "span": span[0], "noise": noise,
                "contacts": contacts, "method": method, "held_end": False,
                "critical_curvature": float("inf"),
                "tube_radius": float(row["tube_radius_cm"]),
                "gain_error": float(row["gain_error"]),
                "offset_error": float(row["offset_error_per_cm"]),
                "map_error": float(row["map_error"]),
                **SETTLED,
            }  # fmt: skip
            localizer = Localizer.of(**(options | around))
            answers = localizer.localize(curvature, free_curvature=free).contacts
            claims = [
                [f"{c.arc:.4f}", f"{c.interval[0]:.4f}", f"{c.interval[1]:.4f}",
                 int(c.status == "localized")]
                if method == METHODS[0] else [f"{c.arc:.4f}", "", "", ""]
                for c in answers
            ]  # fmt: skip
            return [[row["frame"], *claim] for claim in claims or [["", "", "", ""]]]
        if not count:
            return []
        spans = np.full(position.size, span[0])
        reduced = curvature - free
        problem = BaselineProblem(reduced, position, spans, length, int(count), noise=noise)
        arcs = BASELINES[method](problem)[0]
    except ThigmoError:
        return []
    return [[row["frame"], f"{arc:.4f}", "", "", ""] for arc in np.sort(arcs)]


def write_answers(method: str, out: Path, folder: Path = FOLDER) -> None:
    """Answer every frame; of a slow method every twentieth."""
    with out.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "arc_cm", "low_cm", "high_cm", "localized"])
        for number, (row, columns) in enumerate(frames_of(folder)):
            if method not in SLOW or number % EVERY == 0:
                writer.writerows(answer(method, row, columns))


def scored(method: str) -> list[dict[str, Any]]:
    """Rows of the table: one method's scores."""
    out = ROOT / "build" / f"answers-{method}.csv"
    out.parent.mkdir(exist_ok=True)
    write_answers(method, out)
    print(method, file=sys.stderr, flush=True)
    return [
        {"method": method}
        | {
            k: (v if not isinstance(v, float) or isfinite(v) else None)
            for k, v in asdict(s).items()
        }
        for s in score(out)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make")
    making.add_argument("--held", type=int, help="secret seed of the held-back frames")
    answering = commands.add_parser("answer")
    answering.add_argument("method", choices=COMPARED)
    answering.add_argument("--out", type=Path, default=Path("answers.csv"))
    answering.add_argument("--folder", type=Path, default=FOLDER, help="of frames and readings")
    tabling = commands.add_parser("table")
    tabling.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    if options.command == "make" and options.held is None:
        make(SEED, FOLDER, FOLDER)
    elif options.command == "make":
        make(options.held, FOLDER / "held", ROOT / "build", "held-")
    elif options.command == "answer":
        write_answers(options.method, options.out, options.folder)
    else:
        with ProcessPoolExecutor(options.jobs) as pool:
            rows = [row for rows in pool.map(scored, COMPARED) for row in rows]
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
