"""Measurements as rows: the product's time and a peer's in turns, their ratio, and ratios beside a baseline's."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

BETWEEN_RUNS = 0.1  # by how much a ratio differs between two runs of the same code, beside the spread of their rounds
TOO_NOISY = 0.5  # what differs by more within a run shows no fall
Ratio = dict[str, Any]
Took = Callable[[], float]
"""A measurement: does its work, and returns how long one unit of that took."""


def timed(
    work: Callable[[], Any],
    scale: float,
    *,
    turns: int = 1,
    of: float = 1.0,
    timer: Callable[[], float] = time.process_time,
) -> Took:
    """Return a measurement: `scale` times the seconds of one unit of `work`, which is called so many times.

    of: how many units (frames, cycles) one call does.
    """

    def took() -> float:
        began_s = timer()
        for _ in range(turns):
            work()
        return scale * (timer() - began_s) / (turns * of)

    return took


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return median, least and most of one figure over the rounds, to four digits."""
    figures = {"median": statistics.median(values), "least": min(values), "most": max(values)}
    return {name: float(f"{figure:.4g}") for name, figure in figures.items()}


def row(name: str, unit: str, ours: Sequence[float], peer_name: str, peer: Sequence[float]) -> Ratio:
    """Return one row of the results. Its `ratio` is the peer's time over this project's, round by round."""
    ratios = [theirs / own for own, theirs in zip(ours, peer, strict=True)]
    figures = {"ours": spread(ours), "peer": spread(peer), "ratio": spread(ratios)}
    return {"name": name, "unit": unit, "peer_name": peer_name, **figures}


def in_turns(unit: str, rounds: int, peer: tuple[str, Took], *ours: tuple[str, Took], cold: int = 0) -> list[Ratio]:
    """Measure the peer and each work by name in every round, and return a row for each work.

    A machine that slows down slows both. The first `cold` rounds, in which is done what is done once, do not count.
    """
    works = (peer, *ours)
    took: dict[str, list[float]] = {name: [] for name, _ in works}
    for number in range(cold + rounds):
        # Neither is always the one that finds the caches warm.
        for name, measured in works if number % 2 else (*ours, peer):
            took[name].append(measured())
    return [row(name, unit, took[name][cold:], peer[0], took[peer[0]][cold:]) for name, _ in ours]


def fallen(rows: Sequence[Ratio], baseline: Ratio, processors: int) -> list[str]:
    """Return the ratios that fell below the baseline's by more than their noise, and what is measured no more.

    A wall time says nothing beside that of a machine with another number of processors.
    """
    now = {each["name"]: each["ratio"] for each in rows}
    found = []
    for name, was in ((each["name"], each["ratio"]) for each in baseline["results"]):
        if name not in now:
            found.append(f"{name} is not measured")
        elif not name.endswith(", wall") or processors == baseline["machine"]["processors"]:
            change = now[name]["median"] / was["median"] - 1
            noise = BETWEEN_RUNS + sum((one["most"] - one["least"]) / 2 / one["median"] for one in (now[name], was))
            if change < -noise and noise <= TOO_NOISY:
                found.append(f"{name} fell from {was['median']:.3g} to {now[name]['median']:.3g} ({change:.0%})")
    return found


def table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, its columns as wide as they need, all but the first to the right."""
    lines = [heads, *lines]
    first, *others = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rows = [[line[0].ljust(first), *map(str.rjust, line[1:], others)] for line in lines]
    rule = "|".join(["-" * (first + 2), *["-" * (width + 1) + ":" for width in others]])
    whole = ["| " + " | ".join(cells) + " |" for cells in rows]
    return "\n".join([whole[0], f"|{rule}|", *whole[1:]])
