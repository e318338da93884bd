"""The fibre of a robot that is driven: opened where it is needed first, and guarding motions.

A robot with a fibre that is read live grows and bends only while the fibre is read. The supervisor
asks before every command and while it waits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from thigmo.config import RobotConfig
from thigmo.errors import ConfigError
from thigmo.link import protocol as wire
from thigmo.link.interrogator import Interrogator, TcpSource
from thigmo.operator_prompts import Simulated
from thigmo.record import FibreLine
from thigmo.robot.fibre import Fibre

if TYPE_CHECKING:
    from thigmo.link.client import Client

_LINES_S = 2.0  # within which an interrogator sends its first lines
# What a fibre guards, what ends that, and what lays it otherwise.
_GUARDED = (wire.GrowTo, wire.Sweep, wire.SetPressure)
_UNGUARDED = (wire.Vent, wire.RetractTo, wire.Home)
_MOTIONS = (wire.GrowTo, wire.RetractTo, wire.Home, wire.TestOutput)


class FibreGuard:
    """A robot's fibre, if it has one that is read live.

    Attributes:
        on_line: called with each line of strains and each zeroing, in order.
        guarding: whether a motion that the fibre guards is under way.
    """

    def __init__(
        self, link: Client, config: RobotConfig, simulated: Simulated | None = None
    ) -> None:
        self.on_line: list[Callable[[FibreLine], None]] = []
        self.guarding = False
        self._link = link
        self._config = config
        self._simulated = simulated  # whose fibre is emulated
        self._fibre: Fibre | None = None

    def use(self, config: RobotConfig) -> None:
        """Read the fibre that robot.toml describes, once it is needed; the old one is closed."""
        self.close()
        self._config = config

    @property
    def fitted(self) -> bool:
        """Whether the robot has a fibre that is read live."""
        return bool(self._config.gratings) and self._config.interrogator is not None

    def before(self, command: wire.Message) -> None:
        """Note a command that is about to be sent: whether it is guarded, and voids the zeros."""
        if isinstance(command, _MOTIONS) and self._fibre is not None:
            self._fibre.void()
        self.guarding = (isinstance(command, _GUARDED) and self.fitted) or (
            self.guarding and not isinstance(command, _UNGUARDED)
        )

    def require(self) -> Fibre:
        """The fibre, opened, with all its strains of now.

        Raises InterrogatorError if they are not, and ConfigError for a robot without a fibre that
        is read live.
        """
        if self._fibre is None:
            self._fibre = self._open()
        self._fibre.require()
        return self._fibre

    def _open(self) -> Fibre:
        address, count = self._config.interrogator, len(self._config.gratings)
        if address is None or not count:
            raise ConfigError(
                "the robot has no fibre that is read live",
                'give `interrogator = "host:port"` and its gratings in robot.toml',
            )
        source = self._simulated.interrogator() if self._simulated else TcpSource(address)
        interrogator = Interrogator(source, count, self._link.now)
        self._link.wait_for(lambda: interrogator.heard, _LINES_S)
        fibre = Fibre(self._config, interrogator, self._publish)
        # Its lines are read before the frame that comes after them is kept and handed on.
        self._link.taps.insert(0, fibre.tap)
        self._link.on_telemetry.insert(0, fibre.telemetry)
        return fibre

    def _publish(self, line: FibreLine) -> None:
        for callback in self.on_line:
            callback(line)

    def close(self) -> None:
        """Close the fibre, if it is open."""
        if self._fibre is not None:
            self._link.taps.remove(self._fibre.tap)
            self._link.on_telemetry.remove(self._fibre.telemetry)
            self._fibre.close()
            self._fibre = None
