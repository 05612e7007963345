"""The survivors that no test can kill, each with the reason; and the judgement on a run.

An entry of `tests/evidence/survivors.toml` names a mutant by its place and its lines, not by line numbers, so that it
stays true while the code around it moves and fails when the code itself changes.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from fsai_hil.evidence.mutation.operators import Mutant
from fsai_hil.evidence.mutation.trial import KILLED, TIMED_OUT, Verdict, root

Key = tuple[str, str, str, int]

LIST = Path("tests/evidence/survivors.toml")

_FIELDS = {"where", "minus", "plus", "nth", "why"}


class ListError(ValueError):
    """The list of explained survivors cannot be used."""


def load(path: Path | None = None) -> dict[Key, str]:
    """Mutant -> why no test can tell it from the code as it is. `plus` may list several that share a reason."""
    text = (path or root() / LIST).read_text()
    explained: dict[Key, str] = {}
    for number, entry in enumerate(tomllib.loads(text).get("survivor", []), start=1):
        unknown, lacking = entry.keys() - _FIELDS, _FIELDS - {"nth"} - entry.keys()
        if unknown or lacking:
            raise ListError(f"survivor {number}: unknown {sorted(unknown)}, missing {sorted(lacking)}")
        if len(entry["why"].split()) < 5:
            raise ListError(f"survivor {number}: why is {entry['why']!r}: a reason is a sentence")
        pluses = entry["plus"] if isinstance(entry["plus"], list) else [entry["plus"]]
        for plus in pluses:
            key = (entry["where"], _lines(entry["minus"]), _lines(plus), entry.get("nth", 1))
            if key in explained:
                raise ListError(f"survivor {number}: {key} is listed twice")
            explained[key] = " ".join(entry["why"].split())
    return explained


def _lines(text: str) -> str:
    return "\n".join(line.strip() for line in text.strip().splitlines())


def stale(explained: Mapping[Key, str], mutants: Iterable[Mutant]) -> list[Key]:
    """Entries that name no mutant of the code as it is now."""
    known = {mutant.key for mutant in mutants}
    return [key for key in explained if key not in known]


@dataclass(slots=True)
class Judgement:
    """What a run shows."""

    killed: int
    timed_out: int
    explained: list[Mutant]
    unexplained: list[Mutant]
    wrongly_explained: list[Mutant]  # a test kills it: it is not equivalent

    @property
    def tried(self) -> int:
        return self.killed + self.timed_out + len(self.explained) + len(self.unexplained)

    @property
    def caught(self) -> int:
        return self.killed + self.timed_out

    @property
    def holds(self) -> bool:
        return not (self.unexplained or self.wrongly_explained)


def judge(results: Iterable[tuple[Mutant, Verdict]], explained: Mapping[Key, str]) -> Judgement:
    """Killed, explained, or missing a test."""
    judgement = Judgement(0, 0, [], [], [])
    for mutant, verdict in results:
        if verdict.outcome in (KILLED, TIMED_OUT):
            judgement.killed += verdict.outcome == KILLED
            judgement.timed_out += verdict.outcome == TIMED_OUT
            if mutant.key in explained:
                judgement.wrongly_explained.append(mutant)
        elif mutant.key in explained:
            judgement.explained.append(mutant)
        else:
            judgement.unexplained.append(mutant)
    return judgement
