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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results"
PAGES = (ROOT / "README.md", ROOT / "docs" / "figures.md", ROOT / "docs" / "benchmark.md")
PLACE = re.compile(r"(<!-- figures: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
Row = tuple[str, str, str]


@dataclass(frozen=True)
class Source:
    """A command, the pictures of it that are kept, and the rows made of its JSON."""

    command: tuple[str, ...]
    rows: Callable[[Any], list[Row]]
    pictures: dict[str, str]

    @property
    def command_line(self) -> str:
        """The command as a reader types it."""
        return " ".join(self.command)


EXPLORED = "default exploration: \\|x error\\| (thesis: 6.82 cm)"


def _explore(result: dict[str, Any]) -> list[Row]:
    return [
        (
            EXPLORED,
            f"{result['error_x_cm']:.2f} cm",
            "one run; many seeds in the rows below",
        ),
        (
            "default exploration: robot time over wall time",
            f"{result['robot_per_wall_time']:.0f}",
            f"{result['robot_time_s']:.0f} s of robot time in {result['wall_time_s']:.1f} s",
        ),
    ]


def _experiments(results: list[dict[str, Any]]) -> list[Row]:
    return [
        (
            f"{row['experiment']}, {row['condition']}: x error in the room",
            f"{row['ours_workspace_mean']:.2f} cm",
            f"thesis's method here {row['here_workspace_mean']:.2f}{_above(row['beaten'])}; "
            f"in the thesis's measure {row['ours_mean']:.2f}, its method here "
            f"{row['here_mean']:.2f}, thesis {row['thesis_mean']:.2f}{_above(row['mean_beaten'])}; "
            f"bound {_number(row['bound_mean'])}, "
            f"in that measure {_number(row['bound_measured_mean'])}",
        )
        for experiment in results
        for row in experiment["rows"]
    ]


def _predictions(results: list[dict[str, Any]]) -> list[Row]:
    """What the fitted constants predict, with the tool's own verdict."""
    rows = []
    for study in results:
        for note in study["notes"] if study["study"] == "predictions" else []:
            name, outcome = note.split(": ", 1)
            verdict = outcome.split("(")[1].split(";")[0]
            rows.append((f"prediction: {name}", verdict, outcome.replace(f"{verdict}; ", "")))
    return rows


def _many_robots(results: list[dict[str, Any]]) -> list[Row]:
    """Ours less its method, with the standard error over the robots."""
    rows = []
    for row in (row for experiment in results for row in experiment["rows"]):
        tie = abs(row["less_mean"]) < 2 * row["less_se"]
        verdict = "a tie" if tie else "ours" if row["less_mean"] > 0 else "its method"
        places = ", ".join(
            f"{place} {its:.2f} / {ours:.2f}" for place, (its, ours) in row["by_place"].items()
        )
        rows.append((
            f"{row['condition']}: x error in the room, its method less ours",
            f"{row['less_mean']:.2f} +- {row['less_se']:.2f} cm",
            f"nearer: {verdict}; its method / ours {row['here_workspace_mean']:.2f} / "
            f"{row['ours_workspace_mean']:.2f}, at {places}; in the thesis's measure "
            f"{row['here_mean']:.2f} / {row['ours_mean']:.2f}",
        ))  # fmt: skip
    return rows


def _above(beaten: bool) -> str:
    return "" if beaten else " (**above what is allowed**)"


def _experiments_and_claims(results: list[dict[str, Any]]) -> list[Row]:
    claims = _claims([e for e in results if not e["rows"]])
    return _experiments(results) + claims + _predictions(results)


def _claims(results: list[dict[str, Any]]) -> list[Row]:
    rows = []
    for study in results:
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
    """A claim's value, with one more digit where a miss would look like a hit."""
    rounded = _number(claim["value"])
    return (
        rounded if claim["holds"] or rounded != _number(claim["limit"]) else f"{claim['value']:.4g}"
    )


def _explorations(results: list[dict[str, Any]]) -> list[Row]:
    (study,) = results
    kinds = [
        (
            row["kind"],
            f"{row['touched_missed']} of {row['touched']} missed, "
            f"{row['with_false_contacts']} with false contacts, "
            f"{row['contacts_wrong']} of {row['contacts_localized']} localized wrong",
            f"{row['rooms']} rooms"
            + (f", {row['aborted']} aborted" if row["aborted"] else "")
            + (
                ""
                if row["median_error_x_cm"] is None
                else f"; median \\|x error\\| {row['median_error_x_cm']:.2f} cm"
            ),
        )
        for row in study["rows"]
    ]
    return kinds + _claims(results) + _notes(study)


def _robots(results: list[dict[str, Any]]) -> list[Row]:
    """A row a robot."""
    (study,) = results
    kinds = [
        (
            row["robot"],
            f"{row['missed_percent']:.3g} % missed, {row['wrong_percent']:.3g} % wrong, "
            f"{row['localized']} localized of {row['rooms']}",
            f"in the plane {row['error_percent']:.2g} % of the length off in the median and "
            f"{row['worst_percent']:.2g} % at most, {row['outside_percent']:.2g} % outside of "
            f"their ellipses; {row['empty_localized']} localized in {row['empty_rooms']} empty "
            "rooms",
        )
        for row in study["rows"]
    ]
    return kinds + _claims(results)


def _notes(study: dict[str, Any]) -> list[Row]:
    return [(*note.rsplit(": ", 1), "") for note in study["notes"]]


def _accuracy(results: list[dict[str, Any]]) -> list[Row]:
    """A row an error: the worst of its groups of bodies that are touched."""
    (study,) = results
    rows = _claims(results)
    for error in dict.fromkeys(row["error"] for row in study["rows"]):
        for stated in (False, True):
            cases = [
                row
                for row in study["rows"]
                if (row["error"], row["stated"]) == (error, stated) and "free" not in row["group"]
            ]
            if not cases:
                continue
            can_be = any(row["error"] == error and row["stated"] for row in study["rows"])
            how = ", stated" if stated else ", not stated" if can_be else ""
            cover = [row["covered"] for row in cases]
            wrong = max(cases, key=lambda row: row["wrong"])
            rows.append(
                (
                    f"{error}{how}: coverage",
                    f"{min(cover):.3f} to {max(cover):.3f}",
                    f"localized and wrong at most {100 * wrong['wrong']:.2g} % "
                    f"({wrong['group']}), contacts found {min(r['found'] for r in cases):.2f} to "
                    f"{max(r['found'] for r in cases):.2f}; {cases[0]['count']} frames a group",
                )
            )
    return rows


def _wrong(row: dict[str, Any]) -> str:
    """Frames with a localized contact where nothing is: of all, and of those with a localized one.

    The latter is not there if none is localized.
    """
    if not row["localized"]:
        return "wrong 0.0 %"
    of_localized = row["wrong"] / row["localized"]
    return f"wrong {100 * row['wrong']:.1f} % ({100 * of_localized:.1f} % of localized)"


def _mistakes(results: list[dict[str, Any]]) -> list[Row]:
    """A row a group: wrong answers with nothing stated, and beside them with the error stated."""
    (study,) = results
    rows = []
    stated = {(row["kind"], row["body"]): row for row in study["rows"] if row["stated"]}
    for row in study["rows"]:
        if row["stated"] or row["kind"].startswith("empty"):
            continue  # empty bodies stand among the claims
        right = stated[row["kind"], row["body"]]
        rows.append(
            (
                f"{row['kind']}: {row['body']}",
                _wrong(row),
                f"of {row['count']} frames, localized {100 * row['localized']:.0f} %; with the "
                f"error stated {_wrong(right)}, localized {100 * right['localized']:.0f} %",
            )
        )
    return rows + _claims(results)


def _loads(results: list[dict[str, Any]]) -> list[Row]:
    (study,) = results
    return _claims(results) + [
        (
            row["group"],
            " / ".join(f"{100 * row[count]:.1f}" for count in ("none", "one", "two")) + " %",
            f"of {row['count']} frames answered with no, one, two contacts; "
            f"localized {100 * row['localized']:.1f} %, {_wrong(row)}",
        )
        for row in study["rows"]
    ]


def _in_space(results: list[dict[str, Any]]) -> list[Row]:
    """The claims, and each group's places."""
    return _claims(results) + [
        (
            f"{row['group']}: mean place error",
            f"{100 * row['place_off']:.2f} %",
            f"coverage {row['coverage']:.3f}, number right {100 * row['found']:.1f} %, "
            f"localized {100 * row['localized']:.1f} %, {_wrong(row)}, "
            f"force in its interval {100 * row['newtons_covered']:.1f} % of {row['count']} rods",
        )
        for study in results
        for row in study["rows"]
    ]


def _number_claims(results: list[dict[str, Any]]) -> list[Row]:
    """The claims, and how many frames leave the number in doubt."""
    notes = [note.split(": ", 1) for study in results for note in study["notes"]]
    return _claims(results) + [(name, "", outcome) for name, outcome in notes]


def _stability(results: list[dict[str, Any]]) -> list[Row]:
    """A row a map: the default's mean error and failures, then those of the other methods."""
    (study,) = results
    rows = _claims(results)
    for stress in dict.fromkeys(row["stress"] for row in study["rows"]):
        default, *rivals = (row for row in study["rows"] if row["stress"] == stress)
        rival_text = ", ".join(
            f"{row['method']} "
            + ("" if row["mean_cm"] is None else f"{_number(row['mean_cm'])} ")
            + f"({100 * row['failures']:.0f} %)"
            for row in rivals
        )
        rows.append(
            (
                f"{stress}, {default['cases']} cases: mean error (failures)",
                f"{_number(default['mean_cm'])} cm ({100 * default['failures']:.0f} %)",
                rival_text,
            )
        )
    return rows


def _stopping(results: list[dict[str, Any]]) -> list[Row]:
    (study,) = results
    return [
        (
            f"{row['who']}: {row['how']}",
            f"{row['p50_ms']:.0f} ms",
            f"worst {row['worst_ms']:.0f} ms of {row['n']}",
        )
        for row in study["rows"]
    ] + _claims(results)


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


def _benchmark(rows_of_methods: list[dict[str, Any]]) -> list[Row]:
    rows = []
    for method in dict.fromkeys(row["method"] for row in rows_of_methods):
        method_rows = [row for row in rows_of_methods if row["method"] == method]
        answered = sum(row["answered"] for row in method_rows)
        failed = sum(row["answered"] * (row["failures"] or 0.0) for row in method_rows)
        groups = ", ".join(
            f"{row['group']} {_number(row['error_cm'])}" for row in method_rows if row["answered"]
        )
        note = f"mean error, cm: {groups}"
        claiming = [row for row in method_rows if row["claimed"]]
        if claiming:
            note += "; localized, of these overclaimed: " + ", ".join(
                f"{row['group']} {row['claimed']:.2f}, {row['overclaimed']:.2f}" for row in claiming
            )
            note += "; coverage: " + ", ".join(
                f"{row['group']} {row['coverage']:.2f}" for row in method_rows if row["coverage"]
            )
        rows.append((method, f"{100 * failed / max(answered, 1):.0f} % of {answered} failed", note))
    return rows


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
    "camera",
)
# The rules were chosen while looking at rooms of the usual seed: the table has others.
SEEDS = {"exploration": ("--seed", "31")}
OWN_ROWS: dict[str, Callable[[Any], list[Row]]] = {
    "exploration": _explorations,
    "robots": _robots,
    "accuracy": _accuracy,
    "mistakes": _mistakes,
    "loads": _loads,
    "number": _number_claims,
    "space": _in_space,
    "stability": _stability,
    "stopping": _stopping,
    "crowd": _stopping,
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
    ),
    "experiments-robots": Source(
        (THIGMO, "experiment", "single-contact", "--robots", "100", "--trials", "1", "--json"),
        _many_robots,
        {},
    ),
    **{
        f"bench-{study}": Source(
            (
                *(THIGMO, "bench", study, *(("--jobs", "2") if study in LONG else ())),
                *(*SEEDS.get(study, ()), "--json"),
            ),
            OWN_ROWS.get(study, _claims),
            pictures,
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
            "robots": {},
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
        (".venv/bin/python", "tools/benchmark.py", "table", "--jobs", "2"), _benchmark, {}
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
        print(f"{name}: {source.command_line}", flush=True)
        # Its progress goes to the terminal.
        process = subprocess.run(command, cwd=ROOT, check=False, stdout=subprocess.PIPE, text=True)
        try:
            result = json.loads(process.stdout)
            source.rows(result)  # of a command that ends with 1 for a broken promise, too
        except (ValueError, KeyError, TypeError, AttributeError):
            sys.exit(f"{name}: exit {process.returncode}; see above")
        RESULTS.mkdir(parents=True, exist_ok=True)
        # Where this machine put the files is nobody's business.
        for part in result if isinstance(result, list) else [result]:
            part.pop("run", None)
            part.pop("files", None)
        (RESULTS / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")
        for made_name, kept_name in source.pictures.items():
            shutil.copy(next(Path(folder).rglob(made_name)), ROOT / "docs" / kept_name)


def draw_dial() -> None:
    """Draw docs/dial.png from the kept rows of the explorations."""
    from thigmo_bench.studies.exploration import dial_figure

    (study,) = json.loads((RESULTS / "bench-exploration.json").read_text())
    dial_figure(study["dial"]).savefig(ROOT / "docs" / "dial.png", dpi=200)


# The five rows of README, by source and name, with the words that README has for them.
HEADLINES = (
    (
        "bench-exploration",
        "one peg, default: mean error in the plane",
        "mean error, in the plane, of the contact that a default exploration finds, 40 rooms",
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
    lines = [f"`{SOURCES[name].command_line}`", ""]
    if not rows:
        return "\n".join([*lines, "Not run yet.", "", ""])
    result = json.loads((RESULTS / f"{name}.json").read_text())
    studies = result if isinstance(result, list) else []
    for study in studies:
        if samples := study.get("samples"):
            study_name = f" of {study['study']}" if len(studies) > 1 else ""
            cases = "; ".join(f"{part}: {count}" for part, count in samples.items())
            lines += [f"Cases{study_name}: {cases}.", ""]
    lines += ["| what | value | |", "| --- | --- | --- |"]
    return "\n".join([*lines, *(f"| {a} | {b} | {c} |" for a, b, c in rows), "", ""])


def headlines() -> str:
    """README's table: one row of each of five sources, with its command."""
    lines = ["| what | value | command |", "| --- | --- | --- |"]
    for name, row_name, words in HEADLINES:
        if not _rows(name):
            continue  # never run
        values = {row: value for row, value, _ in _rows(name)}
        if row_name not in values:
            sys.exit(f"docs/results/{name}.json has no row {row_name!r}; correct HEADLINES")
        command = SOURCES[name].command_line.replace(".venv/bin/", "").replace(" --json", "")
        lines.append(f"| {words} | {values[row_name]} | `{command}` |")
    return "\n".join([*lines, "", ""])


MISSED = ("**missed**", "**exceeded**", "**above what is allowed**")


def summary() -> str:
    """How many promises each table keeps, and the rows that miss theirs."""
    counts = ["| command | promises | kept |", "| --- | --- | --- |"]
    missed = ["| missed | value | |", "| --- | --- | --- |"]
    for name, source in SOURCES.items():
        promised = [row for row in _rows(name) if _is_promise(row)]
        late = [row for row in promised if any(mark in row[2] for mark in MISSED)]
        if promised:
            command = source.command_line.replace(".venv/bin/", "").replace(" --json", "")
            counts.append(f"| `{command}` | {len(promised)} | {len(promised) - len(late)} |")
        missed += [f"| {row} | {value} | {note} |" for row, value, note in late]
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
    for page in PAGES:
        text = rendered(page)
        if options.check and text != page.read_text():
            sys.exit(
                f"{page.name}'s figures are not what docs/results say; run "
                "tools/figures.py --render"
            )
        if not options.check:
            page.write_text(text)


if __name__ == "__main__":
    main()
