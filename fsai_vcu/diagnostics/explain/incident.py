"""Parts of an explanation: events of the timeline, and incidents with their candidate causes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from functools import cached_property
from typing import Any, Final, NamedTuple, Protocol, TypeVar

from fsai_vcu.diagnostics.explain.causes import CAUSES, Cause
from fsai_vcu.diagnostics.remedies import OURS, Setting
from fsai_vcu.interface.bus_table import BY_ID


class Weight(IntEnum):
    """Weight of an event to a reader."""

    NOTE = 0
    STATE = 1
    WARNING = 2
    FAULT = 3


@dataclass(frozen=True, slots=True)
class TimelineEntry:
    """One line of the timeline."""

    t_ns: int
    topic: str
    text: str
    weight: Weight = Weight.NOTE
    can_id: int | None = None
    signal: str = ""


class IncidentKind(Enum):
    """Kind of an incident: its name, the words of the heading, and what one and several of it are called."""

    EMERGENCY = ("emergency_brake", "emergency brake", "emergency brake", "emergency brakes")
    ABORT = ("abort", "the drive was cut off", "drive cut off", "drives cut off")
    REFUSAL = ("refusal_to_start", "refusal to start", "refusal to start", "refusals to start")
    MISMATCH = (
        "not_as_asked", "the car does not do what it is asked", "thing not as asked", "things not as asked"
    )  # fmt: skip
    STOP = ("early_stop", "stopped before the mission was done", "early stop", "early stops")
    STAND = ("not_driving", "the car does not drive in AS_DRIVING", "time without driving", "times without driving")

    def __init__(self, slug: str, words: str, one: str, many: str) -> None:
        self.slug = slug
        self.words = words
        self.one = one
        self.many = many


class Sureness(IntEnum):
    """Sureness of a candidate: how well it is founded."""

    POSSIBLE = 0
    FITS = 1
    SHOWN = 2
    SAID = 3

    @property
    def words(self) -> str:
        return ("cannot be excluded", "fits the frames", "the frames show it", "the car says so")[self]


class Claim(NamedTuple):
    """A sentence's value of a signal (message, name): in force at `begin_ns`, and in each frame up to `end_ns`."""

    signal: tuple[str, str]
    low: float
    high: float
    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class ChainLink:
    """One link of a cause chain: what a frame shows, and when.

    `claims`: what the words say of signals; `proof.py` holds them against the frames before anybody reads the words.
    """

    t_ns: int
    words: str
    can_id: int | None = None
    signal: str = ""
    claims: tuple[Claim, ...] = ()

    @property
    def frame(self) -> str:
        """`0x520 VCU2AI_Status`, or nothing where no one frame says it."""
        if self.can_id is None:
            return ""
        known = BY_ID.get(self.can_id)
        return f"0x{self.can_id:03X} {known.name}" if known else f"0x{self.can_id:03X}"


@dataclass(frozen=True, slots=True)
class Candidate:
    """One cause that may be behind an incident, with its evidence, the earliest first.

    `setting` chooses what is to be done.
    """

    slug: str
    sureness: Sureness
    steps: tuple[ChainLink, ...]
    setting: Setting = OURS

    @property
    def cause(self) -> Cause:
        return replace(CAUSES[self.slug], setting=self.setting)

    @property
    def t_ns(self) -> int:
        return self.steps[0].t_ns


def candidate(slug: str, sureness: Sureness, *steps: ChainLink) -> Candidate:
    """A candidate with its steps in the order of time, each once. Raises KeyError for a cause that is in no table."""
    return Candidate(CAUSES[slug].slug, sureness, tuple(sorted(dict.fromkeys(steps), key=lambda step: step.t_ns)))


def shown(slug: str, *steps: ChainLink) -> Candidate:
    """A cause that the frames show."""
    return candidate(slug, Sureness.SHOWN, *steps)


@dataclass(frozen=True, slots=True)
class Incident:
    """One emergency brake, refusal, cut-off drive or early stop. `candidates` are ranked, the likeliest first.

    planned: the mission ends like this, nothing is to be put right. lasted: from when to when, where it is no moment.
    """

    kind: IncidentKind
    t_ns: int
    what: str
    candidates: tuple[Candidate, ...]
    planned: bool = False
    lasted: tuple[int, int] | None = None

    @property
    def begin_ns(self) -> int:
        return self.lasted[0] if self.lasted else self.t_ns

    @property
    def end_ns(self) -> int:
        return self.lasted[1] if self.lasted else self.t_ns


class HasSpan(Protocol):
    """Thing with a begin and an end."""

    @property
    def begin_ns(self) -> int: ...
    @property
    def end_ns(self) -> int: ...


Some = TypeVar("Some", bound=HasSpan)
TimeRange = tuple[float, float]  # from, to, in ns of the log's clock
ALWAYS: Final[TimeRange] = (-math.inf, math.inf)


def within(part_ns: TimeRange, things: Iterable[Some]) -> Iterator[Some]:
    """Yield the things with a moment in that time."""
    return (one for one in things if one.begin_ns <= part_ns[1] and one.end_ns >= part_ns[0])


def ranked(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Rank the candidates: the best founded first, of equals the earliest, one of each cause."""
    found: dict[str, Candidate] = {}
    for one in sorted(candidates, key=lambda c: (-c.sureness, c.t_ns)):
        found.setdefault(one.slug, one)
    return tuple(found.values())


@dataclass(frozen=True)
class Explanation:
    """The whole of it. `timeline` makes the events when they are asked for: a verdict needs none."""

    heading: dict[str, Any]
    timeline: Callable[[], Iterable[TimelineEntry]]
    incidents: tuple[Incident, ...]
    closing: str
    end_ns: int  # of what is told
    problems: tuple[str, ...] = field(default=())
    recorded: frozenset[int] = frozenset()  # identifiers in the log
    unknown: str = ""  # why nobody can tell what happened, where that is so

    @cached_property
    def events(self) -> tuple[TimelineEntry, ...]:
        """Everything that happened, in the order of time."""
        return tuple(self.timeline())

    def to_record(self, cause: Cause) -> str:
        """Return what to record next time for that cause; '' where this log has it, or this car sends no such thing."""
        wanted = {int(number, 16) for number in re.findall(r"0x([0-9A-F]{3})", cause.record)}
        lacking = {i for i in wanted if self.heading["revision"] in BY_ID[i].period_ns} - self.recorded
        if wanted and len(lacking) < len(wanted):
            return ", ".join(str(BY_ID[can_id]) for can_id in sorted(lacking))
        return cause.record

    @property
    def clean(self) -> bool:
        """Nothing happened but what was planned."""
        return not self.unknown and all(incident.planned for incident in self.incidents)
