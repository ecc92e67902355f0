# The environment is made by `make` itself, in .venv, and made again when pyproject.toml changes.

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
BENCHES = control record dashboard paper scenarios applications calls small cost loopback urgent big wan start readers foxglove services hops clients overlay nodes anycast scale zenoh mqtt links
# The tests of a file run in one process, one after the other; files run beside each other, the longest ones first
# (tests/conftest.py, which also says how many files at a time).
PARALLEL = -n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder
# Python 3.12 and later watch lines at next to no cost.
COVERAGE = $(shell $(BIN)/python -c 'import sys; print("COVERAGE_CORE=sysmon" * (sys.version_info >= (3, 12)))' 2>/dev/null)
export PYTHON

.PHONY: help demo demo-anycast demo-iort demo-robots test test-all test-arm64 test-dds cov lint bench deb fuzz dist clean

help: ## show this
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "make %-12s %s\n", $$1, $$2}'

demo: $(VENV)/$(if $(findstring --web,$(DEMO)),demo,runtime).stamp ## two networks, two gateways, a camera each way; DEMO="--for 60 --bag FILE", or --web for a browser
	@$(BIN)/ropeway demo $(DEMO)

demo-iort: $(VENV)/demo.stamp ## one command to a ROS 2, a ROS 1 and another robot; DEMO="--keyboard" for yourself
	@$(BIN)/ropeway demo-iort $(DEMO)

demo-anycast: $(VENV)/demo.stamp ## one of two edges and a cloud; a link is made slow; DEMO="--for 30 -o FILE"
	@$(BIN)/ropeway demo-anycast $(DEMO)

demo-robots: $(VENV)/demo.stamp ## five robots that are alike in one picture; DEMO="--for 20 -o FILE"
	@$(BIN)/ropeway demo-robots $(DEMO)

test: $(VENV)/dev.stamp ## all tests but the slow ones; TEST="-k outbox" for some
	@$(BIN)/python -m pytest -q $(PARALLEL) -m "not slow" $(TEST)

test-all: $(VENV)/dev.stamp ## all tests, with a short run of the fuzzer and of everything that must not grow
	@$(BIN)/python -m pytest -q $(PARALLEL) $(TEST)

test-dds: $(VENV)/dev.stamp ## the tests of DDS against the C library of Debian (apt install cyclonedds-tools), not the wheel's
	@ROPEWAY_DDS_LIBRARY=$(or $(DDS_LIBRARY),$(lastword $(sort $(wildcard /usr/lib/*/libddsc.so.*.*.*)))) \
		$(BIN)/python -m pytest -q $(PARALLEL) -m "not slow" tests/networks/dds $(TEST)

test-arm64: $(VENV)/dev.stamp ## the wheel in an emulated Debian for ARM, as root, in hours; ARM64="tests/store" for some
	@.ci/arm64 $(ARM64)

cov: $(VENV)/dev.stamp ## all tests but the slow ones, with the lines that they reach, and a floor for every module
	@$(COVERAGE) $(BIN)/python -m pytest -q $(PARALLEL) -m "not slow" --cov --cov-report=json --cov-report=term:skip-covered $(TEST)
	@$(BIN)/python -m tests.floors

lint: $(VENV)/dev.stamp ## style, spelling, types, the direction of imports, and no circles of them
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/codespell
	@$(BIN)/mypy
	@$(BIN)/mypy examples
	@$(BIN)/lint-imports
	@$(BIN)/python -m tests.circles

bench: $(VENV)/dev.stamp ## the figures of the README; BENCH="loopback" for one
	@for name in $(or $(BENCH),$(BENCHES)); do $(BIN)/python -m bench.$$name || exit 1; done

deb: $(VENV)/dev.stamp ## packages for Debian 12, amd64 and arm64, in dist/
	@$(BIN)/python deploy/debian/build.py amd64 arm64

fuzz: $(VENV)/dev.stamp ## look for inputs that break parsers; FUZZ="cdr xml-rpc --seconds 3600" for some, longer
	@$(BIN)/python -m fuzz $(FUZZ)

dist: $(VENV)/dev.stamp ## the wheel, the source archive, and what an installation of the wheel consists of (CycloneDX)
	@rm -rf dist build/sbom && $(BIN)/python -m build --no-isolation --outdir dist . >/dev/null
	@$(BIN)/python -m venv --without-pip build/sbom
	@$(PIP) --python build/sbom install --quiet dist/*.whl
	@$(BIN)/cyclonedx-py environment build/sbom/bin/python --pyproject pyproject.toml --output-reproducible \
		--output-file $$(ls dist/*.whl | sed 's/-py3.*//').cdx.json
	@ls -l dist

clean: ## remove the environment and all caches
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache dist build
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@echo "Making $(VENV)"
	@.ci/venv $(VENV)

$(VENV)/runtime.stamp: pyproject.toml | $(BIN)/python
	@echo "Installing Ropeway into $(VENV); the first time, its dependencies are downloaded, which may take a minute"
	@.ci/pip $(VENV) --editable .
	@touch $@

$(VENV)/demo.stamp: $(VENV)/runtime.stamp
	@echo "Installing its extras"
	@.ci/pip $(VENV) --editable ".[all]"
	@touch $@

$(VENV)/dev.stamp: pyproject.toml | $(BIN)/python
	@echo "Installing Ropeway and its tools into $(VENV)"
	@.ci/pip $(VENV) --upgrade "pip>=25.1"  # the first that knows dependency groups
	@.ci/pip $(VENV) --editable ".[all]" --group dev
	@touch $@ $(VENV)/runtime.stamp
