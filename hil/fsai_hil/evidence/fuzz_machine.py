"""What may happen to the AI side, as the rules of a hypothesis state machine.

Each example begins at a station on the way of an ordinary drive, and whatever happens is followed by ordinary traffic.
The values are those at which something changes: a little before, at and after every time and limit, and those that are
none. hypothesis chooses, and cuts down what breaks a rule to the fewest steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from fsai_hil.evidence.fuzz_run import READY_CYCLES, SPOKEN, Run, at_station
from fsai_vcu.interface.bus_table import BUS_TABLE
from fsai_vcu.interface.enums import Ami, AsState, EbsState, OpState, ShutdownCause, TsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import Faults, VcuBrake, VcuDriveFront, VcuDriveRear, VcuStatus, VcuSteer, WheelSpeeds
from fsai_vcu.interface.reserved import AI_IDS

Happens = Callable[..., object]
STEPS: Final = 3  # of an example, the first takes it to its station: many short ones reach more than few long ones


def _one_of(*values: Any) -> st.SearchStrategy[Any]:
    return st.sampled_from(values)


# Cycles of 10 ms about the times at which something runs out, and far from them.
_FEW: Final = (1, 1, 1, 2, 2, 3, 4, 5, 6, 9, 10, 11, 14, 20, 29, 30, 31, 32, 49, 51, 59, 61, 69, 71, 99, 101, 120)
_CYCLES: Final = _one_of(*[0] * 14, *_FEW, *_FEW, *(150, 200, 299, 310, 330))
_MS: Final = _one_of(
    0.5, 5.0, 9.999999, 10.0, 15.0, 20.0, 49.999999, 50.0, 50.000001, 60.0, 99.999999, 100.0, 100.000001,
    150.0, 299.999999, 300.0, 400.0, 500.0, 700.0, 999.999999, 1000.0, 1000.000001, 1500.0, 3000.0,
)  # fmt: skip
_AGE_MS: Final = _one_of(
    0.0, 0.0, 10.0, 99.0, 400.0, 499.999999, 500.0, 500.000001, 600.0, 600.0, 700.0, 5000.0, 1e12, -10.0, -20.0,
    -20.000001, -50.0, -400.0, -1e12,
)  # fmt: skip
_ODD: Final = _one_of(math.nan, math.inf, -math.inf, -0.0, 5e-324, 1e308, -1e308, -1.0, 1.0000001, 2.0, -1e-9)
_WALK: Final = _one_of(*(AsState(number) for number in (1, 2, 3, 5, 4, 0)))
_SOME_IDS: Final = st.sampled_from([one.can_id for one in BUS_TABLE]) | st.sampled_from(AI_IDS) | st.just(0x520)


def _number(low: float, high: float) -> st.SearchStrategy[float]:
    number = st.floats(low, high).map(lambda value: round(value, 3))
    return st.one_of(number, number, number, _ODD)


_COMMAND: Final[dict[str, st.SearchStrategy[Any]]] = {
    "steering_rad": _number(-0.5, 0.5),
    "throttle": _one_of(0.0, 0.4, 1.0) | _number(0.0, 1.0),
    "brake": _one_of(0.0, 0.0, 0.3, 1.0) | _number(0.0, 1.0),
    "speed_limit_mps": _number(0.0, 20.0),
    "mission_finished": st.booleans(),
    "estop_request": _one_of(False, False, True),
    "laps": _one_of(0, 1, 15, 16, -1, 10**30),
    "cones_count_all": _one_of(0, 65535, 65536, -5, 10**30),
    "age_ms": _AGE_MS,
    "run_offset": _one_of(0, 0, -1, 1),
}
_FIELDS: Final = st.lists(
    st.one_of(*(st.tuples(st.just(name), values) for name, values in _COMMAND.items())), min_size=1, max_size=3
).map(dict)

# Fields of the car's messages whose bits may be anything, and bits about which something changes.
_SPEEDS: Final = ("fl_rpm", "fr_rpm", "rl_rpm", "rr_rpm")


def _bits(messages: tuple[type, ...], names: tuple[tuple[str, ...], ...], *bits: int) -> st.SearchStrategy[Any]:
    return st.fixed_dictionaries({"message": _one_of(*messages), "names": _one_of(*names), "bits": _one_of(*bits)})


_RAW: Final = st.one_of(
    _bits((VcuStatus,), (("as_state",), ("as_state",), ("ami",)), *range(16)),
    _bits((VcuStatus,), tuple((name,) for name in ("go_signal", "fault", "shutdown_request", "handshake")), 0, 1),
    _bits((VcuStatus,), (("as_switch",), ("ts_switch",), ("shutdown_cause",)), *range(16)),
    _bits((VcuStatus,), (("ebs_state",), ("ts_state",), ("op_state",)), *range(16)),
    _bits((VcuDriveFront, VcuDriveRear), (("torque_max_nm",),), 0, 1, 500, 1950, 0xFFFF),
    _bits((VcuSteer,), (("angle_max_deg",), ("angle_deg",)), 0, 1, 50, 300, 0x8000, 0xFFFF),
    _bits((VcuBrake,), (("front_request_pct",), ("rear_request_pct",)), 0, 1, 200, 255),
    _bits((WheelSpeeds,), (_SPEEDS, _SPEEDS, _SPEEDS[:1], _SPEEDS[:3]), 0xFFFF, 1251, 1300, 1250, 700, 9, 10, 0),
)


@st.composite
def _frames(draw: st.DrawFn) -> Frame:
    """Any frame: of a known identifier or of any, of a right length or a wrong one, of any kind."""
    can_id = draw(st.one_of(_SOME_IDS, _SOME_IDS, st.integers(0, (1 << 11) - 1), st.integers(0, (1 << 29) - 1)))
    length = draw(_one_of(8, 8, 8, 8, 0, 1, 2, 4, 5, 6, 7, 9, 12, 64))
    data = draw(st.binary(min_size=length, max_size=length))
    kind = draw(_one_of(*[""] * 7, "extended", "remote", "error")) if can_id < 0x800 else "extended"
    return Frame(can_id, b"" if kind == "remote" else data, **({kind: True} if kind else {}))


class Machine(RuleBasedStateMachine):
    """A run from one of the stations on; each rule is something that happens to it, and ordinary traffic after it."""

    run: Run

    @initialize(
        setup=_one_of(*["2026"] * 8, *["2021", "venue"] * 3, *["staging", "official simulator"] * 2, "listening"),
        station=_one_of("start", "awake", *["off", "ready", "launched"] * 2, *["driving"] * 5, *["moving"] * 8,
                        "emergency", "finished"),
    )  # fmt: skip
    def begin(self, setup: str, station: str) -> None:
        self.run = at_station(setup, station)


def _happening(name: str = "", **arguments: st.SearchStrategy[Any]) -> Callable[[Happens], Happens]:
    """Make a rule of a function: what happens to the run, with which arguments, and ordinary traffic after it."""

    def decorate(happens: Happens) -> Happens:
        def step(self: Machine, then: int, **values: Any) -> None:
            happens(self.run, **values.pop("fields", {}), **values)
            self.run.run(then)
            self.run.judge()

        step.__name__ = name or happens.__name__
        setattr(Machine, step.__name__, rule(then=_CYCLES, **arguments)(step))
        return happens

    return decorate


@_happening(
    status=st.one_of(
        _one_of({"as_switch": False}, {"ts_switch": False}, {"shutdown_request": True}, {"go_signal": False},
                {"fault": True}),
        st.sampled_from(Faults.__struct_fields__).map(lambda bit: {"faults": Faults(**{bit: True})}),
        st.fixed_dictionaries({"shutdown_cause": st.sampled_from(ShutdownCause)}),
        _one_of({"ebs_state": EbsState.EBS_FAULT}, {"ts_state": TsState.TS_FAULT}, {"op_state": OpState.OP_FAULT}),
        st.fixed_dictionaries({"ami": st.sampled_from(Ami)}),
    ),
    cycles=_one_of(1, 2, 40),
    back=st.booleans(),
)  # fmt: skip
def turned(run: Run, status: dict[str, Any], cycles: int, back: bool) -> None:
    """A switch that ends a drive by turning, for a moment or until the end."""
    run.car(**status)
    run.run(cycles)
    if back:
        run.car(as_switch=True, ts_switch=True, shutdown_request=False, go_signal=True, fault=False,
                faults=Faults(), shutdown_cause=ShutdownCause.NO_SHUTDOWN, ebs_state=None, ts_state=None,
                op_state=None, ami=Ami.TRACKDRIVE)  # fmt: skip


@_happening(
    before=_one_of(AsState.AS_FINISHED, AsState.EMERGENCY_BRAKE, AsState.AS_DRIVING),
    off=_one_of(AsState.AS_OFF, AsState.AS_OFF, AsState.AS_INIT),
    off_cycles=_one_of(2, 3, 60),
    ami=_one_of(Ami.TRACKDRIVE, Ami.TRACKDRIVE, Ami.NOT_SELECTED),
    early_go=_one_of(False, False, True),
    ready_cycles=_one_of(*[READY_CYCLES] * 5, 2, 100, 489, 490, 491, 492),
    restart=_one_of(False, False, True),
    left_out=st.none() | st.integers(0, 8),
    off_ns=_one_of(0, -1, 1),
)
def next_drive(run: Run, before: AsState, off: AsState, off_cycles: int, ami: Ami, early_go: bool,
               ready_cycles: int, restart: bool, left_out: int | None, off_ns: int) -> None:  # fmt: skip
    """The whole way to a drive once more, with what may be wrong on it."""
    run.command(throttle=0.5, brake=0.0, speed_limit_mps=8.0, age_ms=0.0, run_offset=0)
    way: tuple[Callable[[], object], ...] = (
        lambda: run.car(as_state=before, go_signal=False),
        lambda: run.run(2),
        lambda: run.car(as_state=off, go_signal=False, ami=ami),
        lambda: run.run(off_cycles),
        run.reset,
        lambda: run.mode("autonomous"),
        lambda: run.run(3),
        lambda: run.car(as_state=AsState.AS_READY, go_signal=early_go),
        lambda: run.run(ready_cycles),
    )
    for place, step in enumerate(way):
        if place != left_out:
            step()
    if restart:
        run.restart()
        run.run(25)
        run.mode("autonomous")
    run.car(as_state=AsState.AS_DRIVING, go_signal=True)
    run.run(2)
    run.aim(3000.0, off_ns)
    run.run(8)


@_happening(
    pulses=_one_of(0.0, 0.05, 0.05, 1.0, 2.0, 7.0), stand=st.booleans(), stop=st.booleans(),
    cycles=_one_of(20, 60, 120),
)  # fmt: skip
def counts(run: Run, pulses: float, stand: bool, stop: bool, cycles: int) -> None:
    """Pulse counts that contradict the wheel speeds, on a car that drives or stops."""
    if stand:
        run.raw(WheelSpeeds, _SPEEDS, 0, cycles)
    if stop:
        run.mode("manual")
    run.pulses = pulses
    run.run(cycles)
    run.pulses = None


@_happening(
    messages=st.one_of(*[st.tuples(st.sampled_from(SPOKEN))] * 3, st.just(SPOKEN), st.just(SPOKEN[1:3])),
    cycles=_one_of(1, 4, 5, 9, 10, 11, 12, 29, 30, 31, 99, 100, 101),
    more=_one_of(0, 1, 1, 2, 5, -1),
    late_ns=_one_of(0, 0, 0, 4_999_999, 5_000_000, 5_000_001),
)
def mute(run: Run, messages: tuple[Any, ...], cycles: int, more: int, late_ns: int) -> None:
    """Messages are missing, and the loop answers the last of them a little late."""
    if late_ns:
        run.late_ns = late_ns
    run.mute(messages, cycles)
    run.run(cycles + more)
    if late_ns:
        run.late_ns = 0


@_happening(frame=_frames(), times=_one_of(1, 1, 1, 2, 5, 12))
def frames(run: Run, frame: Frame, times: int) -> None:
    """The same strange frame once, or again and again amid the ordinary ones."""
    for _ in range(times):
        run.frame(frame)
        run.run(times > 1)


@_happening(asked=st.booleans(), moving_cycles=_one_of(20, 180), quiet_ms=_one_of(100.0, 999.0, 1001.0))
def emergency_to_rest(run: Run, asked: bool, moving_cycles: int, quiet_ms: float) -> None:
    """The car brakes itself, comes to rest and is switched off and on."""
    run.rpm = None
    if asked:
        run.emergency()
    run.car(as_state=AsState.EMERGENCY_BRAKE, go_signal=False)
    run.run(moving_cycles)
    run.car(as_state=AsState.AS_OFF)
    run.quiet(quiet_ms)
    run.run(60)


@_happening(
    steering_rad=_one_of(0.0, 0.3, -0.3, 0.05),
    throttle=_one_of(0.5, 1.0, 0.4, 0.0),
    brake=_one_of(0.0, 0.0, 0.0, 0.3),
)
def drive(run: Run, steering_rad: float, throttle: float, brake: float) -> None:
    """The controller sends valid commands again."""
    run.silent = False
    run.command(steering_rad=steering_rad, throttle=throttle, brake=brake, speed_limit_mps=8.0, age_ms=0.0,
                run_offset=0, mission_finished=False, estop_request=False)  # fmt: skip


@_happening(cycles=_one_of(1, 1, 2), times=st.integers(2, 5))
def flicker(run: Run, cycles: int, times: int) -> None:
    """The controller pushes and brakes in turn, faster than the interlock."""
    for _ in range(times):
        run.command(throttle=0.0, brake=0.5)
        run.run(cycles)
        run.command(throttle=1.0, brake=0.0)
        run.run(cycles)


@_happening(known=_one_of(1, 1, 2, 9, 10, 11), times=st.integers(1, 5))
def state_flickers(run: Run, known: int, times: int) -> None:
    """AS_STATE is known and unknown in turn."""
    for _ in range(times):
        run.raw(VcuStatus, ("as_state",), 15, 1)
        run.run(1 + known)


@_happening(cycles=_one_of(5, 9, 10, 11, 29, 30, 31, 50, 69, 71))
def silence(run: Run, cycles: int) -> None:
    run.silent = True
    run.run(cycles)
    run.silent = False


@_happening(role=_one_of("planner", "controller"), age_ms=_one_of(100.0, 450.0, 500.000001, 550.0, 690.0))
def restarted(run: Run, role: str, age_ms: float) -> None:
    """Planner or controller is started again."""
    run.command(age_ms=age_ms)
    run.run(3)
    run.confirm(role)
    run.command(age_ms=0.0)
    run.run(4)


@_happening(cycles=_one_of(40, 250))
def finish(run: Run, cycles: int) -> None:
    """The mission is over, and in the end the car reports it."""
    run.rpm = None
    run.command(throttle=0.0, brake=0.0, mission_finished=True, age_ms=0.0, run_offset=0)
    run.run(cycles)
    run.car(as_state=AsState.AS_FINISHED, go_signal=False)
    run.run(5)
    run.command(mission_finished=False)


# What is called at once, and what is another from now on.
_CALLS: Final[Mapping[str, Mapping[str, st.SearchStrategy[Any]]]] = {
    "quiet": {"ms": _MS},
    "hang": {"ms": _MS},
    "car": {
        "fields": st.one_of(
            st.fixed_dictionaries({"as_state": _WALK}),
            st.fixed_dictionaries({"go_signal": st.booleans()}),
            st.fixed_dictionaries({"fault": st.booleans()}),
            st.fixed_dictionaries({"ami": st.sampled_from(Ami)}),
            st.fixed_dictionaries({"as_state": _WALK, "go_signal": _one_of(True, True, False)}),
        )
    },
    "frame": {"frame": st.builds(Frame, st.sampled_from(AI_IDS), st.binary(max_size=8))},
    "raw": {"fields": _RAW, "cycles": _one_of(1, 1, 1, 2, 9, 10, 11, 29, 30, 31, 60)},
    "once": {"fields": _FIELDS},
    "command": {"fields": _FIELDS},
    "drops": {"cycles": _one_of(1, 1, 2, 3, 4, 5, 6, 7, 20), "takes": st.integers(0, 4)},
    "confirm": {"role": _one_of("planner", "controller", "bridge", ""), "offset": _one_of(0, 0, 1, -1, 10**12)},
    "mode": {"mode": _one_of("autonomous", "autonomous", "manual", "sideways", "AUTONOMOUS", "", "ä" * 300)},
    "emergency": {"words": _one_of("", "operator", "x" * 200)},
    "reset": {},
    "lost": {"ms": _MS},
    "breaks": {"takes": st.integers(0, 4), "ms": _MS},
    "restart": {},
    "end": {},
}
_CHANGES: Final[Mapping[str, st.SearchStrategy[Any]]] = {
    "rpm": st.one_of(
        st.none(),
        _one_of(0, 9, 10, 11, 200, 300, 301, 701).map(lambda rpm: (rpm,) * 4),
        st.tuples(*[st.integers(0, 1250)] * 4),
        st.tuples(_one_of(0, 230), _one_of(0, 9, 10, 500, 1250)).map(lambda rpm: (*rpm[:1] * 3, rpm[1])),
    ),
    "angle_deg": _one_of(None, None, 0.0, 3.0, -29.9, 29.9),
    "angle_max_deg": _one_of(30.0, 21.0, 10.0, 5.0, 2.0, 0.1, 0.0),
    "front_max_nm": _one_of(195.0, 40.0, 0.0),
    "rear_max_nm": _one_of(195.0, 40.0, 0.1, 0.0),
    "echo_pct": _one_of(None, None, 0.0, 0.5, 100.0),
    "handshake": _one_of("alternate", "alternate", "stuck", "wild"),
    "period_ns": _one_of(
        *[10_000_000] * 4, 100_000, 2_000_000, 7_999_999, 9_999_999, 14_999_999, 25_000_000, 49_999_999, 50_000_001
    ),
    "status_last": st.booleans(),
    "answered_first": st.booleans(),
    "late_ns": _one_of(0, 0, 1, 1_000_000, 3_000_000, 7_999_999, 30_000_000, 49_999_999),
    "confirming": st.booleans(),
}


for _name, _arguments in _CALLS.items():
    _happening(_name, **_arguments)(getattr(Run, _name))
for _name, _values in _CHANGES.items():
    _happening(_name, value=_values)(lambda run, value, name=_name: setattr(run, name, value))
