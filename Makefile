# Everything happens in a virtual environment of the project's own, .venv.

PYTHON  ?= python3
VENV    ?= .venv
OUT     ?= results
# more options of `make reproduce`
ARGS    ?=
# processes that run the tests
WORKERS ?= 2

BIN   := $(VENV)/bin
PY    := $(BIN)/python
PIP   := $(PY) -m pip --disable-pip-version-check --no-input
STAMP := $(VENV)/.installed
BENCH_STAMP := $(VENV)/.installed-bench
DOCS_STAMP  := $(VENV)/.installed-docs

# A second environment, with the lowest versions that pyproject.toml declares.
LOWEST       := .venv-lowest
LOWEST_STAMP := $(LOWEST)/.installed
LOWEST_PIP   := $(LOWEST)/bin/python -m pip --disable-pip-version-check --no-input

# Figures are drawn without a screen, and what the tools keep for themselves stays in
# .venv, so that nothing is written to the home directory.
export MPLBACKEND := Agg
export MPLCONFIGDIR := $(abspath $(VENV))/var/matplotlib
export IPYTHONDIR := $(abspath $(VENV))/var/ipython
export JUPYTER_CONFIG_DIR := $(abspath $(VENV))/var/jupyter/config
export JUPYTER_DATA_DIR := $(abspath $(VENV))/var/jupyter/data
export JUPYTER_RUNTIME_DIR := $(abspath $(VENV))/var/jupyter/runtime

# Where compiled modules may not be kept, every process compiles SciPy anew: tests take twice as long.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:

.PHONY: help
help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))

# ---------------------------------------------------------------- use

.PHONY: setup
setup: $(STAMP) ## make .venv with the locked packages and the project itself

.PHONY: reproduce
reproduce: $(STAMP) ## reproduce the paper's results (OUT=results; ARGS=--quick: a first look)
	$(PY) -m paper_repro --out $(OUT) $(if $(findstring --quick,$(ARGS)),,--readme paper_repro) $(ARGS)

.PHONY: notebooks
notebooks: $(STAMP) ## open the notebooks in JupyterLab
	$(BIN)/jupytext-config set-default-viewer python
	env -u MPLBACKEND $(BIN)/jupyter lab --notebook-dir notebooks \
	    --LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate

# Pages that load nothing from elsewhere: no viewer's scripts are asked for.
.PHONY: notebook-pages
notebook-pages: $(STAMP) ## run every notebook into OUT/notebooks, as notebook and as a page
	@mkdir -p $(OUT)/notebooks
	@set -e; for source in $(wildcard notebooks/*.py); do \
	    name=$$(basename $$source .py); echo "$$source -> $(OUT)/notebooks/$$name.html"; \
	    env -u MPLBACKEND $(BIN)/jupytext --quiet --to ipynb --set-kernel python3 --execute \
	        --output $(OUT)/notebooks/$$name.ipynb $$source; \
	    $(BIN)/jupyter nbconvert --log-level ERROR --to html --embed-images \
	        --HTMLExporter.require_js_url= --HTMLExporter.mathjax_url= \
	        --HTMLExporter.mermaid_js_url= $(OUT)/notebooks/$$name.ipynb; \
	done

# Warnings are errors, links within the project that lead nowhere among them.
.PHONY: docs
docs: $(DOCS_STAMP) ## build the documentation into build/docs/html (NOTEBOOKS=off: as they are)
	$(PY) -m sphinx -q -W --keep-going -b html -d build/docs/doctrees docs build/docs/html
	@echo build/docs/html/index.html

# ---------------------------------------------------------------- checks

# The processes share the cores, so that each computes with one thread.
PYTEST = OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
    $(PY) -m pytest -n $(WORKERS) --dist loadgroup

.PHONY: test
test: lint types $(STAMP) ## lint, types, doctests, the wheel, every test but those marked slow or bench
	$(PYTEST) -m "not slow and not bench"

.PHONY: test-slow
test-slow: $(STAMP) ## the tests that take long, and every property on examples never seen before
	EXPLORE=1 $(PYTEST) -m "(slow or hypothesis) and not bench"

# The core at the lowest versions that are declared: models, solvers, certificates, the gate, the
# commands, and each optional package that has a bound of its own. Not what takes long.
LOWEST_TESTS = $(addprefix tests/,mdp solvers/test_solvers.py solvers/test_equations.py \
    solvers/proof solvers/values solvers/robust solvers/test_parallel.py \
    analysis/cli/test_commands.py analysis/cli/test_train.py \
    analysis/gate/test_check_command.py analysis/sensitivity/test_global.py \
    project/test_versions.py)

.PHONY: test-lowest
test-lowest: $(LOWEST_STAMP) ## the core tests at the lowest declared versions, in .venv-lowest
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(LOWEST)/bin/python -m pytest -n $(WORKERS) \
	    --dist loadgroup -k "not compiled_draws" $(LOWEST_TESTS)

.PHONY: coverage
coverage: $(STAMP) ## the share of lines and branches that `make test` runs, into build/coverage
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PY) -m pytest -n $(WORKERS) --dist loadgroup \
	    --cov --cov-report=term --cov-report=html:build/coverage

# The date of the last commit stands in the archives, so that built again they are the same bytes.
.PHONY: wheel
wheel: $(STAMP) ## build the wheel and the source archive into dist, the same bytes every time
	rm -rf dist
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct 2>/dev/null || echo 1600000000) \
	    $(PY) -m build --no-isolation --sdist --wheel --outdir dist .

.PHONY: wheel-test
wheel-test: $(STAMP) ## build the wheel, install it elsewhere and use it there
	$(PY) -m pytest -m wheel tests/project/test_packaging.py

.PHONY: lint
lint: $(STAMP) ## ruff's checks, its formatting among them
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .

.PHONY: format
format: $(STAMP) ## rewrite the files as ruff formats them
	$(PY) -m ruff check --fix .
	$(PY) -m ruff format .

.PHONY: types
types: $(STAMP) ## mypy over the four packages and the tests' helpers
	$(PY) -m mypy
	$(PY) -m mypy tests/support tests/cases

.PHONY: bench
bench: $(BENCH_STAMP) ## the benchmarks; rewrites tests/benchmarks/RESULTS.md
	$(PY) -m pytest -m bench --benchmark-enable
	$(PY) tests/benchmarks/compare.py

# ---------------------------------------------------------------- upkeep

.PHONY: lock
lock: | $(PY) ## write the lock files again (UPGRADE=1: newest versions)
	$(PIP) install -qq --require-hashes --no-deps -r requirements-uv.lock
	echo uv | $(COMPILE) --output-file requirements-uv.lock -
	$(COMPILE) --extra all --group test --output-file requirements.lock pyproject.toml
	$(COMPILE) --extra bench --constraints requirements.lock \
	    --output-file requirements-bench.lock pyproject.toml
	$(COMPILE) --group docs --constraints requirements.lock --output-file requirements-docs.lock
	printf 'icu-sepsis\ngym\n' | $(COMPILE) --no-deps --output-file requirements-icu.lock -
	$(COMPILE) $(if $(UPGRADE),,--upgrade) --resolution lowest-direct --extra lp --extra plots --extra gymnasium --extra umb \
	    --extra parquet \
	    --group test --output-file requirements-lowest.lock pyproject.toml

# The lowest versions are found anew each time: those locked would be kept where a bound falls.
COMPILE = $(PY) -m uv pip compile --quiet --universal --python-version 3.11 \
    --fork-strategy fewest --generate-hashes --no-emit-index-url \
    --custom-compile-command "make lock" $(if $(UPGRADE),--upgrade)

.PHONY: clean
clean: ## remove what the targets above wrote, .venv and .venv-lowest excepted
	rm -rf $(OUT) build dist *.egg-info .hypothesis .pytest_cache .mypy_cache .ruff_cache \
	    .benchmarks .asv
	find . -path './.venv*' -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

# ---------------------------------------------------------------- .venv

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	    echo "exact-mdp needs Python 3.11 or newer, and '$(PYTHON)' is:" >&2; \
	    $(PYTHON) --version >&2; \
	    echo "Name another one, as in: make setup PYTHON=python3.12" >&2; \
	    exit 1; }
	$(PYTHON) -m venv $(VENV)

# Compiling every module at installation would nearly double its time. The model of notebook 9 is a
# package that asks for gym, of which there is no wheel: it is built by the setuptools of the lock.
# What else it declares it does not import. All but that notebook works without it.
$(STAMP): pyproject.toml requirements.lock requirements-icu.lock | $(PY)
	$(PIP) install -qq --no-compile --require-hashes --no-deps -r requirements.lock
	@$(PIP) install -qq --no-compile --no-build-isolation --require-hashes --no-deps \
	    -r requirements-icu.lock || echo "icu-sepsis is missing: notebook 9 and its tests are left out"
	$(PIP) install -qq --no-build-isolation --no-deps -e .
	@touch $@

$(BENCH_STAMP): requirements-bench.lock $(STAMP)
	$(PIP) install -qq --no-compile --require-hashes --no-deps -r requirements-bench.lock
	@touch $@

$(DOCS_STAMP): requirements-docs.lock $(STAMP)
	$(PIP) install -qq --no-compile --require-hashes --no-deps -r requirements-docs.lock
	@touch $@

# Wheels alone: to build old versions of compiled packages takes compilers and an hour.
$(LOWEST_STAMP): pyproject.toml requirements-lowest.lock
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST_PIP) install -qq --no-compile --only-binary :all: --require-hashes --no-deps \
	    -r requirements-lowest.lock
	$(LOWEST_PIP) install -qq --no-build-isolation --no-deps -e .
	@touch $@
