"""A kind of fault: its row, what is drawn by chance for it, and how it is begun, goes on and ends in a run in lockstep.

An `Injection` takes the fault, the run, the drawn parameters and the instant: it begins the fault, and notes in it how
it goes on and ends. What a fault draws by chance comes from its own `chance`, so that a case is the same wherever it
runs.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial, reduce
from typing import Any, Final

from fsai_hil.evidence.campaign.endings import Graded, Must, Params
from fsai_hil.simulator.lockstep import Lockstep
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.units import MS
from fsai_vcu.interface.values import Value

PATH_MISSIONS: Final = frozenset({Ami.ACCELERATION, Ami.SKIDPAD, Ami.AUTOCROSS, Ami.TRACKDRIVE})
ROAD_MISSIONS: Final = PATH_MISSIONS | {Ami.AUTONOMOUS_DEMO}
EVERY_MISSION: Final = frozenset(Ami) - {Ami.NOT_SELECTED}
BOTH: Final = ("2021", "2026")


class Ongoing:
    """A fault under way: what takes it back at its end, and what it does every millisecond until then."""

    def __init__(self) -> None:
        self.end = ExitStack()
        self.ticks: list[Callable[[int], None]] = []

    def put(self, owner: object, name: str, value: object) -> None:
        """`owner.name` is `value` until the fault ends."""
        self.end.callback(setattr, owner, name, getattr(owner, name))
        setattr(owner, name, value)

    def listed(self, items: list[Any], item: object) -> None:
        """`item` is among `items` until the fault ends."""
        self.end.callback(items.remove, item)
        items.append(item)


Ids = frozenset[int]
Injection = Callable[[Ongoing, Lockstep, Params, int], object]


class At(Value, frozen=True):
    """An instant of a fault under way: its parameters, its chance, when, and what it keeps from one to the next."""

    p: Params
    rng: random.Random
    since_ns: int  # the fault began
    t_ns: int
    kept: dict[str, Any]


def put(part: str, value: object) -> Injection:
    """`part` of the run, by its dotted name, is `value` until the fault ends."""
    *owners, name = part.split(".")
    return lambda fault, rig, p, now_ns: fault.put(reduce(getattr, owners, rig), name, value)


def filtered(change: Callable[[Any, At], Any], p: Params, now_ns: int) -> Callable[[Any, int], Any]:
    """`change` of a value, with the instant of the fault that began at `now_ns`."""
    rng, kept = random.Random(p["chance"]), dict[str, Any]()
    return lambda value, t_ns: change(value, At(p, rng, t_ns - now_ns, t_ns, kept))


def together(*parts: Injection) -> Injection:
    """Several faults at the same instant."""

    def begin(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
        for part in parts:
            part(fault, rig, p, now_ns)

    return begin


Bands = tuple[tuple[float, float], ...]


class Draw:
    """One parameter: a number from one of several bands, or one of several words."""

    def __init__(self, name: str, *of: tuple[float, float] | str) -> None:
        self.name = name
        self.words = [one for one in of if isinstance(one, str)]
        self.bands = [one for one in of if not isinstance(one, str)]

    def drawn(self, rng: random.Random) -> Any:
        if self.words:
            return rng.choice(self.words)
        low, high = rng.choice(self.bands)
        if isinstance(low, int) and isinstance(high, int):
            return rng.randint(low, high)
        return round(rng.uniform(low, high), 3)

    def parsed(self, text: str) -> Any:
        """The value in `text`; ValueError: what it may be."""
        if self.words:
            if text not in self.words:
                raise ValueError(f"{self.name} is {text!r}: choose one of {', '.join(self.words)}")
            return text
        whole = all(isinstance(bound, int) for band in self.bands for bound in band)
        of_0 = min(low for low, _ in self.bands) >= 0
        try:
            value = int(text) if whole else float(text)
        except ValueError:
            value = math.nan
        if math.isnan(value) or (of_0 and value < 0):
            number = f"{'whole ' if whole else ''}number{' of 0 or more' if of_0 else ''}"
            raise ValueError(f"{self.name} is {text!r}, but must be a {number}")
        return value

    def __str__(self) -> str:
        if self.words:
            return f"{self.name} {', '.join(self.words)}"
        return f"{self.name} {', '.join(f'{low:g}…{high:g}' for low, high in self.bands)}"


lasts = partial(Draw, "duration")  # how long, in ms
CONTROL_MS: Final = 20  # a command comes every 20 ms: what is wrong with it shows that much later


class FaultKind(Value, frozen=True):
    """One row. Without a drawn `duration` the fault lasts."""

    name: str
    what: str
    begin: Injection
    must: Must | Graded
    draws: tuple[Draw, ...] = ()
    missions: frozenset[Ami] = EVERY_MISSION
    revisions: tuple[str, ...] = BOTH
    gps: bool = False
    from_start: bool = False  # there from power-up on: such a run begins there, and the demand holds for all of it

    @property
    def parameters(self) -> str:
        return "; ".join(str(draw) for draw in self.draws)


class Entry(Value, frozen=True):
    """The beginning of a row: its name, and what it is."""

    name: str
    what: str

    def by(self, begin: Injection, must: Must | Graded, *draws: Draw, **where: Any) -> FaultKind:
        return FaultKind(self.name, self.what, begin, must, draws, **where)


WHEELS: Final = ("fl", "fr", "rl", "rr")


def late(value: object, first: object, at: At) -> Any:
    """The value of `delay` ms ago; `first` before there was one."""
    waiting = at.kept.setdefault("waiting", deque())
    waiting.append((at.t_ns + at.p["delay"] * MS, value))
    while waiting and waiting[0][0] <= at.t_ns:
        at.kept["due"] = waiting.popleft()[1]
    return at.kept.get("due", first)


FEEDBACK_BANDS: Final = ((10, 60), (130, 240), (360, 2500))
UPSET: Final = lasts((100, 4000))
