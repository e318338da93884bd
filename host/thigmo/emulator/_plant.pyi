"""The emulated plant's parts over one step: a compiled extension.

plant.cpp names the constants that each is made of, and takes no others.
"""

from collections.abc import Sequence

STEP_S: float
"""Length of a step."""

class Muscle:
    """One side's transducer, with play, lag and delay, and the muscle behind it; vented."""

    def __init__(self, **constants: float) -> None: ...
    def set_maps(self, inflate: Sequence[float], deflate: Sequence[float], /) -> None:
        """Curvature over pressure, before the first step.

        Each is a tanh's amplitude (1/cm), scale and offset (psi).
        """

    def advance(self, current_ma: float, forced_psi: float, /) -> float:
        """Go one step; returns the size of the free curvature (1/cm).

        forced_psi overrides the transducer's output unless it is nan.
        """
    outlet_psi: float  # true pressure at the transducer's outlet
    bend_psi: float  # pressure that bends the body: the outlet's, delayed and lagged

class Swing:
    """The body's free curvature swings after its target (second order)."""

    def __init__(self, *, frequency_hz: float, damping: float) -> None: ...
    def follow(self, target: float, /) -> None:
        """Go one step towards a free curvature, 1/cm."""
    curvature: float  # present free curvature, 1/cm

class Spool:
    """Motor and line, at rest."""

    def __init__(self, **constants: float) -> None: ...
    def advance(
        self, duty: int, shorted: bool, stuck: bool, pull_n: float, brake_n: float, /
    ) -> None:
        """Go one step at a duty of -800..800, under the tail's tension, which pays out."""
    damping: float  # force per line speed, N s/cm
    sliding_n: float  # friction of the moving line
    line_cm: float  # line paid out
    line_n: float  # pull on the line
    stop_cm: float  # line at which the tail is tight, and winds in no further

class FlexSensor:
    """A flex sensor on its divider, in the tail at first."""

    def __init__(self, **constants: float) -> None: ...
    def evert(self, at_s: float, offset: float, creep: float, /) -> None:
        """Come out of the tip: with an offset of this eversion and a creep (1/cm)."""

    def stow(self) -> None:
        """Go back into the tail."""

    def count(self, curvature: float, length_cm: float, t_s: float, muscle_psi: float, /) -> float:
        """Go one step; returns the ideal ADC count.

        curvature: mean over the everted part, 1/cm; muscle_psi: of the muscle of its side.
        """
    everted: bool  # whether it is out of the tip
    center_cm: float  # its place
    span_cm: float  # its length along the body
