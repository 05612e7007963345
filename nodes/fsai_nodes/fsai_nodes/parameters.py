"""Parameters as tables: name, default, range, what a person reads, and whether it may change while the node runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterUninitializedException,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

Value = bool | int | float | str


class NodeError(Exception):
    """A node cannot start, or cannot go on; the message is one clear line."""


@dataclass(frozen=True, slots=True)
class Setting:
    """One parameter. `low` and `high` bound numbers, `choices` bound texts.

    live: it may change while the node runs; the others may only change while the node says it is at rest.
    """

    name: str
    default: Value
    description: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False

    def descriptor(self) -> ParameterDescriptor:
        constraints = []
        if self.choices:
            constraints.append("one of: " + ", ".join(self.choices))
        if not self.live:
            constraints.append("fixed while the node is active")
        descriptor = ParameterDescriptor(
            name=self.name,
            type=Parameter.Type.from_parameter_value(self.default).value,
            description=self.description,
            additional_constraints="; ".join(constraints),
            # A command line reads `revision:=2026` and `max_speed:=5` as integers, which rclpy would refuse for a text
            # and for a float; `problem` does the type check, and takes them.
            dynamic_typing=isinstance(self.default, (float, str)),
        )
        if self.low is not None and self.high is not None:
            if isinstance(self.default, float):
                descriptor.floating_point_range = [FloatingPointRange(from_value=self.low, to_value=self.high)]
            else:
                descriptor.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)]
        return descriptor

    def problem(self, value: object) -> str | None:
        """Why `value` cannot be this parameter; None when it can."""
        wanted = type(self.default)
        whole = isinstance(self.default, (float, str)) and isinstance(value, int) and not isinstance(value, bool)
        if type(value) is not wanted and not whole:
            return f"{self.name} must be {_TYPE_WORDS[wanted]}, not {value!r}"
        if self.choices and str(value) not in self.choices:
            return f"{self.name} must be one of {', '.join(self.choices)}, not '{value}'"
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            if not math.isfinite(value):
                return f"{self.name} must be a finite number, not {value}"
            if self.low is not None and self.high is not None and not self.low <= value <= self.high:
                return f"{self.name} must be between {self.low:g} and {self.high:g}, not {value:g}"
        return None


_TYPE_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


class Settings:
    """The declared parameters of one node: typed reading, refusals with reasons, and a call when one has changed."""

    def __init__(
        self,
        node: Node,
        table: Sequence[Setting],
        on_change: Callable[[str], None],
        busy: Callable[[], str | None] = lambda: "the node is running; restart it with the new value",
    ) -> None:
        """Declares `table` on `node`.

        busy: why parameters that are not live cannot change now; None while they can.
        Raises NodeError when a value given at start does not fit.
        """
        self._node = node
        self._table = {setting.name: setting for setting in table}
        self._on_change = on_change
        self._busy = busy
        for setting in table:
            self._declare(setting)
        node.add_on_set_parameters_callback(self._accept)
        node.add_post_set_parameters_callback(self._changed)

    def number(self, name: str) -> float:
        return float(self._node.get_parameter(name).value)

    def integer(self, name: str) -> int:
        return int(self._node.get_parameter(name).value)

    def text(self, name: str) -> str:
        return str(self._node.get_parameter(name).value)

    def flag(self, name: str) -> bool:
        return bool(self._node.get_parameter(name).value)

    def _declare(self, setting: Setting) -> None:
        try:
            parameter = self._node.declare_parameter(setting.name, setting.default, setting.descriptor())
        except (
            InvalidParameterTypeException,
            InvalidParameterValueException,
            ParameterUninitializedException,
        ) as error:
            raise NodeError(f"parameter {setting.name}: {error}") from error
        problem = setting.problem(parameter.value)
        if problem:
            raise NodeError(f"parameter {problem}")

    def _accept(self, parameters: Iterable[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            setting = self._table.get(parameter.name)
            if setting is None:
                continue
            problem = setting.problem(parameter.value)
            if problem is None and not setting.live:
                busy = self._busy()
                problem = f"{setting.name} cannot change now: {busy}" if busy else None
            if problem:
                self._node.get_logger().warning(f"parameter refused: {problem}")
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True)

    def _changed(self, parameters: Iterable[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name in self._table:
                self._node.get_logger().info(f"{parameter.name} is now {parameter.value}")
                self._on_change(parameter.name)
