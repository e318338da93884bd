"""The point fits' C++ with address and undefined-behaviour sanitizers, on frames of every kind."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from compiled import ROOT, compiled
from point_fit_oracles import random_frame

import thigmo

HERE = Path(__file__).parent
FLAGS = [
    *("-std=c++20", "-O0", "-g1", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"),
    *("-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
]


def test_the_sanitizers_find_nothing_and_the_answers_are_the_same() -> None:
    headers = ROOT / "host/thigmo/localization"
    source = HERE / "point_fit_runner.cpp"
    command = ["c++", *FLAGS, f"-I{headers}", source]
    program = compiled("point-fits", command, [source, headers])
    rng = np.random.default_rng(7)
    frames, words = [], []
    for k in range(40):
        contacts, norm = 1 + k % 2, 1 + k // 2 % 2
        y, low, high = random_frame(rng, 8, contacts)
        y *= rng.choice([0.0, 1e-300, 1e-6, 1.0, 1e5])
        if k % 5 == 0:
            y[1:] = np.nan
        columns = (y + 0.5, 0.5 * (low + high), high - low, np.full(len(y), 0.5))
        frames.append((contacts, norm, *columns))
        words += [len(y), contacts, norm, *np.concatenate(columns).tolist()]
    done = subprocess.run(
        [program], input=" ".join(map(repr, words)), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    for line, (contacts, norm, curvature, position, span, free) in zip(
        done.stdout.split(), frames, strict=True
    ):
        found = thigmo.localize(
            curvature, position, length=1.0, span=span, free_curvature=free, tube_radius=1e-6,
            contacts=contacts, method=f"l{norm}",
        )  # fmt: skip
        assert float(line) == pytest.approx(found.objective, rel=1e-9, abs=1e-15)
