"""`fsai-vcu emergency-brake`: ask the car for an emergency stop, through the bridge."""

from __future__ import annotations

import argparse
import json
import sys

EXAMPLE = "fsai-vcu emergency-brake"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.services import call, operator_node

    with operator_node() as node:
        from std_srvs.srv import Trigger

        answer = call(node, Trigger, "/emergency_brake", Trigger.Request())
    if args.json:
        print(json.dumps({"success": answer.success, "message": answer.message}))
    else:
        print(answer.message, file=sys.stdout if answer.success else sys.stderr)
    return 0 if answer.success else 1
