"""`fsai-vcu config`: whether /etc/fsai/fsai.toml is right, and which settings follow from it."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from fsai_vcu.runtime.configuration import (
    KEYS,
    TABLES,
    USUAL_PATH,
    Configuration,
    ConfigurationError,
    parse_configuration,
    read_configuration,
)

EXAMPLE = "fsai-vcu config show\n  fsai-vcu config check /etc/fsai/fsai.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "what",
        choices=("check", "show", "environment"),
        metavar="check|show|environment",
        help="check: is it right? show: every setting in force, or the defaults where there is no file; environment: "
        "the variables with which your own ROS programs see the nodes, as systemd's EnvironmentFile= reads them",
    )
    add("file", nargs="?", type=Path, help="the configuration (default: /etc/fsai/fsai.toml)")
    add("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Read the configuration, print its settings or its problems, and return the exit status."""
    path = args.file or USUAL_PATH
    try:
        configuration = _read(args, path)
    except ConfigurationError as error:
        if args.json:
            print(json.dumps({"file": str(path), "right": False, "problems": list(error.problems)}))
        for problem in () if args.json else error.problems:
            print(problem, file=sys.stderr)
        return 1
    if args.json:
        print(
            json.dumps(
                {"file": str(path) if path.exists() else None, "right": True, "problems": [], **_as_dict(configuration)}
            )
        )
    elif args.what == "environment":
        print("\n".join(f"{name}={value}" for name, value in configuration.environment().items()))
    elif args.what == "show":
        print("\n".join(configuration.described()))
        for node, parameters in configuration.parameters().items():
            print(f"\nparameters of {node}:")
            print("\n".join(_parameter(configuration, node, name, value) for name, value in parameters.items()))
    else:
        print(f"{path}: right")
        print("\n".join(f"operational limits: {line}" for line in configuration.limits_described()))
    return 0


def _parameter(configuration: Configuration, node: str, name: str, value: object) -> str:
    """Return the line of a parameter, with the setting that it comes from, whose name says the unit."""
    line = f"  {name}: {json.dumps(value)}"
    key = next((key for key in KEYS if (key.node, key.parameter) == (node, name)), None)
    if key is None:
        return line
    lowered = ", lowered to the operational limits" if configuration.value(key.table, key.name) != value else ""
    return f"{line}  # {key.spelt}{lowered}"


def _read(args: argparse.Namespace, path: Path) -> Configuration:
    """The configuration in `path`; the defaults are shown on a machine that has none. Raises ConfigurationError."""
    try:
        return read_configuration(path)
    except ConfigurationError as error:
        if args.what != "show" or args.file or not isinstance(error.__cause__, FileNotFoundError):
            raise
    print(f"fsai-vcu config: {path} is not there: these are the defaults", file=sys.stderr)
    return parse_configuration("", path)


def _as_dict(configuration: Any) -> dict[str, Any]:
    settings: dict[str, dict[str, Any]] = {table: {} for table in TABLES}
    for key in KEYS:
        value = configuration.value(key.table, key.name)
        plain = isinstance(value, (bool, int, float, str, tuple, list))
        settings[key.table][key.name] = value if plain else str(value)
    return {
        "settings": settings,
        "operational_limits": list(configuration.limits_described()),
        "parameters": configuration.parameters(),
        "environment": configuration.environment(),
    }
