# Penumbra's front door. `make demo` and `make test` work on a fresh Debian machine; `make help` lists the rest.
SHELL := /bin/bash
.DEFAULT_GOAL := help

VENV ?= .venv
PYTHON ?= python3
BIN := $(VENV)/bin
PACKAGES := scene/penumbra_scene kernels/penumbra_kernels service/penumbra_service client/penumbra_client
# Where `make serve` keeps everything.
DATA ?= data
# Extra words for pytest, for instance: make test ARGS="tests/client -k sse"
ARGS ?=

export VENV PYTHON

.PHONY: help setup bench bench-peers peers demo test serve lint types contracts schema layout lock pictures lights compose-secrets clean distclean accuracy test-statistics farmsim faults soak farm

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

setup: ## make the virtual environment (every other target does so by itself)
	@./scripts/bootstrap.sh

demo: setup ## start the service, render an example scene as a client would, stop the service
	@$(BIN)/python scripts/demo.py $(ARGS)

test: setup ## run the whole test suite
	@$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile $(ARGS)

.PHONY: test-postgres
test-postgres: setup ## the API's tests once more, with the service on PostgreSQL (Debian's package): two minutes
	@PENUMBRA_TEST_DATABASE=postgresql PENUMBRA_REQUIRE_TOOLS=1 $(BIN)/python -m pytest tests/service/api $(ARGS)

.PHONY: test-hard test-oclgrind numerics
test-hard: setup ## the hard cases and examples with all their samples: some minutes
	@PENUMBRA_HARD_CASES=full $(BIN)/python -m pytest tests/hardcases --timeout 1800 $(ARGS)

test-oclgrind: setup ## every example under a memory checker (Debian's oclgrind): some minutes
	@PENUMBRA_OCLGRIND=all PENUMBRA_REQUIRE_TOOLS=1 $(BIN)/python -m pytest tests/hardcases/test_oclgrind.py $(ARGS)

numerics: setup ## measure the hard cases and write them into docs/numerics.md
	@$(BIN)/python scripts/numerics.py $(ARGS)

serve: setup ## keep the service up on 127.0.0.1:8484, its data in data/ (DATA=folder)
	@exec $(BIN)/penumbra serve --data $(DATA) $(ARGS)

lint: setup ## ruff: style and format
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .

types: setup ## mypy in strict mode
	@$(BIN)/mypy

contracts: setup ## import-linter: who may import whom
	@$(BIN)/lint-imports

schema: setup ## write docs/schema from the models
	@$(BIN)/python -m penumbra_scene.schema

layout: setup ## write kernels/penumbra_kernels/cl/layout.h from layout.py
	@$(BIN)/python -m penumbra_kernels.layout

lock: setup ## pin every package, with hashes (ARGS=--upgrade for newer ones)
	@./scripts/lock.sh $(ARGS)

farmsim: setup ## simulate a day of 10,000 workers with the planner of the service, and write it into docs/farm.md: some minutes of a core
	@$(BIN)/python bench/farm_simulation.py $(ARGS)

pictures: setup ## render every example into docs/pictures
	@$(BIN)/python scripts/pictures.py $(ARGS)

bench: setup ## measure against Embree and Mitsuba, and write docs/performance.md (ARGS=--full for longer)
	@$(BIN)/python bench/run.py $(ARGS)

peers: setup .venv-peers/.stamp ## make the environment of Cycles and LuxCore (PEERS_PYTHON=python3.11)

# Blender as a module is for Python 3.11 and numpy 1: apart from everything of ours.
PEERS_PYTHON ?= python3.11
.venv-peers/.stamp: bench/peers/requirements.lock
	@$(PEERS_PYTHON) -m venv --clear .venv-peers
	@.venv-peers/bin/python -m pip --disable-pip-version-check install --quiet --require-hashes --requirement $<
	@touch $@

bench-peers: peers ## measure Cycles and LuxCore beside Penumbra: some minutes, whose results docs/performance.md keeps
	@$(BIN)/python bench/run.py --only peers $(ARGS)

lights: setup ## measure how lights are chosen, and write docs/lights.md
	@$(BIN)/python bench/lights.py $(ARGS)

faults: setup ## kill, stop and fill what a farm consists of while it renders; the picture must have the same bits
	@PENUMBRA_FAULTS=all $(BIN)/python -m pytest tests/faults tests/service/test_dropped_connections.py $(ARGS)

soak: setup ## 200 random kills on a farm of PoCL workers, nothing lost: a quarter of an hour or two (KILLS=n)
	@PENUMBRA_SOAK_KILLS=$(or $(KILLS),200) $(BIN)/python -m pytest tests/faults/test_soak.py -s $(ARGS)

farm: setup ## measure what a farm costs against the local engine, and write it into docs/farm.md: five minutes
	@$(BIN)/python bench/farm.py $(ARGS)

compose-secrets: setup ## make keys and certificates for docker-compose.yml, in secrets/
	@./scripts/compose-secrets.sh

accuracy: setup ## measure what accuracy costs on the examples, and write docs/accuracy.md
	@$(BIN)/python scripts/accuracy.py $(ARGS)

test-statistics: setup ## 1,000 seeds of scenes with known means for every sampler; writes docs/coverage.md
	@$(BIN)/python scripts/coverage.py $(ARGS)

clean: ## remove what the targets left, but not the environment or the service's data
	@rm -rf out dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	@find $(PACKAGES) tests -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## remove the environment too
	@rm -rf $(VENV)

.PHONY: pairs
pairs: setup ## every two effects in a scene of their own: specialised against generic, bit for bit
	@PENUMBRA_ALL_PAIRS=1 $(BIN)/python -m pytest -n auto --maxprocesses 4 tests/kernels/trace/test_pairs.py $(ARGS)

.PHONY: effects
effects: setup ## measure what leaving effects out saves, and write docs/effects.md
	@$(BIN)/python bench/effects.py $(ARGS)
