"""The bridge between an AI stack and the VCU: supervisor, gate, checks and odometry behind one façade.

A thin mutable shell round pure states; single-threaded, no clock, no socket. The loop on the car, the lockstep
simulation and the tests all drive this same object:

    on_frame, on_command, … whenever something arrives;
    cycle(now) -> what to send now, or None for silence; then on_sent(complete, now);
    report(now) -> an immutable snapshot.

Times are integer nanoseconds of the monotonic clock. `on_sent` matters: torque never rises unless complete cycles went
out before it (safety rule 1).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from types import MappingProxyType
from typing import Any

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.driving import Motion, Run
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision import supervisor, wheel_speeds
from fsai_vcu.core.supervision.changes import changes
from fsai_vcu.core.supervision.config import BridgeConfig, official_simulator
from fsai_vcu.core.supervision.gate import GateState, gate, gate_config, sent
from fsai_vcu.core.supervision.plausibility import (
    SteeringCheck,
    WheelCheck,
    check_steering,
    check_wheels,
    forget_steering,
    forget_wheels,
)
from fsai_vcu.core.supervision.readiness import Circumstances, why_not_driving
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.core.supervision.supervisor import Asked, Decision, Inputs, SupervisorState
from fsai_vcu.core.vehicle.odometry import Odometry
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    GPS_FIELD_OF,
    VEHICLE_FIELD_OF,
    AiCommand,
    GpsImu,
    VcuStatus,
    VehicleState,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.reserved import AI_IDS, STATUS_ID
from fsai_vcu.interface.revisions import TELLING_IDS, Revision, told_by_frame
from fsai_vcu.interface.specification import READY_WAIT_NS

__all__ = ["Bridge", "BridgeConfig", "BridgeReport", "official_simulator"]

_BELIEVED_FROM = 10  # frames in a row: interface specification v4.0 counts a loss in tens as well

_AGES = ("status", "drive_front", "drive_rear", "steer", "brake", "speeds", "counts", "log_dynamics", "log_status")

_PROBLEMS_KEPT = 100  # distinct texts: a fuzzed bus must not fill the memory
_OTHER_PROBLEMS = "other problems"

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
        self._codec = codec
        self._car = car
        self._config = config or BridgeConfig()
        self._limits = limits or UNLIMITED
        self._gate_config = gate_config(self._config, revision, car, limits)
        self._steer_limit_rad = math.radians(revision.steer_limit_deg)

        self._state = SupervisorState(run_id=first_run_id)
        self._gate = GateState()
        self._decision = Decision()
        self._steering = SteeringCheck()
        self._wheels = WheelCheck()
        self._belief = wheel_speeds.WheelBelief()
        self._speeds_doubt = ""  # why the newest 0x525 was not believed
        self._status_doubt = ""  # why the newest 0x520 is none that is known
        self._odometry = Odometry(car, now_ns=now_ns)
        self._motion = Motion(t_ns=now_ns)

        self._handshake = False
        self._images: dict[str, Any] = {}
        self._gps_images: dict[str, Any] = {}
        self._vehicle: VehicleState | None = VehicleState()
        self._gps: GpsImu | None = GpsImu()

        self._command: VehicleCommand | None = None
        self._command_ns = 0
        self._asked = AiCommand()

        self._listening_until_ns: int | None = None  # known from the first cycle on
        self._bus_lost: str | None = None
        self._reopened_until_ns: int | None = None  # after a bus loss: silent until 0x520 is heard, or this
        self._last_complete_ns: int | None = None
        self._stop_cycles_left: int | None = None  # None: no stop asked for

        self._active: frozenset[Reason] = frozenset()
        self._counts: Counter[str] = Counter()
        self._details: dict[str, str] = {}
        self._problems: Counter[str] = Counter()
        self._rx: Counter[int] = Counter()
        self._intruders: dict[int, tuple[int, str]] = {}  # by id: when last heard, and with what
        self._otherwise = 0  # frames in a row that tell of another revision
        self._other_revision = ""
        self._cycles = 0
        self._incomplete = 0
        self._vcu_gaps = 0
        self._loop_faults = 0
        self._unanswered_ns: int | None = None
        self._response_ns: int | None = None
        self._response_max_ns: int | None = None

    @property
    def config(self) -> BridgeConfig:
        return self._config

    # ------------------------------------------------------------ what arrives

    @property
    def vehicle(self) -> VehicleState:
        """What the car has said so far."""
        if self._vehicle is None:
            self._vehicle = VehicleState(handshake=self._handshake, status_known=not self._status_doubt, **self._images)
        return self._vehicle

    @property
    def gps(self) -> GpsImu:
        """What the PCAN-GPS has said so far."""
        if self._gps is None:
            self._gps = GpsImu(**self._gps_images)
        return self._gps

    def on_frame(self, frame: Frame) -> None:
        """A frame received at `frame.t_ns`. The process's own frames never come here."""
        if frame.error:
            return
        if not frame.extended:
            self._rx[frame.can_id] += 1
            if frame.can_id in AI_IDS:
                self._on_intruder(frame)
                return
            if frame.can_id in TELLING_IDS:
                self._on_revision(frame)
        decoded = self._codec.decode(frame)
        for problem in decoded.problems:
            self._count_problem(problem)
        if decoded.handshake is not None:
            self._handshake = decoded.handshake
            self._vehicle = None
            if self._unanswered_ns is None:
                self._unanswered_ns = frame.t_ns
        image = decoded.image
        if frame.can_id == STATUS_ID and not frame.extended and not frame.remote and not isinstance(image, VcuStatus):
            self._state = supervisor.heard(self._config, self._state, frame.t_ns)
            self._status_doubt = "; ".join(decoded.problems) or "it cannot be decoded"
            self._vehicle = None
        if image is None:
            return
        if type(image) is VcuStatus:
            self._on_status(image)
        elif type(image) is WheelSpeeds:
            if not self._believed(image):
                return
            self._state = supervisor.on_speeds(self._config, self._state, image)
        elif type(image) is WheelCounts:
            self._belief = wheel_speeds.on_counts(self._config, self._car, self._belief, image)
            self._state = supervisor.on_pulses(self._state, self._belief.pulses.turning_ns)
        field = VEHICLE_FIELD_OF.get(type(image))
        if field is not None:
            self._images[field] = image
            self._vehicle = None
        else:
            self._gps_images[GPS_FIELD_OF[type(image)]] = image
            self._gps = None

    def _believed(self, speeds: WheelSpeeds) -> bool:
        """Whether a frame of 0x525 counts: one that is not believed is treated like one that never came."""
        self._belief, doubt = wheel_speeds.on_speeds(self._config, self._belief, speeds)
        self._speeds_doubt = doubt
        if doubt:
            self._count_problem(f"VCU2AI_Speeds is not believed: {doubt}")
        return not doubt

    def _on_status(self, status: VcuStatus) -> None:
        before = self._state
        state = supervisor.on_status(self._config, before, status)
        self._state = state
        self._status_doubt = ""
        said = self._images.get("status")
        if state.driving and said is not None:
            for reason, detail in changes(said, status):
                self._note(reason, detail)
                self._state = supervisor.strike(self._state, reason, detail, status.t_rx_ns)
        self._reopened_until_ns = None
        if before.status_ns is not None and status.t_rx_ns - before.status_ns >= self._config.vcu_stale_ns:
            self._vcu_gaps += 1
        if before.driving and state.as_state in supervisor.IDLE_STATES:
            self._note(Reason.VCU_REBOOT, f"AS_DRIVING to {status.as_state.label}")
        if state.run_id != before.run_id:
            self._odometry.reset(status.t_rx_ns)
            self._motion = self._odometry.motion

    def _on_revision(self, frame: Frame) -> None:
        """Another revision than the one this bridge is set to is believed when it is heard again and again."""
        told = told_by_frame(frame.can_id, frame.data)
        ours = self._codec.revision.name
        if told is None:
            return
        if told[0] == ours:
            self._otherwise = 0
            return
        self._otherwise += 1
        if self._otherwise == _BELIEVED_FROM:
            self._other_revision = f"the car speaks interface revision {told[0]} ({told[1]}), this bridge {ours}"
            self._count_problem(self._other_revision)

    def _on_intruder(self, frame: Frame) -> None:
        if self._config.listen_only:
            return  # the frames of the bridge that drives
        detail = f"0x{frame.can_id:03X} [{frame.data.hex(' ').upper()}]"
        self._intruders[frame.can_id] = frame.t_ns, detail
        self._note(Reason.INTRUDER, detail)
        self._state = supervisor.strike(self._state, Reason.INTRUDER, detail, frame.t_ns)

    def on_command(self, command: VehicleCommand, now_ns: int) -> tuple[str, ...]:
        """Take a command into the slot. One that is not in order is refused whole, as if it had never come.

        Returns why; empty when it was taken.
        """
        problems = command.problems(self._steer_limit_rad)
        ahead_ns = command.t_sensor_ns - now_ns
        if ahead_ns > self._config.sensor_future_ns:
            problems = (*problems, f"t_sensor_ns is {ahead_ns / 1e6:.0f} ms in the future")
        if problems:
            self._note(Reason.COMMAND_REFUSED, "; ".join(problems))
            return problems
        if command.run_id != self._state.run_id:
            problem = f"run_id {command.run_id} is not the run in hand ({self._state.run_id})"
            if self._decision.may_move:  # before that a command of the last run is merely late
                self._note(Reason.COMMAND_OTHER_RUN, problem)
            return (problem,)
        if self._bus_lost is not None:
            return (f"the bus is lost: {self._bus_lost}",)
        self._command, self._command_ns = command, now_ns
        return ()

    def on_reset_confirmed(self, role: str, run_id: int) -> None:
        """Planner or controller has forgotten everything before run `run_id`."""
        if role not in supervisor.ROLES:
            self._count_problem(f"reset confirmed by {role!r}: the roles are {', '.join(supervisor.ROLES)}")
            return
        before = self._state
        self._state = supervisor.confirm(before, role, run_id)
        if self._state.stop is not before.stop:
            self._note(Reason.STACK_RESTARTED, role)

    # ------------------------------------------------------------ what people ask

    def set_mode(self, mode: str, now_ns: int) -> tuple[bool, str]:
        """'manual' at any time; 'autonomous' in AS_INIT, AS_OFF and AS_READY."""
        self._state, done, message = supervisor.set_mode(self._config, self._state, mode, now_ns)
        return done, message

    def emergency_brake(self, why: str, now_ns: int) -> tuple[bool, str]:
        """Latch ESTOP_REQUEST."""
        if self._config.listen_only:
            return False, "this process only listens (listen_only): it cannot ask for the emergency brake"
        if self.stopped:
            return False, "this software was stopped: it sends nothing any more"
        before = self._state.emergency
        self._state = supervisor.ask_emergency(self._state, Asked.OPERATOR, why, now_ns)
        if before is not None:
            return True, f"already latched because {before.words}"
        if self._bus_lost is not None:
            return True, f"ESTOP_REQUEST is latched, but the bus is lost: {self._bus_lost}"
        return True, "ESTOP_REQUEST is latched"

    def reset(self, now_ns: int) -> tuple[bool, str]:
        """Clear the emergency latch, in AS_INIT and AS_OFF."""
        self._state, done, message = supervisor.reset(self._config, self._state, now_ns)
        return done, message

    # ------------------------------------------------------------ what happens to the loop and the bus

    def bus_lost(self, why: str, now_ns: int) -> None:
        """The interface is gone, down or bus-off: silence until `bus_back`."""
        if self._bus_lost is not None:
            return
        self._bus_lost = why
        self._drop_command(why, now_ns)
        self._state = supervisor.bus_lost(self._config, self._state, why, now_ns)

    def bus_back(self, now_ns: int) -> None:
        """The interface is open again. Silent until the car is heard, but not for longer than it may be."""
        if self._bus_lost is None:
            return
        self._bus_lost = None
        self._last_complete_ns = None
        self._reopened_until_ns = now_ns + self._config.vcu_lost_ns
        self._state = supervisor.bus_back(self._state, now_ns)

    def loop_fault(self, why: str, now_ns: int) -> None:
        """The loop raised an exception, or missed a deadline by 50 ms."""
        self._loop_faults += 1
        if self._state.driving:  # a slow start of the machine, before anything drives, is no reason
            self._note(Reason.LOOP_FAULT, why)
        self._state = supervisor.strike(self._state, Reason.LOOP_FAULT, why, now_ns)

    def backlog(self, age_ns: int, now_ns: int) -> None:
        """The oldest frame that waited was `age_ns` old when the loop read it: from 20 ms on that is reported."""
        if age_ns >= self._config.backlog_ns:
            detail = f"the oldest was {age_ns / 1e6:.0f} ms old"
            self._note(Reason.BACKLOG, detail)
            self._state = supervisor.strike(self._state, Reason.BACKLOG, detail, now_ns)

    def begin_stop(self, now_ns: int) -> None:
        """Orderly end: at rest zeros and NEUTRAL, moving FORWARD with brake and ESTOP_REQUEST; then silence."""
        if self._stop_cycles_left is not None:
            return
        silent = self._config.listen_only or self._bus_lost is not None or self._listening(now_ns)
        self._stop_cycles_left = 0 if silent else self._config.stop_cycles
        self._state = supervisor.begin_end(self._config, self._state, now_ns)

    @property
    def stopped(self) -> bool:
        """The orderly end is over: nothing is sent any more."""
        return self._stop_cycles_left is not None and self._stop_cycles_left <= 0

    # ------------------------------------------------------------ the cycle

    def cycle(self, now_ns: int) -> AiCommand | None:
        """What to send now; None: stay silent. The handshake is the last one received (safety rule 9)."""
        config = self._config
        vehicle = self.vehicle
        self._motion = self._odometry.update(vehicle, self.gps)
        if self._reopened_until_ns is not None and now_ns >= self._reopened_until_ns:
            self._reopened_until_ns = None
        if self._bus_lost is not None or self._reopened_until_ns is not None or self.stopped:
            return None

        if self._stop_cycles_left is not None:  # the car may have entered AS_DRIVING, or begun to roll, meanwhile
            self._state = supervisor.begin_end(config, self._state, now_ns)
        self._state, decision = supervisor.supervise(
            config,
            self._state,
            Inputs(
                now_ns,
                self._command,
                self._command_ns,
                None if vehicle.steer is None else vehicle.steer.t_rx_ns,
                self._steering.implausible_since_ns,
                self._wheels.implausible_since_ns,
                self._wheels.detail,
                self._status_doubt,
                self._speeds_doubt,
            ),
        )
        if self._stop_cycles_left is not None:
            decision = supervisor.ending(decision)
        self._decision = decision

        if self._listening_until_ns is None:
            self._listening_until_ns = now_ns + config.listen_first_ns
        if config.listen_only or self._listening(now_ns):
            self._activate(decision, decision.reasons)
            self._unanswered_ns = None
            return None

        command = self._command
        if now_ns - self._command_ns >= config.command_stale_ns:
            command = None
        self._gate, asked, reasons = gate(
            self._gate_config, self._gate, decision, command, vehicle, now_ns, self._motion.speed_mps
        )
        self._activate(decision, decision.reasons | reasons)
        self._check(asked, vehicle, now_ns)
        self._asked = asked
        self._cycles += 1
        if self._last_complete_ns is None:
            self._last_complete_ns = now_ns  # the 50 ms of a bus that takes nothing begin with the first try
        if self._stop_cycles_left is not None:
            self._stop_cycles_left -= 1
        if self._unanswered_ns is not None:
            self._response_ns = max(0, now_ns - self._unanswered_ns)
            self._response_max_ns = max(self._response_ns, self._response_max_ns or 0)
            self._unanswered_ns = None
        return asked

    def on_sent(self, complete: bool, now_ns: int) -> None:
        """Whether all five frames of the last `cycle` went out."""
        self._gate = sent(self._gate, complete, now_ns)
        if complete:
            self._last_complete_ns = now_ns
            if self._asked.mission_status is MissionStatus.SELECTED:
                self._state = supervisor.on_selected_sent(self._state, self._decision.run_id)
            return
        self._incomplete += 1
        since = self._last_complete_ns
        if since is not None and now_ns - since >= self._config.send_lost_ns and self._state.driving:
            why = f"no complete cycle sent for {(now_ns - since) / 1e6:.0f} ms"
            self._drop_command(why, now_ns)
            self._state = supervisor.bus_lost(self._config, self._state, why, now_ns)
            self._last_complete_ns = now_ns

    def _listening(self, now_ns: int) -> bool:
        """On start a process listens, then sends."""
        return self._listening_until_ns is None or now_ns < self._listening_until_ns

    def _drop_command(self, why: str, now_ns: int) -> None:
        self._command = None
        if self._state.driving:
            self._note(Reason.BUS_LOST, why)

    def _check(self, asked: AiCommand, vehicle: VehicleState, now_ns: int) -> None:
        """Compare what the car does with what it is asked for, as far as AS_DRIVING goes."""
        if not self._state.driving:
            self._steering = forget_steering()
            self._wheels = forget_wheels(self._wheels)
            return
        self._steering = check_steering(self._config, self._car, self._steering, asked.steer_deg, vehicle.steer, now_ns)
        if self._state.mission not in _WHEELS_IN_THE_AIR:
            self._wheels = check_wheels(
                self._config, self._car, self._wheels, asked, vehicle.speeds, vehicle.steer, now_ns
            )

    # ------------------------------------------------------------ counting

    def _note(self, reason: Reason, detail: str = "") -> None:
        """Something that happened once."""
        self._counts[reason.slug] += 1
        self._details[reason.slug] = detail

    def _heard_wrongly(self, now_ns: int) -> tuple[str, ...]:
        """What should not be on the bus, in words."""
        # Named for as long as the car has to stand in AS_READY: who sends now and then is seen before Go.
        heard = [
            f"an intruder sends on our ids: {words}"
            for t_ns, words in self._intruders.values()
            if now_ns - t_ns < READY_WAIT_NS
        ]
        if self._otherwise >= _BELIEVED_FROM:
            heard.append(self._other_revision)
        return tuple(heard)

    def _activate(self, decision: Decision, reasons: frozenset[Reason]) -> None:
        """The reasons active in this cycle; each is counted when it comes up, not for as long as it lasts."""
        for reason, detail in decision.details:
            self._details[reason.slug] = detail
        if reasons != self._active:
            for reason in reasons - self._active:
                self._counts[reason.slug] += 1
            self._active = reasons

    def _count_problem(self, problem: str) -> None:
        if problem not in self._problems and len(self._problems) >= _PROBLEMS_KEPT:
            problem = _OTHER_PROBLEMS
        self._problems[problem] += 1

    # ------------------------------------------------------------ the snapshot

    @property
    def run(self) -> Run:
        """The run in hand, as planner and controller need it."""
        state = self._state
        return Run(state.run_id, state.mission, state.as_state, self._decision.may_move and state.driving)

    def report(self, now_ns: int) -> BridgeReport:
        """Everything the bridge knows, immutable."""
        config, state, vehicle = self._config, self._state, self.vehicle
        standing = supervisor.standing(config, state, now_ns)
        stop = state.stop
        circumstances = Circumstances(
            self._decision.phase,
            self._listening(now_ns),
            self._bus_lost,
            self.stopped,
            self._heard_wrongly(now_ns),
        )
        return BridgeReport(
            t_ns=now_ns,
            mode=state.mode.value,
            run=self.run,
            vehicle=vehicle,
            gps=self.gps,
            command=self._asked,
            motion=self._motion,
            phase=self._decision.phase.value,
            emergency=None if state.emergency is None else state.emergency.words,
            stopping=None if stop is None else stop.words,
            reasons=tuple(sorted(reason.slug for reason in self._active)),
            reason_counts=MappingProxyType(dict(self._counts)),
            reason_details=MappingProxyType(dict(self._details)),
            why_not_driving=why_not_driving(config, state, vehicle, circumstances, now_ns),
            standing=standing,
            confirmed=tuple(role for role in supervisor.ROLES if role in state.confirmed),
            vcu_lost=supervisor.vcu_lost(config, state, now_ns),
            bus_lost=self._bus_lost,
            shutdown_requested=standing and vehicle.status is not None and vehicle.status.shutdown_request,
            listen_only=config.listen_only,
            limits=self._limits,
            cycles=self._cycles,
            incomplete_cycles=self._incomplete,
            vcu_gaps=self._vcu_gaps,
            loop_faults=self._loop_faults,
            response_ns=self._response_ns,
            response_max_ns=self._response_max_ns,
            rx_counts=MappingProxyType(dict(self._rx)),
            problem_counts=MappingProxyType(dict(self._problems)),
            ages_ns=MappingProxyType(dict(self._ages(now_ns))),
            unknown=self._codec.unknown,
        )

    def _ages(self, now_ns: int) -> Iterable[tuple[str, int | None]]:
        for name in _AGES:
            image = self._images.get(name)
            yield name, None if image is None else now_ns - image.t_rx_ns
