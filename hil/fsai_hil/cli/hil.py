"""`fsai-vcu hil`: the hardware-in-the-loop suite on a real vcan0, native or in User-Mode Linux."""

from __future__ import annotations

import argparse
import compileall
import math
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from fsai_hil import CHECKOUT, vcan
from fsai_vcu.cli.main import UserError, WrongUse
from fsai_vcu.runtime.transport import loopback_environment

EXAMPLE = "fsai-vcu hil -k foreign_0x511"

_SUITE = Path("tests") / "hil"
_SOAK = _SUITE / "chain" / "test_soak.py"
_TIMEOUT_S = 600.0
_SOAKED = 1.5  # as long as the driving alone: power cycles, and missions that a disturbed machine makes worthless
_TIMEOUT_ALL_S = 3600.0
# User-Mode Linux has one processor, and five ROS 2 nodes and a car on it have no time to spare: it gets so many seconds
# of this machine for each second of work inside, and its idle time takes none.
_PACE = 3.0
# What of the caller's environment a run sees: enough to behave alike everywhere, and nothing that is nobody's business.
_PASSED_ON = ("PATH", "TERM", "TZ", "CI", "NO_COLOR", "FORCE_COLOR", "LD_LIBRARY_PATH")
_PASSED_ON_PREFIXES = ("LANG", "LC_", "FSAI_", "ROS_", "_ROS_", "PYTEST_", "PYTHON")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments; the unknown ones are pytest's."""
    parser.allow_abbrev = False
    parser.usage = (
        "%(prog)s [--all | --soak MINUTES] [--with NODE=PROGRAM] [--native | --uml] [--timeout S]"
        " [--results DIR] [pytest's arguments: -k, -x, a file …]"
    )
    extent = parser.add_mutually_exclusive_group()
    extent.add_argument("--all", action="store_true", help="also the long tests: every fault of every process")
    extent.add_argument(
        "--soak",
        type=float,
        metavar="MINUTES",
        help="instead: drive one mission after another for this time, and judge whether memory, file "
        "descriptors, threads and echo times stay as they were at first",
    )
    parser.add_argument(
        "--with",
        dest="own",
        action="append",
        default=[],
        metavar="NODE=PROGRAM",
        help="the part of the suite that drives, with a program of yours in the place of this node: FILE.py, MODULE or "
        "an executable; can be repeated",
    )
    add_place_arguments(parser)
    parser.add_argument(
        "--timeout",
        type=float,
        metavar="S",
        help=f"end the suite after this time, by the tests' clock ({_TIMEOUT_S:g}; with --all {_TIMEOUT_ALL_S:g}; "
        f"with --soak, {_SOAKED:g} times that on top)",
    )
    parser.add_argument(
        "--results", type=Path, metavar="DIR", help="where logs are kept (out/hil; with --soak out/soak)"
    )


def add_place_arguments(parser: argparse.ArgumentParser) -> None:
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--native", action="store_true", help="run on this kernel's vcan; fail where it has none")
    place.add_argument("--uml", action="store_true", help="in User-Mode Linux even where the kernel has vcan")


def parse(parser: argparse.ArgumentParser, argv: Sequence[str]) -> argparse.Namespace:
    """Options that are not ours are pytest's."""
    args, others = parser.parse_known_args(argv)
    args.pytest_args = others
    return args


def run(args: argparse.Namespace) -> int:
    """Run the suite on a vcan0, here or in User-Mode Linux; return the exit status."""
    timeout_s = args.timeout
    if timeout_s is None:
        timeout_s = _TIMEOUT_ALL_S if args.all else _TIMEOUT_S + _SOAKED * 60.0 * (args.soak or 0.0)
    if not 0.0 < timeout_s < math.inf:
        raise WrongUse(f"--timeout is {timeout_s:g}, but must be a time in seconds")
    if args.soak is not None and not args.soak > 0.0:
        raise WrongUse(f"--soak is {args.soak:g}, but must be a time in minutes")
    if not (CHECKOUT / _SUITE).is_dir():
        raise UserError(f"the suite is part of the source checkout, and {CHECKOUT} has no {_SUITE}")
    if find_spec("pytest") is None:
        raise UserError(f"the suite needs what tests need: make -C {CHECKOUT} setup-for-tests")
    own = [own_program(each) for each in args.own]
    if any(word.startswith("-") for word in args.pytest_args):
        _refuse_unknown(args)
    # A polite kill ends everything properly, as Ctrl-C does: the logs are still to be put into their place.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        place = prepared_place(args)
        print(f"fsai-vcu hil: {place.name} {vcan.INTERFACE}: {place.why}", flush=True)
        usual = CHECKOUT / "out" / ("hil" if args.soak is None else "soak")
        results = args.results.resolve() if args.results else usual
        if args.results is None and usual.exists():  # another folder must be its owner's care
            shutil.rmtree(usual)
        env = environment(os.environ, vcan.INTERFACE, place.name, results)
        if own:
            env["FSAI_HIL_WITH"] = ",".join(own)
        if args.all or args.soak:
            env["FSAI_LONG_TESTS"] = "1"
        if args.soak is not None:
            env["FSAI_HIL_SOAK_MINUTES"] = f"{args.soak:g}"
        pace = {"pace": _PACE} if place.has_pace else {}
        if pace:
            print(f"fsai-vcu hil: {_PACE:g} s of this machine for each second of work inside", flush=True)
        status = place.run(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *_selection(args)],
            cwd=CHECKOUT,
            env=env,
            timeout_s=(_PACE if pace else 1.0) * timeout_s,
            results_dir=results,
            **pace,
        )
    except vcan.VcanError as error:
        raise UserError(str(error)) from error
    finally:
        signal.signal(signal.SIGTERM, before)
    if status == 124:
        print(f"fsai-vcu hil: stopped: not finished after {timeout_s:g} s of the tests' clock", file=sys.stderr)
    if status:
        print(f"fsai-vcu hil: the logs of the processes are in {results}", file=sys.stderr)
    return status


def _refuse_unknown(args: argparse.Namespace) -> None:
    """Let pytest parse its options before a kernel is booted for it. Raises WrongUse."""
    words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--markers", *_selection(args)]
    parsed = subprocess.run(words, cwd=CHECKOUT, capture_output=True, text=True, check=False)
    if parsed.returncode:
        wrong = re.search(r"error: (.*)", parsed.stderr)
        raise WrongUse(wrong[1] if wrong else (parsed.stderr.strip().splitlines() or ["pytest refuses that"])[-1])


def own_program(given: str) -> str:
    """NODE=PROGRAM as the suite takes it, which runs in another folder. Raises WrongUse."""
    from fsai_hil.rehearsal.stack import NODES

    node, _, named = given.partition("=")
    if node not in NODES[1:] or not named:
        raise WrongUse(f"--with {given}: must be NODE=PROGRAM, with one of {', '.join(NODES[1:])}")
    if ("/" in named or named.endswith(".py")) and not Path(named).is_file():
        raise WrongUse(f"--with {given}: no such file")
    return f"{node}={Path(named).absolute() if Path(named).is_file() else named}"


def prepared_place(args: argparse.Namespace) -> vcan.VcanHost:
    """Return the place of the vcan0 that the arguments ask for, with everything compiled. Raises VcanError."""
    place = vcan.choose_place("native" if args.native else "uml" if args.uml else "auto")
    for package in ("fsai_vcu", "hil", "nodes"):
        # Inside, Python cannot keep what it compiles, and would compile it for each process again.
        compileall.compile_dir(CHECKOUT / package, quiet=2)
    return place


def _selection(args: argparse.Namespace) -> list[str]:
    """The arguments for pytest: the whole suite unless a part of it is named; with programs of others, what drives."""
    words: list[str] = args.pytest_args
    if args.soak is not None:
        return [str(_SOAK), "-s", *words]
    named = [word for word in words if not word.startswith("-") and Path(CHECKOUT, word.split("::")[0]).exists()]
    return [*words] if named else [str(_SUITE / "chain" if args.own else _SUITE), *words]


def environment(caller: Mapping[str, str], interface: str, place: str, results: Path) -> dict[str, str]:
    """Return the part of the caller's environment that a run with a vcan0 of its own sees, and its own variables."""
    passed_on = loopback_environment(
        {name: value for name, value in caller.items() if name in _PASSED_ON or name.startswith(_PASSED_ON_PREFIXES)}
    )
    if not sys.stdout.isatty():
        # The console of User-Mode Linux is a terminal even where ours is a file.
        passed_on.setdefault("NO_COLOR", "1")
    return {
        **passed_on,
        "COLUMNS": str(shutil.get_terminal_size().columns),
        "HOME": "/tmp",  # the only place for caches that is writable in User-Mode Linux too
        "FSAI_CAN_INTERFACE": interface,
        "FSAI_HIL_PLACE": place,
        "FSAI_HIL_RESULTS": str(results),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONUNBUFFERED": "1",
        "ROS_LOG_DIR": str(results / "ros"),
    }
