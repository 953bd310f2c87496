# Needs make and Python >= 3.11, nothing else. `make help` lists the commands.

PYTHON        ?= python3
VENV          ?= .venv
PIP_ARGS      ?=
EVALUATE_ARGS ?=
PYTEST_ARGS   ?=
TUNE_ARGS     ?=
TRAIN_ARGS    ?=
BENCHMARK_ARGS ?=

BIN        := $(VENV)/bin
PIP        := $(BIN)/python -m pip --disable-pip-version-check
STAMP      := $(VENV)/.installed

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help install leaderboard evaluate paper tune train test test-slow oracle lint format docs tools package bare benchmark clean

help: ## list the commands
	@echo "usage: make COMMAND [PYTHON=python3] [VENV=.venv] [PIP_ARGS=...]"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-13s %s\n", $$1, $$2 }' Makefile
	@echo "PIP_ARGS go to pip install, EVALUATE_ARGS, TUNE_ARGS, TRAIN_ARGS, PYTEST_ARGS and BENCHMARK_ARGS to their program."

install: $(STAMP) ## create the virtual environment, install everything and compile the kernels

evaluate: $(STAMP) ## compare a few policies on a few sets: a first look, about a minute
	$(BIN)/python evaluate.py $(EVALUATE_ARGS)

paper: $(STAMP) ## run both papers again: their claims, figures, one page each (minutes)
	$(BIN)/python evaluate.py --paper strawa2021 $(EVALUATE_ARGS)
	$(BIN)/python evaluate.py --paper focchi2025 $(EVALUATE_ARGS)

# Of Torque-v0, with rows for what better filters could be worth at most.
TORQUE := nominal nominal-centred integral integral-centred l1 mrac adaptive oracle mpc-nominal mpc-adaptive mpc-oracle \
  adaptive-true-motion mpc-adaptive-true-motion mpc-oracle-true-motion \
  ppo-blind ppo-estimates mpc-learned-observer any-vehicle

leaderboard: $(STAMP) ## evaluate controllers and shipped agents on all sets, and renew the tables of results
	@echo "All policies on all sets of three environments: about an hour of two processors."
	rm -rf results/leaderboard
	$(BIN)/python evaluate.py --policies $(TORQUE) --episodes 100 --no-figures --output results/leaderboard
	$(BIN)/python evaluate.py --env tracked_env/Speed-v0 --all --episodes 100 --no-figures --output results/leaderboard
	$(BIN)/python evaluate.py --env tracked_env/Terrain-v0 --all --episodes 100 --no-figures --output results/leaderboard
	for folder in results/leaderboard/*-v4-seed0-*; do $(BIN)/python benchmarks/publish.py $$folder || exit 1; done

tune: $(STAMP) ## search the settings of the controllers on development episodes (an hour)
	for policy in integral adaptive; do $(BIN)/tracked-env tune $$policy $(TUNE_ARGS) || exit 1; done
	$(BIN)/tracked-env tune slc-adaptive --env Speed-v0 $(TUNE_ARGS)
	$(BIN)/tracked-env tune slc-adaptive --env Terrain-v0 $(TUNE_ARGS)

train: $(STAMP) ## train a PPO agent into runs/ppo-blind-seed0
	$(BIN)/python train.py $(TRAIN_ARGS)

PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test: $(STAMP) ## run the tests but for the slow ones (5 minutes, 8 the first time)
	$(PYTEST) -m "not slow" $(PYTEST_ARGS)

test-slow: $(STAMP) ## run the slow tests: trainings, whole programs, clusters, the documentation (10 minutes)
	$(PYTEST) -m slow $(PYTEST_ARGS)

oracle: $(STAMP) ## compare optimal plans with IPOPT (installs CasADi into build/oracle, 93 MB)
	$(PIP) install $(PIP_ARGS) --quiet --upgrade --no-deps --target build/oracle 'casadi>=3.6,<4'
	PYTHONPATH=build/oracle $(BIN)/python -m pytest tests/baselines/planners/test_optimal_oracle.py

lint: $(STAMP) ## ruff (rules and format) and mypy
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy

format: $(STAMP) ## sort imports and format the code
	$(BIN)/python -m ruff check --select I --fix .
	$(BIN)/python -m ruff format .

docs: $(STAMP) ## build the documentation into docs/_build/html
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

tools: ## install each tool of docs/register.md in its own environment and run its examples (GBs)
	$(PYTHON) tests/tools/tools_page.py --folder build/tools $(PIP_ARGS)

package: $(STAMP) ## build wheel and source distribution into dist/ and check their metadata
	rm -rf dist
	$(BIN)/python -m build --sdist --wheel --outdir dist .
	$(BIN)/python -m twine check --strict dist/*

bare: package ## follow the quickstart in a new environment that has the wheel alone
	rm -rf build/bare && $(PYTHON) -m venv build/bare
	build/bare/bin/python -m pip install $(PIP_ARGS) -c constraints.txt dist/*.whl
	build/bare/bin/python tests/follow_page.py docs/quickstart.md build/bare/run
	cd build/bare/run && ../bin/tracked-env evaluate --policies nominal adaptive ppo-blind \
	  --sets payload --episodes 2 --duration 3 --no-figures

benchmark: $(STAMP) ## measure the speed of the environment beside its peers
	$(BIN)/python -m benchmarks.speed $(BENCHMARK_ARGS)

clean: ## remove what tools and builds left (keeps results, compiled kernels and the virtual environment)
	rm -rf build dist docs/_build docs/_generated docs/api .pytest_cache .ruff_cache .mypy_cache .hypothesis .coverage
	rm -rf *.egg-info
	find tracked_env baselines agents reproduce benchmarks tests docs -name __pycache__ -type d -prune -exec rm -rf {} +

# Installation: once, and again when pyproject.toml or constraints.txt is newer than the stamp. Bytecode is written by all
# processors, where pip takes one.
define INSTALL
$(PIP) install --no-compile $(PIP_ARGS) -c constraints.txt -e '.[$(1)]' || { \
  echo >&2; \
  echo "ERROR: pip could not install the dependencies; its message stands above." >&2; \
  echo "  no network or a proxy: set HTTPS_PROXY, or PIP_INDEX_URL to a mirror" >&2; \
  echo "  no such version:       constraints.txt pins tested versions; is this Python newer than they are?" >&2; \
  echo "  disk full:             torch takes most space; its CPU build is smaller:" >&2; \
  echo "                         make $(MAKECMDGOALS) PIP_ARGS='--extra-index-url https://download.pytorch.org/whl/cpu'" >&2; \
  echo "  a broken environment:  rm -rf $(VENV), then try again" >&2; \
  exit 1; }
endef

$(STAMP): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null 2>&1 || { \
	  echo "ERROR: '$(PYTHON)' is not installed or not on the PATH." >&2; \
	  echo "  Install Python >= 3.11, or name one: make $(MAKECMDGOALS) PYTHON=/path/to/python3.11" >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "ERROR: '$(PYTHON)' is $$($(PYTHON) --version 2>&1); 3.11 or newer is needed." >&2; \
	  echo "  Name a newer one: make $(MAKECMDGOALS) PYTHON=/path/to/python3.11" >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo "ERROR: '$(PYTHON)' lacks the venv module (or ensurepip)." >&2; \
	  echo "  On Debian or Ubuntu: sudo apt install python3-venv" >&2; \
	  exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV) || { \
	  echo "ERROR: could not create the virtual environment $(VENV); is the folder writable?" >&2; \
	  exit 1; }
	@$(call INSTALL,rl$(COMMA)render$(COMMA)dev)
	@$(BIN)/python -m compileall -qq -j 0 $(VENV)/lib || true  # a few files are no Python of this version
	$(BIN)/tracked-env compile
	@touch $@

COMMA := ,
