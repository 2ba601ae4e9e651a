# prolearn: `make help` lists the targets.
SHELL := /bin/bash
.DEFAULT_GOAL := help

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
JOBS ?= -1
DATA ?= data/paper
PORT ?= 5000
FF := ff1,ff2,ffcol
LSTM := lstm1,lstm2,lstmcol
REFINER := refiner

export MLFLOW_DISABLE_TELEMETRY := true
# Else the UI starts eight more processes, for evaluations of language models.
export MLFLOW_SERVER_ENABLE_JOB_EXECUTION := false

# Modules are compiled once and kept, also where the environment says otherwise: every command starts faster.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo demo-ff demo-lstm demo-refiner demo-flights demo-evaluate demo-warmstart demo-plain demo-times dataset train train-all evaluate warmstart transfer-times flights report paper ui test coverage torture lint bench docs lock release clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "%-16s%s\n", $$1, $$2}'

TOO_OLD := prolearn needs Python 3.11 or later; $(PYTHON) is %d.%d: make PYTHON=python3.13, or another

# torch by pip's own choice of build, with CUDA or without; all else as it is locked, and no resolver:
# by uv, which takes a fifth of pip's time and trusts the certificates of the system as pip does, and
# by pip where uv reaches no index that pip's own settings name.
INSTALL = $(BIN)/uv pip install --quiet --system-certs --python $(BIN)/python --no-deps --requirement $(1) || \
	$(BIN)/python -m pip install --quiet --no-compile --no-deps --requirement $(1)

$(VENV)/made: requirements/run.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info; v < (3, 11) and sys.exit("$(TOO_OLD)" % v[:2])'
	$(PYTHON) -m venv --clear $(VENV)  # without what another Python or an earlier lock installed
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt torch setuptools uv
	$(call INSTALL,requirements/run.txt)
	@touch $@

$(BIN)/prolearn: $(VENV)/made pyproject.toml setup.py $(wildcard pipeline/*/*.c pipeline/*/*/*.c)
	rm -rf prolearn.egg-info  # of an earlier version, which would be taken for the installed one
	$(BIN)/python -m pip install --quiet --no-compile --no-deps --editable .
	@touch $@

$(BIN)/pytest: $(BIN)/prolearn requirements/test.txt
	$(call INSTALL,requirements/test.txt)
	@touch $@

$(BIN)/sphinx-build: $(BIN)/prolearn requirements/docs.txt
	$(call INSTALL,requirements/docs.txt)
	@touch $@

# Keeps the lines of targets at work at once apart; GNU make 3.81, which macOS has, cannot.
SYNC = $(if $(filter output-sync,$(.FEATURES)),--output-sync)
DEMO = OMP_NUM_THREADS=1 $(BIN)/prolearn
demo: $(BIN)/prolearn ## the whole pipeline at small scale: dataset, seven networks, experiments, report
	$(BIN)/prolearn dataset --preset demo --out data/demo --jobs $(JOBS)
	$(MAKE) --jobs 2 $(SYNC) demo-lstm demo-ff demo-refiner
	$(MAKE) --jobs 2 $(SYNC) demo-flights demo-evaluate demo-warmstart demo-plain demo-times
	$(BIN)/prolearn report --out reports
	@echo "Report: reports/report.html. Compare the runs in the MLflow UI: make ui"

demo-ff:
	$(DEMO) train --arch $(FF) --recipe tuned --data data/demo
	$(DEMO) train --arch $(FF) --recipe paper --data data/demo
demo-lstm:
	$(DEMO) train --arch $(LSTM) --recipe tuned --data data/demo --epochs 5
	$(DEMO) train --arch $(LSTM) --recipe paper --data data/demo --epochs 5
demo-refiner:
	$(DEMO) train --arch $(REFINER) --recipe tuned --data data/demo --epochs 3 --crowded 500
demo-flights:
	$(DEMO) flights --data data/demo --trials 5 --flights 4 --jobs 1
demo-evaluate:
	$(DEMO) evaluate --data data/demo --timed 5 --jobs $(JOBS)
demo-warmstart:
	$(DEMO) warmstart --data data/demo --n 10,30 --trials 10
demo-plain:
	$(DEMO) warmstart --data data/demo --optimizer plain --trials 4
demo-times:
	$(DEMO) transfer-times --data data/demo --nodes 6,11,21 --trials 10 --jobs $(JOBS)

dataset: $(BIN)/prolearn ## the paper's dataset: 10,000 scenarios of n=10, 100 of each n=2..30, some of 60, 100, 300
	$(BIN)/prolearn dataset --preset paper --out $(DATA) --jobs $(JOBS)

EPOCHS ?=
ARCH ?= ff1
RECIPE ?= tuned
train: $(BIN)/prolearn ## one network: make train ARCH=lstm2 RECIPE=paper
	$(BIN)/prolearn train --arch $(ARCH) --recipe $(RECIPE) --data $(DATA) $(EPOCHS:%=--epochs %)

SEEDS ?= 1
LSTM_SEEDS ?= $(SEEDS)
REFINER_SEEDS ?= $(SEEDS)
seeds = $(shell seq 0 $$(($(1) - 1)) | paste -s -d , -)
train-all: $(BIN)/prolearn ## the six networks in both recipes and the refiner in its own, each trained SEEDS times
	for recipe in tuned paper; do \
	  for family in "$(FF) --seed $(call seeds,$(SEEDS))" "$(LSTM) --seed $(call seeds,$(LSTM_SEEDS))"; do \
	    $(BIN)/prolearn train --arch $$family --recipe $$recipe --data $(DATA) $(EPOCHS:%=--epochs %) --resume || exit; \
	  done; \
	done
	$(BIN)/prolearn train --arch $(REFINER) --seed $(call seeds,$(REFINER_SEEDS)) --recipe tuned --data $(DATA) $(EPOCHS:%=--epochs %) --resume

evaluate: $(BIN)/prolearn ## experiments 1 and 2, and swarms beyond n=30
	$(BIN)/prolearn evaluate --data $(DATA) --jobs $(JOBS) --resume

warmstart: $(BIN)/prolearn ## experiment 3, with the expert and with a plain SCP
	$(BIN)/prolearn warmstart --data $(DATA) --resume
	$(BIN)/prolearn warmstart --data $(DATA) --optimizer plain --n 10 --trials 100 --resume

transfer-times: $(BIN)/prolearn ## experiment 4
	$(BIN)/prolearn transfer-times --data $(DATA) --jobs $(JOBS) --resume

flights: $(BIN)/prolearn ## experiment 5
	$(BIN)/prolearn flights --data $(DATA) --jobs $(JOBS) --resume

report: $(BIN)/prolearn ## tables and figures from the newest results
	$(BIN)/prolearn report --out reports

paper: dataset train-all evaluate warmstart transfer-times flights report ## the whole paper: finished stages are skipped; SEEDS=3 trains each network thrice

ui: $(BIN)/prolearn ## the MLflow UI on the project's store
	$(BIN)/python -c 'from registry.store import connect; connect()'
	@case "$$MLFLOW_TRACKING_URI" in \
	  http:* | https:*) echo "The tracking server that MLFLOW_TRACKING_URI names has the UI: open its address." ;; \
	  *) $(BIN)/mlflow ui --backend-store-uri "$${MLFLOW_TRACKING_URI:-sqlite:///mlflow.db}" --port $(PORT) ;; \
	esac

MARKS ?= system or not system
test: $(BIN)/pytest $(BIN)/sphinx-build ## the tests; MARKS="not system" without those that need a browser, servers or kills
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal -m "$(MARKS)" $(COVER)

coverage: $(BIN)/pytest ## the tests, and the lines of each file that none of them runs
	rm -f .coverage .coverage.*
	$(MAKE) test COVER="--cov --cov-report="
	$(BIN)/coverage report

KILLS ?= 100
FLIPS ?= 500
torture: $(BIN)/pytest ## kill commands and damage files at random, and see what is lost; half an hour
	PYTHONPATH=.:tests/support $(BIN)/python -m torture --kills $(KILLS) --flips $(FLIPS) --page docs/robustness.md

lint: $(BIN)/pytest ## ruff, mypy, import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(BIN)/prolearn ## how fast the expert and a training epoch are, beside their peers; published cases
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable '.[bench]'
	$(BIN)/python -m benchmarks.expert --out reports/bench
	$(BIN)/python -m benchmarks.training --out reports/bench
	$(BIN)/python -m benchmarks.fallback --out reports/bench
	$(BIN)/python -m benchmarks.yardstick
	$(BIN)/python -m benchmarks.growth

docs: $(BIN)/sphinx-build ## the documentation as pages, in build/docs
	$(BIN)/typer cli.main utils docs --name prolearn --title Commands --output docs/commands.md
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going docs build/docs
	@echo "Documentation: build/docs/index.html"

UPGRADE ?=
UNIVERSAL = $(BIN)/uv pip compile pyproject.toml --quiet --system-certs --universal --python-version 3.11.2 --no-annotate --custom-compile-command 'make lock' $(UPGRADE)
lock: $(BIN)/prolearn ## exact versions for every Python and platform; UPGRADE=--upgrade takes the newest
	$(UNIVERSAL) --all-extras --output-file constraints.txt
	$(UNIVERSAL) --constraint constraints.txt --output-file requirements/light.txt
	$(UNIVERSAL) --constraint constraints.txt --extra learn --output-file requirements/run.txt
	$(UNIVERSAL) --constraint constraints.txt --extra dev --output-file requirements/test.txt
	$(UNIVERSAL) --constraint constraints.txt --extra docs --output-file requirements/docs.txt

TRY := build/release
release: $(BIN)/prolearn ## sdist and wheel in dist/, checked, and the wheel tried in a fresh environment
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt build twine
	rm -rf $(TRY) dist
	$(BIN)/python -m build --no-isolation
	$(BIN)/twine check --strict dist/*
	! $(BIN)/python -m zipfile -l dist/*.whl | grep -E '^(tests|benchmarks|docs)/'
	$(PYTHON) -m venv $(TRY)
	$(TRY)/bin/python -m pip install --quiet --no-compile --constraint constraints.txt torch
	$(TRY)/bin/python -m pip install --quiet --no-compile --no-deps --requirement requirements/run.txt
	$(TRY)/bin/python -m pip install --quiet --no-index --no-deps --find-links dist prolearn
	cd $(TRY) && bin/prolearn --help > help.txt && bin/prolearn scenario new swarm.json --from craft=3,size=150 --to craft=3,size=100
	cd $(TRY) && bin/prolearn plan swarm.json --out plan.json && bin/prolearn plan swarm.json --planner refiner --out plan.json

clean: ## remove what make made, datasets and results included
	rm -rf $(VENV) data reports mlruns mlflow.db* optuna.db* unregistered *.egg-info build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
