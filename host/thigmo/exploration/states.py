"""The exploration as a state machine: its states and transitions as named data.

The thesis's flow (section 3.5, figure 3.8) with what a real run adds: the body pressure that an
operator sets, the settling of sensors after eversion, zeroing, and an end that is always safe.
The run walks this table and nothing else.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """What the exploration is doing; the value is what the operator reads."""

    CONFIGURE = "configuring the board"
    CONFIRM = "confirming the length"
    ARM = "arming"
    PLAN = "planning the next stage"
    PRESSURIZE = "setting the body pressure"
    GROW = "growing"
    SETTLE = "letting sensors settle"
    ZERO = "zeroing the sensors"
    SWEEP = "sweeping"
    REST = "holding still to measure the creep of young sensors"
    PRESS = "setting the body pressure for a measurement"
    MEASURE = "sweeping again to measure a contact"
    LOCALIZE = "localizing"
    MAP = "mapping"
    VENT = "venting"
    BACK_OFF = "winding back from what stopped or bent it"
    FINISH = "venting, keeping the length"
    DONE = "done"


class Transition(NamedTuple):
    """From a state, on an outcome (in the operator's words), to a state."""

    source: State
    outcome: str
    target: State


TRANSITIONS: tuple[Transition, ...] = (
    Transition(State.CONFIGURE, "verified", State.CONFIRM),
    Transition(State.CONFIRM, "length known", State.ARM),
    Transition(State.ARM, "ready", State.PLAN),
    Transition(State.PLAN, "grow", State.PRESSURIZE),
    Transition(State.PLAN, "sweep here", State.PRESSURIZE),
    Transition(State.PLAN, "fully deployed", State.FINISH),
    Transition(State.PLAN, "time is up", State.FINISH),
    Transition(State.PLAN, "peg ahead", State.FINISH),
    Transition(State.PRESSURIZE, "pressure set", State.GROW),
    Transition(State.PRESSURIZE, "stalled, nobody to ask", State.FINISH),
    Transition(State.GROW, "pressure boundary", State.PRESSURIZE),
    Transition(State.GROW, "whole pitch", State.SETTLE),
    Transition(State.GROW, "no eversion", State.BACK_OFF),
    Transition(State.BACK_OFF, "stalled", State.FINISH),
    Transition(State.BACK_OFF, "stalled: more pressure", State.PRESSURIZE),
    Transition(State.BACK_OFF, "clear of what held it", State.SETTLE),
    Transition(State.SETTLE, "settled", State.ZERO),
    Transition(State.ZERO, "drifting", State.SETTLE),
    Transition(State.ZERO, "held bent", State.BACK_OFF),
    Transition(State.ZERO, "straight again: peg ahead", State.FINISH),
    Transition(State.ZERO, "straight again: grown once more", State.PLAN),
    Transition(State.ZERO, "as before: the zeros moved", State.PLAN),
    Transition(State.ZERO, "zeroed after growth", State.SWEEP),
    Transition(State.ZERO, "zeroed after sweep", State.PLAN),
    Transition(State.SWEEP, "contact", State.REST),
    Transition(State.SWEEP, "contact, and its place", State.LOCALIZE),
    Transition(State.SWEEP, "contact, thesis protocol", State.LOCALIZE),
    Transition(State.SWEEP, "no contact", State.LOCALIZE),
    Transition(State.REST, "young", State.REST),
    Transition(State.REST, "every sensor known", State.PRESS),
    Transition(State.PRESS, "pressure set", State.MEASURE),
    Transition(State.PRESS, "pressure as it is", State.MEASURE),
    Transition(State.PRESS, "nobody to ask", State.MEASURE),
    Transition(State.MEASURE, "measured", State.LOCALIZE),
    Transition(State.MEASURE, "once more", State.MEASURE),
    Transition(State.LOCALIZE, "contact", State.MAP),
    Transition(State.LOCALIZE, "none", State.VENT),
    Transition(State.MAP, "mapped", State.VENT),
    Transition(State.VENT, "vented, thesis protocol", State.SETTLE),
    Transition(State.VENT, "vented", State.PLAN),
    Transition(State.FINISH, "safe", State.DONE),
)

# By state and outcome; one that it lacks is a mistake in the program, not of the operator.
NEXT = {(t.source, t.outcome): t.target for t in TRANSITIONS}
