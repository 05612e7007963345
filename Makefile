# `make demo` drives the simulated car on real ROS 2 nodes; `make test` checks everything. Both set up what they need.
SHELL := /bin/bash
BIN := .venv/bin
LINTED := fsai_vcu hil nodes tests

.PHONY: help setup demo test verify lint format clean
.DEFAULT_GOAL := help

help:  ## show this list
	@grep -hE '^[a-z-]+:.*##' Makefile | sed -E 's/^([a-z-]+):[^#]*## */\1|/' | awk -F'|' '{printf "make %-8s %s\n", $$1, $$2}'

setup:  ## create .venv with everything in it; installs system packages when root, else says which
	@scripts/setup

demo: setup  ## drive a mission on real ROS 2 nodes against the simulated car; prints the verdict, saves plot and log
	@$(BIN)/python -m fsai_hil.demo

test: setup lint  ## everything: lint, types, tests, and the HIL suite on a real vcan0
	$(BIN)/pytest -q --ignore=tests/hil
	$(BIN)/fsai-vcu hil

verify: setup  ## search every reachable state of supervisor and gate for a broken rule; then find every seeded fault
	$(BIN)/python -m fsai_hil.evidence --seeded

lint: setup  ## ruff and mypy
	$(BIN)/ruff check $(LINTED)
	$(BIN)/ruff format --check $(LINTED)
	$(BIN)/mypy --strict fsai_vcu

format: setup  ## put the code into ruff's format
	$(BIN)/ruff format $(LINTED)
	$(BIN)/ruff check --fix $(LINTED)

clean:  ## remove .venv and everything made by tests and runs
	rm -rf .venv out .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find fsai_vcu hil nodes tests -name __pycache__ -prune -exec rm -rf {} +
