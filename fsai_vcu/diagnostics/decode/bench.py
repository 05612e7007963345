"""How fast logs are decoded, beside cantools' own command line on the same log in the same run.

python -m fsai_vcu.diagnostics.decode.bench LOG [--frames N]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from fsai_vcu.diagnostics.decode.databases import Databases, load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.decode.lines import LineWriter
from fsai_vcu.diagnostics.log.reader import open_log, read_log
from fsai_vcu.interface.revisions import REVISIONS, dbc_dir


@dataclass(frozen=True, slots=True)
class Speed:
    """Seconds for the whole log, the best of several runs; `lines` and `values` are without a process's start."""

    frames: int
    cantools_command_s: float
    decode_command_s: float
    decode_command_json_s: float
    decode_command_to_file_s: float
    lines_s: float
    values_s: float
    command_ratio: float
    lines_ratio: float
    values_ratio: float


def speed(log: Path, repeats: int = 3) -> Speed:
    """Decode `log` (of candump) with both, all messages of the 2026 databases."""
    from cantools.database.can import Database

    with tempfile.TemporaryDirectory() as folder:
        one_dbc = Path(folder) / "car.dbc"  # cantools' command line takes one file
        whole = Database()
        for name in REVISIONS["2026"].dbc_files:
            whole.add_dbc_file(dbc_dir() / name)
        one_dbc.write_text(whole.as_dbc_string(), encoding="cp1252")
        ours = [sys.executable, "-m", "fsai_vcu.cli.main", "decode", str(log)]
        theirs = [sys.executable, "-m", "cantools", "decode", "--single-line", str(one_dbc)]
        output = Path(folder) / "decoded.txt"
        _best(1, lambda: _command(ours, log, Path(os.devnull)))  # what is remembered between runs is there from now on
        databases = load_databases()
        decoder = Decoder(databases)
        command_s = _best(repeats, lambda: _command(ours, log, Path(os.devnull)))
        command_json_s = _best(repeats, lambda: _command([*ours, "--json"], log, Path(os.devnull)))
        to_file_s = _best(repeats, lambda: _command(ours, log, output))
        lines_s = _best(repeats, lambda: _lines(databases, log))
        values_s = _best(repeats, lambda: decoder.tables(read_log(log)[0]))
        cantools_s = _best(repeats, lambda: _command(theirs, log, Path(os.devnull)))
    return Speed(
        len(read_log(log)[0]),
        cantools_s,
        command_s,
        command_json_s,
        to_file_s,
        lines_s,
        values_s,
        cantools_s / command_s,
        cantools_s / lines_s,
        cantools_s / values_s,
    )


def _best(repeats: int, work: Callable[[], object]) -> float:
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return min(times)


def _command(argv: Sequence[str], log: Path, output: Path) -> None:
    with log.open("rb") as source, output.open("wb") as sink:
        subprocess.run(argv, stdin=source, stdout=sink, check=True)


def _lines(databases: Databases, log: Path) -> None:
    """Every line that `decode` prints, by one process, without its start."""
    writer = LineWriter(Decoder(databases))
    with Path(os.devnull).open("wb") as sink, open_log(log) as opened:
        for frames in opened.chunks():
            sink.write(writer.block(frames))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fsai_vcu.diagnostics.decode.bench", description=speed.__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("--frames", type=int, default=200_000, help="of the log's beginning (default: 200000)")
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, args.log.open("rb") as whole:
        part = Path(folder) / "part.log"
        with part.open("wb") as out:
            for _, line in zip(range(args.frames), whole, strict=False):
                out.write(line)
        print(json.dumps({key: round(value, 4) for key, value in asdict(speed(part, args.repeats)).items()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
