"""Each preset of ackermann_adapter with a stand-in of that team's stack drives to AS_FINISHED. Run by `make adapters`.

Each takes a minute, so they are not among the tests that pytest finds by itself; scripts/test names one.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from ros_rig import driven

from fsai_nodes.adapter_presets import PRESETS

STACK = Path(__file__).with_name("team_stack.py")


@pytest.mark.parametrize("preset", PRESETS)
def test_a_teams_stack_drives_the_acceleration_to_as_finished(tmp_path: Path, preset: str) -> None:
    adapter = f"fsai_nodes.ackermann_adapter --ros-args -p preset:={preset}"
    said = driven(tmp_path, "--mission", "acceleration", "--with", adapter, "--with", f"{STACK} {preset}")
    assert "acceleration: PASS" in said
