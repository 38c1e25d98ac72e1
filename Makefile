# Everything sets itself up: a virtual environment in .venv with the versions of constraints.txt.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
BROWSER_STAMP := $(VENV)/.browser
GRADIENTS_STAMP := $(VENV)/.gradients

.PHONY: park test test-browser check lint types contracts safety clean paper paper-quick paper-gradients

park: $(STAMP)
	$(BIN)/rover-ncp park --out runs/park --overwrite

# Two workers, a file to each: many tests wait for real processes, and two cores are what CI has.
test: $(STAMP)
	$(BIN)/pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

# The pages in Debian's chromium, which it installs where there is none, recordings in Rerun; pictures in runs/browser.
test-browser: $(BROWSER_STAMP)
	$(BIN)/pytest -m browser

check: lint types contracts test

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/mypy

contracts: $(STAMP)
	$(BIN)/lint-imports

# Measures the safety matrix and writes it into docs/safety.md.
safety: $(STAMP)
	$(BIN)/python tests/safety_table.py

# A run of seconds for every task of the paper: the circuit, a network, and both checked by a replay.
paper-quick: $(STAMP)
	$(BIN)/rover-ncp paper run --budget quick --again --agent circuit --agent mlp --seed 0 --runs runs/paper-quick
	$(BIN)/rover-ncp paper replay --agent circuit --agent mlp --seed 0 --runs runs/paper-quick

# All of the paper's runs that are not made yet, but those of PPO and A2C. Hours; interrupt it, and go on.
paper: $(STAMP)
	$(BIN)/rover-ncp paper run

# PPO and A2C: installs stable-baselines3, and with it torch.
paper-gradients: $(GRADIENTS_STAMP)
	$(BIN)/rover-ncp paper run --agent ppo --agent a2c

# The gate has the last word: every line and branch of it is run by its own tests.
coverage-gate: $(STAMP)
	$(BIN)/coverage run --branch --include='bridge/gate/*.py' --data-file=.coverage-gate \
		-m pytest -q tests/test_bridge_gate*.py tests/test_bridge_limits.py
	$(BIN)/coverage report --data-file=.coverage-gate --show-missing --fail-under=100

# And every change of it is noticed by them, but those of tests/data/gate_survivors.yaml. Takes minutes.
mutate: $(STAMP)
	$(BIN)/python tests/mutate_gate.py

# Readers of other people's bytes, fuzzed for FUZZ_S seconds, led by the code's own branches (atheris).
fuzz: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,fuzz]'
	$(BIN)/python tests/fuzz_atheris.py

.PHONY: coverage-gate mutate fuzz

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v <= (3, 13) else "rover-ncp needs Python 3.11 to 3.13, found %d.%d; say make PYTHON=..." % v)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

$(BROWSER_STAMP): $(STAMP)
	command -v chromium >/dev/null || { apt-get -qq update && apt-get -qq install --yes --no-install-recommends chromium fonts-dejavu-core; } >/dev/null
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,browser]'
	touch $@

$(GRADIENTS_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,paper]'
	touch $@

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis runs
