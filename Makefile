# Eight verbs: demo, test, quick, lint, bench, docs, paper, clean. Each works in a fresh clone.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test quick lint bench docs paper clean

demo: $(READY)
	$(RUN)/mjx-fit demo

test: lint
	$(RUN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

quick: $(READY)
	$(RUN)/pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow and not gpu and not long"

lint: $(READY)
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/basedpyright --pythonpath $(RUN)/python
	$(RUN)/lint-imports

bench: $(READY)
	$(RUN)/mjx-fit bench

docs: $(READY)
	PDOC_ALLOW_EXEC=1 $(RUN)/python docs/build_api.py

paper: $(READY)
	$(RUN)/mjx-fit paper --out runs/paper

clean:
	rm -rf $(VENV) runs dist docs/api

$(READY): pyproject.toml
	@echo "Creating $(VENV) and installing mjx_fit into it: about a minute."
	$(PYTHON) -m venv $(VENV)
	$(RUN)/python -m pip install --quiet --disable-pip-version-check --progress-bar off -e '.[dev]'
	touch $@
