"""Runs the callbacks of nodes; a callback that raises is reported, and ends nobody.

Its output is missing, as if its input had not come. Only NodeError ends a node: it is the node's own word for it.
A service whose callback raises answers with what its response is by default, success False, and why.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, await_or_execute
from rclpy.node import Node
from rclpy.service import Service

from fsai_nodes.complaints import complaints_of
from fsai_nodes.door import refusal_of_request
from fsai_nodes.fields import printable
from fsai_nodes.middleware import Take, TakingExecutor
from fsai_nodes.parameters import NodeError
from fsai_vcu.interface.units import MS, S

NOTHING_BUT_NS = S  # a callback that has only raised for so long says so
WAITED_NS = 50 * MS  # an answer that took so long waited for its client: usually one takes a thousandth of it
_PAUSES = 4  # times that, before the next answer: clients that take none cost a fifth of the time at most
_MOST_UNSENT = 8  # answers of a service that wait; the oldest are given up


class ServiceAnswers:
    """Answers of services, each sent at once unless an earlier one had to wait for its client.

    The middleware waits up to 100 ms for a client that is gone, or whose QoS keeps it from receiving the answer, and
    the node does nothing else meanwhile. After such an answer the next ones pause, so that requests are still carried
    out; then the service whose answers waited longest ago comes first.
    """

    def __init__(self, say: Callable[[Service], None]) -> None:
        """say: called with a service of which an answer waited."""
        self._say = say
        self._unsent: dict[Service, deque[Callable[[], None]]] = {}
        self._waited_ns: dict[Service, int] = {}  # when it last did
        self._due_ns = 0

    def put(self, service: Service, send: Callable[[], None]) -> None:
        """Take in an answer, which `send` sends."""
        self._unsent.setdefault(service, deque(maxlen=_MOST_UNSENT)).append(send)
        self.send()

    def send(self) -> None:
        """Send what may be sent now."""
        while self._unsent and (begin_ns := time.monotonic_ns()) >= self._due_ns:
            service = min(self._unsent, key=lambda each: self._waited_ns.get(each, 0))
            send = self._unsent[service].popleft()
            if not self._unsent[service]:
                del self._unsent[service]
            send()
            end_ns = time.monotonic_ns()
            if end_ns - begin_ns >= WAITED_NS:
                self._waited_ns[service] = end_ns
                self._due_ns = end_ns + _PAUSES * (end_ns - begin_ns)
                self._say(service)


class NodeExecutor(TakingExecutor):
    """One thread, in which no exception of a callback gets out but NodeError."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._running: tuple[Any, Node | None] = None, None  # the entity whose callback runs, and its node
        self._raising: dict[str, int] = {}  # what has done nothing but raise, and since when
        self._answers = ServiceAnswers(self._say_unheard)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        self._running = None, None
        try:
            self._answers.send()
            super().spin_once(timeout_sec)
        except (NodeError, ExternalShutdownException):
            raise
        except Exception as error:
            self._report(*self._running, error)
        else:
            if self._raising and self._running[0] is not None:
                self._raising.pop(_name(self._running[0]), None)

    def wait_for_ready_callbacks(self, *arguments: Any, **options: Any) -> Any:
        task, entity, node = super().wait_for_ready_callbacks(*arguments, **options)
        self._running = entity, node
        return task, entity, node

    def _report(self, entity: Any, node: Node | None, error: Exception) -> None:
        what = _name(entity)
        now_ns = time.monotonic_ns()
        since_ns = self._raising.setdefault(what, now_ns)
        words = f"{what} raised {type(error).__name__}: {printable(str(error), 300)}{_place(error)}"
        if now_ns - since_ns >= NOTHING_BUT_NS:
            words += f"; it has done nothing but raise for {(now_ns - since_ns) / 1e9:.0f} s"
        for each in [node] if node is not None else list(self.get_nodes())[:1]:
            complaints_of(each).say(what, words, "error", now_ns)

    # ------------------------------------------------------------ what rclpy takes from the middleware

    # An exception there would leave the entity marked as taken, and its group as busy, so that it is never heard again.

    def _guarded(self, take: Take, entity: Any) -> Any:
        try:
            return take(entity)
        except Exception as error:
            self._report(entity, self._running[1], error)
            return None

    def _take_timer(self, timer: Any) -> Any:
        return self._guarded(super()._take_timer, timer)

    def _take_client(self, client: Any) -> Any:
        return self._guarded(super()._take_client, client)

    def _take_guard_condition(self, guard: Any) -> Any:
        return self._guarded(super()._take_guard_condition, guard)

    def _take_waitable(self, waitable: Any) -> Any:
        return self._guarded(super()._take_waitable, waitable)

    def _take_subscription(self, subscription: Any) -> Any:
        take = getattr(subscription, "take", None)  # the door's, which knows who sent a message
        return self._guarded(super()._take_subscription if take is None else self._take_by_the_door, subscription)

    def _take_by_the_door(self, subscription: Any) -> Any:
        try:
            taken = subscription.take(subscription)
        except InvalidHandle:  # destroyed in the meantime
            return None
        if taken is None:
            return None

        async def call() -> None:
            await await_or_execute(subscription.callback, *taken)

        return call

    def _take_service(self, service: Service) -> Any:
        if not hasattr(service.callback, "answers"):
            service.callback = self._answering(service, self._running[1])
            service.send_response = partial(self._send, service, service.send_response)
        return self._guarded(super()._take_service, service)

    def _send(self, service: Service, send: Callable[[Any, Any], None], response: Any, header: Any) -> None:
        self._answers.put(service, partial(send, response, header))

    def _say_unheard(self, service: Service) -> None:
        what = _name(service)
        words = f"{what}: an answer waited for its client; has the client ended, or is its QoS not that of services?"
        for each in list(self.get_nodes())[:1]:
            complaints_of(each).say(f"{what}, answers", words)

    def _answering(self, service: Service, node: Node | None) -> Any:
        """The service's callback; an answer comes also where it raises, or where the request does not fit."""
        callback = service.callback

        async def answering(request: Any, response: Any) -> Any:
            try:
                if node is not None and (refusal := refusal_of_request(node, service, request)):
                    return _refused(service, request, refusal)
                return await await_or_execute(callback, request, response)
            except NodeError:
                raise
            except Exception as error:
                self._report(service, node, error)
                return _refused(service, request, f"{type(error).__name__}: {printable(str(error), 300)}")

        answering.answers = True  # type: ignore[attr-defined]
        return answering


def _refused(service: Service, request: Any, why: str) -> Any:
    """The response that says no, and why where it has a field for it."""
    response = service.srv_type.Response()
    if hasattr(response, "message"):
        response.message = why
    if hasattr(response, "results"):  # of parameters, one each
        from rcl_interfaces.msg import SetParametersResult

        most = request.parameters[:100]
        response.results = [SetParametersResult(successful=False, reason=why) for _ in most]
    elif hasattr(response, "result") and hasattr(response.result, "reason"):
        response.result.reason = why
    elif hasattr(response, "failure_reason"):
        response.failure_reason = why
    return response


def _name(entity: Any) -> str:
    """Name an entity, in words that stay the same."""
    if entity is None:
        return "a task"
    for field in ("topic_name", "srv_name"):
        name = getattr(entity, field, None)
        if name is not None:
            return f"/{str(name).strip('/')}"
    name = getattr(getattr(entity, "callback", None), "__qualname__", None)
    return f"timer {name}" if name else type(entity).__name__


def _place(error: Exception) -> str:
    """Return where the error was raised: file and line."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return ""
    return f" ({trace.tb_frame.f_code.co_filename.rpartition('/')[2]}:{trace.tb_lineno})"
