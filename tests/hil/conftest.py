"""Fixtures of the hardware-in-the-loop suite: real processes on a real SocketCAN interface.

The suite is run by `fsai-vcu hil`, which provides the interface. Every test ends on a silent bus. A stall
monitor watches the machine: what fails while it stood still is run again, and that is reported
(`undisturbed.py`).
"""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import pytest

from fsai_hil.rehearsal.bus_watch import BusWatch, listeners
from fsai_hil.rehearsal.stack import RunningProcess, Stack, await_condition
from fsai_hil.rehearsal.stall_monitor import StallMonitor
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import CanBus, open_bus
from undisturbed import Undisturbed

LISTENS_S = 60.0
SILENCE_S = 0.25  # over twenty cycles of one who sends every 10 ms, and two of the slowest message
VERB = (sys.executable, "-m", "fsai_vcu.cli.main")
FRAMES = (  # one of each kind
    Frame(0x520, bytes.fromhex("21 1E 43 30 20 00 00 00")),
    Frame(0x510, bytes.fromhex("0100200000000000")),
    Frame(0x514, b"\x0a\xff"),
    Frame(0x080),
    Frame(0x18FF0001, b"\x7f", extended=True),
    Frame(0x123, extended=True, data=b"\x01\x02\x03"),
    Frame(0x523, bytes(6), remote=True),
)
STALL_MONITOR = pytest.StashKey[StallMonitor]()


def pytest_configure(config: pytest.Config) -> None:
    if "FSAI_CAN_INTERFACE" in os.environ and not config.option.collectonly:
        stall_monitor = StallMonitor(Path("/tmp") / f"fsai-stall-monitor-{os.getpid()}")
        config.add_cleanup(stall_monitor.stop)
        config.stash[STALL_MONITOR] = stall_monitor
        config.pluginmanager.register(Undisturbed(stall_monitor))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.timeout(0))  # the suite's own time limit holds
    if "FSAI_CAN_INTERFACE" not in os.environ:
        here = [item for item in items if Path(__file__).parent in item.path.parents]
        for item in here:
            item.add_marker(pytest.mark.skip(reason="needs a vcan0: run this suite with `fsai-vcu hil`"))


@pytest.fixture(scope="session")
def stall_monitor(pytestconfig: pytest.Config) -> StallMonitor:
    """Who watches the machine."""
    return pytestconfig.stash[STALL_MONITOR]


@pytest.fixture(scope="session")
def interface() -> str:
    """The SocketCAN interface that `fsai-vcu hil` made."""
    return os.environ["FSAI_CAN_INTERFACE"]


@pytest.fixture
def results(request: pytest.FixtureRequest) -> Path:
    """This test's own folder, kept after the run: logs of the processes, the bus log."""
    name = re.sub(r"[^\w.-]+", "_", request.node.name)
    return new_folder(name)


def new_folder(name: str) -> Path:
    """A folder for results, `name`, or `name-2` and so on where a test is run again."""
    for number in itertools.count(1):
        folder = Path(os.environ["FSAI_HIL_RESULTS"]) / (name if number == 1 else f"{name}-{number}")
        if not folder.exists():
            break
    folder.mkdir(parents=True)
    return folder


@pytest.fixture(autouse=True)
def silent_bus(interface: str) -> Iterator[None]:
    """Whatever the test started is off the bus afterwards."""
    yield
    with open_bus(interface) as bus:
        received = bus.recv(SILENCE_S)
    assert received is None, f"after the test somebody still sends on {interface}: {received}"


@pytest.fixture
def listen(interface: str) -> Iterator[Callable[..., CanBus]]:
    """Opens sockets on the bus, `listen(receive={0x520})` for some ids only; they are closed after the test."""
    opened: list[CanBus] = []

    def open_one(receive: set[int] | None = None) -> CanBus:
        opened.append(open_bus(interface, receive=receive))
        return opened[-1]

    yield open_one
    for bus in opened:
        bus.close()


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


@pytest.fixture
def other() -> Iterator[str]:
    """An interface of one's own, to be taken down."""
    ip("link", "add", "dev", "vcan3", "type", "vcan")
    try:
        ip("link", "set", "vcan3", "up")
        yield "vcan3"
    finally:
        ip("link", "del", "vcan3")


def logged(interface: str, folder: Path, only: Iterable[int] = ()) -> BusWatch:
    """The bus during a test; its log is in the end among the test's results."""
    return BusWatch(interface, Path("/tmp") / f"{folder.name}.bus.log", folder / "bus.log", only)


@pytest.fixture
def bus_log(interface: str, results: Path, silent_bus: None) -> Iterator[BusWatch]:
    log = logged(interface, results)
    yield log
    log.stop()


@pytest.fixture
def stack(interface: str, results: Path, bus_log: BusWatch) -> Iterator[Stack]:
    """Starts real processes on the bus, which is logged; whatever the test does, they are ended after it."""
    with Stack(interface, results) as running:
        yield running


def listening(interface: str, argv: Sequence[str], output: Path, errors: Path | None = None) -> RunningProcess:
    """A command that has begun to listen to the bus; what it prints is in `output`, its errors too or in `errors`."""
    others = listeners(interface)

    def one_more() -> bool:
        nonlocal others
        now = listeners(interface)
        others = min(others, now)  # one of an earlier test may still have been going
        return now > others

    with (errors or Path(os.devnull)).open("wb") as file:
        process = RunningProcess(argv[0], argv, output, os.environ, stderr=file if errors else subprocess.STDOUT)
    await_condition(one_more, LISTENS_S, f"{argv} listens")
    return process


@pytest.fixture
def verb() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs a verb of the command line to its end: `verb("mode", "autonomous")`."""

    def run(*arguments: str, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*VERB, *arguments], capture_output=True, text=True, timeout=timeout_s, check=False)

    return run
