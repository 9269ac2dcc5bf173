# Every target sets up what it needs by itself. `make help` lists them.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT := out

# Python keeps the tests that it compiled, outside of the sources: collecting them takes 1 s instead of 3.
export PYTHONDONTWRITEBYTECODE :=
export PYTHONPYCACHEPREFIX := $(CURDIR)/out/cache/python

# But not what pip compiles, nor what a user's command does: `.venv/bin/clbvh` looks for that beside the sources.
AS_USER := env -u PYTHONPYCACHEPREFIX
PIP := $(AS_USER) $(BIN)/pip

# One stamp per set of packages; all of them depend on what is to be installed.
INSTALLED := $(VENV)/.installed
INSTALLED_DEV := $(VENV)/.installed-dev
INSTALLED_PEERS := $(VENV)/.installed-peers
INSTALLED_DOCS := $(VENV)/.installed-docs
INSTALLED_STUDY := $(VENV)/.installed-study
INSTALLED_PTXAS := $(VENV)/.installed-ptxas
INSTALLED_LIEF := $(VENV)/.installed-lief

.DEFAULT_GOAL := help
.PHONY: help setup demo gallery test test-processes test-long fuzz mutants conformance conformance-refresh \
  platforms wheels emulated lint bench docs study results gpu-report gpu-day gpu-day-kit clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-19s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(INSTALLED_DEV) ## make .venv with clbvh and everything that tests and lint need

demo: $(INSTALLED) ## render the demo scene to out/demo.ppm and out/demo.png
	@mkdir -p $(OUT)
	$(AS_USER) $(BIN)/clbvh render demo -o $(OUT)/demo.ppm -o $(OUT)/demo.png

gallery: $(INSTALLED) ## draw the pictures of the pages again, each by the command under it; ONLY="bunny meadow"
	$(BIN)/python .ci/draw_gallery.py $(ONLY)

# Each of the WORKERS runs whole files: it compiles for itself what its files share. One test alone is quicker without.
WORKERS := $(if $(TESTS),0,auto)
# What runs in processes of its own is a lane by itself: slower, and seldom broken by a change.
PROCESSES := tests/processes

test: $(INSTALLED_DEV) ## run the tests on the host, some on PoCL, too; TESTS= runs some, CLBVH_TEST_DEVICE=pocl all there
	$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadfile $(if $(TESTS),,--ignore=$(PROCESSES)) $(TESTS)

test-processes: $(INSTALLED_DEV) ## run the tests that start processes: installs, forks, signals, limits, empty caches, examples
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile $(PROCESSES)

# A property's examples and most seeds are random; `make test-long SEED=123` repeats a run.
test-long: $(INSTALLED_DEV) ## run all tests with many more random examples, for an hour or so
	$(BIN)/python -m pytest --hypothesis-profile=long $(if $(SEED),--hypothesis-seed=$(SEED)) $(TESTS)

# Faults are planted one by one in a copy under out/mutants/; ONLY="kernels-3 trees" tests some of them.
mutants: $(INSTALLED_DEV) ## plant small faults in the code, and see that a test fails for each
	$(BIN)/python -m tests.mutants $(if $(ONLY),--only $(ONLY)) $(if $(JOBS),--jobs $(JOBS))

# The same seed gives the same files. A file that fails is kept in out/fuzz/.
fuzz: $(INSTALLED_DEV) ## damage FILES (100,000) files for all readers, cast rays at MESHES (10,000) hard meshes; SEED= repeats
	$(BIN)/python -m tests.fuzz $(if $(FILES),--files $(FILES)) $(if $(MESHES),--meshes $(MESHES)) $(if $(SEED),--seed $(SEED))

# `make conformance RUNTIMES="host pocl rusticl" INSTALL=1` checks these, and installs them first; see docs/conformance.md.
conformance: $(INSTALLED) ## compare the answers of the host and of every OpenCL runtime here with the stored ones
	$(BIN)/python .ci/compare_runtimes.py $(if $(INSTALL),--install) $(RUNTIMES)

conformance-refresh: $(INSTALLED) ## store the answers of the default device anew, where they change on purpose
	$(BIN)/python -m clbvh.conformance.check

platforms: $(INSTALLED_DEV) ## see whether all packages have wheels for each platform and Python (downloads 2 GB)
	$(BIN)/python .ci/check_platforms.py

# Each target has some 560 files of kernels and loops for each of its levels: compiled for the first time, a level takes
# 20 minutes of a processor. `make wheels ONLY=linux-aarch64` builds one.
wheels: $(INSTALLED_LIEF) ## compile for Linux, macOS and Windows: a wheel of each, and the sdist, in dist; CHECK=1 looks into them
	$(BIN)/python .ci/build_wheels.py $(if $(CHECK),--check) $(ONLY)

# `apt-get install qemu-user-static mmdebstrap musl musl-tools wine64 gcc-mingw-w64-x86-64-win32`.
# An emulated Python takes a quarter of an hour.
emulated: $(INSTALLED_DEV) ## run the wheels of dist on aarch64, on an old processor, with musl and Wine; ONLY="musl windows"
	$(BIN)/python .ci/run_emulated.py $(ONLY)

lint: $(INSTALLED_DEV) ## ruff, mypy, import-linter, and the rules for kernels
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(BIN)/python .ci/lint_kernels.py

bench: $(INSTALLED_PEERS) ## measure, beside the peers (installs Open3D and embreex)
	$(BIN)/python -m pytest bench tests/peers -q -s

# `make study QUICK=1` takes four minutes; `make study ONLY="ladder scaling"` runs two experiments. A run goes on where the
# one before was interrupted.
study: $(INSTALLED_STUDY) ## repeat the report's experiments, and write out/study/index.html (installs the peers)
	$(BIN)/clbvh study -o $(OUT)/study $(if $(QUICK),--quick) $(ONLY)

results: $(INSTALLED_STUDY) ## write docs/results.md and the README's table from the study in out/study
	$(BIN)/python -m clbvh.study.publish $(OUT)/study

# The examples are the docstrings', the pages' and the scripts'. `make docs PAGES=only` leaves them out, where `make test`
# has run them. The variable silences an announcement of mkdocs-material's about MkDocs 2. Not --quiet: with it, warnings
# are not counted, and --strict fails for none.
docs: $(INSTALLED_DOCS) ## run every example, and build the documentation site in out/site
	$(if $(filter only,$(PAGES)),,$(BIN)/python -m pytest --quiet tests/docs tests/processes/test_examples.py)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "out/site/index.html"

# Clang and libclc come from the system: apt-get install clang-15 libclc-15.
gpu-report: $(INSTALLED_PTXAS) ## compile every kernel for GPUs that are not here, and write their registers to out/gpu.md
	$(BIN)/python .ci/gpu_report.py $(if $(ONLY),--only $(ONLY))

# `make gpu-day DEVICE=pocl SMALL=1` tries it without a GPU; ONLY="rays builds" takes some steps.
gpu-day: $(INSTALLED_DEV) ## check and measure the first GPU in ten minutes, and write out/gpu-day/gpu-day.md
	$(BIN)/python .ci/gpu_day.py --folder $(OUT)/gpu-day $(if $(DEVICE),--device $(DEVICE)) $(if $(SMALL),--small) $(ONLY)

gpu-day-kit: $(INSTALLED_DEV) ## pack that with all wheels into dist/clbvh-gpu-day.tar.gz, for a machine without a network
	$(BIN)/python .ci/gpu_day_kit.py dist

clean: ## remove what make made, but not downloads
	rm -rf $(VENV) $(OUT) dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -m venv $(VENV) || { echo "the Python module venv is missing: install it, for example with"; \
	  echo "  apt-get install python3-venv"; exit 1; }

$(INSTALLED): pyproject.toml | $(BIN)/python
	@echo "installing clbvh and its libraries into $(VENV), and compiling its kernels: a few minutes the first time"
	$(PIP) install --quiet --disable-pip-version-check --editable .
	@touch $@

$(INSTALLED_DEV): pyproject.toml | $(BIN)/python
	@echo "installing clbvh, its libraries and its tools into $(VENV), and compiling its kernels: a few minutes"
	$(PIP) install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@ $(INSTALLED)

# NVIDIA's assembler: a wheel of 40 MB. Another version may use other registers.
$(INSTALLED_PTXAS): $(INSTALLED)
	$(PIP) install --quiet --disable-pip-version-check nvidia-cuda-nvcc-cu12==12.9.86
	@touch $@

# Reads the libraries of all systems.
$(INSTALLED_LIEF): $(INSTALLED_DEV)
	$(PIP) install --quiet --disable-pip-version-check 'lief>=0.16'
	@touch $@

$(INSTALLED_DOCS): $(INSTALLED_DEV)
	$(PIP) install --quiet --disable-pip-version-check --editable '.[dev,docs]'
	@touch $@

$(INSTALLED_PEERS): $(INSTALLED_DEV)
	$(PIP) install --quiet --disable-pip-version-check --editable '.[dev,peers]'
	@touch $@

$(INSTALLED_STUDY): pyproject.toml | $(BIN)/python
	$(PIP) install --quiet --disable-pip-version-check --editable '.[study,peers]'
	@touch $@ $(INSTALLED)
