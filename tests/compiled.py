"""Programs that tests compile: each is built once for the same sources and flags."""

from __future__ import annotations

import fcntl
import hashlib
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def compiled(
    name: str,
    command: Iterable[str | Path],
    sources: Iterable[Path],
    generated: Mapping[str, str] | None = None,
) -> Path:
    """The program; a failure to build it fails the test with what the compiler said.

    Args:
        name: of its folder in build/tests.
        command: the compiler and its arguments, without the output.
        sources: files and folders of headers that it is made of.
        generated: texts of files to write beside it, on its include path, by name.
    """
    words, generated = [str(word) for word in command], generated or {}
    digest = hashlib.sha256(repr((words, sorted(generated.items()))).encode())
    for source in sources:
        files = sorted(source.rglob("*.h")) if source.is_dir() else [source]
        for file in files:
            digest.update(file.read_bytes())
    folder = ROOT / "build" / "tests" / name
    program = folder / digest.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # several workers may come here
        if program.exists():
            return program
        for file, text in generated.items():
            (folder / file).write_text(text)
        built = folder / "built"
        process = subprocess.run(
            [*words, f"-I{folder}", "-o", built], capture_output=True, text=True, check=False
        )
        assert process.returncode == 0, process.stderr
        return built.rename(program)
