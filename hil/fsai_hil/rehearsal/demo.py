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
from fsai_hil.rehearsal.stack import NODES, Stack, StackError
from fsai_hil.rehearsal.stall_monitor import StallMonitor, describe
from fsai_hil.rules.checker import check_candump
from fsai_hil.simulator.setup_arguments import add_setup_arguments, setup_of
from fsai_hil.simulator.world import World
from fsai_hil.vcan import INTERFACE
from fsai_hil.vcan.native import existing_vcan, namespace_prefix
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.revisions import revision

MISSION = "autocross"
START_TIMEOUT_S = 60.0
RUN_TIMEOUT_S = 1200.0
VERDICT_TIMEOUT_S = 15.0
PROGRESS_PERIOD_S = 1.0
_INSIDE = "FSAI_DEMO_INSIDE"  # set in the process that already has its own vcan0


def main() -> int:
    """0: the judge says pass and the bus log is clean; 1: not; 130: interrupted."""
    parser = argparse.ArgumentParser(prog="fsai_hil.rehearsal.demo", description=__doc__.splitlines()[0])
    add_setup_arguments(parser, MISSION)
    parser.add_argument("--bus", help="default: vcan0 where this kernel has it, else loopback:NAME")
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for logs, plot and verdict")
    args = parser.parse_args()
    args.mission = args.mission or MISSION
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a polite kill ends the rehearsal as Ctrl-C does
    try:
        _check(args)
    except (ValueError, OSError) as error:
        text = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.filename else str(error)
        print(f"demo: {text}", file=sys.stderr)
        return 1
    inside = _in_own_vcan(args)
    if inside is not None:
        return inside
    try:
        return rehearse(lambda: Demo(args).run())
    except KeyboardInterrupt:
        print("demo: interrupted; every process has been ended", file=sys.stderr)
        return 130


def rehearse(drive: Callable[[], int]) -> int:
    """The exit status of `drive`; it drives once more if it failed on a disturbed machine."""
    with tempfile.TemporaryDirectory(prefix="fsai-demo-") as folder, StallMonitor(Path(folder) / "stalls") as monitor:
        for again in (True, False):
            since_ns = time.monotonic_ns()
            try:
                status = drive()
            except StackError as error:
                print(f"demo: {error}", file=sys.stderr)
                status = 1
            disturbances = monitor.disturbances(since_ns) if status else []
            if not disturbances:
                break
            what = f"this machine {describe(disturbances)} meanwhile, and the car and its bridge with it"
            _say(
                f"\n{what}: that run shows nothing, once more"
                if again
                else f"\n{what}, this time too: no run was undisturbed"
            )
        return status


def _check(args: argparse.Namespace) -> None:
    """Raises ValueError or OSError for what would only fail once everything is running."""
    World(setup_of(args, [args.mission]))
    args.out.mkdir(parents=True, exist_ok=True)


def _in_own_vcan(args: argparse.Namespace) -> int | None:
    """Run the demo again where it has a vcan0 of its own, if the kernel can give it one; None to go on here."""
    if args.bus is not None or os.environ.get(_INSIDE) or existing_vcan() or namespace_prefix() is None:
        return None
    from fsai_hil.vcan import run_natively

    return run_natively(
        [sys.executable, "-m", "fsai_hil.rehearsal.demo", *sys.argv[1:]],
        cwd=Path.cwd(),
        env={**os.environ, _INSIDE: "1"},
        timeout_s=RUN_TIMEOUT_S,
        results_dir=args.out,
    )


class Demo:
    """One rehearsal, from the start of the processes to the verdict."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        on_vcan = existing_vcan() or bool(os.environ.get(_INSIDE))
        self._bus = args.bus or (INTERFACE if on_vcan else f"loopback:demo-{os.getpid()}")
        for name in ("bus.log", "verdict.json", "run.png", *(f"{node}.log" for node in (*NODES, "vcu", "recorder"))):
            (args.out / name).unlink(missing_ok=True)
        self._stack = Stack(self._bus, args.out)
        self._log = args.out / "bus.log"
        self._verdict = args.out / "verdict.json"
        self._plot = args.out / "run.png"

    def run(self) -> int:
        args = self._args
        kind = " (stand-in: this kernel has no vcan)" if args.bus is None and self._bus != INTERFACE else ""
        _say(f"bus {self._bus}{kind}, ROS domain {self._stack.domain_id}, logs in {args.out}")
        with self._stack as stack:
            _say(f"starting {', '.join(NODES)}, each its own process")
            stack.start_verb("recorder", "record", "-i", self._bus, "-o", str(self._log))
            stack.start_nodes(_node_parameters(args))
            operator = RosOperator(stack, "demo")
            try:
                operator.await_bridge(START_TIMEOUT_S)
                vcu = stack.start_verb("vcu", *self._vcu_arguments())
                _say(f"set_mode: {operator.become_autonomous(START_TIMEOUT_S, _say, 'vcu')}")
                result = operator.run_mission(args.mission, "end", RUN_TIMEOUT_S, RunPrinter().show, *NODES)
                _say(f"run_mission: {result.message}")
            finally:
                operator.close()
            status = vcu.wait(VERDICT_TIMEOUT_S)
        return self._report(status)

    def _vcu_arguments(self) -> list[str]:
        args = self._args
        words = ["vcu", "-i", self._bus, "--auto", "--mission", args.mission, "--revision", args.revision]
        words += ["--seed", str(args.seed), "--truth", str(self._stack.truth_port)]
        words += ["--result", str(self._verdict), "--plot", str(self._plot)]
        if args.laps is not None:
            words += ["--laps", str(args.laps)]
        if args.track is not None:
            words += ["--track", args.track]
        return words

    def _report(self, status: int) -> int:
        """The judge's verdict and what the bus log shows, for a person."""
        try:
            verdict: dict[str, Any] = json.loads(self._verdict.read_text())
        except (OSError, ValueError):
            raise StackError(f"the simulated car left no verdict; see {self._args.out / 'vcu.log'}") from None
        wire = check_candump(self._log, Codec(revision(self._args.revision)), busy_machine=True)
        laps = ", ".join(f"{lap_s:.2f} s" for lap_s in verdict["lap_times_s"])
        print(
            f"\njudge      {verdict['mission']}: {verdict['result'].upper()}", *verdict["reasons"], sep="\n           "
        )
        print(f"laps       {verdict['laps']}" + (f" ({laps})" if laps else ""))
        print(f"speed      mean {verdict['mean_speed_mps']:.1f} m/s, top {verdict['top_speed_mps']:.1f} m/s")
        print(f"cones hit  {verdict['cones_hit']}, off course {verdict['off_course']}")
        handshake = verdict["handshake"]
        if handshake.get("echoes"):
            print(
                f"handshake  {handshake['echoes']} echoes, response p50 {handshake['median_ms']:.2f} ms, "
                f"p99 {handshake['p99_ms']:.2f} ms, max {handshake['max_ms']:.2f} ms"
            )
        print(f"bus log    {wire.frames} frames, {'every rule kept' if wire.ok else 'RULES BROKEN:'}")
        for violation in wire.violations[:20]:
            print(f"           {violation}")
        print(f"saved      {self._log}, {self._plot}, {self._verdict}")
        return 0 if status == 0 and wire.ok else 1


def _node_parameters(args: argparse.Namespace) -> dict[str, dict[str, object]]:
    car = {"car": args.revision}
    laps = {} if args.laps is None else {"laps": args.laps}
    return {
        "vcu_bridge": {"revision": args.revision, **car},
        "path_planner": {**car, **laps},
        "vehicle_controller": {**car},
    }


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
