"""Cases: which fault, in which mission, when. Case N of seed S follows from the two numbers alone.

So any case can be made again on any machine, in any order, without the ones before it.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from enum import Enum
from functools import cache
from types import MappingProxyType
from typing import Any, Final

from msgspec import field

from fsai_hil.evidence.campaign.catalogue import ROWS, kind_named
from fsai_hil.evidence.campaign.faults.kind import EVERY_MISSION, Draw, FaultKind
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.values import Value

WORLD_SEEDS: Final = 3  # cone noise and the rest of a run's chance; the campaign's variety lies in the faults
CHANCES: Final = 100_000
WINDOW_MS: Final = 10_000  # how long a run from a snapshot lasts

Task = tuple[bool, int]  # full-length or not, and the case's number


class Since(Enum):
    """The begin from which a fault's moment counts."""

    START = "start"
    READY = "ready"
    DRIVING = "driving"
    FINISHED = "finished"

    @property
    def state(self) -> AsState | None:
        """The AS state that begins it; None: the run's beginning."""
        return None if self is Since.START else AsState[f"AS_{self.name}"]


# What a fault by hand is given besides its own parameters.
SINCE: Final = Draw("since", *(moment.value for moment in Since))
AFTER, CHANCE = (Draw(name, (0, CHANCES)) for name in ("after", "chance"))

# Snapshots: so long in AS_DRIVING, in ms. A mission is under way for at least LEG_MS after its last one.
LEG_MS: Final = 6000
LONG_MISSIONS: Final = (Ami.SKIDPAD, Ami.AUTOCROSS, Ami.TRACKDRIVE)
LEGS_MS: Final[Mapping[Ami, tuple[int, ...]]] = MappingProxyType(
    {ami: (3000, 14000, 25000) if ami in LONG_MISSIONS else (3000,) for ami in EVERY_MISSION}
)

# Full-length runs: where in a run the fault may begin, in ms after a moment.
PHASES_MS: Final = (
    (Since.START, 0, 9000),  # switches, self-test, tractive system
    (Since.READY, 0, 6000),
    (Since.DRIVING, 0, 3000),  # the 3 s of standing still
    (Since.DRIVING, 3000, 30000),
    (Since.FINISHED, 0, 2500),
)
# Runs in hundreds: the missions that do not last long are driven most.
FULL_LENGTH: Final = (
    Ami.ACCELERATION,
    Ami.ACCELERATION,
    Ami.AUTONOMOUS_DEMO,
    Ami.STATIC_INSPECTION_A,
    Ami.STATIC_INSPECTION_B,
    Ami.SKIDPAD,
    Ami.AUTOCROSS,
)


class Case(Value, frozen=True):
    """One run of the campaign. Times in ms."""

    fault: str
    mission: Ami
    revision: str
    seed: int  # of the world
    since: Since = Since.DRIVING
    after_ms: int = 4000
    params: Mapping[str, Any] = field(default_factory=dict)
    full: bool = False  # from power-up to the end of the mission, instead of ten seconds
    index: int = 0

    @property
    def kind(self) -> FaultKind:
        return kind_named(self.fault)

    @property
    def world(self) -> tuple[Ami, str, int, bool]:
        """Return what decides the run before the fault."""
        return self.mission, self.revision, self.seed, self.kind.gps

    @property
    def leg_ms(self) -> int | None:
        """The snapshot from which the case may begin; None: from power-up."""
        if self.full or self.since is not Since.DRIVING:
            return None
        return max((leg for leg in LEGS_MS[self.mission] if leg < self.after_ms), default=None)

    @property
    def spec(self) -> str:
        """Return the case as `--fault` takes it."""
        values = {"since": self.since.value, "after": self.after_ms, **self.params}
        return f"{self.fault}:" + ",".join(f"{name}={value}" for name, value in values.items())

    @property
    def replay(self) -> str:
        """The command that drives this very case again and explains it."""
        return (
            f"fsai-vcu drive --mission {self.mission.name.lower()} --revision {self.revision} --seed {self.seed}"
            f"{' --full' if self.full else ''} --fault {self.spec}"
        )


class CampaignPlan(Value, frozen=True):
    """A campaign: how many cases, and of which part of the catalogue. Its cases follow from it and their index.

    Asking for them raises ValueError for an unknown name or an empty choice.
    """

    seed: int
    runs: int = 0
    full: int = 0  # of full length
    faults: tuple[str, ...] = ()  # none: all
    missions: tuple[Ami, ...] = ()
    revisions: tuple[str, ...] = ()
    world_seeds: int = WORLD_SEEDS
    window_ms: int = WINDOW_MS

    def kinds(self) -> tuple[FaultKind, ...]:
        return _usable(self)

    def missions_of(self, kind: FaultKind) -> tuple[Ami, ...]:
        return tuple(ami for ami in Ami if ami in kind.missions and (not self.missions or ami in self.missions))

    def revisions_of(self, kind: FaultKind) -> tuple[str, ...]:
        return tuple(name for name in kind.revisions if not self.revisions or name in self.revisions)

    def tasks(self) -> list[Task]:
        """Full-length runs first: the longest ones must not be left to the end."""
        return [(True, index) for index in range(self.full)] + [(False, index) for index in range(self.runs)]

    def case(self, index: int, *, full: bool = False) -> Case:
        """Kinds take turns; everything else is drawn."""
        kinds = self.kinds()
        kind = kinds[index % len(kinds)]
        rng = random.Random(f"{self.seed}/{'full' if full else 'short'}/{kind.name}/{index // len(kinds)}")
        missions: Sequence[Ami] = self.missions_of(kind)
        if full:
            missions = [ami for ami in FULL_LENGTH if ami in missions] or missions
        mission = rng.choice(missions)
        revision = rng.choice(self.revisions_of(kind))
        world_seed = rng.randrange(self.world_seeds)
        if kind.from_start:
            since, after_ms = Since.START, 0
        elif full:
            since, low, high = rng.choice(PHASES_MS)
            after_ms = rng.randint(low, high)
        else:
            within_ms = min(LEG_MS, 6 * self.window_ms // 10)
            since, after_ms = Since.DRIVING, rng.choice(LEGS_MS[mission]) + rng.randint(50, within_ms)
        return Case(kind.name, mission, revision, world_seed, since, after_ms, drawn(kind, rng), full, index)


@cache
def _usable(plan: CampaignPlan) -> tuple[FaultKind, ...]:
    chosen = tuple(kind_named(name) for name in plan.faults) or ROWS
    usable = tuple(kind for kind in chosen if plan.missions_of(kind) and plan.revisions_of(kind))
    if not usable:
        raise ValueError("none of these faults applies to these missions and revisions")
    return usable


def drawn(kind: FaultKind, rng: random.Random, given: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """A value for each of the kind's parameters, and for its own chance; `given` ones stay."""
    values = {draw.name: draw.drawn(rng) for draw in kind.draws}
    values["chance"] = rng.randrange(CHANCES)
    return {**values, **(given or {})}


def case_from_spec(text: str, *, mission: Ami | None, revision: str, seed: int, full: bool) -> Case:
    """A case from `NAME[:since=…,after=MS,parameter=value,…]`; what is not given is drawn by `seed`.

    Raises ValueError, with one clear line, for anything that cannot be meant.
    """
    name, _, rest = text.partition(":")
    kind = kind_named(name)
    known = {draw.name: draw for draw in (SINCE, AFTER, *kind.draws, CHANCE)}
    given: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, equals, value = part.partition("=")
        if not equals:
            raise ValueError(f"fault {name}: {part!r} is not NAME=VALUE")
        if key not in known:
            raise ValueError(f"fault {name} has no parameter {key!r}: there are {', '.join(known)}")
        given[key] = known[key].parsed(value)
    since = Since(given.pop("since", "start" if kind.from_start else "driving"))
    after_ms: int | None = given.pop("after", 0 if kind.from_start else None)
    rng = random.Random(f"{seed}/by hand/{name}")
    values = drawn(kind, rng, given)
    if mission is None:
        mission = next(ami for ami in (Ami.AUTOCROSS, *Ami) if ami in kind.missions)
    elif mission not in kind.missions:
        there = ", ".join(ami.name.lower() for ami in Ami if ami in kind.missions)
        raise ValueError(f"fault {name} does not apply to {mission.name.lower()}: choose one of {there}")
    if revision not in kind.revisions:
        raise ValueError(f"fault {name} does not apply to revision {revision}: only to {', '.join(kind.revisions)}")
    if after_ms is None:
        after_ms = rng.randint(3050, 3000 + LEG_MS) if since is Since.DRIVING else rng.randint(0, 2000)
    return Case(kind.name, mission, revision, seed, since, after_ms, values, full)
