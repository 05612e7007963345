"""`fsai-vcu record`: what is on a bus, on the disk within a second, for as long as it takes."""

from __future__ import annotations

import argparse
import hashlib
import platform
import re
import signal
import sys
import time
from contextlib import closing, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from fsai_vcu.arguments import add_bus_argument, check_numbers
from fsai_vcu.cli.decoding import Decoding, add_database_arguments
from fsai_vcu.cli.ending import ending
from fsai_vcu.cli.main import main
from fsai_vcu.cli.services import nodes_module, ros_errors
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.export.writing import check_format
from fsai_vcu.diagnostics.log.live import Listener
from fsai_vcu.diagnostics.log.recorded import lost_words
from fsai_vcu.diagnostics.recorder.recording import Recording
from fsai_vcu.diagnostics.recorder.segments import Bounds, SegmentFolder
from fsai_vcu.files import is_folder
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.interface.revisions import revision
from fsai_vcu.printable import printable
from fsai_vcu.runtime.configuration import USUAL_PATH, Configuration, read_configuration
from fsai_vcu.runtime.limits_file import limits_in, read_limits_text

EXAMPLE = (
    "fsai-vcu record can0 -o /var/log/fsai --max-total 8G --mcap --limits limits.toml\n"
    "  fsai-vcu record vcan0 -o run.log --seconds 60\n"
    "  fsai-vcu record --service --config /etc/fsai/fsai.toml"
)
_LOOK_S: Final = 0.1
_TURN_NS: Final = 500_000_000  # with the time that the disk takes, at most a second is ever not on it
_BOUNDS: Final = {  # of a folder: default, metavar, help
    "segment_size": ("64M", "SIZE", "begin a new segment at this size"),
    "segment_time": ("10min", "TIME", "… or after this time: 30s, 10min, 1h"),
    "max_total": ("4G", "SIZE", "most space for all segments; the oldest are deleted"),
}
_SIZES: Final = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_TIMES_S: Final = {"s": 1, "min": 60, "h": 3600}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: bus, output, the bounds of a recording, and what is recorded besides frames."""
    add = parser.add_argument
    add_bus_argument(parser)
    add(
        "-o",
        "--output",
        type=Path,
        metavar="FOLDER|FILE",
        help="a folder: numbered segments of limited size, continued after a restart; a file (run.log): one candump "
        "log, which must not exist yet, and run.json about it",
    )
    add("--service", action="store_true", help="record as the recording service does, as the car's configuration says")
    add("--config", type=Path, metavar="FILE", help="with --service: the configuration (default: /etc/fsai/fsai.toml)")
    add("--seconds", type=float, metavar="S", help="stop after S seconds (default: until Ctrl-C)")
    add("--mcap", action="store_true", help="beside each log an MCAP with every signal decoded")
    add("--ros", action="store_true", help="in the MCAP also the ROS messages of the running nodes (goes with --mcap)")
    add("--topic", action="append", default=[], metavar="NAME", help="with --ros: this topic too; can be repeated")
    add("--namespace", metavar="NS", help="with --ros: the nodes' ROS namespace, such as /car1")
    for option, (default, metavar, words) in _BOUNDS.items():
        add(f"--{option.replace('_', '-')}", metavar=metavar, help=f"{words} (default: {default})")
    add("--keep-free", default="256M", metavar="SIZE", help="leave this much of the disk free (default: 256M)")
    add(
        "--patient",
        action="store_true",
        help="while nothing can be written, try again every second, as the service does",
    )
    add(
        "--limits",
        type=Path,
        metavar="FILE.toml",
        help="operational limits in force: their content is kept beside the log",
    )
    add_database_arguments(parser, "2026")


def run(args: argparse.Namespace) -> int:
    """Check the arguments, then record the bus until the time is up or the end is asked for."""
    if args.service:
        return _as_configured(args.config or USUAL_PATH, args.interface)
    if args.config is not None:
        raise WrongUse("--config goes with --service")
    for missing, value in (("the bus", args.interface), ("-o", args.output)):
        if value is None:
            raise WrongUse(f"{missing} is missing: fsai-vcu record can0 -o run.log")
    check_numbers(args, seconds=0.0)
    if args.ros and not args.mcap:
        raise WrongUse("--ros goes with --mcap: a candump log has no place for ROS messages")
    for option in ("topic", "namespace"):
        if getattr(args, option) and not args.ros:
            raise WrongUse(f"--{option} goes with --ros")
    about = _about(args)
    decoder = None
    if args.mcap:
        check_format("mcap")
        decoder = Decoding("record", args).decoder
    bounds = _bounds(args)
    topics = _topics(args)
    listener = Listener(args.interface, waits=True)
    listener.start()
    with closing(listener), ending() as asked:  # before there is a file: who sees one may ask for the end
        begun = _begun(args, listener.name, about, bounds, decoder, asked)
        if begun is None:
            return 1
        place, recording = begun
        if topics is not None:
            topics.start()
        if args.seconds is None and sys.stderr.isatty():
            _say(f"listening to {listener.name} until Ctrl-C")
        until_ns = float("inf") if args.seconds is None else time.monotonic_ns() + args.seconds * 1e9
        _record(listener, topics, recording, until_ns, asked)
    if topics is not None:
        topics.stop()
    _take(listener, topics, recording)
    recording.close(time.monotonic_ns())
    half = topics is not None and topics.error is not None
    return _result(args, listener, recording, place, stopped=signal.SIGTERM in asked) or int(half)


def _as_configured(path: Path, interface: str | None) -> int:
    """Record as the service does. interface: replaces the configuration's."""
    configuration = read_configuration(path)
    for line in configuration.limits_described():
        print(f"operational limits: {line}", file=sys.stderr, flush=True)
    return main(["record", *record_arguments(configuration, interface or configuration.interface)])


def record_arguments(configuration: Configuration, interface: str) -> list[str]:
    """The configuration's [recording] as arguments."""
    return [
        interface,
        "-o",
        configuration.text("recording", "folder"),
        "--patient",
        "--max-total",
        f"{configuration.text('recording', 'keep_mib')}M",
        "--keep-free",
        f"{configuration.text('recording', 'leave_free_mib')}M",
        "--revision",
        configuration.revision,
        *(word for file in configuration.dbc_files for word in ("--dbc", file)),
        *(("--limits", str(configuration.limits_path)) if configuration.limits_path is not None else ()),
    ]


def _begun(
    args: argparse.Namespace,
    bus: str,
    about: dict[str, Any],
    bounds: Bounds,
    decoder: Decoder | None,
    asked: list[int],
) -> tuple[SegmentFolder, Recording] | None:
    """Open the folder and its recording; None where the end was asked for before anything could be written. Raises
    UserError.
    """
    told = False
    while not asked:
        try:
            place = SegmentFolder(args.output, bus, bounds)
            try:
                now_ns = time.monotonic_ns()
                recording = Recording(place, bus, about, _say, decoder=decoder, wall_ns=time.time_ns, now_ns=now_ns)
            except OSError:
                place.close()
                raise
        except OSError as error:
            why = f"cannot write {args.output}: {error.strerror or error}"
            if not args.patient:
                raise UserError(why) from error
            if not told:
                _say(f"{why}; trying again every second")
            told = True
            for _ in range(round(1 / _LOOK_S)):
                if not asked:
                    time.sleep(_LOOK_S)
        else:
            if told:
                _say(f"writing in {args.output}")
            return place, recording
    return None


def _record(listener: Listener, topics: Any | None, recording: Recording, until_ns: float, asked: list[int]) -> None:
    """Record until the time is up or the end is asked for."""
    turn_ns = time.monotonic_ns()
    told = 0  # of the frames that were lost
    while not asked and time.monotonic_ns() < until_ns:
        time.sleep(_LOOK_S)
        now_ns = time.monotonic_ns()
        for news in [*listener.news(), *(topics.news() if topics is not None else ())]:
            _say(news)
        if now_ns - turn_ns >= _TURN_NS:
            turn_ns = now_ns
            _take(listener, topics, recording)
            recording.turn(now_ns)
            if listener.dropped > 2 * told:  # not a line each time while it goes on
                told = listener.dropped
                _say(lost_words(told))


def _take(listener: Listener, topics: Any | None, recording: Recording) -> None:
    """Hand everything that was received since the last call to the recording."""
    recording.take(listener.fetch())
    recording.dropped = listener.dropped
    if topics is not None:
        recording.take_messages(topics.fetch())


def _result(
    args: argparse.Namespace, listener: Listener, recording: Recording, place: SegmentFolder, *, stopped: bool
) -> int:
    """The exit status. stopped: by the service manager, for which a car that was never on is no failure."""
    lost = recording.lost + listener.overrun
    where = f"{args.output}, up to segment {place.number}" if place.number else f"{args.output}"
    ros = f" and {recording.messages} ROS messages" if args.ros else ""
    silent = not (recording.taken or recording.messages or lost)
    made = bool(place.number) or not silent  # an empty log would only keep the next recording from its name
    if made:
        beside = "" if place.number else f", about it in {place.file('.json')}"
        print(f"{recording.taken} frames{ros} in {where}{beside}", file=sys.stderr)
    if lost:
        _say(f"{lost} frames were received and are not on the disk")
    if listener.dropped:
        _say(lost_words(listener.dropped))
    if silent:
        _say(f"nothing was received on {args.interface}" + ("" if made else f": {args.output} was not made"))
        if not made:
            place.delete()
    return 1 if lost or listener.dropped or recording.in_trouble or (silent and not stopped) else 0


def _say(text: str) -> None:
    with suppress(OSError):  # stderr may be a file on the very disk that is full
        print(f"fsai-vcu record: {text}", file=sys.stderr, flush=True)


# ------------------------------------------------------------ arguments


def _bounds(args: argparse.Namespace) -> Bounds:
    keep_free = _size(args.keep_free, "--keep-free")
    given = {option: getattr(args, option) for option in _BOUNDS}
    if args.output.suffix != "" and not is_folder(args.output):
        for option in (option for option, text in given.items() if text is not None):
            raise WrongUse(f"--{option.replace('_', '-')} goes with a folder, but {args.output} is a file")
        return Bounds(keep_free_bytes=keep_free)
    size, duration, total = (given[option] or default for option, (default, _, _) in _BOUNDS.items())
    most = _size(total, "--max-total")
    if most < 1 << 20:
        raise WrongUse(f"--max-total is {total}, but must be at least 1M")
    return Bounds(max(1, _size(size, "--segment-size")), _time_ns(duration, "--segment-time"), most, keep_free)


def _size(text: str, option: str) -> int:
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if not found:
        raise WrongUse(f"{option} is '{text}', not a size like 64M or 4G")
    return int(float(found[1]) * _SIZES[found[2].upper()])


def _time_ns(text: str, option: str) -> int:
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|min|h)", text.strip())
    if not found or float(found[1]) <= 0.0:
        raise WrongUse(f"{option} is '{text}', not a time like 30s, 10min or 1h")
    return int(float(found[1]) * _TIMES_S[found[2]] * 1e9)


def _about(args: argparse.Namespace) -> dict[str, Any]:
    """Return the facts that belong to a log without being a frame."""
    try:
        about: dict[str, Any] = {
            "made_by": f"fsai-vcu {version('fsai-vcu')}",
            "host": platform.node(),
            "interface": args.interface,
            "revision": revision(args.revision).name,
            "databases": [printable(str(path)) for path in args.dbc],
            "operational_limits": None,
        }
        if args.limits is not None:
            content = read_limits_text(args.limits)
            about["operational_limits"] = {
                "in_force": list(limits_in(content, args.limits).described()),
                "content": content,
                "sha256": hashlib.sha256(content.encode()).hexdigest(),
                "file": printable(str(args.limits)),
            }
    except ValueError as error:
        raise UserError(str(error)) from error
    return about


def _topics(args: argparse.Namespace) -> Any | None:
    """Receives what the nodes publish; None where that is not asked for."""
    if not args.ros:
        return None
    recorder = nodes_module("recorder")
    with ros_errors():
        return recorder.TopicRecorder((*recorder.PROJECT_TOPICS, *args.topic), args.namespace or "/")
