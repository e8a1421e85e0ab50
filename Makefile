# make demo   make the environment, render the jelly video
# make test   make the environment, pass the tests that are worth most, in minutes
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal

PYTHONS ?= python3.10 python3.12 python3.13

.PHONY: help env demo test test-more test-gpu test-pythons test-quadrants test-blender test-long test-all check bench published referee kills fuzz docs gallery clean

help:
	@echo "make env | demo | test | test-more | test-gpu | test-pythons | test-quadrants | test-blender | test-long | test-all | check | bench | published | referee | kills | fuzz | docs | gallery | clean"

env: $(STAMP)

# made once; installed again when pyproject.toml changes
$(STAMP): pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	@touch $@

demo: env
	@mkdir -p out
	@start=$$(date +%s) && $(BIN)/taichi-sim run jelly -o out/jelly.mp4 \
	  && echo "out/jelly.mp4 took $$(( $$(date +%s) - start )) s"

# Taichi holds one precision per process, so each has its own run
test: env
	TAICHI_SIM_PRECISION=f32 $(PYTEST) -m "not slow"
	TAICHI_SIM_PRECISION=f64 $(PYTEST) -m "not slow"

# what `make test` leaves out: some twenty minutes
test-more: env
	TAICHI_SIM_PRECISION=f32 $(PYTEST) -m "slow and not long"
	TAICHI_SIM_PRECISION=f64 $(PYTEST) -m "slow and not long"

# the same answers on a device as on the CPU: ARCH=cuda, metal or vulkan, which without a GPU is SwiftShader
ARCH ?= vulkan
test-gpu: env
	TAICHI_SIM_PRECISION=f32 $(BIN)/python -m pytest -m gpu --arch $(ARCH)

# the tests of `make test` in single precision on other Pythons, each with the newest packages that it takes
test-pythons:
	@for python in $(PYTHONS); do \
	  $$python -c "" 2>/dev/null || { echo "$$python: not here"; continue; }; \
	  folder=$$(mktemp -d) && $$python -m venv $$folder \
	  && $$folder/bin/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]" \
	  && TAICHI_SIM_PRECISION=f32 $$folder/bin/python -m pytest -n 2 --dist worksteal -m "not slow" \
	  && rm -rf $$folder || exit 1; \
	done

# what Blender sees in the files that are written for it: its package takes 1 GB, and Python 3.11
BLENDER := .venv-blender
test-blender: env
	@test -x $(BLENDER)/bin/python || python3.11 -m venv $(BLENDER)
	$(BLENDER)/bin/python -m pip install --quiet --disable-pip-version-check bpy==5.0.1
	BLENDER_PYTHON=$(BLENDER)/bin/python TAICHI_SIM_PRECISION=f32 $(BIN)/python -m pytest tests/outputs/test_blender.py

# the tests of `make test` on the engine Quadrants, with the same bits on the CPU
test-quadrants: env
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev,quadrants]"
	TAICHI_SIM_ENGINE=quadrants TAICHI_SIM_PRECISION=f32 $(PYTEST) -m "not slow"
	TAICHI_SIM_ENGINE=quadrants TAICHI_SIM_PRECISION=f64 $(PYTEST) -m "not slow"

# what takes hours
test-long: env
	TAICHI_SIM_PRECISION=f32 $(PYTEST) -m long
	TAICHI_SIM_PRECISION=f64 $(PYTEST) -m long

test-all: test test-more test-gpu test-quadrants test-long

check: env
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

# random scenes, judged by what holds for any; ended and started again it goes on where it was: SCENES=2000 SEED=1
SCENES ?= 2000
SEED ?= 1
referee: env
	@mkdir -p out
	$(BIN)/python -m tests.referee --scenes $(SCENES) --seed $(SEED) --shrink --json out/referee_$(SEED).json

# exports that are killed at random moments and resumed: KILLS=200 SEED=1; some seconds each
KILLS ?= 200
kills: env
	$(BIN)/python -m tests.support.kills --kills $(KILLS) --seed $(SEED)
	$(BIN)/python -m tests.support.sweep_kills --seed $(SEED)

# thousands of scene files, states and meshes that something happened to: each is read, or refused in one sentence
CASES ?= 10000
fuzz: env
	$(BIN)/python -m tests.fuzz --cases $(CASES)

# problems with known solutions, measured at the defaults: writes docs/published.md; NAMES="pendulum silo" prints these alone
published: env
	$(BIN)/python -m tests.published $(NAMES)

bench: env
	$(BIN)/taichi-sim bench

# the tables of keys in docs/scenes.md, from the schema
docs: env
	$(BIN)/python -m tests.support.scene_keys

# the loops of docs/gallery.md that are not there
gallery: env
	$(BIN)/python -m tests.support.gallery

clean:
	rm -rf $(VENV) $(BLENDER) build dist out bench_out *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
