# Two commands: `make solvers` runs the comparison, `make test` passes the tests.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
READY := $(VENV)/.ready

.PHONY: setup solvers test lint kernels docs clean

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "moc_opt needs Python 3.11 or later: make PYTHON=python3.12 ...")'
	@echo 'installing the pinned packages into $(VENV): two to ten minutes, without a word'
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --editable '.[solvers,vision,live,cluster,peers,qpbenchmark,dataframes,docs,dev]' --constraint constraints.txt
	touch $(READY)
	@echo 'ready: . $(VENV)/bin/activate && moc-opt run (the first run compiles, for one to three minutes)'

solvers: setup
	$(RUN) -m benchmarks.solvers

# The tests share the cores: threads of the linear algebra library would only wait for each other.
test: setup
	$(MAKE) --no-print-directory --jobs=3 lint kernels
	OPENBLAS_NUM_THREADS=1 $(RUN) -m pytest -n auto --dist loadfile --no-loadscope-reorder

lint: setup
	$(RUN) -m ruff check .
	$(RUN) -m mypy

# Compiled once, while the linters run on one core: else every process that shares the tests compiles the same anew.
kernels: kernels.exact kernels.rnn

kernels.%: setup
	$(RUN) -m benchmarks.common.preload $*

# Pages of sources are written anew: one that is older than a change of the reference links to where its names were.
docs: setup
	rm -rf build/docs/_modules
	$(RUN) -m sphinx -W --keep-going -q -b html docs build/docs
	@echo written: build/docs/index.html

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache results build docs/gallery docs/_api
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
