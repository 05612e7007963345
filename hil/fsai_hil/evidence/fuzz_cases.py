"""Makes cases: fresh ones from a seed, and changed ones from cases that reached something new.

A case is made from its lineage alone: "7" is the case of seed 7, "7.31.4" is that case changed with seed 31 and the
result changed again with seed 4; "tour-5-7" is the fifth kind of happening with seed 7. So a case can be made anew
without the run in which it came up.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import fields
from random import Random
from typing import Any, Final

from fsai_hil.evidence.fuzz_events import SETUPS, STATIONS, FuzzCase, FuzzEvent, event
from fsai_vcu.interface.bus_table import BUS_TABLE
from fsai_vcu.interface.messages import Faults
from fsai_vcu.interface.reserved import AI_IDS

# Cycles of 10 ms about the times at which something runs out, and far from them.
_CYCLES: Final = (1, 1, 1, 2, 2, 3, 4, 5, 6, 9, 10, 11, 14, 20, 29, 30, 31, 32, 49, 51, 59, 61, 69, 71, 99, 101, 120)
_LONG_CYCLES: Final = (150, 200, 299, 300, 301, 310, 330)
_MS: Final = (0.5, 5.0, 9.999999, 10.0, 15.0, 20.0, 49.999999, 50.0, 50.000001, 60.0, 99.999999, 100.0, 100.000001)
_LONG_MS: Final = (150.0, 299.999999, 300.0, 400.0, 500.0, 700.0, 999.999999, 1000.0, 1000.000001, 1500.0, 3000.0)
_NUMBERS: Final = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, 1e-300, 1e308, -1e308, 1.0, -1.0, 1.0000001, 2.0, 0.5, 1e-9, -1e-9
)  # fmt: skip
_AGES_MS: Final = (
    0.0, 0.0, 10.0, 99.0, 400.0, 499.999999, 500.0, 500.000001, 700.0, 5000.0, 1e12, -10.0, -20.0, -20.000001, -50.0,
    -400.0, -1e12,
)  # fmt: skip
_READY_CYCLES: Final = 495  # of AS_READY with Go off, before a drive counts as begun in order
_FAULT_BITS: Final = tuple(bit.name for bit in fields(Faults))
_STATE_WALK: Final = (1, 2, 3, 5, 1, 4, 0)
_CAR_IDS: Final = tuple(one.can_id for one in BUS_TABLE if one.can_id not in AI_IDS)
_VITAL_IDS: Final = (0x520, 0x521, 0x522, 0x523, 0x524, 0x525, 0x526)
MODES: Final = (
    "manual",
    "autonomous",
    "autonomous",
    "AUTONOMOUS",
    "",
    "Manual ",
    "sideways",
    "autonomous\x00",
    "ä" * 300,
)
_FIELDS: Final[dict[str, tuple[tuple[str, tuple[Any, ...]], ...]]] = {
    "VcuStatus": (
        ("as_state", (0, 1, 2, 3, 4, 5)),
        ("ami", (0, 1, 2, 3, 4, 5, 6, 7)),
        ("go_signal", (False, True)),
        ("fault", (False, True)),
        ("shutdown_request", (False, True)),
        ("as_switch", (False, True)),
        ("ts_switch", (False, True)),
        ("shutdown_cause", (0, 1, 11)),
        ("handshake", (False, True)),
    ),
    "VcuDriveFront": (("torque_max_nm", (0.0, 0.1, 50.0, 195.0)), ("torque_nm", (-195.0, 195.0))),
    "VcuDriveRear": (("torque_max_nm", (0.0, 0.1, 50.0, 195.0)), ("torque_nm", (-195.0, 195.0))),
    "VcuSteer": (("angle_max_deg", (0.0, 0.1, 5.0, 30.0)), ("angle_deg", (-30.0, 0.0, 30.0))),
    "VcuBrake": (("front_request_pct", (0.0, 0.5, 100.0)), ("rear_request_pct", (0.0, 0.5, 100.0))),
    "WheelSpeeds": (("fl_rpm", (0, 9, 10, 300, 1250)), ("rr_rpm", (0, 9, 10, 701, 1250))),
    "WheelCounts": (("rl", (0, 1, 65535)), ("rr", (0, 32768))),
    "LogDynamics1": (("speed_actual_kmh", (0, 255)),),
    "LogStatus": (("lap_counter", (0, 15)),),
    "RotationB": (("z_degps", (0.0, 1e30, -1e30)),),
    "GpsDateTime": (("year", (0, 255)),),
}

Maker = Callable[[Random], list[FuzzEvent]]


def _run(chance: Random) -> FuzzEvent:
    return event("run", cycles=chance.choice(_LONG_CYCLES if chance.random() < 0.06 else _CYCLES))


def _ms(chance: Random) -> float:
    return chance.choice(_LONG_MS if chance.random() < 0.3 else _MS)


def _car(chance: Random) -> list[FuzzEvent]:
    match chance.randrange(5):
        case 0:
            says: dict[str, Any] = {"as_state": chance.choice(_STATE_WALK)}
        case 1:
            says = {"go": chance.random() < 0.5}
        case 2:
            says = {"fault": chance.random() < 0.5}
        case 3:
            says = {"ami": chance.randrange(8)}
        case _:
            says = {"as_state": chance.randrange(6), "go": chance.random() < 0.7, "ami": chance.choice((0, 2, 4, 4, 5))}
    return [event("car", **says)]


def _next_run(chance: Random) -> list[FuzzEvent]:
    """The whole way to a drive once more, with what may be wrong on it."""
    events = [
        event("car", as_state=chance.choice((5, 4, 3)), go=False),
        event("run", cycles=2),
        event("car", as_state=chance.choice((0, 1, 1)), go=False),
        event("run", cycles=chance.choice((2, 3, 60))),
        event("service", name="reset"),
        event("service", name="mode", text="autonomous"),
        event("run", cycles=3),
        event("car", as_state=2),
        event("run", cycles=_READY_CYCLES),
        event("car", as_state=3, go=True),
        event("run", cycles=305),
        event("run", cycles=20),
    ]
    if chance.random() < 0.4:
        del events[chance.randrange(len(events))]
    return events


def _wheels(chance: Random) -> list[FuzzEvent]:
    match chance.randrange(4):
        case 0:
            rpm: list[int] | None = None
        case 1:
            rpm = [chance.choice((0, 9, 10, 11, 200, 300, 301, 701))] * 4
        case 2:
            rpm = [chance.randrange(1251) for _ in range(4)]
        case _:
            rpm = [chance.choice((0, 230))] * 4
            rpm[chance.randrange(4)] = chance.choice((0, 9, 10, 500, 1250))
    return [event("wheels", rpm=rpm)]


def _steering(chance: Random) -> list[FuzzEvent]:
    return [event("steering", deg=chance.choice((None, None, 0.0, 3.0, -29.9, 29.9)))]


def _limits(chance: Random) -> list[FuzzEvent]:
    return [
        event(
            "limits",
            angle_deg=chance.choice((0.0, 0.1, 2.0, 10.0, 21.0, 30.0, 30.0)),
            front_nm=chance.choice((0.0, 40.0, 195.0)),
            rear_nm=chance.choice((0.0, 0.1, 40.0, 195.0)),
        )
    ]


def _mute(chance: Random) -> list[FuzzEvent]:
    ids = [chance.choice(_VITAL_IDS)] if chance.random() < 0.7 else chance.sample(_VITAL_IDS, chance.randrange(2, 8))
    cycles = chance.choice((1, 4, 5, 9, 10, 11, 29, 30, 31, 99, 100, 101))
    return [
        event("mute", ids=ids, cycles=cycles),
        event("run", cycles=cycles + chance.choice((-1, 0, 1, 1, 2, 5)) or 1),
    ]


def _frame(chance: Random) -> list[FuzzEvent]:
    match chance.randrange(6):
        case 0:
            can_id = chance.choice(AI_IDS)
        case 1 | 2:
            can_id = chance.choice(_CAR_IDS)
        case 3:
            can_id = 0x520
        case _:
            can_id = chance.randrange(1 << chance.choice((11, 11, 29)))
    length = chance.choice((0, 1, 2, 4, 5, 6, 7, 8, 8, 8, 8, 9, 12, 64))
    fill = chance.choice(("random", "random", "zeros", "ones"))
    data = chance.randbytes(length) if fill == "random" else bytes([0 if fill == "zeros" else 255]) * length
    kind = chance.choice(("standard",) * 7 + ("extended", "remote", "error")) if can_id < 0x800 else "extended"
    return [event("frame", id=can_id, data="" if kind == "remote" else data.hex(), kind=kind)]


def _storm(chance: Random) -> list[FuzzEvent]:
    """The same strange frame again and again in the midst of the ordinary ones."""
    (frame,) = _frame(chance)
    return [one for _ in range(chance.randrange(2, 12)) for one in (frame, event("run", cycles=1))]


def _says(chance: Random) -> list[FuzzEvent]:
    image = chance.choice(("VcuStatus", "VcuStatus", *_FIELDS))
    name, values = chance.choice(_FIELDS[image])
    return [event("says", image=image, field=name, value=chance.choice(values))]


def _flip(chance: Random) -> list[FuzzEvent]:
    return [event("flip", id=chance.choice(_VITAL_IDS), bit=chance.randrange(64))]


def _number(chance: Random, low: float, high: float) -> float:
    return chance.choice(_NUMBERS) if chance.random() < 0.15 else round(chance.uniform(low, high), 3)


def fields_of_a_command(chance: Random) -> dict[str, Any]:
    """Some fields of a command, told as nobody in his right mind would."""
    makers: dict[str, Callable[[], Any]] = {
        "steering_rad": lambda: _number(chance, -0.5, 0.5),
        "throttle": lambda: chance.choice((0.0, 0.4, 1.0, _number(chance, 0.0, 1.0))),
        "brake": lambda: chance.choice((0.0, 0.0, 0.3, 1.0, _number(chance, 0.0, 1.0))),
        "speed_limit_mps": lambda: _number(chance, 0.0, 20.0),
        "mission_finished": lambda: chance.random() < 0.5,
        "estop_request": lambda: chance.random() < 0.3,
        "laps": lambda: chance.choice((0, 1, 15, 16, -1, 10**30)),
        "cones_count_all": lambda: chance.choice((0, 65535, 65536, -5, 10**30)),
        "age_ms": lambda: chance.choice(_AGES_MS),
        "run_offset": lambda: chance.choice((0, 0, 0, -1, 1)),
    }
    names = chance.sample(sorted(makers), chance.choice((1, 1, 1, 2, 3)))
    return {name: makers[name]() for name in names}


def _command(chance: Random) -> list[FuzzEvent]:
    return [event("command", **fields_of_a_command(chance))]


def _orderly(chance: Random) -> list[FuzzEvent]:
    """The controller is in its right mind again."""
    return [
        event("command", steering_rad=round(chance.uniform(-0.3, 0.3), 3), throttle=chance.choice((0.0, 0.4, 1.0)),
              brake=chance.choice((0.0, 0.0, 0.0, 0.4)), speed_limit_mps=8.0, age_ms=0.0, run_offset=0,
              mission_finished=False, estop_request=False),
        event("silence", on=False),
    ]  # fmt: skip


def _once(chance: Random) -> list[FuzzEvent]:
    return [event("once", **fields_of_a_command(chance))]


def _flicker(chance: Random) -> list[FuzzEvent]:
    """The controller pushes and brakes in turn, faster than the interlock."""
    cycles = chance.choice((1, 1, 2))
    events: list[FuzzEvent] = []
    for _ in range(chance.randrange(2, 6)):
        events += [
            event("command", throttle=0.0, brake=0.5),
            event("run", cycles=cycles),
            event("command", throttle=1.0, brake=0.0),
            event("run", cycles=cycles),
        ]
    return events


def _silence(chance: Random) -> list[FuzzEvent]:
    cycles = chance.choice((5, 9, 10, 11, 29, 30, 31, 50, 69, 71))
    return [event("silence", on=True), event("run", cycles=cycles), event("silence", on=False)]


def _planner(chance: Random) -> list[FuzzEvent]:
    """A planner or controller that is started anew."""
    role = chance.choice(("planner", "controller"))
    old = [event("command", age_ms=chance.choice((100.0, 450.0, 550.0, 690.0))), event("run", cycles=3)]
    return [*old, event("confirm", role=role, offset=0), event("command", age_ms=0.0), event("run", cycles=4)]


def _confirm(chance: Random) -> list[FuzzEvent]:
    role = chance.choice(("planner", "controller", "planner", "controller", "bridge", "", "PLANNER"))
    return [event("confirm", role=role, offset=chance.choice((0, 0, 1, -1, 10**12)))]


def _confirming(chance: Random) -> list[FuzzEvent]:
    return [event("confirming", on=chance.random() < 0.5)]


def _service(chance: Random) -> list[FuzzEvent]:
    match chance.randrange(6):
        case 0 | 1 | 2:
            return [event("service", name="mode", text=chance.choice(MODES))]
        case 3:
            return [event("service", name="emergency", text=chance.choice(("", "operator", "x" * 200)))]
        case _:
            return [event("service", name="reset")]


def _drops(chance: Random) -> list[FuzzEvent]:
    cycles = chance.choice((1, 1, 2, 3, 4, 5, 6, 7, 20))
    return [event("drops", cycles=cycles, takes=chance.randrange(5)), event("run", cycles=cycles)]


def _lost(chance: Random) -> list[FuzzEvent]:
    lost = event("breaks", takes=chance.randrange(5), ms=_ms(chance)) if chance.random() < 0.5 else event(
        "lost", ms=_ms(chance)
    )  # fmt: skip
    events = [lost, event("run", cycles=chance.choice((1, 2, 5, 20)))]
    if chance.random() < 0.6:
        events += chance.choice((_service, _car, _confirm, _wheels))(chance)
        events.append(_run(chance))
    return events


def _quiet(chance: Random) -> list[FuzzEvent]:
    return [event("quiet", ms=_ms(chance))]


def _hang(chance: Random) -> list[FuzzEvent]:
    return [event("hang", ms=_ms(chance))]


def _late(chance: Random) -> list[FuzzEvent]:
    return [event("late", ns=chance.choice((0, 0, 1, 1_000_000, 3_000_000, 7_999_999, 30_000_000, 49_999_999)))]


def _pace(chance: Random) -> list[FuzzEvent]:
    ns = chance.choice(
        (10_000_000,) * 4 + (100_000, 2_000_000, 7_999_999, 9_999_999, 14_999_999, 25_000_000, 49_999_999)
    )
    return [event("pace", ns=ns, first=chance.random() < 0.7, answered=chance.random() < 0.5)]


def _handshake(chance: Random) -> list[FuzzEvent]:
    return [event("handshake", how=chance.choice(("alternate", "alternate", "stuck", "wild")))]


def _echo(chance: Random) -> list[FuzzEvent]:
    return [event("echo", pct=chance.choice((None, None, 0.0, 0.5, 100.0)))]


def _stops_itself(chance: Random) -> list[FuzzEvent]:
    """The car says in AS_DRIVING that it is stopping itself, for a moment or for good."""
    says = chance.choice(({"go": False}, {"fault": True}))
    events = [event("car", **says), event("run", cycles=chance.choice((1, 2, 40)))]
    return [*events, event("car", go=True, fault=False)] if chance.random() < 0.6 else events


def _at_the_edge(chance: Random) -> list[FuzzEvent]:
    """A nanosecond on either side of the instant at which something runs out."""
    off_ns = chance.choice((-1, 0, 1))
    match chance.randrange(4):
        case 0:
            way = (event("car", as_state=1, go=False), event("run", cycles=3), event("car", as_state=2),
                   event("run", cycles=_READY_CYCLES))  # fmt: skip
            drive = event("command", throttle=0.5, brake=0.0, speed_limit_mps=8.0, age_ms=0.0, run_offset=0)
            return [*way, event("car", as_state=3, go=True), drive, event("run", cycles=2),
                    event("aim", ms=3000.0, ns=off_ns), event("run", cycles=5)]  # fmt: skip
        case 1:
            drive = event("command", throttle=0.5, brake=0.0, age_ms=0.0, run_offset=0)
            stale = event("command", age_ms=500.0 + off_ns / 1e6)
            return [drive, event("run", cycles=4), stale, event("run", cycles=chance.choice((1, 2)))]
        case 2:
            events = [event("late", ns=5_000_000 + off_ns), event("mute", ids=[0x520], cycles=12)]
            return [*events, event("run", cycles=13), event("late", ns=0)]
        case _:
            return [event("pace", ns=50_000_000 + off_ns, first=True, answered=True), event("run", cycles=4)]


def _pedals(chance: Random) -> list[FuzzEvent]:
    """Throttle and brake together, for about as long as it may last."""
    return [
        event("command", throttle=0.5, brake=0.3, age_ms=0.0, run_offset=0),
        event("run", cycles=chance.choice((9, 10, 11, 12, 13))),
    ]


def _beyond(chance: Random) -> list[FuzzEvent]:
    """More steering than the car allows just now."""
    return [
        event("limits", angle_deg=chance.choice((0.0, 2.0, 5.0)), front_nm=195.0, rear_nm=195.0),
        event("command", steering_rad=chance.choice((0.3, -0.3)), age_ms=0.0, run_offset=0),
        event("run", cycles=chance.choice((2, 6))),
        event("limits", angle_deg=30.0, front_nm=195.0, rear_nm=195.0),
    ]


def _other_run(chance: Random) -> list[FuzzEvent]:
    return [event("command", run_offset=chance.choice((-1, 1))), event("run", cycles=chance.choice((2, 9, 11, 31)))]


def _finish(chance: Random) -> list[FuzzEvent]:
    """The mission is done, and the car says so in the end."""
    return [
        event("wheels", rpm=None),
        event("command", throttle=0.0, brake=0.0, mission_finished=True, age_ms=0.0, run_offset=0),
        event("run", cycles=chance.choice((40, 250))),
        event("car", as_state=5, go=False),
        event("run", cycles=5),
        event("command", mission_finished=False),
    ]


def _emergency_to_rest(chance: Random) -> list[FuzzEvent]:
    """The car brakes itself, comes to rest and is switched off and on."""
    events = [
        event("wheels", rpm=None),
        event("car", as_state=4, go=False),
        event("run", cycles=chance.choice((20, 180))),
        event("car", as_state=1),
        event("quiet", ms=chance.choice((100.0, 999.0, 1001.0))),
        event("run", cycles=60),
    ]
    if chance.random() < 0.5:
        events.insert(0, event("service", name="emergency"))
    return events


def _intruder(chance: Random) -> list[FuzzEvent]:
    """Somebody else sends on the AI computer's ids, once or for a while."""
    length = chance.choice((8, 4, 2, 0))
    frame = event("frame", id=chance.choice(AI_IDS), data=chance.randbytes(length).hex(), kind="standard")
    return [one for _ in range(chance.choice((1, 1, 5))) for one in (frame, event("run", cycles=1))]


def _unbelieved(chance: Random) -> list[FuzzEvent]:
    """A 0x520 with an AS_STATE that is none: its handshake counts, the rest does not."""
    data = bytearray(chance.randbytes(8))
    data[2] = data[2] & 0xF0 | chance.randrange(6, 16)
    return [event("frame", id=0x520, data=data.hex(), kind="standard"), event("run", cycles=chance.choice((1, 2)))]


def _turned(chance: Random) -> list[FuzzEvent]:
    """What ends a drive by turning, though FAULT_STATUS stays 0; for a moment or for good."""
    says = chance.choice(
        (
            {"switches": [False, True]},
            {"switches": [True, False]},
            {"shutdown": True},
            {"bits": [chance.choice(_FAULT_BITS)]},
            {"cause": chance.randrange(1, 12)},
        )
    )
    events = [event("car", **says), event("run", cycles=chance.choice((1, 2, 40)))]
    back = event("car", switches=[True, True], shutdown=False, bits=[], cause=0)
    return [*events, back] if chance.random() < 0.6 else events


def _speeds(chance: Random) -> list[FuzzEvent]:
    """0x525 says what no wheel of this car turns at, or jumps."""
    rpm = [chance.choice((65535, 1251, 1300, 1250, 700, 0))] * 4
    if chance.random() < 0.5:
        rpm[chance.randrange(4)] = chance.choice((0, 65535, 1251))
    cycles = chance.choice((1, 2, 9, 10, 11, 29, 30, 31, 60))
    return [event("speeds", rpm=rpm), event("run", cycles=cycles), event("speeds", rpm=None)]


def _counts(chance: Random) -> list[FuzzEvent]:
    """Pulse counts that contradict the wheel speeds, on a car that drives or stops."""
    how = chance.choice(({"how": "none"}, {"how": "more", "pulses": chance.choice((0.05, 0.05, 1, 2, 7))}))
    reads = [event("speeds", rpm=[0] * 4)] if chance.random() < 0.5 else []
    stops = [event("service", name="mode", text="manual")] if chance.random() < 0.5 else []
    ends = [event("speeds", rpm=None), event("counts", how="pulses")]
    return [*reads, *stops, event("counts", **how), event("run", cycles=chance.choice((20, 60, 120))), *ends]


def _hasty(chance: Random) -> list[FuzzEvent]:
    """AS_DRIVING too soon after AS_OFF, without an edge of Go, or without a mission."""
    ready = chance.choice((2, 100, 489, 490, 491, 492, _READY_CYCLES))
    return [
        event("car", as_state=1, go=False, ami=chance.choice((4, 4, 0))),
        event("run", cycles=chance.choice((2, 5))),
        event("service", name="reset"),
        event("service", name="mode", text="autonomous"),
        event("run", cycles=2),
        event("car", as_state=2, go=chance.random() < 0.3),
        event("run", cycles=ready),
        event("command", throttle=0.5, brake=0.0, speed_limit_mps=8.0, age_ms=0.0, run_offset=0),
        event("car", as_state=3, go=True),
        event("run", cycles=310),
    ]


def _restart_on_the_way(chance: Random) -> list[FuzzEvent]:
    """The process is killed before AS_DRIVING, and everybody goes on as if nothing had happened."""
    return [
        event("car", as_state=1, go=False),
        event("run", cycles=3),
        event("car", as_state=2),
        event("run", cycles=_READY_CYCLES),
        event("restart"),
        event("run", cycles=25),
        event("service", name="mode", text="autonomous"),
        event("command", throttle=0.5, brake=0.0, speed_limit_mps=8.0, age_ms=0.0, run_offset=0),
        event("run", cycles=3),
        event("car", as_state=3, go=True),
        event("run", cycles=chance.choice((310, 330))),
    ]


def _restart(chance: Random) -> list[FuzzEvent]:
    return [event("restart"), event("run", cycles=chance.choice((5, 25, 40)))]


def _end(chance: Random) -> list[FuzzEvent]:
    return [event("end"), event("run", cycles=chance.choice((3, 8, 20)))]


_MAKERS: Final[tuple[tuple[int, Maker], ...]] = (
    (7, _car), (3, _next_run), (4, _wheels), (2, _steering), (2, _limits), (5, _mute), (4, _frame), (1, _storm),
    (5, _says), (2, _flip), (6, _command), (5, _orderly), (4, _once), (2, _flicker), (4, _silence), (2, _planner),
    (2, _confirm), (1, _confirming), (5, _service), (4, _drops), (3, _lost), (3, _quiet), (2, _hang), (1, _late),
    (2, _pace), (1, _handshake), (1, _echo), (1, _restart), (1, _end), (1, _pedals),
    (2, _stops_itself), (5, _at_the_edge), (2, _unbelieved), (2, _intruder), (2, _restart_on_the_way),
    (1, _beyond), (1, _other_run), (1, _finish), (1, _emergency_to_rest),
    (4, _turned), (4, _speeds), (4, _counts), (2, _hasty),
)  # fmt: skip
_WEIGHTS: Final = [weight for weight, _ in _MAKERS]
_STATION_NAMES: Final = tuple(STATIONS)
_STATION_WEIGHTS: Final = {
    "start": 1, "awake": 1, "off": 2, "ready": 2, "launched": 2, "driving": 5, "moving": 8, "emergency": 1,
    "finished": 1,
}  # fmt: skip
_SETUP_WEIGHTS: Final = {"2026": 8, "2021": 3, "venue": 3, "staging": 2, "official simulator": 2, "listening": 1}


def some_events(chance: Random) -> list[FuzzEvent]:
    """One thing that happens, mostly with a little ordinary traffic after it."""
    (maker,) = chance.choices([maker for _, maker in _MAKERS], _WEIGHTS)
    events = maker(chance)
    if chance.random() < 0.75:
        events.append(_run(chance))
    return events


def fresh(chance: Random) -> FuzzCase:
    """A case out of nothing."""
    (setup,) = chance.choices(tuple(SETUPS), [_SETUP_WEIGHTS[name] for name in SETUPS])
    (station,) = chance.choices(_STATION_NAMES, [_STATION_WEIGHTS[name] for name in _STATION_NAMES])
    events = [one for _ in range(chance.randrange(2, 12)) for one in some_events(chance)]
    return FuzzCase(setup, station, tuple(events))


TOURS: Final = len(_MAKERS)
"""How many ways there are in which something happens."""


def tour(number: int, chance: Random) -> FuzzCase:
    """One thing that happens to a car that drives, so that none is left to chance alone."""
    events = [*_MAKERS[number % TOURS][1](chance), event("run", cycles=35), *some_events(chance)]
    return FuzzCase(chance.choice(("2026", "2026", "2021")), "moving", tuple(events))


def changed(case: FuzzCase, chance: Random) -> FuzzCase:
    """The case with one to three changes: something put in, taken out, repeated, told otherwise, or put at the end."""
    events = list(case.events)
    for _ in range(chance.choice((1, 1, 2, 3))):
        place = chance.randrange(len(events) + 1)
        match chance.randrange(7):
            case 0 | 1:
                events[place:place] = some_events(chance)
            case 2:
                del events[place : place + chance.randrange(1, 4)]
            case 3:
                events[place:place] = events[place : place + chance.randrange(1, 5)]
            case 4 if place < len(events):
                events[place] = _otherwise(events[place], chance)
            case 5:
                events = [*events[:place], *some_events(chance), *some_events(chance)]
            case _:
                events += some_events(chance)
    return FuzzCase(case.setup, case.station, tuple(events))


def _otherwise(one: FuzzEvent, chance: Random) -> FuzzEvent:
    """The same event with other values, where the vocabulary has one like it."""
    if one.name == "run":
        return _run(chance)
    for _ in range(20):
        for other in some_events(chance):
            if other.name == one.name:
                return other
    return one


def make(origin: str) -> FuzzCase:
    """The case of this lineage. Raises ValueError for text that is none."""
    first, *changes = origin.split(".")
    if not first or not all(changes):
        raise ValueError(f"{origin!r} is no lineage of a case: seeds with points between them, such as 7.31.4")
    touring = re.match(r"tour-(\d+)-", first)
    case = fresh(Random(first)) if touring is None else tour(int(touring.group(1)), Random(first))
    for count in range(len(changes)):
        case = changed(case, Random(".".join((first, *changes[: count + 1]))))
    return FuzzCase(case.setup, case.station, case.events, origin)


def lineage_depth(origin: str) -> int:
    return origin.count(".")


def shortened(events: Sequence[FuzzEvent], fails: Callable[[tuple[FuzzEvent, ...]], bool]) -> tuple[FuzzEvent, ...]:
    """Delta debugging: the fewest events found with which `fails` still holds, and the smallest `cycles` in them."""
    kept = tuple(events)
    parts = 2
    while len(kept) >= 2:
        size = max(1, len(kept) // parts)
        for start in range(0, len(kept), size):
            rest = kept[:start] + kept[start + size :]
            if fails(rest):
                kept, parts = rest, max(2, parts - 1)
                break
        else:
            if size == 1:
                break
            parts = min(len(kept), 2 * parts)
    if len(kept) == 1 and fails(()):
        return ()
    for index, one in enumerate(kept):
        for smaller in _smaller(one):
            tried = (*kept[:index], smaller, *kept[index + 1 :])
            if fails(tried):
                kept = tried
                break
    return kept


def _smaller(one: FuzzEvent) -> list[FuzzEvent]:
    values = dict(one.values)
    cycles = values.get("cycles")
    if isinstance(cycles, int):
        steps = sorted({1, 2, 5, cycles // 4, cycles // 2, 3 * cycles // 4, cycles - 1} - {0})
        return [FuzzEvent(one.name, {**values, "cycles": step}) for step in steps if step < cycles]
    if one.name in ("command", "once", "car"):
        return [
            FuzzEvent(one.name, {k: v for k, v in values.items() if k != name}) for name in values if len(values) > 1
        ]
    return []
