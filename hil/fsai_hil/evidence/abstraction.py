"""The abstraction of a bridge's state: what a search tells apart in it, and a state made of that again.

`TimeFields` follows the declarations of the fields (`fsai_vcu.core.ages`), down to the last value in a value: it takes
the times out, as ages, and leaves the rest as it is. Before that `Abstraction.forgotten` makes of a state one that acts
alike from now on and in which nothing is left that nobody looks at any more, because that must not separate states.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType, UnionType
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from msgspec import NODEFAULT, Struct
from msgspec.structs import FieldInfo, fields, replace

from fsai_hil.rules.declared import declared, edges_ns
from fsai_hil.rules.numbers import CYCLE_NS, S
from fsai_vcu.core.ages import Ages, NotSearched, Within
from fsai_vcu.core.bridge import BridgeConfig, BridgeState
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.gate import GateState
from fsai_vcu.core.supervision.plausibility import SteeringCheck, WheelCheck
from fsai_vcu.core.supervision.supervisor import STEERS_WHILE_STOPPING, Asked, Latch, SupervisorState
from fsai_vcu.core.supervision.wheel_speeds import NO_PULSES, Pulses, WheelBelief
from fsai_vcu.core.vehicle.odometry import standing_start
from fsai_vcu.interface.messages import VehicleState

NOW: Final = 1_000 * S  # every state is looked at as if it were now
FRESH: Final = NOW + CYCLE_NS  # most of what a state holds has come in the cycle that led to it
NEVER: Final = -1

_RUN: Final = 2  # every run in hand has this number
_ZERO_NS, _ECHO_NS = 0, 1  # an echo that is newer than the first zero cycle, both long ago


# ---------------------------------------------------------------- times and ages, by their declarations


class TimeFields:
    """The times of a kind of value, and of the values within it: taken out of it as ages, and put back."""

    def __init__(self, made: type[Struct], given: Mapping[str, Any] = MappingProxyType({})) -> None:
        """`given`: declarations that come before the fields' own.

        Raises ValueError, which names the file to change, if a time has no declaration.
        """
        self._times: list[str] = []
        self._apart: dict[str, Any] = {}  # what stands for a time, and in a field that is not searched
        self.ages: list[Ages] = []  # of all times, in the order in which they are taken out
        parts: list[tuple[str, TimeFields]] = []
        notes, hints = declared(made, given), get_type_hints(made)
        for spec in fields(made):
            name, note = spec.name, notes[spec.name]
            if isinstance(note, NotSearched):
                self._apart[name] = _default(spec)
            elif isinstance(note, Ages):
                self._apart[name] = None if spec.default is None else FRESH
                self._times.append(name)
                self.ages.append(note)
            elif kind := _kind_in(hints[name]):
                parts.append((name, TimeFields(kind, note.fields if isinstance(note, Within) else {})))
        self._parts = [(name, inner) for name, inner in parts if inner._apart or inner._parts]
        self.ages += (ages for _, inner in self._parts for ages in inner.ages)
        self._never = [NEVER] * len(self.ages)

    def apart(self, value: Any, now: int, ages: list[int]) -> Any:
        """Return the value without its times; their ages in ns go to the end of `ages`."""
        if value is None:
            ages += self._never
            return None
        for name in self._times:
            t_ns = getattr(value, name)
            ages.append(NEVER if t_ns is None else now - t_ns if t_ns < now else 0)
        if not self._parts:
            for name, stands in self._apart.items():
                if getattr(value, name) != stands:
                    return replace(value, **self._apart)
            return value
        rest = self._apart.copy()
        for name, inner in self._parts:
            rest[name] = inner.apart(getattr(value, name), now, ages)
        return replace(value, **rest)

    def whole(self, value: Any, ages: Iterator[int]) -> Any:
        """Put the times back, as they are at `NOW`."""
        if value is None:
            for _ in self._never:
                next(ages)
            return None
        known: dict[str, Any] = {}
        for name in self._times:
            age = next(ages)
            known[name] = None if age < 0 else NOW - age
        for name, inner in self._parts:
            known[name] = inner.whole(getattr(value, name), ages)
        return replace(value, **known)


def _default(spec: FieldInfo) -> Any:
    """Return the value that a field has where none was given; None if there is no such value."""
    if spec.default_factory is not NODEFAULT:
        return spec.default_factory()
    return None if spec.default is NODEFAULT else spec.default


def _kind_in(hint: Any) -> type[Struct] | None:
    """Return the kind of value that a field holds, or None."""
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    found = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Struct)]
    return found[0] if found else None


_BRIDGE: Final = TimeFields(BridgeState)
FITTING: Final = SteeringCheck(), WheelCheck()
_AT_REST: Final = standing_start(0)


# ---------------------------------------------------------------- what nobody looks at any more


class Abstraction:
    """Takes the bridge's state apart into content and ages, without what nobody looks at, for one configuration.

    `sends_fail`, `data_may_be_lost`: what the environment may do besides.
    """

    def __init__(self, config: BridgeConfig, *, sends_fail: bool, data_may_be_lost: bool) -> None:
        self.edges = edges_of(_BRIDGE, config)
        self._config = config
        self._sends_fail = sends_fail
        self._data_may_be_lost = data_may_be_lost

    def apart(self, state: BridgeState, bit: bool, now: int, ages: list[int]) -> BridgeState:
        """Return what is no time; the ages of the times, not yet rounded, go to the end of `ages`.

        `bit`: the handshake that the VCU sends now.
        """
        content: BridgeState = _BRIDGE.apart(self.forgotten(state, bit, now), now, ages)
        return content

    def whole(self, content: BridgeState, ages: Iterable[int]) -> BridgeState:
        """The state as it was taken apart, at `NOW`, where the VCU sends a handshake of 0; `ages` may be longer."""
        state: BridgeState = _BRIDGE.whole(content, iter(ages))
        s, vehicle, command = state.supervisor, state.vehicle, state.command
        if s.still_since_ns is not None:
            assert s.speeds_ns is not None
            s = replace(s, still_since_ns=s.still_since_ns + s.speeds_ns - NOW)
        status, speeds = vehicle.status, vehicle.speeds
        if status is not None:
            status = replace(status, t_rx_ns=s.status_ns)
        if speeds is not None:
            speeds = replace(speeds, t_rx_ns=s.speeds_ns)
        pulses = NO_PULSES if s.turning_ns is None else Pulses(turning_ns=s.turning_ns)
        return replace(
            state,
            supervisor=s,
            odometry=_AT_REST,
            gate=replace(state.gate, pulses=pulses),
            vehicle=replace(vehicle, status=status, speeds=speeds),
            belief=WheelBelief(speeds, s.speeds_ns),
            command=None if command is None else replace(command, t_sensor_ns=state.command_ns, run_id=_RUN),
        )

    def forgotten(self, state: BridgeState, bit: bool, now: int) -> BridgeState:
        """Return a state that acts like this one from now on, with nothing in it that nobody looks at any more."""
        s = state.supervisor
        over = s.driving and s.stop is not None and s.emergency is not None  # nothing else happens in this run
        command = self._command(state, over, now)
        complete_ns, steering, wheels = state.last_complete_ns, state.steering, state.wheels
        if complete_ns is not None and not (s.driving and self._sends_fail):
            complete_ns = now
        if over:
            steering, wheels = FITTING
        return replace(
            state,
            supervisor=self._supervisor(s, command, over, now),
            gate=self._gate(state.gate, s),
            vehicle=self._vehicle(state, bit, over, now),
            steering=steering,
            wheels=wheels,
            command=command,
            command_ns=now if command is None else command.t_sensor_ns,
            last_complete_ns=complete_ns,
        )

    def _supervisor(self, s: SupervisorState, command: VehicleCommand | None, over: bool, now: int) -> SupervisorState:
        """Return the supervisor's state without times and latches that no later cycle looks at (`forgotten`)."""
        c, driving, stop = self._config, s.driving, s.stop
        still_since_ns, speeds_ns = s.still_since_ns, s.speeds_ns
        if still_since_ns is not None:  # it counts up to the last wheel speeds, while those are fresh
            assert speeds_ns is not None
            fresh = now - speeds_ns < c.feedback_stale_ns
            still_since_ns = still_since_ns + now - speeds_ns if fresh else None
        driving_since_ns = s.driving_since_ns
        if driving_since_ns is not None and now - driving_since_ns >= c.launch_wait_ns:
            # How long supervision has run counts only while no command ever came.
            in_time = command is not None and now - command.t_sensor_ns < CYCLE_NS and not self._data_may_be_lost
            if stop is not None or in_time:
                driving_since_ns = now - c.launch_wait_ns
        turned = s.turning_ns is not None and now - s.turning_ns >= c.standstill_ns
        window_rpm = None if stop is None or over else s.stop_window_rpm  # it is measured again by each stop
        if stop is not None:
            # Which causes let the planner steer matters, and no longer once the emergency is asked for.
            steered = not over and stop.cause in STEERS_WHILE_STOPPING
            stop = Latch(Asked.MISSION_DONE if steered else Asked.MANUAL, now if over else stop.since_ns)
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
            emergency=None if s.emergency is None else Latch(Asked.OPERATOR, now),
            stop_window_ns=now if window_rpm is None else s.stop_window_ns,
            stop_window_rpm=window_rpm,
            both_pedals_since_ns=None if stop is not None else s.both_pedals_since_ns,
            command_stale_since_ns=None if stop is not None else s.command_stale_since_ns,
        )

    def _gate(self, g: GateState, s: SupervisorState) -> GateState:
        return replace(
            g,
            brake=g.brake if s.driving else 0.0,
            zero_since_ns=_ZERO_NS,
            tried_torque=g.tried_torque and g.awaiting,
            tried_brake=g.tried_brake and g.awaiting,
            tried_selected=g.tried_selected and g.awaiting,
            acknowledged_run_id=_RUN if g.acknowledged_run_id == s.run_id else None,
            run_id=_RUN,
        )

    def _vehicle(self, state: BridgeState, bit: bool, over: bool, now: int) -> VehicleState:
        """Return the part of the car's messages that the bridge looks at."""
        vehicle, gate, s = state.vehicle, state.gate, state.supervisor
        status, steer, front, rear, brake = (
            vehicle.status, vehicle.steer, vehicle.drive_front, vehicle.drive_rear, vehicle.brake,
        )  # fmt: skip
        if status is not None and not s.driving:
            status = replace(status, go_signal=False, fault=False)
        if steer is not None and steer.t_rx_ns != now and not (s.driving and not over):
            steer = replace(steer, t_rx_ns=now)
        if front is not None and rear is not None and rear.t_rx_ns != now and not (s.driving and s.stop is None):
            front, rear = replace(front, t_rx_ns=now), replace(rear, t_rx_ns=now)
        if brake is not None:  # a 0x524 counts if it is newer than the first zero cycle, and then by its rear axle
            counts = gate.zero_cycles == 1 and brake.t_rx_ns > gate.zero_since_ns
            brake = replace(brake, t_rx_ns=_ECHO_NS) if counts else None
        return replace(
            vehicle,
            handshake=vehicle.handshake != bit,
            status=status,
            steer=steer,
            drive_front=front,
            drive_rear=rear,
            brake=brake,
        )

    def _command(self, state: BridgeState, over: bool, now: int) -> VehicleCommand | None:
        """Return what may still be obeyed of the command in the slot; it and its data count as handed in together.

        A command is used in AS_DRIVING only, and there each cycle may bring a new one. Its own age and that of its data
        count together: data of 500 ms ages like a command of 100 ms.
        """
        s, command, c = state.supervisor, state.command, self._config
        if command is None or not s.driving or command.run_id != s.run_id:
            return None
        handed_in_ns = min(state.command_ns, command.t_sensor_ns + c.sensor_stale_ns - c.command_stale_ns)
        if now - handed_in_ns >= c.command_lost_ns or over:
            return VehicleCommand(handed_in_ns, _RUN)  # it can only be lost
        if s.stop is None:
            return command if command.t_sensor_ns == handed_in_ns else replace(command, t_sensor_ns=handed_in_ns)
        # Of a stop's command only the steering counts, and a wish for an emergency.
        steering_rad = command.steering_rad if s.stop.cause in STEERS_WHILE_STOPPING else 0.0
        return VehicleCommand(handed_in_ns, _RUN, steering_rad, estop_request=command.estop_request)


def edges_of(times: TimeFields, config: BridgeConfig) -> tuple[tuple[int, ...], ...]:
    """The ages in ns at which each time matters."""
    return tuple(edges_ns(ages, config) for ages in times.ages)
