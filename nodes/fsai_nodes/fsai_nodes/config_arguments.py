"""`--config /etc/fsai/fsai.toml [--interface can0]` on a node's command line: the file's settings as ROS arguments.

What stands after it on the command line, in --ros-args, goes before the file.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from fsai_nodes.parameters import NodeError
from fsai_vcu.runtime.configuration import ConfigurationError, Plain, read_configuration


class Configured:
    """A command line with the configuration taken out of it.

    `arguments`: for rclpy. `lines`: what the log is to say of the configuration. The environment that ROS 2 reads is
    set, so this comes before rclpy is started. Raises NodeError.
    """

    def __init__(self, arguments: Sequence[str], node: str) -> None:
        """node: whose parameters are wanted; 'composed' stands for all."""
        parser = argparse.ArgumentParser(prog=node, add_help=False, allow_abbrev=False, exit_on_error=False)
        parser.add_argument("--config", type=Path)
        parser.add_argument("--interface")
        program, *given = arguments
        split = given.index("--ros-args") if "--ros-args" in given else len(given)
        try:
            ours, others = parser.parse_known_args(given[:split])
        except argparse.ArgumentError as error:
            raise NodeError(str(error)) from error
        self.lines: tuple[str, ...] = ()
        self.writes_logs = "--disable-external-lib-logs" not in given  # files of ROS's own
        self.arguments = [program, *others, *given[split:]]
        if ours.config is None:
            if ours.interface is not None:
                raise NodeError("--interface needs --config; without it: --ros-args -p can_interface:=can0")
            return
        try:
            configuration = read_configuration(ours.config)
        except ConfigurationError as error:
            raise NodeError(str(error)) from error
        os.environ.update(configuration.environment())
        found = configuration.parameters(ours.interface)
        wanted = found if node == "composed" else {"": found.get(node, {})}
        self.writes_logs = False
        # The journal keeps what a node says; files of ROS's own beside it would grow without bound.
        quiet = ["--ros-args", "--disable-external-lib-logs", "--"]
        enclave = ["--ros-args", "--enclave", f"/fsai/{node}", "--"] if configuration.text("ros", "keystore") else []
        own = [*ros_arguments(wanted), *enclave, *quiet]
        self.arguments = [program, *others, *own, *given[split:]]
        self.lines = (f"configuration {ours.config}: revision {configuration.revision}, car {configuration.car}",)


def ros_arguments(parameters: Mapping[str, Mapping[str, Plain]]) -> list[str]:
    """Parameters by node name, of every node under ''. What is empty is left at the node's own default."""
    words: list[str] = []
    for node, values in parameters.items():
        for name, value in values.items():
            if value != "":
                # JSON is YAML, which is what ROS takes a value for: a text in quotes stays a text. But YAML knows no
                # letter in two escapes.
                words += ["-p", f"{node}{':' if node else ''}{name}:={json.dumps(value, ensure_ascii=False)}"]
    return ["--ros-args", *words, "--"] if words else []
