"""The report of a measurement, for people: a table, the verdict in plain words, and what the figures mean."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fsai_hil.rehearsal.scrutineering.load import FILL_ID
from fsai_hil.rehearsal.scrutineering.machine import scheduling_in_words
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import MS

ECHO_LIMIT_MS = MESSAGE_LIMIT_MS = COMMS_LOST_NS // MS
IDLE_P50_MS, IDLE_P99_MS = 1.0, 3.0
MOST_MS = 20.0  # under any load
PEER_SHARE = 0.5  # of the C loop's p99
_IDLE, _EMERGENCY = "idle", "EMERGENCY_BRAKE"
_FEW = 1000  # under so many echoes a p99.9 is the maximum by another name
_FIGURES = ("p50_ms", "p99_ms", "max_ms")


def failures(measured: Mapping[str, Any]) -> list[str]:
    """Say what was measured and is not as it should be; nothing when all is. See also `not_measured`."""
    found = []
    for row in measured["conditions"]:
        reasons = [f"{row['name']}: {words}" for words in (*_late(row), *_slow(row))]
        if reasons and row["machine_stalls_ms"]:
            reasons[-1] += (
                " (a stall monitor beside it saw the machine itself stand still, for up to "
                f"{max(row['machine_stalls_ms']):.0f} ms: measure again before blaming the bridge)"
            )
        found += reasons
    return found


def _late(row: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is late by the VCU's own limits."""
    response = row["response"]
    if not response["count"]:
        yield "the VCU saw no echo at all"
    elif row["comms_losses"]:
        yield f"the VCU raised AI_COMMS_LOST {_times(row['comms_losses'])}"
    elif response["max_ms"] >= ECHO_LIMIT_MS:
        yield f"an echo took {response['max_ms']:.1f} ms, and the VCU allows {ECHO_LIMIT_MS} ms"
    elif _EMERGENCY in row["ended_early"]:
        yield f"{row['ended_early']} before the time was up"


def _slow(row: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is slow between the two frames on the bus.

    p50 and p99 have fixed limits when nothing else goes on; the maximum's limit and the peer's times count always.
    """
    ours, peer = row["wire"], row["peer"]["wire"]
    if not ours["count"] or not peer["count"]:
        if row["response"]["count"]:
            yield "the log of the bus shows no echo"
        return
    if not row["log_complete"]:
        yield "the log of the bus misses frames, so nothing can be compared"
        return
    if row["name"] == _IDLE:
        for key, limit_ms in (("p50_ms", IDLE_P50_MS), ("p99_ms", IDLE_P99_MS)):
            if ours[key] > limit_ms:
                yield f"{key.removesuffix('_ms')} is {ours[key]:.2f} ms, above {limit_ms:g} ms"
    if ours["max_ms"] > MOST_MS:
        yield f"the maximum is {ours['max_ms']:.2f} ms, above {MOST_MS:g} ms"
    if ours["max_ms"] > peer["max_ms"]:
        yield f"the maximum is {ours['max_ms']:.2f} ms, the C loop's {peer['max_ms']:.2f} ms"
    if ours["p99_ms"] > PEER_SHARE * peer["p99_ms"]:
        yield f"p99 is {ours['p99_ms']:.2f} ms, more than half of the C loop's {peer['p99_ms']:.2f} ms"


def not_measured(measured: Mapping[str, Any]) -> list[str]:
    """Return what could not be measured, or not to the end for want of commands to drive by, by why."""
    names: dict[str, list[str]] = {}
    for name, why in measured["not_measured"].items():
        names.setdefault(why, []).append(name)
    for row in measured["conditions"]:
        if row["ended_early"] and _EMERGENCY not in row["ended_early"]:
            names.setdefault(row["ended_early"], []).append(f"{row['name']} after {row['seconds']:.0f} s")
    return [f"{', '.join(those)} ({why})" for why, those in names.items()]


def verdict(measured: Mapping[str, Any]) -> str:
    """One paragraph."""
    reasons, left_out = failures(measured), not_measured(measured)
    missing = f" Not measured: {'; '.join(left_out)}." if left_out else ""
    if reasons:
        return f"FAIL. {'; '.join(reasons)}.{missing}"
    rows = measured["conditions"]
    worst = max(rows, key=lambda row: row["response"]["max_ms"])
    count = sum(row["response"]["count"] for row in rows)
    return (
        f"{'INCOMPLETE' if left_out else 'PASS'}. In every condition measured the VCU was answered in time: of {count} "
        f"echoes it saw the slowest took {worst['response']['max_ms']:.2f} ms ({worst['name']}), where it allows "
        f"{ECHO_LIMIT_MS} ms, and it never raised AI_COMMS_LOST. Between the two frames on the bus no maximum was "
        f"above {MOST_MS:g} ms or above the C loop's under the same load, and no p99 above half of its; "
        f"idle p50 is to be at most "
        f"{IDLE_P50_MS:g} ms and p99 {IDLE_P99_MS:g} ms.{missing}"
    )


def markdown(measured: Mapping[str, Any]) -> str:
    """The whole report. `measured` is the rehearsal's result with `date`, `place`, `pace`, `host`, `versions`
    and `source`."""
    rows = measured["conditions"]
    parts = (
        "# Handshake response time",
        "The VCU alternates the HANDSHAKE bit of 0x520, and waits for each new value to come back in 0x510 before it\n"
        "toggles again. The time from toggle to echo is the AI computer's response time. Made by\n"
        "`fsai-vcu scrutineering`, from the real processes on a SocketCAN bus, and in the same run from a peer: the\n"
        "C loop, written after the manner of the car's library: it polls every 10 ms\n"
        "(`hil/fsai_hil/rehearsal/scrutineering/polling_loop.c`).",
        f"**{verdict(measured)}**",
        "## Between the two frames on the bus",
        _table(rows, "wire"),
        "By the kernel's time stamps of the two frames, without the simulated VCU's own delays: fair to both, and\n"
        "what is judged. *C loop*: alone with the car in AS_OFF, under the same load, for it drives nothing; beside\n"
        "*standing* and *driving* it so has the processor to itself, where the bridge shares it with the nodes.",
        _legend(rows),
        "## As the VCU sees it",
        _table(rows, "response"),
        "From the instant at which the 0x520 with the new bit was due until the simulated VCU has received its echo.\n"
        "So each figure holds that VCU's own lateness in sending and receiving, which is a Python process here. An\n"
        "echo over 10 ms comes after the VCU's next 0x520: a missed cycle, of which the VCU allows nine in a row.",
        "## What else went on",
        _surroundings(rows),
        "*Bus*: what was on it in all, stuff bits not counted, and its share of 500 kbit/s. *VCU late*: how late the\n"
        "simulated VCU itself sent its 0x520. *Stalls*: a process that only sleeps, with a higher priority than all\n"
        "others, was woken more than 20 ms late. *Time-outs*: AI_COMMS_LOST raised.",
        "## What the VCU allows",
        "| what | limit | source |\n|---|---|---|\n"
        f"| echo of a toggled HANDSHAKE | {ECHO_LIMIT_MS} ms | interface specification v4.0 |\n"
        f"| any one of 0x510 to 0x514 missing | {MESSAGE_LIMIT_MS} ms: ten in a row | interface specification v4.0 |",
        "Either limit reached is AI_COMMS_LOST, and in AS_READY, AS_DRIVING and AS_FINISHED an emergency stop.",
        "## How it was measured",
        _method(measured),
        "## On what",
        _machine(measured),
    )
    return "\n\n".join(parts) + "\n"


def summary(measured: Mapping[str, Any]) -> str:
    """Return the measured times as a table for a terminal."""
    lines = []
    for title, key in (("on the bus", "wire"), ("as the VCU sees it", "response")):
        lines.append(
            f"{title + ', ms':<22}{'echoes':>8}{'p50':>8}{'p99':>8}{'max':>8}   C loop: p50 {'p99':>7}{'max':>8}"
        )
        for row in measured["conditions"]:
            ours = "".join(f"{_ms(row[key][name]):>8}" for name in _FIGURES)
            peer = "".join(f"{_ms(row['peer'][key][name]):>8}" for name in _FIGURES)
            lines.append(f"{row['name']:<22}{row[key]['count']:>8}{ours}{peer:>32}")
        lines.append("")
    return "\n".join((*lines, verdict(measured)))


# ---------------------------------------------------------------- parts


def _table(rows: Sequence[Mapping[str, Any]], key: str) -> str:
    """Ours and the peer's; `key`: by whom they are timed."""
    lines = [
        "| condition | echoes | p50 ms | p99 ms | p99.9 ms | max ms | over 10 ms "
        "| C loop: p50 ms | p99 ms | max ms | over 10 ms |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        ours, peer = row[key], row["peer"][key]
        figures = (*(_ms(ours[name]) for name in ("p50_ms", "p99_ms", "p999_ms", "max_ms")), _share(ours))
        others = (*(_ms(peer[name]) for name in _FIGURES), _share(peer))
        lines.append(f"| {row['name']} | {ours['count']} | {' | '.join((*figures, *others))} |")
    return "\n".join(lines)


def _legend(rows: Sequence[Mapping[str, Any]]) -> str:
    """Describe each condition, and what its log showed of the rules."""
    lines = [
        f"- **{row['name']}**: {row['words']}" + (f" ({note})" if (note := row["ended_early"] or row["stood"]) else "")
        for row in rows
    ]
    notes = []
    if any(row["response"]["count"] < _FEW for row in rows):
        notes.append(f"Where there are fewer than {_FEW} echoes, p99.9 is no more than the maximum.")
    broken = [f"{row['name']}: {text}" for row in rows if row["log_complete"] for text in row["rules_broken"]]
    gaps = [row["name"] for row in rows if not row["log_complete"]]
    notes.append(
        "Meanwhile the log of the bus showed every rule kept that can be seen there."
        if not broken
        else "On the bus rules were seen broken: " + "; ".join(broken)
    )
    if gaps:
        notes.append(f"That log misses frames in {', '.join(gaps)}, where it shows neither rules nor times reliably.")
    return "\n".join(lines) + "\n\n" + " ".join(notes)


def _surroundings(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        "| condition | seconds | frames/s | bus | VCU late p99/max ms | stalls | time-outs | of the C loop |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        late, stalls = row["status_late"], row["machine_stalls_ms"]
        stalled = f"{len(stalls)}, up to {max(stalls):.0f} ms" if stalls else "none"
        lines.append(
            f"| {row['name']} | {row['seconds']:.0f} | {row['frames_per_s']} | {row['bus_load_pct']:.0f} % "
            f"| {_ms(late['p99_ms'])} / {_ms(late['max_ms'])} | {stalled} | {row['comms_losses']} "
            f"| {row['peer']['comms_losses']} |"
        )
    return "\n".join(lines)


def _method(measured: Mapping[str, Any]) -> str:
    """Describe how the figures were measured, and what they do not mean."""
    decimation = measured["decimation"]
    held_up_ms = sum(row["held_up_ms"] for row in measured["conditions"])
    points = [
        "Every echo counts; nothing is left out, averaged or sampled. Percentiles are nearest ranks of exact times.",
        "Bridge, nodes, simulated car, C loop and load are processes of their own. Load and C loop run at normal "
        "priority, as other programs on the AI computer do. The C loop is measured first, bridge and nodes afterwards.",
        f"The bus is filled by `cangen` with identifier 0x{FILL_ID:X}, on top of the car's own frames, with what is "
        "left of 500 kbit/s. vcan has no bitrate: no frame waits there for another. On a real, full bus a 0x510 waits "
        "for the frame that is being sent, a quarter of a millisecond, and for those of higher priority.",
    ]
    if held_up_ms:
        points.append(
            f"The simulated VCU itself was held up for more than 50 ms at a time, {held_up_ms:.0f} ms in all; its "
            "clock stands still meanwhile, so that time is in no figure."
        )
    if max(decimation.values()) > 1:
        points.append(
            f"One slow processor: of the PCAN-GPS's frames only each {decimation['gps']}th was sent, of the logging "
            f"frames each {decimation['log']}th."
        )
    if measured["place"] == "uml":
        points.append(
            "The vcan0 was that of User-Mode Linux, because this machine's kernel has none. There a system call costs "
            "many times what it costs elsewhere and everything shares one processor: the figures are not "
            "those of an ordinary computer. What is written to the "
            "disk is not forced onto it there, because that stops the inner kernel whole. On the car's own computer "
            "run the same command again."
        )
    if measured["pace"] != 1.0:
        points.append(
            f"A second there took {measured['pace']:g} s of this machine, so that nodes, car and load had time to run "
            "side by side at all. Every figure is by that clock, as of a processor so many times faster."
        )
    if measured["comms_losses_between"]:
        points.append(
            f"Between the measurements, while programs were started or the load came and went, the VCU raised "
            f"AI_COMMS_LOST {_times(measured['comms_losses_between'])}."
        )
    return "\n".join(f"- {point}" for point in points)


def _machine(measured: Mapping[str, Any]) -> str:
    """Describe the machine and the place of the bus as a table."""
    host, inside = measured["host"], measured["machine"]
    slower = "" if measured["pace"] == 1.0 else f", its clock {measured['pace']:g} times slower"
    place = (
        "this machine's own vcan"
        if measured["place"] == "native"
        else f"vcan of User-Mode Linux ({inside['kernel']}, one processor{slower})"
    )
    rows = [
        ("date", measured["date"]),
        ("bus", place),
        ("kernel", host["kernel"]),
        ("system", host["system"]),
        ("processor", f"{host['processor']}, {host['processors']} of them, {host['memory_gib']:g} GiB of memory"),
        ("Python", host["python"]),
        ("interface revision", measured["revision"]),
        ("source", measured["source"] or "not a git checkout"),
        ("versions", ", ".join(f"{name} {version}" for name, version in measured["versions"].items())),
        *((f"scheduling of the {name}", scheduling_in_words(how)) for name, how in measured["scheduling"].items()),
    ]
    return "| what | value |\n|---|---|\n" + "\n".join(f"| {what} | {value} |" for what, value in rows)


def _ms(time_ms: float | None) -> str:
    return "-" if time_ms is None else f"{time_ms:.2f}"


def _share(times: Mapping[str, Any]) -> str:
    return f"{100.0 * times['above_ms']['10'] / times['count']:.2f} %" if times["count"] else "-"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
