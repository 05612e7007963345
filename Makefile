# `make demo` drives the simulated car on real ROS 2 nodes; `make test` checks everything. Both set up what they need.
SHELL := /bin/bash
VENV ?= .venv
BIN := $(VENV)/bin
export VENV
MAKEFLAGS += --no-builtin-rules
.DEFAULT_GOAL := help
.PHONY: $(shell sed -nE 's/^([a-z-]+):.*/\1/p' Makefile)

help:  ## show this list
	@awk -F':.*## ' '/^##@/ {print "\n" substr($$0, 5)} /^[a-z-]+:.*## / {printf "  make %-16s %s\n", $$1, $$2}' Makefile

# What somebody mistyped.
.DEFAULT:
	@echo "make: there is no target '$@'; all there are: make help" >&2; exit 2
Makefile: ;

##@ First minutes
demo: setup  ## drive a mission on real ROS 2 nodes against the simulated car; prints the verdict, saves plot and log
	@$(BIN)/python -m fsai_hil.rehearsal.demo

demo-everywhere:  ## the demo on every Python of this machine that fits, each in an environment of its own (out/python3.X)
	@source scripts/environment.bash; failed=; \
	for python in $$(every_python); do \
	  $(MAKE) demo PYTHON=$$python VENV=out/$${python##*/} || failed+=" $$python"; \
	done; \
	[[ ! $$failed ]] || { echo "demo-everywhere: failed on$$failed" >&2; exit 1; }

drive: setup  ## nodes, simulated car, pit wall and recording until the mission is over or Ctrl-C; ARGS="mission:=skidpad ..."
	@run=$$(date +%Y-%m-%d_%H-%M-%S); mkdir -p out/runs; ln -sfn $$run out/runs/latest; \
	$(BIN)/python -m fsai_nodes.launch simulated_car:=true pitwall:=true record:=out/runs/$$run $(ARGS)

setup:  ## .venv with everything in it; installs system packages when root, else says which; what needs it does it first
	@scripts/setup

##@ While you work
test: setup-for-tests  ## everything: lint, types, tests, HIL on a real vcan0, services under a real systemd
	@scripts/test

test-long: setup-for-tests  ## the tests that take long and repeat in full what make test shows in short; minutes
	FSAI_LONG_TESTS=1 $(BIN)/pytest -q -n auto -m long --ignore=tests/hil tests

humble: setup-for-tests  ## the nodes' tests on rclpy reduced to what Humble's has; minutes
	PYTHONPATH=$(CURDIR)/tests/nodes/humble $(BIN)/pytest -q tests/nodes

adapters: setup-for-tests  ## a stand-in of each team's stack drives through ackermann_adapter; minutes
	$(BIN)/pytest -q tests/nodes/adapter_drives.py

lint: setup-for-tests  ## ruff and mypy
	@scripts/test lint types

format: setup-for-tests  ## put the code into ruff's format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

setup-for-tests:  ## setup, and what only tests, lint and long evidence need
	@scripts/setup --for-tests

clean:  ## remove .venv and everything made by tests and runs
	rm -rf .venv out dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find fsai_vcu hil nodes tests -name __pycache__ -prune -exec rm -rf {} +

##@ Is it safe? Each prints figures, and fails when a rule breaks
evidence: verify mutation campaign explanations missions planning pages  ## all of it, into docs; goes on where it was stopped

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
	$(BIN)/fsai-vcu campaign --resume -o docs/evidence/faults.md

explanations: setup  ## logs of faults of every kind, and of other cars and AI computers; is what was wrong named?
	$(BIN)/python -m fsai_hil.evidence.explanations -o docs/evidence/explanations.md

missions: setup  ## every mission, 100 seeds, every condition of the cone sensor (goes on where it was stopped); laps beside their bounds
	$(BIN)/python -m fsai_hil.evidence.missions -o docs/evidence/missions.md
	$(BIN)/python -m fsai_hil.bench laps --laps 10 -o docs/evidence/laps.md

SOAK_MINUTES ?= 30
soak: setup-for-tests  ## drive mission after mission on a real vcan0: do memory, files and response time stay flat?
	$(BIN)/fsai-vcu hil --soak $(SOAK_MINUTES)

rehearsal: setup-for-tests  ## boot the car PC's services under a real systemd, drive, and break them one by one
	$(BIN)/python -m fsai_hil.rehearsal.carpc

##@ Is it fast, and good?
scrutineering: setup  ## the handshake's response time on a real vcan0, idle and under load, beside a C loop's; a report
	$(BIN)/fsai-vcu scrutineering

bench: setup-for-tests  ## speed, as ratios to cantools and python-can, and how soon the bridge node speaks; minutes
	$(BIN)/python -m fsai_hil.bench speed $(ARGS)

bench-check: setup-for-tests  ## bench; fails where a ratio fell below docs/evidence/bench.json; ARGS=--write renews that
	$(BIN)/python -m fsai_hil.bench speed --check $(ARGS)

bench-planning: setup  ## how well and how fast the lane is found, with cones missing, swapped, invented or without colours
	$(BIN)/python -m fsai_hil.bench planning

planning: setup  ## the same on 70 generated circuits, into docs; TRACKS="FILE.csv …": more; 15 minutes
	$(BIN)/python -m fsai_hil.bench planning -o docs/evidence/planning.md $(TRACKS) $$(seq -f generated-%.0f 50) $$(seq -f generated-%.0f-islands 20)

bench-control: setup  ## how well the car follows paths and speeds, beside plain pure pursuit; minutes
	$(BIN)/python -m fsai_hil.bench control

bench-laps: setup  ## how fast laps are driven, beside the least time that the car's forces allow; minutes
	$(BIN)/python -m fsai_hil.bench laps

# Attached to a process that runs, for which some systems want root: of one that it starts, py-spy looks at an
# interpreter that is not ready.
SPY = $(BIN)/py-spy record --function --rate 100 --output
profile: setup-for-tests  ## where the time goes, as the pictures of docs/profiles.md: CAN loop, decoding, planning
	mkdir -p out && $(BIN)/fsai-vcu drive --mission trackdrive --log out/profile.log
	for _ in {1..10}; do cat out/profile.log; done >out/profile-long.log
	watched() { \
	  taskset -c 0 $(BIN)/python -m "$${@:2}" >/dev/null 2>&1 & \
	  until grep -q numpy /proc/$$!/maps; do kill -0 $$! || return; sleep 0.01; done; \
	  $(SPY) docs/pictures/profile-$$1.svg --pid $$! || { kill $$!; return 1; }; \
	  wait $$!; \
	}; \
	watched loop fsai_hil.bench.loop && \
	  watched decode fsai_vcu.cli.main decode out/profile-long.log && \
	  watched planning fsai_hil.bench planning --condition ideal

##@ For others
install:  ## install as the car's software, as root, who only copies (or below DESTDIR=...); docs/car.md says what comes next
	@scripts/install-car install

uninstall:  ## take it away again; configuration and logs are kept
	@scripts/install-car uninstall

lock: setup  ## renew the versions and hashes of all that the car gets (scripts/locks); asks the package index
	@$(BIN)/python -c "import uv" 2>/dev/null || $(BIN)/pip install -q "uv>=0.9,<1"
	@scripts/lock-car $(BIN)/python

deb:  ## a Debian package that needs no network where it is installed, in out/deb
	@scripts/install-car deb

rehearse-deb:  ## install that package in bare chroots of SUITES (debootstrap), drive, upgrade, purge; as root, minutes
	@scripts/rehearse-deb $(SUITES)

fresh-machine:  ## the two commands (on Ubuntu the demo), and more, in bare chroots of four distributions, as root; TRIALS="trixie noble/deb ...": these
	@scripts/fresh-machine $(TRIALS)

wheel: setup  ## the wheel and the sdist, in dist; fsai-vcu drive works from it: pipx install dist/*.whl
	@$(BIN)/python -c "import hatchling" 2>/dev/null || $(BIN)/pip install -q "hatchling>=1.24,<2"
	$(BIN)/python -m hatchling build -d dist

docs: setup  ## build the documentation into out/docs, every link checked; installs what that needs
	@$(BIN)/python -c "import material, mkdocstrings_handlers, mmdr" 2>/dev/null || $(BIN)/pip install -q -e ".[docs]"
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python docs/site.py out

pages: setup  ## renew the tables and diagrams in the documentation's pages from code and evidence
	@$(BIN)/python docs/pages.py
