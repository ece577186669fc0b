# `make attack` and `make test` do everything from a clean clone.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
OUT ?= runs/attack
WORKERS ?= 2

.PHONY: attack test test-all package lint docs bench results clean

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev]'
	touch $@

attack: $(VENV)/.installed  ## attack the shipped detector with BBGAN
	$(BIN)/sada-gym attack SADA-Detection-Car-v0 --adversary bbgan --budget 20000 --seed 0 --workers 2 --out $(OUT) --resume

test: $(VENV)/.installed  ## the fast tests
	$(BIN)/pytest -m 'not slow' -n auto --maxprocesses 4 --dist worksteal

test-all: $(VENV)/.installed  ## every test
	$(BIN)/pytest -n auto --maxprocesses 4 --dist worksteal

package: $(VENV)/.installed  ## sdist and wheel, installed elsewhere: every id steps there
	$(BIN)/pytest tests/test_packaging.py

lint: $(VENV)/.installed  ## format, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

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
