"""Strict records read from TOML files: their numbers, and errors that name file, line and cure.

Used by `thigmo.config` (robot.toml) and by the emulator's scenes.
"""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import tomlkit
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from thigmo.errors import ConfigError
from thigmo.files import CONFIG_BYTES, read_file, why_unreadable, write_whole


def _not_zero(value: float) -> float:
    if not value:
        raise ValueError("0 would make every reading 0: give its scale")
    return value


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
NonZero = Annotated[Finite, AfterValidator(_not_zero)]


class Model(BaseModel):
    """A strict record: unknown keys are errors, so that a typing slip is never ignored."""

    # Names of union members, which pydantic puts between the keys of an invalid entry.
    union_tags: ClassVar[frozenset[str]] = frozenset()
    model_config = ConfigDict(
        extra="forbid",
        validate_assignment=True,
        populate_by_name=True,
        ser_json_inf_nan="constants",  # TOML has inf
    )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the record as TOML, with every entry that has a value; ConfigError if it cannot."""
        with ConfigError.from_os(f"cannot write {path}", "choose a folder that you may write to"):
            write_whole(
                path, tomlkit.dumps(self.model_dump(mode="json", exclude_none=True, by_alias=True))
            )


M = TypeVar("M", bound=Model)


def load_toml(model: type[M], path: str | os.PathLike[str]) -> M:
    """Read a TOML file into a model, with errors that name file, key and cure.

    Raises:
        ConfigError: the file is missing, malformed or invalid; what is wrong is named by its line.
    """
    data = read_toml(path)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        line = _line_of(error, Path(path).read_text(), model.union_tags)
        where = f"{path}, line {line}" if line else path
        raise ConfigError(invalid_entry(where, error), "correct that entry") from error


def _line_of(error: ValidationError, text: str, union_tags: frozenset[str]) -> int:
    """Line of a TOML file, from 1, with its first invalid entry, or the table where one is missing.

    0 if there is none.
    """
    first = error.errors()[0]
    # A check of the whole file names the table in its sentence.
    named = re.match(r"Value error, (\w+)\[(\d+)\]", first["msg"])
    wanted: list[int | str] = [named[1], int(named[2])] if named and not first["loc"] else []
    wanted += [part for part in first["loc"] if part not in union_tags]
    table: list[int | str] = []
    tables: dict[tuple[int | str, ...], int] = {}  # how many of each array have come
    best, length = 0, 0
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*(\[\[?)([\w.]+)\]", line):
            table = []
            *above, last = header[2].split(".")
            for name in above:
                table.append(name)
                if tuple(table) in tables:
                    table.append(tables[tuple(table)])
            table.append(last)
            if header[1] == "[[":
                tables[tuple(table)] = tables.get(tuple(table), -1) + 1
                table.append(tables[tuple(table)])
            location = table
        elif key := re.match(r"\s*(\w+)\s*=", line):
            location = [*table, key[1]]
        else:
            continue
        if len(location) > length and location == wanted[: len(location)]:
            best, length = number, len(location)
    return best


# tomllib takes the square of a dotted key's length.
_LONG_KEY = re.compile(r"""(?m)^\s*+\[{0,2}(?:\s*+(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')\s*+\.){64}""")


def _parsed(text: str) -> dict[str, Any]:
    """TOML's entries. Raises ValueError, or RecursionError if they are nested too deeply."""
    if _LONG_KEY.search(text):
        raise RecursionError
    return tomllib.loads(text)


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        ConfigError: the file is missing or malformed.
    """
    try:
        data = _parsed(read_file(path, CONFIG_BYTES).decode())
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}", "check the path") from error
    except (ValueError, RecursionError) as error:
        reason = why_unreadable(error)
        raise ConfigError(f"{path} is not valid TOML: {reason}", "correct that line") from error
    return data


def validated(model: type[M], data: dict[str, Any], path: str | os.PathLike[str]) -> M:
    """Make a model of data that came from a file.

    Raises:
        ConfigError: an entry is invalid; it is named, and so is the file.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(invalid_entry(path, error), "correct that entry") from error


# What an entry must be, by the kind of pydantic's error; filled in from the error's context.
_MUST_BE = {
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_parsing": "a whole number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_parsing": "true or false",
    "bool_type": "true or false",
    "string_type": "a text in quotes",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "greater_than": "above {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "below {lt:g}",
    "less_than_equal": "at most {le:g}",
    "literal_error": "{expected}",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
}
_LONGEST_SHOWN = 40  # characters of a wrong value


def invalid_entry(path: str | os.PathLike[str], error: ValidationError) -> str:
    """What is wrong with a file's first invalid entry, which is named, in the file's words."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "missing":
        return f"{path}: {where} is missing"
    if first["type"] == "extra_forbidden":
        return f"{path}: {where} is no entry that is known here"
    if first["type"] == "too_short" and not first["input"]:
        name = ".".join(part for part in where.split(".") if not part.isdecimal())
        return f"{path}: [[{name}]] is empty: give at least {first['ctx']['min_length']}"
    if (wanted := _MUST_BE.get(first["type"])) is not None:
        value = first["input"]
        shown = repr(value) if isinstance(value, str | int | float) else ""
        instead = f", not {shown}" if 0 < len(shown) <= _LONGEST_SHOWN else ""
        must_be = wanted.format(**first.get("ctx", {}))
        return f"{path}: {where or 'the file'} must be {must_be}{instead}"
    return f"{path}: {where + ': ' if where else ''}{first['msg'].removeprefix('Value error, ')}"
