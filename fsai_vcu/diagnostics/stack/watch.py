"""Judgement of what a ROS stack around the bridge does wrong, from its messages. No ROS here: the listener hands them
in.

stack = StackWatch()
stack.receive("vehicle_cmd", message, now_s, ros_ns)      # each message, as it comes
stack.ends["vehicle_cmd"] = Ends(publishers, readers, deaf)
for finding in stack.findings(): ...
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import WITHOUT_PATH
from fsai_vcu.core.supervision.config import BridgeConfig, Reason, words_of
from fsai_vcu.core.supervision.supervisor import ROLES, Asked
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.printable import LINE, printable

_CONFIG = BridgeConfig()
AGE_MAX_S = _CONFIG.sensor_stale_ns / 1e9
AHEAD_MAX_S = _CONFIG.sensor_future_ns / 1e9
GAP_MAX_S = _CONFIG.command_stale_ns / 1e9
_STEER_MAX_RAD = math.radians(30.0)  # where the car has not said its own
_COMMANDED = [name for name in VehicleCommand.__struct_fields__ if name != "t_sensor_ns"]
_ASKED = tuple(each.value for each in Asked)  # such a stop is in order
_REASONS = frozenset(each.slug for each in Reason)
_NAME = 100  # characters of one
_DIGITS = 20  # of a count
_MOST = 100  # nodes and frames that are told of: any program on this machine can make up names
_CLOCK = "start it without use_sim_time, or let everything go by one /clock"


@dataclass(frozen=True, slots=True)
class Topic:
    """Expectation of a topic. `least_hz` is a tenth below what is asked for; 0: said once, kept for late listeners."""

    least_hz: float
    sender: str = ""  # of what must come


TOPICS = {
    "vehicle_cmd": Topic(45.0, "the controller"),
    "vehicle_state": Topic(18.0, "vcu_bridge"),
    "detected_cones": Topic(4.5),
    "path": Topic(4.5),
    "planner_status": Topic(4.5),
    "run_state": Topic(0.0, "vcu_bridge"),
    "reset_confirmation": Topic(0.0),
}


@dataclass(frozen=True, slots=True)
class Ends:
    """The nodes at a topic's ends, by name."""

    publishers: list[str] = field(default_factory=list)
    readers: list[str] = field(default_factory=list)
    deaf: list[tuple[str, str, str]] = field(default_factory=list)  # reader, publisher, and why it does not receive it


@dataclass(slots=True)
class Heard:
    """One topic: when its messages came, and what their stamps said. Times in s."""

    count: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    gap_s: float = 0.0
    unstamped: int = 0
    oldest_s: float = -math.inf
    youngest_s: float = math.inf

    def receive(self, now_s: float, age_s: float | None) -> None:
        """Take in a message that came at `now_s`, with the age (s) of its stamp; None where the stamp is empty."""
        if self.count:
            self.gap_s = max(self.gap_s, now_s - self.last_s)
        else:
            self.first_s = now_s
        self.count, self.last_s = self.count + 1, now_s
        if age_s is None:
            self.unstamped += 1
        else:
            self.oldest_s, self.youngest_s = max(self.oldest_s, age_s), min(self.youngest_s, age_s)

    @property
    def rate_hz(self) -> float:
        return (self.count - 1) / (self.last_s - self.first_s) if self.last_s > self.first_s else 0.0


@dataclass(slots=True)
class StackWatch:
    """Record of what was heard of a stack, and of what is wrong."""

    heard: dict[str, Heard] = field(default_factory=lambda: {topic: Heard() for topic in TOPICS})
    ends: dict[str, Ends] = field(default_factory=dict)
    run_id: int | None = None
    confirmed: set[tuple[str, int]] = field(default_factory=set)
    problems: Counter[str] = field(default_factory=Counter)  # of single commands, in words
    counted: dict[str, tuple[int, int]] = field(default_factory=dict)  # by reason: at first, and at last
    details: dict[str, str] = field(default_factory=dict)
    stopping: str = ""
    frames: set[str] = field(default_factory=set)
    steer_max_rad: float = _STEER_MAX_RAD
    drives: bool = False  # it was to drive by a path at least once
    points: int = 0  # of all paths
    no_path: str = ""  # in the planner's words
    by_clock: dict[str, bool] = field(default_factory=dict)  # by node: whether its time is what /clock says
    clock_published: bool = False
    told: dict[tuple[str, str], str] = field(default_factory=dict)  # what nodes complain of: by node, and of what

    def receive(self, topic: str, message: Any, now_s: float, ros_ns: int) -> None:
        """Take in a message. `now_s`: any steady clock; `ros_ns`: ROS time, by which messages are stamped."""
        age_s = None
        if TOPICS[topic].least_hz:
            stamp = message.header.stamp
            stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
            # With `late` a planner's status has no path, and no stamp.
            age_s = (ros_ns - stamp_ns) / 1e9 if stamp_ns or getattr(message, "late", "") else None
        if topic == "planner_status" and message.late:
            self.no_path = printable(message.late, LINE)
            return
        self.heard[topic].receive(now_s, age_s)
        if hasattr(self, f"_on_{topic}"):
            getattr(self, f"_on_{topic}")(message)

    def _on_run_state(self, message: Any) -> None:
        self.run_id = message.run_id
        self.drives |= message.may_move and message.mission not in WITHOUT_PATH

    def _on_reset_confirmation(self, message: Any) -> None:
        if message.role in ROLES:
            self.confirmed.add((message.role, message.run_id))

    def _on_vehicle_state(self, message: Any) -> None:
        if message.steering_max_rad > 0.0:
            self.steer_max_rad = message.steering_max_rad
        why = message.emergency or message.stopping
        if why and not why.startswith(_ASKED):
            self.stopping = printable(why, LINE)

    def _on_path(self, message: Any) -> None:
        if message.poses and len(self.frames) < _MOST:
            self.frames.add(printable(message.header.frame_id, _NAME))
        self.points += len(message.poses)

    def _on_planner_status(self, message: Any) -> None:
        if message.note:
            self.no_path = printable(message.note, LINE)

    def _on_vehicle_cmd(self, message: Any) -> None:
        command = VehicleCommand(0, **{name: getattr(message, name) for name in _COMMANDED})
        # The numbers differ from command to command; the first words of a problem say what it is.
        self.problems.update(text.split(" ")[0] for text in command.problems(self.steer_max_rad))
        if command.throttle > 0.0 and command.brake > 0.0:
            self.problems["both"] += 1
        if self.run_id is not None and command.run_id != self.run_id:
            self.problems["run_id"] += 1

    def diagnose(self, key: str, value: str) -> None:
        """A pair of /diagnostics' supervision: how often each reason has come up, and its last detail."""
        what, _, slug = key.partition(" of ")
        if slug not in _REASONS:
            return
        if what == "count" and value.isdecimal() and len(value) < _DIGITS:
            count = int(value)
            self.counted[slug] = self.counted.get(slug, (count, count))[0], count
        elif what == "last detail":
            self.details[slug] = printable(value, LINE)

    def complain(self, name: str, message: str) -> None:
        """An entry of /diagnostics by which a node complains: 'path_planner: /vehicle_state', 'path_planner: clock'."""
        node, _, what = printable(name, 2 * _NAME).partition(": ")
        if (node, what) in self.told or len(self.told) < _MOST:
            self.told[node, what] = printable(message, LINE)

    # ------------------------------------------------------------ what is wrong

    def findings(self) -> Iterator[Finding]:
        """Yield everything that is wrong with the stack, and what to do about it."""
        for topic, ends in self.ends.items():
            yield from _of_ends(topic, ends)
        for topic, expected in TOPICS.items():
            heard = self.heard[topic]
            if expected.sender and not heard.count:
                to_do = (
                    f"{expected.sender} sends it: is that node running, on this ROS_DOMAIN_ID and in this namespace?"
                )
                yield _wrong(topic, "nothing was received", to_do)
            if expected.least_hz:
                yield from _of_times(topic, heard, expected.least_hz)
        yield from self._of_plans()
        yield from self._of_clocks()
        for (node, what), message in self.told.items():
            if what != "clock":
                to_do = "fsai_nodes.declarations has what each field may be"
                yield _wrong(what.removeprefix("/"), f"{node} says: {message}", to_do)
        for role in ROLES if self.run_id is not None else ():
            if (role, self.run_id) not in self.confirmed:
                to_do = f"publish ResetConfirmation(role='{role}') with each new run_id of /run_state, transient local"
                yield _wrong("reset_confirmation", f"the {role} has not confirmed run {self.run_id}", to_do)
        for problem, count in self.problems.items():
            yield _wrong("vehicle_cmd", *_of_commands(problem, count, self.steer_max_rad))
        for frame in sorted(self.frames - {"base_link"}):
            to_do = "points are in base_link, of the instant of the stamp: x forward, y left, from the rear axle"
            yield _wrong("path", f"frame_id is '{frame}'", to_do)
        for slug, (before, after) in self.counted.items():
            if after > before:
                detail = f" ({self.details[slug]})" if slug in self.details else ""
                wrong = f"the bridge intervened {after - before} times: {words_of(slug)}{detail}"
                yield _wrong("vehicle_cmd", wrong, "docs/supervision.md says what follows from it")
        if self.stopping:
            yield Finding(
                "problem", "vehicle_state", f"the car was stopped: {self.stopping}", "the lines above may say why"
            )

    def _of_plans(self) -> Iterator[Finding]:
        """Yield what is published and does not come; and paths that lead nowhere."""
        why = f"; the planner says: {self.no_path}" if self.no_path else ""
        for topic in ("detected_cones", "path"):
            ends = self.ends.get(topic, Ends())
            if ends.publishers and ends.readers and not self.heard[topic].count:
                who, waits = (" and ".join(sorted(set(each))) for each in (ends.publishers, ends.readers))
                words = "no plan is sent" if topic == "path" else "nothing was received"
                wrong = f"{words}: {who} publishes it but sends nothing, and {waits} waits for it"
                yield Finding(
                    "problem",
                    topic,
                    wrong + (why if topic == "path" else ""),
                    "the log of that node says what it lacks",
                )
        if self.drives and self.heard["path"].count and not self.points:
            wrong = f"no plan is sent: none of {self.heard['path'].count} paths has a point{why}"
            yield _wrong("path", wrong, "look at the cones that come: fsai-vcu pitwall CHANNEL --ros")

    def _of_clocks(self) -> Iterator[Finding]:
        """Nodes whose own clock stands still, or is another than the others'."""
        simulated = sorted(node for node, by_clock in self.by_clock.items() if by_clock)
        others = sorted(node for node, by_clock in self.by_clock.items() if not by_clock)
        if simulated and not self.clock_published:
            wrong = (
                f"nobody publishes it, and use_sim_time is set in {' and '.join(simulated)}: that clock stands still"
            )
            yield _wrong("clock", wrong, _CLOCK)
        elif simulated and others:
            wrong = f"{' and '.join(simulated)} goes by /clock (use_sim_time), and {' and '.join(others)} does not"
            yield _wrong("clock", wrong, _CLOCK)
        for (node, what), message in self.told.items():
            if what == "clock" and node not in simulated:
                yield _wrong("clock", f"{node} says: {message}", _CLOCK)


def _wrong(topic: str, words: str, remedy: str) -> Finding:
    return Finding("problem", topic, words, remedy)


def _of_ends(topic: str, ends: Ends) -> Iterator[Finding]:
    """Publishers and readers that do not receive each other, and a topic with one side only."""
    if not ends.publishers and ends.readers and not TOPICS[topic].sender and topic != "reset_confirmation":
        wrong = f"nobody publishes it, and {' and '.join(sorted(set(ends.readers)))} waits for it"
        yield _wrong(topic, wrong, "is that node running? is it remapped?")
    if topic == "vehicle_cmd" and len(ends.publishers) > 1:
        wrong = f"{len(ends.publishers)} nodes command the car: {' and '.join(sorted(ends.publishers))}"
        yield _wrong(topic, wrong, "end all but one of them")
    for reader, publisher, why in ends.deaf:
        wrong = f"{reader} does not receive {publisher}: {why}"
        yield _wrong(topic, wrong, "use the profile of fsai_nodes.qos (nodes/README.md has the table)")


def _of_times(topic: str, heard: Heard, least_hz: float) -> Iterator[Finding]:
    """Yield what is wrong with a topic's rate, its pauses and its stamps."""
    if heard.count > 1 and heard.rate_hz < least_hz:
        wrong = f"{heard.rate_hz:.1f} Hz, at least {least_hz / 0.9:.0f} are needed"
        yield Finding(
            "problem", topic, wrong, "publish by a timer or with each input, and do nothing slow in a callback"
        )
    elif topic == "vehicle_cmd" and heard.gap_s > GAP_MAX_S:
        wrong = f"it paused for {heard.gap_s * 1e3:.0f} ms; after {GAP_MAX_S * 1e3:.0f} ms torque is cut"
        yield _wrong(topic, wrong, "publish by a timer of 20 ms, and do nothing slow in a callback")
    if heard.unstamped:
        to_do = "copy the stamp of the oldest data behind it (cones, path), not the time of publishing"
        yield _wrong(topic, f"{heard.unstamped} of {heard.count} messages have no stamp", to_do)
    if heard.oldest_s > AGE_MAX_S:
        wrong = f"stamps are up to {heard.oldest_s:.2f} s old; after {AGE_MAX_S:g} s data are stale"
        yield Finding(
            "problem", topic, wrong, "pass the newest data on at once; on two computers: are their clocks synchronised?"
        )
    if heard.youngest_s < -AHEAD_MAX_S:
        wrong = f"stamps are up to {-heard.youngest_s:.2f} s in the future: such messages are refused"
        yield _wrong(topic, wrong, "stamp with this computer's clock, not with simulated time")


def _of_commands(problem: str, count: int, steer_max_rad: float) -> tuple[str, str]:
    """Say what is wrong with `count` commands, and what to do; `problem` is a field's name, or 'both'."""
    if problem == "both":
        return f"{count} commands ask for throttle and brake together: the brake wins", "set one of them to 0"
    if problem == "run_id":
        return f"{count} commands belong to another run, and are ignored", "copy run_id from the newest /run_state"
    limits = f"+-{steer_max_rad:.2f} rad" if problem == "steering_rad" else "0 or more"
    limits = "0 to 1" if problem in ("throttle", "brake") else limits
    return f"in {count} commands {problem} is out of range or not a number", f"keep it within {limits}"
