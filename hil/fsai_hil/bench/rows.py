"""Measurements as rows: the product's time and a peer's in turns, their ratio, and ratios beside a baseline's."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

BETWEEN_RUNS = 0.1  # by how much a ratio differs between two runs of the same code, beside the spread of their rounds
TOO_NOISY = 0.5  # what differs by more within a run shows no fall
Row = dict[str, Any]
Took = Callable[[], float]
"""A measurement: does its work, and returns how long one unit of that took."""


def timed(
    work: Callable[[], Any],
    scale: float,
    *,
    turns: int = 1,
    of: float | None = None,
    timer: Callable[[], float] = time.process_time,
) -> Took:
    """Return a measurement: `scale` times the seconds of one unit of `work`, which is called so many times.

    of: how many units (frames, cycles) one call does; None: each call returns it.
    """

    def took() -> float:
        began_s = timer()
        for _ in range(turns):
            done = work()
        return scale * (timer() - began_s) / (turns * (done if of is None else of))

    return took


def spread(values: Sequence[float]) -> dict[str, float] | None:
    """Return median, least and most of one figure over the rounds, to four digits; None where there are no values."""
    figures = {"median": statistics.median(values), "least": min(values), "most": max(values)} if values else {}
    return {name: float(f"{figure:.4g}") for name, figure in figures.items()} or None


def row(name: str, unit: str, ours: Sequence[float], peer_name: str = "", peer: Sequence[float] = ()) -> Row:
    """Return one row of the results. Its `ratio` is the peer's time by ours, round by round; None without a peer."""
    figures = {"ours": spread(ours), "peer": spread(peer)}
    ratio = spread([theirs / own for own, theirs in zip(ours, peer, strict=False)])
    return {"name": name, "unit": unit, "peer_name": peer_name, **figures, "ratio": ratio}


def in_turns(unit: str, rounds: int, peer: tuple[str, Took], *ours: tuple[str, Took], cold: int = 0) -> list[Row]:
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


def compared(rows: Sequence[Row], baseline: Row, here: Row) -> tuple[str, list[str]]:
    """Return a table of each ratio beside the baseline's, and the names of those that fell by more than their noise.

    `here` describes this machine: a wall time says nothing beside that of a machine with other processors.
    """
    before = {each["name"]: each["ratio"] for each in baseline["results"]}
    processors = baseline["machine"]["processors"]
    lines, fell = [], []
    for name, now in ((each["name"], each["ratio"]) for each in rows if each["name"] in before):
        was, words = before[name], ""
        change = now["median"] / was["median"] - 1
        noise = BETWEEN_RUNS + sum((each["most"] - each["least"]) / 2 / each["median"] for each in (now, was))
        if name.endswith(", wall") and here["processors"] != processors:
            words = f"not judged: {here['processors']} processors, and {processors} in the baseline"
        elif noise > TOO_NOISY:
            words = "not judged: too noisy"
        elif change < -noise:
            words = "FELL"
            fell.append(name)
        lines.append((name, f"{was['median']:.3g}", f"{now['median']:.3g}", f"{change:.0%}", f"{noise:.0%}", words))
    return table(("ratio", "baseline", "now", "change", "noise", ""), lines), fell


def table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, its columns as wide as they need, all but the first to the right."""
    lines = [heads, *lines]
    first, *others = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rows = [[line[0].ljust(first), *map(str.rjust, line[1:], others)] for line in lines]
    rule = "|".join(["-" * (first + 2), *["-" * (width + 1) + ":" for width in others]])
    whole = ["| " + " | ".join(cells) + " |" for cells in rows]
    return "\n".join([whole[0], f"|{rule}|", *whole[1:]])
