"""`fsai-vcu recorder`: what the recording service does: `record`, as the configuration says."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from fsai_vcu.cli.main import main
from fsai_vcu.runtime.configuration import USUAL_PATH, Configuration, read_configuration

EXAMPLE = "fsai-vcu recorder --config /etc/fsai/fsai.toml --interface can0"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, metavar="FILE", help="the configuration (default: /etc/fsai/fsai.toml)")
    parser.add_argument("-i", "--interface", help="the bus to record (default: the configuration's)")


def run(args: argparse.Namespace) -> int:
    configuration = read_configuration(args.config or USUAL_PATH)
    for line in configuration.limits_described():
        print(f"operational limits: {line}", file=sys.stderr, flush=True)
    return main(["record", *record_arguments(configuration, args.interface or configuration.interface)])


def record_arguments(configuration: Configuration, interface: str) -> list[str]:
    """The configuration's [recording] as arguments of `record`."""
    return [
        "-i",
        interface,
        "-o",
        configuration.text("recording", "folder"),
        "--patient",
        "--max-total",
        f"{configuration.text('recording', 'keep_mib')}M",
        "--keep-free",
        f"{configuration.text('recording', 'leave_free_mib')}M",
        "--revision",
        configuration.revision,
        *(word for file in configuration.dbc_files for word in ("--dbc", file)),
        *(("--limits", str(configuration.limits_path)) if configuration.limits_path is not None else ()),
    ]
