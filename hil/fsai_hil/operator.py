"""The person beside the car: walks the switches, chooses missions, gives Go, and presses what a scenario asks for.

Pure: driven by the time and by what the car shows (ASSI, siren, display), like a person; it never looks at the state
machine behind them. A person's work is a script: a generator that says what it waits to see, and moves switches when
it has seen it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any, Final, Protocol

from fsai_hil.indicators import Assi, Indicators, Siren
from fsai_hil.power import POWER_UP, PowerUp
from fsai_hil.profiles import MS, S
from fsai_hil.switches import Switches
from fsai_vcu.interface.enums import Ami

HAND_NS: Final = 300 * MS  # from one switch to the next
REACTION_NS: Final = 500 * MS  # from seeing to doing
FINISHED_NS: Final = 3 * S  # how long people look at a car that has finished
OFF_NS: Final = 2 * S  # a power cycle is no flick: the AI computer must see the car gone
GO_PATIENCE_NS: Final = 1500 * MS  # a Go that starts nothing is taken back and given again

READY: Final = frozenset({Assi.YELLOW, Assi.YELLOW_AND_BLUE})
ENDED: Final = frozenset({Assi.BLUE, Assi.BLUE_FLASHING, Assi.OFF})

SWITCH_NAMES: Final = tuple(field.name for field in fields(Switches))


class CarShows(Protocol):
    """What a person beside the car sees, and what a person's hands reach."""

    switches: Switches

    @property
    def indicators(self) -> Indicators: ...

    @property
    def mission_selectable(self) -> bool: ...

    @property
    def shut_down(self) -> bool: ...


@dataclass(frozen=True, slots=True)
class Await:
    """What a script waits for: until `seen`, then `delay_ns` more. Out of patience it goes on with False instead."""

    what: str
    seen: Callable[[CarShows], bool] = lambda car: True
    delay_ns: int = HAND_NS
    patience_ns: int | None = None


Script = Generator[Await, bool, None]


class Moment(Enum):
    """From when an event counts its time: the first look, or the first time that the ASSI shows a state."""

    START = frozenset(Assi)
    READY = READY
    DRIVING = frozenset({Assi.YELLOW_FLASHING})
    EMERGENCY = frozenset({Assi.BLUE_FLASHING})
    FINISHED = frozenset({Assi.BLUE})


@dataclass(frozen=True, slots=True)
class At:
    """Something that happens whatever the script is about: `after_ns` after a moment, `switch` becomes `value`.

    Raises ValueError for a switch that the car does not have.
    """

    after_ns: int
    switch: str
    value: Any = True
    since: Moment = Moment.START

    def __post_init__(self) -> None:
        if self.switch not in SWITCH_NAMES:
            raise ValueError(f"the car has no switch {self.switch!r}: choose one of {', '.join(SWITCH_NAMES)}")


class Operator:
    """Follows a script, and does beside it what is due `at` a moment.

    Call `act` about once a millisecond of virtual time; it moves `car.switches`. `doing` says in words what is being
    waited for, `done` that the script has ended, `log` what was done and when.
    """

    def __init__(self, script: Callable[[Switches], Script] | None = None, at: Iterable[At] = ()) -> None:
        self._begin = script
        self._script: Script | None = None
        self._await = Await("about to begin")
        self._await_since_ns = 0
        self._seen_ns: int | None = None
        self._at = list(at)
        self._moments_ns: dict[Moment, int] = {}
        self.done = script is None
        self.log: list[tuple[int, str]] = []

    @classmethod
    def auto(
        cls, revision: str, missions: Sequence[Ami], at: Iterable[At] = (), switch_off_at_end: bool = True
    ) -> Operator:
        """One who has these missions driven one after another, from a car that is off to a car that is off."""
        power_up = POWER_UP[revision]
        return cls(lambda switches: drive_missions(switches, power_up, missions, switch_off_at_end), at)

    @property
    def doing(self) -> str:
        return "nothing left to do" if self.done else self._await.what

    def act(self, now_ns: int, car: CarShows) -> None:
        """Look at the car at `now_ns` and move what is to be moved."""
        if self._at:
            self._events(now_ns, car)
        if self._script is None and self._begin is not None:
            self._script = self._begin(car.switches)
            self._go_on(now_ns, None)
        if self.done:
            return
        awaited = self._await
        if self._seen_ns is None and awaited.seen(car):
            self._seen_ns = now_ns
        if self._seen_ns is not None:
            if now_ns - self._seen_ns >= awaited.delay_ns:
                self.log.append((now_ns, awaited.what))
                self._go_on(now_ns, True)
        elif awaited.patience_ns is not None and now_ns - self._await_since_ns >= awaited.patience_ns:
            self.log.append((now_ns, f"no longer waiting: {awaited.what}"))
            self._go_on(now_ns, False)

    def _go_on(self, now_ns: int, seen: bool | None) -> None:
        assert self._script is not None
        try:
            self._await = next(self._script) if seen is None else self._script.send(seen)
        except StopIteration:
            self.done = True
        self._await_since_ns = now_ns
        self._seen_ns = None

    def _events(self, now_ns: int, car: CarShows) -> None:
        assi = car.indicators.assi
        for moment in Moment:
            if assi in moment.value:
                self._moments_ns.setdefault(moment, now_ns)
        waiting = []
        for event in self._at:
            since_ns = self._moments_ns.get(event.since)
            if since_ns is None or now_ns - since_ns < event.after_ns:
                waiting.append(event)
                continue
            setattr(car.switches, event.switch, event.value)
            value = event.value.name if isinstance(event.value, Enum) else event.value
            self.log.append((now_ns, f"{event.switch} is {value}"))
        self._at = waiting


# ---------------------------------------------------------------- scripts


def drive_missions(
    switches: Switches, power_up: PowerUp, missions: Sequence[Ami], switch_off_at_end: bool = True
) -> Script:
    """Power up, choose the mission, give Go, wait for the end, switch off what this car wants off; then the next."""
    on = False
    for number, mission in enumerate(missions, start=1):
        if not on:
            yield from power_on(switches, power_up)
            on = True
        yield Await("waiting until the display offers the missions", lambda car: car.mission_selectable, REACTION_NS)
        switches.ami = mission
        if not switches.asms:  # the mission before ended with it
            yield Await("turning ASMS on")
            switches.asms = True
        yield Await("waiting for yellow and blue: 5 s in AS_READY", _ready_for_go, REACTION_NS)
        failed = yield Await("looking whether the car is still ready", _emergency, 0, patience_ns=0)
        if not failed:
            yield from give_go(switches)
        yield Await("waiting for the end of the mission", lambda car: car.indicators.assi in ENDED, 0)
        emergency = yield Await("looking how it ended", _emergency, 0, patience_ns=0)
        if emergency:
            yield Await("waiting until the siren falls silent", lambda car: car.indicators.siren is Siren.OFF)
        else:
            yield Await("letting the car stand", delay_ns=FINISHED_NS)
        switches.go = False
        last = number == len(missions)
        if last and not switch_off_at_end:
            return
        everything = ("asms", "tsms", "lvms")
        yield from power_down(switches, everything if emergency or last else power_up.switches_off)
        on = switches.lvms


def power_on(switches: Switches, power_up: PowerUp) -> Script:
    """The switches in the order of this car's power-up."""
    yield Await("checking the dongle, the E-stops and the remote", delay_ns=OFF_NS)
    switches.dongle = True
    switches.remote_estop = switches.car_estop = False
    switches.remote_radio_ok = True
    switches.go = False
    for name in power_up.switches_on:
        yield Await(f"turning {name.upper()} on")
        setattr(switches, name, True)


def power_down(switches: Switches, names: Iterable[str]) -> Script:
    """The switches off, one after another; LVMS only when the car has shut down."""
    for name in names:
        if name == "lvms":
            yield Await("waiting until the car has shut down", lambda car: car.shut_down)
        yield Await(f"turning {name.upper()} off")
        setattr(switches, name, False)
        if name == "lvms":
            switches.ami = Ami.NOT_SELECTED  # the display forgets


def give_go(switches: Switches) -> Script:
    """Go; off and on again as long as the car stays ready and does not start."""
    while True:
        switches.go = True
        started = yield Await(
            "giving Go", lambda car: car.indicators.assi not in READY, delay_ns=0, patience_ns=GO_PATIENCE_NS
        )
        if started:
            return
        switches.go = False
        yield Await("taking Go back", delay_ns=REACTION_NS)


def _ready_for_go(car: CarShows) -> bool:
    return car.indicators.assi in (Assi.YELLOW_AND_BLUE, Assi.BLUE_FLASHING)


def _emergency(car: CarShows) -> bool:
    return car.indicators.assi is Assi.BLUE_FLASHING
