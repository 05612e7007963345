"""The car's vehicle control unit, simulated: what it receives from the AI computer, decides, orders and sends.

Pure: frames and sensor readings in, frames and orders out, time an argument in integer nanoseconds. The state machine
is the table of `as_machine.py`, the link's supervision `ai_link.py`, the power-up `power.py`, and how a VCU may differ
`profiles.py`; this file puts them together.

Source: the vehicle's interface specification v4.0 (2021) and the signal databases and documents of 2026.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import groupby
from operator import attrgetter, itemgetter
from types import MappingProxyType
from typing import Any, Final, NamedTuple, cast

from fsai_hil.simulator.ai_link import AiLink
from fsai_hil.simulator.as_machine import AI_COMMS_LOST, CAR_FAULTS, Row, Situation, ai_faults, taken, transition_table
from fsai_hil.simulator.car_signals import Actuation, CarFeedback, limited
from fsai_hil.simulator.faults import FaultyWire
from fsai_hil.simulator.gps_device import GPS_NAMES, PcanGps
from fsai_hil.simulator.power import (
    EBS_STATUS,
    INITIAL_ACTIONS_NS,
    POWER_UP,
    SELF_TEST_NS,
    SHUTDOWN_NS,
    TS_LIVE,
    Subsystem,
    SystemAction,
    SystemState,
)
from fsai_hil.simulator.profiles import SPECIFICATION, Profile
from fsai_hil.simulator.switches import ASSI, READY_BLUE_NS, SWITCH_NAMES, Assi, Switches
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.bus_table import BY_NAME
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import (
    AsState,
    BrakeStatus,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    FAULT_NAMES,
    AiBrake,
    AiDriveFront,
    AiDriveRear,
    AiImage,
    AiStatus,
    AiSteer,
    Faults,
    Image,
    LogDynamics1,
    LogStatus,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    VcuSystemStatus,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import Revision
from fsai_vcu.interface.specification import AXLE_TORQUE_MAX_NM, WHEEL_SPEED_MAX_RPM
from fsai_vcu.interface.units import KMH_PER_MPS, MS
from fsai_vcu.interface.values import Value

REMOTE: Final = BY_NAME["RES_TPDO"]  # of the remote E-stop's receiver on the car
# Each device hands its frames to the bus at once, and the bus puts them one behind the other.
GPS_PHASE_NS: Final = 2_500_000  # after the VCU's own frames; the remote's receiver too


class Transition(Value, frozen=True):
    """One change of the AS state and what brought it about."""

    t_ns: int
    source: AsState
    target: AsState
    why: str

    def __str__(self) -> str:
        return f"{self.source.label} -> {self.target.label}: {self.why}"


class _Burst(NamedTuple):
    """Messages that a device hands to the bus together, in this order."""

    names: tuple[str, ...]
    period_ns: int
    phase_ns: int
    frames: Callable[[SimulatedVcu, Sequence[str], int], list[Frame]]


class SimulatedVcu:
    """A VCU on a car's bus.

    Set `switches`, hand it the AI computer's frames, call `step` at least once a millisecond (or at `next_due_ns()`)
    with what the car's sensors read; do what `actuation` orders. Faults of the wire go into `outgoing` (what the VCU,
    the PCAN-GPS and the remote's receiver say) and `incoming` (what it receives).

    `gps_decimation` and `log_decimation` stretch the periods of the PCAN-GPS's and the logging frames on machines that
    cannot carry them all. Raises ValueError for an interface revision whose power-up is not known.
    """

    def __init__(
        self,
        codec: Codec,
        revision: Revision,
        profile: Profile = SPECIFICATION,
        now_ns: int = 0,
        gps: bool = True,
        gps_decimation: int = 1,
        log_decimation: int = 1,
    ) -> None:
        """Begin without power. Raises ValueError for a revision or a decimation that cannot be simulated."""
        if revision.name not in POWER_UP:
            raise ValueError(f"no power-up is known for revision {revision.name!r}: only for {', '.join(POWER_UP)}")
        if gps_decimation < 1 or log_decimation < 1:
            raise ValueError("a decimation is 1 or more")
        self.codec = codec
        self.revision = revision
        self.power_up = POWER_UP[revision.name]
        self.switches = Switches()
        self.incoming = FaultyWire()
        self.outgoing = FaultyWire()
        self.transitions: list[Transition] = []
        self.history: list[tuple[int, AsState]] = [(now_ns, self.power_up.first_state)]
        self.response_times_ns: list[int] = []
        self.comms_losses = 0  # how often AI_COMMS_LOST was raised
        self.power_cycles = 0
        self._now_ns = now_ns
        self._feedback = CarFeedback()
        self.behave(profile)
        self._bursts = self._cyclic_bursts(gps, gps_decimation, log_decimation)
        self.powered = False  # low voltage is on: the VCU runs and sends
        self._ebs_closed_itself = False
        self._begin(now_ns)

    def behave(self, profile: Profile) -> None:
        """Behave otherwise from now on, as far as the state machine goes."""
        self.profile = profile
        self._table = transition_table(profile)
        self._ai_faults = ai_faults(profile)

    # ------------------------------------------------------------ what it receives

    def on_frame(self, frame: Frame) -> None:
        """A frame of the AI computer has arrived, at its `t_ns`."""
        for arrived in self.incoming.through((frame,), frame.t_ns):
            self._receive(arrived)

    def _receive(self, frame: Frame) -> None:
        if not self.powered or frame.can_id not in AI_IDS:
            return
        if "aims" in self.power_up.switches_on and not self.switches.aims:
            return  # an AI computer without power sends nothing
        image = self.codec.decode(frame).image
        if image is None:
            return  # a malformed message is a missing one
        self._now_ns = max(self._now_ns, frame.t_ns)
        self._link.on_image(cast(AiImage, image), frame.t_ns)
        # the VCU sees the five messages one after another: what meets between two of them has met
        if self._heard.get(frame.can_id) != frame.data:
            self._heard[frame.can_id] = frame.data
            self._look(self._now_ns)

    # ------------------------------------------------------------ what it does

    def step(self, now_ns: int, feedback: CarFeedback) -> list[Frame]:
        """Live on until `now_ns`, where the sensors read `feedback`; returns the frames sent, each with its time."""
        self._feedback = feedback
        for arrived in self.incoming.through((), now_ns):
            self._receive(arrived)
        self._now_ns = now_ns
        if self.switches.lvms != self.powered:
            if self.switches.lvms:
                self._begin(now_ns)
                self.powered = True
            else:
                self._power_off(now_ns)
        sent: list[Frame] = []
        if self.powered:
            due = self._due
            self._look(now_ns, cycle=any(order == 0 and t_ns <= now_ns for t_ns, order in due))
            while due and due[0][0] <= now_ns:
                t_ns, order = due[0]
                burst = self._bursts[order]
                heapq.heapreplace(due, (t_ns + burst.period_ns, order))
                sent += burst.frames(self, burst.names, t_ns)
        return self.outgoing.through(sent, now_ns)

    def next_due_ns(self) -> int:
        """Return when the next frame is due; a millisecond from now while the VCU has no power."""
        return self._due[0][0] if self.powered else self._now_ns + MS

    def _begin(self, now_ns: int) -> None:
        """Everything as it is when low voltage comes on."""
        self._powered_ns = now_ns
        self._link = AiLink(self.profile)
        self._link.response_times_ns = self.response_times_ns
        self._comms_were_lost = False
        self._tractive_system = Subsystem(TsState.TS_INIT, now_ns)
        self._ebs = Subsystem(EbsState.EBS_INIT, now_ns)
        self._device = PcanGps(self.codec, now_ns)
        self._situation = Situation()
        self._set_so: tuple[Any, ...] = ()  # the switches, as the situation has them
        self._heard: dict[int, bytes] = {}  # the last payload of each of the AI computer's messages
        self._latched: set[str] = set()
        self.shutdown_cause = ShutdownCause.NO_SHUTDOWN
        self.state = self.power_up.first_state
        self._state_since_ns = now_ns
        self._go_before = True  # a Go that is on while the VCU starts is no rising edge
        self.power_cycle_needed = False  # the car will not get ready again before LVMS has been off
        self._activated = False
        self._tsms_was_on = False
        self._shutdown_since_ns: int | None = None
        self._held_steer_deg = self._feedback.steer_deg
        begin_ns = now_ns + INITIAL_ACTIONS_NS
        self._due = sorted((begin_ns + burst.phase_ns, order) for order, burst in enumerate(self._bursts))

    def _power_off(self, now_ns: int) -> None:
        """Low voltage goes: an EBS under pressure closes the brakes by itself, until it is armed again."""
        self._ebs_closed_itself |= self._ebs.state in (EbsState.EBS_ARMED, EbsState.EBS_TRIGGERED)
        self.powered = False
        self.power_cycles += 1
        self._change(now_ns, self.power_up.first_state, "LVMS off")

    # ------------------------------------------------------------ deciding

    def _look(self, now_ns: int, *, cycle: bool = False) -> None:
        """Look at everything once: subsystems first, then one row of the state machine.

        cycle: the VCU's own is due, in which it sends; else a frame has come, or time has passed.
        """
        switches, link, s = self.switches, self._link, self._situation
        comms_lost = link.lost(now_ns)
        if comms_lost and not self._comms_were_lost:
            self.comms_losses += 1
        self._comms_were_lost = comms_lost
        sdc_open = self.sdc_open
        self._follow_power(now_ns, sdc_open)

        rpm = self._feedback.wheel_rpm
        s.fastest_wheel_rpm = max(rpm)
        s.slowest_wheel_rpm = min(rpm)
        s.steer_deg = self._feedback.steer_deg
        set_so = _seen_of(switches)
        if set_so != self._set_so:
            self._set_so = set_so
            for name, value in zip(SEEN_OF_THE_SWITCHES, set_so, strict=True):
                setattr(s, name, value)
        s.go = self.go_signal
        s.go_rising = s.go and not self._go_before
        self._go_before = s.go
        s.sdc_open = sdc_open
        s.ebs_armed = self._ebs.state is EbsState.EBS_ARMED
        s.tractive_system_running = self._ts_running
        s.power_cycle_needed = self.power_cycle_needed
        s.comms_lost = comms_lost
        s.estop_request, s.direction = link.status.estop_request, link.status.direction
        if cycle or self.profile.pedals_judged_by_frame:
            s.torque_requested = link.drive_front.torque_nm > 0.0 or link.drive_rear.torque_nm > 0.0
            s.brake_requested = link.brake.front_pct > 0.0 or link.brake.rear_pct > 0.0
        s.steer_requested = link.steer.steer_deg != 0.0
        # what was received before the link was lost acknowledges nothing
        s.mission_status = MissionStatus.NOT_SELECTED if comms_lost else link.status.mission_status
        in_state_ns = now_ns - self._state_since_ns
        s.ready_wait_over = in_state_ns >= self.profile.ready_wait_ns
        s.emergency_timer_over = in_state_ns >= self.profile.emergency_timer_ns

        row = taken(self._table, self.state, s)
        if row is not None:
            self._take(row, now_ns)

    def _take(self, row: Row, now_ns: int) -> None:
        """Take a transition: latch its fault, and enter its target."""
        if row.fault is not None:
            self._latched.add(row.fault.name)
            self.shutdown_cause = row.fault.cause
        if row.target is AsState.EMERGENCY_BRAKE:
            self.power_cycle_needed = True
        if self.state is AsState.AS_FINISHED and "lvms" in self.power_up.switches_off:
            self.power_cycle_needed = True
        if row.reset:
            self._latched.clear()
            self.shutdown_cause = ShutdownCause.NO_SHUTDOWN
            self.power_cycle_needed = False
        if self.state is AsState.AS_DRIVING:
            self._held_steer_deg = self._steer_target_deg()
        elif self.state is AsState.AS_READY:
            self._held_steer_deg = 0.0
        self._change(now_ns, row.target, row.why)
        self._follow_power(now_ns, self.sdc_open)

    def _change(self, now_ns: int, target: AsState, why: str) -> None:
        if target is not self.state:
            self.transitions.append(Transition(now_ns, self.state, target, why))
            self.history.append((now_ns, target))
        self.state = target
        self._state_since_ns = now_ns

    def _follow_power(self, now_ns: int, sdc_open: bool) -> None:
        """Shutdown, tractive system and EBS follow the switches, the shutdown circuit and the state."""
        switches = self.switches
        if switches.tsms:
            self._tsms_was_on = True
        elif self._tsms_was_on and self._shutdown_since_ns is None:
            self._shutdown_since_ns = now_ns
        if not self._activated:
            self._activated = not self._booting(now_ns) and self._link.valid(now_ns)
        emergency = self.state is AsState.EMERGENCY_BRAKE
        alive = (
            self._activated
            and switches.tsms
            and self._shutdown_since_ns is None
            and not sdc_open
            and not emergency
            and not self.power_cycle_needed
        )
        ts_fault = switches.bms_fault or switches.hvil_open or switches.hvil_short
        self._tractive_system.update(now_ns, alive, TsState.TS_FAULT if ts_fault else None)
        ebs_forced = EbsState.EBS_TRIGGERED if emergency else EbsState.EBS_FAULT if switches.ebs_fault else None
        self._ebs.update(now_ns, alive and switches.asms, ebs_forced)
        self._ebs_closed_itself &= self._ebs.state is not EbsState.EBS_ARMED

    def _booting(self, now_ns: int) -> bool:
        return now_ns - self._powered_ns < INITIAL_ACTIONS_NS + SELF_TEST_NS

    # ------------------------------------------------------------ what can be read

    @property
    def in_state_ns(self) -> int:
        return self._now_ns - self._state_since_ns

    @property
    def go_signal(self) -> bool:
        """The remote's Go as the VCU receives it."""
        return self.switches.go and self.switches.remote_radio_ok

    @property
    def sdc_open(self) -> bool:
        """Interface specification v4.0: what opens the shutdown circuit."""
        s = self.switches
        stopped = s.remote_estop or not s.remote_radio_ok or s.car_estop or s.crash or not s.dongle
        return stopped or self._broken

    @property
    def _broken(self) -> bool:
        """A critical fault of the VCU or the battery."""
        s = self.switches
        charging = s.offboard_charger_fault or s.charge_procedure_fault
        return s.hvil_open or s.hvil_short or s.ebs_fault or s.bms_fault or charging

    @property
    def _ts_running(self) -> bool:
        return self._tractive_system.state is TsState.TS_RUNNING

    @property
    def _ebs_status(self) -> EbsStatus:
        return EBS_STATUS.get(self._ebs.state, EbsStatus.UNAVAILABLE)

    @property
    def comms_lost(self) -> bool:
        """AI_COMMS_LOST now."""
        return self.powered and self._link.lost(self._now_ns)

    @property
    def faults(self) -> Faults:
        """The fault bits of 0x520: those that stopped the car until power is cycled, and those that are there now."""
        shown = self._latched | {fault.name for fault in CAR_FAULTS if fault.when(self.switches)}
        if self.comms_lost:
            shown |= {AI_COMMS_LOST.name}
        return _shown(frozenset(shown))

    @property
    def system_state(self) -> SystemState:
        """SM_SYS of 0x120."""
        since_ns = self._now_ns - self._powered_ns
        if since_ns < INITIAL_ACTIONS_NS:
            return SystemState.INITIAL_ACTIONS
        if since_ns < INITIAL_ACTIONS_NS + SELF_TEST_NS:
            return SystemState.POWER_ON_SELF_TEST
        if self._shutdown_since_ns is not None:
            return SystemState.SHUTDOWN_OFF if self.shut_down else SystemState.SHUTDOWN
        if not self._activated:
            return SystemState.AUX
        if self._ts_running or self.state is not AsState.AS_OFF or self.power_cycle_needed:
            return SystemState.DRIVE_AUTONOMOUS
        return SystemState.POWERTRAIN_ENABLE

    @property
    def mission_selectable(self) -> bool:
        """The display offers the missions: the VCU is ready to drive autonomously and no mission is under way."""
        return self.powered and self.state is AsState.AS_OFF and self._ts_running and self._shutdown_since_ns is None

    @property
    def shut_down(self) -> bool:
        """SHUTDOWN_OFF: the low-voltage master switch may be turned off."""
        return not self.powered or (
            self._shutdown_since_ns is not None and self._now_ns - self._shutdown_since_ns >= SHUTDOWN_NS
        )

    @property
    def assi(self) -> Assi:
        """The light of the AS state, dark without low voltage."""
        over_ns = self.in_state_ns - self.profile.ready_wait_ns
        if self.state is AsState.AS_READY and 0 <= over_ns < READY_BLUE_NS:
            return Assi.YELLOW_AND_BLUE
        return ASSI[self.state]

    @property
    def siren(self) -> bool:
        """The siren sounds in an emergency."""
        return self.state is AsState.EMERGENCY_BRAKE and self.in_state_ns < self.profile.emergency_timer_ns

    # ------------------------------------------------------------ what it orders

    @property
    def torque_max_nm(self) -> tuple[float, float]:
        """FRONT_ and REAR_AXLE_TRQ_MAX: nothing without the tractive system or without a motor."""
        if not (self.powered and self._ts_running):
            return 0.0, 0.0
        derated = self.switches.torque_limit_nm
        most = AXLE_TORQUE_MAX_NM if derated is None else limited(derated, AXLE_TORQUE_MAX_NM, 0.0)
        return (most if CARS[self.revision.name].driven_front else 0.0), most

    @property
    def steer_max_deg(self) -> float:
        """ANGLE_MAX."""
        derated, most = self.switches.steer_limit_deg, self.revision.steer_limit_deg
        return most if derated is None else limited(derated, most, 0.0)

    def _steer_target_deg(self) -> float:
        target = limited(self._link.steer.steer_deg, self.steer_max_deg)
        return float(round(target)) if self.profile.whole_degree_steering else target

    @property
    def actuation(self) -> Actuation:
        """The orders of this instant.

        Torque and steering requests count only in AS_DRIVING. Before it the wheels are held straight; after it, where
        they were. The brake request counts always; the EBS closes the brakes whatever is asked.
        """
        if not self.powered:
            return Actuation(steer_deg=self._held_steer_deg, ebs_engaged=self._ebs_closed_itself)
        link, state, profile = self._link, self.state, self.profile
        closed = self._ebs_closed_itself or state is AsState.EMERGENCY_BRAKE
        brake = link.brake
        front_brake, rear_brake = brake.front_pct, brake.rear_pct
        if closed or (profile.brakes_fully_when_neutral and link.status.direction is Direction.NEUTRAL):
            front_brake = rear_brake = 100.0
        live = self._tractive_system.state in TS_LIVE
        if state is not AsState.AS_DRIVING:
            steer = 0.0 if state is AsState.AS_READY else self._held_steer_deg
            return Actuation(steer, 0.0, 0.0, 0, 0, front_brake, rear_brake, closed, live)
        front_torque = rear_torque = 0.0
        braking = front_brake > 0.0 or rear_brake > 0.0  # interface specification v4.0: braking has priority
        if link.status.direction is Direction.FORWARD and not braking:
            front_max, rear_max = self.torque_max_nm
            rear_torque = min(rear_max, link.drive_rear.torque_nm)
            if not profile.rear_torque_only:
                front_torque = min(front_max, link.drive_front.torque_nm)
        return Actuation(
            self._steer_target_deg(),
            front_torque,
            rear_torque,
            link.drive_front.motor_speed_max_rpm,
            link.drive_rear.motor_speed_max_rpm,
            front_brake,
            rear_brake,
            False,
            live,
        )

    # ------------------------------------------------------------ what it sends

    def _cyclic_bursts(self, gps: bool, gps_decimation: int, log_decimation: int) -> tuple[_Burst, ...]:
        """Everything that is sent in this revision, 0x520 first."""
        decimation = dict.fromkeys((LogDynamics1.dbc_name, LogStatus.dbc_name), log_decimation)
        decimation |= dict.fromkeys(GPS_NAMES, gps_decimation)
        revision = self.revision.name
        bursts: list[_Burst] = []
        for names, phase_ns, frames in (
            (tuple(BUILDERS), 0, SimulatedVcu._own_frames),
            (GPS_NAMES if gps else (), GPS_PHASE_NS, SimulatedVcu._gps_frames),
            ((REMOTE.name,), GPS_PHASE_NS, SimulatedVcu._remote_frames),
        ):
            sent = [
                (BY_NAME[name].period_ns[revision] * decimation.get(name, 1), name)
                for name in names
                if revision in BY_NAME[name].period_ns
            ]
            for period_ns, together in groupby(sent, itemgetter(0)):
                bursts.append(_Burst(tuple(name for _, name in together), period_ns, phase_ns, frames))
        return tuple(bursts)

    def _own_frames(self, names: Sequence[str], t_ns: int) -> list[Frame]:
        encode = self.codec.encode
        return [encode(BUILDERS[name](self, t_ns)) for name in names]

    def _gps_frames(self, names: Sequence[str], t_ns: int) -> list[Frame]:
        return self._device.frames(names, t_ns, self._feedback)

    def _remote_frames(self, names: Sequence[str], t_ns: int) -> list[Frame]:
        """0x181 of the remote's receiver on the car, which sends on when it no longer receives the remote.

        The signal database calls ESTOP_STATUS 1 ON and does not say whether that is pressed: here it is.
        """
        switches = self.switches
        strength_pct = 100 if switches.remote_radio_ok else 0
        pressed = switches.remote_estop | self.go_signal << 1
        return [Frame(REMOTE.can_id, bytes((pressed, 0, 0, 0, 0, 0, strength_pct, 0)), t_ns)]

    def _status_image(self, t_ns: int) -> VcuStatus:
        """Return the 0x520 of now."""
        s, profile = self.switches, self.profile
        shutting_down = self._shutdown_since_ns is not None
        hidden = profile.as_state_zero_without_asms and not s.asms
        ops = self.power_up.sends_op_states
        return VcuStatus(
            handshake=self._link.next_bit(t_ns),
            shutdown_request=shutting_down,
            as_switch=s.asms,
            ts_switch=s.tsms,
            go_signal=self.go_signal,
            steering_status=SteeringStatus.ACTIVE if self._steering_active() else SteeringStatus.OFF,
            as_state=AsState.AS_INIT if hidden else self.state,
            ami=s.ami,
            fault=bool(self._latched) or self.comms_lost or self._broken,
            warning=s.batt_temp_high or s.batt_soc_low,
            warn_batt_temp_high=s.batt_temp_high,
            warn_batt_soc_low=s.batt_soc_low,
            faults=self.faults,
            shutdown_cause=self.shutdown_cause,
            op_state=self._op_state(t_ns) if ops else None,
            ts_state=self._tractive_system.state if ops else None,
            ebs_state=self._ebs.state if ops else None,
            t_rx_ns=t_ns,
        )

    def _op_state(self, t_ns: int) -> OpState:
        """This car only ever drives autonomously."""
        if self._booting(t_ns):
            return OpState.OP_INIT
        return OpState.OP_FAULT if self._broken else OpState.OP_AUTO

    def _steering_active(self) -> bool:
        return (
            self.switches.asms
            and not self.switches.steering_fault
            and self._ts_running
            and self.state is not AsState.EMERGENCY_BRAKE
        )

    def _drive_front_image(self, t_ns: int) -> VcuDriveFront:
        measured, asked, most = self._feedback.front_torque_nm, self._link.drive_front.torque_nm, AXLE_TORQUE_MAX_NM
        return VcuDriveFront(limited(measured, most), min(most, asked), self.torque_max_nm[0], t_ns)

    def _drive_rear_image(self, t_ns: int) -> VcuDriveRear:
        measured, asked, most = self._feedback.rear_torque_nm, self._link.drive_rear.torque_nm, AXLE_TORQUE_MAX_NM
        return VcuDriveRear(limited(measured, most), min(most, asked), self.torque_max_nm[1], t_ns)

    def _steer_image(self, t_ns: int) -> VcuSteer:
        most = self.revision.steer_limit_deg
        angle, request = limited(self._feedback.steer_deg, most), limited(self._link.steer.steer_deg, most)
        return VcuSteer(angle, self.steer_max_deg, request, t_ns)

    def _brake_image(self, t_ns: int) -> VcuBrake:
        known = self.profile.sends_brake_and_ebs_status
        requested = self._link.brake
        return VcuBrake(
            limited(self._feedback.front_brake_pct, 100.0, 0.0),
            limited(requested.front_pct, 100.0, 0.0),
            limited(self._feedback.rear_brake_pct, 100.0, 0.0),
            limited(requested.rear_pct, 100.0, 0.0),
            self._brake_status(t_ns) if known else BrakeStatus.INITIALISING,  # 0 on the wire
            self._ebs_status if known else None,
            t_ns,
        )

    def _brake_status(self, t_ns: int) -> BrakeStatus:
        if self.switches.brake_fault:
            return BrakeStatus.FAULT
        if self._booting(t_ns):
            return BrakeStatus.INITIALISING
        if self._shutdown_since_ns is None:
            return BrakeStatus.READY
        return BrakeStatus.SHUTDOWN_COMPLETE if self.shut_down else BrakeStatus.SHUTTING_DOWN

    def _speeds_image(self, t_ns: int) -> WheelSpeeds:
        return WheelSpeeds(*[round(limited(rpm, WHEEL_SPEED_MAX_RPM, 0.0)) for rpm in self._feedback.wheel_rpm], t_ns)

    def _system_image(self, t_ns: int) -> VcuSystemStatus:
        """Return the system status of now."""
        link = self._link
        # the AI computer's faults do not stop the car outside AS_DRIVING: there they are warnings
        warned = {fault.name: fault.when(self._situation) for fault in self._ai_faults}
        state = self.system_state
        if state <= SystemState.AUX:
            action = SystemAction.INITIALISE
        else:
            ending = state in (SystemState.SHUTDOWN, SystemState.SHUTDOWN_OFF)
            action = SystemAction.SHUTDOWN if ending else SystemAction.DRIVE_AUTO
        return VcuSystemStatus(
            sm_sys=state,
            sm_as=self.state,
            sys_action_state=action,
            status_timeout=link.missing(AiStatus, t_ns),
            drive_front_timeout=link.missing(AiDriveFront, t_ns),
            drive_rear_timeout=link.missing(AiDriveRear, t_ns),
            steer_timeout=link.missing(AiSteer, t_ns),
            brake_timeout=link.missing(AiBrake, t_ns),
            handshake_timeout=link.echo_missing(t_ns),
            warn_brake_plausibility=warned["brake_plausibility"],
            warn_ai_estop_req=warned["ai_estop_request"],
            warn_ai_comms_lost=warned["ai_comms_lost"],
            warn_auto_braking=warned["autonomous_braking"],
            warn_mission_status=warned["mission_status"],
            t_rx_ns=t_ns,
        )

    def _log_dynamics_image(self, t_ns: int) -> LogDynamics1:
        order, car = self.actuation, self._feedback
        return LogDynamics1(
            speed_actual_kmh=round(car.speed_mps * KMH_PER_MPS),
            speed_target_kmh=self._link.status.speed_demand_kmh,
            steer_actual_deg=car.steer_deg,
            steer_target_deg=order.steer_deg,
            brake_actual_pct=round(max(car.front_brake_pct, car.rear_brake_pct)),
            brake_target_pct=round(max(order.front_brake_pct, order.rear_brake_pct)),
            torque_actual_pct=_torque_pct(car),
            torque_target_pct=_torque_pct(order),
            t_rx_ns=t_ns,
        )

    def _log_status_image(self, t_ns: int) -> LogStatus:
        """Return the logging frame of the status as it is now."""
        status = self._link.status
        braking = max(self._feedback.front_brake_pct, self._feedback.rear_brake_pct) > 0.0
        ready = self._brake_status(t_ns) is BrakeStatus.READY
        return LogStatus(
            assi=max(int(self.state), int(AsState.AS_OFF)),
            ebs=self._ebs_status,
            ami=self.switches.ami,
            steering=int(self._steering_active()),
            service_brake=LOG_BRAKE_ENGAGED if braking else LOG_BRAKE_AVAILABLE if ready else LOG_BRAKE_DISENGAGED,
            lap_counter=status.lap_counter,
            cones_count_actual=status.cones_count_actual,
            cones_count_all=status.cones_count_all,
            t_rx_ns=t_ns,
        )


BUILDERS: Final[Mapping[str, Callable[[SimulatedVcu, int], Image]]] = MappingProxyType(
    {
        VcuStatus.dbc_name: SimulatedVcu._status_image,
        VcuDriveFront.dbc_name: SimulatedVcu._drive_front_image,
        VcuDriveRear.dbc_name: SimulatedVcu._drive_rear_image,
        VcuSteer.dbc_name: SimulatedVcu._steer_image,
        VcuBrake.dbc_name: SimulatedVcu._brake_image,
        WheelSpeeds.dbc_name: SimulatedVcu._speeds_image,
        WheelCounts.dbc_name: lambda vcu, t_ns: WheelCounts(*[each & 0xFFFF for each in vcu._feedback.pulses], t_ns),
        VcuSystemStatus.dbc_name: SimulatedVcu._system_image,
        LogDynamics1.dbc_name: SimulatedVcu._log_dynamics_image,
        LogStatus.dbc_name: SimulatedVcu._log_status_image,
    }
)

SEEN_OF_THE_SWITCHES: Final = tuple(
    name for name in Situation.__struct_fields__ if name in SWITCH_NAMES and name != "go"
)

_seen_of: Final = attrgetter(*SEEN_OF_THE_SWITCHES)

# signal database: State_service_brake of 0x502
LOG_BRAKE_DISENGAGED: Final = 1
LOG_BRAKE_ENGAGED: Final = 2
LOG_BRAKE_AVAILABLE: Final = 3


@lru_cache
def _shown(faults: frozenset[str]) -> Faults:
    return Faults(**{name: name in faults for name in FAULT_NAMES})


def _torque_pct(torques: CarFeedback | Actuation) -> int:
    """Return the torque of the axle with more of it, in percent."""
    most_nm = max(abs(torques.front_torque_nm), abs(torques.rear_torque_nm))
    return round(min(100.0, 100.0 * most_nm / AXLE_TORQUE_MAX_NM))
