# All that a fresh machine needs is done by `make fit` and by `make test`; see scripts/setup.sh.
VENV ?= .venv
export VENV
# Arguments for the two commands that take some: make fit ARGS="cup.terms=8", make test ARGS="-k cli".
ARGS ?=

.PHONY: help fit test slow readers lint check setup
.DEFAULT_GOAL := help

help:
	@echo "make fit    set up what is missing, then fit the bundled scans   (ARGS=\"scans=FOLDER cup.terms=8\")"
	@echo "make test   set up what is missing, then run the tests           (ARGS=\"-k pattern\")"
	@echo "make slow   the tests that take longer as well"
	@echo "make readers  what some tests read files with (GDAL, poppler, librsvg, Chromium); without it they are skipped"
	@echo "make lint   ruff and pyright"
	@echo "make check  lint and test, as CI does"

setup:
	@scripts/setup.sh

fit: setup
	"$(VENV)/bin/brafit" $(ARGS)

# Two processes, one thread each: the tests' arrays are too small for more.
test:
	@scripts/setup.sh test
	OMP_NUM_THREADS=1 "$(VENV)/bin/python" -m pytest -n 2 $(ARGS)

slow:
	@scripts/setup.sh test
	OMP_NUM_THREADS=1 "$(VENV)/bin/python" -m pytest -n 2 -m "slow or not slow" $(ARGS)

readers:
	@scripts/setup.sh readers

lint:
	@scripts/setup.sh dev
	"$(VENV)/bin/python" -m ruff check .
	"$(VENV)/bin/python" -m pyright --pythonpath "$(VENV)/bin/python"

check: lint test
