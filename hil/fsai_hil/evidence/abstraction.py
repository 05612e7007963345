"""The abstraction of a bridge's state: what a search tells apart in it, and a state made of that again.

`Abstraction.apart` maps over the fields of `BridgeState` and of the supervisor's and the gate's within it: one whose
name ends in `_ns` is a time and becomes an age, any other stays as it is. A new field is so part of what is searched;
a new time also needs its line in `_edges`, at which ages it matters, or nothing runs.

What is not mapped so is written out, each with its reason: `_OF_ITSELF` is left out or follows from the rest, and
`_supervisor`, `_gate`, `_command` and `_reported` forget what nothing looks at any more, because it must not separate
states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final, cast

from msgspec.structs import replace

from fsai_hil.rules.numbers import CYCLE_NS, S
from fsai_hil.rules.seen import STATES, Parts, marks_of
from fsai_vcu.core.bridge import BridgeConfig, BridgeState
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.gate import GateState
from fsai_vcu.core.supervision.plausibility import SteeringCheck, WheelCheck
from fsai_vcu.core.supervision.supervisor import STEERS_WHILE_STOPPING, Asked, Latch, SupervisorState
from fsai_vcu.core.supervision.wheel_speeds import NO_PULSES, Pulses, WheelBelief
from fsai_vcu.core.vehicle.odometry import standing_start
from fsai_vcu.interface.codec import Decoded
from fsai_vcu.interface.enums import Ami, AsState, EbsState, OpState, ShutdownCause, TsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    Faults,
    Image,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    VehicleState,
    WheelSpeeds,
)

NOW: Final = 1_000 * S  # every state is looked at as if it were now
NEVER: Final = -1

Content = tuple[object, ...]

_NO_TIME: Final = cast(int, None)  # for a time whose type knows no None
_RUN: Final = 2  # every run in hand has this number
_NO_TIMES: Final[Mapping[str, str]] = {
    "ready_waited_ns": "a duration",
    "zero_since_ns": "compared with the time of one 0x524 only: `_reported` keeps whether that is newer",
}
_OF_ITSELF: Final[Mapping[str, str]] = {
    "supervisor": "mapped field by field",
    "gate": "mapped field by field",
    "pulses": "turn as the supervisor's `turning_ns` says: counts are not sent",
    "odometry": "fills a logging field",
    "gps": "is looked at by odometry alone",
    "decision": "each cycle makes its own",
    "asked": "each cycle makes its own",
    "speeds_doubt": "words",
    "belief": "follows from the wheel speeds believed last: counts are not sent",
    "vehicle": "what the bridge looks at of it: `_reported`; the supervisor knows when 0x520 and 0x525 came",
    "steering": "since when it is implausible: the check is the environment's choice",
    "wheels": "since when one is implausible: the check is the environment's choice",
    "command": "what may still be obeyed of it: `_command`",
}
_STEERED_STOP, _HELD_STOP = Latch(Asked.MISSION_DONE, 0), Latch(Asked.MANUAL, 0)
_EMERGENCY: Final = Latch(Asked.OPERATOR, 0)
_SPENT: Final = (0.0, 0.0, 0.0, 0.0, False, False)  # a command that can only be lost
_ZERO_NS, _ECHO_NS = 0, 1  # an echo that is newer than the first zero cycle, both long ago
_INSIDE: Final = ("stop", "steering", "wheels", "steer", "axles")  # times that are written out


def _edges(c: BridgeConfig) -> dict[str, tuple[int, ...]]:
    """The ages at which each time matters. A gap that is seen when a frame comes has its edge a cycle earlier too."""
    vcu = (c.vcu_stale_ns, c.vcu_lost_ns)
    jump = (c.wheel_jump_ns - CYCLE_NS, c.wheel_jump_ns)
    implausible = (c.implausible_ns, c.implausible_lost_ns)
    return {
        "status_ns": vcu,
        "received_ns": (c.power_cycle_ns - CYCLE_NS, c.power_cycle_ns),
        "known_again_ns": (c.as_state_known_ns,),
        "ready_since_ns": (c.ready_wait_ns,),
        "driving_since_ns": (
            c.launch_wait_ns,
            c.launch_wait_ns + c.command_stale_ns,
            c.launch_wait_ns + c.command_lost_ns,
        ),
        "speeds_ns": (c.feedback_stale_ns - CYCLE_NS, c.feedback_stale_ns, c.feedback_lost_ns, *jump),
        "still_since_ns": (c.standstill_ns,),
        "turning_ns": (c.standstill_ns,),
        "stop_window_ns": (c.stop_window_ns,),
        "both_pedals_since_ns": (c.both_pedals_ns,),
        "command_stale_since_ns": (c.command_lost_ns,),
        "cycle_ns": (),
        "command_ns": (c.command_stale_ns, c.command_lost_ns),
        "listening_since_ns": (c.listen_first_ns,),
        "reopened_ns": (c.vcu_lost_ns,),
        "last_complete_ns": (c.send_lost_ns,),
        "stop": (c.stop_timeout_ns,),
        "steering": implausible,
        "wheels": implausible,
        "steer": (c.feedback_stale_ns, c.feedback_lost_ns),
        "axles": (c.feedback_stale_ns,),
    }


def _parts(made: type[Any]) -> Parts:
    times = [name for name in made.__struct_fields__ if name.endswith("_ns") and name not in _NO_TIMES]
    return Parts(made, times, _OF_ITSELF)


_SUPERVISOR, _GATE, _BRIDGE = map(_parts, (SupervisorState, GateState, BridgeState))
CLOCKS: Final = (*_SUPERVISOR.times, *_GATE.times, *_BRIDGE.times, *_INSIDE)


class Abstraction:
    """For one configuration. `sends_fail`, `data_may_be_lost`: what the environment may do besides."""

    def __init__(self, config: BridgeConfig, *, sends_fail: bool, data_may_be_lost: bool) -> None:
        edges = _edges(config)
        if set(edges) != set(CLOCKS):
            raise ValueError(f"at which ages does it matter? {sorted(set(edges) ^ set(CLOCKS))}")
        self.edges = tuple(edges[name] for name in CLOCKS)
        self._config = config
        self._sends_fail = sends_fail
        self._data_may_be_lost = data_may_be_lost

    def apart(self, state: BridgeState, bit: bool, now: int) -> tuple[Content, list[int]]:
        """Return what is no time, and the ages by `CLOCKS`, not yet rounded.

        `bit`: the handshake that the VCU sends now.
        """
        s, vehicle = state.supervisor, state.vehicle
        driving, stop = s.driving, s.stop
        over = driving and stop is not None and s.emergency is not None  # nothing else happens in this run
        command_ns, content = self._command(state, over, now)
        supervising = self._supervisor(s, command_ns, over, now)
        complete_ns = state.last_complete_ns
        if complete_ns is not None and not (driving and self._sends_fail):
            complete_ns = now
        bridge = replace(
            state,
            status_doubt="it cannot be read" if state.status_doubt else "",
            bus_lost=None if state.bus_lost is None else "the interface is gone",
            command_ns=_NO_TIME if command_ns is None else command_ns,
            last_complete_ns=complete_ns,
        )
        steer, axle = vehicle.steer, vehicle.drive_rear
        times = (
            *_SUPERVISOR.times_of(supervising),
            *_GATE.times_of(state.gate),
            *_BRIDGE.times_of(bridge),
            None if stop is None else now if over else stop.since_ns,
            None if over else state.steering.implausible_since_ns,
            None if over else state.wheels.implausible_since_ns,
            None if steer is None else steer.t_rx_ns if driving and not over else now,
            None if axle is None else axle.t_rx_ns if driving and stop is None else now,
        )
        disc = (
            _SUPERVISOR.others_of(supervising),
            _GATE.others_of(self._gate(state, driving)),
            (*_BRIDGE.others_of(bridge), vehicle.handshake != bit, content),
            _reported(state),
        )
        return disc, [NEVER if time is None else now - time if time < now else 0 for time in times]

    def whole(self, content: Content, ages: Sequence[int]) -> BridgeState:
        """The state as it was taken apart, at `NOW`, where the VCU sends a handshake of 0."""
        supervising, gating, (*others, handshake, ordered), reported = cast(Any, content)
        times = iter([None if age < 0 else NOW - age for age in ages])
        s, g, b = _SUPERVISOR.values(supervising, times), _GATE.values(gating, times), _BRIDGE.values(others, times)
        stop_ns, steering_ns, wheels_ns, *reported_ns = times
        if s["stop"] is not None:
            s["stop"] = replace(s["stop"], since_ns=stop_ns)
        if s["still_since_ns"] is not None:
            s["still_since_ns"] += s["speeds_ns"] - NOW
        reported_ns = [s["status_ns"], s["speeds_ns"], *reported_ns]
        vehicle = _vehicle(reported, reported_ns, handshake, known=not b["status_doubt"])
        return BridgeState(
            supervisor=SupervisorState(**s),
            gate=GateState(**g, pulses=NO_PULSES if s["turning_ns"] is None else Pulses(turning_ns=s["turning_ns"])),
            odometry=_AT_REST,
            vehicle=vehicle,
            belief=WheelBelief(vehicle.speeds, s["speeds_ns"]),
            steering=_FITS[0] if steering_ns is None else SteeringCheck(implausible_since_ns=steering_ns),
            wheels=_FITS[1] if wheels_ns is None else WheelCheck(implausible_since_ns=wheels_ns),
            command=None if ordered is None else VehicleCommand(b["command_ns"], _RUN, *ordered),
            **b,
        )

    def _supervisor(self, s: SupervisorState, command_ns: int | None, over: bool, now: int) -> SupervisorState:
        """Return the supervisor's state with every time put back to the age that still matters."""
        c, driving, stop = self._config, s.driving, s.stop
        still_since_ns, speeds_ns = s.still_since_ns, s.speeds_ns
        if still_since_ns is not None:  # it counts up to the last wheel speeds, while those are fresh
            assert speeds_ns is not None
            fresh = now - speeds_ns < c.feedback_stale_ns
            still_since_ns = still_since_ns + now - speeds_ns if fresh else None
        driving_since_ns = s.driving_since_ns
        if driving_since_ns is not None and now - driving_since_ns >= c.launch_wait_ns:
            # How long supervision has run counts only while no command ever came.
            in_time = command_ns is not None and now - command_ns < CYCLE_NS and not self._data_may_be_lost
            if stop is not None or in_time:
                driving_since_ns = now - c.launch_wait_ns
        turned = s.turning_ns is not None and now - s.turning_ns >= c.standstill_ns
        window_rpm = None if stop is None or over else s.stop_window_rpm  # it is measured again by each stop
        if stop is not None:
            # Which causes let the planner steer matters, and no longer once the emergency is asked for.
            stop = _STEERED_STOP if not over and stop.cause in STEERS_WHILE_STOPPING else _HELD_STOP
        return replace(
            s,
            go=s.go and driving,
            fault=s.fault and driving,
            ready_waited_ns=c.ready_wait_ns if s.ready_waited_ns >= c.ready_wait_ns else 0,
            driving_since_ns=driving_since_ns,
            still_since_ns=still_since_ns,
            turning_ns=None if turned else s.turning_ns,
            run_id=_RUN,
            power_up=s.power_up and c.autonomous_at_power_up,
            stop=stop,
            emergency=None if s.emergency is None else _EMERGENCY,
            stop_window_ns=_NO_TIME if window_rpm is None else s.stop_window_ns,
            stop_window_rpm=window_rpm,
            both_pedals_since_ns=None if stop is not None else s.both_pedals_since_ns,
            command_stale_since_ns=None if stop is not None else s.command_stale_since_ns,
        )

    def _gate(self, state: BridgeState, driving: bool) -> GateState:
        g = state.gate
        return replace(
            g,
            brake=g.brake if driving else 0.0,
            zero_since_ns=_ZERO_NS,
            tried_torque=g.tried_torque and g.awaiting,
            tried_brake=g.tried_brake and g.awaiting,
            tried_selected=g.tried_selected and g.awaiting,
            acknowledged_run_id=_RUN if g.acknowledged_run_id == state.supervisor.run_id else None,
            run_id=_RUN,
        )

    def _command(self, state: BridgeState, over: bool, now: int) -> tuple[int | None, Content | None]:
        """Return when the command in the slot, and its data, count as handed in, and what may still be obeyed of it.

        A command is used in AS_DRIVING only, and there each cycle may bring a new one. Its own age and that of its data
        count together: data of 500 ms ages like a command of 100 ms.
        """
        s, command, c = state.supervisor, state.command, self._config
        if command is None or not s.driving or command.run_id != s.run_id:
            return None, None
        handed_in_ns = min(state.command_ns, command.t_sensor_ns + c.sensor_stale_ns - c.command_stale_ns)
        if now - handed_in_ns >= c.command_lost_ns or over:
            return handed_in_ns, _SPENT
        if s.stop is None:
            return handed_in_ns, (
                command.steering_rad, command.throttle, command.brake, command.speed_limit_mps,
                command.mission_finished, command.estop_request,
            )  # fmt: skip
        # Of a stop's command only the steering counts, and a wish for an emergency.
        steering_rad = command.steering_rad if s.stop.cause in STEERS_WHILE_STOPPING else 0.0
        return handed_in_ns, (steering_rad, 0.0, 0.0, 0.0, False, command.estop_request)


_FITS: Final = (SteeringCheck(), WheelCheck())
_AT_REST: Final = standing_start(0)


def _reported(state: BridgeState) -> Content:
    """Return the part of the car's messages that the bridge looks at."""
    vehicle, gate = state.vehicle, state.gate
    driving = state.supervisor.driving
    status, speeds, steer, axle, brake = (
        vehicle.status, vehicle.speeds, vehicle.steer, vehicle.drive_rear, vehicle.brake,
    )  # fmt: skip
    echo: bool | None = None  # of a brake, in a 0x524 newer than the first zero cycle; another says nothing
    if brake is not None and gate.zero_cycles == 1 and brake.t_rx_ns > gate.zero_since_ns:
        echo = brake.rear_request_pct != 0.0
    return (
        None if status is None else (
            status.as_state, status.go_signal and driving, status.ami, status.fault and driving, marks_of(status),
        ),
        None if speeds is None else speeds.all_rpm,
        None if steer is None else steer.angle_max_deg,
        None if axle is None else axle.torque_max_nm,  # of both: they come together
        echo,
    )  # fmt: skip


def _vehicle(reported: Content, times: Sequence[int | None], handshake: bool, *, known: bool) -> VehicleState:
    """Make the vehicle's state of what is reported and of the messages' times."""
    status, rpm, angle_max_deg, torque_max_nm, echo = cast(Any, reported)
    status_ns, speeds_ns, steer_ns, axle_ns = cast(Sequence[int], times)
    frames = {}
    if status is not None:
        as_state, go, ami, fault, marks = status
        frames["status"] = status_frame(False, go, as_state, ami, fault, marks, status_ns)
    if rpm is not None:
        frames["speeds"] = car_frame(WheelSpeeds, speeds_ns, *rpm)
    if angle_max_deg is not None:
        frames["steer"] = car_frame(VcuSteer, steer_ns, 0.0, angle_max_deg)
    if torque_max_nm is not None:
        frames["drive_front"] = car_frame(VcuDriveFront, axle_ns, 0.0, 0.0, torque_max_nm)
        frames["drive_rear"] = car_frame(VcuDriveRear, axle_ns, 0.0, 0.0, torque_max_nm)
    if echo is not None:
        frames["brake"] = brake_frame(echo, _ECHO_NS)
    images: dict[str, Any] = {name: frame.decoded.image for name, frame in frames.items()}
    return VehicleState(handshake=handshake, status_known=known, **images)


# ---------------------------------------------------------------- the car's frames: the same few come again and again

_SWITCHES: Final = ("AS_SWITCH_STATUS falls", "TS_SWITCH_STATUS falls")
_REQUEST: Final = "SHUTDOWN_REQUEST rises"
_BITS: Final[Mapping[str, str]] = {f"fault bit {name} rises": name for name in ("bms", "ebs")}
_CAUSE: Final = "SHUTDOWN_CAUSE rises"
_STATES: Final = tuple(f"{name} becomes FAULT" for name in STATES)
MARKS: Final = (*_SWITCHES, _REQUEST, *_BITS, _CAUSE, *_STATES)  # of those that `rules.seen.marks_of` knows
_IDS: Final[Mapping[type, int]] = {
    kind: can_id for can_id, kind in enumerate((VcuDriveFront, VcuDriveRear, VcuSteer, VcuBrake, WheelSpeeds), 0x521)
}


class CarFrame(Frame, frozen=True):
    """A frame that carries its image along."""

    decoded: Decoded = Decoded(None)


class PlainCodec:
    """The codec that hands on what a frame carries."""

    unknown = ""

    def decode(self, frame: CarFrame) -> Decoded:
        return frame.decoded


def _frame(can_id: int, image: Image | None, now: int, handshake: bool | None = None) -> CarFrame:
    return CarFrame(can_id, b"", now, decoded=Decoded(image, (), handshake))


@cache
def status_frame(
    bit: bool, go: bool, state: AsState, ami: Ami, fault: bool, marks: frozenset[str], now: int
) -> CarFrame:
    """Return a 0x520 as the searched car sends it."""
    image = VcuStatus(
        handshake=bit,
        shutdown_request=_REQUEST in marks,
        as_switch=_SWITCHES[0] not in marks,
        ts_switch=_SWITCHES[1] not in marks,
        go_signal=go,
        as_state=state,
        ami=ami,
        fault=fault,
        faults=Faults(**{field: mark in marks for mark, field in _BITS.items()}),
        shutdown_cause=ShutdownCause.BMS_FAULT if _CAUSE in marks else ShutdownCause.NO_SHUTDOWN,
        ebs_state=EbsState.EBS_FAULT if _STATES[0] in marks else EbsState.EBS_ARMED,
        ts_state=TsState.TS_FAULT if _STATES[1] in marks else TsState.TS_RUNNING,
        op_state=OpState.OP_FAULT if _STATES[2] in marks else OpState.OP_AUTO,
        t_rx_ns=now,
    )
    return _frame(0x520, image, now, bit)


@cache
def unreadable_frame(bit: bool, now: int) -> CarFrame:
    return _frame(0x520, None, now, bit)


@cache
def car_frame(kind: type[Any], now: int, *values: float) -> CarFrame:
    """A frame of 0x521 to 0x525, by what it carries in the order of its fields."""
    return _frame(_IDS[kind], kind(*values, t_rx_ns=now), now)


@cache
def brake_frame(braking: bool, now: int) -> CarFrame:
    return car_frame(VcuBrake, now, *[30.0 if braking else 0.0] * 4)
