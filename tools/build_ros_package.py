"""Builds ros/thigmo_ros with the ROS wheels of .venv-ros and installs it there, as colcon would.

`make .stamps/ros` calls it with the interpreter of .venv-ros.
"""

import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
PREFIX = Path(sys.prefix)
TOOLS = ROOT / ".venv" / "bin"
BUILD = ROOT / "build" / "thigmo_ros"
# Folders of the machine that built the wheels, in the targets that they export.
FOREIGN = {
    r"/opt/python/[^\";]+/numpy/_core/include": np.get_include(),
    r"/opt/python/[^\";]+/include/python[0-9.]+": sysconfig.get_path("include"),
}

for exported in PREFIX.glob("share/*/cmake/*_pyExport.cmake"):
    text = exported.read_text()
    for foreign, local in FOREIGN.items():
        text = re.sub(foreign, local, text)
    exported.write_text(text)
path = f"{PREFIX / 'bin'}{os.pathsep}{TOOLS}{os.pathsep}{os.environ['PATH']}"
env = os.environ | {"AMENT_PREFIX_PATH": str(PREFIX), "PATH": path}
for arguments in (
    ["-G", "Ninja", "-S", ROOT / "ros" / "thigmo_ros", "-B", BUILD, "--log-level=WARNING",
     f"-DCMAKE_PREFIX_PATH={PREFIX}", f"-DCMAKE_INSTALL_PREFIX={PREFIX}",
     f"-DPython3_EXECUTABLE={sys.executable}"],
    ["--build", BUILD, "--", "--quiet"],
    ["--install", BUILD],
):  # fmt: skip
    subprocess.run([TOOLS / "cmake", *arguments], env=env, check=True, stdout=subprocess.DEVNULL)
