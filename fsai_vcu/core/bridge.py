"""The bridge between an AI stack and the VCU: supervisor, gate, checks and odometry behind one façade.

A thin shell round one immutable `BridgeState`; single-threaded, no clock, no socket. The loop on the car, the lockstep
simulation and the tests all drive this same object:

    on_frame, on_command, … whenever something arrives;
    cycle(now) -> what to send now, or None for silence; then on_sent(complete, now);
    report(now) -> an immutable snapshot.

Times are integer nanoseconds of the monotonic clock. `on_sent` matters: torque never rises unless complete cycles went
out before it (safety rule 1).
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Any, cast

from msgspec.structs import replace

from fsai_vcu.core.bridge_state import BridgeState
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.driving import Run
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.report import UNKNOWN_LENGTH, WHYS_KEPT, BridgeReport
from fsai_vcu.core.supervision import supervisor, wheel_speeds
from fsai_vcu.core.supervision.changes import changes
from fsai_vcu.core.supervision.config import BridgeConfig, Reason, official_simulator
from fsai_vcu.core.supervision.gate import gate, gate_config, sent
from fsai_vcu.core.supervision.plausibility import (
    NEW_STEERING,
    SteeringCheck,
    WheelCheck,
    check_steering,
    check_wheels,
    forget_wheels,
)
from fsai_vcu.core.supervision.readiness import Circumstances, why_not_driving
from fsai_vcu.core.supervision.supervisor import Asked, Inputs, SupervisorState
from fsai_vcu.core.tally import Tally
from fsai_vcu.core.vehicle.odometry import OdometryState, advance, begin_run, standing_start
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    GPS_FIELD_OF,
    VEHICLE_FIELD_OF,
    AiCommand,
    Image,
    VcuStatus,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.reserved import AI_IDS, STATUS_ID
from fsai_vcu.interface.revisions import REVISION_IDS, Revision, revision_by_frame
from fsai_vcu.interface.values import DETAIL_LENGTH, WORD_LENGTH, shortened

__all__ = ["Bridge", "BridgeConfig", "BridgeReport", "BridgeState", "official_simulator"]


_AGES = ("status", "drive_front", "drive_rear", "steer", "brake", "speeds", "counts", "log_dynamics", "log_status")

_NOT_ONLY_DECODED = REVISION_IDS.union(AI_IDS)

# In static inspections the wheels are in the air, each for itself.
_WHEELS_IN_THE_AIR = frozenset((Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B))


class Bridge:
    """One AI computer's side of the interface. See the module's words for how to drive it."""

    def __init__(
        self,
        codec: Codec,
        revision: Revision,
        car: VehicleParameters,
        config: BridgeConfig | None = None,
        limits: OperationalLimits | None = None,
        first_run_id: int = 1,
        now_ns: int = 0,
    ) -> None:
        """Begin at rest and idle, with `first_run_id` as the first run; `now_ns` is of the monotonic clock."""
        self._codec = codec
        self._car = car
        self._config = config or BridgeConfig()
        self._limits = limits or UNLIMITED
        self._gate_config = gate_config(self._config, revision, car, limits)
        self._steer_limit_rad = math.radians(revision.steer_limit_deg)
        self._unknown = shortened(codec.unknown, UNKNOWN_LENGTH)

        self._state = BridgeState(SupervisorState(run_id=first_run_id), standing_start(now_ns))
        # Images received since the state was last looked at, by the fields of `vehicle` and `gps`: a cycle's thirty
        # frames are taken in at once.
        self._vehicle_news: dict[str, Any] = {}
        self._gps_news: dict[str, Any] = {}
        self.tally = Tally()

    @property
    def config(self) -> BridgeConfig:
        return self._config

    @property
    def state(self) -> BridgeState:
        """Everything that decides what is sent next: a bridge to which it is given goes on as this one does."""
        state, vehicle, gps = self._state, self._vehicle_news, self._gps_news
        if vehicle or gps:
            self._state = state = replace(
                state,
                vehicle=replace(state.vehicle, **vehicle),
                gps=replace(state.gps, **gps),
            )
            vehicle.clear()
            gps.clear()
        return state

    @state.setter
    def state(self, state: BridgeState) -> None:
        self._vehicle_news.clear()
        self._gps_news.clear()
        self._state = state

    # ------------------------------------------------------------ what arrives

    def on_frame(self, frame: Frame) -> None:
        """A frame received at `frame.t_ns`. The process's own frames never come here."""
        if frame.error:
            return
        tally, can_id = self.tally, frame.can_id
        if not frame.extended:
            tally.received(can_id)
            if can_id in _NOT_ONLY_DECODED:
                if can_id in AI_IDS:
                    self._on_intruder(frame)
                    return
                self._on_revision(frame)
        decoded = self._codec.decode(frame)
        image, problems, handshake = decoded.image, decoded.problems, decoded.handshake
        for problem in problems:
            tally.problem(problem)
        if handshake is not None:
            self._vehicle_news["handshake"] = handshake
            if tally.unanswered_ns is None:
                tally.unanswered_ns = frame.t_ns
        if image is None:
            if can_id == STATUS_ID and not frame.extended and not frame.remote:
                self._on_doubted_status("; ".join(problems) or "it cannot be decoded", frame.t_ns)
            return
        kind = type(image)
        field = GPS_FIELD_OF.get(kind)
        if field is not None:
            self._gps_news[field] = image
            return
        if kind is VcuStatus:
            self._on_status(cast(VcuStatus, image))
        elif kind is WheelSpeeds:
            if not self._believed(cast(WheelSpeeds, image)):
                return
        elif kind is WheelCounts:
            self._on_counts(cast(WheelCounts, image))
        take = supervisor.TAKES.get(kind)
        if take is not None:
            self._supervise(take(self._config, self._state.supervisor, image))
        self._vehicle_news[VEHICLE_FIELD_OF[kind]] = image

    def _believed(self, speeds: WheelSpeeds) -> bool:
        """Judge a frame of 0x525 and return whether it counts: one not believed is treated as if it never came."""
        state = self._state
        belief, doubt = wheel_speeds.on_speeds(self._config, state.belief, speeds)
        if doubt:
            self.tally.problem(f"VCU2AI_Speeds is not believed: {doubt}")
        self._state = replace(state, belief=belief, speeds_doubt=doubt)
        return not doubt

    def _on_counts(self, counts: WheelCounts) -> None:
        state = self._state
        belief = wheel_speeds.on_counts(self._config, self._car, state.belief, counts)
        supervising = supervisor.on_pulses(state.supervisor, belief.pulses.turning_ns)
        self._state = replace(state, supervisor=supervising, belief=belief)

    def _on_doubted_status(self, doubt: str, t_ns: int) -> None:
        """A 0x520 of which at most the handshake counts."""
        state = self._state
        doubt = shortened(doubt, DETAIL_LENGTH)
        self._vehicle_news["status_known"] = False
        self._state = replace(
            state, supervisor=supervisor.received(self._config, state.supervisor, t_ns), status_doubt=doubt
        )

    def _on_status(self, status: VcuStatus) -> None:
        """Take in a believed 0x520: supervise it, note what it must not show, and begin the odometry of a new run."""
        state, tally, t_ns = self._state, self.tally, status.t_rx_ns
        before, odometry = state.supervisor, state.odometry
        now = supervisor.on_status(self._config, before, status)
        last = self._vehicle_news.get("status", state.vehicle.status)
        self._vehicle_news["status_known"] = True
        if now.driving and last is not None:
            for reason, detail in changes(last, status):
                tally.note(reason, detail)
                now = supervisor.strike(now, reason, detail, t_ns)
        if before.status_ns is not None and t_ns - before.status_ns >= self._config.vcu_stale_ns:
            tally.vcu_gaps += 1
        if before.driving and now.as_state in supervisor.IDLE_STATES:
            tally.note(Reason.VCU_REBOOT, f"AS_DRIVING to {status.as_state.label}")
        if now.run_id != before.run_id:
            odometry = begin_run(odometry, t_ns)
        self._state = replace(state, supervisor=now, odometry=odometry, status_doubt="", reopened_ns=None)

    def _on_revision(self, frame: Frame) -> None:
        found = revision_by_frame(frame.can_id, frame.data)
        if found is not None:
            self.tally.on_revision(*found, self._codec.revision.name, frame.t_ns)

    def _on_intruder(self, frame: Frame) -> None:
        if self._config.listen_only:
            return  # the frames of the bridge that drives
        detail = f"0x{frame.can_id:03X} [{frame.data.hex(' ').upper()}]"
        self.tally.intruders[frame.can_id] = frame.t_ns, detail
        self.tally.note(Reason.INTRUDER, detail)
        self._strike(Reason.INTRUDER, detail, frame.t_ns)

    def on_command(self, command: VehicleCommand, now_ns: int) -> tuple[str, ...]:
        """Take a command into the slot. A command that is not in order is refused whole, as if it had never come.

        Returns why; empty when it was taken.
        """
        state = self._state
        problems = command.problems(self._steer_limit_rad)
        ahead_ns = command.t_sensor_ns - now_ns
        if ahead_ns > self._config.sensor_future_ns:
            problems = (*problems, f"t_sensor_ns is {ahead_ns / 1e6:.0f} ms in the future")
        if problems:
            self.tally.note(Reason.COMMAND_REFUSED, "; ".join(problems))
            return problems
        if command.run_id != state.supervisor.run_id:
            problem = f"run_id {command.run_id} is not the present run ({state.supervisor.run_id})"
            if state.decision.may_move:  # before that a command of the last run is merely late
                self.tally.note(Reason.COMMAND_OTHER_RUN, problem)
            return (problem,)
        if state.bus_lost is not None:
            return (f"the bus is lost: {state.bus_lost}",)
        self._state = replace(state, command=command, command_ns=now_ns)
        return ()

    def on_reset_confirmed(self, role: str, run_id: int) -> None:
        """Planner or controller has forgotten everything before run `run_id`."""
        if role not in supervisor.ROLES:
            self.tally.problem(
                f"reset confirmed by {shortened(role, WORD_LENGTH)!r}: the roles are {', '.join(supervisor.ROLES)}"
            )
            return
        before = self._state.supervisor
        self._supervise(supervisor.confirm(before, role, run_id))
        if self._state.supervisor.stop is not before.stop:
            self.tally.note(Reason.STACK_RESTARTED, role)

    # ------------------------------------------------------------ what people ask

    def set_mode(self, mode: str, now_ns: int) -> tuple[bool, str]:
        """'manual' at any time; 'autonomous' in AS_INIT, AS_OFF and AS_READY."""
        supervising, done, message = supervisor.set_mode(self._config, self._state.supervisor, mode, now_ns)
        self._supervise(supervising)
        return done, message

    def emergency_brake(self, why: str, now_ns: int) -> tuple[bool, str]:
        """Latch ESTOP_REQUEST."""
        if self._config.listen_only:
            return False, "this process only listens (listen_only): it cannot ask for the emergency brake"
        if self.stopped:
            return False, "this software was stopped: it sends nothing any more"
        state = self._state
        before = state.supervisor.emergency
        why = shortened(why, DETAIL_LENGTH)
        self._supervise(supervisor.ask_emergency(state.supervisor, Asked.OPERATOR, why, now_ns))
        if before is not None:
            return True, f"already latched because {before.words}"
        if state.bus_lost is not None:
            return True, f"ESTOP_REQUEST is latched, but the bus is lost: {state.bus_lost}"
        return True, "ESTOP_REQUEST is latched"

    def reset(self, now_ns: int) -> tuple[bool, str]:
        """Clear the emergency latch, in AS_INIT and AS_OFF."""
        supervising, done, message = supervisor.reset(self._config, self._state.supervisor, now_ns)
        self._supervise(supervising)
        return done, message

    # ------------------------------------------------------------ what happens to the loop and the bus

    def bus_lost(self, why: str, now_ns: int) -> None:
        """The interface is gone, down or bus-off: silence until `bus_back`."""
        why = shortened(why, DETAIL_LENGTH)
        if self._state.bus_lost is None:
            self._lose_bus(why, now_ns)
            self._state = replace(self._state, bus_lost=why)

    def bus_back(self, now_ns: int) -> None:
        """The interface is open again. Silent until the car is received, but not for longer than it may be."""
        state = self._state
        if state.bus_lost is None:
            return
        supervising = supervisor.bus_back(state.supervisor, now_ns)
        wheels = replace(state.wheels, doubted_since_ns=None)  # nothing was checked meanwhile
        self._state = replace(
            state, supervisor=supervising, wheels=wheels, bus_lost=None, last_complete_ns=None, reopened_ns=now_ns
        )

    def loop_fault(self, why: str, now_ns: int) -> None:
        """The loop raised an exception, or missed a deadline by 50 ms."""
        why = shortened(why, DETAIL_LENGTH)
        self.tally.loop_faults += 1
        if self._state.supervisor.driving:  # a slow start of the machine, before anything drives, is no reason
            self.tally.note(Reason.LOOP_FAULT, why)
        self._strike(Reason.LOOP_FAULT, why, now_ns)

    def backlog(self, age_ns: int, now_ns: int) -> None:
        """The oldest frame that waited was `age_ns` old when the loop read it: from 20 ms on that is reported."""
        if age_ns >= self._config.backlog_ns:
            detail = f"the oldest was {age_ns / 1e6:.0f} ms old"
            self.tally.note(Reason.BACKLOG, detail)
            self._strike(Reason.BACKLOG, detail, now_ns)

    def begin_stop(self, now_ns: int) -> None:
        """Orderly end: at rest zeros and NEUTRAL, moving FORWARD with brake and ESTOP_REQUEST; then silence."""
        state = self._state
        if state.stop_cycles_left is not None:
            return
        silent = self._config.listen_only or state.bus_lost is not None or self._listening(now_ns)
        self._state = replace(
            state,
            supervisor=supervisor.begin_end(self._config, state.supervisor, now_ns),
            stop_cycles_left=0 if silent else self._config.stop_cycles,
        )

    @property
    def stopped(self) -> bool:
        """The orderly end is over: nothing is sent any more."""
        return self._state.stopped

    # ------------------------------------------------------------ the cycle

    def cycle(self, now_ns: int) -> AiCommand | None:
        """Return the command to send now; None: stay silent. The handshake is the last one received (safety rule 9)."""
        config, state = self._config, self.state
        vehicle, supervising = state.vehicle, state.supervisor
        odometry = self._moved(state)
        reopened_ns = state.reopened_ns
        if reopened_ns is not None and now_ns - reopened_ns >= config.vcu_lost_ns:
            reopened_ns = None
        if state.bus_lost is not None or reopened_ns is not None or state.stopped:
            self._state = replace(state, odometry=odometry, reopened_ns=reopened_ns)
            return None

        ending = state.stop_cycles_left is not None
        if ending:  # the car may have entered AS_DRIVING, or begun to roll, meanwhile
            supervising = supervisor.begin_end(config, supervising, now_ns)
        supervising, decision = supervisor.supervise(
            config,
            supervising,
            Inputs(
                now_ns,
                state.command,
                state.command_ns,
                None if vehicle.steer is None else vehicle.steer.t_rx_ns,
                state.steering.implausible_since_ns,
                state.wheels.implausible_since_ns,
                state.wheels.detail,
                state.status_doubt,
                state.speeds_doubt,
            ),
        )
        if ending:
            decision = supervisor.ending(decision)
        listening_since_ns = now_ns if state.listening_since_ns is None else state.listening_since_ns
        self._state = state = replace(
            state,
            supervisor=supervising,
            decision=decision,
            odometry=odometry,
            reopened_ns=None,
            listening_since_ns=listening_since_ns,
        )
        if config.listen_only or self._listening(now_ns):
            self.tally.activate(decision, decision.reasons)
            self.tally.unanswered_ns = None
            return None
        return self._ask(state, now_ns)

    def _ask(self, state: BridgeState, now_ns: int) -> AiCommand:
        """Pass this cycle's decision through the gate and return the command to send."""
        fresh = now_ns - state.command_ns < self._config.command_stale_ns
        gated, asked, reasons = gate(
            self._gate_config,
            state.gate,
            state.decision,
            state.command if fresh else None,
            state.vehicle,
            now_ns,
            state.odometry.motion.speed_mps,
        )
        self.tally.activate(state.decision, state.decision.reasons | reasons)
        self.tally.answered(now_ns)
        steering, wheels = self._checked(state, asked, now_ns)
        left = state.stop_cycles_left
        self._state = replace(
            state,
            gate=gated,
            asked=asked,
            steering=steering,
            wheels=wheels,
            # The 50 ms of a bus that takes nothing begin with the first try.
            last_complete_ns=now_ns if state.last_complete_ns is None else state.last_complete_ns,
            stop_cycles_left=None if left is None else left - 1,
        )
        return asked

    def on_sent(self, complete: bool, now_ns: int) -> None:
        """Take in whether all five frames of the last `cycle` went out."""
        state = self._state
        supervising, since_ns = state.supervisor, state.last_complete_ns
        gated = sent(state.gate, complete, now_ns)
        if complete:
            if state.asked.mission_status is MissionStatus.SELECTED:
                supervising = supervisor.on_selected_sent(supervising, state.decision.run_id)
            self._state = replace(state, supervisor=supervising, gate=gated, last_complete_ns=now_ns)
            return
        self._state = replace(state, gate=gated)
        self.tally.incomplete_cycles += 1
        if since_ns is not None and now_ns - since_ns >= self._config.send_lost_ns and supervising.driving:
            self._lose_bus(f"no complete cycle sent for {(now_ns - since_ns) / 1e6:.0f} ms", now_ns)
            self._state = replace(self._state, last_complete_ns=now_ns)

    def _listening(self, now_ns: int) -> bool:
        """Return true while a process that has just started listens before it sends."""
        since_ns = self._state.listening_since_ns
        return since_ns is None or now_ns - since_ns < self._config.listen_first_ns

    def _lose_bus(self, why: str, now_ns: int) -> None:
        state = self._state
        if state.supervisor.driving:
            self.tally.note(Reason.BUS_LOST, why)
        lost = supervisor.bus_lost(self._config, state.supervisor, why, now_ns)
        self._state = replace(state, supervisor=lost, command=None)

    def _strike(self, reason: Reason, detail: str, now_ns: int) -> None:
        self._supervise(supervisor.strike(self._state.supervisor, reason, detail, now_ns))

    def _supervise(self, supervising: SupervisorState) -> None:
        if supervising is not self._state.supervisor:
            self._state = replace(self._state, supervisor=supervising)

    def _moved(self, state: BridgeState) -> OdometryState:
        """Dead reckoning by the newest that the car has reported."""
        return advance(self._car, state.odometry, state.vehicle, state.gps)

    def _checked(self, state: BridgeState, asked: AiCommand, now_ns: int) -> tuple[SteeringCheck, WheelCheck]:
        """Compare what the car does with what it is asked for, as far as AS_DRIVING goes."""
        config, car, vehicle, wheels = self._config, self._car, state.vehicle, state.wheels
        if not state.supervisor.driving:
            return NEW_STEERING, forget_wheels(wheels)
        steering = check_steering(config, car, state.steering, asked.steer_deg, vehicle.steer, now_ns)
        if state.supervisor.mission not in _WHEELS_IN_THE_AIR:
            doubted = bool(state.speeds_doubt)
            wheels = check_wheels(config, car, wheels, asked, vehicle.speeds, vehicle.steer, now_ns, doubted=doubted)
        return steering, wheels

    # ------------------------------------------------------------ the snapshot

    @property
    def run(self) -> Run:
        """The run in hand, as planner and controller need it."""
        state = self._state.supervisor
        return Run(state.run_id, state.mission, state.as_state, self._state.decision.may_move and state.driving)

    def report(self, now_ns: int) -> BridgeReport:
        """Everything the bridge knows, immutable."""
        config, bridge, tally = self._config, self.state, self.tally
        state, vehicle, phase = bridge.supervisor, bridge.vehicle, bridge.decision.phase
        standing = supervisor.standing(config, state, now_ns)
        stop = state.stop
        circumstances = Circumstances(
            phase,
            bridge.asked,
            self._listening(now_ns),
            bridge.bus_lost,
            bridge.stopped,
            tally.received_wrongly(now_ns),
            bridge.command.note if bridge.command is not None and bridge.command.run_id == state.run_id else "",
        )
        return BridgeReport(
            t_ns=now_ns,
            mode=state.mode.value,
            run=self.run,
            vehicle=vehicle,
            gps=bridge.gps,
            command=bridge.asked,
            motion=bridge.odometry.motion,
            phase=phase.value,
            emergency=None if state.emergency is None else shortened(state.emergency.words),
            stopping=None if stop is None else shortened(stop.words),
            reasons=tuple(sorted(reason.slug for reason in tally.active)),
            reason_counts=MappingProxyType(dict(tally.counts)),
            reason_details=MappingProxyType(dict(tally.details)),
            why_not_driving=tuple(
                map(shortened, why_not_driving(config, state, vehicle, circumstances, now_ns)[:WHYS_KEPT])
            ),
            standing=standing,
            confirmed=tuple(role for role in supervisor.ROLES if role in state.confirmed),
            vcu_lost=supervisor.vcu_lost(config, state, now_ns),
            bus_lost=bridge.bus_lost,
            shutdown_requested=standing and vehicle.status is not None and vehicle.status.shutdown_request,
            listen_only=config.listen_only,
            limits=self._limits,
            cycles=tally.cycles,
            incomplete_cycles=tally.incomplete_cycles,
            vcu_gaps=tally.vcu_gaps,
            loop_faults=tally.loop_faults,
            response_ns=tally.response_ns,
            response_max_ns=tally.response_max_ns,
            rx_counts=MappingProxyType(dict(tally.rx)),
            problem_counts=MappingProxyType(dict(tally.problems)),
            ages_ns=MappingProxyType({name: _age_ns(getattr(vehicle, name), now_ns) for name in _AGES}),
            unknown=self._unknown,
        )


def _age_ns(image: Image | None, now_ns: int) -> int | None:
    return None if image is None else now_ns - image.t_rx_ns
