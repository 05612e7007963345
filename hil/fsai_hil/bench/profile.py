"""Where the time goes, as flame graphs that py-spy draws: the CAN loop, the decoding of a log, planning.

py-spy looks at a process from outside, some hundred times a second, while it does nothing but this one thing. A frame
is as wide as the share of the time in it and in what it calls, which is below it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from fsai_hil.bench.decode import recorded_frames, write
from fsai_hil.bench.loop import REVISION

LOG_FRAMES = 1_000_000
SAMPLES_HZ = 400
LOOP = """
from fsai_hil.bench.loop import answering
with answering() as (turn, _):
    for _ in range(60_000):
        turn()
"""
DECODE = f"""
import os
from fsai_vcu.cli.main import main
os.sched_setaffinity(0, {{min(os.sched_getaffinity(0))}})  # one process decodes
main(["decode", "long.log", "--revision", "{REVISION}"])
"""
SUBJECTS = {
    "loop": ("-c", LOOP),
    "decode": ("-c", DECODE),
    "planning": ("-m", "fsai_hil.bench", "planning", "trackdrive", "--condition", "ideal"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", type=Path, default=Path("out/profiles"), metavar="DIR", help="for the pictures")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> str:
    """Draw a picture of each subject; return what went wrong."""
    args.out.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    with tempfile.TemporaryDirectory() as folder:
        write(recorded_frames(LOG_FRAMES, Path(folder)), Path(folder) / "long.log")
        for name, arguments in SUBJECTS.items():
            picture = (args.out / f"profile-{name}.svg").resolve()
            spy = ["py-spy", "record", "--function", "--rate", str(SAMPLES_HZ), "--output", str(picture), "--"]
            command = [*spy, sys.executable, *arguments]
            done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=-1, text=True)
            if done.returncode or not picture.exists():
                return f"py-spy: {name}: {done.stderr.strip()[-300:] or 'no profile'}"
            print(f"saved {picture}")
    return ""
