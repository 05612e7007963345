"""The injections do each fault to a run in lockstep: on the wire, to sensors, actuators, people, or the AI computer.

An `Injection` takes the fault, the run, the drawn parameters and the instant: it begins the fault, and notes in it how
it goes on and ends. What a fault draws by chance comes from its own `chance`, so that a case is the same wherever it
runs.
"""

from __future__ import annotations

import itertools
import math
import random
import struct
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from functools import partial, reduce
from typing import Any, Final

import numpy as np
from msgspec.structs import replace

from fsai_hil.evidence.campaign.endings import Params
from fsai_hil.simulator.car_signals import Actuation, CarFeedback
from fsai_hil.simulator.faults import (
    Changed,
    Delay,
    Drop,
    FlipBits,
    FrameFault,
    Freeze,
    Overwrite,
    Repeat,
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
from fsai_vcu.interface.values import Value


class Ongoing:
    """A fault under way: what takes it back at its end, and what it does every millisecond until then."""

    def __init__(self) -> None:
        self.end = ExitStack()
        self.ticks: list[Callable[[int], None]] = []

    def put(self, owner: object, name: str, value: object) -> None:
        """`owner.name` is `value` until the fault ends."""
        self.end.callback(setattr, owner, name, getattr(owner, name))
        setattr(owner, name, value)

    def listed(self, items: list[Any], item: object) -> None:
        """`item` is among `items` until the fault ends."""
        self.end.callback(items.remove, item)
        items.append(item)


Ids = frozenset[int]
Injection = Callable[[Ongoing, Lockstep, Params, int], object]


class At(Value, frozen=True):
    """An instant of a fault under way: its parameters, its chance, when, and what it keeps from one to the next."""

    p: Params
    rng: random.Random
    since_ns: int  # the fault began
    t_ns: int
    kept: dict[str, Any]


def put(part: str, value: object) -> Injection:
    """`part` of the run, by its dotted name, is `value` until the fault ends."""
    *owners, name = part.split(".")
    return lambda fault, rig, p, now_ns: fault.put(reduce(getattr, owners, rig), name, value)


def _filter(change: Callable[[Any, At], Any], p: Params, now_ns: int) -> Callable[[Any, int], Any]:
    """`change` of a value, with the instant of the fault that began at `now_ns`."""
    rng, kept = random.Random(p["chance"]), dict[str, Any]()
    return lambda value, t_ns: change(value, At(p, rng, t_ns - now_ns, t_ns, kept))


def together(*parts: Injection) -> Injection:
    """Several faults at the same instant."""

    def begin(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
        for part in parts:
            part(fault, rig, p, now_ns)

    return begin


# ---------------------------------------------------------------- the wire

STATUS, DRIVE_F, DRIVE_R, STEER, BRAKE, SPEEDS, COUNTS = VCU_IDS
LOGS: Final = frozenset({0x120, 0x500, 0x502})
GPS_IDS: Final = frozenset(range(0x600, 0x641))
FROM_CAR: Final = frozenset({*LOGS, *VCU_IDS})
AI_STATUS, AI_DRIVE_F, AI_DRIVE_R, AI_STEER, AI_BRAKE = AI_IDS
WHEELS: Final = ("fl", "fr", "rl", "rr")


def _mask(p: Params) -> bytes:
    rng = random.Random(p["chance"])
    mask = bytearray(8)
    for _ in range(p["bits"]):
        bit = rng.randrange(64)
        mask[bit // 8] |= 1 << bit % 8
    return bytes(mask)


def _impossible_speeds(ids: Ids, p: Params) -> FrameFault:
    """Report speeds that no wheel of this car can turn at, on one wheel or on all."""
    raw = struct.pack("<H", int(p["rpm"]))
    at, data = (0, raw * 4) if p["wheel"] == "all" else (2 * WHEELS.index(p["wheel"]), raw)
    return Overwrite(ids, at, data)


def _flickering_state(ids: Ids, p: Params) -> FrameFault:
    """Every other frame shows an AS_STATE that no table knows; HANDSHAKE stays what it is."""
    odd = itertools.cycle((True, False))

    def change(frame: Frame) -> Frame:
        return replace(frame, data=frame.data[:2] + bytes([p["state"]]) + frame.data[3:]) if next(odd) else frame

    return Changed(ids, change)


_NO_NUMBERS: Final = {"nan": math.nan, "inf": math.inf, "huge": 3e38}
_ON_THE_WIRE: Final[Mapping[str, Callable[[Ids, Params], FrameFault]]] = {
    "lost": lambda ids, p: Drop(ids),
    "thinned": lambda ids, p: Drop(ids, probability=p["share"], seed=p["chance"]),
    "late": lambda ids, p: Delay(ids, delay_ns=p["delay"] * MS),
    "jittering": lambda ids, p: Delay(ids, jitter_ns=p["delay"] * MS, seed=p["chance"]),
    "frozen": lambda ids, p: Freeze(ids),
    "twice": lambda ids, p: Repeat(ids, p["times"]),
    "flipped": lambda ids, p: FlipBits(ids, _mask(p)),
    "cut": lambda ids, p: WrongLength(ids, p["length"]),
    "no number": lambda ids, p: Overwrite(ids, 0, struct.pack("<f", _NO_NUMBERS[p["value"]])),
    "impossible speeds": _impossible_speeds,
    "flickering AS_STATE": _flickering_state,
    "undefined AS_STATE": lambda ids, p: Overwrite(ids, 2, bytes([p["state"]])),  # HANDSHAKE stays what it is
}


def _on_the_wire(side: str, ids: Iterable[int], how: str) -> Injection:
    """On one side of the VCU, on those of `ids` (all, but for the one that a parameter `message` names)."""
    make = _ON_THE_WIRE[how]

    def begin(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
        chosen = frozenset({int(p["message"], 16)} if "message" in p else ids)
        fault.listed(getattr(rig.world.vcu, side).faults, make(chosen, p))

    return begin


from_car = partial(_on_the_wire, "outgoing")  # what the car sends
to_car = partial(_on_the_wire, "incoming")  # what it receives; the bus itself shows what was sent


def status_shows(values: Callable[[Params], Mapping[str, Any]]) -> Injection:
    """Fields of 0x520 show something else."""
    ids = frozenset({STATUS})
    return lambda fault, rig, p, now_ns: fault.listed(
        rig.world.vcu.outgoing.faults, WrongValues(ids, rig.world.codec, values(p))
    )


def wild_handshake(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """HANDSHAKE on the wire is not what the VCU means: inverted, or thrown like a coin."""
    rng = random.Random(p["chance"])

    def change(frame: Frame) -> Frame:
        if p["way"] == "random" and rng.random() < 0.5:
            return frame
        return replace(frame, data=bytes((frame.data[0] ^ 1, *frame.data[1:])))

    fault.listed(rig.world.vcu.outgoing.faults, Changed(frozenset({STATUS}), change))


def spiking_speed(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Every so many frames one wheel speed jumps by more than any tyre can follow, for that one frame."""
    codec = rig.world.codec
    name = f"{p['wheel']}_rpm"
    seen = 0

    def change(frame: Frame) -> Frame:
        nonlocal seen
        seen += 1
        image = codec.decode(frame).image
        if seen % p["every"] or image is None:
            return frame
        spike = 1250 if getattr(image, name) < 600 else 0
        return replace(frame, data=codec.encode(replace(image, **{name: spike})).data)

    fault.listed(rig.world.vcu.outgoing.faults, Changed(frozenset({SPEEDS}), change))


def intruder(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Somebody else sends on one of the AI computer's ids."""
    rng = random.Random(p["chance"])
    can_id = int(p["message"], 16)
    length = BY_ID[can_id].dlc
    payload = bytes(length) if p["payload"] == "zeros" else rng.randbytes(length)

    def tick(t_ns: int) -> None:
        turn, rest_ns = divmod(t_ns - now_ns, p["period"] * MS)
        if not rest_ns and turn < p["frames"]:
            rig.intrude(Frame(can_id, payload, t_ns))

    fault.ticks.append(tick)


def other_revision(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """0x120, which is in 2021 only, comes every 10 ms."""

    def tick(t_ns: int) -> None:
        if not (t_ns - now_ns) % (10 * MS):
            rig.intrude(Frame(0x120, bytes(8), t_ns))

    fault.ticks.append(tick)


def stranger(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
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

    fault.ticks.append(tick)


# ---------------------------------------------------------------- sensors and actuators

TORQUES: Final = ("front_torque_nm", "rear_torque_nm")
BRAKES: Final = ("front_brake_pct", "rear_brake_pct")

# What a reading or an order becomes: of its value, its value at the fault's beginning, and the instant.
CHANGES: Final[Mapping[str, Callable[[Any, Any, At], Any]]] = {
    "stuck": lambda value, before, at: before,
    "dead": lambda value, before, at: 0.0,
    "drifting": lambda value, before, at: value + float(at.p["rate"]) * (at.since_ns / 1e9),
    "noisy": lambda value, before, at: value + at.rng.gauss(0.0, at.p["size"]),
    "offset": lambda value, before, at: value + float(at.p["size"]),
    "scaled": lambda value, before, at: value * float(at.p["factor"]),
    "inverted": lambda value, before, at: -value,
    "runs on": lambda value, before, at: max(value, at.p["torque"]),
    "late": lambda value, before, at: _late(value, 0.0, at),
    "slow": lambda value, before, at: _slow(value, before, at),
    "builds up": lambda value, before, at: _slow(value, before, at, falls=True),
    "stuck or noise": lambda value, before, at: before if at.p["way"] == "stuck" else at.rng.uniform(0.0, 100.0),
    "wrong pulses": lambda value, before, at: _wrong_pulses(value, before, at),
}


def _wrong_pulses(count: int, before: int, at: At) -> int:
    """A pulse counter stands still, runs double, is chance, or runs on by itself at `rate` pulses/s."""
    match at.p["way"]:
        case "stuck":
            return before
        case "double":
            return (2 * count - before) & 0xFFFF
        case "running":
            return (before + round(float(at.p["rate"]) * at.since_ns / 1e9)) & 0xFFFF
        case _:
            return at.rng.randrange(0x10000)


def _late(value: object, first: object, at: At) -> Any:
    """The value of `delay` ms ago; `first` before there was one."""
    waiting = at.kept.setdefault("waiting", deque())
    waiting.append((at.t_ns + at.p["delay"] * MS, value))
    while waiting and waiting[0][0] <= at.t_ns:
        at.kept["due"] = waiting.popleft()[1]
    return at.kept.get("due", first)


def _slow(value: float, before: float, at: At, *, falls: bool = False) -> float:
    """It changes by `rate` a second only (none: it sticks); one that `falls` does so at once."""
    was, t_ns = at.kept.get("slow", (before, at.t_ns - at.since_ns))
    most = at.p.get("rate", 0.0) * (at.t_ns - t_ns) / 1e9
    now = min(value, was + most) if falls else was + min(most, max(-most, value - was))
    at.kept["slow"] = now, at.t_ns
    return float(now)


def _fields(how: str, names: tuple[str, ...], before: object, p: Params, now_ns: int) -> Callable[[Any, int], Any]:
    """Return what `how` makes of fields; of four wheels it changes the one that a parameter `wheel` names, or all."""
    change, rng, kept = CHANGES[how], random.Random(p["chance"]), {name: dict[str, Any]() for name in names}
    chosen = [p.get("wheel", wheel) == wheel for wheel in WHEELS]

    def changed(real: Any, t_ns: int) -> Any:
        fields: dict[str, Any] = {}
        for name in names:
            value, then, at = getattr(real, name), getattr(before, name), At(p, rng, t_ns - now_ns, t_ns, kept[name])
            if isinstance(value, tuple):
                wheels = zip(value, then, chosen, strict=True)
                fields[name] = tuple(max(change(one, old, at), 0) if is_it else one for one, old, is_it in wheels)
            else:
                fields[name] = change(value, then, at)
        return replace(real, **fields)

    return changed


def reading(how: str, *names: str) -> Injection:
    """Change what the car's sensors read, by their fields."""

    def begin(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
        fault.listed(rig.world.sensor_faults, _fields(how, names, rig.world.car.feedback(), p, now_ns))

    return begin


def ordered(how: str, *names: str) -> Injection:
    """Change the orders that reach actuators, by their fields; the EBS has its own way to the brakes."""

    def begin(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
        before = replace(rig.world.vcu.actuation, steer_deg=rig.world.car.truth().steer_deg)
        change = _fields(how, names, before, p, now_ns)

        def order(real: Actuation, t_ns: int) -> Any:
            return real if real.ebs_engaged and names[0] in BRAKES else change(real, t_ns)

        fault.listed(rig.world.actuator_faults, order)

    return begin


def swapped_wheels(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Speeds and pulses of two wheels are exchanged."""
    one, other = (WHEELS.index(name) for name in p["wheels"].split("-"))
    order = list(range(4))
    order[one], order[other] = other, one

    def read(real: CarFeedback, t_ns: int) -> CarFeedback:
        changed: dict[str, Any] = {
            name: tuple(getattr(real, name)[wheel] for wheel in order) for name in ("wheel_rpm", "pulses")
        }
        return replace(real, **changed)

    fault.listed(rig.world.sensor_faults, read)


# ---------------------------------------------------------------- people and the car's electrics


def manual_asked(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    rig.bridge.set_mode("manual", now_ns)


def derated(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """The car lowers a limit of its own while it drives."""
    fault.put(rig.world.vcu.switches, p["limit"], p["value"])


def vcu_differs(**differences: Any) -> Injection:
    """The VCU's state machine differs from the specification's, by fields of `Profile`; it stays so."""
    return lambda fault, rig, p, now_ns: rig.world.vcu.behave(replace(rig.world.vcu.profile, **differences))


def hasty_go(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Go comes `ready` ms after AS_READY began."""
    vcu = rig.world.vcu

    def tick(t_ns: int) -> None:
        if vcu.state is AsState.AS_READY and vcu.in_state_ns >= p["ready"] * MS:
            vcu.switches.go = True

    fault.ticks.append(tick)


# ---------------------------------------------------------------- planner, controller, detector


def _filtered(name: str, change: Callable[[Any, At], Any]) -> Injection:
    """Put a filter of the AI computer over what passes it; None takes its place."""
    return lambda fault, rig, p, now_ns: fault.put(rig.computer, name, _filter(change, p, now_ns))


commands = partial(_filtered, "command_filter")  # what becomes of the controller's commands on their way


def commanded(fields: Callable[[VehicleCommand, At], Mapping[str, Any]]) -> Injection:
    """Fields of the controller's commands are others."""
    return commands(lambda command, at: replace(command, **fields(command, at)))


def clock_step(command: VehicleCommand, at: At) -> Mapping[str, Any]:
    """The wall clock is set. Stamps travel as wall-clock time; for a second after a step a stamp is read by whichever
    offset makes it youngest without putting it into the future, so it may be taken as younger by a small step."""
    step_ns = abs(at.p["step"]) * MS
    younger = at.since_ns < 1000 * MS and step_ns <= at.t_ns - command.t_sensor_ns
    return {"t_sensor_ns": command.t_sensor_ns + step_ns} if younger else {}


def no_number(command: VehicleCommand, at: At) -> Mapping[str, Any]:
    return {at.p["field"]: {"nan": math.nan, "inf": math.inf, "beyond": 5.0, "negative": -0.9}[at.p["value"]]}


def absurd(command: VehicleCommand, at: At) -> Mapping[str, Any]:
    """Anything that is in range."""
    throttle = at.rng.random()
    brake = 0.0 if at.rng.random() < 0.5 else at.rng.random()
    return {
        "throttle": 0.0 if brake else throttle,
        "brake": brake,
        "steering_rad": at.rng.uniform(-0.36, 0.36),  # within 21 deg, what every revision takes
        "speed_limit_mps": at.rng.uniform(0.0, 30.0),
    }


def _by_turns(at: At) -> bool:
    return bool(at.t_ns // (at.p["period"] * MS) % 2)


def swinging(command: VehicleCommand, at: At) -> Mapping[str, Any]:
    return {"steering_rad": 0.36 if _by_turns(at) else -0.36}


def pumping(command: VehicleCommand, at: At) -> Mapping[str, Any]:
    drives = _by_turns(at)
    return {"throttle": float(drives), "brake": float(not drives)}


def restarted(*processes: str) -> Injection:
    """Processes end and are started again after the duration."""

    def begin(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
        for name in processes:
            if name == "bridge":
                rig.computer.kill_bridge()
            else:
                setattr(rig.computer, f"{name}_running", False)

        for name in processes:
            fault.end.callback(*((rig.start_bridge,) if name == "bridge" else (rig.start, name)))

    return begin


def insisting_operator(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """The bridge is killed and started again, and somebody asks for autonomous mode all the while."""
    gone = Ongoing()
    restarted("bridge")(gone, rig, p, now_ns)

    def tick(t_ns: int) -> None:
        gone_ns = t_ns - now_ns - p["gone"] * MS
        if gone_ns == 0:
            gone.end.close()
        if gone_ns >= 0:
            rig.bridge.set_mode("autonomous", t_ns)

    fault.ticks.append(tick)


def plans(change: Callable[[Plan, At], Plan | None]) -> Injection:
    """Change the planner's plans on their way."""
    return _filtered("plan_filter", lambda plan, at: None if plan is None else change(plan, at))


def late_plans(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Each plan comes `delay` ms later, with the stamp of its data."""
    first = rig.computer.plan
    fault.put(rig.computer, "plan_filter", _filter(lambda plan, at: _late(plan, first, at), p, now_ns))


def absurd_plan(plan: Plan, at: At) -> Plan:
    steps = np.array([[at.rng.uniform(-2.0, 2.0), at.rng.uniform(-2.0, 2.0)] for _ in range(20)])
    return replace(plan, path_m=np.cumsum(steps, axis=0))


def nan_plan(plan: Plan, at: At) -> Plan:
    if len(plan.path_m) == 0:
        return plan
    path = plan.path_m.copy()
    path[at.rng.randrange(len(path)), at.rng.randrange(2)] = at.rng.choice((math.nan, math.inf))
    return replace(plan, path_m=path)


def swinging_plan(plan: Plan, at: At) -> Plan:
    side = 1.0 if _by_turns(at) else -1.0
    x = np.linspace(0.0, 12.0, 25)
    return replace(plan, path_m=np.column_stack([x, side * 0.05 * x * x]))


def cones(change: Callable[[ConeObservation, At], ConeObservation]) -> Injection:
    """Change what the detector makes of what it sees."""

    def begin(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
        detector = _filter(change, p, now_ns)
        fault.put(rig, "detector", lambda seen: detector(confident(seen), seen.t_ns))

    return begin


def blind(seen: ConeObservation, at: At) -> ConeObservation:
    return ConeObservation(seen.t_ns, seen.xy_m[:0], seen.color[:0], seen.confidence[:0])


def invented(seen: ConeObservation, at: At) -> ConeObservation:
    count = at.p["count"]
    xy = np.array([[at.rng.uniform(1.0, 15.0), at.rng.uniform(-6.0, 6.0)] for _ in range(count)])
    color = np.array([at.rng.choice((ConeColor.BLUE, ConeColor.YELLOW)) for _ in range(count)], dtype=np.int64)
    return ConeObservation(
        seen.t_ns,
        np.concatenate([seen.xy_m, xy]),
        np.concatenate([seen.color, color]),
        np.concatenate([seen.confidence, np.full(count, 0.9)]),
    )


def shifted(seen: ConeObservation, at: At) -> ConeObservation:
    return replace(seen, xy_m=seen.xy_m + np.array([0.0, at.p["size"]]))


def nan_cones(seen: ConeObservation, at: At) -> ConeObservation:
    xy = seen.xy_m.copy()
    for row in range(len(xy)):
        if at.rng.random() < at.p["share"]:
            xy[row, at.rng.randrange(2)] = at.rng.choice((math.nan, math.inf, -math.inf, 1e30))
    return replace(seen, xy_m=xy)


def swapped_colours(seen: ConeObservation, at: At) -> ConeObservation:
    color = seen.color.copy()
    color[seen.color == ConeColor.BLUE] = ConeColor.YELLOW
    color[seen.color == ConeColor.YELLOW] = ConeColor.BLUE
    return replace(seen, color=color)


# ---------------------------------------------------------------- the bridge's bus


def full_queue(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """The transmit queue takes no frame (or only the first few of a cycle)."""
    taken = AI_IDS[: p.get("taken", 0)]
    fault.put(rig.computer, "takes_frame", lambda frame: frame.can_id in taken)


def busy_queue(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Each frame finds the transmit queue full by chance."""
    rng = random.Random(p["chance"])
    fault.put(rig.computer, "takes_frame", lambda frame: rng.random() >= float(p["share"]))


def lost_bus(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Bus-off, or the interface goes down for `gone` ms; the loop tries to open it again with growing pauses."""
    rig.computer.lose_bus(p["why"], now_ns, now_ns + p["gone"] * MS)
