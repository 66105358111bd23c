# Everything a newcomer needs: Python 3.11+ and make.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Bytecode is kept, also on machines that are set up to keep none: the tests start many processes.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install map test slow style kernels tests bench validate mutants docs clean

install: $(STAMP)

map: $(STAMP)
	$(BIN)/fieldmap map maps/workspace.toml -o maps/out/workspace.h5 --resume --summary

# Style and kernels as Python run beside the tests, which have two processes, for two processors. A file's tests stay in
# one process, which makes their shared fixtures once. `make validate` runs the tests that tests/slow.txt names.
test: $(STAMP)
	$(MAKE) --no-print-directory --jobs=2 kernels tests

slow: $(STAMP)
	$(BIN)/pytest -q -n 2 --dist loadfile -m slow tests

# Types by mypy's rules; mypy itself, ten times as slow, is run by `make validate`.
style: $(STAMP)
	$(BIN)/ruff check fieldmap tests scripts
	$(BIN)/lint-imports
	$(BIN)/zuban mypy --python-executable $(BIN)/python

# As Python, an index out of range is an error.
kernels: style
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest -q -m "not slow" tests/kernels

# Without the values in failed assertions, for which each process would rewrite all tests, and without catching what is
# logged; what fails runs once more, with both.
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

# Both in environments of their own, which are deleted again (FOLDER=... keeps the second's files).
oldest:
	$(PYTHON) scripts/dev/oldest.py

release-check:
	$(PYTHON) scripts/dev/release_check.py $(if $(FOLDER),--folder $(FOLDER))

docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# What is compiled is compiled anew.
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
