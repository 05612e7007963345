"""Does the explanation of a log name what was really wrong? Runs of the fault campaign, explained from their frames.

    python -m fsai_hil.evidence.explanations     # a log of each kind of fault, and the score: status 0 from 95 % on

What is expected follows from the run itself: the bridge's own reason, or why the simulated VCU changed its state.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from functools import cache, partial
from typing import Any, Final

from fsai_hil.evidence.campaign.cases import CampaignPlan, Case
from fsai_hil.evidence.campaign.catalogue import ROWS
from fsai_hil.evidence.campaign.demands import End
from fsai_hil.evidence.campaign.scenario import Scenario, Snapshots
from fsai_hil.evidence.work import followed, spread
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.diagnostics.explain import IncidentKind
from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of
from fsai_vcu.diagnostics.verdict import judged
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
    "the EBS is not available any more": frozenset({"tsms_off", "ebs_fault"}),
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
# Why it stops a drive does not show on the bus.
HIDDEN: Final = frozenset({Reason.COMMAND_STALE, Reason.BOTH_PEDALS, Reason.NOT_CONFIRMED, Reason.STACK_RESTARTED})
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
    incidents = [incident for incident in verdict.explanation.incidents if incident.kind is not IncidentKind.MISMATCH]
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
    if reason is None or reason in HIDDEN:
        return unseen
    return ALIKE.get(reason, frozenset({reason.slug}))


def _not_right(one: Explained) -> str:
    if one.grade == "right" and not one.falsely_green:
        return ""
    green = ", and check called it OK" if one.falsely_green else ""
    named, expected = (" or ".join(words) or "nothing" for words in (one.named, sorted(one.expected)))
    return f"{one.grade}: {named}, expected {expected}{green}\n    {one.case.replay}"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m fsai_hil.evidence.explanations", description=__doc__)
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="what every case follows from (default: 1)")
    parser.add_argument("--logs", type=int, metavar="N", help="so many logs (default: one of each kind of fault)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")
    args = parser.parse_args(argv)
    count = args.logs or len(ROWS)
    every = max(1, len(ROWS) // count)
    numbers = [index * every for index in range(count)]
    logs = spread(partial(explained, args.seed), numbers, args.jobs)
    found = list(followed(logs, "logs", count, _not_right, "not right"))
    grades = {grade: sum(one.grade == grade for one in found) for grade in ("right", "partly", "wrong")}
    green = sum(one.falsely_green for one in found)
    share = grades["right"] / len(found)
    counted = ", ".join(f"{n} {grade}" for grade, n in grades.items())
    print(f"{len(found)} logs: {counted} ({share:.1%} right); {green} called OK that are not")
    return 0 if share >= RIGHT_SHARE and not green else 1


if __name__ == "__main__":
    sys.exit(main())
