"""The verdict table: what each kind of fault led to, how fast, and how often it was worse than the rules allow.

Made from a record, for people: `docs/evidence/faults.md` is such a table.
"""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from fsai_hil.evidence.campaign.cases import WINDOW_MS, WORLD_SEEDS
from fsai_hil.evidence.campaign.catalogue import KINDS, ROWS
from fsai_hil.evidence.campaign.faults.kind import FaultKind
from fsai_hil.evidence.work import Header

RunLine = Mapping[str, Any]
HEAD: Final = (
    "| fault | what it is | end demanded | reactions seen | runs | to the reaction, worst | to a safe state,"
    " median | worst | left the course | worse than allowed |\n|---|---|---|---|---:|---:|---:|---:|---:|---:|"
)
LISTED: Final = 40  # failures
_IN_MS: Final = frozenset({"duration", "delay"})  # parameters of faults


def failures(runs: Sequence[RunLine]) -> list[RunLine]:
    return [run for run in runs if run["verdict"] != "ok"]


def command_of(header: Header, runs: Sequence[RunLine]) -> str:
    """The command that makes this record."""
    full = sum(run["full"] for run in runs)
    words = [f"fsai-vcu campaign --runs {len(runs) - full} --full {full} --seed {header['seed']}"]
    for option, value, usual in (
        ("--faults", header["faults"], [kind.name for kind in ROWS]),
        ("--missions", header["missions"], []),
        ("--revisions", header["revisions"], []),
        ("--world-seeds", header["world_seeds"], WORLD_SEEDS),
        ("--window", header["window_ms"] / 1000, WINDOW_MS / 1000),
    ):
        if value != usual:
            words.append(f"{option} {','.join(value) if isinstance(value, list) else format(value, 'g')}")
    return " ".join(words)


def markdown(header: Header, runs: Sequence[RunLine]) -> str:
    """The whole document."""
    command = command_of(header, runs)
    short = [run for run in runs if not run["full"]]
    full = [run for run in runs if run["full"]]
    worse = failures(runs)
    kinds = {run["fault"] for run in runs}
    simulated_h = sum(run["sim_s"] for run in runs) / 3600.0
    lines = [
        "# Fault campaign",
        "",
        f"Made by `{command} -o docs/evidence/faults.md`; do not edit.",
        "",
        f"{len(runs)} runs of the whole AI side against the simulated car in lockstep, seed {header['seed']}:"
        f" {len(short)} of {header['window_ms'] / 1000:g} s from a snapshot in AS_DRIVING,"
        f" {len(full)} from power-up to the end;"
        f" {len(kinds)} kinds of fault, {simulated_h:.1f} simulated hours. In each run one fault begins at a random"
        " moment; the checker of the rules, which stands beside the CAN loop and does not know its decisions, judges"
        " every frame and every reaction by its time, and the catalogue says how each fault must end.",
        "",
        f"Sources (a digest of all code that a run uses, and of the signal databases): `{header['sources']}`.",
        "",
        f"**Worse than the rules allow: {len(worse)} of {len(runs)} runs.**",
        "",
        "- *To the reaction*: from the fault (where steering or a wheel must first become implausible: from the moment"
        " at which it certainly was) to the reaction on the bus: torque 0, the service brake, ESTOP_REQUEST, or the"
        " car's own emergency brake.",
        "- *To a safe state*: until the car truly stands or its EBS acts; where it drives on, until torque was 0.",
        "- Times in milliseconds. *Left the course* counts runs in which all four wheels did after the fault: no rule"
        " on the bus forbids it, and where the fault must change nothing it is worse than allowed.",
        "- *Worse than allowed* counts a wrong end, one that comes late, a broken rule (a late reaction is one), a"
        " process of this software that ended by an exception, and a stop although the rules let the car drive on.",
        "- Runs in which the mission was over before a reaction could be demanded are counted, and judged by the rules"
        " on the bus only.",
        "",
        HEAD,
    ]
    for kind in ROWS:
        mine = [run for run in short if run["fault"] == kind.name]
        if mine:
            lines.append(_row(kind.name, mine))
    if full:
        lines += [
            "",
            "## Full-length runs",
            "",
            "From power-up to the end of the mission, the fault at any phase. Outside AS_DRIVING, and in its first"
            " three seconds, no reaction is demanded: the rules on the bus hold, the car does not move before it may,"
            " and it comes to rest, wherever it is not in AS_DRIVING; a mission that is over is FINISHED.",
            "",
            "| fault begins | runs | ends seen | left the course | worse than allowed |",
            "|---|---:|---|---:|---:|",
        ]
        for phase in ("power-up", "AS_READY", "first 3 s of AS_DRIVING", "AS_DRIVING", "after the end"):
            mine = [run for run in full if _phase(run) == phase]
            if mine:
                lines.append(f"| {phase} | {len(mine)} | {_ends(mine)} | {_left(mine)} | {len(failures(mine))} |")
    if worse:
        lines += ["", "## Worse than allowed", ""]
        lines += [f"- `{run['replay']}`: {'; '.join(run['reasons'][:2])}" for run in worse[:LISTED]]
        if len(worse) > LISTED:
            lines.append(f"- … and {len(worse) - LISTED} more in the record")
    lines += [
        "",
        "## What a lockstep run cannot show",
        "",
        "The wall clock is no part of it: a step of that clock is done to the stamps of commands as far as the nodes'"
        " conversion lets it through. Processes are objects there: the CAN loop decides as on the car, but its bus, its"
        " hanging and its ending are simulated. The same faults on real processes and a real vcan0 are the HIL"
        " suite's.",
        "",
    ]
    return "\n".join(lines)


def _row(name: str, runs: Sequence[RunLine]) -> str:
    kind = KINDS[name]
    applied = [run for run in runs if run["applies"]]
    reactions = [run["reaction_ms"] for run in applied if run["reaction_ms"] is not None]
    safe = [run["safe_ms"] for run in applied if run["safe_ms"] is not None]
    what = kind.what + (f" ({kind.parameters})" if kind.draws else "")
    slowest = f"{_ms(max(reactions, default=None))} | {_ms(statistics.median(safe) if safe else None)}"
    return (
        f"| `{name}` | {what} | {kind.must.demanded} | {_seen(runs)} | {len(runs)} | {slowest} |"
        f" {_ms(max(safe, default=None))} | {_left(runs)} | {len(failures(runs))} |"
    )


def _left(runs: Sequence[RunLine]) -> int:
    return sum(run["off_course"] > 0 for run in runs)


def _seen(runs: Sequence[RunLine]) -> str:
    return _counted(
        "mission over before" if not run["applies"] and run["end"] == "ON" else run["reaction"] for run in runs
    )


def _ends(runs: Sequence[RunLine]) -> str:
    return _counted("drives to its end" if run["end"] == "ON" else run["reaction"] for run in runs)


def _counted(words: Iterable[str]) -> str:
    return ", ".join(f"{one} ({count})" for one, count in Counter(words).most_common())


def _phase(run: RunLine) -> str:
    if run["since"] == "driving":
        return "AS_DRIVING" if run["after_ms"] >= 3000 else "first 3 s of AS_DRIVING"
    return {"start": "power-up", "ready": "AS_READY", "finished": "after the end"}[run["since"]]


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.0f}"


def _drawn(kind: FaultKind) -> str:
    return "; ".join(f"{draw}{' ms' * (draw.name in _IN_MS)}" for draw in kind.draws)


def catalogue_lines(word: str = "") -> list[str]:
    """The catalogue for a terminal, or the lines of it with that word: `--list-faults`."""
    width = max(len(kind.name) for kind in ROWS)
    lines = [f"{kind.name:<{width}}  {kind.what}" + (f" [{_drawn(kind)}]" if kind.draws else "") for kind in ROWS]
    words = word.casefold().split()
    return [line for line in lines if all(each in line.casefold() for each in words)] or [
        f"no kind of fault with '{word}'"
    ]
