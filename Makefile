# `make attack` and `make test` do everything from a clean clone; `make help` lists all commands.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
OUT ?= runs/attack
WORKERS ?= 2

UV := $(shell command -v uv)
PIP_INSTALL = $(BIN)/python -m pip install -qq --no-compile -c constraints.txt
# PyTorch's builds for the CPU: its other builds bring CUDA, several GB that nothing here uses
UV_INSTALL = uv pip install --quiet --torch-backend cpu --python $(BIN)/python -c constraints.txt
INSTALL = $(if $(UV),$(UV_INSTALL) $(1) || (echo "uv failed, so pip installs" && $(PIP_INSTALL) $(1)),$(PIP_INSTALL) $(1))
# many images set this for a smaller disk; each of the tests' processes would compile torch anew
export PYTHONDONTWRITEBYTECODE =
# the tests, on up to four cores
TEST = $(BIN)/pytest -n auto --maxprocesses 4 --dist worksteal

.PHONY: help attack test test-long test-all package lint docs bench results clean

help:  ## what make can do
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-9s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

# what an attack needs
$(VENV)/.package: pyproject.toml constraints.txt
	@echo "Creating the environment $(VENV)$(if $(UV), with uv)"
	@$(if $(UV),uv venv --quiet --seed --allow-existing --python $(PYTHON) $(VENV),$(PYTHON) -m venv $(VENV))
	@echo "Installing sada_gym and the packages that it needs (a minute or two, 1.6 GB)"
	@$(call INSTALL,-e .)
	@touch $@

# what developers need beside it
$(VENV)/.installed: $(VENV)/.package
	@echo "Installing the developers' tools (some minutes, 1 GB)"
	@$(call INSTALL,-e '.[dev]')
	@touch $@

attack: $(VENV)/.package  ## attack the shipped detector in three ways, and compare them
	@$(BIN)/python examples/three_attacks.py --out $(OUT)

test: $(VENV)/.installed  ## the fast tests
	$(TEST) -m 'not slow and not long'

test-long: $(VENV)/.installed  ## examples, the pages' code, and what starts many processes
	$(TEST) -m 'long and not slow'

test-all: $(VENV)/.installed  ## every test
	$(TEST)

package: $(VENV)/.installed  ## sdist and wheel, installed elsewhere: every id steps there
	$(BIN)/pytest tests/test_packaging.py

lint: $(VENV)/.installed  ## format, lint, imports, types, and the lines of each folder
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports --no-logo
	$(BIN)/mypy
	@$(BIN)/python -m tools.count_lines

docs: $(VENV)/.installed  ## the documentation, warnings as errors
	$(BIN)/sphinx-build -W --keep-going -b html docs docs/_build/html

bench: $(VENV)/.installed  ## speed, as ratios within one run
	$(BIN)/pytest benchmarks -s

# PLAN=--plan says what is missing and what it will cost; a stopped run goes on, on any machine
results: $(VENV)/.installed  ## measure what the leaderboard's entries lack, and write the tables
	@suites=$$($(BIN)/python -m leaderboard.tables --suites) && for suite in $$suites; do \
	  $(BIN)/sada-gym benchmark --suite $$suite --out docs/results/$$suite \
	    --entries leaderboard/entries --workers $(WORKERS) $(PLAN) || exit 1; \
	done
	$(if $(PLAN),,$(BIN)/python -m leaderboard.tables)

clean:  ## the environment and what was built
	rm -rf $(VENV) build docs/_build
