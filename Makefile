# `make` prints this list. Every target sets itself up: an environment in .venv with the versions of constraints.txt.
# A pipe ends with the exit code of its tests.
SHELL := bash
.SHELLFLAGS := -o pipefail -c
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
BROWSER_STAMP := $(VENV)/.browser
DOCS_STAMP := $(VENV)/.docs
DEMO_STAMP := $(VENV)/.demo
GRADIENTS_STAMP := $(VENV)/.gradients
FUZZ_STAMP := $(VENV)/.fuzz
FILES_STAMP := $(VENV)/.files
RELEASE_STAMP := $(VENV)/.release
# uv where it is present, or pip.
UV := $(shell uv --version >/dev/null 2>&1 && command -v uv)
# The pip of an older Python knows no dependency groups, the newest does.
MAKE_VENV := $(if $(UV),$(UV) venv --quiet --seed --allow-existing --python $(PYTHON),$(PYTHON) -m venv --upgrade-deps)
# A test starts hundreds of Python processes: each would compile the libraries anew.
unexport PYTHONDONTWRITEBYTECODE
INSTALL := $(if $(UV),$(UV) pip install --quiet --compile-bytecode --python $(BIN)/python,$(BIN)/python -m pip install --quiet) --constraint constraints.txt
DEV := --editable '.[research,tag]' --group dev
# park and dock install what they need, unless there is an environment for development.
USER_STAMP = $(if $(wildcard $(STAMP)),$(STAMP),$(VENV)/.$(1))
PIP_INSTALL := $(BIN)/python -m pip install --quiet --constraint constraints.txt

.PHONY: help
help: ## Print this list.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-16s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

.PHONY: park
park: $(call USER_STAMP,train) ## Train a circuit (our search; the paper's is train --search published) and park a simulated robot.
	$(BIN)/rover-ncp park --out runs/park --overwrite

.PHONY: dock
dock: $(call USER_STAMP,tag) ## Dock a simulated robot at a place, by a camera and tags.
	$(BIN)/rover-ncp park --dock --out runs/dock --overwrite

.PHONY: test
test: $(STAMP) ## The quick tests, which plain pytest runs too.
# The others compute and process tests wait: they run beside each other, those that wait with precedence.
	$(MAKE) --jobs 2 test-unit test-process

.PHONY: test-unit test-process
# By lines, with the name of the run: the progress of two runs in one terminal.
test-unit: $(STAMP)
	nice -n 10 $(BIN)/pytest tests/unit tests/computing --durations=25 --numprocesses 2 --dist worksteal \
		| sed --unbuffered 's/^/unit     /'

test-process: $(STAMP)
	$(BIN)/pytest tests/process --durations=25 --numprocesses 3 --dist worksteal | sed --unbuffered 's/^/process  /'

.PHONY: check lint types contracts
check: lint types contracts ## Lint, types and import contracts.

lint: $(STAMP) ## Rules and format of the code.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP) ## Strict types.
	$(BIN)/mypy

contracts: $(STAMP) ## Which package may import which.
	$(BIN)/lint-imports

# Beside a copy of the clone without the packages: only the wheel can be imported.
WHEEL := $(CURDIR)/build/wheel
.PHONY: test-wheel
test-wheel: $(STAMP) ## The main job and the tutorials, with the built wheel in an environment of its own.
	rm -rf $(WHEEL) && mkdir -p $(WHEEL)/clone
	$(BIN)/python -m build --wheel --outdir $(WHEEL) .
	git ls-files | grep --extended-regexp --invert-match '^((rover_ncp|bridge|deploy|sim)/|tests/unit/test_architecture)' \
		| tar --create --files-from - | tar --extract --directory $(WHEEL)/clone
	$(MAKE) VENV=$(WHEEL)/env install-wheel
	cd $(WHEEL) && env/bin/rover-ncp park --out park
	$(MAKE) --directory $(WHEEL)/clone VENV=$(WHEEL)/env tutorials

.PHONY: install-wheel
install-wheel: $(VENV)/.made
	$(INSTALL) "$$(echo $(WHEEL)/*.whl)[research,tag]" --group dev
	touch $(STAMP)

.PHONY: test-long
test-long: $(STAMP) ## The long tests that measure no times: they mostly wait.
	$(BIN)/pytest tests/unit tests/computing tests/process tests/system -m "long and not browser and not timed" \
		--ignore=tests/system/test_tutorials.py --numprocesses 3 --dist worksteal

# In an environment of its own: 77 says that it cannot be made on this machine.
.PHONY: test-ros
test-ros: $(STAMP) ## Bridge and driver with ROS 2 (rclpy from PyPI); skipped where its wheels cannot be had.
	@$(BIN)/python tests/ros/install.py build/venv-ros; code=$$?; test $$code = 77 && exit 0; test $$code = 0 && \
		$(BIN)/pytest tests/ros -m long --durations=10 --numprocesses 3

.PHONY: test-timed
test-timed: $(STAMP) ## Every row of both safety matrices and live drives.
	$(BIN)/pytest tests/system -m "timed and long" --numprocesses 2 --dist loadgroup

.PHONY: test-browser
test-browser: chromium $(BROWSER_STAMP) $(DEMO_STAMP) ## Pages in chromium; pictures in runs/browser.
	$(BIN)/pytest tests -m browser

.PHONY: pictures
pictures: chromium $(BROWSER_STAMP) ## The moving picture of the README, from the page of a drive.
	$(BIN)/rover-ncp park --policy course --out runs/pictures --overwrite
	PYTHONPATH=tests $(BIN)/python tests/tools/pictures.py runs/pictures/run.html docs/drive.webp

.PHONY: chromium
chromium:
	@command -v chromium >/dev/null || { echo "chromium is missing: apt-get install chromium fonts-dejavu-core" >&2; exit 1; }

.PHONY: tutorials
tutorials: $(STAMP) ## Every command of the tutorials.
	$(BIN)/pytest tests/system/test_tutorials.py -m "not browser" --numprocesses 3 --dist worksteal

.PHONY: demo
demo: $(DEMO_STAMP) ## The demo, one page on which a circuit parks a rover: build/demo.html.
	$(BIN)/python docs/demo/build.py build/demo.html
	@echo "The demo: open $(CURDIR)/build/demo.html in a browser."

.PHONY: docs
docs: $(DOCS_STAMP) ## The documentation as a site in build/site; a broken link is an error.
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "The site: open $(CURDIR)/build/site/index.html in a browser."

.PHONY: reference
reference: $(STAMP) ## Write the reference, which is made from the code, as Markdown in build/reference.
	$(BIN)/python docs/reference_pages.py

.PHONY: safety
safety: $(STAMP) ## Measure the safety matrix and write it into docs/measured.
	PYTHONPATH=tests $(BIN)/python tests/tools/safety_table.py

.PHONY: paper
paper: $(STAMP) ## Which claims of the paper the stored runs confirm; replay some of the runs.
	$(BIN)/python -m paper report
	$(BIN)/python -m paper replay --agent circuit --seed 0 --budget published

.PHONY: paper-quick
paper-quick: $(STAMP) ## A short run of every task of the paper, checked by a replay.
	$(BIN)/python -m paper run --budget quick --again --agent circuit --agent mlp --seed 0 --results runs/paper-quick
	$(BIN)/python -m paper replay --budget quick --agent circuit --agent mlp --seed 0 --results runs/paper-quick

.PHONY: paper-docs
paper-docs: $(STAMP) ## Write the tables of the stored runs into docs/paper.md.
	$(BIN)/python tests/tools/paper_tables.py

.PHONY: paper-gradients
paper-gradients: $(GRADIENTS_STAMP) ## PPO and A2C: installs stable-baselines3, which needs torch.
	$(BIN)/python docs/examples/ppo_parking.py
	$(BIN)/python -m paper run --budget gradients

# All platforms and Pythons in one file; no address, so that any index can serve it. gradients has no lock: torch comes from
# an index of its choice.
LOCK := uv pip compile --quiet --universal --python-version 3.11 --constraint constraints.txt --generate-hashes \
	--no-header --no-annotate pyproject.toml
.PHONY: lock
lock: ## Write requirements/: the versions of constraints.txt with hashes, for each extra. Needs uv.
	$(LOCK) --output-file requirements/base.txt
	for extra in drive train tag research; do \
		$(LOCK) --extra $$extra --output-file requirements/$$extra.txt || exit 1; \
	done

.PHONY: files
files: $(FILES_STAMP) ## Workflows, compose file, Dockerfile, CITATION.cff, declared dependencies and locks by their linters.
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-forms .github/ISSUE_TEMPLATE/[!c]*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.dependabot .github/dependabot.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.compose-spec packaging/compose.yaml
	$(BIN)/check-jsonschema --builtin-schema vendor.citation-file-format CITATION.cff
	$(BIN)/deptry .
	PATH="$(CURDIR)/$(BIN):$$PATH" $(MAKE) lock
	git diff --exit-code --stat requirements
	$(BIN)/zizmor --offline --quiet .github
	$(BIN)/hadolint packaging/Dockerfile

# The platforms that PyPI takes; the others compile the sdist. hatch_build.py has their names in zig.
TARGETS := manylinux_2_17_x86_64 manylinux_2_28_aarch64 manylinux_2_28_armv7l macosx_11_0_arm64 macosx_11_0_x86_64
.PHONY: dist
dist: $(RELEASE_STAMP) ## Checked wheels and the sdist in dist, and the bill of materials of each lock in build/sbom.
	rm -rf dist build/sbom && mkdir -p build/sbom
	$(BIN)/python -m build --sdist --no-isolation
	for target in $(TARGETS); do \
		ROVER_NCP_TARGET=$$target $(BIN)/python -m build --wheel --no-isolation || exit 1; \
	done
	$(BIN)/python tests/tools/check_wheels.py
	for lock in requirements/*.txt; do \
		$(BIN)/cyclonedx-py requirements --output-reproducible --pyproject pyproject.toml --mc-type application \
			--output-file build/sbom/$$(basename $$lock .txt).cdx.json $$lock || exit 1; \
	done

.PHONY: sanitize
sanitize: $(STAMP) ## The native library's tests under AddressSanitizer and UndefinedBehaviorSanitizer. Needs g++.
	$(BIN)/python hatch_build.py --sanitized build/sanitized
	LD_PRELOAD="$$(c++ -print-file-name=libasan.so) $$(c++ -print-file-name=libubsan.so)" \
		ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 NATIVE=build/sanitized \
		$(BIN)/pytest -q tests/unit/test_native.py tests/unit/circuit/test_solver.py tests/unit/learn/test_evaluator.py \
		tests/unit/search/test_gauss_newton.py

.PHONY: test-pure
test-pure: $(STAMP) ## Circuits and drives without the native library: the same bits.
	NATIVE=none $(BIN)/pytest -q tests/unit/circuit/test_golden.py tests/unit/deploy tests/unit/place tests/unit/test_hazards.py

.PHONY: coverage-gate
coverage-gate: $(STAMP) ## The gate's own tests must run every line and branch of it.
	$(BIN)/coverage run --branch --include='bridge/gate/*.py' --data-file=.coverage-gate \
		-m pytest -q -m "not browser" tests/unit/bridge/test_gate*.py
	$(BIN)/coverage report --data-file=.coverage-gate --show-missing --fail-under=100

.PHONY: mutate
mutate: $(STAMP) ## Tests must fail on every mutant of the modules that keep the rover safe, except those of tests/data/survivors.yaml.
	$(BIN)/python tests/tools/mutate.py

.PHONY: fuzz
fuzz: $(FUZZ_STAMP) ## Fuzz the readers of external data for FUZZ_S seconds, guided by branch coverage.
	$(BIN)/python tests/tools/fuzz_atheris.py

.PHONY: test-installs
test-installs: ## The quick unit tests on each Python from 3.11 to 3.13 that is present.
	for version in 3.11 3.12 3.13; do \
		if python$$version -c '' 2>/dev/null; then \
			$(MAKE) VENV=build/venv-$$version PYTHON=python$$version test-unit || exit 1; \
		else \
			echo "python$$version is not here: not tested"; \
		fi; \
	done

.PHONY: nightly nightly-waits nightly-cpu
nightly: $(FUZZ_STAMP) ## All that takes an hour or more: matrices, all examples of Hypothesis, mutants, fuzzing, installs.
	$(MAKE) test-timed
	$(MAKE) --jobs 2 --output-sync=line nightly-waits nightly-cpu

# Timed tests run beside no others. Then what waits for processes has precedence over what only computes. All is
# installed before.
nightly-waits:
	$(BIN)/pytest tests/process tests/system -m "not browser and not timed" --hypothesis-profile=full \
		--numprocesses 3 --dist worksteal
	nice -n 19 $(MAKE) test-installs

nightly-cpu:
	nice -n 19 $(BIN)/pytest tests/unit tests/computing -m "not browser" --hypothesis-profile=full
	nice -n 19 $(MAKE) test-pure
	nice -n 19 $(MAKE) mutate
	nice -n 19 $(MAKE) fuzz

SOURCES := pyproject.toml constraints.txt hatch_build.py $(wildcard rover_ncp/native/*.cpp rover_ncp/native/*.h)

$(VENV)/.made:
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v <= (3, 13) else "rover-ncp needs Python 3.11 to 3.13, found %d.%d; run make PYTHON=..." % v)'
	$(MAKE_VENV) $(VENV)
	touch $@

$(STAMP): $(SOURCES) | $(VENV)/.made
	$(INSTALL) $(DEV)
	touch $@

$(VENV)/.train: $(SOURCES) | $(VENV)/.made
	$(INSTALL) --editable '.[train]'
	touch $@

$(VENV)/.tag: $(SOURCES) | $(VENV)/.made
	$(INSTALL) --editable '.[train,tag]'
	touch $@

$(BROWSER_STAMP): $(STAMP)
	$(INSTALL) $(DEV) --group browser
	touch $@

$(DEMO_STAMP): $(STAMP)
	$(INSTALL) $(DEV) --group demo
	touch $@

$(DOCS_STAMP): $(STAMP)
	$(INSTALL) $(DEV) --group docs
	touch $@

$(FUZZ_STAMP): $(STAMP)
	$(INSTALL) $(DEV) --group fuzz
	touch $@

$(FILES_STAMP): $(STAMP)
	$(INSTALL) $(DEV) --group files
	touch $@

$(RELEASE_STAMP): $(STAMP)
	$(INSTALL) $(DEV) --group release
	touch $@

# By pip: the environment may limit what pip takes of torch, which uv does not read.
$(GRADIENTS_STAMP): $(STAMP)
	$(PIP_INSTALL) --editable '.[research]' --group gradients
	touch $@

.PHONY: clean
clean: ## Remove the environment, caches and runs.
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis runs
