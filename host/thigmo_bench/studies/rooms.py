"""Explorations of emulated rooms for studies, without what only a user needs.

Decoding telemetry and posteriors into the record and drawing the map take three quarters of the
time of `thigmo.explore`, so they are left out. Sweeps, contacts, maps and robot time are the same.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from thigmo.config import RobotConfig
from thigmo.emulator.scene import Scene
from thigmo.exploration import ExplorationResult
from thigmo.exploration.effort import EFFORTS, THESIS, Effort, Planner
from thigmo.exploration.methods import FIELD
from thigmo.exploration.run import Exploration, Protocol
from thigmo.record import Obstacle, RunDocument, RunFolder
from thigmo.robot import connect
from thigmo.version import VERSION
from thigmo.wiring import Wiring


def explored(
    url: str,
    out: Path | str,
    seed: int,
    *,
    config: RobotConfig | None = None,
    protocol: Protocol = "measure",
    effort: Effort = EFFORTS["default"],
    method: str = FIELD,
    frames: bool = False,
    prior: Sequence[Obstacle] = (),
) -> ExplorationResult:
    """Explore an emulated room.

    The host uses `config`, or the constants that the robot's lab would know. `protocol`, `effort`
    and `method` are those of `thigmo.explore`. `frames` records raw frames, for `recorded_sweeps`.
    `prior` holds the obstacles of the map that the run is given.

    Raises:
        ThigmoError: the exploration was aborted.
    """
    with connect(url, seed=seed) as robot:
        used = config or robot.known_config
        assert used is not None  # set for an emulated robot
        folder = RunFolder.create(out, protocol, datetime.now())
        used.save(folder.path / "robot.toml")
        document = RunDocument(
            thigmo=VERSION, name=protocol, url=url, started="", seed=seed, method=method
        )
        with folder.open_log(robot.identity, robot.epoch_s) as log:
            if frames:
                robot.record_frames(log.frame)
            wiring = Wiring.laid_out(used)
            planner = Planner(wiring, THESIS if protocol == "thesis" else effort)
            run = Exploration(
                robot,
                wiring,
                folder,
                log,
                document,
                lambda doing, share: None,
                planner,
                protocol,
                prior,
            )
            run.run()
        time = round(robot.elapsed_s, 3)
        document = replace(run.document, length_cm=run.length_cm, robot_time_s=time)
        return ExplorationResult(document, folder.path)


def explored_scene(scene: Scene, seed: int, **options: Any) -> RunDocument:
    """Explore a scene as `explored` does, with its options; only the run's document is kept."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "room.toml"
        scene.save(file)
        return explored(f"emulator://{file}", folder, seed, **options).document
