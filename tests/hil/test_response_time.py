"""The short form of `fsai-vcu scrutineering`: the VCU is answered within its own limits, whatever else goes on."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fsai_hil.rehearsal.scrutineering.conditions import SHORT, conditions_named
from fsai_hil.rehearsal.scrutineering.measurement import Measurement
from fsai_hil.rehearsal.scrutineering.report import failures, summary

pytestmark = pytest.mark.long  # minutes: with `fsai-vcu hil --all`

SECONDS = 3.0


def test_the_vcu_is_answered_in_time_idle_and_under_full_load(interface: str, results: Path) -> None:
    in_uml = os.environ.get("FSAI_HIL_PLACE") == "uml"
    measured = Measurement(interface, results, seconds=SECONDS, slow_place=in_uml).run(conditions_named(SHORT))
    print(summary(measured))
    assert failures(measured) == [], summary(measured)
    for row in measured["conditions"]:
        if row["log_complete"]:
            assert row["rules_broken"] == [], row["rules_broken"]
