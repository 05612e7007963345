"""The closed parts into which the search is split: who does what in each, and what their union covers.

Everything at once would be too much for a minute. Each scope gives some parties their whole freedom and lets the rest
behave; a rule is searched wherever what it speaks of is free. All begin with both sides just switched on, so every
state visited is one that the car can be brought into.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations, product
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.environment import BOTH, BRAKE, CAR_MESSAGES, COMMANDS, MARKS, SPEEDS, STATUS, Choice
from fsai_hil.evidence.model import EVENTS, RESTART, Scope, Setting
from fsai_hil.rules.numbers import S
from fsai_hil.rules.seen import NOBODY
from fsai_hil.simulator.profiles import OFFICIAL_SIMULATOR
from fsai_vcu.core.bridge import official_simulator
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami, AsState

STANDING: Final = (0, 0, 0, 0)
ROLLING: Final = (100, 100, 100, 100)
MOVING: Final = (200, 200, 200, 200)
TOO_FAST: Final = (1200, 1200, 1200, 1200)  # no tyre follows in one cycle
IMPOSSIBLE: Final = (65535, 65535, 65535, 65535)

_WELL = Choice()
GO = replace(_WELL, go=True)
PATH: Final = (_WELL, replace(_WELL, event="autonomous is asked for"), GO)
"""The choices that bring a car into AS_DRIVING: autonomous asked for, Go after 5 s."""

_SILENT_STANDING = replace(GO, command="none")
_SILENT_MOVING = replace(GO, command="none", rpm=MOVING)
_CUT_OFF = replace(GO, lost=frozenset(CAR_MESSAGES), rpm=MOVING)
_SILENCE_AND_STANDS: Final = "a silent planner and a car that comes to rest"
_SILENCE_AND_MOVES: Final = "a silent planner and a car that never brakes"
_DEAF: Final = "a car that is not received any more"

_TWO_ENDINGS: Final = {_SILENCE_AND_STANDS: _SILENT_STANDING, _SILENCE_AND_MOVES: _SILENT_MOVING}
ENDINGS: Final = {**_TWO_ENDINGS, _DEAF: _CUT_OFF}
BOUNDS_NS: Final = {
    # 3 s of standing still, 300 ms for a lost command, 0.5 s of proven rest, the cycles between, and what the
    # rounding of ages counts twice
    _SILENCE_AND_STANDS: 5 * S,
    # the same, and a deceleration that does not show within 0.5 s
    _SILENCE_AND_MOVES: 5 * S,
    # 0x520 stale for 100 ms, the cycles between, and a process that still listens its 200 ms
    _DEAF: 500_000_000,
}

# A VCU that says whatever the environment wants cannot be brought out of AS_DRIVING. There the end is that it has been
# told to stop: ESTOP_REQUEST, or FINISHED at rest, and no torque.
_INSISTS_STANDING: Final = "a silent planner and a car that says AS_DRIVING for ever and comes to rest"
_INSISTS_MOVING: Final = "a silent planner and a car that says AS_DRIVING for ever and never brakes"
_INSISTING: Final = {
    _INSISTS_STANDING: replace(GO, says=AsState.AS_DRIVING, command="none"),
    _INSISTS_MOVING: replace(GO, says=AsState.AS_DRIVING, command="none", rpm=MOVING),
}
_ANY_CAR: Final[dict[str, Any]] = {
    "endings": _INSISTING,
    "bounds_ns": {_INSISTS_STANDING: 5 * S, _INSISTS_MOVING: 5 * S},
    "from_start": True,
}


def _scope(
    name: str,
    covers: str,
    everywhere: Iterable[Choice],
    driving: Iterable[Choice] = (),
    *,
    setting: Setting | None = None,
    endings: Mapping[str, Choice] = _TWO_ENDINGS,
    bounds_ns: Mapping[str, int] = BOUNDS_NS,
    from_start: bool = False,
    endless: str = "",
) -> Scope:
    """A scope: the path into AS_DRIVING, the endings and `everywhere` in every state, `driving` only in AS_DRIVING.

    While the first 200 ms are listened to, only path and endings, unless `from_start`.
    """
    path = () if from_start else (*PATH, *endings.values())
    first = tuple(dict.fromkeys((*path, *everywhere, *endings.values())))
    rest = tuple(choice for choice in dict.fromkeys(driving) if choice not in first)
    choices = (*first, *rest)
    return Scope(name, covers, choices, len(first), len(path), setting or Setting(), endings, bounds_ns, endless)


def _each(base: Choice, *changes: dict[str, Any]) -> list[Choice]:
    return [replace(base, **change) for change in changes]


def _over(base: Choice, **values: Iterable[Any]) -> list[Choice]:
    """`base` with every combination of these values of its fields."""
    return [replace(base, **dict(zip(values, some, strict=True))) for some in product(*values.values())]


_PEOPLE: Final[tuple[dict[str, Any], ...]] = (
    {"event": "manual is asked for"},
    {"event": "autonomous is asked for"},
    {"event": "the emergency brake is asked for"},
    {"event": "reset is asked for"},
    {"asms": False},
    {"tsms": False},
    {"fault": True},
    {"sdc_open": True},
    {"ami": Ami.ACCELERATION},
    {"ami": Ami.NOT_SELECTED},
    {"confirm": NOBODY},
    {"go": False},
    {"command": "finished"},
    {"command": "none"},
)


_PLANNER: Final = frozenset(("planner",))
_CONFIRMED: Final = {"ami": (Ami.TRACKDRIVE, Ami.ACCELERATION), "confirm": (BOTH, _PLANNER, BOTH - _PLANNER, NOBODY)}
_LOST: Final = [frozenset(some) for count in (0, 1, 2) for some in combinations(CAR_MESSAGES, count)]
_TROUBLES: Final = tuple(EVENTS)[:6]
_EVERY_MARK: Final = frozenset(MARKS)
_EACH_MARK: Final = [frozenset((mark,)) for mark in MARKS]
_CONFIG: Final = Setting().config
_AT_POWER_UP: Final = Setting(config=replace(_CONFIG, autonomous_at_power_up=True))
_DRIVES: Final = replace(GO, rpm=MOVING)
_RIGHT: Final = replace(GO, command="drive right")
_SAYS_DRIVING: Final = replace(_DRIVES, says=AsState.AS_DRIVING)
_OFF, _READY, _DRIVING = AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING


def _says(state: AsState, **changes: object) -> Choice:
    """A VCU that says this AS state whatever came before; Go is on in AS_DRIVING, off before it."""
    choice = replace(_WELL, says=state, go=state not in (AsState.AS_INIT, AsState.AS_OFF, AsState.AS_READY))
    return replace(choice, **changes)


def _run(name: str = "run", setting: Setting | None = None, *, bounds_ns: Mapping[str, int] = BOUNDS_NS) -> Scope:
    return _scope(
        name,
        "people: mode requests, emergency brake, reset, Go, ASMS, TSMS, E-stop, faults, AMI, resets not confirmed; "
        "wheels standing, moving; planner driving, finished, silent",
        _each(GO, *_PEOPLE),
        (_DRIVES, *_each(_DRIVES, *_PEOPLE)),
        setting=setting,
        bounds_ns=bounds_ns,
    )


def all_scopes() -> tuple[Scope, ...]:
    """Every scope of the full search."""
    return (
        _run(),
        _scope(
            "confirmations",
            "the AMI changed before Go; resets confirmed by planner and controller, by one of them, by none, of "
            "another run",
            [
                *_over(_WELL, **_CONFIRMED),
                *_over(GO, **_CONFIRMED),
                *_over(_WELL, ami=[Ami.TRACKDRIVE, Ami.ACCELERATION], confirm=[NOBODY, _PLANNER], confirm_other=[BOTH]),
                replace(GO, asms=False),
            ],
            (_DRIVES, replace(_DRIVES, ami=Ami.ACCELERATION, confirm=NOBODY)),
        ),
        _scope(
            "commands",
            "every kind of command: valid, absurd, stale, of another run, both pedals; wheels standing, slowing, "
            "moving",
            _each(GO, {"command": "estop"}, {"command": "finished"}, {"command": "both"}),
            [
                *_over(_DRIVES, command=["none", *(kind for kind in COMMANDS if kind != "drive right")]),
                *_over(GO, command=["none", "drive", "coast", "brake", "both", "finished", "estop"]),
                *_over(GO, command=["none", "drive", "brake"], rpm=[ROLLING]),
            ],
        ),
        _scope(
            "messages",
            "each of the car's messages and each pair of them fresh, late and lost; 0x520 that cannot be read",
            [replace(GO, lost=frozenset((STATUS,))), replace(GO, unreadable=True), _CUT_OFF],
            [
                *_over(_DRIVES, lost=_LOST),
                *_over(GO, lost=[lost for lost in _LOST if len(lost) < 2]),
                *_over(_DRIVES, lost=[NOBODY, frozenset((BRAKE,))], command=["brake"]),
                *_each(replace(GO, unreadable=True), {"rpm": MOVING}, {"lost": frozenset((SPEEDS,))}),
            ],
            endings=ENDINGS,
        ),
        _scope(
            "sends",
            "cycles that go out whole, in part, not at all, for any time; pedals changing under it",
            _each(GO, {"frames": 0}, {"frames": 3}),
            [
                *_over(_DRIVES, frames=[0, 1, 3, 4, 5], command=["drive", "brake"]),
                *_over(GO, frames=[0, 3, 5], command=["drive", "none"]),
            ],
            endings=ENDINGS,
        ),
        _scope(
            "trouble",
            "intruder, fault of the loop, bus lost and back, orderly end, frames that waited, in any order and at any "
            "time",
            _over(GO, event=_TROUBLES),
            _over(_DRIVES, event=[None, *_TROUBLES]),
            setting=Setting(config=replace(_CONFIG, stop_cycles=2)),
        ),
        _scope(
            "restarts",
            "the process dies and comes back in every state of the car, moving and standing; so does the car",
            _each(GO, {"event": RESTART}, {"asms": False}, {"car_off": True}),
            _each(_DRIVES, {}, {"event": RESTART}, {"command": "brake"}),
        ),
        _scope(
            "power cycle",
            "the car switched off for any time and on again in every state, with and without an emergency; its reset",
            _each(
                GO, {"car_off": True}, {"event": "the emergency brake is asked for"}, {"event": "reset is asked for"}
            ),
            _each(_DRIVES, {}, {"car_off": True}),
        ),
        _scope(
            "any car",
            "a VCU that says any AS state at any time, whatever came before: reboots, jumps, faults; people's requests",
            [
                *(_says(state) for state in AsState),
                *(_says(state, rpm=MOVING) for state in AsState if state not in (AsState.AS_INIT, AsState.AS_FINISHED)),
                _says(_DRIVING, go=False, rpm=MOVING),
                *_each(
                    _SAYS_DRIVING, {"fault": True}, {"event": "manual is asked for"}, {"lost": frozenset((STATUS,))}
                ),
                *_each(
                    replace(_SAYS_DRIVING, says=_OFF),
                    {"event": "the emergency brake is asked for"},
                    {"event": "reset is asked for"},
                ),
                _says(_READY, event="autonomous is asked for"),
            ],
            **_ANY_CAR,
        ),
        _scope(
            "beginnings",
            "a VCU that comes to AS_DRIVING after any time, with Go on or off before it, with no mission on the AMI, "
            "and with SELECTED that never went out whole",
            [
                *_each(_says(_OFF), {"event": "autonomous is asked for"}, {"frames": 3}, {"ami": Ami.NOT_SELECTED}),
                *_each(_says(_READY), {}, {"go": True}, {"frames": 3}, {"ami": Ami.NOT_SELECTED}),
                *_each(_says(_DRIVING), {}, {"rpm": MOVING}),
            ],
            **_ANY_CAR,
        ),
        _scope(
            "marks",
            "switches, SHUTDOWN_REQUEST, fault bits, SHUTDOWN_CAUSE and states of FAULT in 0x520 while FAULT_STATUS "
            "stays 0: there since before the run, and turning in AS_DRIVING, each and all of them; the AMI turned",
            [replace(_WELL, marks=_EVERY_MARK), replace(GO, marks=_EVERY_MARK), replace(_WELL, marks=_EACH_MARK[3])],
            [
                *_over(_DRIVES, marks=[NOBODY, _EVERY_MARK, *_EACH_MARK, _EVERY_MARK - _EACH_MARK[3]]),
                replace(GO, marks=_EACH_MARK[0]),
                *_over(_DRIVES, ami=[Ami.ACCELERATION, Ami.NOT_SELECTED]),
            ],
        ),
        _scope(
            "wheel speeds",
            "wheel speeds beyond the database and beyond what a tyre can follow, on all wheels and on one; pulse "
            "counts that run while the wheels stand",
            _each(GO, {"rpm": IMPOSSIBLE}, {"counting": True}),
            [
                *_over(GO, rpm=[MOVING, TOO_FAST, (200, 200, 1251, 200), (200, 200, 1200, 200)]),
                *_over(GO, command=["finished"], counting=[False, True]),
            ],
        ),
        _scope(
            "restarts, any car",
            "the process dies and comes back beside a VCU that goes on as if nothing had happened",
            [
                *(_says(state) for state in (_OFF, _READY, _DRIVING)),
                _says(_DRIVING, rpm=MOVING),
                *(_says(state, event=RESTART) for state in (_OFF, _READY, _DRIVING)),
                *(_says(state, event="autonomous is asked for") for state in (_OFF, _READY)),
            ],
            **_ANY_CAR,
        ),
        _scope(
            "plausibility",
            "steering that does not follow, a wheel that does not fit, planner driving and finished",
            (),
            [
                *_over(_DRIVES, steer_odd=[False, True], wheel_odd=[False, True], command=["drive", "finished"]),
                *_over(GO, steer_odd=[False, True], wheel_odd=[False, True]),
            ],
        ),
        _scope(
            "limits",
            "live ANGLE_MAX and TRQ_MAX, wheel speeds round the constant-power steps, steering left and right at its "
            "rate",
            (),
            [
                *_over(_DRIVES, command=["drive", "drive right"], angle_max_deg=[30.0, 5.0]),
                # no more than 300 rpm from one to the next: else they are not believed
                *_over(_RIGHT, rpm=[(450,) * 4, (450, 300, 300, 501), (401, 300, 601, 450), (450, 701, 450, 401)]),
                *_over(_RIGHT, rpm=[MOVING], torque_max_nm=[40.0, 0.0]),
            ],
            setting=Setting(revision="2021", car=CARS["2021"], first_state=_OFF),
        ),
        _scope(
            "power-up",
            "a process that enters autonomous by itself: car off and on, manual asked for, wheels turning",
            _each(
                GO,
                {"car_off": True},
                {"event": "manual is asked for"},
                {"event": "an unknown mode is asked for"},
                {"rpm": MOVING},
            ),
            setting=_AT_POWER_UP,
        ),
        _scope(
            "power-up, any car",
            "the same beside a VCU that says any of its states from the start, wheels standing and turning",
            [_says(state, rpm=rpm) for state, rpm in product((_OFF, _READY, _DRIVING), (STANDING, MOVING))],
            setting=_AT_POWER_UP,
            **_ANY_CAR,
        ),
        _run(
            "official simulator",
            Setting(
                config=replace(official_simulator(), steer_rate_degps=1500.0),
                car=CARS["official-simulator"],
                profile=OFFICIAL_SIMULATOR,
                first_state=_OFF,
                limits=OperationalLimits(),
            ),
            # Its motors brake more weakly: a deceleration has 2 s to show, not 0.5 s.
            bounds_ns={**BOUNDS_NS, _SILENCE_AND_MOVES: BOUNDS_NS[_SILENCE_AND_MOVES] + 3 * S // 2},
        ),
        _scope(
            "listen only",
            "a process that only listens: nothing that happens makes it send",
            [
                *(_says(state) for state in (_OFF, _READY, _DRIVING)),
                *_over(_SAYS_DRIVING, event=[_TROUBLES[0], _TROUBLES[1], _TROUBLES[4]]),
                replace(_SAYS_DRIVING, event="the emergency brake is asked for"),
                _says(_OFF, event="autonomous is asked for"),
            ],
            setting=Setting(config=replace(_CONFIG, listen_only=True)),
            endings={},
            bounds_ns={},
            from_start=True,
            endless="a process that never sends brings no car to any end",
        ),
    )


def scope(name: str) -> Scope:
    """The scope of that name; an unknown name raises a ValueError that lists the valid ones."""
    scopes = {one.name: one for one in all_scopes()}
    try:
        return scopes[name]
    except KeyError:
        raise ValueError(f"unknown scope {name!r}: choose one of {', '.join(scopes)}") from None
