"""Draws the robot's circuit, plumbing, body, nozzle and spool: docs/hardware/*.svg.

    python tools/schematics.py           draw
    python tools/schematics.py --check   fail if a drawing is not what this file says

This file is the schematic's source; the names of parts are those of docs/hardware/parts.csv. Each
drawing fits an A4 page held sideways. `make lint` calls it with --check.
"""

from __future__ import annotations

import argparse
import re
import runpy
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import schemdraw
import schemdraw.elements as elm

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "hardware"
PICO_PINS = FOLDER.parents[1] / "firmware" / "micropython" / "robot" / "pins.py"
A4_MM = (277, 190)  # held sideways, inside its margins
PX_MM = 72 / 25.4
FONT_PT, SMALLEST_PT = 11, 7.5  # as drawn; as printed
Point = tuple[float, float]


def _sheet(title: str) -> schemdraw.Drawing:
    schemdraw.use("svg")
    schemdraw.svgconfig.text = "text"
    elm.style(elm.STYLE_IEC)
    drawing = schemdraw.Drawing(show=False, canvas="svg")
    drawing.config(
        unit=2.2, inches_per_unit=0.46, fontsize=FONT_PT, lw=1.4, margin=0.6, bgcolor="white"
    )
    drawing.add(elm.Label().at((0, 0)).label(title, loc="right", halign="left", fontsize=14))
    return drawing


def _text(
    d: schemdraw.Drawing, place: Point, text: str, align: str = "left", size: int = FONT_PT
) -> None:
    d.add(elm.Label().theta(0).at(place).label(text, loc="center", halign=align, fontsize=size))


def _wire(d: schemdraw.Drawing, *points: Point) -> None:
    for start, end in pairwise(points):
        d.add(elm.Line().at(start).to(end))


def _part(
    d: schemdraw.Drawing, kind: type, start: Point, end: Point, text: str, loc: str = "top"
) -> None:
    d.add(kind().at(start).to(end).label(text, loc=loc, ofst=0.12))


def _ground(d: schemdraw.Drawing, place: Point) -> None:
    d.add(elm.Ground().at(place))


def _rail(d: schemdraw.Drawing, place: Point, text: str) -> None:
    d.add(elm.Vdd().at(place).label(text))


def _tag(d: schemdraw.Drawing, place: Point, text: str) -> None:
    """A pin or plug from which a wire leaves to the right."""
    d.add(elm.Tag(width=place[0]).left().at(place).label(text))


def _box(d: schemdraw.Drawing, corner: Point, size: Point, text: str) -> None:
    x, y = corner
    w, h = size
    d.add(elm.Rect(corner1=(0, 0), corner2=size).theta(0).at(corner))
    lines = text.split("\n")
    for i, line in enumerate(lines):
        _text(d, (x + w / 2 - 0.1, y + h / 2 + (len(lines) - 1) * 0.22 - i * 0.44), line, "center")


def _dot(d: schemdraw.Drawing, *places: Point) -> None:
    for place in places:
        d.add(elm.Dot().at(place))


class _Stop(elm.Button):
    """A contact of the emergency stop: closed until it is pressed."""

    def __init__(self) -> None:
        super().__init__(nc=True)


def current_stage() -> schemdraw.Drawing:
    """PWM to 0..20 mA, one of two."""
    d = _sheet("CURRENT STAGE, left. Right: names + 10, U1B, Mega 45, J11")
    y = -3.6
    _tag(d, (2.2, y), "Mega 46")
    _wire(d, (2.2, y), (3.0, y))
    _part(d, elm.Resistor, (3.0, y), (3.0, y - 2.4), "R1 10k")
    _part(d, elm.Resistor, (3.0, y), (6.0, y), "R2 4.7k")
    _part(d, elm.Capacitor, (6.0, y), (6.0, y - 2.4), "C1 1 µF")
    _part(d, elm.Resistor, (6.0, y), (9.0, y), "R3 4.7k")
    _part(d, elm.Capacitor, (9.0, y), (9.0, y - 2.4), "C2 1 µF")
    _wire(d, (9.0, y), (13.6, y))
    _part(d, elm.Resistor, (11.2, y), (11.2, y - 2.4), "R4 6.2k")
    _dot(d, (3.0, y), (6.0, y), (9.0, y), (11.2, y))
    for x in (3.0, 6.0, 9.0, 11.2):
        _ground(d, (x, y - 2.4))
    amp = d.add(elm.Opamp(leads=False).theta(0).flip().anchor("in2").at((13.6, y)))
    _text(d, (amp.center.x - 0.2, amp.center.y), "U1A", "center")
    _wire(d, (amp.vs.x, amp.vs.y), (amp.vs.x, amp.vs.y + 0.5))
    _rail(d, (amp.vs.x, amp.vs.y + 0.5), "5 V, C4 100 nF")
    _ground(d, (amp.vd.x, amp.vd.y))
    gate = (amp.out.x + 3.0, amp.out.y)
    _part(d, elm.Resistor, (amp.out.x, amp.out.y), gate, "R5 1k")
    drain = (gate[0] + 1.9, gate[1] + 0.75)
    fet = d.add(elm.NFet().theta(0).reverse().at(drain))
    _wire(d, gate, (fet.gate.x, fet.gate.y))
    _text(d, (drain[0] + 0.3, gate[1]), "Q1 TN0110N3-G")
    low, high = y + 1.4, y + 3.6
    _wire(d, drain, (drain[0], low))
    _part(d, elm.RBox, (drain[0], low), (drain[0], high), "TL transducer", "bottom")
    _part(d, elm.Diode, (drain[0] - 1.6, low), (drain[0] - 1.6, high), "D1 1N4148", "top")
    _wire(d, (drain[0], low), (drain[0] - 1.6, low))
    _wire(d, (drain[0], high), (drain[0] - 1.6, high))
    _dot(d, (drain[0], low), (drain[0], high))
    _rail(d, (drain[0], high), "+24 V AIR")
    _text(d, (drain[0] + 0.3, low - 0.2), "J10.2")
    _text(d, (drain[0] + 0.3, high), "J10.1")
    node = (drain[0], y - 3.2)
    _wire(d, (fet.source.x, fet.source.y), node)
    _part(d, elm.Resistor, node, (node[0], node[1] - 2.2), "R6 100R 0.1 %", "bottom")
    _ground(d, (node[0], node[1] - 2.2))
    _text(d, (node[0] + 0.3, node[1] + 0.15), "TP1: 2 V at 20 mA")
    left = (amp.in1.x - 0.5, amp.in1.y)
    out = (amp.out.x + 0.2, amp.out.y)
    _wire(d, (amp.in1.x, amp.in1.y), left, (left[0], node[1]))
    _part(d, elm.Capacitor, (left[0], node[1]), (out[0], node[1]), "C3 1 nF")
    _wire(d, out, (out[0], node[1]))
    _wire(d, (left[0], node[1]), (left[0], node[1] - 1.4))
    _part(d, elm.Resistor, (left[0], node[1] - 1.4), (out[0], node[1] - 1.4), "R7 10k")
    _wire(
        d, (out[0], node[1] - 1.4), (node[0] - 1.2, node[1] - 1.4), (node[0] - 1.2, node[1]), node
    )
    _dot(d, node, out, (left[0], node[1]))
    return d


def enable() -> schemdraw.Drawing:
    """A valve that is on only while the firmware toggles its pin, one of two."""
    d = _sheet("ENABLE, muscles. Body: names + 10, Mega 26, one valve (Y3, J14)")
    y = -3.2
    _tag(d, (2.2, y), "Mega 24")
    _wire(d, (2.2, y), (3.0, y))
    _part(d, elm.Resistor, (3.0, y), (3.0, y - 2.4), "R21 10k")
    _part(d, elm.Capacitor, (3.0, y), (6.0, y), "C21 220 nF")
    _part(d, elm.Schottky, (6.0, y - 2.4), (6.0, y), "D21 BAT85", "bottom")
    _part(d, elm.Schottky, (6.0, y), (9.0, y), "D22 BAT85")
    _part(d, elm.Capacitor, (9.0, y), (9.0, y - 2.4), "C22 1 µF", "bottom")
    _wire(d, (9.0, y), (11.4, y))
    _part(d, elm.Resistor, (11.4, y), (11.4, y - 2.4), "R22 47k", "bottom")
    for x in (3.0, 6.0, 9.0, 11.4):
        _ground(d, (x, y - 2.4))
    _part(d, elm.Resistor, (11.4, y), (14.4, y), "R23 1k")
    _dot(d, (3.0, y), (6.0, y), (9.0, y), (11.4, y))
    drain = (16.2, y + 0.75)
    fet = d.add(elm.NFet().theta(0).reverse().at(drain))
    _wire(d, (14.4, y), (fet.gate.x, fet.gate.y))
    _text(d, (drain[0] + 0.3, y), "Q21 IRLZ44N")
    _ground(d, (fet.source.x, fet.source.y))
    low, high = y + 1.4, y + 3.8
    _wire(d, drain, (drain[0], low))
    _part(d, elm.Diode, (drain[0], low), (drain[0], high), "D23 1N4007")
    _wire(d, (drain[0], low), (21.2, low))
    _wire(d, (drain[0], high), (21.2, high))
    _part(d, elm.Inductor2, (18.4, low), (18.4, high), "Y1, J12", "bottom")
    _part(d, elm.Inductor2, (21.2, low), (21.2, high), "Y2, J13", "bottom")
    _dot(d, (drain[0], low), (18.4, low), (18.4, high), (18.4, high))
    _rail(d, (18.4, high), "+24 V AIR")
    _text(d, (8.6, y + 1.2), "TP21: 3.5 V while the pin toggles, else 0 V")
    _wire(d, (11.4, y), (11.4, y + 0.9))
    return d


def power() -> schemdraw.Drawing:
    """Supplies, fuses, emergency stop, motor."""
    d = _sheet("POWER, EMERGENCY STOP, MOTOR")
    y = -2.2
    _tag(d, (3.0, y), "PS1 24 V, J2.1")
    _part(d, elm.Fuse, (3.0, y), (6.4, y), "F1 1 A slow")
    _part(d, _Stop, (6.4, y), (10.0, y), "S1B, J15.3-4")
    _wire(d, (10.0, y), (12.4, y))
    _rail(d, (12.4, y), "+24 V AIR")
    _text(d, (13.4, y + 0.2), "J10.1, J11.1: transducers")
    _text(d, (13.4, y - 0.4), "J12.1, J13.1, J14.1: valves")
    _text(d, (3.2, y - 0.9), "S1 is drawn released; pressed, all contacts open")

    y = -5.2
    _rail(d, (3.0, y + 0.6), "5 V of the Mega")
    _wire(d, (3.0, y), (3.0, y + 0.6))
    _part(d, elm.Resistor, (3.0, y), (6.4, y), "R41 4.7k")
    _wire(d, (6.4, y), (7.6, y))
    _part(d, _Stop, (7.6, y), (10.8, y), "S1A, J15.1-2")
    _wire(d, (10.8, y), (11.6, y))
    _ground(d, (11.6, y))
    _wire(d, (6.4, y), (6.4, y - 0.9), (7.6, y - 0.9))
    _dot(d, (6.4, y))
    d.add(elm.Tag(width=3.0).right().at((7.6, y - 0.9)).label("Mega 22"))

    y = -9.2
    _tag(d, (3.0, y), "PS2 12 V, J3.1")
    _part(d, elm.Fuse, (3.0, y), (6.4, y), "F2 2 A slow")
    _wire(d, (6.4, y), (8.6, y))
    _part(d, elm.Switch, (8.6, y), (10.6, y), "K1, K2")
    _wire(d, (10.6, y), (11.4, y))
    _part(d, elm.Capacitor2, (7.4, y), (7.4, y - 1.1), "C41 1000 µF 35 V")
    _dot(d, (7.4, y))
    _ground(d, (7.4, y - 1.1))
    _box(d, (11.4, y - 3.7), (4.6, 4.7), "")
    _text(d, (13.7, y + 0.6), "A2 MD10C", "center")
    for name, place in (("POWER +", y), ("POWER -", y - 0.7)):
        _text(d, (11.6, place), name)
    _wire(d, (11.4, y - 0.7), (10.6, y - 0.7))
    _ground(d, (10.6, y - 0.7))
    for name, place, pin, pull in (
        ("PWM", y - 2.1, "Mega 6", "R42 10k"),
        ("DIR", y - 2.7, "Mega 7", "R43 10k"),
        ("GND", y - 3.3, "Mega GND", ""),
    ):
        _text(d, (11.6, place), name)
        _wire(d, (10.0, place), (11.4, place))
        _text(d, (9.8, place), f"{pin}, {pull} to GND" if pull else pin, "right")
    for name, place in (("A", y - 0.4), ("B", y - 2.6)):
        _text(d, (15.8, place), name, "right")
        _wire(d, (16.0, place), (18.6, place))
    _part(d, elm.Motor, (18.6, y - 0.4), (18.6, y - 2.6), "M1 12 V", "bottom")
    _text(d, (16.1, y + 0.05), "J4.1")
    _text(d, (16.1, y - 2.2), "J4.2")

    y = -14.4
    for row, line in enumerate((
        "Star ground: PS1 -, PS2 -, A2 POWER - and Mega GND meet at one screw, beside A2.",
        "J2 and J3 are of different kinds: 24 V must not fit the motor. S1C, K1 and K2 are in",
        "the drawing of the brake. A robot without them: from F2 to POWER + directly.",
    )):  # fmt: skip
        _text(d, (0.0, y - 0.6 * row), line)
    return d


def brake() -> schemdraw.Drawing:
    """Contacts in the motor's supply, and the brake behind them."""
    d = _sheet("MOTOR'S CONTACTS AND BRAKE. Drawn without current: contacts open, brake closed")
    y = -2.6
    _tag(d, (3.0, y), "from F2, 12 V")
    _wire(d, (3.0, y), (5.0, y))
    _part(d, elm.Switch, (5.0, y), (8.4, y), "K1")
    _part(d, elm.Switch, (8.4, y), (11.8, y), "K2")
    _wire(d, (11.8, y), (17.6, y))
    _text(d, (17.8, y + 0.2), "+12 V MOTOR, to A2 POWER +")
    _text(d, (17.8, y - 0.4), "and BR1 (J16.1)")
    _part(d, elm.Resistor, (12.6, y), (12.6, y - 2.2), "R44 150R 2 W", "bottom")
    _ground(d, (12.6, y - 2.2))
    _part(d, elm.Resistor, (16.2, y), (16.2, y - 2.0), "R45 10k", "bottom")
    _part(d, elm.Resistor, (16.2, y - 2.0), (16.2, y - 4.0), "R46 4.7k", "bottom")
    _ground(d, (16.2, y - 4.0))
    _wire(d, (16.2, y - 2.0), (18.4, y - 2.0))
    d.add(elm.Tag(width=2.4).right().at((18.4, y - 2.0)).label("Mega 27"))
    _dot(d, (4.0, y), (12.6, y), (16.2, y), (16.2, y - 2.0))

    top, low = y - 1.6, y - 4.6
    _wire(d, (4.0, y), (4.0, top), (4.6, top))
    _part(d, _Stop, (4.6, top), (7.8, top), "S1C, J15.5-6")
    _wire(d, (7.8, top), (9.4, top))
    _part(d, elm.Inductor2, (9.4, top), (9.4, low), "K1 coil", "bottom")
    _part(d, elm.Diode, (7.8, low), (7.8, low + 1.5), "D40", "top")
    _part(d, elm.Zener, (7.8, top), (7.8, low + 1.5), "D41 24 V", "top")
    _wire(d, (7.8, low), (9.4, low))
    _ground(d, (9.4, low))
    _dot(d, (7.8, top))

    y = -12.2
    for x, pin, names, coil, plug, rail in (
        (0.0, "Mega 28", ("R47", "C44", "D47", "D48", "C42", "R64", "R49", "Q41", "D42", "D43"),
         "K2 coil", "", "12 V, from F2"),
        (14.8, "Mega 29", ("R48", "C45", "D49", "D50", "C43", "R65", "R50", "Q51", "D44", "D45"),
         "BR1", "J16.2", "+12 V MOTOR"),
    ):  # fmt: skip
        pull, pump, up, link, hold, leak, gate, fet_name, diode, zener = names
        d.add(elm.Tag(width=2.2).left().at((x + 1.8, y)).label(pin))
        _wire(d, (x + 1.8, y), (x + 2.2, y))
        _part(d, elm.Resistor, (x + 2.2, y), (x + 2.2, y - 2.2), f"{pull} 10k", "bottom")
        _part(d, elm.Capacitor, (x + 2.2, y), (x + 4.4, y), f"{pump} 220 nF")
        _part(d, elm.Schottky, (x + 4.4, y - 2.2), (x + 4.4, y), up, "bottom")
        _part(d, elm.Schottky, (x + 4.4, y), (x + 6.2, y), link)
        _part(d, elm.Capacitor, (x + 6.2, y), (x + 6.2, y - 2.2), f"{hold} 470 nF", "bottom")
        _part(d, elm.Resistor, (x + 8.8, y), (x + 8.8, y - 2.2), f"{leak} 47k", "bottom")
        _wire(d, (x + 6.2, y), (x + 8.8, y))
        _part(d, elm.Resistor, (x + 8.8, y), (x + 10.6, y), f"{gate} 1k")
        for place in (2.2, 4.4, 6.2, 8.8):
            _ground(d, (x + place, y - 2.2))
        _dot(d, (x + 2.2, y), (x + 4.4, y), (x + 6.2, y), (x + 8.8, y))
        drain = (x + 12.0, y + 0.75)
        fet = d.add(elm.NFet().theta(0).reverse().at(drain))
        _wire(d, (x + 10.6, y), (fet.gate.x, fet.gate.y))
        _text(d, (drain[0] + 0.3, y), fet_name)
        _ground(d, (fet.source.x, fet.source.y))
        low, high = y + 1.2, y + 4.0
        _wire(d, drain, (drain[0], low))
        _part(d, elm.Inductor2, (drain[0], low), (drain[0], high), coil, "bottom")
        _part(d, elm.Diode, (drain[0] - 1.6, low), (drain[0] - 1.6, low + 1.4), diode, "top")
        _part(d, elm.Zener, (drain[0] - 1.6, high), (drain[0] - 1.6, low + 1.4), f"{zener} 24 V")
        _wire(d, (drain[0], low), (drain[0] - 1.6, low))
        _wire(d, (drain[0], high), (drain[0] - 1.6, high))
        _dot(d, (drain[0], low), (drain[0], high))
        _rail(d, (drain[0], high), rail)
        _text(d, (drain[0] + 0.2, low - 0.3), plug)
    _text(d, (0.0, y - 3.8), "Q41, Q51 IRLZ44N. D40, D42, D44 1N4007. D47 to D50 BAT85.")
    return d


def sensors() -> schemdraw.Drawing:
    """Flex sensors, pressure sensors, encoder."""
    d = _sheet(
        "SENSORS: one of each. All 5 V come from the Mega's 5 V pin, all grounds go to its GND"
    )
    y = -2.4
    _rail(d, (3.0, y), "5 V")
    _text(d, (3.3, y - 0.2), "J6.1")
    _part(d, elm.ResistorVar, (3.0, y), (3.0, y - 2.4), "B1 flex sensor, 10k or 25k flat", "bottom")
    node = (3.0, y - 3.0)
    _wire(d, (3.0, y - 2.4), node, (10.0, node[1]))
    _part(d, elm.Resistor, node, (3.0, node[1] - 2.4), "R51 22k 1 %")
    _part(d, elm.Capacitor, (6.6, node[1]), (6.6, node[1] - 2.4), "C51 100 nF")
    for x in (3.0, 6.6):
        _ground(d, (x, node[1] - 2.4))
    _dot(d, node, (6.6, node[1]))
    _text(d, (3.3, node[1] + 0.3), "J6.2")
    d.add(elm.Tag(width=2.2).right().at((10.0, node[1])).label("Mega A0"))
    _text(d, (0.2, node[1] - 3.5), "left, base first: B1..B5, R51..R55, C51..C55, J6.2..6, A0..A4")
    _text(
        d, (0.2, node[1] - 4.1), "right, base first: B6..B10, R56..R60, C56..C60, J7.2..6, A5..A9"
    )

    y = -3.4
    _box(d, (14.0, y - 2.0), (3.8, 2.7), "P1\nHoneywell SSC\n0..60 psi gauge")
    for name, place in (("J8.1", y), ("J8.2", y - 0.7), ("J8.3", y - 1.4)):
        _text(d, (18.0, place + 0.28), name)
    _wire(d, (17.8, y), (23.4, y))
    _rail(d, (23.4, y), "5 V")
    _wire(d, (17.8, y - 0.7), (21.6, y - 0.7))
    d.add(elm.Tag(width=2.4).right().at((21.6, y - 0.7)).label("Mega A10"))
    _part(d, elm.Resistor, (20.4, y - 0.7), (20.4, y - 3.0), "R61 100k", "bottom")
    _ground(d, (20.4, y - 3.0))
    _dot(d, (20.4, y - 0.7))
    _wire(d, (17.8, y - 1.4), (18.6, y - 1.4), (18.6, y - 3.0))
    _ground(d, (18.6, y - 3.0))
    _text(d, (14.0, y - 4.2), "C61 100 nF across J8.1 and J8.3, at the sensor")
    _text(d, (14.0, y - 4.8), "right: P2, R62, C62, J9, A11")

    y = -11.0
    _box(d, (14.0, y - 2.4), (3.8, 3.0), "M1's encoder")
    for name, place, where in (
        ("J5.1 5 V", y, "5 V"),
        ("J5.2 A", y - 0.6, "Mega 2"),
        ("J5.3 B", y - 1.2, "Mega 3"),
        ("J5.4 GND", y - 1.8, "Mega GND"),
    ):
        _wire(d, (17.8, place), (21.6, place))
        _text(d, (18.0, place + 0.2), name)
        _text(d, (21.8, place), where)
    _text(d, (14.0, y - 3.0), "A leads B while paying out; pull-ups are in the Mega")
    _text(d, (14.0, y - 3.6), "in A and B, at the Mega: R71, R72 1k, C71, C72 1 nF to GND,")
    _text(d, (14.0, y - 4.2), "then two inverters each of U2 (74HC14)")
    _text(d, (0.2, -11.0), "A12 is spare: R63 100k to GND")
    return d


def air() -> schemdraw.Drawing:
    """Compressed air, from the wall to muscles and body."""
    d = _sheet("AIR. Without current the valves Y1, Y2 and Y3 empty muscles and body")
    y = -3.0

    def step(x: float, y: float, text: str, width: float = 3.2) -> None:
        _box(d, (x, y - 0.9), (width, 1.8), text)

    def pipe(*points: Point) -> None:
        _wire(d, *points[:-1])
        d.add(elm.Line(arrow="->").at(points[-2]).to(points[-1]))

    def valve(x: float, y: float, name: str) -> None:
        step(x, y, f"{name}, 3/2: on 1-2,\noff 2-3", 3.6)
        pipe((x + 1.8, y - 0.9), (x + 1.8, y - 1.6))
        _text(d, (x + 2.0, y - 1.5), "3, silencer")

    step(0.0, y, "shop air\n60..100 psi", 2.6)
    pipe((2.6, y), (3.4, y))
    step(3.4, y, "V1 shut-off\nthat exhausts", 3.0)
    pipe((6.4, y), (7.2, y))
    step(7.2, y, "FR1 filter 5 µm,\nregulator 25 psi", 3.6)
    _wire(d, (10.8, y), (12.6, y))
    step(8.2, y - 3.0, "RV1 relief,\nopens at 30 psi", 3.4)
    _wire(d, (12.6, y), (12.6, y - 3.0))
    pipe((12.6, y - 3.0), (11.6, y - 3.0))
    _dot(d, (12.6, y - 3.0))
    _dot(d, (12.6, y))
    for side, top, names in (
        ("left", y, ("TL", "Y1", "P1")),
        ("right", y - 3.6, ("TR", "Y2", "P2")),
    ):
        _wire(d, (12.6, y), (12.6, top))
        pipe((12.6, top), (13.4, top))
        step(13.4, top, f"{names[0]} I/P\n2..60 psi", 2.8)
        pipe((16.2, top), (17.0, top))
        valve(17.0, top, names[1])
        pipe((20.6, top), (22.0, top))
        step(22.0, top, f"muscle\n{side}", 2.2)
        _wire(d, (21.2, top), (21.2, top + 1.3), (21.6, top + 1.3))
        _text(d, (21.7, top + 1.3), f"{names[2]}, sensor")
        _dot(d, (21.2, top))
    low = y - 8.0
    _wire(d, (12.6, y - 3.6), (12.6, y - 5.6), (1.6, y - 5.6))
    pipe((1.6, y - 5.6), (1.6, low + 0.9))
    _dot(d, (12.6, y - 3.6))
    step(0.0, low, "PR1 regulator\n0..2 psi, gauge G1", 3.8)
    pipe((3.8, low), (5.0, low))
    step(5.0, low, "NV1 throttle", 3.0)
    pipe((8.0, low), (9.2, low))
    valve(9.2, low, "Y3")
    pipe((12.8, low), (17.4, low))
    step(17.4, low, "base chamber\nand body", 3.4)
    pipe((15.4, low), (15.4, low - 1.6))
    _dot(d, (15.4, low))
    step(14.0, low - 2.5, "RV2 relief,\nopens at 2.5 psi", 3.6)
    return d


def pico() -> schemdraw.Drawing:
    """What is between a Raspberry Pi Pico and the circuits of the other drawings."""
    pins = runpy.run_path(str(PICO_PINS))["PINS"]

    def pin(name: str) -> str:
        return f"GP{pins[name]}"

    def into(place: Point, text: str) -> None:
        d.add(elm.Tag(width=2.2).left().at(place).label(text))

    def out_of(place: Point, text: str) -> None:
        d.add(elm.Tag(width=2.4).right().at(place).label(text))

    def down(kind: type, place: Point, text: str, length: float = 2.0) -> None:
        _part(d, kind, place, (place[0], place[1] - length), text, "bottom")
        _ground(d, (place[0], place[1] - length))

    d = _sheet("PICO (A3) in place of the Mega. A design that has not been tried on hardware")

    y = -3.0
    _text(d, (0.0, y + 1.2), "OUTPUTS, one of eight")
    into((2.2, y), pin("drive_left"))
    _wire(d, (2.2, y), (6.0, y))
    down(elm.Resistor, (3.2, y), "R85 10k")
    _dot(d, (3.2, y))
    _box(d, (6.0, y - 0.6), (2.6, 1.2), "U6, 5 V")
    _wire(d, (8.6, y), (9.6, y))
    out_of((9.6, y), "Mega 46")
    rows = (
        ("drive_left", "R85", "U6", "46"),
        ("drive_right", "R86", "U6", "45"),
        ("muscle_air", "R87", "U6", "24"),
        ("body_air", "R88", "U6", "26"),
        ("motor_pwm", "R89", "U7", "6"),
        ("motor_direction", "R90", "U7", "7"),
        ("motor_enable", "R91", "U7", "28"),
        ("brake_enable", "R92", "U7", "29"),
    )
    for row, (name, pull, buffer, mega) in enumerate(rows):
        words = (name, pin(name), pull, buffer, f"Mega {mega}")
        for x, text in zip((0.0, 4.6, 6.2, 7.8, 9.2), words, strict=True):
            _text(d, (x, y - 4.0 - 0.6 * row), text)
    _text(d, (0.0, y - 9.0), "Mega 46: the other drawings go on there, unchanged.")
    _text(d, (0.0, y - 9.6), "U5, U6, U7: all OE to GND.")

    x = 19.4
    _text(d, (14.6, y + 1.2), "CONVERTERS. U4 as U3, but for CS and channels")
    _box(d, (x, y - 2.6), (2.6, 3.2), "U5\n5 V")
    _box(d, (x + 5.4, y - 3.8), (5.4, 4.4), "")
    _text(d, (x + 8.4, y - 1.0), "U3 MCP3208", "center")
    _text(d, (x + 8.4, y - 1.6), "VDD, VREF: 5 V", "center")
    inputs = (
        ("adc_sck", "R81", "GND", "CLK"),
        ("adc_mosi", "R82", "GND", "DIN"),
        ("adc_select_flex", "R83", "3.3 V", "CS"),
        ("adc_select_other", "R84", "3.3 V", ""),
    )
    for row, (name, pull, rail, end) in enumerate(inputs):
        place = y - 0.7 * row
        _text(d, (x - 1.0, place), f"{pin(name)}, {pull} 10k to {rail}", "right")
        _wire(d, (x - 0.8, place), (x, place))
        _wire(d, (x + 2.6, place), (x + (5.4 if end else 3.2), place))
        _text(d, (x + (5.6 if end else 3.3), place), end or "CS of U4")
    place = y - 3.4
    _text(d, (x + 5.6, place), "DOUT")
    _text(d, (x + 2.4, place + 0.35), "DOUT of U4 too")
    _wire(d, (x + 5.4, place), (x + 1.8, place))
    _part(d, elm.Resistor, (x + 1.8, place), (x - 1.2, place), "R93 2.2k", "bottom")
    down(elm.Resistor, (x - 1.2, place), "R94 3.9k")
    _wire(d, (x - 1.2, place), (x - 2.0, place))
    into((x - 2.0, place), pin("adc_miso"))
    _dot(d, (x - 1.2, place))
    for row, line in enumerate((
        "U3 CH0 to CH4: flex left, A0..A4; CH5 to CH7: flex right, A5..A7",
        "U4 CH0, CH1: flex right, A8..A9; CH2, CH3: pressures, A10..A11",
        "U4 CH4 to CH7: GND. A0..A11: as in the sensors' drawing",
        "C81, C82 1 µF at U3, U4. 100 nF: C83 to C86 at U5 to U8, C87 at R98",
    )):  # fmt: skip
        _text(d, (14.6, place - 3.8 - 0.6 * row), line)

    y = -15.2
    _text(d, (0.0, y + 1.6), f"ENCODER A. B: J5.3, R96, R72, C72, {pin('encoder_b')}")
    into((2.2, y), "J5.2")
    _wire(d, (2.2, y), (4.2, y))
    _part(d, elm.Resistor, (3.2, y), (3.2, y - 2.0), "R95 4.7k", "bottom")
    _text(d, (2.7, y - 2.3), "to 5 V")
    _part(d, elm.Resistor, (4.2, y), (6.6, y), "R71 1k")
    down(elm.Capacitor, (6.6, y), "C71 1 nF")
    _wire(d, (6.6, y), (8.6, y))
    _dot(d, (3.2, y), (6.6, y))
    _box(d, (8.6, y - 0.8), (3.0, 1.6), "U8, 3.3 V,\ntwice")
    _wire(d, (11.6, y), (12.2, y))
    out_of((12.2, y), pin("encoder_a"))

    x = 17.4
    _text(d, (x - 1.6, y + 1.6), "EMERGENCY STOP")
    _rail(d, (x, y), "")
    _text(d, (x - 1.6, y), "3.3 V")
    _part(d, elm.Resistor, (x, y), (x, y - 2.0), "R41 4.7k")
    _part(d, _Stop, (x, y - 2.0), (x, y - 4.0), "S1A, J15.1-2")
    _ground(d, (x, y - 4.0))
    _part(d, elm.Resistor, (x, y - 2.0), (x + 2.4, y - 2.0), "R101 1k")
    down(elm.Capacitor, (x + 2.4, y - 2.0), "C88 100 nF")
    _wire(d, (x + 2.4, y - 2.0), (x + 4.6, y - 2.0))
    _dot(d, (x, y - 2.0), (x + 2.4, y - 2.0))
    out_of((x + 4.6, y - 2.0), pin("estop"))

    dividers = (
        (-8.7, "5 V RAIL", "5 V", "R97 10k", "R98 10k", "supply"),
        (-15.2, "MOTOR'S SUPPLY", "+12 V MOTOR", "R45 10k", "R102 3.3k", "motor_power"),
    )
    x = 27.6
    for y, title, rail, high, low, name in dividers:
        _text(d, (x - 0.2, y + 1.2), title)
        _text(d, (x - 0.2, y + 0.3), rail)
        _part(d, elm.Resistor, (x, y), (x, y - 1.8), high, "bottom")
        down(elm.Resistor, (x, y - 1.8), low, 1.8)
        _wire(d, (x, y - 1.8), (x + 2.2, y - 1.8))
        out_of((x + 2.2, y - 1.8), pin(name))
        _dot(d, (x, y - 1.8))

    y = -21.0
    ends = f"R104, R105 10k: {pin('link_tx')}, {pin('link_rx')} to 3.3 V"
    _text(d, (0.0, y + 1.2), f"LINK. {ends}; GND to A4's GND")
    for x, source, series, sink in (
        (0.0, pin("link_tx"), "R99 1k", "A4 RXD"),
        (10.4, "A4 TXD", "R100 1k", pin("link_rx")),
    ):
        into((x + 2.2, y), source)
        _part(d, elm.Resistor, (x + 2.2, y), (x + 5.8, y), series)
        out_of((x + 5.8, y), sink)
    _text(d, (20.6, y + 0.3), "A3: pin 40 (VBUS) feeds the 5 V rail, U3 to U7 and U1;")
    _text(d, (20.6, y - 0.3), "pin 36 (3V3 OUT) feeds U8, R41, R83, R84, R104, R105")
    return d


def _dimension(d: schemdraw.Drawing, start: Point, end: Point, text: str) -> None:
    """An arrow with two heads between two edges; its text stands beside its middle."""
    d.add(elm.Arrow(double=True, headwidth=0.15, headlength=0.25).at(start).to(end).linewidth(0.8))
    (x0, y0), (x1, y1) = start, end
    aside = (0.2, 0.0) if x0 == x1 else (0.0, 0.35)
    _text(d, ((x0 + x1) / 2 + aside[0], (y0 + y1) / 2 + aside[1]), text,
          "left" if x0 == x1 else "center", 9)  # fmt: skip


def nozzle_and_spool() -> schemdraw.Drawing:
    """Sections; one unit is 10 mm."""
    d = _sheet(
        "NOZZLE AND SPOOL, sections, mm. Of the thesis: 35. All else is this design's choice"
    )
    # The nozzle lies along x, from the chamber's wall; its axis is at y.
    y = -5.0
    _wire(d, (1.0, y + 3.2), (1.0, y + 1.75), (7.0, y + 1.75), (7.0, y + 1.55), (1.4, y + 1.55))
    _wire(d, (1.0, y - 3.2), (1.0, y - 1.75), (7.0, y - 1.75), (7.0, y - 1.55), (1.4, y - 1.55))
    for side in (1.0, -1.0):
        _wire(d, (1.4, y + 1.55 * side), (1.4, y + 0.6 * side), (1.7, y + 0.6 * side),
              (1.7, y + 1.55 * side))  # fmt: skip
        _wire(d, (3.2, y + 1.85 * side), (9.5, y + 1.85 * side))
        d.add(elm.Rect(corner1=(0, 0), corner2=(1.2, 0.25 * side)).theta(0)
              .at((4.0, y + 1.9 * side)))  # fmt: skip
    _dimension(d, (6.2, y - 1.75), (6.2, y + 1.75), "outer 35")
    _dimension(d, (1.0, y - 3.6), (7.0, y - 3.6), "60")
    _text(d, (9.6, y + 1.85), "body, over the nozzle", size=9)
    _text(d, (5.3, y + 2.5), "hose clamp", size=9)
    _text(d, (1.2, y + 3.0), "chamber's wall, pipe of 100", size=9)
    _text(d, (1.9, y), "stop ring: lets the folded\ntube through, not the knot", size=9)
    # The spool, its shaft along x.
    x, top = 16.0, y + 2.5
    for left in (x, x + 2.3):
        d.add(elm.Rect(corner1=(0, 0), corner2=(0.3, -3.0)).theta(0).at((left, top)))
    d.add(elm.Rect(corner1=(0, 0), corner2=(2.0, -2.0)).theta(0).at((x + 0.3, top - 0.5)))
    _wire(d, (x - 1.2, top - 1.3), (x, top - 1.3))
    _wire(d, (x - 1.2, top - 1.7), (x, top - 1.7))
    _dimension(d, (x + 0.3, top + 0.4), (x + 2.3, top + 0.4), "20 between the flanges")
    _dimension(d, (x + 1.2, top - 2.5), (x + 1.2, top - 0.5), "20")
    _dimension(d, (x + 3.0, top - 3.0), (x + 3.0, top), "30")
    _text(d, (x - 1.4, top - 1.5), "M1's\nshaft", "right", 9)
    _text(
        d,
        (x - 2.0, top - 4.0),
        "17 turns of line of 1 mm or less,\nside by side in one layer",
        size=9,
    )
    return d


CM = 0.36  # units for a centimetre of cloth
CENTERS_CM = (5, 15, 25, 35, 45)  # of the sensors, from the clamp


def body_layout() -> schemdraw.Drawing:
    """The tube's cloth, laid flat with its outside up: pouches, sensors and muscles."""
    d = _sheet("BODY, the cloth laid flat, outside up, cm. Of the thesis: 53, the pouches, 5.5")
    x0, y0 = 1.0, -7.2  # of the clamp's line, at the lower edge

    def box(x: float, y: float, length: float, width: float, fill: str | None = None) -> None:
        """A rectangle by the middle of its left end, cm from the clamp and from the lower edge."""
        corner = (x0 + CM * x, y0 + CM * (y - width / 2))
        part = elm.Rect(corner1=(0, 0), corner2=(CM * length, CM * width)).theta(0).at(corner)
        d.add(part.fill(fill) if fill else part)

    box(-8, 6, 65, 12)
    _wire(d, (x0 - CM * 8, y0 + CM), (x0 + CM * 57, y0 + CM))
    for x in (0, 53):
        _wire(d, (x0 + CM * x, y0 - 0.5), (x0 + CM * x, y0 + CM * 12 + 0.5))
    for y, name in ((3.25, "right"), (8.75, "left")):
        box(0, y, 53, 2.5)
        for n, center in enumerate(CENTERS_CM):
            box(center - 5, y, 10, 0.75)
            box(center - 2.75, y, 5.5, 0.45, "lightgray")
            place = (x0 + CM * center, y0 + CM * y + 0.62)
            d.add(elm.Label().theta(0).at(place).label(f"{name} {n}", loc="center", fontsize=8))
    low = y0 - 0.9
    _dimension(d, (x0 - CM * 8, low), (x0, low), "8, clamp")
    _dimension(d, (x0, low), (x0 + CM * 53, low), "53 evert")
    _dimension(d, (x0 + CM * 53, low), (x0 + CM * 57, low), "4, tip")
    top = y0 + CM * 12 + 0.6
    _dimension(d, (x0, top), (x0 + CM * 5, top), "5")
    for first, second in pairwise(CENTERS_CM):
        _dimension(d, (x0 + CM * first, top), (x0 + CM * second, top), "10")
    side = x0 + CM * 58.5
    for start, end, said in ((0, 3.25, "3.25"), (3.25, 8.75, "5.5"), (8.75, 12, "3.25")):
        _dimension(d, (side, y0 + CM * start), (side, y0 + CM * end), said)
    lap = "Lap: the lowest 1 cm lies over the uppermost, along the back. Pouches 10 x 0.75,"
    _text(d, (x0, low - 1.3), f"{lap} sensors 5.5 active (grey),", size=9)
    names = "B1 to B5 are left 0 to 4, B6 to B10 right 0 to 4."
    _text(d, (x0, low - 1.9), f"muscles 2.5 wide when flat, over the pouches. {names}", size=9)
    return d


DRAWINGS: dict[str, Callable[[], schemdraw.Drawing]] = {
    "power": power,
    "current-stage": current_stage,
    "enable": enable,
    "brake": brake,
    "sensors": sensors,
    "air": air,
    "pico": pico,
    "nozzle-and-spool": nozzle_and_spool,
    "body-layout": body_layout,
}


def drawn(name: str) -> str:
    """A drawing as SVG, its size in millimetres so that it prints as it should."""
    text = DRAWINGS[name]().get_imagedata("svg").decode()
    header = re.search(r'height="([\d.]+)pt" width="([\d.]+)pt"', text)
    if header is None:
        raise SystemExit("schemdraw's file header has changed; adapt tools/schematics.py")
    height, width = (float(number) / PX_MM for number in header.groups())
    scale = min(1.0, A4_MM[0] / width, A4_MM[1] / height)
    if scale * FONT_PT < SMALLEST_PT:
        raise SystemExit(
            f"{name}: letters of {scale * FONT_PT:.1f} points on A4; split the drawing"
        )
    size = f'height="{scale * height:.1f}mm" width="{scale * width:.1f}mm"'
    return text.replace(header.group(0), size).rstrip() + "\n"


def main() -> None:
    """Draw, or compare."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true")
    stale = []
    check = parser.parse_args().check
    for name in DRAWINGS:
        path, text = FOLDER / f"{name}.svg", drawn(name)
        if not check:
            path.write_text(text)
        elif not path.is_file() or path.read_text() != text:
            stale.append(path.name)
    if stale:
        sys.exit(f"{', '.join(stale)}: not as drawn by tools/schematics.py; run it and commit")


if __name__ == "__main__":
    main()
