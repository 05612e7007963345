"""The contents of the page's tiles, as JSON types, from pictures of the monitor. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from fsai_vcu.diagnostics.explain.causes import CAUSES, FAULT_BITS, SHUTDOWN
from fsai_vcu.diagnostics.explain.incident import TimelineEntry, Weight
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.monitor.snapshot import Freshness, MessagePicture, Picture, age
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.diagnostics.statistics.measure import as_json
from fsai_vcu.interface.lights import light_of
from fsai_vcu.interface.units import S

EVENTS: Final = 30
CHANGES, SECONDS = 120, 60  # so many moments of a log are pictures: one takes some 20 ms
_EACH: Final = 3  # so many lost messages have a line each: a silent bus has thirty
_CAUSES: Final = {**{f"SHUTDOWN_CAUSE {one.label}": slug for one, slug in SHUTDOWN.items()}, **FAULT_BITS}
_AS_THEY_ARE: Final = (
    *("as_state", "as_state_s", "as_state_heard", "channel", "mission", "mode", "mission_status", "direction"),
    *("estop_request", "lap", "laps", "cones", "go", "as_switch", "ts_switch", "driving", "speed_mps", "load"),
    *("bitrate", "states", "lap_times_s", "actuators", "warnings", "link"),
)


def state_of(picture: Picture) -> dict[str, Any]:
    """The picture in the page's words: with the lights, and with the causes of fault bits."""
    ages = [one.age_s for one in picture.messages if one.age_s is not None]
    shown = picture.handshake.response_ms if picture.handshake else None
    found = {
        **{name: getattr(picture, name) for name in _AS_THEY_ARE},
        "light": light_of(picture.as_state)._asdict(),
        "silent_s": min(ages, default=None),  # since the newest frame of anybody
        "response_ms": [shown.p50_ms, shown.max_ms] if shown else [None, None],
        "why_not_driving": [{"text": one.sentence, "remedy": one.remedy} for one in picture.why_not_driving],
        "faults": _faults(picture.all_faults),
        "missing": list(_missing(picture.messages)),
        "received": sum(one.freshness is Freshness.FRESH for one in picture.messages),
    }
    rounded: dict[str, Any] = as_json(found, 4)
    return rounded


def _faults(names: Iterable[str]) -> list[dict[str, Any]]:
    """The faults, those of one cause together."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(_CAUSES.get(name, name), []).append(name)
    causes = ((named, CAUSES.get(slug)) for slug, named in found.items())
    return [{"names": n, "text": c.words if c else "", "remedy": c.remedy if c else ""} for n, c in causes]


def _missing(messages: Sequence[MessagePicture]) -> Iterator[str]:
    """Lines on what does not come as it should."""
    lost = [(one, one.age_s) for one in messages if one.age_s is not None and one.freshness is Freshness.LOST]
    if len(lost) > _EACH:
        yield f"lost: {', '.join(f'0x{one.number}' for one, _ in lost)}"
    else:
        yield from (f"0x{one.number} {one.name or ''} lost: {age(age_s)} old" for one, age_s in lost)
    if late := [f"0x{one.number}" for one in messages if one.freshness is Freshness.LATE]:
        yield f"late: {', '.join(late)}"
    if never := [f"0x{one.number}" for one in messages if one.age_s is None]:
        yield f"never received: {', '.join(never)}"


def events_of(events: Iterable[TimelineEntry], until_ns: int, clock: Callable[[int], str]) -> list[dict[str, str]]:
    """The newest first: changes of states, warnings and faults."""
    seen = [one for one in events if one.t_ns <= until_ns and one.weight > Weight.NOTE][-EVENTS:]
    return [{"at": clock(one.t_ns), "text": one.text, "kind": one.weight.name.lower()} for one in reversed(seen)]


def states_of(
    frames: Frames, view: View, changes_ns: Iterable[int], zero_ns: int
) -> Iterator[tuple[float, dict[str, Any]]]:
    """(s since `zero_ns`, what differs from the state before) at the moments of a log that the page can show.

    frames: in the order of their times. changes_ns: when something changed: so many of them, and besides a moment each
    second, or as many at equal distances. `view` has seen nothing yet.
    """
    if not len(frames):
        return
    begin_ns, end_ns = int(frames.t_ns[0]), int(frames.t_ns[-1])
    changed = np.unique(np.fromiter((t_ns for t_ns in changes_ns if begin_ns <= t_ns <= end_ns), np.int64))
    changed = changed[np.linspace(0, len(changed) - 1, min(len(changed), CHANGES)).astype(np.int64)]
    count = min(SECONDS, (end_ns - begin_ns) // S + 2)
    # Spread from 0 on: a date in ns has more digits than a float.
    moments = np.union1d(changed, begin_ns + np.linspace(0, end_ns - begin_ns, count).astype(np.int64))
    before: dict[str, Any] = {}
    low = 0
    for t_ns, high in zip(moments.tolist(), np.searchsorted(frames.t_ns, moments, side="right").tolist(), strict=True):
        view.update(frames.only(np.arange(low, high, dtype=np.int64)))
        low = high
        state = state_of(view.picture(t_ns))
        del state["speed_mps"], state["load"]  # the page has them whole, as curves; and so what is asked and given
        for actuator in state["actuators"].values():
            del actuator["asked"], actuator["given"]
        yield (t_ns - zero_ns) / S, {name: value for name, value in state.items() if before.get(name, ...) != value}
        before = state
