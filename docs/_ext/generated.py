"""Pages made from the code's own texts: every command, every fault, refusal and
error, every entry of robot.toml, and the layers of the host's code; and the parts
lists with their totals.

Written to docs/_made before the pages are read, and included by commands.md,
troubleshooting.md, robot-toml.md, contributing.md and hardware/parts.md.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import runpy
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
import yaml
from pydantic.fields import FieldInfo

from thigmo import errors
from thigmo.cli.main import app as thigmo
from thigmo.config import (
    BoardSettings,
    Body,
    BodyPressure,
    Muscle,
    MuscleMap,
    RestCurvature,
    RobotConfig,
    Spool,
    TanhMap,
)
from thigmo.sensors import KINDS
from thigmo.toml_model import Model

ROOT = Path(__file__).resolve().parents[2]
_ERRORS = {
    name: kind
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, errors.ThigmoError)
}
# Where an operator meets the errors of each folder of host/thigmo, and those of thigmo_bench.
_WHERE = {
    "link": "The connection to the board",
    "robot": "The robot",
    "exploration": "Explorations and replays",
    "localization": "Readings and the localizer",
    "reading_errors": "Readings and the localizer",
    "record": "Files: run folders, maps, tables of readings",
    "config": "robot.toml",
    "calibrate": "Calibration",
    "camera": "The camera",
    "bringup": "Bring-up",
    "design": "Layouts and designs",
    "emulator": "The emulator and its scenes",
    "live": "The page",
    "mechanics": "Mechanics",
    "thigmo_bench": "Studies and experiments",
}


def commands(command: Any = None, name: str = "thigmo") -> Iterator[tuple[str, Any]]:
    """Every command with its full name, groups opened."""
    command = command or typer.main.get_command(thigmo)
    inner = getattr(command, "commands", None)
    if inner:
        for part, subcommand in inner.items():
            yield from commands(subcommand, f"{name} {part}")
    else:
        yield name, command


def _paragraphs(text: str | None) -> str:
    """Help text as Markdown: rich's markup is not used in it."""
    return inspect.cleandoc(text or "")


def _option(parameter: Any) -> tuple[str, str]:
    names = ", ".join(f"`{name}`" for name in parameter.opts + parameter.secondary_opts)
    if parameter.param_type_name == "argument":
        names = f"`{parameter.name}`"
    default = parameter.default
    said = parameter.help or ""
    if parameter.param_type_name == "option" and default not in (None, False, (), ...):
        said += f" [{default}]"
    return names, said.replace("\n", " ").replace("|", "\\|")


def _commands_page() -> str:
    lines: list[str] = []
    for name, command in commands():
        lines += [f"## `{name}`", "", _paragraphs(command.help), ""]
        rows = [_option(p) for p in command.params if p.name != "help"]
        if rows:
            lines += ["| option | what [default] |", "| --- | --- |"]
            lines += [f"| {names} | {said} |" for names, said in rows]
            lines.append("")
    return "\n".join(lines)


def _from_schema(enumeration: str) -> str:
    schema = yaml.safe_load((ROOT / "protocol/schema.yaml").read_text())
    lines = ["| name | what it means, and what to do |", "| --- | --- |"]
    for name, entry in sorted(schema["enums"][enumeration].items()):
        if name not in ("doc", "none"):
            lines.append(f"| `{name}` | {entry['doc']} |")
    return "\n".join(lines) + "\n"


def _text(node: ast.expr) -> str | None:
    """A message's text; what is known only when it happens stands in angle brackets."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(
                part.value
                if isinstance(part, ast.Constant) and isinstance(part.value, str)
                else f"<{_name(part.value)}>"
                for part in values
                if isinstance(part, ast.Constant | ast.FormattedValue)
            )
        case ast.BinOp(left=left, right=right):
            first, second = _text(left), _text(right)
            return None if first is None or second is None else first + second
    return None


def _name(node: ast.expr) -> str:
    """A short word for what is filled in."""
    words = re.findall(r"[A-Za-z_]\w*", ast.unparse(node))
    kept = [word for word in words if word not in ("self", "join", "len", "str", "repr", "sorted")]
    return (kept[-1] if kept else "...").strip("_").replace("_", " ")


def messages() -> Iterator[tuple[str, str, str, str]]:
    """Folder, class, message and next step of every error with a literal text."""
    host = ROOT / "host"
    for path in sorted(host.rglob("*.py")):
        package, folder, *_ = path.relative_to(host).parts
        folder = folder.removesuffix(".py") if package == "thigmo" else package
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case ast.Call(func=ast.Name(id=kind), args=[first, *rest]):
                    reason = ""
                case ast.Call(
                    func=ast.Attribute(value=ast.Name(id=kind), attr="from_os"),
                    args=[first, *rest],
                ):
                    reason = ": <reason>"
                case _:
                    continue
            problem, step = _text(first), _text(rest[0]) if rest else ""
            if kind in _ERRORS and problem and re.search("[a-z]{2}", re.sub("<.*?>", "", problem)):
                yield folder, kind, problem + reason, step or ""


def _errors_page() -> str:
    by_place: dict[str, set[tuple[str, str, str]]] = {}
    for folder, kind, problem, step in messages():
        place = _WHERE.get(folder, "Other commands")
        by_place.setdefault(place, set()).add((problem, step, kind))
    lines = []
    for place in [*dict.fromkeys(_WHERE.values()), "Other commands"]:
        rows = sorted(by_place.get(place, ()), key=lambda row: row[0].lower())
        if rows:
            lines += [f"### {place}", "", "| message | what to do | type |", "| --- | --- | --- |"]
            lines += [
                f"| {_cell(problem)} | {_cell(step)} | `{kind}` |" for problem, step, kind in rows
            ]
            lines.append("")
    return "\n".join(lines)


def _cell(text: str) -> str:
    """Text in a Markdown table: nothing in it is markup but the code's own backquotes."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    return "".join(
        part.replace("|", "\\|")
        if part.startswith("`")
        else re.sub(r"([\\*_\[\]<>|$~])", r"\\\1", part)
        for part in parts
    )


def _kinds_page() -> str:
    return "\n".join(
        f"- `{name}`: {inspect.cleandoc(kind.__doc__ or '').splitlines()[0]}"
        for name, kind in _ERRORS.items()
    )


# The tables of robot.toml: their heading in the file, and the model behind it.
_ROBOT_TABLES: dict[str, type[Model]] = {
    "the file itself": RobotConfig,
    "[body]": Body,
    "[[body.pressure]]": BodyPressure,
    "[[body.rest_curvature]]": RestCurvature,
    "[[muscle]]": Muscle,
    "[[muscle.map]]": MuscleMap,
    "[muscle.map.inflate], [muscle.map.deflate]": TanhMap,
    **{f'[[sensor]], kind = "{name}"': kind for name, kind in KINDS.items()},
    "[spool]": Spool,
    "[board]": BoardSettings,
}


def _comments(model: type[Model]) -> dict[str, str]:
    """What the source says of each field of a model and its bases: above it, and behind it."""
    texts: dict[str, str] = {}
    for base in reversed(model.__mro__[: model.__mro__.index(Model)]):
        above: list[str] = []
        open_field = ""
        for line in inspect.getsource(base).splitlines():
            code, _, comment = line.partition("  # ") if "  # " in line else (line, "", "")
            if line.strip().startswith("# "):
                above.append(line.strip()[2:])
            elif field := re.match(r"    (\w+): (?!ClassVar)", code):
                texts[field[1]] = " ".join([*above, comment]).strip()
                above, open_field = [], field[1]
            elif comment and open_field:
                texts[open_field] = f"{texts[open_field]} {comment}".strip()
            elif not line.strip():
                above, open_field = [], ""
            else:
                above = []
    return texts


def _limits(field: FieldInfo) -> str:
    """What an entry must be: its kind and range."""
    kind, metadata = field.annotation, list(field.metadata)
    if type(None) in get_args(kind):  # it may be left out
        (kind,) = (part for part in get_args(kind) if part is not type(None))
        if get_origin(kind) is Annotated:
            kind, *extra = get_args(kind)
            metadata += [entry for part in extra for entry in getattr(part, "metadata", ())]
    if get_origin(kind) is Literal:
        return " or ".join(json.dumps(value) for value in get_args(kind))
    if get_origin(kind) is list:
        return "tables"
    kinds = {bool: "true or false", str: "a text", int: "a whole number", float: "a number"}
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    bounds = [
        f"{sign} {getattr(entry, name):g}"
        for entry in metadata
        for name, sign in signs.items()
        if hasattr(entry, name)
    ]
    return f"{kinds.get(kind, 'a table')} {' and '.join(bounds)}".strip()


def robot_entries() -> Iterator[tuple[str, str, str, str, str]]:
    """Table, entry, what it must be, default and meaning of everything in robot.toml."""
    for table, model in _ROBOT_TABLES.items():
        texts = _comments(model)
        usual: dict[str, object] = {}  # of the entries before, on which some defaults depend
        for name, field in model.model_fields.items():
            default = field.get_default(call_default_factory=True, validated_data=usual)
            usual[name] = default
            shown = "needed" if field.is_required() else "none" if default is None else ""
            if not shown:
                simple = isinstance(default, bool | int | float | str)
                shown = f"`{json.dumps(default)}`" if simple else "the thesis's robot"
            yield table, field.serialization_alias or name, _limits(field), shown, texts[name]


def _robot_toml_page() -> str:
    lines: list[str] = []
    last = ""
    for table, name, limits, default, text in robot_entries():
        if table != last:
            doc = inspect.cleandoc(_ROBOT_TABLES[table].__doc__ or "")
            lines += ["", f"## {table}", "", doc.split("\n\n")[0], ""]
            lines += ["| entry | must be | default | what |", "| --- | --- | --- | --- |"]
            last = table
        lines.append(f"| `{name}` | {_cell(limits)} | {default} | {_cell(text)} |")
    return "\n".join(lines) + "\n"


def _layers_page() -> str:
    """The folders and files of host/thigmo, highest layer first, with what each says it is."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    order = next(c for c in contracts["contracts"] if c.get("containers") == ["thigmo"])
    lines = ["| layer | part | what |", "| --- | --- | --- |"]
    for number, layer in enumerate(order["layers"][::-1], start=1):
        rows = [
            f"| {number} | `{name}` | {_cell(_first_line(name))} |" for name in layer.split(" | ")
        ]
        lines[2:2] = rows
    return "\n".join(lines) + "\n"


def _first_line(name: str) -> str:
    """What a package or module of host/thigmo says it is."""
    package = ROOT / "host" / "thigmo" / name
    source = package / "__init__.py" if package.is_dir() else package.with_suffix(".py")
    return (ast.get_docstring(ast.parse(source.read_text())) or "").split("\n")[0]


def write(folder: Path) -> None:
    """Write every made page; one that has not changed is left alone."""
    folder.mkdir(exist_ok=True)
    for name, text in {
        "commands.md": _commands_page(),
        "faults.md": _from_schema("Fault"),
        "refusals.md": _from_schema("Reason"),
        "errors.md": _errors_page(),
        "kinds.md": _kinds_page(),
        "robot_toml.md": _robot_toml_page(),
        "layers.md": _layers_page(),
        "parts.md": runpy.run_path(str(ROOT / "tools" / "parts.py"))["page"](),
    }.items():
        path = folder / name
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def setup(app: Any) -> dict[str, bool]:
    """Write the pages before any is read."""
    app.connect("builder-inited", lambda sphinx: write(Path(sphinx.srcdir) / "_made"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
