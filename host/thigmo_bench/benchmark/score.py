"""Scores of answers to the benchmark: errors, coverage and overclaiming, by group of frames.

Imports the standard library alone, so that anyone can read what is counted, and run it beside the
benchmark's files without an installation:

    python score.py answers.csv

An answer is a row for each contact: `frame, arc_cm`, and where the method knows them `low_cm`,
`high_cm` (95 %) and `localized` (1 or 0). A frame that touches nothing has one row with an empty
`arc_cm`. Frames that have no row are not answered.
"""

from __future__ import annotations

import csv
import math
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median, stdev

FOLDER = Path(__file__).parent
FAILURE_CM = 10.0
_SLACK_CM = 1e-6  # of an interval's ends
_COLUMNS = ("frame", "arc_cm", "low_cm", "high_cm", "localized")


class AnswersError(ValueError):
    """A file of answers that cannot be scored: the file, the line, and what is wrong."""


@dataclass(frozen=True)
class Claim:
    """A contact of an answer."""

    arc_cm: float
    interval_cm: tuple[float, float] | None
    localized: bool

    def holds(self, arcs: Iterable[float]) -> bool:
        """Whether the interval holds one of the true arcs."""
        low, high = self.interval_cm or (math.nan, math.nan)
        return any(low - _SLACK_CM <= arc <= high + _SLACK_CM for arc in arcs)


@dataclass(frozen=True)
class Score:
    """What answers to one group of frames are worth; NaN where there is nothing to count.

    Attributes:
        frames: in the group.
        answered: of these.
        number: share of the answered with the true number of contacts.
        error_cm: mean distance of answer and truth, ordered along the body, over these.
        standard_error_cm: of that mean.
        median_cm: of the frames' distances.
        failures: share of the answered with another number, or farther off than 10 cm.
        coverage: share of the intervals that hold a true contact.
        width_cm: median width of the intervals.
        claimed: share of the answered that call a contact localized.
        overclaimed: share of the contacts called localized that have no true one in their interval.
    """

    group: str
    frames: int
    answered: int
    number: float
    error_cm: float
    standard_error_cm: float
    median_cm: float
    failures: float
    coverage: float
    width_cm: float
    claimed: float
    overclaimed: float


def read_answers(path: Path, frames: Mapping[str, str]) -> dict[str, list[Claim]]:
    """Contacts of each frame that is answered. Raises AnswersError."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            return _answers(csv.DictReader(file), path, frames)
    except OSError as error:
        raise AnswersError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise AnswersError(f"{path} is not a text file") from error


def _answers(
    rows: csv.DictReader[str], path: Path, frames: Mapping[str, str]
) -> dict[str, list[Claim]]:
    names = rows.fieldnames or ()
    if len(names) == 1 and ";" in names[0]:
        raise AnswersError(f"{path} has semicolons between its columns, where commas belong")
    if not {"frame", "arc_cm"} <= set(names):
        raise AnswersError(f"{path} needs the columns {', '.join(_COLUMNS[:2])}")
    claims_by_frame: dict[str, list[Claim]] = {}
    for row in rows:
        where, frame = f"{path}, line {rows.line_num}", (row["frame"] or "").strip()
        if frame not in frames:
            raise AnswersError(f"{where}: there is no frame {frame!r}")
        numbers = {}
        for name in _COLUMNS[1:]:
            try:
                numbers[name] = float((row.get(name) or "").strip() or "nan")
            except ValueError as error:
                raise AnswersError(f"{where}: {name} is {row[name]!r}, not a number") from error
            if math.isinf(numbers[name]):
                raise AnswersError(f"{where}: {name} is infinite")
        arc, low, high, localized = numbers.values()
        claims = claims_by_frame.setdefault(frame, [])
        if math.isnan(arc):
            if claims or not math.isnan(low) or localized == 1:
                raise AnswersError(f"{where}: an empty arc_cm says that nothing is touched")
            continue
        if math.isnan(low) != math.isnan(high) or low > high:
            raise AnswersError(f"{where}: low_cm and high_cm are not an interval")
        interval = None if math.isnan(low) else (low, high)
        if localized == 1 and interval is None:
            raise AnswersError(f"{where}: a localized contact has an interval")
        claims.append(Claim(arc, interval, localized == 1))
    return claims_by_frame


def groups_of() -> dict[str, str]:
    """Group of each frame, of those held back, too."""
    groups = {}
    for path in (FOLDER / "frames.csv", FOLDER / "held" / "frames.csv"):
        with path.open(newline="", encoding="utf-8") as file:
            groups.update({row["frame"]: row["group"] for row in csv.DictReader(file)})
    return groups


def truth_of(path: Path) -> dict[str, list[float]]:
    """True arcs of each frame, cm, rising; none where nothing is touched. Raises AnswersError."""
    arcs_by_frame: dict[str, list[float]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                arcs = arcs_by_frame.setdefault(row["frame"], [])
                if row["arc_cm"]:
                    arcs.append(float(row["arc_cm"]))
    except OSError as error:
        raise AnswersError(f"cannot read {path}: {error.strerror}") from error
    except (KeyError, ValueError) as error:
        raise AnswersError(f"{path} is not a truth file of the benchmark: {error}") from error
    return {frame: sorted(arcs) for frame, arcs in arcs_by_frame.items()}


def score(answers: Path, truth: Path = FOLDER / "truth.csv") -> list[Score]:
    """Score a file of answers, group by group. Raises AnswersError."""
    true = truth_of(truth)
    groups = {frame: group for frame, group in groups_of().items() if frame in true}
    claims = read_answers(answers, groups)
    frames_by_group: dict[str, list[str]] = defaultdict(list)
    for frame, group in groups.items():
        frames_by_group[group].append(frame)
    return [
        _group_score(group, frames, [(claims[f], true[f]) for f in frames if f in claims])
        for group, frames in frames_by_group.items()
    ]


def _group_score(
    group: str, frames: Sequence[str], pairs: Sequence[tuple[list[Claim], list[float]]]
) -> Score:
    errors = []
    hits = 0
    for claims, arcs in pairs:
        if len(claims) != len(arcs):
            continue
        hits += 1
        if arcs:
            places = sorted(claim.arc_cm for claim in claims)
            errors.append(fmean(abs(a - b) for a, b in zip(places, arcs, strict=True)))
    misses = sum(error > FAILURE_CM for error in errors)
    covered = [claim.holds(arcs) for claims, arcs in pairs for claim in claims if claim.interval_cm]
    wrong = [not claim.holds(arcs) for claims, arcs in pairs for claim in claims if claim.localized]
    widths = [
        claim.interval_cm[1] - claim.interval_cm[0]
        for claims, _ in pairs
        for claim in claims
        if claim.interval_cm
    ]
    localized = sum(any(claim.localized for claim in claims) for claims, _ in pairs)
    answered = len(pairs)
    return Score(
        group, len(frames), answered, _share(hits, answered), fmean(errors) if errors else math.nan,
        stdev(errors) / math.sqrt(len(errors)) if len(errors) > 1 else math.nan,
        median(errors) if errors else math.nan, _share(answered - hits + misses, answered),
        _share(sum(covered), len(covered)), median(widths) if widths else math.nan,
        _share(localized, answered), _share(sum(wrong), len(wrong)),
    )  # fmt: skip


def _share(count: int, total: int) -> float:
    return count / total if total else math.nan


# Of each column, in one or two lines.
_HEADS = {
    "answered": "answers", "number": "number right", "error_cm": "error, cm", "failures": "failed",
    "coverage": "coverage", "width_cm": "width, cm", "claimed": "localized",
    "overclaimed": "over- claimed",
}  # fmt: skip


def table(scores: Sequence[Score]) -> str:
    """Scores for people, in 80 columns."""
    heads = [["", *head.split()][-2:] for head in _HEADS.values()]
    lines = [["", *(upper for upper, _ in heads)], ["group", *(lower for _, lower in heads)]]
    for score in scores:
        cells = [score.group, f"{score.answered}/{score.frames}"]
        for name in list(_HEADS)[1:]:
            value = getattr(score, name)
            cells.append("-" if math.isnan(value) else f"{value:.2f}")
        lines.append(cells)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        " ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]).rstrip()
        for line in lines
    )


def main(arguments: Sequence[str]) -> int:
    """Score the file that is named."""
    if len(arguments) not in (1, 2):
        print("usage: python score.py answers.csv [truth.csv]", file=sys.stderr)
        return 2
    try:
        print(table(score(*map(Path, arguments))))
    except AnswersError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
