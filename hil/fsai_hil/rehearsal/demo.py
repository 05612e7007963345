"""`make demo`: one mission with the real nodes, each its own process, against the simulated car; then the verdict.

On vcan0 where this kernel has one, otherwise on the loopback stand-in. It follows the run as any script of a team
could: over ROS topics, the /set_mode service and the /run_mission action. Everything it leaves behind is in one folder.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fsai_hil.rehearsal.ros_operator import RosOperator
from fsai_hil.rehearsal.stack import NODES, PLOT, VERDICT, Stack, StackError, simulated_car, words_of
from fsai_hil.rehearsal.stall_monitor import BUSY_NS, StallMonitor, on_wall_clock
from fsai_hil.rules.checker import WireChecker, check_candump
from fsai_hil.simulator.setup_arguments import add_setup_arguments, setup_of
from fsai_hil.simulator.world import World
from fsai_hil.vcan.native import INTERFACE, existing_vcan, namespace_prefix, run_natively
from fsai_vcu.diagnostics.log.recorded import note_stalls
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.revisions import revision

MISSION = "autocross"
REPLACEABLE = NODES[1:]  # the bridge is what all others stand in front of
WITH_HELP = "start a node of yours as well, with its arguments in the same text; may be given more than once"
START_TIMEOUT_S = 180.0
RUN_TIMEOUT_S = 1200.0
VERDICT_TIMEOUT_S = 180.0  # matplotlib, the first time that it is imported, on a busy machine
PROGRESS_PERIOD_S = 1.0
SAVED = ("bus.log", PLOT, VERDICT)


def main() -> int:
    """0: the judge says pass and the bus log is clean; 1: not; 130: interrupted."""
    parser = argparse.ArgumentParser(prog="fsai_hil.rehearsal.demo", description=__doc__.splitlines()[0])
    add_setup_arguments(parser, MISSION)
    parser.add_argument("--bus", help="default: vcan0 where this kernel has it, else loopback:NAME")
    parser.add_argument("--own-vcan", action="store_true", help=argparse.SUPPRESS)  # it runs in a network of its own
    out = "folder for logs, plot and verdict (default: out/demo, of a run with nodes of yours out/demo-NAME)"
    parser.add_argument("--out", type=Path, help=out)
    parser.add_argument("--no-gps", action="store_true", help="a car without the PCAN-GPS")
    parser.add_argument("--without", default="", metavar="NODE,...", help=f"leave out, of {', '.join(REPLACEABLE)}")
    parser.add_argument("--with", dest="others", action="append", default=[], metavar="FILE.py|MODULE", help=WITH_HELP)
    args = parser.parse_args()
    args.mission = args.mission or MISSION
    args.without = [name.strip() for name in args.without.split(",") if name.strip()]
    if unknown := [name for name in args.without if name not in REPLACEABLE]:
        parser.error(f"--without {unknown[0]}: choose of {', '.join(REPLACEABLE)}")
    for other in args.others:
        try:
            named = words_of(other)[0]
        except (ValueError, IndexError):
            parser.error(f"--with '{other}': no program")
        if named.endswith(".py") and not Path(named).is_file():
            parser.error(f"--with {named}: no such file")
    if args.out is None:  # a run with other nodes leaves the demo's results as they are
        replaced = [Path(words_of(other)[0]).stem for other in args.others] or args.without
        args.out = Path("out", "-".join(["demo", *replaced]))
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a polite kill ends the rehearsal as Ctrl-C does
    try:
        # What would only fail once everything is running.
        World(setup_of(args, [args.mission]))
        args.out.mkdir(parents=True, exist_ok=True)
    except (ValueError, OSError) as error:
        text = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.filename else str(error)
        print(f"demo: {text}", file=sys.stderr)
        return 1
    inside = _in_own_vcan(args)
    if inside is not None:
        return inside
    try:
        return rehearse(lambda: drive(args), args.out)
    except KeyboardInterrupt:
        print("demo: interrupted; every process has been ended", file=sys.stderr)
        return 130


def rehearse(run: Callable[[], int], out: Path) -> int:
    """The exit status of `run`, which leaves its log in `out`; on a disturbed machine one that failed is repeated."""
    with tempfile.TemporaryDirectory(prefix="fsai-demo-") as folder, StallMonitor(Path(folder) / "stalls") as monitor:
        for last in (False, True):
            since_ns = time.monotonic_ns()
            try:
                status = run()
            except StackError as error:
                print(f"demo: {error}", file=sys.stderr)
                status = 1
            note_stalls(out, on_wall_clock(monitor.stalls(since_ns, BUSY_NS)))
            what = monitor.disturbed(since_ns) if status else ""
            if not what:
                break
            then = "this time too: no run was undisturbed" if last else "that run shows nothing, once more"
            _say(f"\nthis machine {what} meanwhile, and the car and its bridge with it: {then}")
        return status


def _in_own_vcan(args: argparse.Namespace) -> int | None:
    """Run the demo again where it has a vcan0 of its own, if the kernel can give it one; None to go on here."""
    if args.bus is not None or existing_vcan() or namespace_prefix() is None:
        return None
    return run_natively(
        [sys.executable, "-m", "fsai_hil.rehearsal.demo", "--own-vcan", *sys.argv[1:]],
        cwd=Path.cwd(),
        env=os.environ,
        timeout_s=RUN_TIMEOUT_S,
        results_dir=args.out,
    )


def drive(args: argparse.Namespace) -> int:
    """One rehearsal, from the start of the processes to the verdict."""
    bus = args.bus or (INTERFACE if existing_vcan() else f"loopback:demo-{os.getpid()}")
    for name in (*SAVED, "bus.json", *(f"{node}.log" for node in (*NODES, "vcu", "recorder"))):
        (args.out / name).unlink(missing_ok=True)
    log, plot, verdict = (args.out / name for name in SAVED)
    with Stack(bus, args.out) as stack:
        kind = " (stand-in: this kernel has no vcan)" if args.bus is None and bus != INTERFACE else ""
        _say(f"bus {bus}{kind}, ROS domain {stack.domain_id}, logs in {args.out}")
        verb = os.path.relpath(Path(sys.executable).with_name("fsai-vcu"))
        if args.own_vcan:
            python = os.path.relpath(sys.executable)
            other = f"{python} -m fsai_hil.rehearsal.demo --bus loopback:demo"
            _say(f"watch it: this vcan0 is the demo's own and not to be reached; can be watched: {other}")
        else:
            _say(f"watch it: ROS_DOMAIN_ID={stack.domain_id} {verb} pitwall {bus} --ros")
        stack.start_verb("recorder", "record", "-i", bus, "-o", str(log))
        car = {"car": args.revision}
        laps = {} if args.laps is None else {"laps": args.laps}
        nodes = stack.start_nodes(
            {"vcu_bridge": {"revision": args.revision, **car}, "path_planner": car | laps, "vehicle_controller": car},
            args.without,
            args.others,
        )
        _say(f"started {', '.join(nodes)}, each its own process")
        operator = RosOperator(stack, "demo")
        try:
            operator.await_bridge(START_TIMEOUT_S)
            options = {name: getattr(args, name) for name in ("mission", "revision", "seed", "laps", "track")}
            options |= {"result": verdict, "plot": plot, "no-gps": args.no_gps}
            vcu = stack.start_verb("vcu", *simulated_car(bus, stack.truth_port, options))
            accepted = operator.become_autonomous(
                START_TIMEOUT_S, lambda why: _say(f"set_mode: {why}; asking again"), "vcu"
            )
            _say(f"set_mode: {accepted}")
            result = operator.run_mission(args.mission, "end", RUN_TIMEOUT_S, RunPrinter().show, *nodes)
            _say(f"run_mission: {result.message}")
        finally:
            operator.close()
        status = vcu.wait(VERDICT_TIMEOUT_S)
    try:
        judged = json.loads(verdict.read_text())
    except (OSError, ValueError) as error:
        raise StackError(f"the simulated car left no verdict; see {args.out / 'vcu.log'}") from error
    wire = check_candump(log, Codec(revision(args.revision)), busy_machine=True)
    _report(judged, wire)
    print(f"saved      {log}, {plot}, {verdict}")
    print(f"report     {verb} report {log} -o {args.out / 'report.html'}")
    return 0 if status == 0 and wire.ok else 1


def _report(verdict: dict[str, Any], wire: WireChecker) -> None:
    """The judge's verdict and what the bus log shows, for a person."""
    laps = ", ".join(f"{lap_s:.2f} s" for lap_s in verdict["lap_times_s"])
    lines = [
        ("judge", f"{verdict['mission']}: {verdict['result'].upper()}"),
        *(("", reason) for reason in verdict["reasons"]),
        ("laps", f"{verdict['laps']}" + (f" ({laps})" if laps else "")),
        ("speed", f"mean {verdict['mean_speed_mps']:.1f} m/s, top {verdict['top_speed_mps']:.1f} m/s"),
        ("cones hit", f"{verdict['cones_hit']}, off course {verdict['off_course']}"),
    ]
    if (handshake := verdict["handshake"]).get("echoes"):
        figures = ((name, handshake[key]) for name, key in (("p50", "median_ms"), ("p99", "p99_ms"), ("max", "max_ms")))
        words = ", ".join(f"{name} {time_ms:.2f} ms" for name, time_ms in figures)
        lines.append(("handshake", f"{handshake['echoes']} echoes, response {words}"))
    lines.append(("bus log", f"{wire.frames} frames, {'every rule kept' if wire.ok else 'RULES BROKEN:'}"))
    lines += [("", violation) for violation in wire.violations[:20]]
    print("", *(f"{name:<10} {text}" for name, text in lines), sep="\n")


class RunPrinter:
    """Prints the run as it goes: one line a second, and one whenever the AS state changes."""

    def __init__(self) -> None:
        self._label = ""
        self._shown_s = 0.0

    def show(self, seen: Any) -> None:
        now_s = time.monotonic()
        if seen.as_state_label == self._label and now_s - self._shown_s < PROGRESS_PERIOD_S:
            return
        self._label, self._shown_s = seen.as_state_label, now_s
        why = f"  {seen.why_not_driving[0]}" if seen.why_not_driving else ""
        _say(
            f"{seen.as_state_label:<15} {seen.mode:<10} lap {seen.lap}  {seen.speed_mps:4.1f} m/s  "
            f"{seen.distance_m:6.1f} m{why}"
        )


def _say(text: str) -> None:
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
