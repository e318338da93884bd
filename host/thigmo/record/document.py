"""contacts.json: what a run found, as plain data.

Written by the exploration after every stage, read by the report, by `thigmo info` and by
planners. Lengths in cm, forces over EI in 1/cm^2, times in s; x along the straight
robot, y to its left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from math import nan
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator

from thigmo.config import RobotConfig
from thigmo.contact_status import POINT_ESTIMATE, interval_text

RUNNING, KILLED = "running", "killed"

# JSON has null where a number is not known.
Number = Annotated[float, BeforeValidator(lambda value: nan if value is None else value)]
Pose = tuple[float, float, float]  # x, y in cm; heading in rad from the x axis


_WORTH_SAYING = 0.01  # probability of an explanation


@dataclass(frozen=True, slots=True)
class Shape:
    """A measured centreline of the robot."""

    side: str  # of the muscle that was inflated
    pressure_psi: float  # its pressure, filtered by the calibrated lag
    poses: list[Pose]  # base to tip, evenly spaced in arc length
    # standard error of its curvature, common to all of it, 1/cm: at arc s the body may be s^2/2 of
    # that aside. None: not known, and no space counts as swept by it.
    curvature_se: float | None = None


@dataclass(frozen=True, slots=True)
class Trigger:
    """The board's contact trigger in a sweep."""

    side: str  # active muscle
    t_s: float  # device time
    excess_per_cm: float  # base curvature minus free curvature when it fired
    status: str  # of the localizer's result for the peak's readings
    message: str = ""  # the localizer's reason


def _percent(share: float) -> str:
    # Nothing that is felt is wholly certain.
    return "> 99 %" if share > 0.99 else f"{100 * share:.0f} %"


@dataclass(frozen=True, slots=True)
class Explanation:
    """What may have stood in the way of a side's sweeps."""

    name: str  #: "peg", "two pegs" or "wall"
    probability: float


@dataclass(frozen=True, slots=True)
class MapContact:
    """A contact in the room; lengths in cm, x along the straight robot, y to its left."""

    arc_cm: float  #: along the body, from the base
    x_cm: float  #: of the point of the skin that touches
    y_cm: float  #: of the same point
    force_per_cm2: float  #: signed, F/EI; positive pushes towards +y of the body there
    interval_cm: tuple[float, float]  #: 95 % interval of the arc
    #: "localized", "ambiguous", or "point estimate": the method gives no error, and the interval is
    #: therefore the whole body
    status: str
    everted_length_cm: float  #: stage at which it was felt
    #: active muscle; empty for a peg that growth met, which stopped the tip or bent it aside
    side: str
    normal_rad: float  #: direction from the centreline to the contact point
    #: of (x, y), from the interval along the body and the shape's uncertainty
    covariance_cm2: tuple[tuple[float, float], tuple[float, float]]
    track: list[tuple[float, float]]  #: the interval drawn along the skin, low end to high end
    model: str  #: the localizer's model
    readings: int  #: number of sensors used
    merged: list[float] = field(default_factory=list)  #: earlier stages whose contact is this one
    #: index of the prior map's obstacle (prior.json) that this is; null if it is new or none given
    known: int | None = None
    kind: str = "peg"  #: "peg", or "wall": a straight one, along which the tip slid
    probability: Number = 1.0  #: that it is real; null of a point estimate
    #: what explains the sweeps, likeliest first, as far as it was weighed; empty of what growth met
    #: and of point estimates
    explanations: list[Explanation] = field(default_factory=list)
    doubt: str = ""  #: why its place is only a guess, for people; empty if it is not
    #: of a wall: the ends of the part of its face that was touched
    surface: list[tuple[float, float]] = field(default_factory=list)
    #: force across the body in newtons, and its 95 % interval; null and empty if EI is not known
    force_n: float | None = None
    force_interval_n: list[float] = field(default_factory=list)
    #: of a fit, null of other contacts: log odds that something stands there; squares that the
    #: fit leaves for each independent reading (1 if the model holds); effective samples
    fit_log_odds: float | None = None
    fit_misfit: float | None = None
    fit_samples: float | None = None
    #: what it fitted beside the place: the peg's radius, the skin's friction, and by how much the
    #: peg yielded
    fit_radius_cm: float | None = None
    fit_friction: float | None = None
    fit_yield_cm: float | None = None
    #: bend of the free body (1/cm, signed) up to which it stood: then it gave way; null: it stands
    gave_way_per_cm: float | None = None

    @property
    def force_text(self) -> str:
        """The force for people: in newtons if they are known, else over EI."""
        if self.force_n is None:
            return f"{self.force_per_cm2:.2g} 1/cm² (over EI)"
        low, high = self.force_interval_n
        return f"{self.force_n:.2g} ({low:.2g} to {high:.2g}) N"

    def __repr__(self) -> str:
        return (
            f"MapContact({self.place_text}; arc {self.along_text}, 95 % {self.interval_text}; "
            f"{self.status})"
        )

    def to_row(self, muscles: Mapping[str, str]) -> dict[str, Any]:
        """The contact as a row of a table: one number or word for each column.

        Args:
            muscles: name of the muscle on each side, as robot.toml has it.

        Returns:
            The fields by their names, with the unit in each; intervals and the covariance as one
            column for each number, explanations as words, and `muscle` in place of `side`. The
            outlines (`track`, `surface`) are left out.
        """
        row = asdict(self)
        del row["track"], row["surface"]
        side = row.pop("side")
        row["muscle"] = muscles.get(side, side)
        row["interval_low_cm"], row["interval_high_cm"] = row.pop("interval_cm")
        row["force_low_n"], row["force_high_n"] = row.pop("force_interval_n") or (None, None)
        (row["variance_x_cm2"], row["covariance_xy_cm2"]), (_, row["variance_y_cm2"]) = row.pop(
            "covariance_cm2"
        )
        row["explanations"] = self.explanation_text
        row["merged_cm"] = " ".join(f"{length:g}" for length in row.pop("merged"))
        return row

    # How terminal, notebook, map and page say it: one rule of rounding.

    @property
    def place_text(self) -> str:
        """Where in the room, for people."""
        return f"x {self.x_cm:.1f}, y {self.y_cm:.1f} cm"

    @property
    def along_text(self) -> str:
        """Where along the body, for people."""
        return f"{self.arc_cm:.1f} of {self.everted_length_cm:.1f} cm"

    @property
    def certainty_text(self) -> str:
        """How certain it is, and what it is, for people: "localized, > 99 %; peg"."""
        if self.status == POINT_ESTIMATE:
            return self.status
        return f"{self.status}, {_percent(self.probability)}; {self.explanation_text}"

    @property
    def kind_text(self) -> str:
        """What it is, for people."""
        return self.kind if self.gave_way_per_cm is None else f"{self.kind} that gave way"

    @property
    def explanation_text(self) -> str:
        """What explains the sweeps, for people: "wall 97 %, two pegs 3 %", or only "peg"."""
        likely = [e for e in self.explanations if e.probability >= _WORTH_SAYING]
        if len(likely) < 2:
            return self.kind_text
        return ", ".join(f"{e.name} {_percent(e.probability)}" for e in likely)

    @property
    def interval_text(self) -> str:
        """The interval for people."""
        return interval_text(self.status, self.interval_cm, ".1f", " cm")


@dataclass(frozen=True, slots=True)
class Stage:
    """One stop of the growth: swept both ways."""

    everted_length_cm: float
    body_pressure_psi: float
    t_s: float
    shapes: list[Shape] = field(default_factory=list)
    triggers: list[Trigger] = field(default_factory=list)
    # by side swept: largest curvature by which the base fell short of the free curvature, 1/cm;
    # the trigger compares it with its threshold
    curvature_deficit_per_cm: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TrueContact:
    """A contact as the room knows it, at a sweep's peak; `side` is the inflated muscle."""

    x_cm: float
    y_cm: float
    arc_cm: float
    everted_length_cm: float
    peg: int
    side: str = ""


@dataclass(frozen=True, slots=True)
class TruePeg:
    """A round peg of the room."""

    x_cm: float
    y_cm: float
    radius_cm: float
    gave_way: bool = False  # to the body, for good


@dataclass(frozen=True, slots=True)
class Truth:
    """What the emulator knows: pegs, and the contact forces at the moments of measurement."""

    pegs: list[TruePeg] = field(default_factory=list)
    contacts: list[TrueContact] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class MissedContact:
    """A contact that should be on the map and is not."""

    # who knows of it: "truth" (the emulated room: a peg that a sweep's peak touched) or "prior"
    # (the given map: an obstacle that was not felt although its place was swept)
    source: str
    x_cm: float
    y_cm: float
    reason: str  # why it was missed, as far as the record tells
    # along the body, at the last stage that touched it; null and empty for the prior's
    arc_cm: float | None = None
    everted_length_cm: float | None = None
    side: str = ""


@dataclass(frozen=True, slots=True)
class FalseContact:
    """A contact of the map that the emulated room does not have: its index, and why it was taken
    for one, as far as the record tells.
    """

    contact: int
    x_cm: float
    y_cm: float
    reason: str


@dataclass(frozen=True, slots=True)
class Stall:
    """A growth that stopped, and what may have stopped it, with probabilities."""

    length_cm: float  # where the tip stood, by the best guess
    interval_cm: tuple[float, float]  # it stood within these
    obstacle: float  # something stands ahead
    wall: float  # a wall does
    pressure: float  # the body pressure was too little for the tail's friction
    # whether the tip moved on when the body pressure was raised; null: nobody tried
    moved_on: bool | None = None

    @property
    def words(self) -> str:
        """For the operator."""
        shares = sorted(
            (
                (self.obstacle, "an obstacle ahead"),
                (self.wall, "a wall ahead"),
                (self.pressure, "too little body pressure for the tail's friction"),
            ),
            reverse=True,
        )
        causes = ", ".join(f"{cause} ({100 * share:.0f} %)" for share, cause in shares)
        trial = "" if self.moved_on is None else ", after a trial at a higher body pressure"
        return f"growth stalled at {self.length_cm:.1f} cm: {causes}{trial}"


@dataclass(frozen=True, slots=True)
class NamedMuscle:
    """A muscle as robot.toml names it; `side` is what entries of this file call it by."""

    side: str  # of the plane, to which it bends the body
    name: str
    angle_deg: float  # around the body

    @classmethod
    def all_of(cls, config: RobotConfig) -> list[Self]:
        """The robot's muscles in the plane."""
        return [cls(m.side, m.name, m.angle_deg) for m in config.muscles if m.side]


@dataclass(frozen=True, slots=True)
class RunDocument:
    """Contents of contacts.json."""

    thigmo: str
    name: str
    url: str
    started: str
    #: "running", "full length", "peg ahead" (felt, or by a body that growth bent aside), "growth
    #: stalled" with its possible causes, with the reason "aborted", or "killed" (its process ended
    #: without a word; length and times are the record's)
    outcome: str = RUNNING
    seed: int | None = None
    contacts: list[MapContact] = field(default_factory=list)  #: in the order of their discovery
    stages: list[Stage] = field(default_factory=list)
    truth: Truth | None = None
    #: absolute x error of the best contact against the true contact point (the thesis's measure),
    #: null without truth or contact
    error_x_cm: float | None = None
    error_cm: float | None = None  #: distance in the plane from it to the true contact point
    missed: list[MissedContact] | None = None  #: known otherwise; null if nothing else is known
    false: list[FalseContact] | None = None  #: not in the room; null without truth
    stall: Stall | None = None  #: what stopped the growth; null if nothing did
    length_cm: float = 0.0  #: everted length at the end, which the robot keeps
    robot_time_s: float = 0.0  #: device time that the run took
    wall_time_s: float = 0.0  #: the operator's time that it took, from connecting on
    method: str = "field"  #: by which contacts were localized, as for `thigmo.explore`
    #: "quick", "default", "careful", "thesis", or a budget such as "120 s"
    effort: str = ""
    skips: str = ""  #: parts of a full run that this effort omitted, and their cost; or empty
    resumes: str = ""  #: folder of the run that was cut short, from which this one goes on
    muscles: list[NamedMuscle] = field(default_factory=list)
    version: Literal[2] = 2
