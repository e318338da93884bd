"""The documentation: every command stands in it, and what it names is in the repository."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import typer

import thigmo
from thigmo.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
# Pages that people write; docs/_made is made from the code when the site is built.
PAGES = sorted(page for page in DOCS.rglob("*.md") if "_made" not in page.parts)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def commands(group: Any, name: str = "thigmo") -> Iterator[tuple[str, Any]]:
    """All commands with their full names."""
    members = getattr(group, "commands", None)
    if members:
        for part, command in members.items():
            yield from commands(command, f"{name} {part}")
    else:
        yield name, group


COMMANDS = dict(sorted(commands(typer.main.get_command(app))))


def anchor(heading: str) -> str:
    """A heading's anchor, as GitHub and MyST make it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings, with those of what it includes."""
    anchors = {anchor(line) for line in re.findall(r"^#+ (.*)$", outside_code(page), re.MULTILINE)}
    for name in re.findall(r"^```\{include\} (\S+)", page.read_text(), re.MULTILINE):
        if (page.parent / name).exists():
            anchors |= headings(page.parent / name)
    return anchors


def outside_code(page: Path) -> str:
    """A page's text without its code blocks."""
    return re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("name", COMMANDS)
def test_command_is_on_a_page(name: str) -> None:
    assert any(re.search(rf"\b{name}\b", page.read_text()) for page in PAGES)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_on_a_page(name: str) -> None:
    documents = [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *PAGES,
        *ROOT.glob("firmware/*/*.md"),
    ]
    text = "\n".join(document.read_text() for document in documents)
    for option in COMMANDS[name].params:
        if option.param_type_name != "option" or option.hidden or option.name == "help":
            continue
        flags = [*option.opts, *option.secondary_opts]
        assert any(re.search(rf"{flag}(?![\w-])", text) for flag in flags), flags


@pytest.mark.parametrize(
    "page",
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_links_lead_somewhere(page: Path) -> None:
    for link in LINK.findall(outside_code(page)):
        if re.match(r"https?:", link):
            continue
        name, _, part = link.partition("#")
        aim = (page.parent / name).resolve() if name else page
        assert aim.exists(), link
        if part:
            assert part in headings(aim), link


def test_public_names_are_in_the_reference() -> None:
    written = (DOCS / "api.md").read_text()
    names = set(thigmo.__all__) - {"__version__"}
    assert not {name for name in names if not re.search(rf"\b{name}\b", written)}


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = set(re.findall(r"^([\w/-]+)$", (DOCS / "index.md").read_text(), re.MULTILINE))
    pages = {str(page.relative_to(DOCS).with_suffix("")) for page in PAGES} - {"index"}
    assert pages == listed & pages


def test_documents_that_the_code_cites_exist() -> None:
    cited = set()
    for folder in ("host", "firmware", "protocol", "tests", "tools"):
        for source in (ROOT / folder).rglob("*"):
            if source.suffix in (".py", ".h", ".cpp", ".c", ".ino", ".yaml", ".toml"):
                cited |= set(re.findall(r"\bdocs/[\w/-]+\.md\b", source.read_text()))
    assert "docs/methods.md" in cited
    assert not [name for name in cited if not (ROOT / name).exists()]


def test_what_the_operating_system_refuses_is_on_the_errors_page(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    said = {(problem, step) for _, _, problem, step in import_module("generated").messages()}
    assert ("cannot write <path>: <reason>", "choose a folder that you may write to") in said


def test_every_entry_of_robot_toml_is_described(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    entries = {
        (table, entry): rest for table, entry, *rest in import_module("generated").robot_entries()
    }
    assert [name for name, (_, _, text) in entries.items() if not text] == []
    assert entries["[body]", "stiffness_n_cm2"][:2] == ["a number > 0", "none"]
    channel = entries['[[sensor]], kind = "heading"', "mux_channel"]
    assert channel[:2] == ["a whole number >= 0 and <= 7", "`0`"]
