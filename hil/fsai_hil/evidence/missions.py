"""`python -m fsai_hil.evidence.missions`: every mission, under every condition of the cone sensor, with many seeds.

Each run is the whole AI side against the simulated car in lockstep, judged by the judge and by the rules on the bus.
A mission with cones is driven on its own built-in track, autocross on the small oval and on a generated circuit for
each seed, too; tracks of files are driven by each mission they suit (a circuit in trackdrive's ten laps only where
autocross is not asked for). Runs are kept in a record, and a run that is there is not driven again: more seeds or
tracks may follow later, in the same record.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from msgspec.structs import asdict

from fsai_hil.evidence.hard_sensing import DriveEnd, HardDrive, Trouble, drawn
from fsai_hil.evidence.work import RecordFile, digest, followed, spread
from fsai_hil.simulator.judge import check_track
from fsai_hil.simulator.lockstep import CONFIDENCE_THRESHOLD, Lockstep, LockstepResult, confident
from fsai_hil.simulator.sensing import SensorSettings
from fsai_hil.simulator.tracks import MISSION_TRACK, load_track
from fsai_hil.simulator.world import WorldSetup, mission_named
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.values import Value

MIDLINE: Final = "_midline"  # files beside a track that are none
AUTOCROSS_TOO: Final = ("small_oval", "generated-SEED")
RECORD: Final = Path("out/missions/record.jsonl")
LISTED: Final = 40  # failures
STOPPED: Final = "stopped"  # a result: in its lane, with a sensor that does not always show it
GOOD: Final = ("pass", STOPPED)


class Sensing(Value, frozen=True):
    """A condition of the cone sensor: its noise, losses and mistakes."""

    what: str
    sensor: SensorSettings = SensorSettings()
    threshold: float = CONFIDENCE_THRESHOLD  # of the detector
    # By the seed, what happens to the sensor of a car that may stop in its lane; None: it must drive.
    trouble: Callable[[int], Trouble] | None = None
    track: str | None = None  # of autocross, the only mission; None: all of all missions


CONDITIONS: Final[Mapping[str, Sensing]] = {
    "nominal": Sensing("the simulated sensor as it is"),
    "noise": Sensing("0.1 m of noise, near and far", SensorSettings(noise_m=0.1, noise_per_m=0.0)),
    "missing": Sensing("10 % of the cones missing in each look, near and far", SensorSettings(miss_near=0.1)),
    "colourless": Sensing("no colours: all cones UNKNOWN", SensorSettings(colours=False)),
    "mistaken": Sensing(
        "the same 5 % of the cones have the other border's colour in every look", SensorSettings(mistaken=0.05)
    ),
    "clutter": Sensing("a false cone in each look, and no threshold", SensorSettings(false_per_scan=1.0), 0.0),
    "hard": Sensing(
        "by the seed, range 6 to 15 m, view 60 to 180 deg, 0 to 4 false cones a look as sure as true ones, colours or"
        " none, 2 s without cones or not, a jump of the pose by 0.5 m or none: the mission is driven, or the car stops"
        " in its lane; one that leaves the lane fails, and its drive ends there",
        trouble=drawn,
    ),
    "sharp": Sensing(
        "the simulated sensor as it is, on circuits with inside radii of 1.4 to 4 m and chicanes into hairpins,"
        " some harder than the rules allow: the lap is driven, or the car stops in its lane; one that leaves the lane"
        " fails, and its drive ends there",
        trouble=lambda _: Trouble(),
        track="generated-SEED-sharp",
    ),
}


class MissionCase(Value, frozen=True):
    """One run."""

    mission: str
    track: str  # as load_track takes it, but for SEED
    condition: str
    seed: int

    @property
    def row(self) -> tuple[str, str, str]:
        return self.mission, Path(self.track).stem, self.condition

    @property
    def name(self) -> str:
        return f"{', '.join(self.row)}, seed {self.seed}"


def cases(
    missions: Iterable[str], conditions: Sequence[str], seeds: Sequence[int], tracks: Sequence[str] | None
) -> Iterator[MissionCase]:
    """Every run asked for. `tracks`: only these; None: the built-in ones. Raises ValueError, OSError."""
    asked = [mission_named(name) for name in missions]
    for mission in asked:
        own = MISSION_TRACK.get(mission)
        if own is None:  # without cones nothing in a run is random
            yield MissionCase(mission.name.lower(), "static", "nominal", 0)
            continue
        chosen = tracks if tracks is not None else (own, *(AUTOCROSS_TOO if mission is Ami.AUTOCROSS else ()))
        everywhere = [which for which in conditions if CONDITIONS[which].track is None]
        rows = [(track, which) for track in chosen for which in everywhere]
        if mission is Ami.AUTOCROSS:
            rows += [(track, which) for which in conditions if (track := CONDITIONS[which].track) is not None]
        for track, which in rows:
            again = mission is Ami.TRACKDRIVE and track != own and Ami.AUTOCROSS in asked
            if again or check_track(load_track(track.replace("SEED", "1")), mission) is not None:
                continue
            yield from (MissionCase(mission.name.lower(), track, which, seed) for seed in seeds)


def driven(case: MissionCase) -> dict[str, Any]:
    """The line of the record of one run."""
    track, condition = load_track(case.track.replace("SEED", str(case.seed))), CONDITIONS[case.condition]
    mission = mission_named(case.mission)
    if condition.trouble is not None:
        drive = HardDrive(mission, track, condition.trouble(case.seed), case.seed)
        return _line(case, drive.result(), drive.ending)
    setup = WorldSetup(missions=[mission], track=track, seed=case.seed, sensor=condition.sensor, gps=False)
    lockstep = Lockstep(setup)
    lockstep.detector = partial(confident, threshold=condition.threshold)
    result = lockstep.run()
    return _line(case, result, DriveEnd.DRIVEN if result.passed else DriveEnd.NEITHER)


def _line(case: MissionCase, result: LockstepResult, ending: DriveEnd) -> dict[str, Any]:
    """Return the line of the record of a run that ended so."""
    found, verdict = result.as_dict(), result.verdict
    kept = ("result", "reasons", "cones_hit", "off_course", "faults", "gate_reasons", "emergency", "sim_time_s")
    times = verdict.lap_times_s or (verdict.driving_time_s,)
    case = MissionCase(*case.row, case.seed)  # where a track's file lies is of no interest
    line = {**asdict(case), **{key: found[key] for key in kept}, "times_s": [round(time, 3) for time in times]}
    if ending is DriveEnd.STOPPED and result.wire.ok:
        line |= {"result": STOPPED, "reasons": []}
    elif ending is DriveEnd.LEFT:
        line |= {"result": "fail", "reasons": [DriveEnd.LEFT.value], "off_course": 1}
    return line


# ---------------------------------------------------------------- the record and the table


def _case(run: Mapping[str, Any]) -> MissionCase:
    return MissionCase(run["mission"], run["track"], run["condition"], run["seed"])


def _failed(run: Mapping[str, Any]) -> str:
    return "" if run["result"] in GOOD else f"failed: {_case(run).name}: {'; '.join(run['reasons'])}"


def _row(group: Sequence[Mapping[str, Any]]) -> str:
    """Return the row of one mission, track and condition; its times are those of the runs that passed."""
    passed = [run for run in group if run["result"] == "pass"]
    times = [time for run in passed for time in run["times_s"]]
    of_first = [sum(run["times_s"]) / len(run["times_s"]) / run["times_s"][0] for run in passed if run["times_s"][1:]]
    stopped = sum(run["result"] == STOPPED for run in group)
    counts = (stopped, sum(run["cones_hit"] for run in group), sum(run["off_course"] for run in group))
    cells = (
        *_case(group[0]).row, len(group), len(passed), *counts, sum(len(run["faults"]) for run in group),
        *((round(sum(times) / len(times), 2), round(max(times), 2)) if times else ("–", "–")),
        f"{max(of_first):.3f}" if of_first else "–",
    )  # fmt: skip
    return f"| {' | '.join(map(str, cells))} |"


def _order(run: Mapping[str, Any]) -> tuple[int, str, int, int]:
    return Ami[run["mission"].upper()], run["track"], list(CONDITIONS).index(run["condition"]), run["seed"]


def markdown(runs: Sequence[Mapping[str, Any]]) -> str:
    """The whole document, of all runs in the record."""
    grouped: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for run in runs:
        grouped.setdefault(_case(run).row, []).append(run)
    failed = [run for run in runs if run["result"] not in GOOD]
    hours = sum(run["sim_time_s"] for run in runs) / 3600.0
    lines = [
        "# Missions",
        "",
        f"Made by `python -m fsai_hil.evidence.missions`; do not edit. Sources: `{digest()}`.",
        "",
        f"{len(runs)} runs of the whole AI side against the simulated car in lockstep, {hours:.1f} simulated hours,"
        " judged by the car's true motion and by the rules on the bus.",
        "",
        f"**Failed: {len(failed)} of {len(runs)} runs.**",
        "",
        "Cones hit and times off course are sums over the runs; times are of a lap (acceleration: from line to line;"
        " missions without a track: in AS_DRIVING), of the runs that passed. Missions without cones are driven once:"
        " nothing in them is random, and the emergency brake in which some end is among the faults. With"
        " `generated-SEED` each seed is another circuit by the rules. *To first*: the mean time of a run's laps, the"
        " first among them, as a share of the first one's; the worst run's.",
        "",
        *(f"- *{name}*: {CONDITIONS[name].what}" for name in dict.fromkeys(run["condition"] for run in runs)),
        "",
        "| mission | track | cones seen | runs | passed | stopped in lane | cones hit | off course | faults"
        " | mean s | worst s | to first |",
        f"|{'---|' * 3}{'---:|' * 9}",
        *map(_row, grouped.values()),
    ]
    if failed:
        lines += ["", "## Failed runs", ""]
        lines += [
            f"- {run['mission']}, {run['track']}, {run['condition']}, seed {run['seed']}: {'; '.join(run['reasons'])}"
            for run in failed[:LISTED]
        ]
    return "\n".join(lines) + "\n"


# ---------------------------------------------------------------- the command


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _conditions(text: str) -> list[str]:
    if unknown := set(_names(text)) - set(CONDITIONS):
        raise argparse.ArgumentTypeError(f"unknown {', '.join(sorted(unknown))}: choose of {', '.join(CONDITIONS)}")
    return _names(text)


def _seeds(text: str) -> range:
    first, _, last = text.partition("-")
    try:
        return range(int(first), int(last) + 1) if last else range(1, int(first) + 1)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither N nor FIRST-LAST") from None


def _tracks(texts: Iterable[str]) -> list[str]:
    """Names, files, and what is in folders."""
    found: list[str] = []
    for text in texts:
        files = sorted(str(path) for path in Path(text).glob("*.csv") if not path.stem.endswith(MIDLINE))
        found += files if Path(text).is_dir() else [text]
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive the missions that the arguments name; return the exit status."""
    every = ",".join(ami.name.lower() for ami in Ami if ami is not Ami.NOT_SELECTED)
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.evidence.missions",
        description="Drive every mission under every condition of the cone sensor, with many seeds.",
    )
    add = parser.add_argument
    add("--missions", type=_names, default=_names(every), metavar="A,B,…", help="default: all")
    add("--conditions", type=_conditions, default=list(CONDITIONS), metavar="A,B,…", help=", ".join(CONDITIONS))
    add("--seeds", type=_seeds, default=_seeds("100"), metavar="N|FIRST-LAST", help="default: 100, which is 1-100")
    add("--tracks", type=_names, metavar="A,B,…", help="only these: names, generated-SEED, CSV files, folders of them")
    add("--record", type=Path, default=RECORD, metavar="FILE", help=f"where the runs are kept (default: {RECORD})")
    add("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes (default: one per processor)")
    add("-o", "--output", type=Path, metavar="FILE.md", help="write the document (default: to the terminal)")
    args = parser.parse_args(arguments)
    try:
        tracks = None if args.tracks is None else _tracks(args.tracks)
        asked = list(cases(args.missions, args.conditions, args.seeds, tracks))
        return _drive(asked, args)
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2


def _drive(asked: Sequence[MissionCase], args: argparse.Namespace) -> int:
    """Do the runs that the record lacks, and print or write the table of all; return the exit status."""
    with RecordFile(args.record, {"missions": digest()}) as record:
        if record.kept_as:
            print(f"{record.path} was of other sources, and is now {record.kept_as}", file=sys.stderr)
        runs = {_case(run): run for run in record.results}
        missing = [case for case in asked if MissionCase(*case.row, case.seed) not in runs]
        results = spread(driven, missing, args.jobs)
        deque(followed(results, "runs", len(missing), _failed, "failed", record=record, to=sys.stderr), 0)
        runs = {_case(run): run for run in record.results}
    text = markdown(sorted(runs.values(), key=_order))
    if args.output:
        args.output.write_text(text, encoding="utf-8")
    else:
        print(text, end="")
    return 1 if any(runs[MissionCase(*case.row, case.seed)]["result"] not in GOOD for case in asked) else 0


if __name__ == "__main__":
    sys.exit(main())
