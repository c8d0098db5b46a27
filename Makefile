# `make demo` and `make test` each do all of their own set-up in .venv; the second time they skip it.
# PYTHON makes .venv, so a change of it takes `make distclean` first.
PYTHON ?= python3
WORKERS ?= 2

override VENV := .venv
override BIN := $(VENV)/bin
override STAMP := $(VENV)/.installed
# One thread a worker: two workers with a thread pool each would fight over two cores.
PYTEST = OMP_NUM_THREADS=1 $(BIN)/python -P -m pytest -n $(WORKERS) --dist loadfile

# A `.venv` that was copied or moved with its checkout still runs the code of the old place.
ifneq ($(shell cat $(STAMP) 2>/dev/null),$(CURDIR))
.PHONY: $(STAMP)
endif

.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help install demo test test-slow pytest lint types format hooks build clean distclean

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

$(STAMP): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { \
	  echo "There is no $(PYTHON) here. Install Python 3.11 or newer, or name it: make PYTHON=/path/to/python" >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "swarmssm needs Python 3.11 or newer, and $(PYTHON) is $$($(PYTHON) --version 2>&1). Name a newer one: make PYTHON=python3.11" >&2; \
	  exit 1; }
	@test "$$(cat $(VENV)/.place 2>/dev/null)" = "$(CURDIR)" || rm -rf $(VENV)
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { \
	  rm -rf $(VENV); \
	  echo "$(PYTHON) could not make a virtual environment. On Debian and Ubuntu: apt install python3-venv" >&2; \
	  exit 1; }
	@printf '%s\n' "$(CURDIR)" > $(VENV)/.place
	@echo "Installing swarmssm and what it needs into $(VENV) (minutes the first time, then never again)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	@printf '%s\n' "$(CURDIR)" > $@

install: $(STAMP)  ## Set up .venv with everything below

demo: $(STAMP)  ## Fit and report on the bundled data; the report lies in demo/
	$(BIN)/swarmssm demo --out demo --overwrite

test: lint types pytest  ## Lint, types and the tests

pytest: $(STAMP)  ## The tests alone
	$(PYTEST)

test-slow: lint types  ## As `test`, with the tests that take longer than about 20 s
	$(PYTEST) -m ''

lint: $(STAMP)  ## ruff: rules and format
	$(BIN)/python -m ruff check
	$(BIN)/python -m ruff format --check

types: $(STAMP)  ## mypy, strict, over the package
	$(BIN)/python -m mypy

format: $(STAMP)  ## Mend what ruff can mend by itself
	$(BIN)/python -m ruff check --fix
	$(BIN)/python -m ruff format

hooks: $(STAMP)  ## Run the checks of .pre-commit-config.yaml before each commit
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	$(BIN)/python -m pre_commit install

build: $(STAMP)  ## Wheel and source archive, in dist/
	rm -rf build dist
	$(BIN)/python -m build

clean:  ## Remove caches and built files, but neither .venv nor demo/
	rm -rf build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find swarmssm tests benchmarks docs -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean  ## Remove .venv and demo/ too
	rm -rf $(VENV) demo
