# Every target sets up what it needs in .venv; only Python 3.11 and make have to be installed. `make help` lists the targets.
PYTHON ?= $(shell command -v python3.11 || echo python3)
VENV := .venv
BIN := $(VENV)/bin

# How many pytest processes run at once: tests in virtual time keep a core busy each, tests in real time mostly wait.
WORKERS ?= 2
REALTIME_WORKERS ?= 3

# Whether `make test` runs a 20th of the tests marked `catalogue` and a sixth of the files marked `rotating`, or all.
KINDS ?= some

# How long `make fuzz` draws new examples.
MINUTES ?= 10

# What `make test-changed` compares with.
BASE ?= HEAD

# What `make try-dist` installs: the wheel, or the sdist with TRIED=sdist.
TRIED ?= wheel

# Python keeps its bytecode, wherever that is switched off: hundreds of processes of the tests import the same modules.
export PYTHONDONTWRITEBYTECODE :=

# The tools that make a release have an environment of their own.
RELEASE := .venv-release
MATERIALS := build/materials

PYTEST := $(BIN)/python -m pytest -rsfE
TIMES := .pytest_cache/processor-times
FAST := not slow and not realtime and not external

# What `make reproduce` makes.
WHAT ?=

.PHONY: help demo test test-all test-fast test-virtual test-realtime fuzz check check-quick audit setup engines kernels contexts faults reproduce test-changed docs changes dist check-dist try-dist sbom clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(VENV)/.installed ## fly an attack beside its twin, and print where the report is
	$(BIN)/skyrange install kernels
	$(BIN)/skyrange pair rid-spoofing

test: $(VENV)/.tested ## the checks, and all tests but those that are slow, in real time or of other programs
	@$(BIN)/python -m tools.budget --minutes 16 kernels check test-fast

test-all: $(VENV)/.tested engines ## the checks, and all tests
	@$(BIN)/python -m tools.budget --minutes 60 --keep-going kernels check test-virtual test-realtime

kernels: $(VENV)/.installed ## compile what is missing of the compiled functions, on all cores, so that no flight waits for it
	$(BIN)/skyrange install kernels

test-fast: kernels $(VENV)/.tested ## the tests of `make test`, without the checks
	$(PYTEST) -n $(WORKERS) -m '$(FAST)' --kinds $(KINDS) --hypothesis-profile quick \
		--limit-processor-time --processor-times=$(TIMES)/fast.json

test-virtual: kernels $(VENV)/.tested ## the first half of `make test-all`: the tests that are not in real time
	$(PYTEST) -n $(WORKERS) -m 'not realtime' --processor-times=$(TIMES)/virtual.json

test-realtime: kernels $(VENV)/.tested ## the second half of `make test-all`: the tests in real time
	$(PYTEST) -n $(REALTIME_WORKERS) -m realtime --processor-times=$(TIMES)/realtime.json

fuzz: $(VENV)/.tested ## draw new examples for the property tests, for MINUTES
	$(PYTEST) -p tests.fuzzing --fuzz-minutes $(MINUTES) --hypothesis-profile fuzz -m '$(FAST)' \
		$$(grep -rlE '^(from|import) hypothesis' tests --include='test_*.py')

check: check-quick ## `make check-quick`, the viewer's modules, unused names, and known vulnerabilities
	$(BIN)/python -m tools.viewer_modules
	$(BIN)/python -m tools.unused_names
	@$(MAKE) --no-print-directory audit

check-quick: $(VENV)/.tested ## ruff, mypy, and the rules of tracked files and of imports
	$(BIN)/ruff check .
	$(BIN)/ruff check --preview --select PLR0917 src tools
	$(BIN)/ruff format --check .
	$(BIN)/python -m tools.tracked_files
	$(BIN)/mypy
	$(BIN)/lint-imports

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

$(VENV)/.installed: pyproject.toml src/skyrange/__init__.py | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[view,live]'
	@touch $@

$(VENV)/.tested: pyproject.toml src/skyrange/__init__.py requirements-dev.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@ $(VENV)/.installed

$(VENV)/.documented: pyproject.toml requirements-image.txt requirements-docs.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-image.txt -r requirements-docs.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

$(VENV)/.engines: requirements-engines.txt $(wildcard engines/*/*) | $(VENV)/.tested
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r requirements-engines.txt \
		|| echo "ns-3 cannot be installed from the package index"
	@if $(BIN)/skyrange install ns3; then touch $@; else echo "without ns-3: its tests are skipped"; fi

contexts: $(VENV)/.tested ## record which lines each fast test executes, for `make faults` and `make test-changed`
	$(BIN)/python -m tools.record_contexts --workers $(WORKERS) $(if $(COSTS),--costs $(COSTS))

faults: $(VENV)/.tested ## plant faults in copies of the code, and print which of them the fast tests find
	$(BIN)/python -m tools.plant_faults --jobs $(WORKERS) $(FAULTS)

reproduce: $(VENV)/.tested ## make WHAT, a figure or a measured table of the documentation, anew; without WHAT, list them
	@$(BIN)/python -m tools.docs.reproduce $(WHAT)

test-changed: $(VENV)/.tested ## the fast tests that executed what differs from BASE
	$(BIN)/python -m tools.test_changed $(BASE) --workers $(WORKERS)

docs: $(VENV)/.documented ## fly two pairs, and build the documentation site in build/site
	$(BIN)/skyrange install kernels
	$(BIN)/python -m tools.docs.build_site

changes: $(VENV)/.tested ## print the next entry of CHANGELOG.md, from the fragments in changes/
	$(BIN)/towncrier build --draft --version Unreleased

dist: $(RELEASE)/.installed ## build the sdist, and from it the wheel, in dist/
	rm -rf dist
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(RELEASE)/bin/python -m build --no-isolation

check-dist: dist ## check what the archives in dist/ contain, and their page on the package index; with TAG, their version
	$(RELEASE)/bin/twine check --strict dist/*
	$(RELEASE)/bin/python -m tools.check_distributions $(if $(TAG),--tag $(TAG))

try-dist: dist ## install the wheel in an empty environment of PYTHON, and fly the demo; with TRIED=sdist, the sdist
	$(PYTHON) -m tools.try_distribution dist/*$(if $(filter sdist,$(TRIED)),.tar.gz,.whl)

sbom: dist ## list what an installation has, in build/materials/: a CycloneDX bill of materials, and the licences
	rm -rf $(MATERIALS)
	$(RELEASE)/bin/python -m venv $(MATERIALS)/environment
	$(MATERIALS)/environment/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-image.txt
	$(MATERIALS)/environment/bin/python -m pip install --quiet --disable-pip-version-check --no-deps dist/*.whl
	$(MATERIALS)/environment/bin/python -m pip uninstall --quiet --yes pip setuptools
	$(RELEASE)/bin/cyclonedx-py environment --output-reproducible --validate --output-file $(MATERIALS)/skyrange.cdx.json \
		$(MATERIALS)/environment
	$(RELEASE)/bin/pip-licenses --python $(MATERIALS)/environment/bin/python --with-system --from=mixed --with-urls \
		--format=markdown --output-file=$(MATERIALS)/licences.md

$(RELEASE)/.installed: requirements-release.txt | $(VENV)/bin/python
	$(PYTHON) -m venv $(RELEASE)
	$(RELEASE)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-release.txt
	@touch $@

clean: ## remove the environments, all caches, and what was built
	rm -rf $(VENV) $(RELEASE) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .contexts
