"""`make profile`: where the time goes, as pictures: the CAN loop, the decoding of a log, planning.

    python -m fsai_hil.rehearsal.profiles -o docs/pictures

py-spy looks at a process from outside, some hundred times a second, while it does nothing but this one thing. Each
picture is a flame graph: a frame is as wide as the share of the time in it and in what it calls, which is below it.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from fsai_hil.rehearsal.bench import REVISION, answering, recorded_frames, write
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.world import WorldSetup, mission_named
from fsai_vcu.cli.main import main as fsai_vcu
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.revisions import revision

CYCLES = 60_000
LOG_FRAMES = 1_000_000
SAMPLES_HZ = 400
WIDTH, ROW, MARGIN = 1000, 17, 4  # pixels
LEAST_SHARE = 0.01  # what is narrower is not drawn
LABEL_PX = 6.2  # a character
LEAST_LABEL = 4  # characters
COLOURS = {
    "fsai_vcu/core": "#f4a261",
    "fsai_vcu/interface": "#e9c46a",
    "fsai_vcu/runtime": "#e07a5f",
    "fsai_vcu/diagnostics": "#81b29a",
    "fsai_hil": "#a8c5e2",
    "": "#d5d5d5",
}


def loop(_: Path) -> None:
    """A 0x520 received, five frames sent: again and again, on the loopback bus."""
    with answering(Codec(revision(REVISION))) as (turn, _bridge):
        for _number in range(CYCLES):
            turn()


def decode(folder: Path) -> None:
    """A recorded log to text, by one process."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    fsai_vcu(["decode", str(folder / "long.log"), "--revision", REVISION])


def planning(_: Path) -> None:
    """A lap of trackdrive in lockstep, of which only the planner is shown."""
    Lockstep(WorldSetup(missions=[mission_named("trackdrive")], laps=1)).run()


@dataclass(frozen=True, slots=True)
class Subject:
    """What is profiled: the function that does it, and the first frame that is shown of it."""

    work: Callable[[Path], None]
    root: str


SUBJECTS = {
    "loop": Subject(loop, r"turn \("),
    "decode": Subject(decode, r"main \(fsai_vcu/cli/main.py"),
    "planning": Subject(planning, r"\(fsai_vcu/core/planning/planner.py"),
}


@dataclass(slots=True)
class Node:
    """A frame of the graph: samples in it and below it."""

    samples: int = 0
    below: dict[str, Node] = field(default_factory=dict)

    def add(self, stack: Sequence[str], samples: int) -> None:
        self.samples += samples
        if stack:
            self.below.setdefault(stack[0], Node()).add(stack[1:], samples)

    def deep(self, least: float) -> int:
        """How many rows its graph has."""
        return 1 + max((each.deep(least) for each in self.below.values() if each.samples >= least), default=0)


def graph_of(stacks: str, root: str) -> tuple[Node, int]:
    """Of py-spy's raw output: what is below the first frame that is named like `root`; and all samples."""
    graph, everything = Node(), 0
    for line in stacks.splitlines():
        stack, _, count = line.rpartition(" ")
        everything += int(count)
        frames = [re.sub(r"(:\d+)?\)$", ")", frame) for frame in stack.split(";") if "importlib" not in frame]
        first = next((number for number, frame in enumerate(frames) if re.search(root, frame)), None)
        if first is not None:
            graph.add(frames[first:], int(count))
    if not graph.samples:
        raise OSError(f"no sample is in {root}")
    return graph, everything


def drawn(graph: Node, title: str) -> str:
    """The flame graph as SVG."""
    least = LEAST_SHARE * graph.samples
    height = graph.deep(least) * ROW + 2 * MARGIN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif"',
        ' font-size="11">',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/><text x="{MARGIN}" y="14">{escape(title)}</text>',
        *_bars(graph, 0.0, 1, WIDTH / graph.samples, least),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _bars(node: Node, left: float, row: int, px: float, least: float) -> Iterator[str]:
    for frame, below in sorted(node.below.items(), key=lambda item: -item[1].samples):
        if below.samples < least:
            continue
        width = below.samples * px
        name, _, file = frame.rstrip(")").partition(" (")
        colour = next(colour for part, colour in COLOURS.items() if part in file)
        share = f"{100 * width / WIDTH:.0f} %"
        room = int((width - 6) / LABEL_PX)
        words = f"{name} {share}"[:room] if room >= LEAST_LABEL else ""
        at = f'x="{left:.1f}" y="{row * ROW + MARGIN}"'
        yield (
            f'<g><title>{escape(frame)}: {share}</title><rect {at} width="{width - 0.5:.1f}" height="{ROW - 1}" '
            f'fill="{colour}"/><text x="{left + 3:.1f}" y="{row * ROW + MARGIN + 12}">{escape(words)}</text></g>'
        )
        yield from _bars(below, left, row + 1, px, least)
        left += width


def profiled(name: str, folder: Path) -> str:
    """py-spy's raw output of the subject in a process of its own."""
    raw = folder / f"{name}.raw"
    spy = ["py-spy", "record", "--format", "raw", "--function", "--rate", str(SAMPLES_HZ), "--output", str(raw), "--"]
    command = [sys.executable, "-m", "fsai_hil.rehearsal.profiles", "--only", name, "-o", str(folder)]
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        [*spy, *command], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    if done.returncode or not raw.exists():
        raise OSError(f"py-spy: {done.stderr.strip()[-300:] or 'no profile'}")
    return raw.read_text("utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    """0: every picture is drawn; 1: not."""
    parser = argparse.ArgumentParser(prog="fsai_hil.rehearsal.profiles", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("out/profiles"), metavar="DIR", help="for the pictures")
    parser.add_argument("--only", choices=SUBJECTS, help=argparse.SUPPRESS)  # this is the process that is looked at
    args = parser.parse_args(argv)
    if args.only:
        SUBJECTS[args.only].work(args.out)
        return 0
    args.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        write(recorded_frames(LOG_FRAMES, Path(folder)), Path(folder) / "long.log")
        for name, subject in SUBJECTS.items():
            try:
                graph, everything = graph_of(profiled(name, Path(folder)), subject.root)
            except OSError as error:
                print(f"profiles: {name}: {error}", file=sys.stderr)
                return 1
            share = f"{100 * graph.samples / everything:.0f} % of {everything} samples"
            title = f"{name}: {(subject.work.__doc__ or '').strip()} {share} of the process."
            (args.out / f"profile-{name}.svg").write_text(drawn(graph, title), encoding="utf-8")
            print(title, *sorted(_selves(graph).items(), key=lambda item: -item[1])[:12], sep="\n  ")
    return 0


def _selves(node: Node, name: str = "") -> dict[str, int]:
    """Samples of each function itself, without what it calls."""
    total = {name: node.samples - sum(each.samples for each in node.below.values())}
    for frame, below in node.below.items():
        for each, samples in _selves(below, frame).items():
            total[each] = total.get(each, 0) + samples
    return total


if __name__ == "__main__":
    sys.exit(main())
