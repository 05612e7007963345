"""One thing that a person should know: what every check of a log, a machine and a stack returns."""

from __future__ import annotations

from typing import Literal

from fsai_vcu.interface.values import Value


class Finding(Value, frozen=True):
    """A problem makes the verdict bad; "right" is what was looked at and is in order.

    `kind`: what it is about, in a word. `t_ns`: its moment; None: it is about the whole. `silent_ns`: from when to
    when something was missing, of a pause and of answers that never came. `remedy`: what to do.
    """

    severity: Literal["problem", "note", "right"]
    kind: str
    words: str
    remedy: str = ""
    t_ns: int | None = None
    can_ids: tuple[int, ...] = ()
    channel: str = ""
    silent_ns: tuple[tuple[int, int], ...] = ()
