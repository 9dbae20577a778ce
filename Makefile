# Sets up .venv on first use; every other target depends on it.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3 python; do \
	$$p -c 'import sys; sys.exit(not sys.version_info >= (3, 11))' >/dev/null 2>&1 && { echo $$p; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: help setup demo test test-long soak check format schemas docs pictures wheel clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: $(STAMP)  ## create .venv and install comotion with what the tests need

$(STAMP): pyproject.toml requirements.txt
	@test -n "$(PYTHON)" || { echo "comotion needs Python 3.11 or newer on the PATH" >&2; exit 2; }
	@echo "setting up $(VENV), once: a minute or two"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.txt -e '.[cluster,foxglove,metrics,mocap,plot,record,ros,secure,video]' --group dev
	@echo "compiling, once: a minute or two"
	$(BIN)/comotion dev warm-up
	@touch $@

demo: setup  ## router, three sources, service and watch; a summary and a plot at the end
	$(BIN)/comotion demo

# Two workers run the tests of processes, which wait half of their time, beside one with the others. Each
# process computes on one core, and what is compiled of a module is kept for the next.
test: setup  ## the whole test suite, on two cores
	PYTHONDONTWRITEBYTECODE= NUMBA_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
		$(BIN)/python -m pytest -n 3 --dist loadscope --no-loadscope-reorder

test-long: setup  ## the tests that take a minute or more each
	$(BIN)/python -m pytest -m long

soak: setup  ## three minutes of a scene under faults: kills, stops, clock steps, hostile input
	$(BIN)/comotion dev soak --duration 180 --gap 10 --seed 0 --out out/soak

check: setup  ## lint, format, types, import rules
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --config-file tests/typing/mypy.ini
	$(BIN)/lint-imports

format: setup  ## apply lint fixes and formatting
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

schemas: setup  ## export the JSON Schema of every message header, and the tables of parameters
	$(BIN)/python -m comotion_schemas.export schemas
	PYTHONPATH=tests $(BIN)/python -m comotion_tools.parameter_table docs/parameters.md

docs: setup  ## the site in out/site, with the API; broken links and warnings are errors
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.txt --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

pictures: setup  ## make the pictures, the samples and the notebook's outputs again
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.txt -e '.[foxglove,sim3d,view]' nbconvert ipykernel
	$(BIN)/python -m comotion_experiments.pictures docs
	for scene in 3d_5 fig4_4; do $(BIN)/comotion evaluate sim:$$scene --plot docs/images/$$scene.png || exit; done
	for camera in truck/a truck-tower/b shelf/a arm/b; do $(BIN)/comotion segment \
	  "workcell:$$camera?rate=15&size=640x480" --no-depth --sheet docs/images/sheet-$${camera%/*}.jpg || exit; done
	$(BIN)/jupyter nbconvert --to notebook --execute --inplace docs/examples/library.ipynb
	rm -f docs/examples/bodies.png

wheel: setup  ## wheel and source distribution, in dist
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.txt build
	$(BIN)/python -m build --outdir dist

clean:  ## remove what setup and runs created
	rm -rf $(VENV) out dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
