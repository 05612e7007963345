"""What was measured, for people: one table, the verdict in plain words, and what the figures mean and do not mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fsai_hil.profiles import MS, SPECIFICATION
from fsai_hil.scrutineering.load import FILL_ID
from fsai_hil.scrutineering.machine import scheduling_in_words

ECHO_LIMIT_MS = SPECIFICATION.echo_timeout_ns // MS
MESSAGE_LIMIT_MS = SPECIFICATION.message_timeout_ns // MS
_BAR = 40
_FEW = 1000  # under so many echoes a p99.9 is the maximum by another name


def failures(measured: Mapping[str, Any]) -> list[str]:
    """Why it is not shown that the AI computer is always in time for the VCU, in words; nothing when it is."""
    found = []
    for row in measured["conditions"]:
        name, response = row["name"], row["response"]
        if not response["count"]:
            found.append(f"{name}: the VCU saw no echo at all")
            continue
        if row["comms_losses"]:
            found.append(f"{name}: the VCU raised AI_COMMS_LOST {_times(row['comms_losses'])}")
        elif response["max_ms"] >= ECHO_LIMIT_MS:
            found.append(f"{name}: an echo took {response['max_ms']:.1f} ms, and the VCU allows {ECHO_LIMIT_MS} ms")
        elif row["ended_early"]:
            found.append(f"{name}: {row['ended_early']} before the time was up")
        if found and found[-1].startswith(f"{name}:") and row["machine_stalls_ms"]:
            found[-1] += (
                " (a witness beside it saw the machine itself stand still, for up to "
                f"{max(row['machine_stalls_ms']):.0f} ms: measure again before blaming the bridge)"
            )
    return found + [f"{name}: not measured: {why}" for name, why in measured["not_measured"].items()]


def verdict(measured: Mapping[str, Any]) -> str:
    """One paragraph."""
    reasons = failures(measured)
    if reasons:
        return f"FAIL. {'; '.join(reasons)}."
    rows = measured["conditions"]
    worst = max(rows, key=lambda row: row["response"]["max_ms"])
    count = sum(row["response"]["count"] for row in rows)
    return (
        f"PASS. The VCU was answered in time in every condition: of {count} echoes the slowest took "
        f"{worst['response']['max_ms']:.2f} ms ({worst['name']}), where the VCU allows {ECHO_LIMIT_MS} ms; "
        "it never raised AI_COMMS_LOST."
    )


def markdown(measured: Mapping[str, Any]) -> str:
    """The whole report. `measured` is the rehearsal's result with `date`, `place`, `pace`, `host`, `versions`
    and `source`."""
    rows = measured["conditions"]
    parts = (
        "# Handshake response time",
        "The VCU alternates the HANDSHAKE bit of 0x520, and waits for each new value to come back in 0x510 before it\n"
        "toggles again. The time from toggle to echo is the AI computer's response time. Made by\n"
        "`fsai-vcu scrutineering`, from the real processes on a SocketCAN bus.",
        f"**{verdict(measured)}**",
        "## As the VCU sees it",
        _table(rows),
        _legend(rows),
        "## Between the two frames on the bus",
        _bus_table(rows),
        "The same echoes by the kernel's time stamps of the two frames, without the simulated VCU's own delays. *Bus*\n"
        "is what was on it in all, stuff bits not counted, and its share of 500 kbit/s. *VCU late*: how late the\n"
        "simulated VCU itself sent its 0x520. *Stalls*: a process that only sleeps, with a higher priority\n"
        "than all others, was woken more than 20 ms late.",
        "## Distribution",
        *(_histogram(row) for row in rows),
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
    """For a terminal."""
    lines = [
        f"{'condition':<18}{'echoes':>8}{'p50':>8}{'p99':>8}{'p99.9':>8}{'max':>8} ms{'> 10 ms':>9}{'time-outs':>11}"
    ]
    for row in measured["conditions"]:
        times = row["response"]
        figures = "".join(f"{_ms(times[key]):>8}" for key in ("p50_ms", "p99_ms", "p999_ms", "max_ms"))
        lines.append(f"{row['name']:<18}{times['count']:>8}{figures}   {_share(times):>9}{row['comms_losses']:>11}")
    return "\n".join((*lines, "", verdict(measured)))


# ---------------------------------------------------------------- parts


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        "| condition | seconds | echoes | p50 ms | p99 ms | p99.9 ms | max ms | over 10 ms | VCU time-outs |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        times = row["response"]
        figures = " | ".join(_ms(times[name]) for name in ("p50_ms", "p99_ms", "p999_ms", "max_ms"))
        lines.append(
            f"| {row['name']} | {row['seconds']:.0f} | {times['count']} | {figures} | {_share(times)} "
            f"| {row['comms_losses']} |"
        )
    return "\n".join(lines)


def _legend(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        f"- **{row['name']}**: {row['words']}" + (f" ({row['ended_early']})" if row["ended_early"] else "")
        for row in rows
    ]
    notes = [
        "An echo over 10 ms comes after the VCU's next 0x520, which then repeats its bit: a missed cycle, of which the "
        "VCU allows nine in a row. A time-out is AI_COMMS_LOST raised."
    ]
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


def _bus_table(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        "| condition | echoes | p50 ms | p99 ms | p99.9 ms | max ms | frames/s | bus | VCU late p99/max ms | stalls |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        figures = " | ".join(_ms(row["wire"][name]) for name in ("p50_ms", "p99_ms", "p999_ms", "max_ms"))
        late, stalls = row["status_late"], row["machine_stalls_ms"]
        stalled = f"{len(stalls)}, up to {max(stalls):.0f} ms" if stalls else "none"
        lines.append(
            f"| {row['name']} | {row['wire']['count']} | {figures} | {row['frames_per_s']} "
            f"| {row['bus_load_pct']:.0f} % | {_ms(late['p99_ms'])} / {_ms(late['max_ms'])} | {stalled} |"
        )
    return "\n".join(lines)


def _histogram(row: Mapping[str, Any]) -> str:
    bins = [(edge, count) for edge, count in row["response"]["histogram_ms"]]
    filled = [index for index, (_, count) in enumerate(bins) if count]
    if not filled:
        return f"{row['name']}: no echo"
    total = sum(count for _, count in bins)
    lines = [f"{row['name']}, as the VCU sees it"]
    for index in range(filled[0], filled[-1] + 1):
        edge, count = bins[index]
        words = f"over {bins[index - 1][0]:g} ms" if edge is None else f"to {edge:g} ms"
        bar = "#" * max(round(_BAR * count / total), 1 if count else 0)
        lines.append(f"{words:>12} {count:>8} {100 * count / total:>7.2f} % {bar}".rstrip())
    return "```\n" + "\n".join(lines) + "\n```"


def _method(measured: Mapping[str, Any]) -> str:
    decimation = measured["decimation"]
    held_up_ms = sum(row["held_up_ms"] for row in measured["conditions"])
    points = [
        "The clock starts at the instant at which the 0x520 with the new bit was due, and stops when the simulated VCU "
        "has received the first 0x510 with that bit. So each figure holds the VCU's own lateness in sending, both "
        "ways through the kernel, the bridge, and the VCU's delay in receiving: it is never better than the bridge.",
        "Every echo counts; nothing is left out, averaged or sampled. Percentiles are nearest ranks of exact times.",
        "Bridge, nodes, simulated car and load are processes of their own. The load runs at normal priority, as other "
        "programs on the AI computer do.",
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


def _slower(measured: Mapping[str, Any]) -> str:
    return "" if measured["pace"] == 1.0 else f", its clock {measured['pace']:g} times slower"


def _machine(measured: Mapping[str, Any]) -> str:
    host, inside = measured["host"], measured["machine"]
    place = (
        "this machine's own vcan"
        if measured["place"] == "native"
        else f"vcan of User-Mode Linux ({inside['kernel']}, one processor{_slower(measured)})"
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
