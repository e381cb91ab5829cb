# Two commands are all a newcomer needs: `make run` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
SEED ?= 1
# Half of the tests is numerical work that one core does; two workers fill two cores.
WORKERS ?= 2

# What Debian 12 has of ROS 1, for the dVRK: rospy, a master (roscore) and the messages. crtk_msgs is in our own definitions.
ROS := python3-rospy python3-rosmaster python3-roslaunch python3-rostopic python3-sensor-msgs python3-geometry-msgs python3-std-srvs

.PHONY: run test test-all lint bench ros clean

# Status 1 is a session that ended incomplete: a result, and no error of make's.
run: $(STAMP)
	$(BIN)/dissect run --scene silicone --seed $(SEED) || [ $$? -eq 1 ]

test: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) -m "not slow"

test-all: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)
	$(BIN)/python -m benchmarks.render
	$(BIN)/python -m benchmarks.tick
	$(BIN)/python -m benchmarks.exposure

# As root, on Debian 12. A .pth file puts Debian's packages after pip's, where PYTHONPATH would put them before. Without ROS the tests
# on a real graph skip, saying why.
ros: $(STAMP)
	apt-get update --quiet
	DEBIAN_FRONTEND=noninteractive apt-get install --yes --quiet --no-install-recommends $(ROS)
	/usr/bin/python3 -c 'import pathlib, rospy; print(pathlib.Path(rospy.__file__).parents[1])' \
		> "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/ros1.pth"
	$(BIN)/python -c 'import rospy, sensor_msgs.msg, geometry_msgs.msg, std_srvs.srv'

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "Python 3.11 or newer is needed; this is " + sys.version)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	touch $(STAMP)

clean:
	rm -rf $(VENV)
