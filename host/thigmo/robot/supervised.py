"""The board's configuration and its supervisor: parameters, faults, arming, venting."""

from __future__ import annotations

from thigmo.config import RobotConfig
from thigmo.errors import CommandRefusedError, CommandTimeoutError
from thigmo.link import protocol as wire
from thigmo.link.heart import PERIOD_S
from thigmo.link.stored import StoredConfiguration
from thigmo.robot.configuration import get_parameter, send_config, set_parameters
from thigmo.robot.connected import Connected
from thigmo.robot.readings import SensorTable

_VENT_S = 15.0  # muscles empty within a second or two; a blocked valve does not


class Supervised(Connected):
    """A robot that can be configured, armed and vented."""

    # Configuration.

    def configure(self, config: RobotConfig) -> bool:
        """Send robot.toml to the board, read it back, and store it there if it changed.

        A flex sensor's fault is cleared with it if the sensor is now marked unhealthy. Returns
        whether the board's configuration changed.

        Raises:
            ConfigError: a value that the board cannot hold, or does not give back.
            CommandRefusedError: an output is energised, or a value is out of range.
        """
        changed = send_config(self._client, config)
        self.config = config
        self._configured(1 << self.parameter("oversample_log2")[0])
        status = self.status()
        if changed or status.config_generation == 0 or "bad_config" in status.faults:
            self.save()
        # What a configuration cures; the board keeps a fault whose cause lasts.
        cured = {"bad_config", *(("flex_open", "flex_short") if changed else ())}
        if cured & set(status.faults):
            self.clear_faults(*sorted(cured & set(status.faults)))
        return changed

    def parameter(self, name: str) -> list[int]:
        """A parameter of the schema as the board holds it, in its wire unit.

        Raises:
            ConfigError: no such parameter.
        """
        return get_parameter(self._client, name)

    def set_parameter(self, name: str, values: list[int]) -> None:
        """Set a parameter in the board's memory, in its wire unit; `save` stores it.

        Raises:
            ConfigError: no such parameter, a wrong number of values, or one out of range or that
                contradicts another.
        """
        set_parameters(self._client, {name: values})

    def load_defaults(self) -> None:
        """Give the board the schema's defaults, store them, and clear `bad_config`."""
        self._client.request(wire.LoadDefaults())
        self.save()
        self.clear_faults("bad_config")

    def save(self) -> int:
        """Store the configuration in the board; returns its generation. Takes seconds."""
        return self._client.request(wire.SaveConfig()).detail

    def stored_configuration(self) -> StoredConfiguration:
        """How the stored configuration fits the firmware that runs."""
        return StoredConfiguration.of(self._client.request(wire.GetConfigReport()))

    def _configured(self, oversample: int) -> None:
        """The board has another configuration; its raw readings sum so many conversions."""
        self._table = SensorTable.of(self.config, oversample)
        self._aside = 0
        self._decode()

    # State.

    def clear_faults(self, *names: str) -> tuple[str, ...]:
        """Clear latched faults, named as in the schema or all, whose cause is gone.

        Returns the names of those that remain.
        """
        known = [wire.Fault[name.upper()] for name in names] or list(wire.Fault)
        mask = sum(fault.mask for fault in known)
        remaining = self._client.request(wire.ClearFaults(mask)).detail
        return tuple(fault.key for fault in wire.Fault.from_mask(remaining))

    def raise_faults(self) -> None:
        """Tell a latched fault, if there is one.

        Raises:
            RobotFaultError: a fault is latched.
        """
        faults = self.status().faults
        if faults:
            raise self._watch.fault_error(faults)

    def arm(self, *, body_air: bool = True) -> None:
        """Leave safe for ready: outputs may be energised from now on, and the body gets its air.

        Without `body_air` the body stays empty, if it has an enable.

        Raises:
            RobotFaultError: a fault is latched.
        """
        self.raise_faults()
        try:
            self._request(wire.Arm())
        except CommandRefusedError as error:
            if error.reason != "host_silent":
                raise
            # While an operator was asked nothing was heard of the board, and the heart held still.
            self.wait(2.0 * PERIOD_S)
            self._request(wire.Arm())
        if body_air:
            self._request(wire.BodyAir(1))

    def test_output(self, output: wire.Output, level: int, seconds: float) -> None:
        """Drive one output as it is; the board ends it by itself unless repeated, or at `vent`.

        Args:
            output: which.
            level: transducer 0..400 (5 mA), motor -200..200 (a quarter of full).
            seconds: at most 0.5.

        Raises:
            CommandRefusedError: not armed, beyond a limit, or a muscle holds pressure (motor).
        """
        self._request(wire.TestOutput(output, level, round(seconds * 1e3)))

    def vent(self, *, wait: bool = True) -> None:
        """Empty both muscles, and wait until they are, by their sensors.

        Do not wait for sensors whose zeros are unknown.

        Raises:
            CommandTimeoutError: they stay under pressure.
        """
        self._request(wire.Vent())
        if wait:
            self._wait_vented()

    def _wait_vented(self) -> None:
        end = self.now() + _VENT_S
        while "vented" not in self.status().conditions:
            if self.now() > end:
                raise CommandTimeoutError(
                    f"a muscle still holds pressure {_VENT_S:.0f} s after venting",
                    "check the exhaust of its transducer; if it is empty, its sensor's zero: "
                    "`thigmo bringup --robot PORT --from pressure`",
                )
            self.wait(0.2)
