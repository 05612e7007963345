"""What the page shows, as JSON types, from a picture of the monitor. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final

from fsai_vcu.diagnostics.explain.causes import CAUSES, FAULT_BITS, SHUTDOWN
from fsai_vcu.diagnostics.explain.incident import TimelineEntry, Weight
from fsai_vcu.diagnostics.monitor.snapshot import LIGHTS, Freshness, MessagePicture, Picture, age

EVENTS: Final = 30
_EACH: Final = 3  # so many lost messages have a line each: a silent bus has thirty
_CAUSES: Final = {**{f"SHUTDOWN_CAUSE {one.label}": slug for one, slug in SHUTDOWN.items()}, **FAULT_BITS}


def state_of(picture: Picture) -> dict[str, Any]:
    """The picture without the messages that come as they should; with the lights, and the causes of fault bits."""
    colour, flashes = LIGHTS.get(picture.as_state or "", ("off", False))
    ages = [one.age_s for one in picture.messages if one.age_s is not None]
    return {
        **picture.as_dict(),
        "light": {"colour": colour if picture.as_state else "unknown", "flashes": flashes},
        "silent_s": min(ages, default=None),  # since the newest frame of anybody
        "why_not_driving": [{"text": one.sentence, "remedy": one.remedy} for one in picture.why_not_driving],
        "faults": _faults(picture.all_faults),
        "messages": [],
        "missing": list(_missing(picture.messages)),
        "received": sum(one.freshness is Freshness.FRESH for one in picture.messages),
    }


def _faults(names: Iterable[str]) -> list[dict[str, Any]]:
    """Those of one cause together."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(_CAUSES.get(name, name), []).append(name)
    causes = ((named, CAUSES.get(slug)) for slug, named in found.items())
    return [{"names": n, "text": c.words if c else "", "remedy": c.remedy if c else ""} for n, c in causes]


def _missing(messages: Sequence[MessagePicture]) -> Iterator[str]:
    """What does not come as it should, in lines."""
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
