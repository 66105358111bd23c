# Everything a newcomer needs: Python 3.11+ and make.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# The tests start many processes, which share the bytecode: Python must write it, even if the machine's settings forbid it.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install map test slow style kernels tests bench validate mutants docs clean

install: $(STAMP)

map: $(STAMP)
	$(BIN)/fieldmap map maps/workspace.toml -o maps/out/workspace.h5 --resume --summary

# Two jobs at a time: style and kernels, and the tests, which use two processes. All tests of a file run in one process,
# so that their shared fixtures are made once. `make slow` and `make validate` run the tests that tests/slow.txt names.
test: $(STAMP)
	$(MAKE) --no-print-directory --jobs=2 kernels tests

slow: $(STAMP)
	$(BIN)/pytest -q -n 2 --dist loadfile -m slow tests

# zuban checks types by mypy's rules. `make validate` runs mypy itself, which takes ten times as long.
style: $(STAMP)
	$(BIN)/ruff check fieldmap tests scripts
	$(BIN)/lint-imports
	$(BIN)/zuban mypy --python-executable $(BIN)/python

# Kernels run as plain Python, without numba: an index out of range then raises an error.
kernels: style
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest -q -m "not slow" tests/kernels

# The first run leaves out pytest's rewriting of assertions and its capture of logs, to save time. Tests that fail run a
# second time with both, for a readable report.
tests: $(STAMP)
	$(BIN)/pytest -q -n 2 --dist loadfile --no-loadscope-reorder --doctest-modules -m "not slow" \
	    --assert=plain -p no:logging fieldmap tests \
	    || { $(BIN)/pytest -q --doctest-modules --last-failed --last-failed-no-failures none fieldmap tests; exit 1; }

bench: $(VENV)/.installed-bench
	$(BIN)/python scripts/benchmark.py

validate: slow
	$(BIN)/mypy
	FIELDMAP_OTHER_PROGRAMS=1 $(BIN)/pytest -q tests/interop
	$(BIN)/python scripts/validate.py

mutants: $(VENV)/.installed-mutants
	$(BIN)/python scripts/dev/mutants.py --planted
	$(BIN)/python scripts/dev/mutants.py control currents dynamics interpolants iron levitation lookup sources

# Both targets work in temporary environments (FOLDER=... keeps the files of release-check).
oldest:
	$(PYTHON) scripts/dev/oldest.py

release-check:
	$(PYTHON) scripts/dev/release_check.py $(if $(FOLDER),--folder $(FOLDER))

docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Installation compiles the core, so a changed C file starts it again.
$(STAMP): pyproject.toml constraints.txt $(wildcard fieldmap/core/*.h fieldmap/core/*.c)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test]"
	touch $@

$(VENV)/.installed-docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[docs]"
	touch $@

$(VENV)/.installed-bench: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[bench]"
	touch $@

$(VENV)/.installed-mutants: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[mutants]"
	touch $@

clean:
	rm -rf $(VENV) maps/out build dist site
