"""The firmware core on a virtual board for four muscles, 16 sensors and 8 body pressures.

Its channels are the sensors' inputs and then the muscles': levels and noise have 20 of them.
"""

from thigmo.emulator._board import Analog as Analog
from thigmo.emulator._board import VirtualBoard as VirtualBoard
