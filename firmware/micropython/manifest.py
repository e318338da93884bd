# Frozen into the images whose hardware is injected; a Pico keeps these files on its file system.
module("thigmo_board.py", base_path="$(MPY_LIB_DIR)/robot")  # noqa: F821
module("thigmo_names.py", base_path="$(MPY_LIB_DIR)/robot")  # noqa: F821
module("main.py", base_path="$(MPY_LIB_DIR)/robot")  # noqa: F821
module("pins.py", base_path="$(MPY_LIB_DIR)/robot")  # noqa: F821
