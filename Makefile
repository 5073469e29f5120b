# Two commands do everything themselves: `make run` flies, `make test` tests. PYTHON chooses the interpreter (3.11 or newer).
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
# Errors alone are shown: what an index lacks, or that one is root, concerns nobody who wants to fly.
PIP    := $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check --root-user-action ignore

.DEFAULT_GOAL := help
# Whole files, in the order that tests/conftest.py gives them.
WORKERS := -n 2 --dist loadscope --no-loadscope-reorder
LEARNERS := sb3 torchrl rllib supersuit

.PHONY: help run test long-test core-test check format figures bench docs soak kill-test compose-test page-test bridge-test learn-test clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 16

$(VENV)/.run: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Outrider needs Python 3.11 or newer: make PYTHON=python3.11 ...")'
	@echo 'installing Outrider into $(VENV), once'
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) --editable .
	@touch $@

$(VENV)/.dev: $(VENV)/.run
	@echo 'installing what the tests need into $(VENV), once'
	@$(PIP) --editable '.[dev,window,record,drive,dashboard,sweep,dask,falsify,tls,ros2,mavlink,fmi]'
	@touch $@

run: $(VENV)/.run ## fly the escort scenario as three processes over Zenoh (ARGS="..." for more)
	@$(BIN)/outrider run $(ARGS)

# Tests start many interpreters: each module is compiled to bytecode once, whatever the environment says.
test long-test: export PYTHONDONTWRITEBYTECODE =

test: $(VENV)/.dev ## install and run the test suite
	$(BIN)/python -m pytest $(WORKERS) $(ARGS)

check: $(VENV)/.dev ## format, lint, types, import contracts
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.dev ## format and mend what can be mended
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

figures: $(VENV)/.run ## the paper's figures and the table of their claims
	$(BIN)/outrider figures $(ARGS)

bench: $(VENV)/.dev ## the speed of each layer beside its limit, in benchmarks/results.json (ARGS="lockstep env_step")
	@rm -f benchmarks/results.json
	$(BIN)/python -m pytest -c benchmarks/pytest.ini --benchmark-json benchmarks/results.json \
		$(or $(ARGS:%=benchmarks/test_speed.py::test_%),benchmarks/test_speed.py)

core-test: ## the core's own tests in a copy without extensions, in a fresh environment without extras
	rm -rf $(VENV)-core && mkdir -p $(VENV)-core/copy
	git ls-files -- . ':!extensions' ':!benchmarks' | tar -cf - -T - | tar -xf - -C $(VENV)-core/copy
	$(PYTHON) -m venv $(VENV)-core/venv
	$(VENV)-core/venv/bin/python -m pip install --quiet --disable-pip-version-check --root-user-action ignore --constraint constraints.txt --editable $(VENV)-core/copy hypothesis pytest pytest-timeout pytest-xdist
	cd $(VENV)-core/copy && ../venv/bin/python -m pytest $(WORKERS) tests $(ARGS)

long-test: $(VENV)/.dev ## the tests that repeat for long what a short one of the suite shows
	$(BIN)/python -m pytest $(WORKERS) -m long $(ARGS)

docs: $(VENV)/.docs ## the documentation as a site that works offline, in site/index.html
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict $(ARGS) && echo "open site/index.html"

$(VENV)/.docs: $(VENV)/.run
	@$(PIP) --editable '.[docs]'
	@touch $@

soak: $(VENV)/.dev ## an hour of simulated time with random kills: memory, trajectory, nothing left behind
	$(BIN)/python tests/acceptance/soak.py $(ARGS)

kill-test: $(VENV)/.dev ## a vehicle killed at 40 random moments from its start to the run's end: the same trajectory each time
	$(BIN)/python tests/acceptance/kill.py $(ARGS)

compose-test: $(VENV)/.run ## the containers, built, flown, killed, paused and cut off; needs a Docker engine
	$(BIN)/python tests/acceptance/compose.py $(ARGS)

page-test: $(VENV)/.dev ## the dashboard in a real headless Chromium; gets what it needs, or says in a line what is missing
	@$(PIP) 'playwright>=1.49' || echo 'page-test: playwright cannot be installed'
	$(BIN)/python extensions/outrider_dashboard/tests/acceptance/page.py --install $(ARGS) || test $$? -eq 77

bridge-test: $(VENV)/.dev ## the bridges against what others wrote, in environments of their own (ARGS="ros2")
	$(BIN)/python tests/acceptance/bridges.py $(ARGS)

learn-test: $(LEARNERS:%=learn-test-%) ## the learning libraries, each installed into an environment of its own (learn-test-sb3, ...)

$(VENV)-%/.learn: pyproject.toml
	$(PYTHON) -m venv $(VENV)-$*
	$(VENV)-$*/bin/python -m pip install --quiet --quiet --disable-pip-version-check --root-user-action ignore --editable '.[$*]' 'pytest>=8.3' 'pytest-timeout>=2.3' 'moviepy>=2'
	@touch $@

learn-test-%: $(VENV)-%/.learn
	$(VENV)-$*/bin/python -m pytest -c extensions/outrider_learning/tests/libraries/pytest.ini extensions/outrider_learning/tests/libraries/test_$*.py $(ARGS)

.PRECIOUS: $(VENV)-%/.learn

clean: ## remove the environments and what runs have written
	rm -rf $(VENV) $(LEARNERS:%=$(VENV)-%) $(VENV)-core $(VENV)-ros2 $(VENV)-ros2-rclpy $(VENV)-mavlink $(VENV)-fmi .venv-peers runs figures site
