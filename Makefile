VENV ?= .venv
BIN := $(VENV)/bin
PYTHON ?= python3
EXTRAS ?= dev
STAMP := $(VENV)/.installed-$(EXTRAS)

.DEFAULT_GOAL := help
.PHONY: help setup run test test-slow dist-check release-check smoke site site-setup site-docs docs lint type perf perf-large bytes clean zenere2018 zenere2017 souto2011 ma2025 belda2017 mayne2005 servo-constrained benchmarks estimators wkf2018 papers suite

help:  ## show the targets
	@grep -E '^[a-z0-9 -]+:.*##' Makefile | sed -E 's/:[^#]*## /\t/' | expand -t 24

setup: $(STAMP)  ## make the virtual environment and install into it (EXTRAS=dev,adapters adds other libraries)

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV) && $(BIN)/python -m pip install --quiet --editable '.[$(EXTRAS)]' && touch $@

run: setup  ## run the quickstart and print the path of its figure
	$(BIN)/rmpc-bench run configs/quickstart.yaml

# Where bytecode is not kept, each of the hundreds of processes that tests start would compile the package again.
# Compiled kernels are kept for the next run, in this checkout, so that no other one replaces them.
test: export NUMBA_CACHE_DIR ?= $(CURDIR)/.numba_cache
test: setup  ## run the default tests, on all cores; with RMPC_BENCH_TESTS=all those too that .ci/run adds
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest

test-slow: setup  ## run the tests that take minutes, on all cores
	$(BIN)/python -m pytest -m slow

dist-check: setup  ## install the wheel into fresh environments of every Python on this machine, with the newest and the lowest libraries, and run it
	PYTHONPATH=tests $(BIN)/python -m dist_check $(if $(TURN),--turn $(TURN))

release-check: setup  ## before a release: dist-check, the metadata, the archives and tests in the source archive
	PYTHONPATH=tests $(BIN)/python -m dist_check --release

smoke: setup  ## run every configuration at its small size (or CONFIGS='FILE ..'); those without their libraries are named and skipped
	@printf '%s\n' $(or $(CONFIGS),$$(find configs -name '*.yaml' | sort)) | xargs -n 1 -P $$(getconf _NPROCESSORS_ONLN) $(BIN)/rmpc-bench run --smoke --fresh --if-installed

site: setup  ## write the pages of all stored experiments and their index into results/site
	$(BIN)/rmpc-bench report $$(find results -name trials.sqlite -o -name claims.json | grep -v -e /site/ -e /smoke/ -e '~' -e '\.2' | xargs -n 1 dirname | sort -u) --to results/site

site-setup:  ## install what the documentation site is built with (needs npm for its search and the font of its formulas)
	$(MAKE) setup EXTRAS=dev,docs
	npm install --silent --ignore-scripts --no-audit --no-fund --prefix $(VENV)/share/site-docs iframe-worker@1.0.4 @fontsource/stix-two-math@5.3.0

site-docs:  ## build the documentation site in build/site-docs/site, without a network (after site-setup)
	PYTHONPATH=tests $(BIN)/python -m docs.site build/site-docs

docs: setup  ## make the generated parts of README and docs again
	PYTHONPATH=tests $(BIN)/python -m docs.pages

lint: setup  ## check style and format
	$(BIN)/ruff check . && $(BIN)/ruff format --check .

type: setup  ## check types
	$(BIN)/mypy

perf: setup  ## measure speed and memory beside plain programs, and write results/perf (needs the extra perf)
	RMPC_BENCH_TESTS= PYTHONPATH=tests $(BIN)/python -m perf

perf-large: setup  ## the same for 100,000 and 1,000,000 runs
	RMPC_BENCH_TESTS= PYTHONPATH=tests $(BIN)/python -m perf --large

bytes: setup  ## compare what HEAD and another commit write, at the small size of every configuration (BASE=COMMIT)
	PYTHONPATH=tests $(BIN)/python -m byte_gate $(BASE)

clean:  ## remove generated files (results stay)
	rm -rf $(VENV) build *.egg-info .numba_cache .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks .coverage

zenere2018 zenere2017 souto2011 ma2025 belda2017 mayne2005 servo-constrained benchmarks estimators wkf2018: setup  ## reproduce a paper (or run another group of experiments), every claim compared with its record
	@for config in configs/$@/*.yaml; do $(BIN)/rmpc-bench run $$config --strict || exit; done

papers: zenere2018 zenere2017 souto2011 ma2025 belda2017  ## reproduce all papers

suite: setup  ## compare the estimators on the published uncertain systems of configs/suite
	$(BIN)/rmpc-bench suite
