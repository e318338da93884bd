# The lab's program: starts the controller, then leaves the prompt to you. `board` is there.
#
# The controller runs beside Python. A host may connect by the link's pins at any time; without one,
# arm() makes this program the host, and it must call board.beat() within every half second.
import thigmo_board
from pins import PINS

board = thigmo_board.Board(PINS)
board.start()
