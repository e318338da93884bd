"""Breaks the sources one operator at a time, and asks whether the tests notice.

`python tools/mutations.py` draws a sample of mutants of firmware/core/safety and of the localizer,
builds each, and runs the tests that are to catch it; docs/results/mutations.json keeps how many
they caught, and those that survived, to be read: some change nothing. It works in this tree, which
must be clean, and puts every file back. Run it before and after tests are removed.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "docs" / "results" / "mutations.json"
PARTS = {
    "safety": (["firmware/core/safety/*.h"], ["tests/unit/firmware"]),
    "localization": (
        ["host/thigmo/localization/*.py", "host/thigmo/localization/*.h"],
        ["tests/oracles", "tests/unit/localization"],
    ),
}
SWAPS = {
    "<=": "<", ">=": ">", " < ": " <= ", " > ": " >= ", "==": "!=", "!=": "==", "&&": "||",
    "||": "&&", " + ": " - ", " - ": " + ", " * ": " / ", " / ": " * ", " and ": " or ",
    " or ": " and ", "true": "false", "false": "true", "True": "False", "False": "True",
    " not ": " ", "!": "", "1.0": "2.0", "0.5": "0.6",
}  # fmt: skip
OPERATOR = re.compile("|".join(map(re.escape, sorted(SWAPS, key=len, reverse=True))))
COMMENT = re.compile(r"\s*(//|#|\*|\"\"\")|.*static_assert|\s*(from|import|template|raise)\b")
Place = tuple[Path, int, int, str]  # file, line from 0, column, operator


def places(patterns: list[str]) -> list[Place]:
    """Operators in code; text between quotes and docstrings are none."""
    operators = []
    for path in sorted(file for pattern in patterns for file in ROOT.glob(pattern)):
        text = re.sub(r'"""[\s\S]*?"""', lambda doc: "\n" * doc[0].count("\n"), path.read_text())
        for number, line in enumerate(text.splitlines()):
            if COMMENT.match(line):
                continue
            code = re.sub(r'"[^"]*"', lambda quoted: "~" * len(quoted[0]), line)
            code = re.split(r"//|  #", code)[0]
            operators += [(path, number, m.start(), m[0]) for m in OPERATOR.finditer(code)]
    return operators


def mutate(place: Place) -> tuple[str, str]:
    """Write a mutant; its line, and the file's old text."""
    path, number, column, operator = place
    old = path.read_text()
    lines = old.splitlines(keepends=True)
    line = lines[number]
    lines[number] = line[:column] + SWAPS[operator] + line[column + len(operator) :]
    path.write_text("".join(lines))
    return f"{line.strip()} -> {lines[number].strip()}", old


def built() -> bool:
    """Build the extensions and put them where the interpreter finds them."""
    folder = next((ROOT / "build").glob("cp3*"))
    cmake = Path(sys.executable).with_name("cmake")
    target = sysconfig.get_path("platlib")
    commands = [["--build", folder], ["--install", folder, "--prefix", target]]
    return all(
        subprocess.run([cmake, *command], capture_output=True, check=False).returncode == 0
        for command in commands
    )


def caught(tests: list[str]) -> bool:
    command = [sys.executable, "-m", "pytest", *tests, "-qx", "--timeout", "300"]
    command += ["-m", "not ci and not nightly"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode != 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=12, help="mutants of each part")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--part", choices=PARTS, help="only this part; the other's result is kept")
    arguments = parser.parse_args()
    if subprocess.run(["git", "diff", "--quiet"], cwd=ROOT, check=False).returncode != 0:
        sys.exit("the tree has changes: commit them first")
    results: dict[str, Any] = json.loads(RESULT.read_text())
    for part in [arguments.part] if arguments.part else PARTS:
        patterns, tests = PARTS[part]
        sample = places(patterns)
        random.Random(arguments.seed).shuffle(sample)
        survivors: list[str] = []
        count = broken = 0
        for place in sample:
            if count == arguments.count:
                break
            where = f"{place[0].relative_to(ROOT)}:{place[1] + 1}"
            change, old = mutate(place)
            try:
                if place[0].suffix == ".h" and not built():
                    broken += 1  # no mutant: the compiler refuses it
                    continue
                count += 1
                noticed = caught(tests)
            finally:
                place[0].write_text(old)
            survivors += [] if noticed else [f"{where}: {change}"]
            print(f"{part}: {'caught' if noticed else 'SURVIVED'} {where}: {change}", flush=True)
        results[part] = {
            "places": len(sample), "tried": count, "caught": count - len(survivors),
            "refused by the compiler": broken, "survivors": survivors,
        }  # fmt: skip
        if not built():
            sys.exit("the sources that were put back do not build")
    RESULT.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
