"""The robot on this board: start its controller, read it, command it.

    import thigmo_board
    from pins import PINS

    board = thigmo_board.Board(PINS)
    board.start()
    print(board.curvature())

Commands meet the same checks as a host's. A refused one raises OSError with the reason. From arm()
on, call beat() within every half second (the parameter heartbeat_ms), or the robot stops.
"""

import struct

import _thigmo
from thigmo_names import (
    ACTIVITIES,
    EVENTS,
    FAULTS,
    LENGTH_KNOWN,
    MESSAGES,
    REASONS,
    SENSORS_ALL,
    STATES,
)

_NONE = -32768


class Board:
    """The controller of one robot.

    Args:
        pins: the number of the pin of each signal, by name, as in pins.py; other names are ignored.
    """

    def __init__(self, pins):
        self._pins = pins
        self._callback = None

    # --- the controller's life --------------------------------------------------------------------
    def start(self):
        """Start the controller beside Python; ValueError if the pins cannot serve it."""
        _thigmo.start(self._pins)
        if self._callback:
            _thigmo.notify(self._deliver)

    def end(self):
        """Outputs off; the controller ends. start() starts it anew."""
        _thigmo.end()

    def running(self):
        """Whether the controller runs."""
        return _thigmo.runs()

    def on_event(self, callback):
        """Have callback(name, arg, value) called at each event (PROTOCOL.md, EventCode).

        It runs between two statements of the program; the controller does not wait for it. If it
        raises, the outputs go off. None ends the calls.
        """
        self._callback = callback
        _thigmo.notify(self._deliver if callback else None)

    def _deliver(self):
        while self._callback:
            event = _thigmo.ask(_thigmo.EVENT)
            if not event:
                return
            _, code, _, arg, value = struct.unpack("<HBIHi", event)
            self._callback(EVENTS.get(code, code), arg, value)

    # --- readings ---------------------------------------------------------------------------------
    def curvature(self):
        """Curvature at each flex input, 1/cm; None where none is read.

        A sensor reads once it is everted and zeroed.
        """
        answer = _thigmo.ask(_thigmo.CURVATURE)
        values = struct.unpack(f"<{len(answer) // 2}h", answer)
        return tuple(None if value == _NONE else value / 100000 for value in values)

    def pressure(self):
        """Pressure of each muscle, psi."""
        return tuple(value / 100 for value in self._status()[8:-8])

    def length(self):
        """Everted length, cm; None if it is unknown."""
        status = self._status()
        return status[7] / 10000 if status[5] & LENGTH_KNOWN else None

    def state(self):
        """boot, safe, ready, moving or fault."""
        return STATES[self._status()[1]]

    def activity(self):
        """What the robot does: idle, growing, sweeping and so on."""
        return ACTIVITIES[self._status()[2]]

    def faults(self):
        """Names of the latched faults."""
        latched = self._status()[4]
        return tuple(FAULTS[bit] for bit in sorted(FAULTS) if latched >> bit & 1)

    def _status(self):
        answer = _thigmo.ask(_thigmo.COMMAND, MESSAGES["get_status"])
        muscles = answer[16]
        head = struct.unpack("<BBBBHHIi", answer[:16])
        tail = struct.unpack(f"<{muscles}hHHHHIHHI", answer[17:])
        return head + tail

    # --- commands ---------------------------------------------------------------------------------
    def stop(self):
        """Stop, whoever has the robot: 0 mA, motor braked, latched until clear_stop()."""
        _thigmo.ask(_thigmo.STOP, 0, struct.pack("<I", self._status()[6] | 1))

    def clear_stop(self):
        """Clear the latched stop, after a look at the robot."""
        self._take()
        self._command("clear_stop", struct.pack("<I", self._status()[-1]))

    def clear_faults(self):
        """Clear the latched faults whose cause is gone."""
        self._take()
        self._command("clear_faults", b"\xff\xff")

    def beat(self):
        """Tell the controller that the program is alive."""
        _thigmo.ask(_thigmo.BEAT)

    def arm(self):
        """Take the robot, unless a host has it, and let outputs be energised."""
        self._take()
        self._command("arm")

    def disarm(self):
        """Outputs off; arm() is needed again."""
        self._command("disarm")

    def vent(self):
        """Set all transducers to 0 mA; ends a sweep."""
        self._command("vent")

    def confirm_length(self, length_cm, settled=False):
        """State the everted length as measured, and whether the sensors have settled since."""
        self._take()
        self._command("confirm_length", struct.pack("<iB", round(length_cm * 1e4), bool(settled)))

    def select_zone(self, zone):
        """State which of the configured body pressures is set, from 0."""
        self._take()
        self._command("select_zone", bytes([zone]))

    def zero(self):
        """Take the present readings of the everted sensors for those of a straight body."""
        self._command("zero_sensors", struct.pack("<H", SENSORS_ALL & self._status()[-8]))

    def body_air(self, wanted):
        """Open the body's air valve (True), or close it and empty the body."""
        self._command("body_air", bytes([bool(wanted)]))

    def home(self):
        """Wind in to the base."""
        self._command("home")

    def grow_to(self, length_cm, speed_cm_s=0):
        """Grow to an everted length; speed 0: as configured."""
        self._wind("grow_to", length_cm, speed_cm_s)

    def retract_to(self, length_cm, speed_cm_s=0):
        """Retract to an everted length; speed 0: as configured."""
        self._wind("retract_to", length_cm, speed_cm_s)

    def _wind(self, name, length_cm, speed_cm_s):
        payload = struct.pack("<iI", round(length_cm * 1e4), round(speed_cm_s * 1e4))
        self._command(name, payload)

    def sweep(self, amplitudes_psi, period_s, cycles=1, hold_on_contact=False):
        """Bend with half a sine of pressure, one muscle after the other.

        Args:
            amplitudes_psi: peak pressure of each muscle; 0 skips it.
            period_s: of a whole sine; each muscle takes half of it.
            cycles: how often all muscles take their turn.
            hold_on_contact: hold the pressure when a contact is felt, until vent().
        """
        peaks = [round(100 * psi) for psi in amplitudes_psi]
        payload = bytes([len(peaks)]) + struct.pack(f"<{len(peaks)}h", *peaks)
        payload += struct.pack("<IBB", round(1000 * period_s), cycles, bool(hold_on_contact))
        self._command("sweep", payload)

    def _take(self):
        _thigmo.ask(_thigmo.TAKE)
        _thigmo.ask(_thigmo.BEAT)

    def _command(self, name, payload=b""):
        answer = _thigmo.ask(_thigmo.COMMAND, MESSAGES[name], payload)
        if answer[1]:
            raise OSError(f"{name}: {REASONS[answer[1]]}")
