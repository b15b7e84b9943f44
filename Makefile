# Everything here runs in .venv with the packages of the Python index, ROS 2 included; a ROS 2
# that happens to be sourced in this shell is left out, because the two do not mix.

.DEFAULT_GOAL := help
.PHONY: help setup demo test lint readme

unexport PYTHONPATH PYTHONHOME AMENT_PREFIX_PATH LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
# No packet of a demo or a test leaves this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST

BIN := .venv/bin
STAMP := .venv/.ready
# The first Python of a version that all dependencies have.
FITS := import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for p in python3 python3.12 python3.13 python3.11 python3.10; do \
	$$p -c '$(FITS)' 2>/dev/null && echo $$p && break; done)

help:
	@echo 'make demo    play the included drive through the live nodes; results in out/demo/'
	@echo 'make test    run linters and the whole test suite'
	@echo 'make lint    run the linters alone'
	@echo 'make readme  renew the tables of parameters in README.md'
	@echo 'make setup   install everything into .venv (the others do it by themselves)'

setup: $(STAMP)

$(STAMP): setup.py setup.cfg pyproject.toml
	@test -n '$(PYTHON)' || { echo 'Python 3.10 to 3.13 is needed, and none was found.'; exit 1; }
	@echo 'Setting up .venv: a download of some 400 MB, two minutes or so'
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv || { rm -rf .venv; \
		echo 'No .venv could be made. On Debian and Ubuntu: apt install python3-venv'; exit 1; }
	$(BIN)/python -m pip install --disable-pip-version-check -e '.[ros,simulation,viewer,test]'
	$(BIN)/python -m stri_mapping.build_tf2_msgs
	@touch $@

demo: setup
	$(BIN)/stri-mapping run --bag bags/campus --output out/demo --overwrite

lint: setup
	$(BIN)/ruff check --config .ci/ruff.toml .
	$(BIN)/mypy

# The README's tables of parameters, from the nodes' declarations.
readme: setup
	$(BIN)/python -m stri_mapping.nodes.describe README.md

test: lint
	$(BIN)/python -m pytest
