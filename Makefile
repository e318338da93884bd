# Every command of the README. `make` alone lists them.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# Rebuild the extensions when their sources, the schema or the packaging change.
CORE   := $(shell find firmware/core firmware/virtual host/thigmo -name '*.h' -o -name '*.cpp') CMakeLists.txt pyproject.toml

# Tests run on this many cores. Tests in real time mostly wait, so more of them run at once, except
# where a browser takes part: those run one after the other.
WORKERS  ?= 2
WAITING  ?= 6
PYTEST  := $(BIN)/pytest -q
FAST    := not (bench or browser or ros or ci or nightly)
LONG    := (bench or browser or ros or ci) and not nightly

.PHONY: help install explore test ci nightly lint bench soak figures docs docs-cells firmware clean
help:
	@echo "make explore  set up what a robot needs, then explore the default room on the emulator"
	@echo "make test     set up everything, then lint, and test units, protocol, simulation and image"
	@echo "make ci       the same, and what takes longer: studies, browser, ROS, fault campaign, docs"
	@echo "make nightly  the same, and the full oracles, soak and studies (hours)"
	@echo "make install  set up $(VENV) only"
	@echo "make lint     types, style, layers, generated files"
	@echo "make bench    the large studies (minutes)"
	@echo "make soak     nine times 0.1 h of robot time with random commands and faults on the simulated Mega"
	@echo "make figures  run everything behind the figures in docs/ and README, and write them there"
	@echo "make docs-cells  execute every command and code cell of the site, and keep their output"
	@echo "make docs     build the site into build/site from that output"
	@echo "make firmware the Mega's image, with its size (needs avr-gcc)"

install: .stamps/install
$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
# What a robot needs; then what its developers need.
.stamps/robot: $(BIN)/python $(CORE)
	@mkdir -p .stamps
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet setuptools wheel scikit-build-core nanobind cmake ninja
	$(BIN)/pip install --quiet --no-build-isolation --editable '.[plot]'
	@touch $@
.stamps/install: .stamps/robot
	$(BIN)/pip install --quiet --no-build-isolation --editable '.[all,dev,bench]'
	@touch $@

# ROS 2 itself with the package ros/thigmo_ros, for the tests to talk to. It has an environment of
# its own, because it replaces the interpreter of the environment that it is installed in. Its wheels
# leave out some of what they need (the second half of the list), and name folders of the machine
# that built them.
ROS := $(addprefix ros-jazzy-, rclpy rmw-fastrtps-cpp nav-msgs sensor-msgs diagnostic-msgs std-srvs \
       visualization-msgs \
       rosidl-default-generators ament-cmake \
       ament-cmake-gmock ament-cmake-gtest ament-cmake-include-directories ament-cmake-pytest \
       ament-cmake-ros ament-package python-cmake-module rosidl-core-generators) catkin_pkg
ROS_PACKAGE := $(shell find ros/thigmo_ros -type f)
.stamps/ros: .stamps/install $(ROS_PACKAGE)
	@mkdir -p .stamps
	$(PYTHON) -m venv .venv-ros
	.venv-ros/bin/pip install --quiet $(ROS)
	.venv-ros/bin/python tools/build_ros_package.py
	@touch $@

explore: .stamps/robot
	$(BIN)/thigmo explore

lint: install
	$(BIN)/python protocol/generate.py --check
	$(BIN)/python tools/figures.py --check
	$(BIN)/python tools/schematics.py --check
	$(BIN)/check-jsonschema --quiet --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/ruff check host ros tests tools protocol docs
	$(BIN)/ruff format --check host ros tests tools protocol docs
	$(BIN)/mypy
	$(BIN)/lint-imports
	git ls-files '*.h' '*.cpp' '*.c' '*.ino' | xargs $(BIN)/clang-format --dry-run --Werror

test: lint
	$(PYTEST) -n $(WORKERS) --dist worksteal -m "$(FAST) and not realtime"
	$(PYTEST) -n $(WAITING) --dist worksteal -m "$(FAST) and realtime"

ci: test .stamps/ros
	$(PYTEST) -n $(WORKERS) --dist worksteal -m "$(LONG) and not realtime"
	$(PYTEST) -m "$(LONG) and realtime"
	$(MAKE) docs-cells
	$(MAKE) docs
	$(BIN)/python tools/release.py

nightly: ci
	$(PYTEST) -n $(WORKERS) --dist worksteal --nightly -m "nightly or scaled"
	$(BIN)/python tools/soak.py
	$(BIN)/thigmo bench --jobs $(WORKERS) --out build/nightly

bench: install
	$(BIN)/thigmo bench

soak: install
	$(BIN)/python tools/soak.py

figures: install
	$(BIN)/python tools/figures.py
	$(BIN)/python tools/fit_picture.py

# Every command and code cell on the pages is executed by one target, and kept; the other builds the
# site from what was kept. A page that fails or is slow is named, and the rest is built.
SPHINX := $(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --jobs 2
docs-cells: install .stamps/docs
	rm -rf build/cells
	DOCS_EXECUTE=1 $(SPHINX) --fresh-env --builder dummy --doctree-dir build/cells/doctrees docs build/cells/pages
docs: install .stamps/docs
	[ -d build/cells ] || $(MAKE) docs-cells || true
	$(SPHINX) --fresh-env docs build/site
.stamps/docs: .stamps/install
	$(BIN)/pip install --quiet --no-build-isolation --editable '.[docs]'
	@touch $@

firmware:
	$(MAKE) -C firmware/mega

clean:
	rm -rf $(VENV) .venv-ros build .stamps
