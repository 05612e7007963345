"""Parameters as tables: name, default, range, what a person reads, and whether it may change while the node runs."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from typing import cast

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from fsai_nodes.complaints import ANSWERS, complaints_of
from fsai_nodes.fields import NAMED, printable, shown
from fsai_nodes.middleware import on_parameters
from fsai_vcu.files import SETTINGS_BYTES, read_named
from fsai_vcu.runtime.configuration import KEYS

Value = bool | int | float | str
MOST_CHARACTERS = 4000  # of a text


class NodeError(Exception):
    """A node cannot start, or cannot go on; the message is one clear line."""


@dataclass(frozen=True, slots=True)
class NodeParameter:
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
        """Return the parameter's descriptor, as ROS tools show it."""
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
        """Say why `value` cannot be this parameter; None when it can."""
        wanted = type(self.default)
        whole = isinstance(self.default, (float, str)) and isinstance(value, int) and not isinstance(value, bool)
        if type(value) is not wanted and not whole:
            return f"{self.name} must be {_TYPE_WORDS[wanted]}, not {shown(value)}"
        if isinstance(value, str) and (len(value) > MOST_CHARACTERS or not value.isprintable()):
            return f"{self.name} must be one line of at most {MOST_CHARACTERS} characters, not {shown(value)}"
        if self.choices and str(value) not in self.choices:
            return f"{self.name} must be one of {', '.join(self.choices)}, not {shown(str(value))}"
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            if not math.isfinite(value):
                return f"{self.name} must be a finite number, not {value}"
            if self.low is not None and self.high is not None and not self.low <= value <= self.high:
                return f"{self.name} must be between {self.low:g} and {self.high:g}, not {value:g}"
        return None


def of_the_file(node: str, note: str = "", *, live: bool = False) -> tuple[NodeParameter, ...]:
    """Return those of the node's parameters that the configuration file has, too: its KEYS describe them.

    note: a sentence more for each.
    """
    return tuple(
        NodeParameter(
            key.parameter,
            cast("Value", key.default),
            f"{key.meaning[:1].upper()}{key.meaning[1:]}.{note}",
            key.low,
            key.high,
            key.choices,
            live,
        )
        for key in KEYS
        if key.node == node
    )


CLOCK = "use_sim_time"  # rclpy's own: whose time the stamps are
_TYPE_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


@dataclass(frozen=True, slots=True)
class Scattered:
    """Parameters on a command line that name no node: a node that does not have one need not be meant."""

    unnamed: frozenset[str]  # -p laps:=3
    of_files: frozenset[str]  # under /** in a parameter file, which may be meant for anybody's nodes

    @classmethod
    def among(cls, arguments: Sequence[str]) -> Scattered:
        """Return the parameters of the arguments that name no node. A file that cannot be read is left to ROS to
        complain of.
        """
        unnamed: set[str] = set()
        of_files: set[str] = set()
        for option, value in pairwise(arguments):
            if option in ("-p", "--param"):
                node, colon, name = value.partition(":=")[0].rpartition(":")
                if not colon or _is_wildcard(node):
                    unnamed.add(name)
            elif option == "--params-file":
                of_files |= set(_for_everybody(yaml_of(value)))
        return cls(frozenset(unnamed), frozenset(of_files))


def _is_wildcard(node: str) -> bool:
    return node.rpartition("/")[2] in ("*", "**")


def yaml_of(file: str) -> object:
    """The content of a parameter file; None where it cannot be read, or says things by reference, which may expand."""
    import yaml

    try:
        text = read_named(file, SETTINGS_BYTES)
        if any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text)):
            return None
        return yaml.safe_load(text)
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return None


def _for_everybody(content: object, node: str = "") -> Iterable[str]:
    """The parameters of a parameter file that stand under a wildcard instead of a node's name."""
    if not isinstance(content, Mapping):
        return
    for key, below in content.items():
        if key != "ros__parameters":
            yield from _for_everybody(below, str(key))
        elif _is_wildcard(node):
            yield from _flat(below)


def _flat(content: object, prefix: str = "") -> Iterable[str]:
    if isinstance(content, Mapping):
        for key, below in content.items():
            yield from _flat(below, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix


# Parameters of every node of this process, where it holds several: -p laps:=3 is meant for whichever has it.
_of_this_process: set[str] = set()


def several_nodes(tables: Iterable[Sequence[NodeParameter]]) -> None:
    """Note that this process holds several nodes, which have these parameters."""
    _of_this_process.update(setting.name for table in tables for setting in table)


class _UnknownParameter(ParameterNotDeclaredException):  # type: ignore[misc]  # rclpy has no types
    """rclpy answers a request with this error's words; its own name no parameter."""

    def __init__(self, words: str) -> None:
        Exception.__init__(self, words)


def misspelt(given: Iterable[str], known: Iterable[str]) -> str:
    """Say which of the names `given` are nearly one of `known`, and which; '' where all are right, or quite others."""
    known = list(known)
    close = {name: get_close_matches(name, known, n=1) for name in given if name not in known}
    return "; ".join(f"unknown argument {name}: did you mean {meant[0]}?" for name, meant in close.items() if meant)


class Settings:
    """The declared parameters of one node: typed reading, refusals with reasons, and a call when one has changed."""

    def __init__(
        self,
        node: Node,
        table: Sequence[NodeParameter],
        on_change: Callable[[str], None],
        busy: Callable[[], str | None] = lambda: "the node is running; restart it with the new value",
    ) -> None:
        """Declares `table` on `node`.

        busy: why parameters that are not live cannot change now; None while they can.
        Raises NodeError when a value given at start does not fit, or a parameter given is none of the node's.
        """
        self._node = node
        self._table = {setting.name: setting for setting in table}
        self._on_change = on_change
        self._busy = busy
        for setting in table:
            self._declare(setting)
        self._refuse_unknown()
        on_parameters(node, self._only_known, self._accept, self._changed)

    def number(self, name: str) -> float:
        return float(self._node.get_parameter(name).value)

    def integer(self, name: str) -> int:
        return int(self._node.get_parameter(name).value)

    def text(self, name: str) -> str:
        return str(self._node.get_parameter(name).value)

    def flag(self, name: str) -> bool:
        return bool(self._node.get_parameter(name).value)

    def _declare(self, setting: NodeParameter) -> None:
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

    def _unknown(self, name: str, also: Iterable[str] = ()) -> str:
        """Say that a parameter is unknown; `also`: other names that may have been meant."""
        close = next(iter(get_close_matches(name, [*self._table, *also], n=1)), None)
        words = f"did you mean {close}?" if close else f"{self._node.get_name()} has {', '.join(self._table)}"
        return f"unknown parameter {printable(name)}: {words}"

    def _refuse_unknown(self) -> None:
        """Look at what was given at start; rclpy ignores what no node declares."""
        given = [
            name
            for name in self._node._parameter_overrides
            if not self._node.has_parameter(name) and not name.startswith("qos_overrides.")
        ]
        scattered = Scattered.among(sys.argv)
        refused = []
        for name in given:
            if name in scattered.of_files:
                # Other nodes read that file, too: only what is nearly one of these names is likely to be meant.
                if get_close_matches(name, self._table, n=1):
                    self._node.get_logger().warning(f"{self._unknown(name)} (under /** in a parameter file)")
            elif name not in scattered.unnamed:
                refused.append(self._unknown(name))
            elif name not in _of_this_process:
                refused.append(self._unknown(name, _of_this_process))
        if refused:
            raise NodeError("; ".join(refused))

    def _only_known(self, parameters: list[Parameter]) -> list[Parameter]:
        unknown = [each.name for each in parameters if not self._node.has_parameter(each.name)]
        if unknown:
            words = "; ".join(map(self._unknown, unknown[:NAMED]))
            if len(unknown) > NAMED:
                words += f"; and {len(unknown) - NAMED} more"
            self._refused(words)
            raise _UnknownParameter(words)
        return parameters

    def _accept(self, parameters: Iterable[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if problem := self._why_not(parameter):
                self._refused(problem)
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True)

    def _refused(self, words: str) -> None:
        complaints_of(self._node).say("parameters", f"parameter refused: {words}", at_once=ANSWERS)

    def _why_not(self, parameter: Parameter) -> str | None:
        """Say why it cannot be set; None where it can."""
        if parameter.name == CLOCK and parameter.value != self._node.get_parameter(CLOCK).value:
            return f"{CLOCK} cannot change while the node runs: restart it with the new value"
        setting = self._table.get(parameter.name)
        if setting is None:
            return None
        problem = setting.problem(parameter.value)
        if problem is None and not setting.live and (busy := self._busy()):
            problem = f"{setting.name} cannot change now: {busy}"
        return problem

    def _changed(self, parameters: Iterable[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name in self._table:
                line = f"{parameter.name} is now {parameter.value}"
                complaints_of(self._node).say("parameters set", line, "info", at_once=ANSWERS)
                self._on_change(parameter.name)
