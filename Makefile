# Two commands: `make solvers` runs the comparison, `make test` passes the tests.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
READY := $(VENV)/.ready

.PHONY: setup solvers test lint sanitize docs clean

setup: $(READY)

$(READY): pyproject.toml setup.py constraints.txt packaging/backend.py $(wildcard moc_opt/core/*.[ch])
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "moc_opt needs Python 3.11 or later: make PYTHON=python3.12 ...")'
	@echo 'installing the pinned packages into $(VENV): two to ten minutes, without output'
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --editable '.[solvers,vision,live,cluster,peers,qpbenchmark,dataframes,docs,dev]' --constraint constraints.txt
	touch $(READY)
	@echo 'ready: . $(VENV)/bin/activate && moc-opt run'

solvers: setup
	$(RUN) -m benchmarks.solvers

# The tests share the cores: threads of the linear algebra library would only wait for each other. The tests start many
# processes. Each would compile all modules again if the environment forbade bytecode files.
test: setup lint
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(RUN) -m pytest -n auto --dist loadfile --no-loadscope-reorder

lint: setup
	$(RUN) -m ruff check .
	$(RUN) -m mypy

# The core's own code, without its binding, under the address and the undefined-behaviour sanitizer.
CORE := $(filter-out %/python.c %/python_arm.c %/python_subproblem.c %/arguments.c %/plant.c,$(wildcard moc_opt/core/*.c))
EXTREMES ?= build/extremes
SANITIZERS ?= -fsanitize=address,undefined -fno-sanitize-recover=undefined

sanitize: $(EXTREMES)
	$(EXTREMES) 10000

$(EXTREMES): tests/core/extremes.c $(CORE) $(wildcard moc_opt/core/*.h)
	@mkdir -p $(@D)
	$(CC) -std=c11 -O1 -g $(SANITIZERS) -ffp-contract=off -fno-builtin-sin -fno-builtin-cos -Wall -Wextra \
		-Imoc_opt/core tests/core/extremes.c $(CORE) -lm -o $@

# Pages of sources are written anew: one that is older than a change of the reference links to where its names were.
docs: setup
	rm -rf build/docs/_modules
	$(RUN) -m sphinx -W --keep-going -q -b html docs build/docs
	@echo written: build/docs/index.html

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache results build docs/gallery docs/_api
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
