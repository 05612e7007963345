"""One mission after another without a restart of anything: nothing grows, and nobody answers later in the end.

`fsai-vcu hil --soak MINUTES` drives for so long, with `--all` it is one mission more than the suite has.
"""

from __future__ import annotations

import json
import math
import os
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from chain.conftest import CODEC, DRIVE_S, POWER_UP_S, Chain
from fsai_hil.rehearsal.soak import Sampler, judge, response_parts
from fsai_hil.rehearsal.stack import NODES
from fsai_hil.rehearsal.stall_monitor import StallMonitor
from fsai_vcu.interface.enums import AsState

pytestmark = pytest.mark.long  # the suite judges a lap that it drives anyway, in test_missions.py

LAP_S = 35.0  # from power-up to the end of a mission, at the least
SHORT_PERIOD_S, LONG_PERIOD_S = 0.5, 5.0
CAR = "simulated car"
HANDSHAKE_IDS = frozenset((0x510, 0x520))


@dataclass(frozen=True)
class Instant:
    """Now, by the clock that everything is judged by and by the one of the bus log."""

    steady_ns: int = field(default_factory=time.monotonic_ns)
    wall_ns: int = field(default_factory=time.time_ns)


Period = tuple[Instant, Instant]


def test_mission_after_mission_nothing_grows(chain: Chain, results: Path, stall_monitor: StallMonitor) -> None:
    """A mission that failed on a disturbed machine shows nothing: reported and left out, and the next one counts."""
    minutes = float(os.environ.get("FSAI_HIL_SOAK_MINUTES", "0"))
    missions = 1 + math.ceil(60.0 * minutes / LAP_S)
    pids = chain.pids
    left_out: list[Period] = []
    with chain.car("soak", "--mission", ",".join(["autocross"] * 2 * missions), only=HANDSHAKE_IDS) as run:
        pids[CAR] = run.vcu.popen.pid
        chain.autonomous()
        chain.operator.await_state(lambda s: s.as_state == AsState.AS_DRIVING, POWER_UP_S, "AS_DRIVING")
        with Sampler(pids, LONG_PERIOD_S if minutes else SHORT_PERIOD_S) as sampler:
            # The short form begins with the drive; the long one counts from when it has seen a whole mission.
            began = Instant()
            driven_s, driven = 0.0, 0
            while True:
                mission = Instant()
                result = chain.operator.run_mission("autocross", "end", POWER_UP_S + DRIVE_S, None, *NODES)
                ended = Instant()
                words = f"{(ended.steady_ns - began.steady_ns) / 60e9:6.1f} min: {result.message}"
                if result.success and result.as_state == "AS_FINISHED" and result.laps == 1:
                    driven += 1
                    driven_s += (ended.steady_ns - mission.steady_ns) / 1e9
                    words += f" (mission {driven})"
                else:
                    disturbed = stall_monitor.disturbed(mission.steady_ns)
                    assert disturbed, result.message
                    left_out.append((mission, ended))
                    words += f": left out, for the machine {disturbed}"
                    assert len(left_out) <= missions // 4, "the machine is disturbed too often to show anything"
                if minutes:
                    print(words, flush=True)
                if driven_s >= 60.0 * minutes:
                    break
                if driven == 1 and not left_out:
                    began, driven_s = Instant(), 0.0
                # The result may be here before the state that it is about.
                over = result.as_state
                chain.operator.await_state(lambda s, over=over: s.as_state_label == over, POWER_UP_S, f"{over}")
                chain.operator.await_state(lambda s, over=over: s.as_state_label != over, POWER_UP_S, "power-up")
                if left_out:
                    chain.autonomous()  # what ends a mission early leaves the mode manual
    flatness = judge(
        sampler.since(began.steady_ns / 1e9, [(a.steady_ns / 1e9, b.steady_ns / 1e9) for a, b in left_out]),
        response_parts(run.log_path, CODEC, began.wall_ns, [(a.wall_ns, b.wall_ns) for a, b in left_out]),
        unjudged=(CAR,),
    )
    print(f"\n{flatness}", flush=True)
    left_out_s = sum(b.steady_ns - a.steady_ns for a, b in left_out) / 1e9
    found = {**flatness.as_dict(), "missions": driven, "left_out": len(left_out), "left_out_s": left_out_s}
    (results / "soak.json").write_text(json.dumps(found, indent=2) + "\n")
    assert flatness.flat, str(flatness)
