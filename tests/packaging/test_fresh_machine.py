"""The rehearsal on machines that have nothing: its trials are there, and it says why none can be made."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]
SCRIPT = CHECKOUT / "scripts" / "fresh-machine"
RECORD = CHECKOUT / "docs" / "evidence" / "fresh-machines.json"


def fresh_machine(*words: str, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, SCRIPT, *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]


def test_what_is_no_trial_is_refused_before_anything_is_made() -> None:
    for words in (["stretch"], ["bookworm/nothing"], ["trixie", "--shrt"]):
        done = fresh_machine(*words)
        assert done.returncode == 2 and words[-1] in done.stderr


def test_help_says_what_may_be_tried() -> None:
    done = fresh_machine("--help")
    assert done.returncode == 0 and "scripts/fresh-machine --list" in done.stdout


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_an_ordinary_user_is_told_why_no_chroot_is_made() -> None:
    known = runpy.run_path(str(SCRIPT))["hindrance"]
    child = os.fork()
    if child == 0:
        status = 1
        try:  # whatever happens, it must not go on as a second pytest
            os.setuid(65534)
            status = 0 if "made by root" in known() else 1
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_the_commands_of_devcontainer_and_workflow_are_found() -> None:
    packages, safe, everything = runpy.run_path(str(SCRIPT))["container_commands"]()
    assert "apt-get install" in packages and "safe.directory" in safe and everything == ".ci/run"
    container = json.loads((CHECKOUT / ".devcontainer/devcontainer.json").read_text())
    assert "apt-get install" in container["onCreateCommand"] and "make setup" in container["postCreateCommand"]


def test_what_is_recorded_are_trials_that_there_are() -> None:
    trials = runpy.run_path(str(SCRIPT))["TRIALS"]
    rows = json.loads(RECORD.read_text())
    assert rows
    for row in rows:
        assert row["trial"].partition("/")[2] in trials
        assert row["passed"] == (row["failed"] == "") and row["date"] and row["system"]
