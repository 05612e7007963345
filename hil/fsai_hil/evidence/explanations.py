"""Does the explanation of a log name what was really wrong? Two halves, each with its score.

    python -m fsai_hil.evidence.explanations     # status 0 where both are right from 95 % on, and none falsely OK

The first half are runs of the fault campaign, a log of each kind of fault: what is expected follows from the run, the
bridge's own reason, or why the simulated VCU changed its state. The second half are good runs that were changed frame
by frame (edited_logs.py), as other cars and other AI computers would have written them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from fsai_hil.evidence.campaign.cases import CampaignPlan, Case
from fsai_hil.evidence.campaign.catalogue import ROWS
from fsai_hil.evidence.campaign.endings import End
from fsai_hil.evidence.campaign.scenario import Scenario, Snapshots
from fsai_hil.evidence.edited_logs import EDITS, Edit, Told, told_at
from fsai_hil.evidence.work import digest, followed, spread
from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.diagnostics.explain import IncidentKind
from fsai_vcu.diagnostics.explain.causes import CAUSES
from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of
from fsai_vcu.diagnostics.verdict.judging import judged
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import MS
from fsai_vcu.interface.values import Value

RIGHT_SHARE: Final = 0.95
LOOK_NS: Final = 10 * MS
PLANNED: Final = "planned_end"  # the emergency brake with which some missions end
NOTHING: Final = frozenset({""})
SILENT_STOP: Final = frozenset({"", Reason.COMMAND_STALE.slug, "stop_asked"})  # what the bus cannot tell
LINK: Final = frozenset(
    {
        "ai_unheard",
        "ai_silent",
        "ai_message_missing",
        "ai_message_length",
        "handshake_lost",
        "handshake_stands",
        "echo_wrong",
        "ai_bus_off",
        "vcu_hung",
        "status_frozen",
    }
)
VCU_WHY: Final[Mapping[str, frozenset[str]]] = {
    "Go off": frozenset({"go_off"}),
    "ASMS off": frozenset({"asms_off"}),
    "the EBS is no longer available": frozenset({"tsms_off", "ebs_fault"}),
    "shutdown circuit open": frozenset({"sdc_open", "remote_estop", "radio_lost", "go_off"}),
    "the AI computer's messages or echo are missing": LINK,
    "torque and brake requested together": frozenset({"torque_with_brake"}),
    "mission FINISHED while a wheel turns": frozenset({"finished_while_moving"}),
    "direction NEUTRAL while a wheel turns": frozenset({"neutral_while_moving"}),
    "BMS fault": frozenset({"bms"}),
    "EBS fault": frozenset({"ebs_fault"}),
    "high-voltage interlock open": frozenset({"hvil_open"}),
    "LVMS off": frozenset({"vcu_reboot", "power_off"}),
}
# What a car does beside, whatever the fault was: one that is held still stands, and what is measured wrong is not asked
TRUE_ANYWAY: Final = (IncidentKind.MISMATCH, IncidentKind.STAND)
# To those who see the frames only, these look alike.
ALIKE: Final[Mapping[Reason, frozenset[str]]] = {
    Reason.LOOP_FAULT: frozenset({Reason.LOOP_FAULT.slug, Reason.BUS_LOST.slug, "ai_silent"}),
    Reason.BUS_LOST: frozenset({Reason.LOOP_FAULT.slug, Reason.BUS_LOST.slug, "ai_silent", "ai_bus_off", "stop_asked"}),
    # One wheel that reads too much keeps the bridge from seeing that the brake has stopped the car.
    Reason.STOP_INEFFECTIVE: frozenset({Reason.STOP_INEFFECTIVE.slug, Reason.WHEEL_IMPLAUSIBLE.slug}),
    Reason.NOT_SEEN: frozenset({Reason.NOT_SEEN.slug, "frames_wrong", "stop_asked", "ai_silent"}),
}


class _Log(list[Frame]):
    """The frames of a run. Copied with its snapshot, frames are shared."""

    def __call__(self, frame: Frame) -> None:
        self.append(frame)

    def __deepcopy__(self, memo: dict[int, Any]) -> _Log:
        return _Log(self)


class Explained(Value, frozen=True):
    """One log. `named`: the first cause of each incident; `expected`: what may be named first, "" for nothing; `also`:
    what may be named besides, as what the AI computer did before the car stopped itself.
    """

    case: Case
    expected: frozenset[str]
    also: frozenset[str]
    named: tuple[str, ...]
    others: tuple[str, ...]
    ok: bool

    @property
    def grade(self) -> str:
        named = self.named if PLANNED in self.expected else [slug for slug in self.named if slug != PLANNED]
        if (self.expected | self.also).issuperset(named or ("",)) and self.expected.intersection(named or ("",)):
            return "right"
        if self.expected.intersection(named):
            return "partly"
        return "partly" if self.expected.intersection(self.others) else "wrong"

    @property
    def falsely_green(self) -> bool:
        return self.ok and not self.expected & {"", PLANNED}


@cache
def _snapshots() -> Snapshots:
    return Snapshots(_Log)


def explained(seed: int, index: int) -> Explained:
    """Drive a case and explain its log."""
    case = CampaignPlan(seed).case(index)
    rig = _snapshots().rig(case)
    scenario = Scenario(case, rig)
    reasons: dict[str, str] = {}
    while not scenario.over:
        scenario.step()
        if scenario.fault_ns is not None and rig.now_ns % LOOK_NS == 0 and rig.computer.bridge_running:
            report = rig.computer.report()
            for name, reason in (("stopping", report.stopping), ("emergency", report.emergency)):
                if reason is not None:
                    reasons.setdefault(name, str(reason))
    end, fault_ns = scenario.verdict().end, scenario.fault_ns
    why = [t.why for t in rig.world.vcu.transitions if fault_ns is not None and t.t_ns >= fault_ns]
    assert isinstance(rig.on_frame, _Log)
    frames = frames_of(
        LogFrame(f.t_ns, "vcan0", f.can_id, f.data, extended=f.extended, remote=f.remote, error=f.error)
        for f in rig.on_frame
    )
    verdict = judged(frames).verdict
    incidents = [incident for incident in verdict.explanation.incidents if incident.kind not in TRUE_ANYWAY]
    named = tuple(incident.candidates[0].slug for incident in incidents)
    others = tuple(one.slug for incident in incidents for one in incident.candidates[1:])
    also = _asked(reasons["stopping"]) if end in (End.SELF, End.OFF) and "stopping" in reasons else NOTHING
    return Explained(case, _expected(end, reasons, why), also, named, others, verdict.ok)


def _expected(end: End, reasons: Mapping[str, str], why: list[str]) -> frozenset[str]:
    """The causes that are right for a run that ended so."""
    if end in (End.ON, End.HELD):
        # What shows for a moment and changes nothing may be named or not.
        return NOTHING | {Reason.AS_STATE_UNKNOWN.slug, "frames_wrong"}
    if end in (End.SELF, End.OFF):
        return frozenset().union(*(VCU_WHY.get(each, frozenset()) for each in why))
    if end is End.ESTOP:
        return _asked(reasons.get("emergency", ""), frozenset({"not_on_the_bus", PLANNED}))
    return _asked(reasons.get("stopping", ""))


def _asked(words: str, unseen: frozenset[str] = SILENT_STOP) -> frozenset[str]:
    """The causes that are right where the bridge stopped the car for this reason; `unseen`: where no frame shows it."""
    reason = next((reason for reason in Reason if words.startswith(reason.words)), None)
    if reason is None or reason is Reason.COMMAND_STALE or reason.slug not in CAUSES:  # no frame shows that
        return unseen
    return ALIKE.get(reason, frozenset({reason.slug}))


def _not_right(one: Explained) -> str:
    if one.grade == "right" and not one.falsely_green:
        return ""
    green = ", and check called it OK" if one.falsely_green else ""
    named, expected = (" or ".join(words) or "nothing" for words in (one.named, sorted(one.expected)))
    return f"{one.grade}: {named}, expected {expected}{green}\n    {one.case.replay}"


def _edit_not_right(one: Told) -> str:
    if one.grade == "right" and not one.falsely_green:
        return ""
    green = ", and check called it OK" if one.falsely_green else ""
    named, expected = (" or ".join(word or "nothing" for word in words) for words in (one.named, one.expected))
    return f"{one.grade}: {named}, expected {expected}{green}\n    {one.edit}"


class Score(NamedTuple):
    """The score of one half. missed: each log that was not told rightly, in words."""

    what: str
    grades: Mapping[str, int]
    green: int
    missed: tuple[str, ...]

    @property
    def logs(self) -> int:
        return sum(self.grades.values())

    @property
    def good(self) -> bool:
        return self.grades["right"] >= RIGHT_SHARE * self.logs and not self.green

    @property
    def line(self) -> str:
        counted = ", ".join(f"{count} {grade}" for grade, count in self.grades.items())
        share = self.grades["right"] / self.logs
        return f"{self.what}: {self.logs} logs: {counted} ({share:.1%} right); {self.green} wrongly called OK"


def score(what: str, found: Iterable[Explained | Told]) -> Score:
    """The score of these logs."""
    logs = list(found)
    grades = {grade: sum(one.grade == grade for one in logs) for grade in ("right", "partly", "wrong")}
    missed = (_not_right(one) if isinstance(one, Explained) else _edit_not_right(one) for one in logs)
    return Score(what, grades, sum(one.falsely_green for one in logs), tuple(filter(None, missed)))


def markdown(halves: Iterable[Score], edits: Iterable[Edit]) -> str:
    """The page of evidence."""
    rows = [
        f"| {half.what} | {half.logs} | {half.grades['right']} | {half.grades['partly']} | {half.grades['wrong']} |"
        f" {half.green} |"
        for half in halves
    ]
    lines = [
        "# Explanations",
        "",
        f"Made by `python -m fsai_hil.evidence.explanations`; do not edit. Sources: `{digest()}`.",
        "",
        "Logs with a known cause, and what `fsai-vcu explain` and `check` say of them: *right* names it and nothing"
        " else, *partly* something else beside it, *wrong* does not name it. *Called OK* are logs that are not.",
        "",
        "| logs | how many | right | partly | wrong | called OK |",
        "|---|---:|---:|---:|---:|---:|",
        *rows,
        "",
        "The first are runs with a fault of the campaign in each. The others are good runs, changed frame by frame as"
        " another car or another AI computer would have sent them:",
        "",
        *(f"- {edit.name}: {' or '.join(f'`{slug}`' if slug else 'OK' for slug in edit.named)}" for edit in edits),
    ]
    missed = [words.replace("\n    ", ": ") for half in halves for words in half.missed]
    if missed:
        lines += ["", "## Not right", "", *(f"- {words}" for words in missed)]
    return "\n".join(lines) + "\n"


def _halves(args: argparse.Namespace) -> Iterator[Score]:
    if args.half in (1, None):
        count = args.logs or len(ROWS)
        numbers = [index * max(1, len(ROWS) // count) for index in range(count)]
        logs = spread(partial(explained, args.seed), numbers, args.jobs)
        yield score("a fault in the drive", followed(logs, "logs", count, _not_right, "not right"))
    if args.half in (2, None):
        edited = spread(told_at, range(len(EDITS)), args.jobs)
        yield score("frames edited", followed(edited, "logs", len(EDITS), _edit_not_right, "not right"))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m fsai_hil.evidence.explanations", description=__doc__)
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="what every case follows from (default: 1)")
    parser.add_argument("--logs", type=int, metavar="N", help="so many of the first half (default: of each fault one)")
    parser.add_argument("--half", type=int, choices=(1, 2), help="one half only")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.md", help="write the page of evidence, too")
    args = parser.parse_args(argv)
    halves = list(_halves(args))
    for half in halves:
        print(half.line)
    if args.output:
        args.output.write_text(markdown(halves, EDITS), encoding="utf-8")
    return 0 if all(half.good for half in halves) else 1


if __name__ == "__main__":
    sys.exit(main())
