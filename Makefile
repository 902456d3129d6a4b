# What one does with this project. Needs Python >= 3.11 and make; the targets set up .venv by themselves.

VENV := .venv
PIP := $(VENV)/bin/python -m pip --quiet --disable-pip-version-check --no-input
PYTEST := $(VENV)/bin/python -m pytest
RUN_READY := $(VENV)/.ready-run
DEV_READY := $(VENV)/.ready-dev
RCSS := .venv-rcss

.DEFAULT_GOAL := help
.NOTPARALLEL:
.DELETE_ON_ERROR:
.PHONY: help demo pictures test check format benchmarks hooks lock rcss clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z%-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(RUN_READY) ## tune a simulated robot's path follower in a calibrated simulator; report in out/demo
	@$(VENV)/bin/trueup demo --out out/demo

# One thread a process, for matrices and simulations: two pytest workers with two threads each would wait for one another.
test: export OMP_NUM_THREADS = 1
test: export OPENBLAS_NUM_THREADS = 1
test: export MKL_NUM_THREADS = 1
test: export TRUEUP_THREADS = 1
test: $(DEV_READY) $(VENV)/.compiled ## run all tests, on two cores
	@$(MAKE) --no-print-directory rcss >/dev/null 2>&1 || true # a RoboCup server to talk to; its tests say what is missing
	@# The report is opened in a real browser wherever one can be had; .ci/browser says why there is none, the tests pass it on.
	@TRUEUP_NO_BROWSER="$$(.ci/browser)" $(PYTEST) -n 2 --dist worksteal --durations=15 -rs $(ARGS)

# A loop that was compiled before knows the loops of other files, which it calls, as they were then.
$(VENV)/.compiled: $(shell grep -rl "compiled import njit" src --include=*.py) | $(DEV_READY)
	@find src -name '*.nb[ci]' -delete
	@touch $@

check: $(DEV_READY) ## lint, formatting, types, layers, addresses and paths
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/ruff format --check .
	@$(VENV)/bin/pyright
	@$(PYTEST) -q tests/test_layers.py tests/test_tree.py

pictures: demo ## screenshots of the reports into docs/images, that of the demo from out/demo
	@TRUEUP_PICTURES=out $(PYTEST) -q tests/report/test_pages.py tests/studies/test_stanley.py -k "cut_off or whole_study"

format: $(DEV_READY) ## mend what ruff can mend
	@$(VENV)/bin/ruff check --fix .
	@$(VENV)/bin/ruff format .

benchmarks: $(DEV_READY) ## run every benchmark, write docs/benchmarks.md (ARGS=--quick for a look)
	@$(VENV)/bin/python benchmarks/_table.py $(ARGS)

# With all extras: the robots of the balance study live in DART.
study-%: $(DEV_READY) ## run one of the papers' experiments, into out/study-NAME
	@if test -f src/trueup/studies/$*/campaign.toml; then \
	  $(VENV)/bin/trueup run src/trueup/studies/$*/campaign.toml --out out/study-$*; \
	elif test -f src/trueup/studies/$*/__main__.py; then \
	  $(VENV)/bin/python -m trueup.studies.$* --out out/study-$* $(ARGS); \
	else \
	  studies=$$(cd src/trueup/studies 2>/dev/null && ls -d */ | tr -d / | xargs); \
	  echo "no study '$*'; studies are: $${studies:-none yet}" >&2; exit 2; fi

hooks: $(DEV_READY) ## run the checks before each commit
	@$(VENV)/bin/pre-commit install

# Hashes, and no address of any index: where packages come from is each machine's business. ARGS=--upgrade for newer ones.
LOCK := CUSTOM_COMPILE_COMMAND='make lock' $(VENV)/bin/pip-compile --quiet --generate-hashes --strip-extras --allow-unsafe \
  --no-emit-index-url --no-emit-find-links --no-emit-trusted-host --build-deps-for editable
lock: $(DEV_READY) ## pin the versions in requirements/ anew from pyproject.toml
	@$(LOCK) $(ARGS) --output-file requirements/run.txt pyproject.toml
	@$(LOCK) $(ARGS) --output-file requirements/rcss.txt requirements/rcss.in
	@$(LOCK) $(ARGS) --extra ros,hdf5,dart,grounding,cluster,bench,dev --constraint requirements/run.txt --output-file requirements/dev.txt pyproject.toml

clean: ## remove .venv, caches and the demo's results
	rm -rf $(VENV) $(RCSS) out/demo build dist .pytest_cache .ruff_cache .hypothesis
	find src tests benchmarks examples -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

rcss: $(RCSS)/.ready ## install a RoboCup server (rcssservermj) for tests, in an environment of its own

# Its engine is older than trueup's: it runs in its own environment and process.
$(RCSS)/.ready: requirements/rcss.txt
	@python=$$($(find_python)) && $$python -m venv --clear $(RCSS)
	@$(RCSS)/bin/python -m pip --quiet --disable-pip-version-check --no-input --retries 1 --timeout 10 \
	  install --require-hashes --no-compile -r requirements/rcss.txt
	@touch $@

# ---- set-up: the stamps say which lock was installed last; an unfinished set-up leaves none and starts again ----

find_python = for p in $(or $(PYTHON),python3.13 python3.12 python3.11 python3); do \
  $$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo $$p; break; }; done

define set_up
@echo 'setting up $(VENV) (once, about a minute)'
@$(VENV)/bin/python -m pip --version >/dev/null 2>&1 || { \
  python=$$($(find_python)); \
  test -n "$$python" || { \
    echo 'trueup needs Python >= 3.11 with its venv module, and none was found; say which with: make PYTHON=PATH' >&2; exit 1; }; \
  $$python -m venv --clear $(VENV); }
@$(PIP) install --require-hashes --no-compile -r $(1)
@$(PIP) install --no-deps --no-build-isolation --no-compile --editable .
@# Compiled on all cores, and once: where Python may not write byte code each start would compile anew, for seconds.
@$(VENV)/bin/python -m compileall -qq -j 0 -x '/tests?/' $(VENV)/lib src || true
endef

$(RUN_READY): requirements/run.txt pyproject.toml
	$(call set_up,requirements/run.txt)
	@touch $@

$(DEV_READY): requirements/run.txt requirements/dev.txt pyproject.toml
	$(call set_up,requirements/dev.txt)
	@touch $(RUN_READY) $@
