"""The closed parts into which the search is split: who does what in each, and what their union covers.

Everything at once would be too much for a minute. Each scope gives some parties their whole freedom and lets the rest
behave; a rule is searched wherever what it speaks of is free. All begin with both sides just switched on, so every
state visited is one that the car can be brought into.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations, product
from typing import Final

from fsai_hil.evidence.model import CAR_MESSAGES, COMMANDS, SPEEDS, STATUS, Choice, Scope, Setting
from fsai_hil.profiles import OFFICIAL_SIMULATOR
from fsai_vcu.core.bridge import BridgeConfig, official_simulator
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami, AsState

S: Final = 1_000_000_000

STANDING: Final = (0, 0, 0, 0)
ROLLING: Final = (100, 100, 100, 100)
MOVING: Final = (200, 200, 200, 200)

_WELL = Choice()
_WAITING = replace(_WELL, request="autonomous")
_GO = replace(_WELL, go=True)
PATH: Final = (_WELL, _WAITING, _GO)
"""What brings a car into AS_DRIVING: autonomous asked for, Go after 5 s."""

_SILENT_STANDING = replace(_GO, command="none")
_SILENT_MOVING = replace(_GO, command="none", rpm=MOVING)
_CUT_OFF = replace(_GO, lost=frozenset(CAR_MESSAGES), rpm=MOVING)
_SILENCE_AND_STANDS: Final = "a silent planner and a car that comes to rest"
_SILENCE_AND_MOVES: Final = "a silent planner and a car that never brakes"
_DEAF: Final = "a car that is not heard any more"

ENDINGS: Final = {
    _SILENCE_AND_STANDS: _SILENT_STANDING,
    _SILENCE_AND_MOVES: _SILENT_MOVING,
    _DEAF: _CUT_OFF,
}
BOUNDS_NS: Final = {
    # 3 s of standing still, 300 ms for a lost command, 0.5 s of proven rest, and the cycles between
    _SILENCE_AND_STANDS: 3_300_000_000 + 500_000_000 + 100_000_000,
    # the same, and a deceleration that does not show within 0.5 s
    _SILENCE_AND_MOVES: 3_300_000_000 + 500_000_000 + 100_000_000,
    # 0x520 stale for 100 ms, and the cycles between
    _DEAF: 200_000_000,
}
_ENDING_CHOICES = tuple(ENDINGS.values())


def _scope(
    name: str,
    covers: str,
    everywhere: Iterable[Choice],
    driving: Iterable[Choice] = (),
    *,
    setting: Setting | None = None,
    endings: bool = True,
    bounds: bool = True,
) -> Scope:
    """A scope: the path into AS_DRIVING and `everywhere` in every state, `driving` only in AS_DRIVING."""
    first = tuple(dict.fromkeys((*PATH, *everywhere, *(_ENDING_CHOICES if endings else ()))))
    rest = tuple(choice for choice in dict.fromkeys(driving) if choice not in first)
    return Scope(
        name,
        covers,
        (*first, *rest),
        len(first),
        setting or Setting(),
        ENDINGS if endings else {},
        BOUNDS_NS if endings and bounds else {},
    )


def _each(base: Choice, *changes: dict[str, object]) -> list[Choice]:
    return [replace(base, **change) for change in changes]  # type: ignore[arg-type]


_PEOPLE: Final[tuple[dict[str, object], ...]] = (
    {"request": "manual"},
    {"request": "autonomous"},
    {"request": "the emergency brake"},
    {"request": "reset"},
    {"request": "sideways"},
    {"asms": False},
    {"sdc_open": True},
    {"fault": True},
    {"ami": Ami.NOT_SELECTED},
    {"ami": Ami.ACCELERATION},
    {"confirm": False},
    {"car_off": True},
    {"go": False},
    {"command": "finished"},
    {"command": "none"},
)


def _run(name: str = "run", setting: Setting | None = None, *, bounds: bool = True) -> Scope:
    return _scope(
        name,
        "people: mode requests, emergency brake, reset, Go, ASMS, E-stop, AMI, resets not confirmed, car off and on; "
        "wheels standing, moving; planner driving, finished, silent",
        (*_each(_GO, *_PEOPLE), *_each(_WELL, *_PEOPLE[:7], {"ami": Ami.NOT_SELECTED}, {"confirm": False})),
        (replace(_GO, rpm=MOVING), *_each(replace(_GO, rpm=MOVING), *_PEOPLE)),
        setting=setting,
        bounds=bounds,
    )


def _commands() -> Scope:
    kinds = ("none", *COMMANDS)
    return _scope(
        "commands",
        "every kind of command: in order, absurd, stale, of another run, both pedals; wheels standing, slowing, moving",
        (),
        [
            replace(_GO, command=kind, rpm=rpm)
            for kind, rpm in product(kinds, (STANDING, ROLLING, MOVING))
            if kind != "drive right"
        ],
    )


def _messages() -> Scope:
    lost = [frozenset(some) for count in (0, 1, 2) for some in combinations(CAR_MESSAGES, count)]
    choices = [
        replace(_GO, lost=some, rpm=rpm, command=command)
        for some, (rpm, command) in product(lost, ((MOVING, "drive"), (STANDING, "drive"), (MOVING, "brake")))
    ]
    unreadable = _each(replace(_GO, unreadable=True), {}, {"rpm": MOVING}, {"lost": frozenset((SPEEDS,))})
    everywhere = [replace(_GO, lost=frozenset((STATUS,))), replace(_GO, unreadable=True), _CUT_OFF]
    return _scope(
        "messages",
        "each of the car's messages and each pair of them fresh, late and lost; 0x520 that cannot be read",
        everywhere,
        (*choices, *unreadable),
    )


def _sends() -> Scope:
    return _scope(
        "sends",
        "cycles that go out whole, in part, not at all, for any time; pedals changing under it",
        (),
        [
            replace(_GO, frames=frames, command=command, rpm=rpm)
            for frames, command, rpm in product((0, 1, 3, 4, 5), ("drive", "brake", "none"), (MOVING, STANDING))
        ],
    )


_EVENTS: Final = (
    "an intruder sends 0x511",
    "the loop misses its deadline",
    "the bus is lost",
    "the bus is back",
    "the software is stopped",
    "restart",
)


def _events() -> Scope:
    return _scope(
        "events",
        "restart of the process, of the car, of both; intruder, fault of the loop, bus lost and back, orderly end",
        [
            *_each(_GO, *({"event": event} for event in _EVENTS), {"car_off": True}, {"asms": False}),
            replace(_WELL, request="reset"),
        ],
        _each(replace(_GO, rpm=MOVING), {}, *({"event": event} for event in _EVENTS), {"car_off": True}),
    )


def _any_car() -> Scope:
    says = [
        replace(_GO, says=state, go=go, rpm=rpm)
        for state, go, rpm in product(AsState, (True, False), (STANDING, MOVING))
    ]
    driving = replace(_GO, says=AsState.AS_DRIVING, rpm=MOVING)
    return _scope(
        "any car",
        "a VCU that says any AS state at any time, whatever came before: reboots, jumps, faults; people's requests",
        [
            *says,
            *_each(driving, {"fault": True}, {"request": "manual"}, {"lost": frozenset((STATUS,))}),
            *_each(replace(driving, says=AsState.AS_OFF), {"request": "the emergency brake"}, {"request": "reset"}),
            replace(_GO, says=AsState.AS_READY, request="autonomous"),
        ],
        endings=False,
    )


def _plausibility() -> Scope:
    return _scope(
        "plausibility",
        "steering that does not follow, a wheel that does not fit, with and without a planner that brakes",
        (),
        [
            replace(_GO, steer_odd=steer, wheel_odd=wheel, command=command, rpm=rpm)
            for steer, wheel, command, rpm in product(
                (False, True), (False, True), ("drive", "brake", "finished"), (MOVING, ROLLING, STANDING)
            )
        ],
    )


def _limits() -> Scope:
    speeds = [(rpm, 0, 0, rpm) for rpm in (9, 10, 300, 301, 501, 720)]
    return _scope(
        "limits",
        "live ANGLE_MAX and TRQ_MAX, wheel speeds round the constant-power steps, steering left and right at its rate",
        (),
        [
            replace(_GO, command=command, rpm=rpm, angle_max_deg=angle, torque_max_nm=torque)
            for command, rpm, angle, torque in product(
                ("drive", "drive right"), (MOVING, *speeds), (30.0, 5.0, 0.0), (195.0, 40.0, 0.0)
            )
        ],
        setting=Setting(
            config=BridgeConfig(steer_rate_degps=600.0),
            revision="2021",
            car=CARS["2021"],
            first_state=AsState.AS_OFF,
        ),
    )


def _power_up() -> Scope:
    return _run("power-up", Setting(config=BridgeConfig(steer_rate_degps=1500.0, autonomous_at_power_up=True)))


def _official() -> Scope:
    return _run(
        "official simulator",
        Setting(
            config=replace(official_simulator(), steer_rate_degps=1500.0),
            car=CARS["official-simulator"],
            profile=OFFICIAL_SIMULATOR,
            first_state=AsState.AS_OFF,
            limits=OperationalLimits(),
        ),
        bounds=False,
    )


def _listening() -> Scope:
    return _scope(
        "listen only",
        "a process that only listens, beside a VCU that says any AS state",
        [
            *(replace(_GO, says=state, rpm=rpm) for state, rpm in product(AsState, (STANDING, MOVING))),
            *_each(_GO, *({"event": event} for event in _EVENTS), {"request": "the emergency brake"}),
        ],
        setting=Setting(config=BridgeConfig(steer_rate_degps=1500.0, listen_only=True)),
        endings=False,
    )


def all_scopes() -> tuple[Scope, ...]:
    """Every scope of the full search."""
    return (
        _run(),
        _commands(),
        _messages(),
        _sends(),
        _events(),
        _any_car(),
        _plausibility(),
        _limits(),
        _power_up(),
        _official(),
        _listening(),
    )


def scope(name: str) -> Scope:
    """The scope of that name; an unknown name raises a ValueError that lists the valid ones."""
    scopes = {one.name: one for one in all_scopes()}
    try:
        return scopes[name]
    except KeyError:
        raise ValueError(f"unknown scope {name!r}: choose one of {', '.join(scopes)}") from None
