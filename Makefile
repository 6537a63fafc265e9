# Two commands: `make run` (set up, drive the default mission, leave a recording) and `make test`.
# Neither calls sudo. Both are spelled out as plain pip commands in README.md.
PYTHON ?= python3.11
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: run test setup assets check verify clean

run: $(VENV)/.installed assets
	$(BIN)/dssmsg run

test: $(VENV)/.installed-dev assets
	$(BIN)/python -m pytest -n 2 --dist worksteal

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy dssmsg plugins

verify: $(VENV)/.installed-dev assets
	$(BIN)/python benchmarks/verify.py --write docs/figures.md

setup: $(VENV)/.installed

assets: $(VENV)/.installed
	@sh tools/get_assets.sh $(BIN)/python

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { echo "error: $(PYTHON) not found; install Python 3.11 with venv (Debian: apt-get install python3.11-venv) or: make run PYTHON=..."; exit 2; }
	$(PYTHON) -m venv $(VENV) || { echo "error: no venv; on Debian: apt-get install python3.11-venv"; exit 2; }

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[dev]"
	@touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache
