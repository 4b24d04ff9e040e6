# Every target makes the environment it needs first; a Python of at least 3.11 with pip and venv is enough.
# Settings are given on the command line, for example:
#
#   make study SETS=20 WORKERS=2 SEED=1 STUDY_OUT=results/try
#   make test ARGS="-k rotations"
#   make test PYTHON=python3.13 VENV=.venv-3.13

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

# An interpreter on the PATH may be a shim that does not run: it counts only if it answers.
# $(call answers,NAME,TEST OF THE MINOR VERSION) is NAME, or nothing.
answers = $(shell $(1) -c "import sys; sys.exit(not sys.version_info[1] $(2))" 2>/dev/null && echo $(1))

ifndef PYTHON
PYTHON := $(or $(call answers,python3.11,== 11),$(call answers,python3,>= 11))
endif
VENV ?= .venv
RUN := $(VENV)/bin/python

# What the study does not find here it chooses itself.
SETS ?=
WORKERS ?=
SEED ?=
STUDY_OUT ?= results/paper
STUDY_ARGS = $(if $(SETS),--sets $(SETS)) $(if $(WORKERS),--workers $(WORKERS)) $(if $(SEED),--seed $(SEED))

# The problems are small: more BLAS threads only make them slower, and the workers are processes.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

.PHONY: help
help: ## List the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 12

.PHONY: environment
environment: ## Make the environment of environment.lock, unless it stands already
	@$(if $(PYTHON),,echo "No Python of at least 3.11 answers: name one with PYTHON=" >&2; exit 1)
	@$(PYTHON) .ci/environment.py $(VENV)

.PHONY: study
study: environment ## Run the study of the paper: the main job, from nothing
	$(RUN) -m studies paper --out $(STUDY_OUT) --resume $(STUDY_ARGS)

.PHONY: test
test: environment ## Run the tests and the doctests
	$(RUN) -m pytest -n auto $(ARGS)

.PHONY: test-all
test-all: ## Run the tests under every supported Python that answers
	@failed=; \
	for version in 3.11 3.12 3.13; do \
	    python=python$$version; \
	    venv=.venv-$$version; \
	    if [ $$python = "$(PYTHON)" ]; then venv=$(VENV); fi; \
	    if $$python -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$$version')" 2>/dev/null; then \
	        echo "Python $$version:"; \
	        $(MAKE) --no-print-directory test PYTHON=$$python VENV=$$venv || failed+=" $$version"; \
	    else \
	        echo "Python $$version: skipped, no $$python answers"; \
	    fi; \
	done; \
	if [ -n "$$failed" ]; then echo "Failed under Python$$failed" >&2; exit 1; fi

.PHONY: lint
lint: environment ## Check style and types
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(RUN) -m mypy

.PHONY: format
format: environment ## Format the code, and mend what ruff can mend
	$(RUN) -m ruff check --fix .
	$(RUN) -m ruff format .

.PHONY: docs
docs: environment ## Build the documentation into docs/_build/html
	rm -rf docs/auto_gallery docs/generated
	$(RUN) -m sphinx -q -W --keep-going docs docs/_build/html

# Pins that still fit stay as they are; "make lock ARGS=--upgrade" takes the newest of everything.
.PHONY: lock
lock: environment ## Bring environment.lock into line with pyproject.toml
	$(RUN) -m uv pip compile --quiet --universal --python-version 3.11 --fork-strategy fewest --all-extras \
	    --generate-hashes --custom-compile-command "make lock" $(ARGS) pyproject.toml --output-file environment.lock

.PHONY: clean
clean: ## Remove environments, caches and built documentation, but no results
	rm -rf .venv .venv-* .hypothesis .mypy_cache .pytest_cache .ruff_cache docs/_build docs/auto_gallery docs/generated
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
