"""Dependence on rclpy's version, and on what rclpy does not tell: all of it is here.

Written for rclpy 7 (Jazzy) and 3 (Humble), which is told by what it lacks. rclpy does not tell a callback the sender of
a message; the middleware knows it (the GID of the publisher), and `Taker` asks for it where the C libraries are laid
out as expected. Where they are not, nothing is lost but the name.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Coroutine, Iterable
from typing import Any

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import SingleThreadedExecutor, await_or_execute
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_policy_name_from_kind as policy_name
from rclpy.subscription import Subscription

_GID_BYTES = 16  # what all versions have of it
_ROOM = 1024  # bytes to begin with; it grows

Take = Callable[[Any], Callable[[], Coroutine[Any, Any, None]] | None]


# ---------------------------------------------------------------- publishers and parameters


def without_events() -> dict[str, Any]:
    """Arguments of create_publisher that leave out rclpy's event handlers.

    Each is one more thing to wait for, every time that a node waits. The subscriptions keep theirs, so a mismatch is
    still reported, on the side where something is missing.
    """
    try:
        from rclpy.event_handler import PublisherEventCallbacks
    except ModuleNotFoundError:  # Humble
        from rclpy.qos_event import PublisherEventCallbacks

    return {"event_callbacks": PublisherEventCallbacks(use_default_callbacks=False)}


def on_mismatch(say: Callable[[str], None]) -> dict[str, Any]:
    """Arguments of create_subscription with which `say` is called for each publisher whose QoS keeps it from being
    heard; rclpy's own callback has a line for each, however many come and go.
    """
    try:
        from rclpy.event_handler import SubscriptionEventCallbacks
    except ModuleNotFoundError:  # Humble
        from rclpy.qos_event import SubscriptionEventCallbacks

    def mismatch(event: Any) -> None:
        say(f"a publisher is not received, as it offers too little (QoS: {policy_name(event.last_policy_kind)})")

    return {"event_callbacks": SubscriptionEventCallbacks(incompatible_qos=mismatch)}


def on_parameters(
    node: Node,
    known: Callable[[list[Parameter]], list[Parameter]],
    accept: Callable[[Iterable[Parameter]], SetParametersResult],
    changed: Callable[[Iterable[Parameter]], None],
) -> None:
    """Have `known` called before parameters are looked at, `accept` before and `changed` after they are set.

    Humble refuses unknown ones itself, in its own words, and calls nobody once they are set: there `changed` is called
    by the executor, as soon as it turns to the node again.
    """
    if hasattr(node, "add_post_set_parameters_callback"):
        node.add_pre_set_parameters_callback(known)
        node.add_on_set_parameters_callback(accept)
        node.add_post_set_parameters_callback(changed)
        return
    accepted: list[Parameter] = []

    def announce() -> None:
        were_set = [each for each in accepted if node.get_parameter(each.name).value == each.value]
        accepted.clear()
        changed(were_set)

    guard = node.create_guard_condition(announce)

    def accept_and_announce(parameters: Iterable[Parameter]) -> SetParametersResult:
        given = list(parameters)
        result = accept(given)
        if result.successful:
            accepted.extend(given)
            guard.trigger()
        return result

    node.add_on_set_parameters_callback(accept_and_announce)


# ---------------------------------------------------------------- the executor


class TakingExecutor(SingleThreadedExecutor):  # type: ignore[misc]  # rclpy has no types
    """One thread, like rclpy's own; `_take_...(entity)` takes what waits, and gives the call that handles it or None.

    Humble takes in one method and handles in another, `_execute_...(entity, taken)`: there the two are put together.
    """


def _take_and_handle(kind: str) -> Callable[[Any, Any], Any]:
    """Return the method by which a Humble executor takes an entity of this kind and gives the call that handles it."""
    execute = getattr(SingleThreadedExecutor, f"_execute_{kind}")

    def taken(executor: Any, entity: Any) -> Callable[[], Coroutine[Any, Any, None]]:
        take = getattr(super(TakingExecutor, executor), f"_take_{kind}", None)
        found = entity.take_data() if take is None else take(entity)

        async def call() -> None:
            if kind == "subscription" and entity.raw and found is not None:
                await await_or_execute(entity.callback, found, {})  # the door's, with nothing known of the sender
            else:
                await execute(executor, entity, found)

        return call

    return taken


def _make_handler(executor: Any, entity: Any, node: Any, _: Any, execute: Any) -> Any:
    async def call(_: Any, taken: Callable[[], Coroutine[Any, Any, None]] | None) -> None:
        if taken is not None:
            await taken()

    take = getattr(executor, execute.__name__.replace("_execute_", "_take_"))
    return SingleThreadedExecutor._make_handler(executor, entity, node, take, call)


if hasattr(SingleThreadedExecutor, "_execute_timer"):  # Humble
    for _kind in ("timer", "subscription", "client", "service", "guard_condition", "waitable"):
        setattr(TakingExecutor, f"_take_{_kind}", _take_and_handle(_kind))
    TakingExecutor._make_handler = _make_handler


# ---------------------------------------------------------------- messages with their sender


class _Allocator(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in ("take", "free", "again", "zeroed", "state"))


class _Bytes(ctypes.Structure):  # rcutils_uint8_array_t, which is rcl_serialized_message_t
    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class Taker:
    """Takes one subscription's messages as bytes, each with the GID of its publisher."""

    def __init__(self) -> None:
        """Look for the C libraries. Raises OSError or AttributeError where they are not as expected."""
        self._rcl = ctypes.CDLL("librcl.so")
        rcutils = ctypes.CDLL("librcutils.so")
        rmw = ctypes.CDLL(f"lib{rclpy.get_rmw_implementation_identifier()}.so")
        rmw.rmw_get_implementation_identifier.restype = ctypes.c_void_p
        # It stands before the GID in the middleware's description of a message.
        self._mark: int = rmw.rmw_get_implementation_identifier()
        self._rcl.rcl_take_serialized_message.argtypes = [
            ctypes.c_void_p,
            ctypes.POINTER(_Bytes),
            ctypes.c_void_p,
            ctypes.c_void_p,
        ]
        rcutils.rcutils_get_default_allocator.restype = _Allocator
        rcutils.rcutils_get_zero_initialized_uint8_array.restype = _Bytes
        rcutils.rcutils_uint8_array_init.argtypes = [
            ctypes.POINTER(_Bytes),
            ctypes.c_size_t,
            ctypes.POINTER(_Allocator),
        ]
        self._free = rcutils.rcutils_uint8_array_fini
        self._free.argtypes = [ctypes.POINTER(_Bytes)]
        self._init = rcutils.rcutils_uint8_array_init
        self._reset_error = rcutils.rcutils_reset_error
        self._allocator = rcutils.rcutils_get_default_allocator()
        self._zeroed = rcutils.rcutils_get_zero_initialized_uint8_array
        self._info = (ctypes.c_uint64 * 32)()  # twice what any version fills

    def take(self, subscription: Subscription) -> tuple[bytes, dict[str, Any]] | None:
        """The next message, when it was sent and the GID of who sent it, if known; None where none is left.

        The two are `source_timestamp` (ns, 0: not known) and `publisher_gid`, the names that rclpy gives them.
        """
        taken = self._zeroed()
        self._init(taken, _ROOM, self._allocator)
        try:
            ctypes.memset(self._info, 0, ctypes.sizeof(self._info))
            with subscription.handle:
                status = self._rcl.rcl_take_serialized_message(subscription.handle.pointer, taken, self._info, None)
            if status:
                self._reset_error()
                return None
            sent_ns = ctypes.c_int64(self._info[0]).value  # the first field in all versions
            return ctypes.string_at(taken.buffer, taken.length), {
                "source_timestamp": sent_ns,
                "publisher_gid": self._gid(),
            }
        finally:
            self._free(taken)

    def _gid(self) -> bytes | None:
        words = list(self._info)
        if self._mark not in words[:-3]:
            return None
        start = 8 * (words.index(self._mark) + 1)
        return bytes(self._info)[start : start + _GID_BYTES]


def taker() -> Taker | None:
    """Return a Taker; None where senders cannot be known."""
    try:
        return Taker()
    except (OSError, AttributeError):
        return None


def gid_of(endpoint: Any) -> bytes:
    """Return an endpoint's GID as `Taker` tells it, of an entry of get_publishers_info_by_topic."""
    return bytes(endpoint.endpoint_gid[:_GID_BYTES])


def process_of(gid: bytes) -> bytes:
    """The part of a GID that all publishers of one ROS context share."""
    return gid[:12]
