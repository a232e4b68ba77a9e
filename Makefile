# One command each; every one does the set-up it needs. `make help` lists them.

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= python3
PYTEST_ARGS ?=
WHEEL ?= lightest
VERSIONS ?= newest
TWINE := twine==7.0.0
export MUJOCO_GL ?= egl
# One BLAS thread: the small matrices here only lose by more, and sweeps use all cores anyway.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

PACKAGES := $(VENV)/.packages
RENDERING := $(VENV)/.rendering
VIEWERS := $(VENV)/.viewers

.DEFAULT_GOAL := help
.PHONY: help setup demo test lint docs pictures lock wheel image release

help: ## list the commands
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 16

setup: $(PACKAGES) $(RENDERING) ## install all into .venv; quick when it is there

demo: setup ## run the mission: two rovers find their site and insert a card
	$(BIN)/python -m experiments mission --quick --record

test: setup $(VIEWERS) ## run the tests; PYTEST_ARGS="-m 'not slow'" for the quick ones
	@sh tools/run_tests.sh $(BIN)/python $(PYTEST_ARGS)

lint: setup ## check style, format and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

docs: setup ## build the site into build/site, without network; open index.html there
	$(BIN)/python -m sphinx -c docs -W --keep-going -q -d build/site-doctrees . build/site

pictures: setup ## make the pictures of all pages anew: hours; PICTURES="docs/mapping.gif" for some
	$(BIN)/python tools/make_pictures.py $(PICTURES)

lock: ## make requirements.lock anew from pyproject.toml (needs uv)
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
	    --extra dev pyproject.toml -o requirements.lock

wheel: setup ## run the wheel in an empty environment; WHEEL=all, VERSIONS=lowest or locked
	@$(BIN)/python tools/try_wheel.py --runs $(WHEEL) --versions $(VERSIONS)

image: ## build the image of the Dockerfile, and run it (docker, or root with buildah)
	@sh tools/try_image.sh

release: setup ## check and build a release in dist/; publishes nothing
	@$(BIN)/python tools/check_release.py
	@$(MAKE) wheel
	@$(BIN)/python -m venv build/twine && build/twine/bin/python -m pip install --quiet $(TWINE)
	@build/twine/bin/python -m twine check --strict dist/*

$(PACKAGES): requirements.lock pyproject.toml tools/install_packages.sh
	@sh tools/install_packages.sh $(PYTHON) $(VENV)
	@touch $@

$(RENDERING): $(PACKAGES) tools/ensure_rendering.sh
	@sh tools/ensure_rendering.sh $(BIN)/python
	@touch $@

$(VIEWERS): $(PACKAGES) tools/ensure_viewers.sh
	@sh tools/ensure_viewers.sh
	@touch $@
