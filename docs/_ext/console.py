"""The directive `console`: shell commands, and what they print.

    ```{console}
    :exit: 1
    thigmo explore --scene nowhere
    ```

Each line is one command; a backslash at its end continues it on the next. All commands of a page
run in one folder of their own, in order. `make docs-cells` runs them and keeps what they print;
`make docs` shows what was kept. It is an error of the page if the last command ends with another
exit status than `exit` (0), one before it with any but 0, or one takes longer than `LIMIT_S`.

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
from kept_cells import EXECUTES, KeptOutput, read_output, write_output
from sphinx.util.docutils import SphinxDirective

LIMIT_S = 280  # of one command


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
        """The nodes of what the commands printed, now or when they were run."""
        page = Path(self.env.docname)
        lines = "\n".join(self.content).replace("\\\n", "\\\0").splitlines()
        commands = [line.replace("\0", "\n") for line in lines if line.strip()]
        # What a page's commands print depends on all commands before them.
        page_commands: list[str] = self.env.temp_data.setdefault("console", [])
        first = not page_commands
        page_commands += [*commands, str(self.options.get("exit", 0))]
        if EXECUTES:
            kept = self._execute(commands, page, first)
            write_output(page, page_commands, kept)
        else:
            known = read_output(page, page_commands)
            if known is None:
                raise self.error("this command has not been run; `make docs-cells` runs it")
            kept = known
        if "hidden" in self.options:
            return []
        shown: list[str] = []
        for command, output in zip(commands, kept.printed, strict=True):
            shown += ["$ " + command.replace("\n", "\n> "), *self._excerpt(output)]
        text = "\n".join(shown)
        made: list[nodes.Node] = [nodes.literal_block(text, text, language="console")]
        if "timed" in self.options:
            said = f"(It took {kept.took_s:.0f} s on the computer that ran this page's commands.)"
            made.append(nodes.paragraph(said, said, classes=["timed"]))
        if "picture" in self.options:
            made.append(self._picture(kept.picture, page))
        return made

    def _execute(self, commands: list[str], page: Path, first: bool) -> KeptOutput:
        """Run the commands in the page's folder, which the first of them find empty."""
        folder = Path(self.env.app.doctreedir) / "console" / page
        if first:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        begun = time.monotonic()
        printed = []
        for number, command in enumerate(commands, 1):
            expected = self.options.get("exit", 0) if number == len(commands) else 0
            printed.append(self._output(command, folder, expected))
        took_s = time.monotonic() - begun
        if "picture" not in self.options:
            return KeptOutput(printed, took_s)
        pictures = sorted(folder.glob(self.options["picture"]))
        if not pictures:
            raise self.error(f"no file {self.options['picture']} after the commands")
        return KeptOutput(printed, took_s, pictures[-1])

    def _output(self, command: str, folder: Path, expected: int) -> list[str]:
        environment = {
            **os.environ,
            "COLUMNS": "88",
            "TERM": "dumb",
            "NO_COLOR": "1",
            "PYTHONPATH": str(Path(__file__).parent),  # painted.py
        }
        try:
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
        except subprocess.TimeoutExpired as late:
            raise self.error(f"`{command}` took longer than {LIMIT_S} s") from late
        if done.returncode != expected:
            raise self.error(f"`{command}` ended with {done.returncode}:\n{done.stdout}")
        return [line.rstrip() for line in done.stdout.rstrip().splitlines()]

    def _excerpt(self, lines: list[str]) -> list[str]:
        """The lines that the options `head` and `tail` leave."""
        head, tail = self.options.get("head"), self.options.get("tail")
        if head is None and tail is None:
            return lines
        first, last = lines[: head or 0], lines[len(lines) - (tail or 0) :]
        if len(first) + len(last) >= len(lines):
            return lines
        return [*first, "...", *last]

    def _picture(self, picture: Path | None, page: Path) -> nodes.Node:
        if picture is None:
            raise self.error("this picture has not been made; `make docs-cells` makes it")
        copy = Path("_made") / "-".join([*page.parts, str(self.lineno), picture.name])
        (Path(self.env.srcdir) / copy).parent.mkdir(exist_ok=True)
        shutil.copy(picture, Path(self.env.srcdir) / copy)
        return nodes.image(
            uri=f"/{copy.as_posix()}",
            alt=self.options.get("alt", picture.name),
            width=self.options.get("width", "100%"),
        )


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("console", Console)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
