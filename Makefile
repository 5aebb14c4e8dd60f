# make demo   grasps built-in objects and the one in an image; writes a film and a page
# make test   all checks and tests but the slow ones, which it names
# make test-all  the slow ones too
# make cold-start  the first commands of a newcomer, in empty environments
# make check  those of them that take less than a minute
# make tables writes the tables of README and docs from lab/results
# make fuzz   CASES=1000 SEED=1 damaged files of each kind for the readers
# They set up what they need in .venv, once. PYTHON=... chooses the Python (3.11 or newer) it is made with.

PYTHON ?= python3
CASES ?= 100
SEED ?= 0
JOBS ?= 2
VENV := .venv
BIN := $(VENV)/bin
# Whether hands in images can be found; the models are fetched, as the repository does not hold them.
SEES = $(BIN)/python -c 'import sys, ai_edge_litert; from fungrasp.perception.hand.mediapipe_models import have_weights; \
	sys.exit(not have_weights())' 2>/dev/null
CHECKS := lint types imports docs unit
# Tests that take seconds; with the checks before them, less than a minute on two cores.
QUICK := tests/core/test_errors.py tests/core/test_files.py tests/benchmarks/documents/test_tables.py tests/hands/test_forward_kinematics.py \
	tests/geometry/test_poses.py tests/optimization tests/sim2real tests/policies/checkpoint \
	tests/evaluation/test_statistics.py tests/evaluation/test_result_files.py tests/cli/test_console.py

export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export NO_MKDOCS_2_WARNING := 1
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.PHONY: help demo test test-all cold-start check quick tables format fuzz clean $(CHECKS)
.DELETE_ON_ERROR:

help:
	@sed -n '/^$$/q;s/^# //p' Makefile

demo: $(VENV)/.installed
	@$(SEES) || { echo "fetching the hand models, once"; $(BIN)/fungrasp setup perception; } || \
	echo "the grasp in an image is left out: it needs ai-edge-litert and the hand models"
	$(BIN)/fungrasp demo $(ARGS)

test: $(VENV)/.installed-dev
	@failed=; for check in $(CHECKS); do $(MAKE) --no-print-directory $$check || failed="$$failed $$check"; done; \
	if [ -n "$$failed" ]; then echo "failed:$$failed"; exit 1; fi

check: $(VENV)/.installed-dev
	@$(MAKE) --no-print-directory --jobs=2 --keep-going types quick lint imports

tables: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.documents.tables

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check --output-format concise
	$(BIN)/ruff format --check --output-format concise
	$(BIN)/codespell README.md CONTRIBUTING.md CHANGELOG.md docs lab src emulators ros2 examples benchmarks

types: $(VENV)/.installed-dev
	$(BIN)/pyright --pythonpath $(BIN)/python

imports: $(VENV)/.installed-dev
	$(BIN)/lint-imports --config pyproject.toml

docs: $(VENV)/.installed-dev
	$(BIN)/mkdocs build --quiet --strict --site-dir site

unit: $(VENV)/.installed-dev
	@echo "left out (make test-all runs them): the slow tests of" $$(grep -rl --include='*.py' 'mark.slow' tests | sort)
	$(BIN)/pytest -n $(JOBS) -m "not slow" $(ARGS)

test-all: $(VENV)/.installed-dev
	@$(MAKE) --no-print-directory test
	$(BIN)/pytest -n $(JOBS) -m slow $(ARGS)

cold-start:
	$(PYTHON) benchmarks/cold_start.py $(ARGS)

quick: $(VENV)/.installed-dev
	$(BIN)/pytest $(QUICK)

fuzz: $(VENV)/.installed-dev
	$(BIN)/python tests/core/formats/fuzz.py --cases $(CASES) --seed $(SEED)

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

clean:
	rm -rf $(VENV) site

$(VENV)/.installed: pyproject.toml $(VENV)/.made
	@echo "installing fungrasp into $(VENV), once"
	@$(BIN)/python -m pip install --quiet --no-compile -e ".[perception]" || $(BIN)/python -m pip install --quiet --no-compile -e .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml $(VENV)/.made
	@echo "installing fungrasp and its tools into $(VENV), once"
	@$(BIN)/python -m pip install --quiet --no-compile -e ".[dev,docs]" -e ./emulators
	@touch $@ $(VENV)/.installed

# Debian splits ensurepip off into python3-venv; without it the system's pip puts a pip into the environment.
$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	echo "fungrasp needs Python 3.11 or newer, and '$(PYTHON)' is $$($(PYTHON) --version 2>/dev/null || echo missing);" \
	"choose another one: make PYTHON=/path/to/python3.11"; exit 2; }
	@if $(PYTHON) -c 'import ensurepip' 2>/dev/null; then $(PYTHON) -m venv $(VENV); else \
	$(PYTHON) -m venv --without-pip $(VENV) && $(PYTHON) -m pip --python $(BIN)/python install --quiet pip || { \
	echo "no pip could be put into $(VENV): install one of the packages python3-venv and python3-pip"; exit 2; }; fi
	@touch $@
