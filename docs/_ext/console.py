"""The directive `console`: runs shell commands while the site is built, and shows what they print.

    ```{console}
    :exit: 1
    thigmo explore --scene nowhere
    ```

Each line is one command; a backslash at its end continues it on the next. All commands of a page
run in one folder of their own, in order. The build fails if the last command ends with another exit
status than `exit` (0), or one before it with any but 0.

`head` and `tail` show the first and last lines only. `picture` is a file, or a pattern, that the
commands left: it is shown below them, with `alt` as its text. `timed` adds how long they took.
`hidden` shows nothing: for what a reader has and the build must make, such as a photograph.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util.docutils import SphinxDirective

LIMIT_S = 280


class Console(SphinxDirective):
    """Commands, their output, and a picture that they left."""

    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "exit": int,
        "head": int,
        "tail": int,
        "picture": directives.unchanged,
        "alt": directives.unchanged,
        "width": directives.unchanged,
        "timed": directives.flag,
        "hidden": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Run the commands; the nodes of what they printed."""
        page = Path(self.env.docname)
        folder = Path(self.env.app.doctreedir) / "console" / page
        if not self.env.temp_data.get("console"):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            self.env.temp_data["console"] = True
        shown: list[str] = []
        begun = time.monotonic()
        lines = "\n".join(self.content).replace("\\\n", "\\\0").splitlines()
        commands = [line.replace("\0", "\n") for line in lines if line.strip()]
        for number, command in enumerate(commands, 1):
            expected = self.options.get("exit", 0) if number == len(commands) else 0
            output = self._output(command, folder, expected)
            shown += ["$ " + command.replace("\n", "\n> "), *output]
        took = time.monotonic() - begun
        if "hidden" in self.options:
            return []
        text = "\n".join(shown)
        block = nodes.literal_block(text, text, language="console")
        found: list[nodes.Node] = [block]
        if "timed" in self.options:
            said = f"(It took {took:.0f} s on the computer that built this page.)"
            found.append(nodes.paragraph(said, said, classes=["timed"]))
        if "picture" in self.options:
            found.append(self._picture(folder, page))
        return found

    def _output(self, command: str, folder: Path, expected: int) -> list[str]:
        environment = {
            **os.environ,
            "COLUMNS": "88",
            "TERM": "dumb",
            "NO_COLOR": "1",
            "PYTHONPATH": str(Path(__file__).parent),  # painted.py
        }
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        if done.returncode != expected:
            raise self.error(f"`{command}` ended with {done.returncode}:\n{done.stdout}")
        lines = [line.rstrip() for line in done.stdout.rstrip().splitlines()]
        head, tail = self.options.get("head"), self.options.get("tail")
        if head is None and tail is None:
            return lines
        first, last = lines[: head or 0], lines[len(lines) - (tail or 0) :]
        if len(first) + len(last) >= len(lines):
            return lines
        return [*first, "...", *last]

    def _picture(self, folder: Path, page: Path) -> nodes.Node:
        pattern = self.options["picture"]
        made = sorted(folder.glob(pattern))
        if not made:
            raise self.error(f"no file {pattern} after the commands")
        kept = Path("_made") / "-".join([*page.parts, str(self.lineno), made[-1].name])
        (Path(self.env.srcdir) / kept).parent.mkdir(exist_ok=True)
        shutil.copy(made[-1], Path(self.env.srcdir) / kept)
        return nodes.image(
            uri=f"/{kept.as_posix()}",
            alt=self.options.get("alt", made[-1].name),
            width=self.options.get("width", "100%"),
        )


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("console", Console)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
