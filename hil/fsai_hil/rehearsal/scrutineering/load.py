"""The load that keeps a machine and a bus busy: as processes of their own, at normal priority.

`python -m fsai_hil.rehearsal.scrutineering.load processor`, `… memory BYTES`, `… disk FILE`, `… file FILE` and
`… viewers PORT` are such processes.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import re
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from selectors import EVENT_READ, DefaultSelector
from typing import Final

from fsai_hil.rehearsal.scrutineering.conditions import Load, LoadCondition
from fsai_hil.rehearsal.stack import Stack, StackError
from fsai_vcu.interface.bus_table import BUS_TABLE, Flow

BUS_BITS_PER_S: Final = 500_000  # the car's bus
FRAME_BITS: Final = 47  # of a data frame with an 11-bit identifier, with the pause after it and without stuff bits
FILL_ID: Final = 0x7E0  # nobody's on the car, and not received by bridge or simulated car
FILL_BYTES: Final = 8
FILL_BURST: Final = 16  # frames a wake-up: sleeping for a single one takes longer than the frame on a real bus
BLOCK_BYTES: Final = 1 << 18
BLOCKS: Final = 256  # then from the start of the file again
UNFORCED_PAUSE_S: Final = 0.01
MEMORY_SHARE: Final = 0.6  # of what is available: nobody is to be ended for want of memory
MEMORY_MOST_BYTES: Final = 4 << 30
VIEWERS: Final = 10
BUSY: Final = "load: at work"
_START_S = 60.0
_PIT_WALL_START_S = 120.0  # it imports ROS, on one slow processor
_SIMULATED = (Flow.TO_VCU, Flow.FROM_VCU, Flow.FROM_SENSOR)


class LoadNotStarted(StackError):
    """A load does not work in time: beside this stack its process gets too little of the machine."""


def frame_bits(length: int) -> int:
    """Return the bits of one frame with `length` bytes, without the stuff bits, which depend on the content."""
    return FRAME_BITS + 8 * length


def car_bits_per_s(revision: str, gps_decimation: int = 1, log_decimation: int = 1) -> float:
    """Return what bridge, simulated VCU, PCAN-GPS and the remote's receiver put on the bus."""
    bits = 0.0
    for row in BUS_TABLE:
        if (row.flow in _SIMULATED or row.name == "RES_TPDO") and revision in row.period_ns:
            logged = row.flow is Flow.FROM_VCU and row.timeout_ns is None
            thinned = gps_decimation if row.flow is Flow.FROM_SENSOR else log_decimation if logged else 1
            bits += frame_bits(row.dlc) * 1e9 / (row.period_ns[revision] * thinned)
    return bits


def fill_frames_per_s(car_bits: float) -> float:
    """Frames that are missing to a full bus."""
    return max(0.0, BUS_BITS_PER_S - car_bits) / frame_bits(FILL_BYTES)


@contextmanager
def loaded(
    stack: Stack, condition: LoadCondition, disk_file: Path, car_bits: float, *, force_disk: bool = True
) -> Iterator[None]:
    """The condition's load, while inside; returns once it works.

    Raises LoadNotStarted when it does not work in time, StackError when it ends while it should work.

    force_disk: each block is forced onto the disk. (In User-Mode Linux that stops the whole inner kernel meanwhile.)
    """
    names: list[str] = []

    def start(kind: str, *argv: str) -> None:
        names.append(f"load-{len(names) + 1}-{kind}-{condition.name}")
        stack.start(names[-1], argv)

    def await_last(words: str, most_s: float = _START_S) -> None:
        try:
            stack.processes[names[-1]].await_log(words, most_s)
        except StackError as error:
            raise LoadNotStarted(str(error)) from error

    try:
        own = (sys.executable, "-m", __name__)
        # The processors come last: beside them a process that has yet to import its modules does not get far.
        if Load.MEMORY in condition.load:
            start("memory", *own, "memory", str(MEMORY_MOST_BYTES))
            await_last(BUSY)
        if Load.DISK in condition.load:
            start("disk", *own, "disk" if force_disk else "file", str(disk_file))
            await_last(BUSY)
        if {Load.PIT_WALL, Load.PIT_WALL_ROS} & {*condition.load}:
            ros = ["--ros"] if Load.PIT_WALL_ROS in condition.load else []
            start("pitwall", sys.executable, "-m", "fsai_vcu.cli.main", "pitwall", stack.bus, "--port", "0", *ros)
            await_last(" shows ", _PIT_WALL_START_S)
            (port,) = re.findall(r":(\d+) shows ", stack.processes[names[-1]].log())
            start("viewers", *own, "viewers", port)
            await_last(BUSY)
        if Load.BUS in condition.load and (rate := fill_frames_per_s(car_bits)):
            gap_ms = f"{1000.0 * FILL_BURST / rate:.4f}"
            what = ("-I", f"{FILL_ID:X}", "-L", str(FILL_BYTES), "-D", "A5" * FILL_BYTES)
            start("bus", "cangen", stack.bus, "-g", gap_ms, "-c", str(FILL_BURST), *what, "-i")
        if Load.PROCESSORS in condition.load:
            for _ in range(os.cpu_count() or 1):
                start("processor", *own, "processor")
                await_last(BUSY)
        stack.check_alive(*names)
        yield
        stack.check_alive(*names)
    finally:
        for name in names:
            stack.processes.pop(name).stop()
        disk_file.unlink(missing_ok=True)


# ---------------------------------------------------------------- the processes


def keep_processor_busy() -> None:
    print(BUSY, flush=True)
    number = 0
    while True:
        number = (number * 1_103_515_245 + 12_345) % 2_147_483_648


def keep_memory_busy(most_bytes: int) -> None:
    """Take the share, but no more than so much, write to each of its pages twice, give it back, over and over."""
    # Should memory run out all the same, it is this process that the kernel ends, and the measurement reports it.
    Path("/proc/self/oom_score_adj").write_text("1000")
    (available_kib,) = re.findall(r"^MemAvailable:\s*(\d+)", Path("/proc/meminfo").read_text(), re.MULTILINE)
    pages = int(min(MEMORY_SHARE * 1024 * int(available_kib), most_bytes)) // mmap.PAGESIZE
    print(BUSY, flush=True)
    while True:
        with mmap.mmap(-1, pages * mmap.PAGESIZE) as memory:
            for value in (b"\1", b"\2"):
                memory[:: mmap.PAGESIZE] = value * pages


def keep_disk_busy(path: Path, force: bool) -> None:
    """Write blocks over and over: forced onto the disk itself one by one, or left to the page cache, 25 MB a second."""
    block = os.urandom(BLOCK_BYTES)
    with path.open("wb", buffering=0) as file:
        file.write(block)
        print(BUSY, flush=True)
        while True:
            file.seek(0)
            for _ in range(BLOCKS):
                file.write(block)
                if force:
                    os.fsync(file.fileno())
                else:
                    time.sleep(UNFORCED_PAUSE_S)


def watch_pit_wall(port: int) -> None:
    """Read the pit wall as viewers of the page do: each takes all that its stream of events gives."""
    with contextlib.ExitStack() as ending, DefaultSelector() as selector:
        for _ in range(VIEWERS):
            viewer = ending.enter_context(socket.create_connection(("127.0.0.1", port)))
            viewer.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
            selector.register(viewer, EVENT_READ, viewer)
        waiting = {key.data for key in selector.get_map().values()}
        while True:
            for key, _ in selector.select():
                if not key.data.recv(1 << 16):
                    sys.exit("load: the pit wall has ended")
                if waiting and not (waiting := waiting - {key.data}):
                    print(BUSY, flush=True)


def main(argv: list[str]) -> None:
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        if argv[0] == "processor":
            keep_processor_busy()
        elif argv[0] == "memory":
            keep_memory_busy(int(argv[1]))
        elif argv[0] == "viewers":
            watch_pit_wall(int(argv[1]))
        else:
            keep_disk_busy(Path(argv[1]), force=argv[0] == "disk")


if __name__ == "__main__":
    main(sys.argv[1:])
