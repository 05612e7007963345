"""One mission after another without a restart of anything: nothing grows, and nobody answers later in the end.

`fsai-vcu hil --soak MINUTES` drives for so long, with `--all` it is one mission more than the suite has.
"""

from __future__ import annotations

import json
import math
import os
import time
from pathlib import Path

import pytest

from chain.conftest import CODEC, DRIVE_S, POWER_UP_S, Chain
from fsai_hil.soak import Sampler, judge, response_parts
from fsai_hil.stack import NODES
from fsai_vcu.interface.enums import AsState

pytestmark = pytest.mark.long  # the suite judges a lap that it drives anyway, in test_missions.py

LAP_S = 35.0  # from power-up to the end of a mission, at the least
SHORT_PERIOD_S, LONG_PERIOD_S = 0.5, 5.0
CAR = "simulated car"
HANDSHAKE_IDS = frozenset((0x510, 0x520))


def test_missions_one_after_another_leave_memory_descriptors_threads_and_response_times_as_they_were(
    chain: Chain, results: Path
) -> None:
    minutes = float(os.environ.get("FSAI_HIL_SOAK_MINUTES", "0"))
    missions = 1 + math.ceil(60.0 * minutes / LAP_S)
    stop_s = time.monotonic() + 60.0 * minutes
    pids = {name: chain.stack.processes[name].popen.pid for name in NODES}
    with chain.car("soak", "--mission", ",".join(["autocross"] * missions), only=HANDSHAKE_IDS) as run:
        pids[CAR] = run.vcu.popen.pid
        chain.autonomous()
        chain.operator.await_state(lambda s: s.as_state == AsState.AS_DRIVING, POWER_UP_S, "AS_DRIVING")
        with Sampler(pids, LONG_PERIOD_S if minutes else SHORT_PERIOD_S) as sampler:
            # The short form begins with the drive; the long one counts from when it has seen a whole mission.
            began_s, began_ns = time.monotonic(), time.time_ns()
            for mission in range(1, missions + 1):
                result = chain.operator.run_mission("autocross", "end", POWER_UP_S + DRIVE_S, None, *NODES)
                assert result.success and result.as_state == "AS_FINISHED" and result.laps == 1, result.message
                if minutes:
                    print(
                        f"{(time.monotonic() - began_s) / 60.0:6.1f} min: mission {mission}: {result.message}",
                        flush=True,
                    )
                if time.monotonic() >= stop_s:
                    break
                if mission == 1:
                    began_s, began_ns = time.monotonic(), time.time_ns()
                # The result may be here before the state that it tells of.
                chain.operator.await_state(lambda s: s.as_state == AsState.AS_FINISHED, POWER_UP_S, "AS_FINISHED")
                chain.operator.await_state(lambda s: s.as_state != AsState.AS_FINISHED, POWER_UP_S, "the next power-up")
    flatness = judge(sampler.since(began_s), response_parts(run.log_path, CODEC, began_ns), unjudged=(CAR,))
    print(f"\n{flatness}", flush=True)
    (results / "soak.json").write_text(json.dumps(flatness.as_dict(), indent=2) + "\n")
    assert flatness.flat, str(flatness)
