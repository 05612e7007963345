"""What can happen to the AI side, as a vocabulary: a case of the fuzzer is a station and a list of these events.

A case is text, one event a line, so that one that breaks a rule can be read, cut down by hand and played again:

    setup 2026
    station moving
    run cycles=12
    command throttle=1.0 steering_rad=NaN
    mute ids=[1317] cycles=5
    service name="mode" text="manual"

Values are JSON (NaN and Infinity included); what follows a # is for people.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

from fsai_vcu.core.bridge import BridgeConfig, official_simulator
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits

EVENTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "run": "`cycles` times 10 ms of ordinary traffic: the car speaks, the controller commands, the loop answers",
        "aim": "ordinary traffic until `ms` and `ns` after AS_DRIVING began; the last words fall on that instant",
        "quiet": "`ms` without a word of the car's or the controller's",
        "hang": "the loop does not turn for `ms`",
        "late": "the loop turns `ns` late from now on",
        "pace": "the car speaks every `ns` from now on, its status `first` or last, `answered` before the rest",
        "car": "what the car says from now on: as_state, go, fault, ami, shutdown, switches, bits, cause",
        "wheels": "rpm of the four wheels from now on; null: as torque and brake make them turn",
        "speeds": "what 0x525 says from now on, whatever the wheels do, 0 to 65535; null: what they do",
        "counts": "0x526 from now on: `how` pulses as the wheels turn, none, or more by `pulses` in each cycle",
        "steering": "the measured angle from now on; null: it follows the request",
        "limits": "ANGLE_MAX and TRQ_MAX of the axles from now on",
        "echo": "what 0x524 says of the brake requests from now on; null: what was last sent",
        "handshake": "the car's bit: alternate, stuck or wild",
        "mute": "messages `ids` do not come for `cycles`",
        "frame": "one frame: `id`, `data` in hex, of `kind` standard, extended, remote or error",
        "flip": "one bit of the car's next message `id` is flipped",
        "says": "one message of the car's with a field changed: `image`, `field`, `value`",
        "command": "what the controller says from now on, field by field; `age_ms` is that of its sensor data",
        "silence": "the controller says nothing from now on, or speaks again",
        "once": "one command as told, on top of the controller's own",
        "confirm": "`role` confirms its reset for the run in hand plus `offset`",
        "confirming": "planner and controller confirm by themselves, or do not",
        "service": "somebody calls mode, emergency or reset with `text`",
        "drops": "of the next `cycles`, only `takes` frames are taken",
        "breaks": "the bus breaks in the next cycle after `takes` frames and is back after `ms`",
        "lost": "the bus is lost and back after `ms`",
        "restart": "the process is killed and starts anew",
        "end": "the software is told to stop in order",
    }
)


@dataclass(frozen=True, slots=True)
class FuzzEvent:
    """One thing that happens. `values` are JSON values."""

    name: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return " ".join((self.name, *(f"{key}={json.dumps(value)}" for key, value in self.values.items())))


def event(event_name: str, /, **values: Any) -> FuzzEvent:
    """An event of the vocabulary. Raises KeyError for a name that is not in it."""
    EVENTS[event_name]
    return FuzzEvent(event_name, values)


@dataclass(frozen=True, slots=True)
class Setup:
    """One car, venue and configuration under test."""

    name: str
    revision: str = "2026"
    car: str = "2026"
    config: BridgeConfig = field(default_factory=BridgeConfig)
    limits: OperationalLimits = UNLIMITED


SETUPS: Final[Mapping[str, Setup]] = MappingProxyType(
    {
        one.name: one
        for one in (
            Setup("2026"),
            Setup("2021", "2021", "2021"),
            Setup("venue", limits=OperationalLimits(5.0, 60.0, 15.0)),
            Setup("staging", config=BridgeConfig(autonomous_at_power_up=True)),
            Setup("official simulator", car="official-simulator", config=official_simulator()),
            Setup("listening", config=BridgeConfig(listen_only=True)),
        )
    }
)

# How a case begins: the station before, and what an ordinary car, operator and controller do from there on.
STATIONS: Final[Mapping[str, tuple[str | None, tuple[FuzzEvent, ...]]]] = MappingProxyType(
    {
        "start": (None, ()),
        "awake": ("start", (event("run", cycles=25),)),
        "off": ("awake", (event("service", name="mode", text="autonomous"), event("run", cycles=55))),
        "ready": ("off", (event("car", as_state=2), event("run", cycles=495))),
        "launched": ("ready", (event("car", as_state=3, go=True), event("run", cycles=2))),
        "driving": ("launched", (event("command", throttle=0.4, speed_limit_mps=8.0), event("run", cycles=303))),
        "moving": ("driving", (event("command", steering_rad=0.05), event("run", cycles=150))),
        "emergency": (
            "moving",
            (
                event("service", name="emergency", text="on the way"),
                event("run", cycles=3),
                event("car", as_state=4),
                event("run", cycles=5),
            ),
        ),
        "finished": (
            "moving",
            (
                event("command", throttle=0.0, mission_finished=True),
                event("run", cycles=250),
                event("car", as_state=5),
                event("run", cycles=5),
            ),
        ),
    }
)


@dataclass(frozen=True, slots=True)
class FuzzCase:
    """A setup, where it begins, and what happens then. `origin` is the lineage of seeds that makes it anew."""

    setup: str
    station: str
    events: tuple[FuzzEvent, ...]
    origin: str = ""

    def text(self, notes: Sequence[str] = ()) -> str:
        """The case as a file; `notes` go before it for people."""
        lines = [f"# {note}" if note else "#" for note in notes]
        lines += [f"setup {self.setup}", f"station {self.station}", *map(str, self.events)]
        return "\n".join(lines) + "\n"


class CaseError(ValueError):
    """A file that is no case. The message is one line."""


_PAIR: Final = re.compile(r"(\w+)=")


def read_case(text: str) -> FuzzCase:
    """The case of a file's text. Raises CaseError with the line's number."""
    setup, station, events = "2026", "start", []
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        name, _, rest = line.partition(" ")
        try:
            if name == "setup":
                setup = SETUPS[rest.strip()].name
            elif name == "station":
                STATIONS[rest.strip()]
                station = rest.strip()
            else:
                events.append(event(name, **_values(rest)))
        except KeyError as error:
            raise CaseError(f"line {number}: {error.args[0]!r} is not known: {line[:80]}") from None
        except ValueError:
            raise CaseError(f"line {number}: cannot be read: {line[:80]}") from None
    return FuzzCase(setup, station, tuple(events))


def _values(text: str) -> dict[str, Any]:
    decoder = json.JSONDecoder()
    values: dict[str, Any] = {}
    position = 0
    while position < len(text):
        if text[position].isspace():
            position += 1
            continue
        match = _PAIR.match(text, position)
        if match is None:
            raise ValueError(text)
        values[match.group(1)], position = decoder.raw_decode(text, match.end())
    return values
