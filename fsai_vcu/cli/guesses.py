"""The verbs that a person means by a word that is no verb: another tool's name, a plain word, a mistyped name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Final

_LIKE: Final = 0.7
_MOST: Final = 3
_SHORTEST: Final = 3  # letters of a word that is looked for in what the verbs do

MEANT: Final[Mapping[str, str]] = {
    "emergency-brake": "stop estop e-stop brake halt abort kill ebs emergency panic shutdown cancel",
    "drive": "sim simulation simulator demo run start mission missions acceleration skidpad autocross trackdrive "
    "fault faults inject film gif",
    "track": "map circuit course cones",
    "vcu": "sim simulation simulator car",
    "rehearse": "test tests validate verify node inspection",
    "check-stack": "ros ros2 stack topics nodes",
    "status": "state why info",
    "dump": "candump bus can frames sniff listen cat tail",
    "decode": "signals cantools",
    "monitor": "state view show look see live top tui gui screen dashboard",
    "pitwall": "view show look see live web browser http server dashboard play player rviz",
    "foxglove": "rviz plotjuggler",
    "check": "test tests validate verify statistics figures load jitter errors",
    "explain": "why cause log logs analyse analyze analysis debug crash incident",
    "report": "html page pdf summary",
    "plot": "graph graphs chart curve curves png picture matplotlib",
    "compare": "diff",
    "record": "log logs logging logger save capture tcpdump rosbag bag",
    "export": "convert excel matlab pandas table",
    "replay": "play player playback canplayer repeat",
    "mode": "start stop go enable disable arm engage",
    "reset": "clear restart release unlatch",
    "config": "settings limits parameters toml",
    "doctor": "diagnose diagnosis health setup install adapter interface computer",
    "dbc": "diff signals signal messages message ids database",
    "send": "cansend cangen transmit tx",
    "enclaves": "security",
}
"""Verb -> words by which it is looked for, beside its name, its group and what it does; what brakes is named first."""


def meant(word: str, verbs: Mapping[str, tuple[str, str, str]]) -> list[str]:
    """The verbs that `word` may mean, the nearest first.

    verbs: verb -> (module, what it does, its group).
    """
    sought = word[:60].casefold().lstrip("-")
    if grouped := [verb for verb, (_, _, group) in verbs.items() if group == sought]:
        return grouped
    guesses = {verb: words.split() for verb, words in MEANT.items() if verb in verbs}
    if exact := [verb for verb, words in guesses.items() if sought in words]:
        return exact
    told = [verb for verb, (_, does, _) in verbs.items() if sought in re.findall(r"\w+", does.casefold())]
    if len(sought) >= _SHORTEST and 0 < len(told) <= _MOST:
        return told
    near = get_close_matches(sought, {*verbs, *(each for words in guesses.values() for each in words)}, _MOST, _LIKE)
    in_order = {**guesses, **verbs}
    found = (verb for each in near for verb in in_order if each in (verb, *guesses.get(verb, ())))
    return list(dict.fromkeys(found))[:_MOST]
