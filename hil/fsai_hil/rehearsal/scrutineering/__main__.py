"""`fsai-vcu scrutineering` provides a vcan0 and runs this there: `python -m fsai_hil.rehearsal.scrutineering`."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path

from fsai_hil.rehearsal.scrutineering.conditions import BY_NAME, conditions_named
from fsai_hil.rehearsal.scrutineering.measurement import Measurement
from fsai_hil.rehearsal.stack import StackError


def main() -> int:
    parser = argparse.ArgumentParser(prog="fsai_hil.rehearsal.scrutineering", description=__doc__.splitlines()[0])
    parser.add_argument("interface")
    parser.add_argument("result", type=Path, help="the JSON file for what is measured; logs go beside it")
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--revision", required=True)
    parser.add_argument("--conditions", default=",".join(BY_NAME))
    parser.add_argument("--slow-place", action="store_true")
    args = parser.parse_args()
    # A polite kill ends everything that was started, as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    measurement = Measurement(
        args.interface,
        args.result.parent,
        seconds=args.seconds,
        revision=args.revision,
        slow_place=args.slow_place,
        say=lambda text: print(text, flush=True),
    )
    try:
        measured = measurement.run(conditions_named(args.conditions.split(",")))
    except StackError as error:
        print(f"fsai-vcu scrutineering: {error}", file=sys.stderr, flush=True)
        return 1
    except KeyboardInterrupt:
        return 130
    args.result.write_text(json.dumps(measured) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
