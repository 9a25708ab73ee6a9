# Two commands for a newcomer: make quickstart, make test. Both need only Python >= 3.11 and make.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
STAMP = $(VENV)/.installed
# The tests start many processes: without compiled modules each of them compiles boresight, and pytest all tests, again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: quickstart test test-data test-long lint docs clean

quickstart: $(STAMP)
	$(BIN)/boresight run quickstart

test: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile

# The tests alone that are skipped without mission data (BORESIGHT_DATA).
test-data: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "data and not long"

test-long: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m ""

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tests/link_tree.py . build/tree
	$(BIN)/mypy
	PYTHONPATH=build/tree $(BIN)/lint-imports

# The site, build/docs/index.html; a warning is an error.
docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going --quiet -b html docs build/docs

$(VENV)/.docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[docs]"
	touch $@

$(STAMP): pyproject.toml setup.py constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev,llvm]"
	touch $(STAMP)

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
