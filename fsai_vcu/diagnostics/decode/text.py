"""The words and numbers of decoded signals: for people as `cantools decode --single-line` writes them, and as JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from decimal import Decimal
from typing import Any, Final

import numpy as np

from fsai_vcu.diagnostics.decode.decoder import values_of
from fsai_vcu.diagnostics.decode.layouts import MessageLayout, SignalLayout
from fsai_vcu.diagnostics.log.characters import Texts, number_texts, texts_of
from fsai_vcu.diagnostics.log.frames import Ints, Words

_SMALL: Final = 256  # so many values are all learned at once
_TABLE_BITS: Final = 16  # a signal of up to so many bits has a table of its values' texts


class MessageText:
    """The text of one plain message: `before[i]` and what `signals[i]` makes of each of them, then `end`.

    short: signals that are not 0 alone, and no name that the word behind it repeats.
    """

    def __init__(self, layout: MessageLayout, signals: Sequence[SignalText], *, as_json: bool, short: bool) -> None:
        self.signals = signals
        self.before: list[str] = []
        if short:
            name = re.sub("^[A-Z]+2[A-Z]+_", "", layout.name)  # sender and receiver are seen from the identifier
            said = f" {name}" if name != "Status" else ""  # as 0x510 and 0x520 are called, which are known by sight
            self.before = [said, *[""] * (len(layout.signals) - 1)][: len(layout.signals)]
            self.end = "\n" if layout.signals else f"{said}\n"
            return
        between = f',"message":{json.dumps(layout.name)},"signals":{{' if as_json else f" :: {layout.name}("
        for signal, text in zip(layout.signals, self.signals, strict=True):
            self.before.append(between + (f"{json.dumps(signal.name)}:" if as_json else f"{signal.name}: "))
            between = text.behind + ("," if as_json else ", ")
        self.end = (self.signals[-1].behind if self.signals else between) + ("}}\n" if as_json else ")\n")


class SignalText:
    """Texts of the values of signals of plain messages; the arithmetic is Python's, as cantools' is.

    Each is made once, when it first comes up, where a table can have all. behind: what stands behind all its values.
    rounded: to the decimals of scale and offset, without what binary arithmetic adds.
    """

    def __init__(self, layout: SignalLayout, *, as_json: bool, words: bool, rounded: bool = False) -> None:
        """Prepare the texts of one signal; a table holds all of them where the signal has few bits."""
        self._layout = layout
        values = 1 << layout.length if layout.length <= _TABLE_BITS else 0
        self._table = Texts(np.zeros(values, "V1"), np.zeros(values, np.int64))  # by the bits of a value
        self._known = np.zeros(values, np.bool_)
        self._complete = False
        self._json = as_json
        self._words: dict[float, str] = {
            raw: json.dumps(word) if as_json else _one_line(word) for raw, word in layout.choices.items() if words
        }
        unit = f" {_one_line(layout.unit)}" if layout.unit and not as_json else ""
        # A word has no unit: where there can be words, the unit belongs to the single text.
        self.behind, self._unit = ("", unit) if self._words else (unit, "")
        self._numbers = not self._words  # it is numbers alone that are written
        self._decimals = 0
        if rounded and not layout.is_float:
            places = (-int(Decimal(str(each)).as_tuple().exponent) for each in (layout.scale, layout.offset))
            self._decimals = max(0, *places)

    def texts(self, raws: Sequence[float], values: Sequence[float]) -> Sequence[str]:
        """The values of these raw numbers, as they are printed."""
        if self._words:
            pairs = zip(raws, values, strict=True)
            return [self._words.get(raw, f"{value}{self._unit}") for raw, value in pairs]
        return list(map(json_value if self._json else repr, values))

    def of(self, words: Words) -> Texts:
        """A text for the lowest bits of each word."""
        bits = (words & np.uint64((1 << self._layout.length) - 1)).view(np.int64)
        if not len(self._known):
            return self._written(bits)
        if not self._complete and not (known := np.take(self._known, bits)).all():
            # Once many have come up, the rest is learned with them.
            many = 4 * np.count_nonzero(self._known) > len(self._known) or len(self._known) <= _SMALL
            self._learn(np.flatnonzero(~self._known) if many else np.unique(bits[~known]))
        return self._table.at(bits)

    def _learn(self, fresh: Ints) -> None:
        self._table = self._table.put(fresh, self._written(fresh))
        self._known[fresh] = True
        self._complete = bool(self._known.all())

    def _written(self, bits: Ints) -> Texts:
        values, raw = values_of(self._layout, bits.view(np.uint64))
        if self._decimals:
            values = np.array([round(value, self._decimals) for value in values.tolist()])
        if self._numbers:
            return number_texts(values, lambda others: self.texts(others, others))
        return texts_of(self.texts(raw.tolist(), values.tolist()))


# In short lines 0x520 with a fault is to fit beside its frame: what a signal says, and in short. X_FAULT is X!.
_SHORT: Final = {
    "HANDSHAKE": "HS",
    "AS_SWITCH": "ASMS",
    "TS_SWITCH": "TSMS",
    "STEERING ACTIVE": "STEERING",
    "EMERGENCY_BRAKE": "EBRAKE",
    "SM_AS AS_EMERGENCY_BRAKE": "SM_AS AS_EBRAKE",
    "State_ASSI EMERGENCY_BRAKE": "State_ASSI EBRAKE",
    "ACCELERATION": "ACCEL",
    "AUTOCROSS": "AUTOX",
    "TRACK DRIVE": "TRACK",
    "STATIC INSPECTION A": "INSP_A",
    "STATIC INSPECTION B": "INSP_B",
    "AUTONOMOUS DEMO": "DEMO",
    "TS_SHUTDOWN": "TS_SHUT",
    "EBS_TRIGGERED": "EBS_TRIG",
    "WARNING": "WARN",
    "WARN_BATT_TEMP_HIGH": "BATT_HOT",
    "WARN_BATT_SOC_LOW": "SOC_LOW",
    "WARN_BRAKE_PLAUSIBILITY": "WARN_BRAKE_PLAUS",
    "R1_AI2VCU_STATUS_HANDSHAKE_TIMEOUT_ERROR": "R1_AI2VCU_STATUS_HS_TIMEOUT_ERROR",
    "SHUTDOWN_REQUEST": "SHUTDOWN",
    "AI_ESTOP_REQUEST": "AI_ESTOP",
    "OFFBOARD_CHARGER": "CHARGER",
    "AUTONOMOUS_BRAKING": "BRAKING",
    "MISSION_STATUS": "MISSION",
    "CHARGE_PROCEDURE": "CHARGING",
    "BRAKE_PLAUSIBILITY": "BRAKE_PLAUS",
}


def _shortened(text: str) -> str:
    """Return the text in short."""
    name = text.removesuffix("_FAULT")
    return _SHORT.get(name, name) + ("!" if name != text else "")


class ShortText(SignalText):
    """The signal with its name; nothing where it is 0."""

    def __init__(self, layout: SignalLayout, *, words: bool, rounded: bool) -> None:
        super().__init__(layout, as_json=False, words=words, rounded=rounded)
        self._name = layout.name
        for ending in ("_STATUS", "_STATE", "_SIGNAL"):
            self._name = self._name.removesuffix(ending)
        self._unit, self.behind = self._unit or self.behind, ""
        self._numbers = False
        self._flag = layout.length == 1
        self._alone = layout.name.endswith("_STATE")

    def texts(self, raws: Sequence[float], values: Sequence[float]) -> Sequence[str]:
        texts = super().texts(raws, values)
        return [f" {self._text(raw, text)}" if raw else "" for raw, text in zip(raws, texts, strict=True)]

    def _text(self, raw: float, text: str) -> str:
        if self._flag:
            return _shortened(self._name)
        if self._layout.name == "SHUTDOWN_CAUSE":
            return f"CAUSE={_shortened(text.removesuffix('_FAULT').removesuffix('_REQUEST'))}"
        if raw in self._words:
            return _shortened(text if self._alone else f"{self._name} {text}")
        return f"{_SHORT.get(self._layout.name, self._layout.name)} {text}{'' if self._words else self._unit}"


def _one_line(text: str) -> str:
    """Return the text without what would end or break a line."""
    return text.replace("\0", "").replace("\n", " ")


def json_value(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "null"  # JSON has no word for it
    if isinstance(value, int | float):
        return repr(value)
    return json.dumps(str(value))


def with_unit(value: Any, unit: str) -> str:
    return f"{value} {unit}" if unit and isinstance(value, int | float) else str(value)
