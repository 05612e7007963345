"""One run, reported to a person: what was injected when, what the bridge saw and did when, what the rules demand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from fsai_hil.evidence.campaign.endings import End
from fsai_hil.evidence.campaign.scenario import Scenario
from fsai_hil.evidence.campaign.verdict import CaseVerdict
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.config import words_of
from fsai_vcu.interface.units import MS

FIRST: Final[Mapping[End, str]] = {
    End.ESTOP: "ESTOP_REQUEST",
    End.SELF: "EMERGENCY_BRAKE",
    End.STOP: "service brake",
}
"""End of a run -> its reaction that is timed; of the others it is torque 0."""
PEDALS_SHOWN = 20  # a driver changes pedals all the time: the first few show what the reaction was


@dataclass(slots=True)
class ScenarioNarrator:
    """Follows a scenario; `lines` reports it. Times are relative to the fault."""

    scenario: Scenario
    _events: list[tuple[int, str]] = field(default_factory=list)
    _before: dict[str, str] = field(default_factory=dict)
    _reasons: frozenset[str] = frozenset()

    def look(self) -> None:
        """Look at bridge and car once; call it after each step. What the run keeps by itself is for `lines`."""
        rig = self.scenario.rig
        if rig.computer.bridge_running:
            self._follow(rig.now_ns, rig.computer.report())
        else:
            self._change(rig.now_ns, "bridge", "bridge: no process")
        self._change(rig.now_ns, "standing", f"the car {'stands' if rig.world.car.standing else 'moves'}", quiet=True)

    def _follow(self, now_ns: int, report: BridgeReport) -> None:
        """Note what has changed in the bridge's report since the last look."""
        reasons = frozenset(report.reasons)
        elsewhere = "" if report.phase.startswith("AS_DRIVING") else " (the car is not in AS_DRIVING)"
        by_ebs = " (the EBS has to brake)" if report.phase.startswith("EMERGENCY_BRAKE") else ""
        for slug in sorted(reasons - self._reasons):
            detail = report.reason_details.get(slug)
            self._events.append((now_ns, f"bridge sees: {words_of(slug)}" + (f" ({detail})" if detail else "")))
        for slug in sorted(self._reasons - reasons):
            self._events.append((now_ns, f"bridge no longer reports{elsewhere}: {words_of(slug)}"))
        self._reasons = reasons
        self._change(now_ns, "bridge", f"bridge: {report.phase}")
        self._change(now_ns, "mode", f"mode: {report.mode}")
        if report.stopping is not None:
            self._change(now_ns, "stop", f"bridge stops the car because {report.stopping}")
        if report.emergency is not None:
            self._change(now_ns, "emergency", f"bridge sends ESTOP_REQUEST because {report.emergency}")
        asked = report.command
        torque = "torque" if asked.torque_requested else "no torque"
        brake = "brake" if asked.brake_requested else "no brake"
        self._change(now_ns, "pedals", f"on the bus: {torque}, {brake}{by_ebs}", quiet=True)

    def _change(self, now_ns: int, key: str, text: str, *, quiet: bool = False) -> None:
        before, self._before[key] = self._before.get(key), text
        if before != text and not (before is None and quiet):
            self._events.append((now_ns, text))

    def _kept(self) -> list[tuple[int, str]]:
        """The fault, the car's states and why, and processes that ended."""
        scenario, rig = self.scenario, self.scenario.rig
        case, vcu = scenario.case, rig.world.vcu
        fault = f"FAULT {case.spec}, at {scenario.seen.speed_mps:.1f} m/s: {case.kind.what}"
        found = [(scenario.fault_ns, fault), (scenario.fault_over_ns, "the fault is over")]
        whys = {(one.t_ns, one.target): f" ({one.why})" for one in vcu.transitions}
        found += [(t_ns, f"car: {state.label}{whys.get((t_ns, state), '')}") for t_ns, state in vcu.history]
        found += [(t_ns, f"the {process}'s process ended: {what}") for t_ns, process, what in rig.computer.failures]
        return [(t_ns, text) for t_ns, text in found if t_ns is not None]

    def lines(self, verdict: CaseVerdict) -> list[str]:
        """Return what happened from shortly before the fault on, and the verdict."""
        zero_ns = self.scenario.fault_ns or 0
        lines = []
        pedals = 0
        for t_ns, text in sorted(self._kept() + self._events, key=lambda event: event[0]):
            if t_ns >= zero_ns - 1000 * MS:
                pedals += text.startswith("on the bus")
                if pedals <= PEDALS_SHOWN or not text.startswith("on the bus"):
                    lines.append(f"{(t_ns - zero_ns) / MS:+9.0f} ms  {text}")
        must = self.scenario.case.kind.must.of_drawn(self.scenario.case.params)
        lines.append(f"required: {must.note or 'one of the allowed ends'}; allowed: {must.allowed}")
        if not verdict.applies:
            lines.append(
                "(no reaction is required here: not in AS_DRIVING after its first 3 s, or the mission was over)"
            )
        lines.append(f"observed: {verdict.reaction}{self._times(verdict)}")
        return [*lines, *(f"worse than allowed: {fault}" for fault in verdict.faults)]

    def _times(self, verdict: CaseVerdict) -> str:
        """The times of the reactions, from the zero from which the demanded ones count, in the same words."""
        case = self.scenario.case
        late = verdict.applies and case.kind.must.of_drawn(case.params).shows_late and verdict.onset_ms is not None
        both = verdict.end is End.ESTOP and late
        named = (
            ("service brake", verdict.brake_ms if both else None),
            (FIRST.get(verdict.end, "torque 0"), verdict.reaction_ms),
            ("safe", verdict.safe_ms),
        )
        times = ", ".join(f"{what} after {ms:.0f} ms" for what, ms in named if ms is not None)
        if not times:
            return ""
        since = f"; counted from {verdict.onset_ms:+.0f} ms, when it was certainly implausible" if late else ""
        return f" ({times}{since})"
