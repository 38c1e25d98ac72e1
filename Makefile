# Everything sets itself up: a virtual environment in .venv with the versions of constraints.txt.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
BROWSER_STAMP := $(VENV)/.browser
DOCS_STAMP := $(VENV)/.docs
GRADIENTS_STAMP := $(VENV)/.gradients

.PHONY: park test test-system test-browser docs reference tutorials check lint types contracts safety clean paper paper-quick paper-docs paper-gradients

park: $(STAMP)
	$(BIN)/rover-ncp park --out runs/park --overwrite

# Unit tests in two workers, as CI has two cores; process tests in three, whose processes do not keep up beside other work
# if there are more. Then a short set of system tests, alone, because they measure times. About seven minutes on two cores.
test: $(STAMP)
	$(BIN)/pytest tests/unit -m "not long" --numprocesses 2 --dist worksteal
	$(BIN)/pytest tests/process -m "not long" --numprocesses 3 --dist worksteal
	$(BIN)/pytest tests/system -m short

# The long unit and process tests, then the other system tests: installations and drives; then, with little beside
# them, those that measure times: every row of both safety matrices, the soak, live drives.
test-system: $(STAMP)
	$(BIN)/pytest tests/unit tests/process -m long --numprocesses 3 --dist worksteal
	$(BIN)/pytest tests/system -m "not short and not browser and not timed" --ignore=tests/system/test_tutorials.py \
		--numprocesses 2 --dist worksteal
	$(BIN)/pytest tests/system -m "timed and not short" --numprocesses 3 --dist loadgroup

# Tests of the pages in Debian's chromium (installed if missing) and of recordings in Rerun; pictures in runs/browser.
test-browser: $(BROWSER_STAMP)
	$(BIN)/pytest -m browser

check: lint types contracts test tutorials test-system

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/mypy

contracts: $(STAMP)
	$(BIN)/lint-imports

# Every command of the tutorials; they mostly wait for drives in real time. With make docs under four minutes.
tutorials: $(STAMP)
	$(BIN)/pytest tests/system/test_tutorials.py --numprocesses 3 --dist worksteal

# The documentation as a site in build/site; a broken link or reference is an error.
docs: reference $(DOCS_STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "The site: open $(CURDIR)/build/site/index.html in a browser."

# Writes the pages of docs/reference that are made from the code.
reference: $(STAMP)
	$(BIN)/python docs/reference_pages.py

# Measures the safety matrix and writes it into docs/safety.md.
safety: $(STAMP)
	PYTHONPATH=tests $(BIN)/python tests/tools/safety_table.py

# Every fault of the safety matrix at random moments, in processes that keep running; the table in runs/soak.
SOAK_MINUTES ?= 20
soak: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m faults --minutes $(SOAK_MINUTES)

.PHONY: soak

# A run of seconds for every task of the paper: the circuit and a network, each checked by a replay.
paper-quick: $(STAMP)
	$(BIN)/rover-ncp paper run --budget quick --again --agent circuit --agent mlp --seed 0 --results runs/paper-quick
	$(BIN)/rover-ncp paper replay --budget quick --agent circuit --agent mlp --seed 0 --results runs/paper-quick

# The paper's missing runs, without PPO and A2C. Takes hours; an interrupted run can be continued.
paper: $(STAMP)
	$(BIN)/rover-ncp paper run

# Writes what `rover-ncp paper` prints of the shipped runs into docs/paper.md.
paper-docs: $(STAMP)
	$(BIN)/python tests/tools/paper_tables.py

# PPO in the parking environment, then PPO and A2C: installs stable-baselines3, which needs torch.
paper-gradients: $(GRADIENTS_STAMP)
	$(BIN)/python docs/examples/ppo_parking.py
	$(BIN)/rover-ncp paper run --agent ppo --agent a2c

# CfC and LTC against the library ncps, whose cells need torch; elsewhere the tests are skipped.
test-torch: $(GRADIENTS_STAMP)
	$(BIN)/pytest tests/unit/learn/test_liquid.py

.PHONY: test-torch

# The gate's own tests must run every line and branch of it.
coverage-gate: $(STAMP)
	$(BIN)/coverage run --branch --include='bridge/gate/*.py' --data-file=.coverage-gate \
		-m pytest -q tests/unit/bridge/test_gate*.py tests/unit/bridge/test_limits.py
	$(BIN)/coverage report --data-file=.coverage-gate --show-missing --fail-under=100

# The gate's tests must fail on every mutant of it, except those in tests/data/gate_survivors.yaml. Takes minutes.
mutate: $(STAMP)
	$(BIN)/python tests/tools/mutate_gate.py

# Fuzz the readers of external data for FUZZ_S seconds, guided by branch coverage (atheris).
fuzz: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,fuzz]'
	$(BIN)/python tests/tools/fuzz_atheris.py

.PHONY: coverage-gate mutate fuzz

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v <= (3, 13) else "rover-ncp needs Python 3.11 to 3.13, found %d.%d; run make PYTHON=..." % v)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

$(BROWSER_STAMP): $(STAMP)
	command -v chromium >/dev/null || { apt-get -qq update && apt-get -qq install --yes --no-install-recommends chromium fonts-dejavu-core; } >/dev/null
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,browser]'
	touch $@

$(DOCS_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,docs]'
	touch $@

$(GRADIENTS_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,paper]'
	touch $@

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis runs
