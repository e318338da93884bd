"""The emulated plant's parts over one step: a compiled extension (plant.cpp)."""

from collections.abc import Sequence

STEP_S: float
"""Length of a step."""

class Muscle:
    """One side's transducer, with play, lag and delay, and the muscle behind it."""

    def __init__(
        self,
        *,
        at_4ma_psi: float,
        at_20ma_psi: float,
        gain: float,
        lag_s: float,
        delay_s: float,
        play_psi: float,
        slew_psi_s: float,
        supply_psi: float,
        inflate_tau_s: float,
        deflate_tau_s: float,
        muscle_delay_s: float,
        reversal_psi: float,
    ) -> None:
        """Vented; `set_maps` comes before the first step."""

    def set_maps(self, inflate: Sequence[float], deflate: Sequence[float]) -> None:
        """Curvature over pressure: amplitude (1/cm), scale and offset (psi) of a tanh."""

    def advance(self, current_ma: float, forced_psi: float) -> float:
        """Go one step; returns the size of the free curvature (1/cm).

        forced_psi overrides the transducer's output unless it is nan.
        """

    @property
    def outlet_psi(self) -> float:
        """True pressure at the transducer's outlet."""

    @property
    def bend_psi(self) -> float:
        """Pressure that bends the body: the outlet's, delayed and lagged."""

class Swing:
    """The body's free curvature swings after its target (second order)."""

    def __init__(self, *, frequency_hz: float, damping: float) -> None: ...
    def follow(self, target: float) -> None:
        """Go one step towards a free curvature, 1/cm."""

    @property
    def curvature(self) -> float:
        """Present free curvature, 1/cm."""

class Spool:
    """Motor and line."""

    def __init__(
        self,
        *,
        damping: float,
        lag_s: float,
        stall_n: float,
        sliding_n: float,
        holding_n: float,
        line_cm: float,
    ) -> None:
        """At rest. damping: force per line speed, N s/cm; forces in N at the line."""

    def advance(self, duty: int, shorted: bool, stuck: bool, pull_n: float) -> None:
        """Go one step at a duty of -800..800, under the tail's tension, which pays out."""

    @property
    def damping(self) -> float:
        """Force per line speed, N s/cm."""

    @property
    def sliding_n(self) -> float:
        """Friction of the moving line."""

    @property
    def line_cm(self) -> float:
        """Line paid out."""

class FlexSensor:
    """A flex sensor on its divider, in the tail at first."""

    def __init__(
        self,
        *,
        loop_width: float,
        wrong_gain: float,
        wrinkle: float,
        wrinkle_start_psi: float,
        wrinkle_full_psi: float,
        fold_bend: float,
        center_cm: float,
        span_cm: float,
        scale_per_ohm: float,
        zero_ohm: float,
        divider_ohm: float,
        direction: float,
        loop: float,
        creep_tau_s: float,
        stowed: float,
        phase_1: float,
        phase_2: float,
    ) -> None:
        """The first six ail all sensors: see the scene's [noise] and [flex].

        loop, stowed: 1/cm, of its hysteresis and of its bend in the tail; phases: rad.
        """

    def evert(self, at_s: float, offset: float, creep: float) -> None:
        """Come out of the tip: with an offset of this eversion and a creep (1/cm)."""

    def stow(self) -> None:
        """Go back into the tail."""

    def count(self, curvature: float, length_cm: float, t_s: float, muscle_psi: float) -> float:
        """Go one step; returns the ideal ADC count.

        curvature: mean over the everted part, 1/cm; muscle_psi: of the muscle of its side.
        """

    @property
    def everted(self) -> bool:
        """Whether it is out of the tip."""

    @property
    def center_cm(self) -> float:
        """Its place."""

    @property
    def span_cm(self) -> float:
        """Its length along the body."""
