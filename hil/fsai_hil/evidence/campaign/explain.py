"""One run, reported to a person: what was injected when, what the bridge saw and did when, what the rules demand."""

from __future__ import annotations

from dataclasses import dataclass, field

from fsai_hil.evidence.campaign.cases import Case
from fsai_hil.evidence.campaign.scenario import Scenario
from fsai_hil.evidence.campaign.verdict import CaseVerdict
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.reasons import words_of
from fsai_vcu.interface.units import MS


@dataclass(slots=True)
class ScenarioNarrator:
    """Listens to a scenario; `lines` tells it. Times are relative to the fault."""

    case: Case
    _events: list[tuple[int, str]] = field(default_factory=list)
    _before: dict[str, str] = field(default_factory=dict)
    _states: int = 0
    _failures: int = 0
    _reasons: frozenset[str] = frozenset()

    def listen(self, scenario: Scenario) -> None:
        """Look at everything once; call it after each step."""
        rig = scenario.rig
        now_ns = rig.now_ns
        vcu = rig.world.vcu
        if scenario.fault_ns is not None:
            speed = scenario.seen.speed_mps
            text = f"FAULT {self.case.spec}, at {speed:.1f} m/s: {self.case.kind.what}"
            self._change(scenario.fault_ns, "fault", text)
        if scenario.fault_over_ns is not None:
            self._change(scenario.fault_over_ns, "over", "the fault is over")
        for t_ns, state in vcu.history[self._states :]:
            why = next((one.why for one in vcu.transitions if one.t_ns == t_ns and one.target is state), "")
            self._say(t_ns, f"car: {state.label}" + (f" ({why})" if why else ""))
        self._states = len(vcu.history)
        for t_ns, process, what in rig.computer.failures[self._failures :]:
            self._say(t_ns, f"the {process}'s process ended: {what}")
        self._failures = len(rig.computer.failures)
        if rig.computer.bridge_running:
            self._follow(now_ns, rig.computer.report())
        else:
            self._change(now_ns, "bridge", "bridge: no process")
        self._change(now_ns, "standing", "the car stands" if rig.world.car.standing else "the car moves", quiet=True)

    def _follow(self, now_ns: int, report: BridgeReport) -> None:
        reasons = frozenset(report.reasons)
        for slug in sorted(reasons - self._reasons):
            detail = report.reason_details.get(slug)
            self._say(now_ns, f"bridge sees: {words_of(slug)}" + (f" ({detail})" if detail else ""))
        for slug in sorted(self._reasons - reasons):
            self._say(now_ns, f"bridge sees no longer: {words_of(slug)}")
        self._reasons = reasons
        self._change(now_ns, "bridge", f"bridge: {report.phase}")
        self._change(now_ns, "mode", f"mode: {report.mode}")
        if report.stopping is not None:
            self._change(now_ns, "stop", f"bridge stops the car because {report.stopping}")
        if report.emergency is not None:
            self._change(now_ns, "emergency", f"bridge sends ESTOP_REQUEST because {report.emergency}")
        asked = report.command
        torque = "torque" if max(asked.front_torque_nm, asked.rear_torque_nm) > 0 else "no torque"
        brake = "brake" if max(asked.front_brake_pct, asked.rear_brake_pct) > 0 else "no brake"
        self._change(now_ns, "pedals", f"on the bus: {torque}, {brake}", quiet=True)

    def _change(self, now_ns: int, key: str, text: str, *, quiet: bool = False) -> None:
        if self._before.get(key) == text:
            return
        first = key not in self._before
        self._before[key] = text
        if not (first and quiet):
            self._say(now_ns, text)

    def _say(self, t_ns: int, text: str) -> None:
        self._events.append((t_ns, text))

    def lines(self, scenario: Scenario, verdict: CaseVerdict, *, everything: bool = False) -> list[str]:
        """What happened from shortly before the fault on, and the verdict."""
        fault_ns = scenario.fault_ns
        lines = []
        pedals = 0
        for t_ns, text in sorted(self._events, key=lambda event: event[0]):
            if fault_ns is not None and t_ns < fault_ns - 1000 * MS and not everything:
                continue
            if text.startswith("on the bus"):
                pedals += 1
                if pedals > 20 and not everything:
                    continue  # a driver changes pedals all the time: the first few tell what the reaction was
            zero_ns = 0 if fault_ns is None else fault_ns
            lines.append(f"{(t_ns - zero_ns) / MS:+9.0f} ms  {text}")
        lines.append(f"demanded: {self.case.kind.must.demanded}")
        if not verdict.applies:
            lines.append(
                "(here no reaction is demanded: not in AS_DRIVING after its first 3 s, or the mission was over)"
            )
        reaction = "" if verdict.reaction_ms is None else f", reaction after {verdict.reaction_ms:.0f} ms"
        safe = "" if verdict.safe_ms is None else f", safe after {verdict.safe_ms:.0f} ms"
        lines.append(f"seen: {verdict.reaction}{reaction}{safe}")
        lines += [f"worse than allowed: {fault}" for fault in verdict.faults]
        return lines
