# Every target sets up what it needs by itself. `make help` lists them.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT := out

# One stamp per set of packages; all of them depend on what is to be installed.
INSTALLED := $(VENV)/.installed
INSTALLED_DEV := $(VENV)/.installed-dev
INSTALLED_PEERS := $(VENV)/.installed-peers

# numba notices a change in the file of a function, not in the files that it compiles into it; so each state of the
# compiled rooms has a cache of its own.
COMPILED := $(shell find clbvh/build clbvh/tree clbvh/trace clbvh/layout.py clbvh/morton_bits.py clbvh/simd.py -name '*.py' | sort | xargs cat | cksum)
NUMBA_CACHE := $(VENV)/numba-cache/$(firstword $(COMPILED))

.DEFAULT_GOAL := help
.PHONY: help setup demo test lint bench clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(INSTALLED_DEV) ## make .venv with clbvh and everything that tests and lint need

demo: $(INSTALLED) ## render the demo scene to out/demo.ppm and out/demo.png
	@mkdir -p $(OUT)
	$(BIN)/clbvh render demo -o $(OUT)/demo.ppm -o $(OUT)/demo.png

test: $(INSTALLED_DEV) ## run all tests on the OpenCL device at hand, PoCL if there is no other
	NUMBA_CACHE_DIR=$(CURDIR)/$(NUMBA_CACHE) $(BIN)/python -m pytest $(TESTS)

lint: $(INSTALLED_DEV) ## ruff, mypy and import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

bench: $(INSTALLED_PEERS) ## measure, beside the peers (installs Open3D and embreex)
	$(BIN)/python -m pytest bench tests/peers -q -s

clean: ## remove what make made, but not downloads
	rm -rf $(VENV) $(OUT) dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -m venv $(VENV) || { echo "the Python module venv is missing: install it, for example with"; \
	  echo "  apt-get install python3-venv"; exit 1; }

$(INSTALLED): pyproject.toml | $(BIN)/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(INSTALLED_DEV): pyproject.toml | $(BIN)/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@ $(INSTALLED)

$(INSTALLED_PEERS): $(INSTALLED_DEV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev,peers]'
	@touch $@
