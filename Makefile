# Two commands: `make demo` and `make test`. Both set up what they need; `make help` lists the rest.
SHELL := /bin/bash
.DELETE_ON_ERROR:
.PHONY: help demo test docs quick nightly oldest fuzz soak judge paper setup lint types unit clean

DONE := .venv/.done
RUN := . tools/env.sh &&
# One test process a core, one numeric thread each; tests/conftest.py states which tests stay together. Without its
# bytecode, each of the hundreds of processes that they start would compile the package anew.
PYTEST := env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m pytest -n $$(nproc) --dist loadscope \
          --no-loadscope-reorder

help:
	@grep -E '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

demo: $(DONE)/packages ## install, run and identify the live arm, diagnose another arm
	@$(RUN) OPENBLAS_NUM_THREADS=1 python -m examples.demo

test: lint types unit ## install, then lint, type check and run all tests

docs: ## build the documentation as a website, build/site
	@tools/docs.sh

quick: $(DONE)/packages $(DONE)/tests ## the tests that need no ROS graph, no browser and little time
	@$(RUN) $(PYTEST) -m "not graph and not slow and not browser and not nightly"

nightly: $(DONE)/packages $(DONE)/tests ## the long tests that `make test` leaves out: real arms, paper, challenge
	@$(RUN) $(PYTEST) -m nightly

# The Pinocchio that goes with NumPy 1.26 (2.7) returns NaN for the hidden arm with joint springs.
TESTS := tests
oldest: .venv-oldest/.done ## the tests that need no ROS and little time, with the oldest libraries allowed
	@PATH="$$PWD/.venv-oldest/bin:$$PATH" PYTHONPATH=. $(PYTEST) $(TESTS) -m "not graph and not slow and not browser and not nightly" \
	  --ignore tests/nodes --ignore tests/test_package.py \
	  --deselect "tests/effects/test_simulated.py::test_accelerations_agree_with_the_hidden_arm[joint_spring]"

MINUTES := 60
fuzz: $(DONE)/packages $(DONE)/tests ## pass broken bags and files to all readers, for MINUTES=60
	@$(RUN) python -m tests.fuzz --minutes $(MINUTES) --out runs/fuzz

RATE := 1000
soak: $(DONE)/packages $(DONE)/tests ## run the live graph for MINUTES=60 at RATE=1000: memory, losses, delays in runs/soak
	@$(RUN) python -m benchmarks.soak --minutes $(MINUTES) --rate $(RATE) --out runs/soak

JUDGED := runs/judge.csv
judge: $(DONE)/packages $(DONE)/tests ## diagnose the 150 fixed arms, one row per arm in JUDGED=runs/judge.csv
	@$(RUN) python -m benchmarks.judge --out $(JUDGED)

paper: $(DONE)/packages $(DONE)/extras ## reproduce the paper in one report, runs/paper/report.html
	@$(RUN) elastic-arm paper --out runs/paper --force

setup: $(DONE)/packages $(DONE)/tests ## only install

lint: $(DONE)/tests
	@$(RUN) ruff check --quiet . && ruff format --check .

types: $(DONE)/tests
	@$(RUN) mypy --no-error-summary

unit: $(DONE)/packages $(DONE)/tests
	@$(RUN) tools/unit.sh

clean: ## remove everything that the set-up created
	rm -rf .venv .venv-docs .venv-oldest build install log dist *.egg-info

# A step is done again when what it was made from changes.
$(DONE)/environment: requirements.txt requirements-ros.txt constraints.txt
	@tools/setup.sh environment
	@mkdir -p $(DONE) && touch $@

$(DONE)/packages: $(DONE)/environment package.xml setup.py setup.cfg tools/ros_wheels.cmake \
                  $(wildcard msg_defs/*.xml msg_defs/*.txt msg_defs/msg/*.msg tools/interfaces/*/*/*) \
                  $(wildcard launch/*.py config/*.yaml layouts/*)
	@tools/setup.sh packages
	@touch $@

$(DONE)/extras: $(DONE)/environment requirements-extras.txt
	@tools/setup.sh extras
	@touch $@

$(DONE)/tests: $(DONE)/environment requirements-extras.txt requirements-dev.txt
	@tools/setup.sh tests
	@touch $@

.venv-oldest/.done: requirements.txt requirements-extras.txt requirements-dev.txt constraints-oldest.txt
	@tools/setup.sh oldest
	@touch $@
