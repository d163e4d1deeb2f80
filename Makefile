# `make report` and `make test` need only Python >= 3.11, make and git.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
LOWEST := $(VENV)/lowest

# the tests run in parallel processes on small matrices: threads of the linear algebra only get in each other's way
export OPENBLAS_NUM_THREADS ?= 1

# what the linear algebra computes with, by processor, and tests of what a last digit may turn
KERNELS ?= Haswell Prescott SkylakeX Zen
DELICATE := $(addprefix tests/test_,$(addsuffix .py,virtual_rig identification observer limits sampled \
	stabilizing tuning loop_oracles sliding_verification))

.PHONY: report test quick test-all test-kernels test-lowest lint check benchmark generate docs pictures clean

report: $(READY)          ## the main job: stability-margin report, dry and wet rail
	$(BIN)/railslip report --out railslip-report

test: $(READY)            ## linter, formatter, types, import contract, tests: the linters beside the tests
	$(MAKE) --no-print-directory --jobs 2 lint quick

quick: $(READY)
	$(BIN)/python -m pytest -n auto -m "not long"

test-all: lint            ## every test, the delicate ones under each kernel, the README's with the lowest versions
	$(BIN)/python -m pytest -n auto
	$(MAKE) test-kernels
	$(MAKE) test-lowest

test-lowest: $(LOWEST)/.ready  ## commands and Python of the README with the lowest versions that pyproject.toml allows
	$(LOWEST)/bin/python -m pytest -n auto --dist load -W default tests/test_smoke.py

# a processor without a kernel's instructions kills the process (132: illegal instruction): that kernel is left out
test-kernels: $(READY)    ## the numerically delicate tests under each kernel that this processor can run
	for kernel in $(KERNELS); do \
		export OPENBLAS_CORETYPE=$$kernel; \
		$(BIN)/python -c "import numpy; numpy.linalg.svd(numpy.ones((99, 99)))" 2>/dev/null; \
		if [ $$? = 132 ]; then echo "$$kernel: not of this processor, skipped"; continue; fi; \
		echo $$kernel; \
		$(BIN)/python -m pytest -n auto -q $(DELICATE) || exit 1; \
	done

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

benchmark: $(READY)       ## speed, as ratios against a peer in the same run
	$(BIN)/python -m pytest tests/benchmarks --benchmark-enable -o addopts="-ra" -s

generate: $(READY)        ## numeric code from the SymPy statement of the plant
	$(BIN)/python -m railslip_ctrl.sliding.generate

docs: $(READY)            ## the documentation site: equations, gallery, API, without a warning
	$(BIN)/python docs/generate.py
	$(BIN)/python -m sphinx --builder html --fresh-env --jobs auto --nitpicky --fail-on-warning --keep-going --quiet \
		docs docs/_build/html
	@echo "open docs/_build/html/index.html"

pictures: $(READY)        ## those that README.md and CONTRIBUTING.md show
	$(BIN)/railslip report --vehicle designs/vehicles/coach.toml --out $(VENV)/pictures
	cp $(VENV)/pictures/loop.svg docs/_static/report_loop.svg
	$(BIN)/python docs/house.py docs/_static/house.svg
	$(BIN)/python docs/page_picture.py docs/_static/design_page.png  # needs chromium and its driver

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

$(LOWEST)/.ready: pyproject.toml $(READY)
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python $(LOWEST)
	$(BIN)/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct -e ".[all,test]"
	touch $@

clean:
	rm -rf $(VENV) railslip-report build dist docs/_build docs/_generated
