"""The door through which everything comes from ROS: what does not fit its declaration is refused, in one sentence.

door = Door(node)
door.subscription(ConeArray, "raw_cones", self._on_cones)
door.service(SetMode, "set_mode", self._on_set_mode)

The sentence names the topic, the node that sent it, the field and its value. `fsai_nodes.declarations` has the
declarations; a type that is not there makes no subscription and no service.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.service import Service

from fsai_nodes.complaints import complaints_of
from fsai_nodes.declarations import BYTES, DECLARED, MOST_BYTES, declared, key_of
from fsai_nodes.fields import Parts, Several, listed, printable
from fsai_nodes.middleware import gid_of, on_mismatch, taker
from fsai_nodes.parameters import NodeError
from fsai_nodes.qos import TOPICS
from fsai_vcu.interface.units import S

RECORDED_BYTES = 16 * 1024 * 1024  # of a message that is only recorded
KEPT_RESULTS_S = 60  # for a client that asks for a goal's result late
MOST_GOALS = 16  # followed at once
MOST_KEPT = 200  # goals within KEPT_RESULTS_S: each is in every status that the action publishes
_LOOK_EVERY_NS = S // 5  # for a sender that is not known yet: to ask at each message is slow

NOT_KNOWN = "_NODE_NAME_UNKNOWN_"  # a publisher is discovered before its node's name is


class Senders:
    """Publishers of one topic: names by the GID that the middleware gives each publisher."""

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self._topic = topic  # whole
        self._names: dict[bytes, str] = {}
        self._look_ns = 0

    def name(self, gid: bytes | None) -> str:
        """The node that sent a message; all that publish the topic where that is not known."""
        if gid is not None and gid in self._names:
            return self._names[gid]
        now_ns = time.monotonic_ns()
        if now_ns >= self._look_ns:
            self._look_ns = now_ns + _LOOK_EVERY_NS
            self._look()
        if gid is not None and gid in self._names:
            return self._names[gid]
        return listed(self._names.values(), "or") if gid is None else ""

    def present(self) -> frozenset[bytes]:
        """Return the GIDs of the nodes that publish it now."""
        return frozenset(gid_of(each) for each in self._look())

    def _look(self) -> list[Any]:
        found: list[Any] = self._node.get_publishers_info_by_topic(self._topic)
        self._names = {gid_of(each): printable(each.node_name) for each in found if each.node_name != NOT_KNOWN}
        return found


@dataclass(frozen=True, slots=True)
class Arrival:
    """Facts about a message besides its content. `gid`: of its publisher, where the middleware tells it."""

    topic: str
    gid: bytes | None
    senders: Senders

    @property
    def sender(self) -> str:
        """The node's name, as far as the middleware knows it; else empty."""
        return self.senders.name(self.gid)


class Door:
    """Door of a node."""

    def __init__(self, node: Node, *, publishes: bool = True) -> None:
        """publishes: complaints go to /diagnostics, too."""
        self._node = node
        self.complaints = complaints_of(node, publishes=publishes)

    def subscription(
        self,
        kind: type[Any],
        topic: str,
        callback: Callable[..., None],
        *,
        qos: QoSProfile | None = None,
        refused: Callable[[str], None] = lambda _words: None,
        with_sender: bool = False,
    ) -> Any:
        """Have `callback` called with each message on `topic` that fits.

        refused: called with the sentence about a message that does not. with_sender: `callback` gets an Arrival, too.
        Raises LookupError for a type that is not declared.
        """
        parts = declared(kind)
        whole = self._node.resolve_topic_name(topic)
        senders = Senders(self._node, whole)
        most = BYTES.get(key_of(kind), MOST_BYTES)
        leaving_out = [(name, each) for name, each in parts.fields.items() if _leaves_out(each)]

        def taken(data: bytes, info: dict[str, Any]) -> None:
            gid = info.get("publisher_gid")
            message, words = _unpacked(data, kind, most)
            words = words or parts.misfit(message, "")
            if words:
                refused(self.refuse(whole, senders.name(gid), words))
                return
            for name, several in leaving_out:
                self._leave_out(message, name, several, whole, senders, gid)
            if with_sender:
                callback(message, Arrival(whole, gid, senders))
            else:
                callback(message)

        return self._subscribe(kind, topic, taken, TOPICS[topic] if qos is None else qos)

    def recorded(
        self, kind: type[Any], topic: str, callback: Callable[[bytes, dict[str, Any]], None], qos: QoSProfile
    ) -> Any:
        """Have `callback` called with each message as the bytes that it is, whatever is in it."""
        whole = self._node.resolve_topic_name(topic)
        senders = Senders(self._node, whole)

        def taken(data: bytes, info: dict[str, Any]) -> None:
            if len(data) > RECORDED_BYTES:
                words = f"it has {len(data)} bytes, more than {RECORDED_BYTES}"
                self.refuse(whole, senders.name(info.get("publisher_gid")), words)
            else:
                callback(data, info)

        return self._subscribe(kind, topic, taken, qos)

    def service(self, kind: type[Any], name: str, callback: Callable[[Any, Any], Any]) -> Service:
        """A service whose requests are declared: NodeExecutor refuses the others."""
        declared(kind.Request)
        return self._node.create_service(kind, name, callback)

    def action(
        self,
        kind: type[Any],
        name: str,
        *,
        goal: Callable[[Any], GoalResponse],
        accepted: Callable[[Any], None],
        cancel: Callable[[Any], CancelResponse],
        execute: Callable[[Any], Any],
        under_way: Callable[[], int],
    ) -> ActionServer:
        """An action whose goals are declared. under_way: how many goals are being followed."""
        parts = declared(kind.Goal)
        whole = self._node.resolve_topic_name(name)
        taken_ns: deque[int] = deque(maxlen=MOST_KEPT)

        def refused_or(request: Any) -> GoalResponse:
            now_ns = time.monotonic_ns()
            words = parts.misfit(request, "")
            if not words and under_way() >= MOST_GOALS:
                words = f"{MOST_GOALS} goals are being followed already"
            if not words and len(taken_ns) == MOST_KEPT and now_ns - taken_ns[0] < KEPT_RESULTS_S * S:
                words = f"{MOST_KEPT} goals came within {KEPT_RESULTS_S} s"
            if words:
                self.refuse(whole, "", words)
                return GoalResponse.REJECT
            response = self._answer(whole, goal, request, GoalResponse.REJECT)
            if response == GoalResponse.ACCEPT:
                taken_ns.append(now_ns)
            return response

        return ActionServer(
            self._node,
            kind,
            name,
            execute_callback=execute,
            goal_callback=refused_or,
            handle_accepted_callback=accepted,
            cancel_callback=lambda handle: self._answer(whole, cancel, handle, CancelResponse.REJECT),
            result_timeout=KEPT_RESULTS_S,
        )

    def refuse(self, what: str, sender: str, why: str) -> str:
        """Say that something on `what` is refused; returns the sentence."""
        words = _sentence(what, sender, why)
        self.complaints.say(what, words)
        return words

    def _answer(self, what: str, ask: Callable[[Any], Any], argument: Any, otherwise: Any) -> Any:
        """Return what `ask` says; `otherwise` where it raises, so that the asker has an answer."""
        try:
            return ask(argument)
        except NodeError:
            raise
        except Exception as error:
            words = f"{what} raised {type(error).__name__}: {printable(str(error), 300)}"
            self.complaints.say(what, words, "error")
            return otherwise

    # ------------------------------------------------------------ the middleware

    def _leave_out(
        self, message: Any, name: str, several: Several, whole: str, senders: Senders, gid: bytes | None
    ) -> None:
        items = getattr(message, name)
        if not len(items):
            return
        bad, first = several.unfit(items, name)
        if first:
            setattr(message, name, [item for item, unfit in zip(items, bad.tolist(), strict=True) if not unfit])
            who = senders.name(gid)
            words = f"{int(bad.sum())} of {len(items)} left out: {first}"
            self.complaints.say(whole, f"{whole}{f' of {who}' if who else ''}: {words}")

    def _subscribe(self, kind: type[Any], topic: str, taken: Callable[..., None], qos: QoSProfile) -> Any:
        whole = self._node.resolve_topic_name(topic)
        heard = on_mismatch(lambda words: self.complaints.say(f"{whole}, QoS", f"{whole}: {words}"))
        subscription = self._node.create_subscription(kind, topic, taken, qos, raw=True, **heard)
        by_hand = taker()
        if by_hand is not None:
            subscription.take = by_hand.take
        return subscription


def _unpacked(data: bytes, kind: type[Any], most: int) -> tuple[Any, str]:
    """The message, or why there is none."""
    if len(data) > most:
        return None, f"it has {len(data)} bytes, more than {most}"
    try:
        return deserialize_message(data, kind), ""
    except Exception:
        return None, f"its {len(data)} bytes are no {key_of(kind)}"


def _leaves_out(kind: Any) -> bool:
    return isinstance(kind, Several) and kind.leave_out


def _sentence(what: str, sender: str, why: str) -> str:
    return f"{what}{f' of {sender}' if sender else ''} refused: {why}"


def refusal_of_request(node: Node, service: Service, request: Any) -> str:
    """Say why a service's request is refused; empty where it fits. Said in the log, too."""
    parts: Parts | None = DECLARED.get(key_of(type(request)))
    why = parts.misfit(request, "") if parts is not None else ""
    if why:
        name = node.resolve_service_name(service.srv_name)
        complaints_of(node).say(name, _sentence(name, "", why))
    return printable(why, 500)
