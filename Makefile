# `make demo` drives the simulated car on real ROS 2 nodes; `make test` checks everything. Both set up what they need.
SHELL := /bin/bash
BIN := .venv/bin
.PHONY: help setup demo drive test evidence verify missions mutation fuzz campaign explanations soak scrutineering bench bench-planning bench-control rehearsal install uninstall deb rehearse-deb lint format clean
.DEFAULT_GOAL := help

help:  ## show this list
	@grep -hE '^[a-z-]+:.*##' Makefile | sed -E 's/^([a-z-]+):[^#]*## */\1|/' | awk -F'|' '{printf "make %-15s %s\n", $$1, $$2}'

setup:  ## create .venv with everything in it; installs system packages when root, else says which
	@scripts/setup

.PHONY: setup-for-tests
setup-for-tests:  ## setup, and what only tests, lint and long evidence need
	@scripts/setup --for-tests

demo: setup  ## drive a mission on real ROS 2 nodes against the simulated car; prints the verdict, saves plot and log
	@$(BIN)/python -m fsai_hil.rehearsal.demo

drive: setup  ## the nodes and the simulated car until the mission is over, on the screen; ARGS="mission:=skidpad ..."
	@$(BIN)/python -m fsai_nodes.launch simulated_car:=true $(ARGS)

test: setup-for-tests  ## everything: lint, types, tests, HIL on a real vcan0, services under a real systemd
	@scripts/test

evidence: verify mutation campaign explanations missions  ## all of the long evidence, into docs/evidence; goes on where it was stopped

verify: setup  ## search every reachable state of supervisor and gate for a broken rule; then find every seeded fault
	$(BIN)/python -m fsai_hil.evidence --seeded

mutation: setup-for-tests  ## every small mistake in supervisor and gate, and whether a test notices it; takes minutes
	$(BIN)/python -m fsai_hil.evidence.mutation --document

FUZZ_MINUTES ?= 10
fuzz: setup-for-tests  ## strange frames, commands and calls for minutes; then every fault put in on purpose is sought like that
	$(BIN)/python -m fsai_hil.evidence.fuzz --minutes $(FUZZ_MINUTES)
	$(BIN)/python -m fsai_hil.evidence.fuzz --seeded

campaign: setup-for-tests  ## strange frames for minutes, then 10,000 runs with a fault in each; goes on where it was stopped
	$(BIN)/python -m fsai_hil.evidence.fuzz --minutes $(FUZZ_MINUTES)
	$(BIN)/fsai-vcu campaign --resume --renew

explanations: setup  ## logs of faults of every kind, explained from their frames; is what was wrong named?
	$(BIN)/python -m fsai_hil.evidence.explanations

missions: setup  ## every mission, 100 seeds, every condition of the cone sensor; goes on where it was stopped
	$(BIN)/python -m fsai_hil.evidence.missions -o docs/evidence/missions.md

SOAK_MINUTES ?= 30
soak: setup-for-tests  ## drive mission after mission on a real vcan0: do memory, files and response time stay flat?
	$(BIN)/fsai-vcu hil --soak $(SOAK_MINUTES)

scrutineering: setup  ## the handshake's response time on a real vcan0, idle and under load, beside a C loop's; a report
	$(BIN)/fsai-vcu scrutineering

bench: setup  ## speed, as ratios to cantools and python-can, and how soon the bridge node speaks
	$(BIN)/python -m fsai_hil.rehearsal.bench

bench-planning: setup  ## how well and how fast the lane is found, with cones missing, swapped, invented or without colours
	$(BIN)/python -m fsai_hil.rehearsal.bench_planning

bench-control: setup  ## how well the car follows paths and speeds, beside plain pure pursuit; minutes
	$(BIN)/python -m fsai_hil.rehearsal.bench_control

rehearsal: setup-for-tests  ## boot the car PC's services under a real systemd, drive, and break them one by one
	$(BIN)/python -m fsai_hil.rehearsal.carpc

.PHONY: pages docs
pages: setup  ## renew the tables and diagrams in the documentation's pages from code and evidence
	@$(BIN)/python docs/pages.py

docs: setup  ## build the documentation into out/docs, every link checked; installs what that needs
	@$(BIN)/python -c "import material, mkdocstrings_handlers, mmdr" 2>/dev/null || $(BIN)/pip install -q -e ".[docs]"
	@rm -rf out/pages && mkdir -p out/pages
	@git ls-files -coz --exclude-standard '*.md' docs/pictures docs/site.css | xargs -0 cp --parents -t out/pages
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict >out/docs.log 2>&1 || { cat out/docs.log; exit 1; }
	@echo "saved out/docs/index.html; with its search: python3 -m http.server -d out/docs"

install:  ## install as the car's software, as root (or below DESTDIR=...); docs/car.md says what comes next
	@scripts/install-car install

uninstall:  ## take it away again; configuration and logs are kept
	@scripts/install-car uninstall

deb:  ## a Debian package that needs no network where it is installed, in out/deb
	@scripts/install-car deb

rehearse-deb:  ## install that package in bare chroots of SUITES (debootstrap), drive, upgrade, purge; as root, minutes
	@scripts/rehearse-deb $(SUITES)

lint: setup-for-tests  ## ruff and mypy
	@scripts/test lint types

format: setup-for-tests  ## put the code into ruff's format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:  ## remove .venv and everything made by tests and runs
	rm -rf .venv out .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find fsai_vcu hil nodes tests -name __pycache__ -prune -exec rm -rf {} +
