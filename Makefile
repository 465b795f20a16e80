# Everything happens in a virtual environment of the project's own, .venv.
PYTHON  ?= python3
VENV    ?= .venv
OUT     ?= results
WORKERS ?= 2
LOWEST  := .venv-lowest
PY      := $(VENV)/bin/python
# What the tools keep for themselves stays in .venv; figures are drawn without a screen.
$(foreach name,MPLCONFIGDIR IPYTHONDIR JUPYTER_CONFIG_DIR JUPYTER_DATA_DIR JUPYTER_RUNTIME_DIR,\
    $(eval export $(name) := $(abspath $(VENV))/var))
export MPLBACKEND := Agg
unexport PYTHONDONTWRITEBYTECODE # without bytecode each process of the tests compiles SciPy's modules

INSTALL = -m pip --disable-pip-version-check --no-input install -qq --no-compile --no-deps
# The processes share the cores, so that each computes with one thread.
TESTS   = OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(1)/bin/python -m pytest -n $(WORKERS) --dist loadgroup
# The lowest versions are always locked with --upgrade: else a lowered bound would keep the old version.
COMPILE = $(PY) -m uv pip compile -q --universal --python-version 3.11 --fork-strategy fewest \
    --generate-hashes --no-emit-index-url --custom-compile-command "make lock"
# The model of notebook 7, whose package is no wheel: everything else works without it.
ICU = 'gym==0.26.2 --hash=sha256:e0d882f4b54f0c65f203104c24ab8a38b039f1289986803c7d02cdbe214fbcc4' \
    'icu-sepsis==2.0.1 --hash=sha256:93cc0f70d06b23ad024856214942077edef58c62492c6641d1a47ac38cfb1f2f'

.PHONY: help setup reproduce notebooks outputs docs test test-slow test-lowest lint format types mutants proof proof-audit proof-compare proof-yuan2025 bench wheel lock clean
reproduce notebooks outputs docs test test-slow lint format types mutants proof-compare proof-yuan2025 bench wheel lock: setup
help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
setup: $(VENV)/.installed ## make .venv with the locked packages and the project itself
reproduce: ## reproduce the paper's results (OUT=results; ARGS=--quick: a first look)
	$(PY) -m exact_mdp.paper_repro --out $(OUT) $(if $(findstring --quick,$(ARGS)),,--readme exact_mdp/paper_repro) $(ARGS)
notebooks: ## open the notebooks in JupyterLab
	env -u MPLBACKEND $(VENV)/bin/jupyter lab notebooks --LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate
outputs: ## run the notebooks and write their outputs into them
	$(PY) tests/support/notebook_outputs.py
docs: ## write into the pages what is made from the code
	$(PY) docs/write.py
test: lint ## lint, types, doctests, the wheel, every test but those marked slow or storm
	@$(MAKE) --no-print-directory types & typed=$$!; \
	$(call TESTS,$(VENV)) -m "not slow and not storm"; tested=$$?; \
	wait $$typed && exit $$tested
test-slow: ## the tests that take long, and every property on examples never seen before
	EXPLORE=1 $(call TESTS,$(VENV)) -m "(slow or hypothesis) and not storm"
test-lowest: $(LOWEST)/.installed ## the core tests at the lowest declared versions, in .venv-lowest
	$(call TESTS,$(LOWEST)) -k "not Taxi" $(addprefix tests/,mdp solvers/exact solvers/values inner/mdp \
	    solvers/test_published.py solvers/test_solvers.py analysis/cli/test_commands.py analysis/cli/test_train.py project/test_project_files.py \
	    analysis/gate/test_check_command.py analysis/vary/test_sobol.py analysis/vary/test_psa.py solvers/test_laws.py \
	    inner/solvers/test_parallel.py solvers/test_robust.py)
lint: ## ruff's checks, its formatting among them
	$(PY) -m ruff check . && $(PY) -m ruff format --check .
format: ## rewrite the files as ruff formats them
	$(PY) -m ruff check --fix . && $(PY) -m ruff format .
types: ## mypy over the four packages and the tests' helpers
	$(PY) -m mypy && $(PY) -m mypy tests/support tests/cases
mutants: ## change one thing at a time in FILE=solvers/exact/levels.py, a folder or several; which changes do tests notice?
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PY) tests/mutation/mutants.py $(ARGS) $(FILE)
proof: ## check with Coq that what the proven checker accepts holds, and that verified.py is that checker
	@command -v coqc > /dev/null || { echo "Coq is missing: apt-get install --no-install-recommends coq"; exit 1; }
	$(MAKE) --no-print-directory -C proof
proof-audit: ## check the compiled proof once more, with Coq's independent checker
	$(MAKE) --no-print-directory -C proof audit
proof-compare: ## compare both checkers on 20,000 certificates (ARGS="2000 7": how many, which seed)
	PYTHONPATH=. $(PY) tests/support/altered_certificates.py $(ARGS)
proof-yuan2025: proof ## state and prove in Coq the optimum of the paper's model, in build/yuan2025.v
	mkdir -p build
	$(VENV)/bin/exact-mdp convert yuan2025 build/model.json
	$(VENV)/bin/exact-mdp solve yuan2025 --certify --certificate build/proof.json
	$(PY) proof/to_coq.py build/model.json build/proof.json yuan2025 > build/yuan2025.v
	coqc -q -Q proof/theories MDP build/yuan2025.v
bench: ## the benchmarks; rewrites tests/benchmarks/RESULTS.md
	$(PY) -m pytest -m storm && $(PY) tests/benchmarks/compare.py
wheel: ## build the wheel and the source archive into dist, the same bytes every time
	rm -rf dist
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct || echo 1600000000) $(PY) -m build --no-isolation --outdir dist .
lock: ## write the two lock files again (UPGRADE=1: newest versions)
	$(COMPILE) $(if $(UPGRADE),--upgrade) --extra all --extra bench --group dev \
	    --output-file requirements.lock pyproject.toml
	$(COMPILE) --upgrade --resolution lowest-direct --extra lp --extra plots --extra models --group test \
	    --output-file requirements-lowest.lock pyproject.toml
clean: ## remove what the targets above wrote, .venv and .venv-lowest excepted
	rm -rf $(OUT) build dist .hypothesis .pytest_cache .mypy_cache .ruff_cache
	find exact_mdp tests docs -name __pycache__ -prune -exec rm -rf {} +

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "too old: make setup PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
$(VENV)/.installed: pyproject.toml requirements.lock | $(PY)
	$(PY) $(INSTALL) --require-hashes -r requirements.lock
	@printf '%s\n' $(ICU) | $(PY) $(INSTALL) --no-build-isolation --require-hashes -r /dev/stdin \
	    || echo "icu-sepsis is missing: notebook 7 and its tests are left out"
	$(PY) $(INSTALL) --no-build-isolation -e .
	@touch $@
# Wheels alone: to build old versions takes compilers and an hour.
$(LOWEST)/.installed: pyproject.toml requirements-lowest.lock
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python $(INSTALL) --only-binary :all: --require-hashes -r requirements-lowest.lock
	$(LOWEST)/bin/python $(INSTALL) --no-build-isolation -e .
	@touch $@
