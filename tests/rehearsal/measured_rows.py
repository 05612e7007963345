"""Results of rehearsals that nobody had to run: for tests of what is made of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fsai_hil.rehearsal.scrutineering.conditions import BY_NAME
from fsai_hil.rules.response import ResponseTimes
from fsai_vcu.interface.units import MS


def row(name: str = "idle", response_ns: Iterable[int] = range(MS, 3 * MS, 1000), **changes: Any) -> dict[str, Any]:
    """A condition in which everything went well, but for `changes`."""
    times = ResponseTimes(response_ns).as_dict()
    wire = ResponseTimes([MS // 2] * times["count"]).as_dict()
    slower = ResponseTimes([200 * MS]).as_dict()
    return {
        "name": name,
        "words": BY_NAME[name].words,
        "seconds": 20.0,
        "response": times,
        "status_late": ResponseTimes([MS // 2]).as_dict(),
        "comms_losses": 0,
        "held_up_ms": 0.0,
        "wire": wire,
        "rules_broken": [],
        "log_complete": True,
        "frames_per_s": 1350,
        "bus_load_pct": 25.0,
        "machine_stalls_ms": [],
        "ended_early": "",
        "stood": "",
        "peer": {"response": slower, "wire": slower, "comms_losses": 0},
        **changes,
    }


def measured(*rows: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """What the rehearsal hands over."""
    machine = {
        "kernel": "Linux 6.1",
        "processor": "a processor",
        "processors": 4,
        "memory_gib": 16.0,
        "python": "3.11.7",
        "system": "Debian",
    }
    scheduling = {"policy": "SCHED_FIFO", "priority": 45, "memory_locked": True}
    return {
        "revision": "2026",
        "seconds_per_condition": 20.0,
        "machine": machine,
        "scheduling": {"CAN loop": scheduling, "vcu": {**scheduling, "priority": 35}},
        "decimation": {"gps": 1, "log": 1},
        "comms_losses_between": 0,
        "not_measured": {},
        "conditions": list(rows) or [row()],
        **changes,
    }


def reported(*rows: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """What the report is made of."""
    whole = measured(*rows)
    surroundings = {
        "place": "native",
        "pace": 1.0,
        "date": "2026-06-01 12:00 UTC",
        "host": whole["machine"],
        "versions": {"fsai-vcu": "0.1.0"},
        "source": "abcdef",
    }
    return {**whole, **surroundings, **changes}
