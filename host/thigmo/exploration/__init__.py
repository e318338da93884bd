"""The exploration run: grow, sweep, feel, localize, map (thesis, section 3.5), and its replay."""

from thigmo.exploration.explore import ExplorationResult, explore
from thigmo.exploration.replay import replay
from thigmo.exploration.states import TRANSITIONS, State, Transition

__all__ = ["TRANSITIONS", "ExplorationResult", "State", "Transition", "explore", "replay"]
