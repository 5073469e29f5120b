# `make run` and `make test` install everything they need. PYTHON selects the interpreter (3.11 or newer).
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
# Show errors only: warnings about an index or about root do not matter here.
PIP    := $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check --root-user-action ignore

.DEFAULT_GOAL := help
# Distribute whole files, in the order of tests/conftest.py.
WORKERS := -n auto --dist loadscope --no-loadscope-reorder
LEARNERS := sb3 torchrl rllib supersuit

SEQUENCES := 60
TEAM_RUNS := 5000
TEAM_FLIGHT := --duration 20 --law logarithmic --set area.cell=0.5 --expect none

.PHONY: help run test long-test core-test check format reference figures bench docs soak kill-test wall-test team-test compose-test page-test bridge-test learn-test clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 16

$(VENV)/.run: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Outrider needs Python 3.11 or newer: make PYTHON=python3.11 ...")'
	@echo 'installing Outrider into $(VENV), once'
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) --editable .
	@touch $@

$(VENV)/.dev: $(VENV)/.run
	@echo 'installing the test dependencies into $(VENV), once'
	@$(PIP) --editable '.[dev,window,record,drive,dashboard,sweep,dask,falsify,tls,ros2,networks,mavlink,fmi,geo,quadrotor]'
	@touch $@

run: $(VENV)/.run ## run the escort scenario as three processes over Zenoh (ARGS="..." for options)
	@$(BIN)/outrider run $(ARGS)

# Tests start many interpreters: always cache bytecode.
test long-test: export PYTHONDONTWRITEBYTECODE =

test: $(VENV)/.dev ## install and run the test suite
	$(BIN)/python -m pytest $(WORKERS) $(ARGS)

check: $(VENV)/.dev ## check format, lint, types and import contracts
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.dev ## format, and apply automatic fixes
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

reference: $(VENV)/.dev ## write the generated text of the documentation and the scenario's schema
	$(BIN)/python docs/generators/reference.py

figures: $(VENV)/.run ## draw the paper's figures and the table of their claims
	$(BIN)/outrider figures $(ARGS)

bench: $(VENV)/.dev ## measure each layer against its limit into benchmarks/results.json (ARGS="lockstep env_step")
	@rm -f benchmarks/results.json
	$(BIN)/python -m pytest -c benchmarks/pytest.ini --benchmark-json benchmarks/results.json \
		$(or $(ARGS:%=benchmarks/test_speed.py::test_%),benchmarks/test_speed.py)

core-test: ## test the core without extensions and extras in a fresh environment
	rm -rf $(VENV)-core && mkdir -p $(VENV)-core/copy
	git ls-files -- . ':!extensions' ':!benchmarks' | tar -cf - -T - | tar -xf - -C $(VENV)-core/copy
	$(PYTHON) -m venv $(VENV)-core/venv
	$(VENV)-core/venv/bin/python -m pip install --quiet --disable-pip-version-check --root-user-action ignore --constraint constraints.txt --editable $(VENV)-core/copy hypothesis pytest pytest-timeout pytest-xdist
	cd $(VENV)-core/copy && ../venv/bin/python -m pytest $(WORKERS) tests $(ARGS)

long-test: $(VENV)/.dev ## run the long versions of the suite's tests
	$(BIN)/python -m pytest $(WORKERS) -m long $(ARGS)

docs: $(VENV)/.docs ## build the documentation as an offline site in site/index.html
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict $(ARGS) && echo "open site/index.html"

$(VENV)/.docs: $(VENV)/.run
	@$(PIP) --editable '.[docs]'
	@touch $@

soak: $(VENV)/.dev ## simulate an hour with random kills: check memory, trajectory, leftovers
	$(BIN)/python tests/acceptance/soak.py $(ARGS)

kill-test: $(VENV)/.dev ## kill and stop processes at random times; check the trajectory and the counters
	$(BIN)/python tests/acceptance/kill.py $(ARGS)
	$(BIN)/python tests/acceptance/counters.py --sequences $(SEQUENCES)

wall-test: $(VENV)/.dev ## drive along the walls of 1,600 towns: check that no certified UGV hides
	$(BIN)/python tests/acceptance/walls.py $(ARGS)

team-test: $(VENV)/.dev ## attack teams: 900,000 runs of their rules, 10,000 flights with deaths (TEAM_RUNS=5000)
	$(BIN)/python -m pytest -m long tests/test_team_protocol.py
	$(BIN)/outrider falsify scouts --team --runs $(TEAM_RUNS) $(TEAM_FLIGHT)
	$(BIN)/outrider falsify scouts --team --runs $(TEAM_RUNS) $(TEAM_FLIGHT) --set team.guards=2

compose-test: $(VENV)/.run ## build, run, kill, pause and disconnect the containers; needs a Docker engine
	$(BIN)/python tests/acceptance/compose.py $(ARGS)

page-test: $(VENV)/.dev ## test the dashboard in a headless Chromium, installed if needed
	@$(PIP) 'playwright>=1.49' || echo 'page-test: playwright cannot be installed'
	$(BIN)/python extensions/outrider_dashboard/tests/acceptance/page.py --install $(ARGS) || test $$? -eq 77

bridge-test: $(VENV)/.dev ## test the bridges against third-party software in separate environments (ARGS="ros2")
	$(BIN)/python tests/acceptance/bridges.py $(ARGS)

learn-test: $(LEARNERS:%=learn-test-%) ## test the learning libraries, each in its own environment (learn-test-sb3, ...)

$(VENV)-%/.learn: pyproject.toml
	$(PYTHON) -m venv $(VENV)-$*
	$(VENV)-$*/bin/python -m pip install --quiet --quiet --disable-pip-version-check --root-user-action ignore --editable '.[$*,video]' 'pytest>=8.3' 'pytest-timeout>=2.3'
	@touch $@

learn-test-%: $(VENV)-%/.learn
	$(VENV)-$*/bin/python -m pytest -c extensions/outrider_learning/tests/libraries/pytest.ini extensions/outrider_learning/tests/libraries/test_$*.py $(ARGS)

.PRECIOUS: $(VENV)-%/.learn

clean: ## remove environments and outputs of runs
	rm -rf $(VENV) $(LEARNERS:%=$(VENV)-%) $(VENV)-core $(VENV)-ros2 $(VENV)-ros2-rclpy $(VENV)-mavlink $(VENV)-fmi .venv-peers runs figures site
