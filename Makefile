# Each target makes the environment that it needs; `make clean` removes it again.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEV := [dev,detect,cluster,notebooks]
# Else every process of the tests compiles the package and the tests anew.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help demo test test-heavy test-slow docs-check first-command test-matrix fuzz kills soak lint types bench figures notebooks docs dist clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

demo: $(VENV)/.core  ## render a tour, track it and compare with the truth (a minute)
	$(BIN)/remind demo

test: $(VENV)/.dev  ## all tests but the heavy and the slow ones
	$(BIN)/python -m pytest -m "not heavy and not slow and not prose" -n 2 --dist loadfile

test-heavy: $(VENV)/.dev  ## those that compile much, wait, or need a browser or processes
	$(BIN)/python -m pytest -m "heavy and not slow" -n 2 --dist loadfile

test-slow: $(VENV)/.dev  ## the slow tests, properties with ten times as many examples
	HYPOTHESIS_PROFILE=thorough $(BIN)/python -m pytest -m "slow or hypothesis"

docs-check: $(VENV)/.dev  ## pages: their links, what they name, what code cites of them
	$(BIN)/python -m pytest -q -m prose tests/test_architecture.py tests/test_citations.py tests/test_docs.py

first-command: $(BIN)/uv  ## the demo with oldest and newest versions, on the oldest and the newest Python
	UV=$(CURDIR)/$(BIN)/uv tests/first_command.sh

test-matrix: $(VENV)/.dev $(BIN)/uv  ## a share of the tests with oldest and newest versions, on every Python there is
	UV=$(BIN)/uv tests/matrix.sh

fuzz: $(VENV)/.dev  ## changed files of every format, for an hour (make fuzz SECONDS=300)
	$(BIN)/python -m tests.corpus.fuzz --seconds $(or $(SECONDS),3600)

kills: $(VENV)/.dev  ## kill commands at random moments and have them go on (make kills KILLS=30)
	$(BIN)/python -m tests.corpus.kills --kills $(or $(KILLS),100)

soak: $(VENV)/.dev  ## a live loop of 10,000 frames (make soak FRAMES=2000 CONFIG=remind)
	$(BIN)/python -m tests.corpus.soak --frames $(or $(FRAMES),10000) --config $(or $(CONFIG),default)

lint: $(VENV)/.dev  ## style, and which room imports which
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache

types: $(VENV)/.dev  ## types of what is shipped, of tests and of benchmarks
	$(BIN)/pyright --threads 2 --pythonpath $(BIN)/python

bench: $(VENV)/.dev  ## what is claimed about speed
	$(BIN)/python benchmarks/step.py
	$(BIN)/python benchmarks/metrics.py

figures: $(VENV)/.core  ## the figures that pages lead with (three minutes; CLIPS=FOLDER: real clips too)
	$(BIN)/python benchmarks/headline.py $(if $(CLIPS),--clips $(CLIPS))

notebooks: $(VENV)/.dev  ## execute the notebooks and write their pages anew
	$(BIN)/python notebooks/execute.py

dist: $(VENV)/.dev  ## wheel and source archive, checked as the package index does
	rm -rf dist
	$(BIN)/python -m build --no-isolation
	$(BIN)/python -m twine check --strict dist/*

docs: $(VENV)/.docs  ## the documentation as a site, in build/docs
	$(BIN)/python docs/settings_page.py docs/thresholds.md docs/method_plus.md
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet --config-file docs/site/mkdocs.yml
	@echo "open build/docs/index.html"

clean:  ## remove the environment and everything that was made
	rm -rf $(VENV) build dist remind_demo .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' || \
		{ echo "remind-jax needs Python 3.11 to 3.14; name one: make PYTHON=python3.12 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(BIN)/uv: | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv

# uv takes a tenth of the time; pip is asked where uv finds no index.
define install
	$(BIN)/uv pip install --quiet --python $(BIN)/python -e "$(1)" || \
		$(BIN)/python -m pip install --quiet --disable-pip-version-check -e "$(1)"
endef

$(VENV)/.core: pyproject.toml | $(BIN)/uv
	@echo "installing remind-jax and what it needs into $(VENV), once; it usually takes half a minute"
	$(call install,.)
	@touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/uv
	@echo "installing remind-jax with all that tests need into $(VENV), once; it usually takes a minute"
	$(call install,.$(DEV))
	@touch $@ $(VENV)/.core

$(VENV)/.docs: pyproject.toml | $(BIN)/uv
	$(call install,.[docs])
	@touch $@ $(VENV)/.core
