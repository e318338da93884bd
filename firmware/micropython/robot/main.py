# The robot's controller: runs until Ctrl-C, mpremote or an error; outputs go off first, always.
#
# A function given as run(PINS, each) is called about every millisecond, for a lamp or a display. It
# may be slow and may collect garbage: the control tick does not wait for Python.
import thigmo_board

from pins import PINS

thigmo_board.run(PINS)
