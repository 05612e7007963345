"""rclpy reduced to what Humble's has, in every process with this folder on its PYTHONPATH.

Humble is not to be had from the package index. What Jazzy added of what the nodes use is removed from rclpy when it is
imported: the module `event_handler`, callbacks before and after parameters are set, who sent a message, and an
executor that takes and handles in one method.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from textwrap import dedent
from types import ModuleType
from typing import Any

KINDS = ("timer", "subscription", "client", "service", "guard_condition")


def executors_of_humble(module: ModuleType) -> None:
    executor = module.Executor
    jazzy = {kind: getattr(executor, f"_take_{kind}") for kind in (*KINDS, "waitable")}
    make_handler = executor._make_handler

    def take_subscription(_: Any, subscription: Any) -> Any:
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        return None if taken is None else taken[0]

    async def execute_subscription(_: Any, subscription: Any, message: Any) -> None:
        if message is not None:
            await module.await_or_execute(subscription.callback, message)

    async def execute(_: Any, __: Any, call: Callable[[], Any] | None) -> None:
        if call is not None:
            await call()

    async def execute_waitable(self: Any, waitable: Any, data: Any) -> None:
        for future in waitable._futures:
            future._set_executor(self)
        await waitable.execute(data)

    def named(method: Any, kind: str) -> Any:
        """A function of its own with the name that Humble's has."""

        async def of_humble(self: Any, entity: Any, taken: Any) -> None:
            await method(self, entity, taken)

        of_humble.__name__ = f"_execute_{kind}"
        return of_humble

    for kind in KINDS:
        setattr(executor, f"_take_{kind}", take_subscription if kind == "subscription" else jazzy[kind])
        of_kind = execute_subscription if kind == "subscription" else execute
        setattr(executor, f"_execute_{kind}", named(of_kind, kind))
    del executor._take_waitable
    executor._execute_waitable = named(execute_waitable, "waitable")

    def make_handler_of_humble(self: Any, entity: Any, node: Any, take: Any, execute: Any) -> Any:
        return make_handler(self, entity, node, lambda each: partial(execute, each, take(each)))

    executor._make_handler = make_handler_of_humble
    source = dedent(inspect.getsource(executor._wait_for_ready_callbacks))
    source = re.sub(
        r"\(wt, node, self\._take_waitable\)", "(wt, node, lambda e: e.take_data(), self._execute_waitable)", source
    )
    source, count = re.subn(
        r"\((\w+), node, self\._take_(\w+)\)", r"(\1, node, self._take_\2, self._execute_\2)", source
    )
    assert count == len(KINDS), "rclpy's executor is not as this file expects it"
    made: dict[str, Any] = {}
    exec(compile(source, module.__file__ or "", "exec"), vars(module), made)
    executor._wait_for_ready_callbacks = made["_wait_for_ready_callbacks"]


def node_of_humble(module: ModuleType) -> None:
    del module.Node.add_pre_set_parameters_callback, module.Node.add_post_set_parameters_callback
    # rclpy's own modules have it by now.
    sys.modules["rclpy.qos_event"] = sys.modules.pop("rclpy.event_handler")
    GONE.add("rclpy.event_handler")


REDUCED = {"rclpy.executors": executors_of_humble, "rclpy.node": node_of_humble}
GONE: set[str] = set()


class Reducer(MetaPathFinder):
    """Finds a module of rclpy as the others do, and reduces it once it is imported."""

    def find_spec(self, name: str, *_: Any) -> ModuleSpec | None:
        if name in GONE:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        reduce = REDUCED.pop(name, None)
        if reduce is None:
            return None
        spec = find_spec(name)
        assert spec is not None and spec.loader is not None
        run = spec.loader.exec_module

        def run_and_reduce(module: ModuleType) -> None:
            run(module)
            reduce(module)

        spec.loader.exec_module = run_and_reduce  # type: ignore[method-assign]
        return spec


sys.meta_path.insert(0, Reducer())
