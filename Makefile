# `make` lists what it can do
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal

PYTHONS ?= python3.10 python3.12 python3.13

.PHONY: $(shell sed -n 's/^\([a-z][a-z-]*\):.*/\1/p' $(MAKEFILE_LIST))

# each target with the sentence behind its ##
help:
	@sed -n 's/^\([a-z][a-z-]*\):.*## /\1|/p' $(MAKEFILE_LIST) | awk -F'|' '{ printf "make %-15s %s\n", $$1, $$2 }'

env: $(STAMP) ## Make the environment .venv, or bring it up to date.

# made once; installed again when pyproject.toml or setup.py changes
$(STAMP): pyproject.toml setup.py
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	@touch $@

demo: env ## Render the jelly video into out/.
	@mkdir -p out
	@start=$$(date +%s) && $(BIN)/taichi-sim run jelly -o out/jelly.mp4 \
	  && echo "out/jelly.mp4 took $$(( $$(date +%s) - start )) s"

# Taichi holds one precision per process, so each has its own run
test: env ## Run the tests that are worth most, in both precisions.
	TAICHI_SIM_PRECISION=f32 $(PYTEST) -m "not slow"
	TAICHI_SIM_PRECISION=f64 $(PYTEST) -m "not slow"

# what `make test` leaves out: some twenty minutes
test-more: env ## Run the slow tests that `make test` leaves out, some twenty minutes.
	TAICHI_SIM_PRECISION=f32 $(PYTEST) -m "slow and not long"
	TAICHI_SIM_PRECISION=f64 $(PYTEST) -m "slow and not long"

# the same answers on a device as on the CPU: ARCH=cuda, metal or vulkan, which without a GPU is SwiftShader
ARCH ?= vulkan
test-gpu: env ## Compare a device with the CPU: ARCH=cuda, metal or vulkan.
	TAICHI_SIM_PRECISION=f32 $(BIN)/python -m pytest -m gpu --arch $(ARCH)

# the tests of `make test` in single precision on other Pythons, each with the newest packages that it takes
test-pythons: ## Run `make test` in single precision on other Pythons: PYTHONS="python3.10 python3.13".
	@for python in $(PYTHONS); do \
	  $$python -c "" 2>/dev/null || { echo "$$python: not here"; continue; }; \
	  folder=$$(mktemp -d) && $$python -m venv $$folder \
	  && $$folder/bin/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]" \
	  && TAICHI_SIM_PRECISION=f32 $$folder/bin/python -m pytest -n 2 --dist worksteal -m "not slow" \
	  && rm -rf $$folder || exit 1; \
	done

# what Blender sees in the files that are written for it: its package takes 1 GB, and Python 3.11
BLENDER := .venv-blender
test-blender: env ## Check what Blender reads of the files written for it (1 GB, Python 3.11).
	@test -x $(BLENDER)/bin/python || python3.11 -m venv $(BLENDER)
	$(BLENDER)/bin/python -m pip install --quiet --disable-pip-version-check bpy==5.0.1
	BLENDER_PYTHON=$(BLENDER)/bin/python TAICHI_SIM_PRECISION=f32 $(BIN)/python -m pytest tests/outputs/test_blender.py

# the tests of `make test` on the engine Quadrants, with the same bits on the CPU
test-quadrants: env ## Run `make test` on the engine Quadrants.
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev,quadrants]"
	TAICHI_SIM_ENGINE=quadrants TAICHI_SIM_PRECISION=f32 $(PYTEST) -m "not slow"
	TAICHI_SIM_ENGINE=quadrants TAICHI_SIM_PRECISION=f64 $(PYTEST) -m "not slow"

# what takes hours
test-long: env ## Run the tests that take hours.
	TAICHI_SIM_PRECISION=f32 $(PYTEST) -m long
	TAICHI_SIM_PRECISION=f64 $(PYTEST) -m long

test-all: test test-more test-gpu test-quadrants test-long ## Run all tests.

check: env ## Check format, lint and types.
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

wheel: env ## Build the wheel, install it into an empty environment, list its demos and run one.
	@folder=$$(mktemp -d) && trap 'rm -rf $$folder' EXIT \
	  && $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir $$folder . \
	  && $(PYTHON) -m venv $$folder/venv \
	  && $$folder/venv/bin/python -m pip install --quiet --disable-pip-version-check $$folder/*.whl \
	  && $(BIN)/taichi-sim demos >$$folder/demos \
	  && cd $$folder && venv/bin/taichi-sim demos | diff demos - \
	  && venv/bin/taichi-sim run box --duration 0.2 -o box.npz

# random scenes, judged by what holds for any; ended and started again it goes on where it was: SCENES=2000 SEED=1
SCENES ?= 2000
SEED ?= 1
referee: env ## Judge random scenes by laws that hold for any: SCENES=2000 SEED=1.
	@mkdir -p out
	$(BIN)/python -m tests.referee --scenes $(SCENES) --seed $(SEED) --shrink --json out/referee_$(SEED).json

# exports that are killed at random moments and resumed: KILLS=200 SEED=1; some seconds each
KILLS ?= 200
kills: env ## Kill exports at random moments and resume them: KILLS=200 SEED=1.
	$(BIN)/python -m tests.support.kills --kills $(KILLS) --seed $(SEED)
	$(BIN)/python -m tests.support.sweep_kills --seed $(SEED)

# thousands of scene files, states and meshes that something happened to: each is read, or refused in one sentence
CASES ?= 10000
fuzz: env ## Read damaged scene files, states and meshes: CASES=10000.
	$(BIN)/python -m tests.fuzz --cases $(CASES)

# problems with known solutions, measured at the defaults: writes docs/published.md; NAMES="pendulum silo" prints these alone
published: env ## Measure problems with known solutions, and write docs/published.md.
	$(BIN)/python -m tests.published $(NAMES)

bench: env ## Run the benchmark beside its reference implementations.
	$(BIN)/taichi-sim bench

# the pages that the program writes of itself, and the site in out/docs, which needs no network; any warning fails
docs: env ## Build the site in out/docs, after the reference from schema and commands.
	$(BIN)/python -m tests.support.scene_keys
	$(BIN)/python -m tests.support.command_page
	$(BIN)/python -m sphinx -q -W -n --keep-going -d out/doctrees docs out/docs
	@echo "out/docs/index.html"

# the loops of docs/gallery.md that are not there
gallery: env ## Make the loops of docs/gallery.md that are missing.
	$(BIN)/python -m tests.support.gallery

clean: ## Remove environments, builds, caches and outputs.
	rm -rf $(VENV) $(BLENDER) build dist out bench_out *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
