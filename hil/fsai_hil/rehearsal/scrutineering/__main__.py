"""`fsai-vcu scrutineering` provides a vcan0 and runs this there, with what is to be measured as JSON.

Its keys: result (the file for what is measured, logs go beside it), conditions (names), and what Measurement takes.
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

from fsai_hil.rehearsal.scrutineering.conditions import conditions_named
from fsai_hil.rehearsal.scrutineering.measurement import Measurement
from fsai_hil.rehearsal.stack import StackError


def main() -> int:
    plan = json.loads(sys.argv[1])
    result, names = Path(plan.pop("result")), plan.pop("conditions")
    # A polite kill ends everything that was started, as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        measured = Measurement(folder=result.parent, **plan).run(conditions_named(names))
    except StackError as error:
        print(f"fsai-vcu scrutineering: {error}", file=sys.stderr, flush=True)
        return 1
    except KeyboardInterrupt:
        return 130
    result.write_text(json.dumps(measured) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
