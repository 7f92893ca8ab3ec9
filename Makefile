# Two commands are the whole set-up: `make demo` and `make test`. `make help` lists the others.

PYTHON ?= python3
WORKERS ?= 2
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: help demo test lint format goldens schemas docs proofs lock hooks pictures browser vsix clean

help: ## List the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1|\2/p' $(MAKEFILE_LIST) | awk -F'|' '{printf "%-16s %s\n", $$1, $$2}'

# Set-up happens once, and again when the dependencies change. constraints.txt fixes every version.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "SimFoundry needs Python 3.11 or newer, and \`$(PYTHON)\` is $$($(PYTHON) --version 2>&1 | tail -n 1)."; \
	  echo "Name another: make PYTHON=python3.11 $(MAKECMDGOALS)"; exit 1; }
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	@echo "Installing SimFoundry into $(VENV): once, and when its dependencies change; about a minute ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

demo: $(READY) ## Reconstruct a tabletop from a picture, compile it for every target, run it
	@$(BIN)/simfoundry demo

# A file goes to one worker: what its tests share is made once.
test: $(READY) ## Run the tests
	@$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

lint: $(READY) ## Check style, types and the import contract; changes nothing
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(BIN)/python -m simfoundry.spec.generated --check
	$(BIN)/python -m simfoundry.targets.generated --check

format: $(READY) ## Format the code and mend what can be mended by itself
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

schemas: $(READY) ## Write schemas/ and the generated pages of docs/
	$(BIN)/python -m simfoundry.spec.generated
	$(BIN)/python -m simfoundry.targets.generated

docs: $(READY) ## Build the documentation site into build/site; a warning is an error
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

pictures: $(READY) ## Render the pictures of specs/README.md and docs/studio.md anew
	$(BIN)/python specs/render_pictures.py
	$(BIN)/python specs/render_studio.py

# Chromium comes with the system's packages, because that of Playwright is for a few systems only.
browser: $(READY) ## Install what drives the studio in a browser: Playwright, and Chromium where there is none
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[browser]'
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null || \
	  $$(test "$$(id -u)" = 0 || echo sudo) sh -c \
	  'apt-get update -qq && apt-get install -qq -y --no-install-recommends chromium >/dev/null'

# It needs node and npm; the packages that build it are installed beside its sources.
vsix: $(READY) ## Build the extension for VS Code into build/
	@$(BIN)/python -m editors.vscode.build

goldens: $(READY) ## Write the expected texts of the tests anew; review the diff
	$(BIN)/python -m pytest -n $(WORKERS) --update-goldens

# Each module of tests/corpora is a long run over public data, or over many random scenes, and prints a table.
PROOFS := $(patsubst tests/corpora/%.py,tests.corpora.%,$(filter-out %/__init__.py %/conftest.py,\
  $(filter-out tests/corpora/test_%,$(wildcard tests/corpora/*.py))))

proofs: $(READY) ## Long runs that measure what is promised: minutes, and some need data that is not in the repository
	$(BIN)/python -m pytest -n $(WORKERS) -m "slow or hypothesis" --hypothesis-profile=random
	@set -e; for proof in $(PROOFS); do echo "$(BIN)/python -m $$proof"; $(BIN)/python -m $$proof; done

lock: ## Resolve the dependencies of pyproject.toml anew, for every Python, into constraints.txt
	@$(PYTHON) -m venv build/lock
	@build/lock/bin/python -m pip install --quiet --disable-pip-version-check uv
	@build/lock/bin/uv pip compile --quiet --upgrade --universal --python-version 3.11 --no-annotate \
	  --extra browser --extra dev --extra docs --extra train \
	  --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' --output-file constraints.txt pyproject.toml

hooks: $(READY) ## Run the checks at each commit
	$(BIN)/pre-commit install

clean: ## Remove the environment, caches and build outputs
	rm -rf $(VENV) build dist tests/editor/node_modules editors/vscode/node_modules .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find simfoundry tests -name __pycache__ -type d -prune -exec rm -rf {} +
