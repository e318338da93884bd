"""The exploration run: grow, sweep, feel, localize, map (thesis, section 3.5), and its replay."""

from thigmo.exploration.expectation import Expectation, expectations
from thigmo.exploration.explore import explore
from thigmo.exploration.replay import replay
from thigmo.exploration.result import ExplorationResult, open_run
from thigmo.exploration.states import TRANSITIONS, State, Transition

__all__ = [
    "TRANSITIONS",
    "Expectation",
    "ExplorationResult",
    "State",
    "Transition",
    "expectations",
    "explore",
    "open_run",
    "replay",
]
