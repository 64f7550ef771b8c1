# Every target sets up what it needs in .venv; only Python 3.11 and make have to be installed. `make help` lists the targets.
PYTHON ?= $(shell command -v python3.11 || echo python3)
VENV := .venv
BIN := $(VENV)/bin

# How many pytest processes run at once: tests in virtual time keep a core busy each, tests in real time mostly wait.
WORKERS ?= 2
REALTIME_WORKERS ?= 3

# Compiles what is missing, on all cores, so that no flight or test has to wait for it.
KERNELS := $(BIN)/skyrange install kernels
PYTEST := $(BIN)/python -m pytest -rsfE
FAST := not slow and not realtime and not external

.PHONY: help demo test test-all test-fast test-virtual test-realtime check audit setup engines clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(VENV)/.installed ## fly an attack beside its twin, and print where the report is
	$(KERNELS)
	$(BIN)/skyrange pair rid-spoofing

test: check test-fast ## the checks, and all tests but those that are slow, in real time or of other programs

test-all: check engines ## the checks, and all tests
	@failed=0; \
	$(MAKE) --no-print-directory test-virtual || failed=1; \
	$(MAKE) --no-print-directory test-realtime || failed=1; \
	exit $$failed

test-fast: $(VENV)/.tested ## the tests of `make test`, without the checks
	$(KERNELS)
	$(PYTEST) -n $(WORKERS) -m '$(FAST)' --hypothesis-profile quick

test-virtual: $(VENV)/.tested ## the first half of `make test-all`: the tests that are not in real time
	$(KERNELS)
	$(PYTEST) -n $(WORKERS) -m 'not realtime'

test-realtime: $(VENV)/.tested ## the second half of `make test-all`: the tests in real time
	$(KERNELS)
	$(PYTEST) -n $(REALTIME_WORKERS) -m realtime

check: $(VENV)/.tested ## ruff, mypy and the rules of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	@$(MAKE) --no-print-directory audit

audit: $(VENV)/.tested ## known vulnerabilities of the pinned dependencies; skipped where the index cannot be reached
	@found=$$($(BIN)/pip-audit -r requirements-dev.txt --disable-pip --require-hashes --progress-spinner off --timeout 10 2>&1); \
	if echo "$$found" | grep -q 'known vulnerabilit.* in'; then echo "$$found"; exit 1; fi; \
	if echo "$$found" | grep -q 'No known vulnerabilities found' && ! echo "$$found" | grep -q 'could not be audited: numpy'; \
	then echo "pip-audit: no known vulnerabilities"; \
	else echo "pip-audit: skipped, because its index of vulnerabilities cannot be reached from here"; fi

setup: $(VENV)/.tested ## install skyrange in .venv with what its tests need

engines: $(VENV)/.engines ## compile the radio engines that tests run; says so and goes on where that is not possible

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is not there; say make PYTHON=/path/to/python3.11" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
		&& apt-get update -qq && apt-get install -qqy python3-venv; } \
		|| { echo "Python's venv module is missing; on Debian: sudo apt-get install python3-venv" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/.tested: pyproject.toml requirements-dev.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@ $(VENV)/.installed

$(VENV)/.engines: requirements-engines.txt $(wildcard engines/*/*) | $(VENV)/.tested
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r requirements-engines.txt \
		|| echo "ns-3 cannot be installed from the package index"
	@if $(BIN)/skyrange install ns3; then touch $@; else echo "without ns-3: its tests are skipped"; fi

clean: ## remove .venv and all caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
