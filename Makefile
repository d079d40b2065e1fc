# Every target makes .venv first if it is missing, and brings it up to date when pyproject.toml or
# constraints.txt changed. Options: PYTHON=python3.12 (for a new .venv), JOBS=4 (test processes),
# BENCHES="sweep worlds" and ARGS="--quick" (for make bench).

PYTHON ?= python3
VENV ?= .venv
JOBS ?= 2
BENCHES ?= sweep worlds scaling protocol transfer roundtrip neighbors generate learning stepper train startup backends foreign accuracy error_time fc2d stability house
ARGS ?=

BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv demo test lint format bench clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

# bin/pip is the last thing that venv writes: without it an earlier attempt was cut short
$(VENV)/.dev: pyproject.toml constraints.txt
	@test -x $(BIN)/pip || { echo "== creating $(VENV) with $(PYTHON)"; $(PYTHON) -m venv $(VENV); }
	@echo "== installing deep-contact and its dependencies into $(VENV): a few minutes the first time"
	$(INSTALL) -e '.[dev]'
	@touch $@

venv: $(VENV)/.dev ## make the virtual environment only

demo: $(VENV)/.dev ## run the thesis protocol, print its table and draw its plots into out/demo
	@echo "== demo: the first run also compiles the kernels"
	$(BIN)/deep-contact demo --out out/demo

test: lint ## lint, then run the tests
	@echo "== tests, $(JOBS) processes"
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --max-worker-restart 0

lint: $(VENV)/.dev ## check style, format and types
	@echo "== lint: style, format, types"
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	find dc_kernels -name '*.h' -exec $(BIN)/clang-format --dry-run --Werror {} +
	$(BIN)/mypy

format: $(VENV)/.dev ## format the code and fix what can be fixed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	find dc_kernels -name '*.h' -exec $(BIN)/clang-format -i {} +

bench: $(VENV)/.dev ## run the benches: BENCHES="sweep worlds", ARGS=--quick
	@for name in $(BENCHES); do echo "== bench $$name"; $(BIN)/python -m bench $$name $(ARGS) || exit 1; done

clean: ## remove .venv, out and every cache
	rm -rf $(VENV) out build *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
