# Six verbs: demo, test, lint, bench, paper, clean. Each works in a fresh clone.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test lint bench paper clean

demo: $(READY)
	$(RUN)/mjx-fit demo

test: lint
	$(RUN)/pytest -n 2 --dist loadfile

lint: $(READY)
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/basedpyright --pythonpath $(RUN)/python
	$(RUN)/lint-imports

bench: $(READY)
	$(RUN)/mjx-fit bench

paper: $(READY)
	$(RUN)/mjx-fit paper --out runs/paper

clean:
	rm -rf $(VENV) runs dist

$(READY): pyproject.toml
	@echo "Creating $(VENV) and installing mjx_fit into it: about a minute."
	$(PYTHON) -m venv $(VENV)
	$(RUN)/python -m pip install --quiet --disable-pip-version-check --progress-bar off -e '.[dev]'
	touch $@
