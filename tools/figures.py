"""Runs the commands behind the project's figures, keeps what they print, and writes their tables.

    python tools/figures.py                 run every command (an hour or two), then render
    python tools/figures.py explore budgets
                                            run some of them, then render
    python tools/figures.py --render        render from the kept results only
    python tools/figures.py --check         fail if a table is not what the results say

Results are kept as JSON in docs/results/, pictures in docs/. The tables stand in docs/figures.md,
each between `<!-- figures: NAME -->` and `<!-- end -->`; README.md has the headlines. No number in
them is typed by hand. Called by developers before a release; `make lint` calls it with --check.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results"
PAGES = (ROOT / "README.md", ROOT / "docs" / "figures.md", ROOT / "docs" / "benchmark.md")
PLACE = re.compile(r"(<!-- figures: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
Row = tuple[str, str, str]


@dataclass(frozen=True)
class Grid:
    """A table of numbers, one in each column."""

    head: tuple[str, ...]
    rows: list[tuple[str, ...]]


@dataclass(frozen=True)
class Source:
    """A command, the pictures of it that are kept, and the rows made of its JSON."""

    command: tuple[str, ...]
    rows: Callable[[Any], list[Row]]
    pictures: dict[str, str]
    grids: Callable[[Any], list[Grid]] = lambda _: []

    @property
    def shown(self) -> str:
        """The command as a reader types it."""
        return " ".join(self.command)


EXPLORED = "default exploration: \\|x error\\| (thesis: 6.82 cm)"


def _explore(run: dict[str, Any]) -> list[Row]:
    return [
        (
            EXPLORED,
            f"{run['error_x_cm']:.2f} cm",
            "one run; many seeds in the rows below",
        ),
        (
            "default exploration: robot time over wall time",
            f"{run['robot_per_wall_time']:.0f}",
            f"{run['robot_time_s']:.0f} s of robot time in {run['wall_time_s']:.1f} s",
        ),
    ]


def _experiments(experiments: list[dict[str, Any]]) -> list[Row]:
    return [
        (
            f"{row['experiment']}, {row['condition']}: x error in the room",
            f"{row['ours_workspace_mean']:.{2 if row['beaten'] else 3}f} cm",
            _allowed(row["allowed"], row["beaten"]),
        )
        for experiment in experiments
        for row in experiment["rows"]
    ]


def _allowed(limit: float, beaten: bool) -> str:
    return f"promised <= {limit:.2f}" if beaten else f"promised <= {limit:.3f}; **missed**"


def _measures(experiments: list[dict[str, Any]]) -> list[Grid]:
    """A row an experiment and condition: both methods' errors in both measures."""
    head = (
        "mean x error, cm", "ours", "thesis's method here", "bound",
        "in the thesis's measure: ours", "thesis's method here", "thesis", "bound", "",
    )  # fmt: skip
    rows = [
        (
            f"{row['experiment']}, {row['condition']}",
            f"{row['ours_workspace_mean']:.2f}", f"{row['here_workspace_mean']:.2f}",
            _number(row["bound_mean"]), f"{row['ours_mean']:.2f}", f"{row['here_mean']:.2f}",
            f"{row['thesis_mean']:.2f}", _number(row["bound_measured_mean"]),
            _allowed(row["allowed_mean"], row["mean_beaten"]),
        )
        for experiment in experiments
        for row in experiment["rows"]
    ]  # fmt: skip
    return [Grid(head, rows)]


def _predictions(studies: list[dict[str, Any]]) -> list[Row]:
    """What the fitted constants predict, with the tool's own verdict."""
    rows = []
    for study in studies:
        for note in study["notes"] if study["study"] == "predictions" else []:
            name, said = note.split(": ", 1)
            verdict = said.split("(")[1].split(";")[0]
            rows.append((f"prediction: {name}", verdict, said.replace(f"{verdict}; ", "")))
    return rows


def _many_robots(experiments: list[dict[str, Any]]) -> list[Row]:
    """Ours less its method, with the standard error over the robots."""
    rows = []
    for row in (row for experiment in experiments for row in experiment["rows"]):
        tie = abs(row["less_mean"]) < 2 * row["less_se"]
        verdict = "a tie" if tie else "ours" if row["less_mean"] > 0 else "its method"
        rows.append((
            f"{row['condition']}: x error in the room, its method less ours",
            f"{row['less_mean']:.2f} +- {row['less_se']:.2f} cm",
            f"nearer: {verdict}",
        ))  # fmt: skip
    return rows


def _places(experiments: list[dict[str, Any]]) -> list[Grid]:
    """A row a condition: the errors of its method and of ours at each place of the dowel."""
    rows = [row for experiment in experiments for row in experiment["rows"]]
    places = list(rows[0]["by_place"])
    head = [
        f"{where}: {whose}"
        for where in ("all places", *(f"at {place}" for place in places), "in the thesis's measure")
        for whose in ("its method", "ours")
    ]
    lines = []
    for row in rows:
        pairs = [
            (row["here_workspace_mean"], row["ours_workspace_mean"]),
            *(row["by_place"][place] for place in places),
            (row["here_mean"], row["ours_mean"]),
        ]
        lines.append((row["condition"], *(f"{error:.2f}" for pair in pairs for error in pair)))
    return [Grid(("mean x error, cm", *head), lines)]


def _experiments_and_claims(experiments: list[dict[str, Any]]) -> list[Row]:
    claims = _claims([e for e in experiments if not e["rows"]])
    return _experiments(experiments) + claims + _predictions(experiments)


def _claims(studies: list[dict[str, Any]]) -> list[Row]:
    rows = []
    for study in studies:
        for claim in study["claims"]:
            sign = "<=" if claim["at_most"] else ">="
            verdict = "" if claim["holds"] else "; **missed**"
            rows.append(
                (
                    claim["claim"].replace("|", "\\|"),
                    f"{_value(claim)} {claim['unit']}".strip(),
                    f"promised {sign} {_number(claim['limit'])}{verdict}",
                )
            )
    return rows


def _value(claim: dict[str, Any]) -> str:
    """A claim's value and its standard error, with one more digit if a miss looks like a hit."""
    shown = _number(claim["value"])
    if not claim["holds"] and shown == _number(claim["limit"]):
        shown = f"{claim['value']:.4g}"
    return f"{shown} ± {claim['standard_error']:.2g}" if "standard_error" in claim else shown


def _explorations(studies: list[dict[str, Any]]) -> list[Row]:
    return _claims(studies) + _notes(studies[0])


def _explored_rooms(studies: list[dict[str, Any]]) -> list[Grid]:
    """A row a kind of room."""
    (study,) = studies
    head = (
        "rooms of the kind", "rooms", "runs aborted", "contacts", "missed", "rooms with false ones",
        "localized", "arc outside of its set", "localized wrong", "ellipses",
        "ellipses without the truth", "mean error in the plane, cm", "its standard error",
    )  # fmt: skip
    counts = (
        "rooms", "aborted", "touched", "touched_missed", "with_false_contacts",
        "contacts_localized", "sets_missed", "contacts_wrong", "ellipses", "ellipses_missed",
    )  # fmt: skip
    rows = [
        (
            row["kind"], *(str(row[count]) for count in counts),
            _decimals(row["best_cm"]), _decimals(row["best_se_cm"]),
        )
        for row in study["rows"]
        if row["setting"] == "default"
    ]  # fmt: skip
    return [Grid(head, rows)]


def _decimals(value: float | None, digits: int = 2) -> str:
    """A number to its digits; empty where there is none."""
    return "" if value is None else f"{value:.{digits}f}"


# Heads of the columns of robots that were explored or pushed, their keys in a row, and formats.
_ROBOT_COLUMNS = (
    ("robot", "robot", "s"),
    ("check", "check", "s"),
    ("rooms", "rooms", "d"),
    ("missed, %", "missed_percent", ".3g"),
    ("localized wrong, %", "wrong_percent", ".3g"),
    ("localized", "localized", "d"),
    ("median error, % of length", "error_percent", ".2g"),
    ("largest error, %", "worst_percent", ".2g"),
    ("outside of their ellipses, %", "outside_percent", ".2g"),
    ("empty rooms", "empty_rooms", "d"),
    ("localized in these", "empty_localized", "d"),
    ("runs aborted", "aborted", "d"),
)


def _by_columns(columns: Sequence[tuple[str, str, str]], rows: list[dict[str, Any]]) -> list[Grid]:
    """A study's rows by columns of a heading, a key and a format; what is unknown is empty."""
    cells = [
        tuple("" if row[key] is None else f"{row[key]:{digits}}" for _, key, digits in columns)
        for row in rows
    ]
    return [Grid(tuple(head for head, _, _ in columns), cells)]


def _robots(studies: list[dict[str, Any]]) -> list[Grid]:
    """A row a robot; those of the gallery have what `thigmo robot check` says of their file."""
    (study,) = studies
    columns = [column for column in _ROBOT_COLUMNS if column[1] in study["rows"][0]]
    return _by_columns(columns, study["rows"])


_FIELD_COLUMNS = (
    ("what robot.toml does not state", "kind", ""), ("sides", "rooms", ""),
    ("touched at the last peak, and listed", "judged", ""),
    ("mean error in the plane, cm", "error_cm", ".2f"),
    ("ellipses without the truth, %", "outside_percent", ".3g"),
    ("arc outside of its set", "off_set", ""), ("localized", "localized", ""),
    ("localized wrong", "wrong", ""), ("missed", "missed", ""), ("false", "false", ""),
)  # fmt: skip


def _field(studies: list[dict[str, Any]]) -> list[Grid]:
    """A row a kind of error."""
    (study,) = studies
    return _by_columns(_FIELD_COLUMNS, study["rows"])


_MAP_COLUMNS = (
    ("map given", "map", ""), ("rooms", "rooms", ""), ("runs aborted", "aborted", ""),
    ("contacts", "touched", ""), ("missed", "touched_missed", ""),
    ("found without it alone", "lost", ""), ("false", "false", ""),
    ("localized", "localized", ""), ("localized wrong", "wrong", ""),
    ("mean error in the plane, cm", "error_cm", ".2f"), ("less that without", "more_cm", ".2f"),
    ("its standard error", "more_se_cm", ".2f"), ("robot time, s", "time_s", ".0f"),
    ("over that without", "time_share", ".2f"),
)  # fmt: skip


def _maps(studies: list[dict[str, Any]]) -> list[Grid]:
    """A row a map that was given."""
    (study,) = studies
    return _by_columns(_MAP_COLUMNS, study["rows"])


def _notes(study: dict[str, Any]) -> list[Row]:
    return [(*note.rsplit(": ", 1), "") for note in study["notes"]]


def _accuracy(studies: list[dict[str, Any]]) -> list[Grid]:
    """A row an error, stated or not: the worst of its groups of bodies that are touched."""
    (study,) = studies
    head = (
        "error", "stated", "coverage from", "to", "localized and wrong at most, %", "in group",
        "contacts found from", "to", "frames a group",
    )  # fmt: skip
    rows = []
    for error in dict.fromkeys(row["error"] for row in study["rows"]):
        can_be = any(row["error"] == error and row["stated"] for row in study["rows"])
        for stated in (False, True):
            error_rows = [
                row
                for row in study["rows"]
                if (row["error"], row["stated"]) == (error, stated) and "free" not in row["group"]
            ]
            if not error_rows:
                continue
            wrong = max(error_rows, key=lambda row: row["wrong"])
            covered, contacts = [r["covered"] for r in error_rows], [r["found"] for r in error_rows]
            rows.append((
                error, ("yes" if stated else "no") if can_be else "", f"{min(covered):.3f}",
                f"{max(covered):.3f}", f"{100 * wrong['wrong']:.2g}", wrong["group"],
                f"{min(contacts):.2f}", f"{max(contacts):.2f}", str(error_rows[0]["count"]),
            ))  # fmt: skip
    return [Grid(head, rows)]


def _of_localized(row: dict[str, Any]) -> str:
    """Share of the localized frames that are wrong, in %; empty if none is localized."""
    return f"{100 * row['wrong'] / row['localized']:.1f}" if row["localized"] else ""


def _shares(row: dict[str, Any]) -> tuple[str, str, str]:
    """Of a group's frames, in %: localized, localized and wrong, and the latter of the former."""
    return f"{100 * row['localized']:.0f}", f"{100 * row['wrong']:.1f}", _of_localized(row)


def _mistakes(studies: list[dict[str, Any]]) -> list[Grid]:
    """A row a group: wrong answers with nothing stated, and beside them with the error stated."""
    (study,) = studies
    head = (
        "mistake", "body", "frames", "localized, %", "wrong, %", "wrong of these, %",
        "stated: localized, %", "wrong, %", "wrong of these, %",
    )  # fmt: skip
    stated = {(row["kind"], row["body"]): row for row in study["rows"] if row["stated"]}
    rows = [
        (row["kind"], row["body"], str(row["count"]), *_shares(row),
         *_shares(stated[row["kind"], row["body"]]))
        for row in study["rows"]
        if not row["stated"] and not row["kind"].startswith("empty")  # these are among the claims
    ]  # fmt: skip
    return [Grid(head, rows)]


def _loads(studies: list[dict[str, Any]]) -> list[Grid]:
    (study,) = studies
    head = (
        "group", "frames", "no contact, %", "one, %", "two, %", "localized, %", "wrong, %",
        "wrong of these, %",
    )  # fmt: skip
    rows = [
        (row["group"], str(row["count"]),
         *(f"{100 * row[count]:.1f}" for count in ("none", "one", "two")), *_shares(row))
        for row in study["rows"]
    ]  # fmt: skip
    return [Grid(head, rows)]


def _in_space(studies: list[dict[str, Any]]) -> list[Grid]:
    """Each group's places."""
    head = (
        "group", "rods", "mean place error, % of length", "coverage", "number right, %",
        "localized, %", "wrong, %", "wrong of these, %", "force in its interval, %",
    )  # fmt: skip
    rows = [
        (row["group"], str(row["count"]), f"{100 * row['place_off']:.2f}",
         f"{row['coverage']:.3f}", f"{100 * row['found']:.1f}", *_shares(row),
         f"{100 * row['newtons_covered']:.1f}")
        for study in studies
        for row in study["rows"]
    ]  # fmt: skip
    return [Grid(head, rows)]


def _number_claims(studies: list[dict[str, Any]]) -> list[Row]:
    """The claims, and how many frames leave the number in doubt."""
    notes = [note.split(": ", 1) for study in studies for note in study["notes"]]
    return _claims(studies) + [(quantity, "", said) for quantity, said in notes]


def _stability(studies: list[dict[str, Any]]) -> list[Grid]:
    """A row a map: each method's mean error, and its failures."""
    (study,) = studies
    methods = list(dict.fromkeys(row["method"] for row in study["rows"]))
    columns = [column for method in methods for column in (f"{method}, cm", "failed, %")]
    rows = []
    for stress in dict.fromkeys(row["stress"] for row in study["rows"]):
        by_method = {row["method"]: row for row in study["rows"] if row["stress"] == stress}
        cells = []
        for method in methods:
            row = by_method.get(method)
            mean = None if row is None else row["mean_cm"]
            cells += [
                "" if mean is None else _number(mean),
                "" if row is None else f"{100 * row['failures']:.0f}",
            ]
        rows.append((stress, str(next(iter(by_method.values()))["cases"]), *cells))
    return [Grid(("stress", "cases", *columns), rows)]


def _stopping(studies: list[dict[str, Any]]) -> list[Row]:
    (study,) = studies
    return [
        (
            f"{row['who']}: {row['how']}",
            f"{row['p50_ms']:.0f} ms",
            f"worst {row['worst_ms']:.0f} ms of {row['n']}",
        )
        for row in study["rows"]
    ] + _claims(studies)


def _budgets(figures: dict[str, Any]) -> list[Row]:
    return [
        (
            name,
            f"{_number(figure['value'])} {figure['unit']}".strip(),
            ""
            if figure["limit"] is None
            else f"{'at least' if figure['least'] else 'at most'} {_number(figure['limit'])}"
            f"{'' if figure['kept'] else '; **exceeded**'}",
        )
        for name, figure in figures.items()
    ]


def _boards(boards: dict[str, Any]) -> list[Row]:
    return [
        (f"{board}: {column}", value, "")
        for board, row in boards.items()
        for column, value in row.items()
    ]


def _benchmark(groups: list[dict[str, Any]]) -> list[Row]:
    rows = []
    for method in dict.fromkeys(row["method"] for row in groups):
        method_rows = [row for row in groups if row["method"] == method]
        answered = sum(row["answered"] for row in method_rows)
        failed = sum(row["answered"] * (row["failures"] or 0.0) for row in method_rows)
        rows.append((method, f"{100 * failed / max(answered, 1):.0f} %", f"of {answered} failed"))
    return rows


def _benchmark_groups(cells: list[dict[str, Any]]) -> list[Grid]:
    """Mean errors of all methods by group; then what methods with intervals claim."""
    groups = list(dict.fromkeys(row["group"] for row in cells))
    methods = list(dict.fromkeys(row["method"] for row in cells))
    errors = {(row["method"], row["group"]): row["error_cm"] for row in cells if row["answered"]}
    table = [
        (method, *(_decimals(errors.get((method, group))) for group in groups))
        for method in methods
    ]
    claims = [
        (row["method"], row["group"], f"{row['claimed']:.2f}", f"{row['overclaimed']:.2f}",
         _decimals(row["coverage"]))
        for row in cells
        if row["claimed"]
    ]  # fmt: skip
    return [
        Grid(("mean error, cm", *groups), table),
        Grid(("method", "group", "localized", "over-claimed of these", "coverage"), claims),
    ]


def _number(value: float | str | None) -> str:
    if value is None or isinstance(value, str):
        return value or "unbounded"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


THIGMO = ".venv/bin/thigmo"
# Studies of minutes: on two processes.
LONG = (
    "speed-accuracy",
    "stability",
    "accuracy",
    "mistakes",
    "loads",
    "number",
    "exploration",
    "field",
    "camera",
)
# The rules were chosen while looking at rooms of the usual seed: the table has others.
SEEDS = {
    "exploration": ("--seed", "109", "--most", "6"),
    "field": ("--seed", "107", "--most", "30"),
}
OWN_ROWS: dict[str, Callable[[Any], list[Row]]] = {
    "exploration": _explorations,
    "number": _number_claims,
    "stopping": _stopping,
    "crowd": _stopping,
}
GRIDS: dict[str, Callable[[Any], list[Grid]]] = {
    "exploration": _explored_rooms,
    "field": _field,
    "maps": _maps,
    "robots": _robots,
    "gallery": _robots,
    "accuracy": _accuracy,
    "mistakes": _mistakes,
    "loads": _loads,
    "space": _in_space,
    "stability": _stability,
}
SOURCES: dict[str, Source] = {
    "explore": Source(
        (THIGMO, "explore", "--seed", "1", "--name", "readme", "--json"),
        _explore,
        {"map.png": "map.png"},
    ),
    "experiments": Source(
        (THIGMO, "experiment", "all", "--robots", "10", "--jobs", "2", "--json"),
        _experiments_and_claims,
        {
            "two-contacts-errors.png": "two-contacts.png",
            "sensitivity-sensitivity.png": "sensitivity.png",
        },
        _measures,
    ),
    "experiments-robots": Source(
        (THIGMO, "experiment", "single-contact", "--robots", "100", "--trials", "1", "--json"),
        _many_robots,
        {},
        _places,
    ),
    **{
        f"bench-{study}": Source(
            (
                *(THIGMO, "bench", study, *(("--jobs", "2") if study in LONG else ())),
                *(*SEEDS.get(study, ()), "--json"),
            ),
            OWN_ROWS.get(study, _claims),
            pictures,
            GRIDS.get(study, lambda _: []),
        )
        for study, pictures in {
            "speed-accuracy": {"speed-accuracy-chart.png": "speed-accuracy.png"},
            "stability": {
                "stability-force-place.png": "stability.png",
                "stability-unstated.png": "stability-unstated.png",
            },
            "scaling": {},
            "space": {},
            "accuracy": {"accuracy-stated.png": "stated.png", "accuracy-odds.png": "odds.png"},
            "mistakes": {"mistakes-chart.png": "mistakes.png"},
            "loads": {},
            "number": {"number-number.png": "number.png", "number-trade.png": "trade.png"},
            "exploration": {
                "exploration-explorations.png": "explorations.png",
            },
            "field": {},
            "maps": {},
            "robots": {},
            "gallery": {},
            "plant-models": {"plant-models-ladder.png": "ladder.png"},
            "camera": {},
            "trigger": {"trigger-chart.png": "trigger.png"},
            "watch": {},
            "stopping": {},
            "crowd": {},
        }.items()
    },
    "budgets": Source((".venv/bin/python", "tools/budgets.py", "--json"), _budgets, {}),
    "soak": Source((".venv/bin/python", "tools/soak.py", "--json"), _budgets, {}),
    "benchmark": Source(
        (".venv/bin/python", "tools/benchmark.py", "table", "--jobs", "2"),
        _benchmark,
        {},
        _benchmark_groups,
    ),
    "boards": Source((".venv/bin/python", "tools/boards.py", "--json"), _boards, {}),
}


def run(name: str) -> None:
    """Run one source's command; keep its JSON and its pictures."""
    source = SOURCES[name]
    with tempfile.TemporaryDirectory() as folder:
        command = list(source.command)
        if command[0] == THIGMO:
            command += ["--out", folder]
        print(f"{name}: {source.shown}", flush=True)
        # Its progress goes to the terminal.
        done = subprocess.run(command, cwd=ROOT, check=False, stdout=subprocess.PIPE, text=True)
        try:
            results = json.loads(done.stdout)
            source.rows(results)  # of a command that ends with 1 for a broken promise, too
        except (ValueError, KeyError, TypeError, AttributeError):
            sys.exit(f"{name}: exit {done.returncode}; see above")
        RESULTS.mkdir(parents=True, exist_ok=True)
        # Where this machine put the files is nobody's business.
        for part in results if isinstance(results, list) else [results]:
            part.pop("run", None)
            part.pop("files", None)
        (RESULTS / f"{name}.json").write_text(json.dumps(results, indent=1) + "\n")
        for made, kept in source.pictures.items():
            shutil.copy(next(Path(folder).rglob(made)), ROOT / "docs" / kept)


def draw_dial() -> None:
    """Draw docs/dial.png from the kept rows of the explorations."""
    from thigmo_bench.studies.exploration import dial_figure

    (study,) = json.loads((RESULTS / "bench-exploration.json").read_text())
    dial_figure(study["dial"]).savefig(ROOT / "docs" / "dial.png", dpi=200)


DIAL = ROOT / "host" / "thigmo" / "exploration" / "dial.json"
_DIAL_COLUMNS = ("kind", "setting", "rooms", "time_s", "error_cm", "missed")


def dial_rows() -> str:
    """dial.json: what the page tells of efforts and budgets before a run."""
    (study,) = json.loads((RESULTS / "bench-exploration.json").read_text())
    rows = [{name: row[name] for name in _DIAL_COLUMNS} for row in study["dial"]]
    for row in rows:
        row.update({name: round(row[name], 3) for name in ("time_s", "error_cm", "missed")})
    return json.dumps(rows, indent=1) + "\n"


# The five rows of README, by source and name, with the words that README has for them.
HEADLINES = (
    (
        "bench-exploration",
        "one peg, default: mean error in the plane",
        "mean error, in the plane, of the contact that a default exploration finds",
    ),
    (
        "experiments",
        "two-contacts, closer than 23.5 cm: x error in the room",
        "x error of two contacts less than 23.5 cm apart (thesis: 16.94 cm)",
    ),
    (
        "bench-accuracy",
        "errors stated: least coverage",
        "share of 95 % intervals that hold the true contact, in the worst case of stated errors",
    ),
    (
        "bench-scaling",
        "one contact, straight, 10 readings",
        "time of one answer of `thigmo.localize`, ten readings",
    ),
    ("budgets", "trigger: step to event on the wire", "touch to event on the wire, on the Mega"),
)


def _rows(name: str) -> list[Row]:
    """A source's rows; none if it was never run."""
    path = RESULTS / f"{name}.json"
    return SOURCES[name].rows(json.loads(path.read_text())) if path.is_file() else []


def table(name: str) -> str:
    """The table of one source, with the command that makes it."""
    rows = _rows(name)
    lines = [f"`{SOURCES[name].shown}`", ""]
    if not rows:
        return "\n".join([*lines, "Not run yet.", "", ""])
    results = json.loads((RESULTS / f"{name}.json").read_text())
    studies = results if isinstance(results, list) else []
    for study in studies:
        if samples := study.get("samples"):
            study_name = f" of {study['study']}" if len(studies) > 1 else ""
            cases = "; ".join(f"{part}: {count}" for part, count in samples.items())
            lines += [f"Cases{study_name}: {cases}.", ""]
    tables = [Grid(("what", "value", ""), list(rows)), *SOURCES[name].grids(results)]
    for grid in tables:
        if grid.rows:
            lines += [_line(grid.head), _line(["---"] * len(grid.head)), *map(_line, grid.rows), ""]
    return "\n".join([*lines, ""])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def headlines() -> str:
    """README's table: one row of each of five sources, with its command."""
    lines = ["| what | value | command |", "| --- | --- | --- |"]
    for name, wanted, words in HEADLINES:
        if not _rows(name):
            continue  # never run
        values = {row_name: value for row_name, value, _ in _rows(name)}
        if wanted not in values:
            sys.exit(f"docs/results/{name}.json has no row {wanted!r}; correct HEADLINES")
        command = SOURCES[name].shown.replace(".venv/bin/", "").replace(" --json", "")
        lines.append(f"| {words} | {values[wanted]} | `{command}` |")
    return "\n".join([*lines, "", ""])


MISSED = ("**missed**", "**exceeded**")


def summary() -> str:
    """How many promises each table keeps, and the rows that miss theirs."""
    counts = ["| command | promises | kept |", "| --- | --- | --- |"]
    missed = ["| missed | value | |", "| --- | --- | --- |"]
    for name, source in SOURCES.items():
        promised = [row for row in _rows(name) if _is_promise(row)]
        late = [row for row in promised if any(mark in row[2] for mark in MISSED)]
        if promised:
            command = source.shown.replace(".venv/bin/", "").replace(" --json", "")
            counts.append(f"| `{command}` | {len(promised)} | {len(promised) - len(late)} |")
        missed += [f"| {row_name} | {value} | {note} |" for row_name, value, note in late]
    return "\n".join([*counts, "", *missed, "", ""])


def _is_promise(row: Row) -> bool:
    note = row[2]
    return note.startswith(("promised", "at least", "at most")) or any(m in note for m in MISSED)


# Tables of more than one source.
ACROSS = {"headlines": headlines, "summary": summary}


def rendered(page: Path) -> str:
    """The page with every table generated again."""

    def place(mark: re.Match[str]) -> str:
        name = mark[2]
        return mark[1] + (ACROSS[name]() if name in ACROSS else table(name)) + mark[3]

    return PLACE.sub(place, page.read_text())


def main() -> None:
    """Parse the command line and do what it says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sources", nargs="*", choices=[[], *SOURCES], help="all when left out")
    parser.add_argument("--render", action="store_true", help="run nothing")
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    options = parser.parse_args()
    placed = {name for page in PAGES for _, name, _ in PLACE.findall(page.read_text())}
    if placed != {*SOURCES, *ACROSS}:
        wrong = ", ".join(sorted(placed ^ {*SOURCES, *ACROSS}))
        sys.exit(f"docs/figures.md and SOURCES differ in: {wrong}; give each table its place")
    if not (options.render or options.check):
        for name in options.sources or SOURCES:
            run(name)
            if name == "bench-exploration":
                draw_dial()
    made_of = {page: rendered(page) for page in PAGES} | {DIAL: dial_rows()}
    for page, made in made_of.items():
        if options.check and (not page.is_file() or made != page.read_text()):
            sys.exit(
                f"{page.name}'s figures are not what docs/results say; run "
                "tools/figures.py --render"
            )
        if not options.check:
            page.write_text(made)


if __name__ == "__main__":
    main()
