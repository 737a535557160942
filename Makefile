# Everything happens in .venv; `make demo` and `make test` make it first.
PYTHON ?= python3
BIN := .venv/bin
NAME ?=
# of tests: half as many again as there are cores, since many of them wait for processes
PROCESSES ?= $(shell expr 3 \* $$(getconf _NPROCESSORS_ONLN) / 2)

.PHONY: demo test quick coverage docs lint format bench peers clean
.DEFAULT_GOAL := demo

.venv/ready: requirements.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "demflow needs Python 3.11 or newer; say which: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

demo: .venv/ready  ## run studies/quickstart.yaml on two cores
	$(BIN)/demflow run studies/quickstart.yaml --workers 2

test: .venv/ready  ## all tests, three processes for two cores
	$(BIN)/python -m pytest -n $(PROCESSES) --dist worksteal

quick: .venv/ready  ## laws and units: what answers within a minute
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow"

coverage: .venv/ready  ## all tests, and the lines of demflow that none of them reaches
	$(BIN)/python -m pytest -n $(PROCESSES) --dist worksteal --cov=model --cov=sweep --cov-report=term:skip-covered

docs: .venv/ready  ## the reference pages anew, and all pages as HTML in build/docs
	$(BIN)/python docs/reference.py
	$(BIN)/python -m tests.benchmarks --page
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs

lint: .venv/ready  ## style, imports and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: .venv/ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: .venv/ready  ## measured claims; one with NAME=…
	$(BIN)/python -m tests.benchmarks $(NAME)

.peers/ready: tests/peers/requirements.txt
	$(PYTHON) -m venv .peers
	.peers/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

peers: .venv/ready .peers/ready  ## compare with other codes anew, and keep what they answer
	$(BIN)/python -m tests.peers.pressures .peers/bin/python
	if command -v yade >/dev/null; then $(BIN)/python -m tests.peers.grain_forces; \
	else echo "yade is not installed (apt-get install yade); its part is left as it was"; fi

clean:
	rm -rf .venv .peers build *.egg-info
