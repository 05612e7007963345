"""What the page shows, as JSON types, from a picture of the monitor. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from fsai_vcu.diagnostics.explain.causes import CAUSES, FAULT_BITS
from fsai_vcu.diagnostics.explain.incident import TimelineEntry, Weight
from fsai_vcu.diagnostics.monitor.snapshot import LIGHTS, Freshness, MessagePicture, Picture, age

EVENTS: Final = 30
_UNEXPLAINED: Final = ("", "")


def state_of(picture: Picture) -> dict[str, Any]:
    """The picture without the messages that come as they should; with the lights, and the causes of fault bits."""
    colour, flashes = LIGHTS.get(picture.as_state or "", ("off", False))
    ages = [one.age_s for one in picture.messages if one.age_s is not None]
    return {
        **picture.as_dict(),
        "light": {"colour": colour if picture.as_state else "unknown", "flashes": flashes},
        "silent_s": min(ages, default=None),  # since the newest frame of anybody
        "why_not_driving": [{"text": one.sentence, "remedy": one.remedy} for one in picture.why_not_driving],
        "faults": [_fault(name) for name in picture.all_faults],
        "messages": [_missing(one) for one in picture.messages if one.freshness is not Freshness.FRESH],
        "received": sum(one.freshness is Freshness.FRESH for one in picture.messages),
    }


def _fault(name: str) -> dict[str, str]:
    slug = FAULT_BITS.get(name.removeprefix("SHUTDOWN_CAUSE "))
    words, remedy = (CAUSES[slug].words, CAUSES[slug].remedy) if slug else _UNEXPLAINED
    return {"name": name, "text": words, "remedy": remedy}


def _missing(message: MessagePicture) -> dict[str, str]:
    since = "" if message.age_s is None else f", {age(message.age_s)}"
    return {"name": f"0x{message.number} {message.name or ''}".rstrip(), "text": f"{message.freshness.value}{since}"}


def events_of(events: Iterable[TimelineEntry], until_ns: int, clock: Callable[[int], str]) -> list[dict[str, str]]:
    """The newest first: changes of states, warnings and faults."""
    seen = [one for one in events if one.t_ns <= until_ns and one.weight > Weight.NOTE][-EVENTS:]
    return [{"at": clock(one.t_ns), "text": one.text, "kind": one.weight.name.lower()} for one in reversed(seen)]
