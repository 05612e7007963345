"""`fsai-vcu mode`: autonomous or manual, through the bridge's /set_mode service."""

from __future__ import annotations

import argparse
import json
import sys

EXAMPLE = "fsai-vcu mode autonomous"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("mode", help="autonomous or manual")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.services import call, operator_node

    with operator_node() as node:
        from fsai_msgs.srv import SetMode

        answer = call(node, SetMode, "/set_mode", SetMode.Request(mode=args.mode))
    if args.json:
        print(json.dumps({"mode": args.mode, "success": answer.success, "message": answer.message}))
    else:
        print(answer.message, file=sys.stdout if answer.success else sys.stderr)
    return 0 if answer.success else 1
