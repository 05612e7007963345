"""The person beside the car: walks the switches, chooses missions, gives Go.

Pure: driven by the time and by what the car shows (ASSI, siren, display), like a person; it never looks at the state
machine behind them. A person's work is a script: what to wait for, one thing after another, and what to do when it has
been seen. Scripts are data, not running code, so that a run can be copied in the middle of one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, Final

from fsai_hil.simulator.power import POWER_UP, PowerUp
from fsai_hil.simulator.switches import Assi, Switches
from fsai_hil.simulator.vcu import SimulatedVcu
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.units import MS, S
from fsai_vcu.interface.values import Value

HAND_NS: Final = 300 * MS  # from one switch to the next
REACTION_NS: Final = 500 * MS  # from seeing to doing
FINISHED_NS: Final = 3 * S  # how long people look at a car that has finished
OFF_NS: Final = 2 * S  # a power cycle is no flick: the AI computer must see the car gone
GO_PATIENCE_NS: Final = 1500 * MS  # a Go that starts nothing is taken back and given again

READY: Final = frozenset({Assi.YELLOW, Assi.YELLOW_AND_BLUE})
READY_FOR_GO: Final = frozenset({Assi.YELLOW_AND_BLUE, Assi.BLUE_FLASHING})
ENDED: Final = frozenset({Assi.BLUE, Assi.BLUE_FLASHING, Assi.OFF})


class Await(Value, frozen=True):
    """The condition that a script waits for: until `seen`, then `delay_ns` more.

    Out of patience it goes on unseen instead.
    """

    what: str
    seen: Callable[[SimulatedVcu], bool] = lambda car: True
    delay_ns: int = HAND_NS
    patience_ns: int | None = None


# A switch and what it is set to; or, given whether the last thing awaited was seen, what the script goes on with here
Do = tuple[str, Any] | Callable[[Switches, bool], "Script"]
Script = Sequence[Await | Do]


class Operator:
    """Follows a script.

    Call `act` about once a millisecond of virtual time; it moves `car.switches`. `doing` says in words what is being
    waited for, `done` that the script has ended.
    """

    def __init__(self, script: Script = ()) -> None:
        self._ahead = tuple(script)  # of the script
        self._await_since_ns: int | None = None  # None: it has not begun
        self._seen_ns: int | None = None

    @classmethod
    def auto(cls, revision: str, missions: Sequence[Ami]) -> Operator:
        """One who has these missions driven one after another, from a car that is off to a car that is off."""
        return cls(drive_missions(POWER_UP[revision], missions))

    @property
    def done(self) -> bool:
        return not self._ahead

    @property
    def doing(self) -> str:
        for step in self._ahead:
            if isinstance(step, Await):
                return step.what
        return "nothing left to do"

    def act(self, now_ns: int, car: SimulatedVcu) -> None:
        """Look at the car at `now_ns` and move what is to be moved."""
        if self._await_since_ns is None:
            self._go_on(now_ns, car.switches, True)
        if not self._ahead:
            return
        awaited = self._ahead[0]
        assert isinstance(awaited, Await) and self._await_since_ns is not None  # `_go_on` does what is to be done
        if self._seen_ns is None and awaited.seen(car):
            self._seen_ns = now_ns
        if self._seen_ns is not None:
            if now_ns - self._seen_ns < awaited.delay_ns:
                return
        elif awaited.patience_ns is None or now_ns - self._await_since_ns < awaited.patience_ns:
            return
        self._ahead = self._ahead[1:]
        self._go_on(now_ns, car.switches, self._seen_ns is not None)

    def _go_on(self, now_ns: int, switches: Switches, seen: bool) -> None:
        """Do what is to be done before the next thing to wait for."""
        while self._ahead and not isinstance(step := self._ahead[0], Await):
            more: Script = ()
            if isinstance(step, tuple):
                setattr(switches, *step)
            else:
                more = step(switches, seen)
            self._ahead = (*more, *self._ahead[1:])
        self._await_since_ns = now_ns
        self._seen_ns = None


# ---------------------------------------------------------------- scripts


def _emergency(car: SimulatedVcu) -> bool:
    return car.assi is Assi.BLUE_FLASHING


def drive_missions(power_up: PowerUp, missions: Sequence[Ami]) -> Script:
    """Power up, choose the mission, give Go, wait for the end, switch off what this car wants off; then the next."""
    script: list[Await | Do] = [*power_on(power_up)]
    for number, mission in enumerate(missions, start=1):
        last = number == len(missions)
        if number > 1:
            script.append(partial(_power_on_again, power_up))
        script += (
            Await("waiting until the display offers the missions", lambda car: car.mission_selectable, REACTION_NS),
            ("ami", mission),
            # the mission before may have ended with it
            lambda switches, _: () if switches.asms else _turn("asms", True),
            Await(
                "waiting for yellow and blue: 5 s in AS_READY",
                lambda car: car.assi in READY_FOR_GO,
                REACTION_NS,
            ),
            Await("looking whether the car is still ready", _emergency, 0, patience_ns=0),
            lambda _, emergency: () if emergency else give_go(),
            Await("waiting for the end of the mission", lambda car: car.assi in ENDED, 0),
            Await("looking how it ended", _emergency, 0, patience_ns=0),
            partial(_let_it_end, power_up, last),
        )
    return script


def power_on(power_up: PowerUp) -> Script:
    """The switches in the order of this car's power-up."""
    return (
        Await("checking the dongle, the E-stops and the remote", delay_ns=OFF_NS),
        ("dongle", True),
        ("remote_estop", False),
        ("car_estop", False),
        ("remote_radio_ok", True),
        ("go", False),
        *(step for name in power_up.switches_on for step in _turn(name, True)),
    )


def power_down(names: Iterable[str]) -> Script:
    """The switches off, one after another; LVMS only when the car has shut down."""
    script: list[Await | Do] = []
    for name in names:
        if name == "lvms":
            script.append(Await("waiting until the car has shut down", lambda car: car.shut_down))
        script += _turn(name, False)
        if name == "lvms":
            script.append(("ami", Ami.NOT_SELECTED))  # the display forgets
    return script


def give_go() -> Script:
    """Go; off and on again as long as the car stays ready and does not start."""
    return (
        ("go", True),
        Await("giving Go", lambda car: car.assi not in READY, delay_ns=0, patience_ns=GO_PATIENCE_NS),
        _again_unless_started,
    )


# ---------------------------------------------------------------- what hands do


def _turn(switch: str, on: bool) -> Script:
    return Await(f"turning {switch.upper()} {'on' if on else 'off'}"), (switch, on)


def _power_on_again(power_up: PowerUp, switches: Switches, seen: bool) -> Script:
    return () if switches.lvms else power_on(power_up)


def _again_unless_started(switches: Switches, started: bool) -> Script:
    if started:
        return ()
    return ("go", False), Await("taking Go back", delay_ns=REACTION_NS), *give_go()


def _let_it_end(power_up: PowerUp, last: bool, switches: Switches, emergency: bool) -> Script:
    everything = emergency or last  # after an emergency only a power cycle leads on
    off = power_down(("asms", "tsms", "lvms") if everything else power_up.switches_off)
    return (
        Await("waiting until the siren falls silent", lambda car: not car.siren)
        if emergency
        else Await("waiting 3 s at standstill", delay_ns=FINISHED_NS),
        ("go", False),
        *off,
    )
