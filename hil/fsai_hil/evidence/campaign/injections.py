"""How each fault is done to a run in lockstep: on the wire, to sensors, actuators, people, or the AI computer itself.

Every function takes the run, the drawn parameters and the instant; it begins the fault and returns how it goes on and
ends. What a fault draws by chance comes from its own `chance`, so that a case is the same wherever it runs.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from fsai_hil.simulator.car_signals import Actuation, CarFeedback
from fsai_hil.simulator.faults import (
    Delay,
    Drop,
    FlipBits,
    FrameFault,
    Freeze,
    Overwrite,
    Repeat,
    Window,
    WrongLength,
    WrongValues,
)
from fsai_hil.simulator.lockstep import Lockstep, confident
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.driving import ConeColor, ConeObservation, Plan
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.units import MS

Params = Mapping[str, Any]


def _nothing(now_ns: int) -> None:
    return None


@dataclass(frozen=True, slots=True)
class Injected:
    """A fault under way: `tick` is called every millisecond until `end`."""

    end: Callable[[int], None] = _nothing
    tick: Callable[[int], None] | None = None


Injection = Callable[[Lockstep, Params, int], Injected]

# ---------------------------------------------------------------- the wire

STATUS, DRIVE_F, DRIVE_R, STEER, BRAKE, SPEEDS, COUNTS = VCU_IDS
LOGS: Final = frozenset({0x120, 0x500, 0x502})
GPS_IDS: Final = frozenset(range(0x600, 0x641))
FROM_CAR: Final = frozenset({*LOGS, *VCU_IDS})
AI_STATUS, AI_DRIVE_F, AI_DRIVE_R, AI_STEER, AI_BRAKE = AI_IDS

WireFault = Callable[[Window, Params], FrameFault]


def _lost(window: Window, p: Params) -> FrameFault:
    return Drop(window)


def _thinned(window: Window, p: Params) -> FrameFault:
    return Drop(window, probability=p["share"], seed=p["chance"])


def _late(window: Window, p: Params) -> FrameFault:
    return Delay(window, delay_ns=p["delay"] * MS)


def _jittering(window: Window, p: Params) -> FrameFault:
    return Delay(window, jitter_ns=p["delay"] * MS, seed=p["chance"])


def _frozen(window: Window, p: Params) -> FrameFault:
    return Freeze(window)


def _twice(window: Window, p: Params) -> FrameFault:
    return Repeat(window, p["times"])


def _flipped(window: Window, p: Params) -> FrameFault:
    rng = random.Random(p["chance"])
    mask = bytearray(8)
    for _ in range(p["bits"]):
        bit = rng.randrange(64)
        mask[bit // 8] |= 1 << bit % 8
    return FlipBits(window, bytes(mask))


def _cut(window: Window, p: Params) -> FrameFault:
    return WrongLength(window, p["length"])


def _not_a_number(window: Window, p: Params) -> FrameFault:
    return Overwrite(window, 0, struct.pack("<f", {"nan": math.nan, "inf": math.inf, "huge": 3e38}[p["value"]]))


def _impossible_speeds(window: Window, p: Params) -> FrameFault:
    """What no wheel of this car can turn at, on one wheel or on all: more than the signal database allows."""
    raw = struct.pack("<H", int(p["rpm"]))
    return (
        Overwrite(window, 0, raw * 4) if p["wheel"] == "all" else Overwrite(window, 2 * WHEELS.index(p["wheel"]), raw)
    )


def _undefined_as_state(window: Window, p: Params) -> FrameFault:
    """0x520 with an AS_STATE that no table knows; HANDSHAKE stays what it is."""
    return Overwrite(window, 2, bytes([p["state"]]))


LOST, THINNED, LATE, JITTERING, FROZEN, TWICE, FLIPPED, CUT, NOT_A_NUMBER, IMPOSSIBLE_SPEEDS, UNDEFINED_AS_STATE = (
    _lost,
    _thinned,
    _late,
    _jittering,
    _frozen,
    _twice,
    _flipped,
    _cut,
    _not_a_number,
    _impossible_speeds,
    _undefined_as_state,
)


def from_car(ids: Iterable[int], fault: WireFault) -> Injection:
    """On what the car says: on those of `ids` (all, but for the one that a parameter `message` names)."""
    return _on_wire(frozenset(ids), fault, heard_by_car=False)


def to_car(ids: Iterable[int], fault: WireFault) -> Injection:
    """On what the car hears of the AI computer; the bus itself shows what was sent."""
    return _on_wire(frozenset(ids), fault, heard_by_car=True)


def _on_wire(ids: frozenset[int], fault: WireFault, *, heard_by_car: bool) -> Injection:
    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        wire = rig.world.vcu.incoming if heard_by_car else rig.world.vcu.outgoing
        made = fault(Window(frozenset({int(p["message"], 16)}) if "message" in p else ids), p)
        wire.add(made)
        return Injected(lambda end_ns: wire.remove(made))

    return begin


def says(ids: Iterable[int], values: Callable[[Params], Mapping[str, Any]]) -> Injection:
    """Fields of a message of the car say something else."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        wire = rig.world.vcu.outgoing
        made = WrongValues(rig.world.codec, Window(frozenset(ids)), values(p))
        wire.add(made)
        return Injected(lambda end_ns: wire.remove(made))

    return begin


def wild_handshake(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """HANDSHAKE on the wire is not what the VCU means: inverted, or thrown like a coin."""
    rng = random.Random(p["chance"])
    wire = rig.world.vcu.outgoing
    inverted = FlipBits(Window(frozenset({STATUS})), b"\x01")

    class Wild(FrameFault):
        def frames(self, frame: Frame) -> Iterable[Frame]:
            if p["way"] == "random" and rng.random() < 0.5:
                return (frame,)
            return inverted.frames(frame)

    made = Wild()
    wire.add(made)
    return Injected(lambda end_ns: wire.remove(made))


def spiking_speed(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Every so many frames one wheel speed jumps by more than any tyre can follow, for that one frame."""
    codec, wire = rig.world.codec, rig.world.vcu.outgoing
    name = f"{p['wheel']}_rpm"
    seen = 0

    class Spikes(FrameFault):
        def frames(self, frame: Frame) -> Iterable[Frame]:
            nonlocal seen
            if frame.can_id != SPEEDS:
                return (frame,)
            seen += 1
            image = codec.decode(frame).image
            if seen % p["every"] or image is None:
                return (frame,)
            spike = 1250 if getattr(image, name) < 600 else 0
            return (replace(frame, data=codec.encode(replace(image, **{name: spike})).data),)  # type: ignore[arg-type]

    made = Spikes()
    wire.add(made)
    return Injected(lambda end_ns: wire.remove(made))


def both_ways(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The VCU neither speaks nor hears for a while."""
    vcu = rig.world.vcu
    said, heard = Drop(Window(FROM_CAR)), Drop(Window(frozenset(AI_IDS)))
    vcu.outgoing.add(said)
    vcu.incoming.add(heard)

    def end(end_ns: int) -> None:
        vcu.outgoing.remove(said)
        vcu.incoming.remove(heard)

    return Injected(end)


def intruder(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Somebody else sends on one of the AI computer's ids."""
    rng = random.Random(p["chance"])
    can_id = int(p["message"], 16)
    length = BY_ID[can_id].dlc
    payload = bytes(length) if p["payload"] == "zeros" else rng.randbytes(length)
    left = p["frames"]
    next_ns = now_ns

    def tick(t_ns: int) -> None:
        nonlocal left, next_ns
        if left and t_ns >= next_ns:
            left -= 1
            next_ns += p["period"] * MS
            rig.intrude(Frame(can_id, payload, t_ns))

    return Injected(tick=tick)


def stranger(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Somebody sends frames which are nobody's: unknown ids, extended and remote ones, error frames."""
    rng = random.Random(p["chance"])

    def tick(t_ns: int) -> None:
        kind = rng.choice(("unknown", "extended", "remote", "error"))
        payload = rng.randbytes(rng.randrange(9))
        if kind == "unknown":
            rig.intrude(Frame(rng.choice((0x001, 0x2AA, 0x4AA, 0x5FF, 0x7FE)), payload, t_ns))
        elif kind == "extended":
            rig.intrude(Frame(rng.choice((*AI_IDS, STATUS, 0x18FF50E5)), payload, t_ns, extended=True))
        elif kind == "remote":
            rig.intrude(Frame(rng.choice((STATUS, SPEEDS)), b"", t_ns, remote=True))
        else:
            rig.intrude(Frame(0x004, bytes(8), t_ns, error=True))

    return Injected(tick=tick)


# ---------------------------------------------------------------- sensors

WHEELS: Final = ("fl", "fr", "rl", "rr")
Reading = Callable[[CarFeedback, int], CarFeedback]


def _sensed(rig: Lockstep, read: Reading) -> Injected:
    faults = rig.world.sensor_faults
    faults.append(read)
    return Injected(lambda end_ns: faults.remove(read))


def _put(values: Sequence[float], at: int, value: float) -> tuple[float, float, float, float]:
    changed = list(values)
    changed[at] = value
    return changed[0], changed[1], changed[2], changed[3]


def wheel_sensor(change: Callable[[float, float, Params, random.Random, float], float]) -> Injection:
    """One wheel's speed reads what `change` says: of its value, its value at the fault's beginning, the parameters,
    chance and the seconds since."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        rng = random.Random(p["chance"])
        at = WHEELS.index(p["wheel"])
        before = rig.world.car.feedback().wheel_rpm[at]

        def read(real: CarFeedback, t_ns: int) -> CarFeedback:
            rpm = change(real.wheel_rpm[at], before, p, rng, (t_ns - now_ns) / 1e9)
            return replace(real, wheel_rpm=_put(real.wheel_rpm, at, max(0.0, rpm)))

        return _sensed(rig, read)

    return begin


def every_wheel(change: Callable[[float, float, Params, random.Random, float], float]) -> Injection:
    """All four wheel speeds at once."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        rng = random.Random(p["chance"])
        before = rig.world.car.feedback().wheel_rpm

        def read(real: CarFeedback, t_ns: int) -> CarFeedback:
            since_s = (t_ns - now_ns) / 1e9
            fl, fr, rl, rr = (
                max(0.0, change(rpm, before[at], p, rng, since_s)) for at, rpm in enumerate(real.wheel_rpm)
            )
            return replace(real, wheel_rpm=(fl, fr, rl, rr))

        return _sensed(rig, read)

    return begin


def swapped_wheels(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Speeds and pulses of two wheels are exchanged."""
    one, other = (WHEELS.index(name) for name in p["wheels"].split("-"))

    def read(real: CarFeedback, t_ns: int) -> CarFeedback:
        rpm, pulses = list(real.wheel_rpm), list(real.pulses)
        rpm[one], rpm[other] = rpm[other], rpm[one]
        pulses[one], pulses[other] = pulses[other], pulses[one]
        return replace(
            real, wheel_rpm=(rpm[0], rpm[1], rpm[2], rpm[3]), pulses=(pulses[0], pulses[1], pulses[2], pulses[3])
        )

    return _sensed(rig, read)


def pulses(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Pulse counters stand still, run double, are chance, or run on by themselves at `rate` pulses/s."""
    rng = random.Random(p["chance"])
    before = rig.world.car.feedback().pulses

    def count(now: int, then: int, t_ns: int) -> int:
        if p["way"] == "stuck":
            return then
        if p["way"] == "double":
            return (2 * now - then) & 0xFFFF
        if p["way"] == "running":
            return (then + round(p["rate"] * (t_ns - now_ns) / 1e9)) & 0xFFFF
        return rng.randrange(0x10000)

    def read(real: CarFeedback, t_ns: int) -> CarFeedback:
        fl, fr, rl, rr = (count(now, then, t_ns) for now, then in zip(real.pulses, before, strict=True))
        return replace(real, pulses=(fl, fr, rl, rr))

    return _sensed(rig, read)


def reading(name: str, change: Callable[[float, float, Params, random.Random, float], float]) -> Injection:
    """One of the car's other readings, by its field."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        rng = random.Random(p["chance"])
        before: float = getattr(rig.world.car.feedback(), name)

        def read(real: CarFeedback, t_ns: int) -> CarFeedback:
            value = change(getattr(real, name), before, p, rng, (t_ns - now_ns) / 1e9)
            return replace(real, **{name: value})  # type: ignore[arg-type]

        return _sensed(rig, read)

    return begin


def brake_pressure(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Both pressures stand still, or are noise."""
    rng = random.Random(p["chance"])
    before = rig.world.car.feedback()

    def read(real: CarFeedback, t_ns: int) -> CarFeedback:
        if p["way"] == "stuck":
            return replace(real, front_brake_pct=before.front_brake_pct, rear_brake_pct=before.rear_brake_pct)
        return replace(real, front_brake_pct=rng.uniform(0.0, 100.0), rear_brake_pct=rng.uniform(0.0, 100.0))

    return _sensed(rig, read)


def stuck(value: float, before: float, p: Params, rng: random.Random, since_s: float) -> float:
    return before


def dead(value: float, before: float, p: Params, rng: random.Random, since_s: float) -> float:
    return 0.0


def drifting(value: float, before: float, p: Params, rng: random.Random, since_s: float) -> float:
    return value + float(p["rate"]) * since_s


def noisy(value: float, before: float, p: Params, rng: random.Random, since_s: float) -> float:
    return value + rng.gauss(0.0, p["size"])


def offset(value: float, before: float, p: Params, rng: random.Random, since_s: float) -> float:
    return value + float(p["size"])


def scaled(value: float, before: float, p: Params, rng: random.Random, since_s: float) -> float:
    return value * float(p["factor"])


# ---------------------------------------------------------------- actuators

Order = Callable[[Actuation, int], Actuation]


def _acted(rig: Lockstep, order: Order) -> Injected:
    faults = rig.world.actuator_faults
    faults.append(order)
    return Injected(lambda end_ns: faults.remove(order))


def steering(change: Callable[[float, float, Params], float]) -> Injection:
    """What reaches the steering actuator: of the order, the angle at the fault's beginning, and the parameters."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        before = rig.world.car.truth().steer_deg
        return _acted(rig, lambda real, t_ns: replace(real, steer_deg=change(real.steer_deg, before, p)))

    return begin


def slow_steering(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The actuator turns at `rate` deg/s only."""
    at_deg, then_ns = rig.world.car.truth().steer_deg, now_ns

    def order(real: Actuation, t_ns: int) -> Actuation:
        nonlocal at_deg, then_ns
        most = p["rate"] * (t_ns - then_ns) / 1e9
        then_ns = t_ns
        at_deg += min(most, max(-most, real.steer_deg - at_deg))
        return replace(real, steer_deg=at_deg)

    return _acted(rig, order)


def service_brake(change: Callable[[float, Params], float], front: bool = True, rear: bool = True) -> Injection:
    """What reaches the brakes of a request; the EBS has its own way to them."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        def order(real: Actuation, t_ns: int) -> Actuation:
            if real.ebs_engaged:
                return real
            return replace(
                real,
                front_brake_pct=change(real.front_brake_pct, p) if front else real.front_brake_pct,
                rear_brake_pct=change(real.rear_brake_pct, p) if rear else real.rear_brake_pct,
            )

        return _acted(rig, order)

    return begin


def slow_brake(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Pressure builds up at `rate` %/s only."""
    at_pct, then_ns = rig.world.vcu.actuation.front_brake_pct, now_ns

    def order(real: Actuation, t_ns: int) -> Actuation:
        nonlocal at_pct, then_ns
        at_pct = min(real.front_brake_pct, at_pct + p["rate"] * (t_ns - then_ns) / 1e9)
        then_ns = t_ns
        if real.ebs_engaged:
            return real
        return replace(real, front_brake_pct=at_pct, rear_brake_pct=at_pct)

    return _acted(rig, order)


def motor(change: Callable[[float, Params], float], *axles: str) -> Injection:
    """What reaches the motors of `axles` of a torque request."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        def order(real: Actuation, t_ns: int) -> Actuation:
            if "front" in axles:
                real = replace(real, front_torque_nm=change(real.front_torque_nm, p))
            if "rear" in axles:
                real = replace(real, rear_torque_nm=change(real.rear_torque_nm, p))
            return real

        return _acted(rig, order)

    return begin


def late_motor(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Torque comes and goes `delay` ms late."""
    waiting: list[tuple[int, float, float]] = []

    def order(real: Actuation, t_ns: int) -> Actuation:
        waiting.append((t_ns + p["delay"] * MS, real.front_torque_nm, real.rear_torque_nm))
        while len(waiting) > 1 and waiting[1][0] <= t_ns:
            waiting.pop(0)
        front, rear = waiting[0][1:] if waiting[0][0] <= t_ns else (0.0, 0.0)
        return replace(real, front_torque_nm=front, rear_torque_nm=rear)

    return _acted(rig, order)


# ---------------------------------------------------------------- people and the car's electrics


def switched(name: str, value: object = True) -> Injection:
    """A switch, a button or a part of the car changes; it changes back at the end."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        switches = rig.world.vcu.switches
        before = getattr(switches, name)
        setattr(switches, name, value)
        return Injected(lambda end_ns: setattr(switches, name, before))

    return begin


def vcu_differs(**differences: Callable[[Params], object]) -> Injection:
    """The VCU's state machine differs from the specification's, by fields of `Profile`."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        vcu = rig.world.vcu
        values: dict[str, Any] = {name: value(p) for name, value in differences.items()}
        vcu.behave(replace(vcu.profile, **values))
        return Injected()

    return begin


def hasty_go(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Go comes `ready` ms after AS_READY began."""
    vcu = rig.world.vcu

    def tick(t_ns: int) -> None:
        if vcu.state is AsState.AS_READY and vcu.in_state_ns >= p["ready"] * MS:
            vcu.switches.go = True

    return Injected(tick=tick)


def derated(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The car lowers a limit of its own while it drives."""
    switches = rig.world.vcu.switches
    setattr(switches, p["limit"], p["value"])
    return Injected(lambda end_ns: setattr(switches, p["limit"], None))


def asked(question: Callable[[Lockstep, int], object]) -> Injection:
    """Somebody asks something of the bridge through its services."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        question(rig, now_ns)
        return Injected()

    return begin


# ---------------------------------------------------------------- planner, controller, detector

Commanded = Callable[[VehicleCommand, int], VehicleCommand | None]


def _filtered(rig: Lockstep, change: Commanded) -> Injected:
    computer = rig.computer
    computer.command_filter = change

    def end(end_ns: int) -> None:
        if computer.command_filter is change:
            computer.command_filter = None

    return Injected(end)


def commands(change: Callable[[VehicleCommand, Params, random.Random, int], VehicleCommand | None]) -> Injection:
    """What becomes of the controller's commands on their way."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        rng = random.Random(p["chance"])
        return _filtered(rig, lambda command, t_ns: change(command, p, rng, t_ns))

    return begin


def frozen_command(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The controller repeats one command for ever, stamp and all."""
    kept: list[VehicleCommand] = []

    def change(command: VehicleCommand, t_ns: int) -> VehicleCommand:
        if not kept:
            kept.append(command)
        return kept[0]

    return _filtered(rig, change)


def fixed_stamp(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Every command carries the same stamp, which lies `ahead` ms in the future when it begins."""
    return _filtered(rig, lambda command, t_ns: replace(command, t_sensor_ns=now_ns + p["ahead"] * MS))


def fast_sensor_clock(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The sensor's clock gains `gain` ms on every ms: its stamps look younger and younger, then lie ahead of now."""

    def change(command: VehicleCommand, t_ns: int) -> VehicleCommand:
        return replace(command, t_sensor_ns=command.t_sensor_ns + round(p["gain"] * (t_ns - now_ns)))

    return _filtered(rig, change)


def clock_step(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The wall clock is set. Stamps travel as wall-clock time; for a second after a step a stamp is read by whichever
    offset makes it youngest without putting it into the future, so it may be taken as younger by a small step."""
    until_ns = now_ns + 1000 * MS
    step_ns = abs(p["step"]) * MS

    def change(command: VehicleCommand, t_ns: int) -> VehicleCommand:
        if t_ns >= until_ns or step_ns > t_ns - command.t_sensor_ns:
            return command
        return replace(command, t_sensor_ns=command.t_sensor_ns + step_ns)

    return _filtered(rig, change)


def paused(*processes: str) -> Injection:
    """Processes hang, and go on at the end as if nothing had been."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        computer = rig.computer
        for name in processes:
            setattr(computer, f"{name}_running", False)

        def end(end_ns: int) -> None:
            for name in processes:
                setattr(computer, f"{name}_running", True)

        return Injected(end)

    return begin


def restarted(*processes: str) -> Injection:
    """Processes end and are started again after the duration."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        computer = rig.computer
        for name in processes:
            if name == "bridge":
                computer.kill_bridge()
            else:
                setattr(computer, f"{name}_running", False)

        def end(end_ns: int) -> None:
            for name in processes:
                getattr(rig, f"start_{name}")()

        return Injected(end)

    return begin


def insisting_operator(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The bridge is killed and started again, and somebody asks for autonomous mode all the while."""
    begun = restarted("bridge")(rig, p, now_ns)
    started = False

    def tick(t_ns: int) -> None:
        nonlocal started
        if not started and t_ns - now_ns >= p["gone"] * MS:
            started = True
            begun.end(t_ns)
        if started:
            rig.bridge.set_mode("autonomous", t_ns)

    return Injected(tick=tick)


def plans(change: Callable[[Plan | None, Params, random.Random, int], Plan | None]) -> Injection:
    """What becomes of the planner's plans on their way."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        rng = random.Random(p["chance"])
        computer = rig.computer

        def changed(plan: Plan | None, t_ns: int) -> Plan | None:
            return change(plan, p, rng, t_ns)

        computer.plan_filter = changed

        def end(end_ns: int) -> None:
            if computer.plan_filter is changed:
                computer.plan_filter = None

        return Injected(end)

    return begin


def late_plans(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Each plan comes `delay` ms later, with the stamp of its data."""
    waiting: list[tuple[int, Plan | None]] = []
    last: list[Plan | None] = [rig.computer.plan]

    def change(plan: Plan | None, params: Params, rng: random.Random, t_ns: int) -> Plan | None:
        waiting.append((t_ns + p["delay"] * MS, plan))
        while waiting and waiting[0][0] <= t_ns:
            last[0] = waiting.pop(0)[1]
        return last[0]

    return plans(change)(rig, p, now_ns)


def cones(change: Callable[[ConeObservation, Params, random.Random], ConeObservation]) -> Injection:
    """What the detector makes of what it sees."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        rng = random.Random(p["chance"])
        before = rig.detector
        rig.detector = lambda observation: change(confident(observation), p, rng)

        def end(end_ns: int) -> None:
            rig.detector = before

        return Injected(end)

    return begin


def silent_detector(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """No observation comes at all."""
    rig.detects = False

    def end(end_ns: int) -> None:
        rig.detects = True

    return Injected(end)


def blind(seen: ConeObservation, p: Params, rng: random.Random) -> ConeObservation:
    return ConeObservation(seen.t_ns, seen.xy_m[:0], seen.color[:0], seen.confidence[:0])


def invented(seen: ConeObservation, p: Params, rng: random.Random) -> ConeObservation:
    count = p["count"]
    xy = np.array([[rng.uniform(1.0, 15.0), rng.uniform(-6.0, 6.0)] for _ in range(count)])
    color = np.array([rng.choice((ConeColor.BLUE, ConeColor.YELLOW)) for _ in range(count)], dtype=np.int64)
    return ConeObservation(
        seen.t_ns,
        np.concatenate([seen.xy_m, xy]),
        np.concatenate([seen.color, color]),
        np.concatenate([seen.confidence, np.full(count, 0.9)]),
    )


def shifted(seen: ConeObservation, p: Params, rng: random.Random) -> ConeObservation:
    return ConeObservation(seen.t_ns, seen.xy_m + np.array([0.0, p["size"]]), seen.color, seen.confidence)


def nan_cones(seen: ConeObservation, p: Params, rng: random.Random) -> ConeObservation:
    xy = seen.xy_m.copy()
    for row in range(len(xy)):
        if rng.random() < p["share"]:
            xy[row, rng.randrange(2)] = rng.choice((math.nan, math.inf, -math.inf, 1e30))
    return ConeObservation(seen.t_ns, xy, seen.color, seen.confidence)


def swapped_colours(seen: ConeObservation, p: Params, rng: random.Random) -> ConeObservation:
    color = seen.color.copy()
    color[seen.color == ConeColor.BLUE] = ConeColor.YELLOW
    color[seen.color == ConeColor.YELLOW] = ConeColor.BLUE
    return ConeObservation(seen.t_ns, seen.xy_m, color, seen.confidence)


# ---------------------------------------------------------------- the bridge's process and its bus


def hung_bridge(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The bridge's process stops for a while; frames wait for it in the socket."""
    rig.computer.hang_bridge(now_ns + p["hang"] * MS)
    return Injected()


def hung_edge(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The process between ROS and the loop stops for a while: no command comes through, no report gets out."""
    rig.computer.hang_edge(now_ns + p["hang"] * MS)
    return Injected()


def killed_edge(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The process between ROS and the loop ends without a word; the loop is left alone."""
    rig.computer.kill_edge()
    return Injected()


def late_loop(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The loop is late by `late` ms, once: it goes on so long after the instant at which a send was due."""
    rig.computer.hang_bridge(rig.computer.due_ns() + p["late"] * MS)
    return Injected()


def full_queue(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """The transmit queue takes no frame (or only the first few of a cycle)."""
    computer = rig.computer
    last = p.get("taken", 0)

    def takes(frame: Frame) -> bool:
        return frame.can_id in AI_IDS[:last]

    computer.takes_frame = takes

    def end(end_ns: int) -> None:
        computer.takes_frame = None

    return Injected(end)


def busy_queue(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Each frame finds the transmit queue full by chance."""
    computer = rig.computer
    rng = random.Random(p["chance"])

    def takes(frame: Frame) -> bool:
        return rng.random() >= float(p["share"])

    computer.takes_frame = takes

    def end(end_ns: int) -> None:
        computer.takes_frame = None

    return Injected(end)


def lost_bus(rig: Lockstep, p: Params, now_ns: int) -> Injected:
    """Bus-off, or the interface goes down for `gone` ms; the loop tries to open it again with growing pauses."""
    rig.computer.lose_bus(p["why"], now_ns)
    rig.wire.on_bus_lost()
    found = False
    try_ns, pause_ns = now_ns + 10 * MS, 10 * MS

    def tick(t_ns: int) -> None:
        nonlocal found, try_ns, pause_ns
        while not found and t_ns >= try_ns:
            if try_ns - now_ns >= p["gone"] * MS:
                found = True
                rig.computer.find_bus(t_ns)
            pause_ns = min(2 * pause_ns, 1000 * MS)
            try_ns += pause_ns

    return Injected(tick=tick)


def together(*parts: Injection) -> Injection:
    """Several faults at the same instant."""

    def begin(rig: Lockstep, p: Params, now_ns: int) -> Injected:
        begun = [part(rig, p, now_ns) for part in parts]

        def end(end_ns: int) -> None:
            for one in begun:
                one.end(end_ns)

        def tick(t_ns: int) -> None:
            for one in begun:
                if one.tick is not None:
                    one.tick(t_ns)

        return Injected(end, tick)

    return begin


def fallen_back(p: Params) -> Mapping[str, Any]:
    return {"as_state": AsState[p["state"]]}


# ---------------------------------------------------------------- what becomes of commands and plans


def no_command(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand | None:
    return None


def no_number(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    bad = {"nan": math.nan, "inf": math.inf, "beyond": 5.0, "negative": -0.9}[p["value"]]
    return replace(command, **{p["field"]: bad})  # type: ignore[arg-type]


def both_pedals(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    return replace(command, throttle=p["throttle"], brake=p["brake"])


def old_stamp(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    return replace(command, t_sensor_ns=command.t_sensor_ns - p["age"] * MS)


def future_stamp(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    return replace(command, t_sensor_ns=t_ns + p["ahead"] * MS)


def other_run(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    return replace(command, run_id=command.run_id + p["off"])


def gives_up(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    return replace(command, estop_request=True)


def says_finished(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    return replace(command, mission_finished=True)


def absurd(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    """Anything that is in range."""
    throttle = rng.random()
    brake = 0.0 if rng.random() < 0.5 else rng.random()
    return replace(
        command,
        steering_rad=rng.uniform(-0.36, 0.36),  # within 21 deg, what every revision takes
        throttle=0.0 if brake else throttle,
        brake=brake,
        speed_limit_mps=rng.uniform(0.0, 30.0),
    )


def swinging(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    side = 1.0 if t_ns // (p["period"] * MS) % 2 else -1.0
    return replace(command, steering_rad=side * 0.36)


def full_throttle(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    return replace(command, throttle=1.0, brake=0.0, speed_limit_mps=30.0)


def pumping(command: VehicleCommand, p: Params, rng: random.Random, t_ns: int) -> VehicleCommand:
    drives = bool(t_ns // (p["period"] * MS) % 2)
    return replace(command, throttle=1.0 if drives else 0.0, brake=0.0 if drives else 1.0)


def no_plan(plan: Plan | None, p: Params, rng: random.Random, t_ns: int) -> Plan | None:
    return None


def absurd_plan(plan: Plan | None, p: Params, rng: random.Random, t_ns: int) -> Plan | None:
    if plan is None:
        return None
    steps = np.array([[rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0)] for _ in range(20)])
    return replace(plan, path_m=np.cumsum(steps, axis=0))


def nan_plan(plan: Plan | None, p: Params, rng: random.Random, t_ns: int) -> Plan | None:
    if plan is None or len(plan.path_m) == 0:
        return plan
    path = plan.path_m.copy()
    path[rng.randrange(len(path)), rng.randrange(2)] = rng.choice((math.nan, math.inf))
    return replace(plan, path_m=path)


def swinging_plan(plan: Plan | None, p: Params, rng: random.Random, t_ns: int) -> Plan | None:
    if plan is None:
        return None
    side = 1.0 if t_ns // (p["period"] * MS) % 2 else -1.0
    x = np.linspace(0.0, 12.0, 25)
    return replace(plan, path_m=np.column_stack([x, side * 0.05 * x * x]))


def finished_plan(plan: Plan | None, p: Params, rng: random.Random, t_ns: int) -> Plan | None:
    return None if plan is None else replace(plan, finished=True, stop_distance_m=0.0)
