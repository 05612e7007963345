"""`fsai-vcu check-stack`: watches a running stack and lists what it does wrong, each with what to do about it."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from fsai_vcu.cli.arguments import check_numbers
from fsai_vcu.cli.services import operator_node
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.reasons import words_of
from fsai_vcu.core.supervision.supervisor import ROLES, Asked

EXAMPLE = "fsai-vcu check-stack --seconds 20 && echo in order"
ABOUT = "It only listens. Exit status: 0 nothing is wrong, 1 something is. Best while the car drives."

_CONFIG = BridgeConfig()
AGE_MAX_S = _CONFIG.sensor_stale_ns / 1e9
AHEAD_MAX_S = _CONFIG.sensor_future_ns / 1e9
GAP_MAX_S = _CONFIG.command_stale_ns / 1e9
_STEER_MAX_RAD = math.radians(30.0)  # where the car has not said its own
_TURN_S = 0.1
_KEPT = {"run_state", "reset_confirmation"}  # said once, and kept for those who come later
_COMMANDED = [each.name for each in fields(VehicleCommand) if each.name != "t_sensor_ns"]

_ASKED = tuple(each.value for each in Asked)  # such a stop is in order

# Topic -> how often it must come at least, Hz, a tenth below what is asked for; 0: no matter
RATES = {
    "vehicle_cmd": 45.0,
    "vehicle_state": 18.0,
    "detected_cones": 4.5,
    "path": 4.5,
    "planner_status": 4.5,
    "run_state": 0.0,
    "reset_confirmation": 0.0,
}
SENDERS = {
    "vehicle_state": "vcu_bridge",
    "run_state": "vcu_bridge",
    "vehicle_cmd": "the controller",
}  # of what must come


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=float, default=60.0, metavar="S", help="watch for so long, from the first message on (60 s)"
    )
    parser.add_argument("--wait", type=float, default=10.0, metavar="S", help="for so long for a first message (10 s)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--namespace", default="/", metavar="NS", help="the nodes' ROS namespace, such as /car1")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong: where, what, and what to do."""

    topic: str
    wrong: str
    to_do: str


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
        """A message at `now_s`; the age of its stamp, None where the stamp is empty."""
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
    """What was heard of a stack, and what of it is wrong. Fed with messages; knows neither clock nor middleware."""

    heard: dict[str, Heard] = field(default_factory=lambda: {topic: Heard() for topic in RATES})
    run_id: int | None = None
    confirmed: set[tuple[str, int]] = field(default_factory=set)
    problems: Counter[str] = field(default_factory=Counter)  # of single commands, in words
    counted: dict[str, tuple[int, int]] = field(default_factory=dict)  # by reason: at first, and at last
    details: dict[str, str] = field(default_factory=dict)
    stopping: str = ""
    frames: set[str] = field(default_factory=set)
    steer_max_rad: float = _STEER_MAX_RAD

    def receive(self, topic: str, message: Any, now_s: float, ros_ns: int) -> None:
        """`now_s`: any steady clock; `ros_ns`: ROS time, by which messages are stamped."""
        age_s = None
        if topic not in _KEPT:
            stamp = message.header.stamp
            stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
            # With `late` a planner's status has no path, and no stamp.
            age_s = (ros_ns - stamp_ns) / 1e9 if stamp_ns or getattr(message, "late", "") else None
        if topic == "planner_status" and message.late:
            return
        self.heard[topic].receive(now_s, age_s)
        if hasattr(self, f"_on_{topic}"):
            getattr(self, f"_on_{topic}")(message)

    def _on_run_state(self, message: Any) -> None:
        self.run_id = message.run_id

    def _on_reset_confirmation(self, message: Any) -> None:
        self.confirmed.add((message.role, message.run_id))

    def _on_vehicle_state(self, message: Any) -> None:
        if message.steering_max_rad > 0.0:
            self.steer_max_rad = message.steering_max_rad
        why = message.emergency or message.stopping
        if why and not why.startswith(_ASKED):
            self.stopping = why

    def _on_path(self, message: Any) -> None:
        self.frames.add(message.header.frame_id)

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
        if key.startswith("count of "):
            slug, count = key.removeprefix("count of "), int(value)
            self.counted[slug] = self.counted.get(slug, (count, count))[0], count
        elif key.startswith("last detail of "):
            self.details[key.removeprefix("last detail of ")] = value

    # ------------------------------------------------------------ what is wrong

    def findings(self) -> Iterator[Finding]:
        for topic, who in SENDERS.items():
            if not self.heard[topic].count:
                to_do = f"it comes from {who}: is it running, on this ROS_DOMAIN_ID and in this namespace?"
                yield Finding(topic, "nothing was received", to_do)
        for topic, heard in self.heard.items():
            yield from self._of_topic(topic, heard)
        if self.run_id is not None:
            for role in ROLES:
                if (role, self.run_id) not in self.confirmed:
                    to_do = (
                        f"publish ResetConfirmation(role='{role}') with each new run_id of /run_state, transient local"
                    )
                    yield Finding("reset_confirmation", f"the {role} has not confirmed run {self.run_id}", to_do)
        for problem, count in self.problems.items():
            yield Finding("vehicle_cmd", *_of_commands(problem, count, self.steer_max_rad))
        if wrong_frames := self.frames - {"base_link"}:
            to_do = "points are in base_link, of the instant of the stamp: x forward, y left, from the rear axle"
            yield Finding("path", f"frame_id is '{sorted(wrong_frames)[0]}'", to_do)
        for slug, (before, after) in self.counted.items():
            if after > before:
                detail = f" ({self.details[slug]})" if slug in self.details else ""
                wrong = f"the bridge intervened {after - before} times: {words_of(slug)}{detail}"
                yield Finding("vehicle_cmd", wrong, "docs/supervision.md says what follows from it")
        if self.stopping:
            yield Finding("vehicle_state", f"the car was stopped: {self.stopping}", "the first lines here may say why")

    @staticmethod
    def _of_topic(topic: str, heard: Heard) -> Iterator[Finding]:
        least_hz = RATES[topic]
        if not least_hz:
            return
        if heard.count > 1 and heard.rate_hz < least_hz:
            wrong = f"{heard.rate_hz:.1f} Hz, at least {least_hz / 0.9:.0f} are needed"
            yield Finding(topic, wrong, "publish by a timer or with each input, and do nothing slow in a callback")
        elif topic == "vehicle_cmd" and heard.gap_s > GAP_MAX_S:
            wrong = f"it paused for {heard.gap_s * 1e3:.0f} ms; after {GAP_MAX_S * 1e3:.0f} ms torque is cut"
            yield Finding(topic, wrong, "publish by a timer of 20 ms, and do nothing slow in a callback")
        if heard.unstamped:
            to_do = "copy the stamp of the oldest data behind it (cones, path), not the time of publishing"
            yield Finding(topic, f"{heard.unstamped} of {heard.count} messages have no stamp", to_do)
        if heard.oldest_s > AGE_MAX_S:
            wrong = f"stamps are up to {heard.oldest_s:.2f} s old; after {AGE_MAX_S:g} s data are stale"
            yield Finding(topic, wrong, "pass the newest data on at once; on two computers: are their clocks alike?")
        if heard.youngest_s < -AHEAD_MAX_S:
            wrong = f"stamps are up to {-heard.youngest_s:.2f} s in the future: such messages are refused"
            yield Finding(topic, wrong, "stamp with this computer's clock, not with simulated time")


def _of_commands(problem: str, count: int, steer_max_rad: float) -> tuple[str, str]:
    """What is wrong with `count` commands, and what to do; `problem` is a field's name, or 'both'."""
    if problem == "both":
        return f"{count} commands ask for throttle and brake together: the brake wins", "set one of them to 0"
    if problem == "run_id":
        return f"{count} commands are of another run, and count as none", "copy run_id from the newest /run_state"
    limits = f"+-{steer_max_rad:.2f} rad" if problem == "steering_rad" else "0 or more"
    limits = "0 to 1" if problem in ("throttle", "brake") else limits
    return f"in {count} commands {problem} is out of range or no number", f"keep it within {limits}"


def mismatches(node: Any) -> Iterator[Finding]:
    """Publishers and subscriptions of our topics that do not receive each other, and topics with one side only."""
    from rclpy.qos import QoSCompatibility, qos_check_compatible

    for topic in RATES:
        name = node.resolve_topic_name(topic)
        publishers = node.get_publishers_info_by_topic(name)
        readers = [info for info in node.get_subscriptions_info_by_topic(name) if info.node_name != node.get_name()]
        if not publishers and readers and topic not in (*SENDERS, "reset_confirmation"):
            who = " and ".join(sorted({info.node_name for info in readers}))
            yield Finding(
                topic, f"nobody publishes it, and {who} waits for it", "is that node running? is it remapped?"
            )
        if topic == "vehicle_cmd" and len(publishers) > 1:
            who = " and ".join(sorted(info.node_name for info in publishers))
            yield Finding(topic, f"{len(publishers)} nodes command the car: {who}", "end all but one of them")
        for reader in readers:
            for publisher in publishers:
                verdict, why = qos_check_compatible(publisher.qos_profile, reader.qos_profile)
                if verdict == QoSCompatibility.ERROR:
                    why = why.strip().rstrip(";").removeprefix("ERROR: ").lower()
                    wrong = f"{reader.node_name} does not receive {publisher.node_name}: {why}"
                    yield Finding(topic, wrong, "use the profile of fsai_nodes.qos (nodes/README.md has the table)")


def watch(namespace: str, seconds: float, wait_s: float) -> tuple[StackWatch, list[Finding]]:
    """Listen for so long from the first message on; what was heard, and what is wrong."""
    stack = StackWatch()
    with operator_node(namespace) as node:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from fsai_msgs import msg
        from nav_msgs.msg import Path
        from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

        kinds = {
            "vehicle_cmd": msg.VehicleCommand,
            "vehicle_state": msg.VehicleState,
            "detected_cones": msg.ConeArray,
            "path": Path,
            "planner_status": msg.PlannerStatus,
            "run_state": msg.RunState,
            "reset_confirmation": msg.ResetConfirmation,
        }
        kept = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

        def listen(topic: str) -> None:
            def on_message(message: Any) -> None:
                stack.receive(topic, message, time.monotonic(), node.get_clock().now().nanoseconds)

            node.create_subscription(
                kinds[topic], topic, on_message, kept if topic in _KEPT else qos_profile_sensor_data
            )

        def on_diagnostics(message: Any) -> None:
            for status in message.status:
                for pair in status.values if status.name == "vcu_bridge: supervision" else ():
                    stack.diagnose(pair.key, pair.value)

        for topic in RATES:
            listen(topic)
        node.create_subscription(DiagnosticArray, "diagnostics", on_diagnostics, 10)
        began = False
        until = time.monotonic() + wait_s
        while (left_s := until - time.monotonic()) > 0.0:
            rclpy.spin_once(node, timeout_sec=min(_TURN_S, left_s))
            if not began and any(heard.count for heard in stack.heard.values()):
                began, until = True, time.monotonic() + seconds
        return stack, [*mismatches(node), *stack.findings()]


def run(args: argparse.Namespace) -> int:
    check_numbers(args, seconds=0.0, wait=0.0)
    stack, wrong = watch(args.namespace, args.seconds, args.wait)
    rates = {topic: round(heard.rate_hz, 1) for topic, heard in stack.heard.items() if heard.count}
    if args.json:
        print(json.dumps({"seconds": args.seconds, "rates_hz": rates, "wrong": [asdict(each) for each in wrong]}))
    elif wrong:
        print("\n".join(f"/{each.topic}: {each.wrong}\n    {each.to_do}" for each in wrong))
    else:
        heard = ", ".join(f"/{topic} {rate:g} Hz" for topic, rate in rates.items() if RATES[topic])
        print(f"nothing is wrong in {args.seconds:g} s: {heard}")
    return 1 if wrong else 0
