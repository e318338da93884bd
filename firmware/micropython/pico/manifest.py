# Frozen into the Pico's image: the file system's start, and the text of the robot's files.
freeze("$(PORT_DIR)/modules", "rp2.py")  # noqa: F821
module("_boot.py", base_path="$(MPY_LIB_DIR)/pico")  # noqa: F821
module("thigmo_board.py", base_path="$(MPY_LIB_DIR)/robot")  # noqa: F821
module("thigmo_names.py", base_path="$(MPY_LIB_DIR)/robot")  # noqa: F821
module("robot_files.py", base_path="$(ROBOT_FILES)")  # noqa: F821
