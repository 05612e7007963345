"""Faults of the car's sensors and actuators, of its switches, and what people do to it."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.campaign.endings import (
    ANY,
    LOST_FEEDBACK,
    NOTHING,
    ODD,
    ROUGH,
    SLACK_MS,
    STOP,
    UNBELIEVED,
    WITHIN_LIMIT,
    End,
    Graded,
    Params,
    ends,
    estop,
)
from fsai_hil.evidence.campaign.faults.kind import (
    FEEDBACK_BANDS,
    ROAD_MISSIONS,
    UPSET,
    WHEELS,
    At,
    Draw,
    Entry,
    FaultKind,
    Injection,
    Ongoing,
    lasts,
    late,
    put,
    together,
)
from fsai_hil.evidence.campaign.faults.wire import SPEEDS, from_car
from fsai_hil.simulator.car_signals import Actuation, CarFeedback
from fsai_hil.simulator.faults import Changed
from fsai_hil.simulator.lockstep import Lockstep
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.frames import Frame


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
    "late": lambda value, before, at: late(value, 0.0, at),
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


def manual_asked(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    rig.bridge.set_mode("manual", now_ns)


def derated(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """The car lowers a limit of its own while it drives."""
    fault.put(rig.world.vcu.switches, p["limit"], p["value"])


# ---------------------------------------------------------------- endings and draws

ITSELF = ends(End.SELF, safe_ms=2 * SLACK_MS)
INEFFECTIVE = ends(
    *(End.STOP, End.ESTOP), safe_ms=3060, note="no deceleration, or still moving 3 s after the stop began"
)
# Torque goes before the brake comes, and 0.5 s without a deceleration count from the brake on.
NO_BRAKE = replace(INEFFECTIVE, safe_ms=500 + 10 + 2 * SLACK_MS + 10, note="no deceleration for 0.5 s")
EACH_WHEEL = Draw("wheel", *WHEELS)


ROWS: Final[tuple[FaultKind, ...]] = (
    # ---------------------------------------------------------------- sensors
    *(
        Entry(f"wheel_{name}", f"one wheel speed {what}").by(
            reading(change, "wheel_rpm"), must, EACH_WHEEL, *draws, missions=ROAD_MISSIONS
        )
        for name, what, change, must, *draws in (
            ("dead", "reads 0", "dead", ODD),
            ("stuck", "stands still", "stuck", ODD),
            ("drifting", "drifts, in rpm/s", "drifting", ODD, Draw("rate", (-300, -60), (60, 300))),
            ("very_noisy", "is noisy, sigma in rpm", "noisy", ODD, Draw("size", (80, 300))),
            ("offset", "is too high by so many rpm", "offset", ODD, Draw("size", (150, 600))),
            ("scaled", "reads a multiple", "scaled", ODD, Draw("factor", (0.2, 0.6), (1.6, 3.0))),
            ("noisy", "is a little noisy, sigma in rpm", "noisy", NOTHING, Draw("size", (1, 8))),
        )
    ),
    Entry("speeds_impossible", "wheel speeds above what the signal database allows: they are not believed").by(
        from_car({SPEEDS}, "impossible speeds"),
        LOST_FEEDBACK,
        lasts(*FEEDBACK_BANDS),
        Draw("wheel", *WHEELS, "all"),
        Draw("rpm", "1251", "1300", "65535"),
    ),
    Entry(
        "wheel_spiking",
        "one wheel speed jumps in every so many frames by more than any tyre can follow: such a frame is not believed",
    ).by(spiking_speed, NOTHING, EACH_WHEEL, Draw("every", (2, 6))),
    Entry(
        "wheels_jumping",
        "all wheel speeds jump up by so many rpm, more than any tyre can follow, and stay there: not believed",
    ).by(reading("offset", "wheel_rpm"), LOST_FEEDBACK.steps[-1][1], Draw("size", (400, 800))),
    Entry("wheels_stuck", "all wheel speeds stand still").by(reading("stuck", "wheel_rpm"), ANY, UPSET),
    Entry("wheels_dead", "all wheel speeds read 0").by(reading("dead", "wheel_rpm"), UNBELIEVED, UPSET),
    Entry("wheels_swapped", "two wheels exchanged, speeds and pulses").by(
        swapped_wheels,
        ends(End.ON, End.STOP, End.ESTOP, note="curves may make them implausible"),
        Draw("wheels", "fl-fr", "rl-rr", "fl-rr", "fr-rl", "fl-rl"),
        missions=ROAD_MISSIONS,
    ),
    Entry("pulses_wrong", "wheel pulses stand still, run double, or are chance").by(
        reading("wrong pulses", "pulses"),
        Graded((("stuck", UNBELIEVED),), "way"),
        Draw("way", "stuck", "double", "random"),
    ),
    Entry(
        "pulses_running_on",
        "the pulses of every wheel run on by themselves, so many a second, and the bridge is asked to stop",
    ).by(
        together(reading("wrong pulses", "pulses"), manual_asked),
        replace(UNBELIEVED, ends=frozenset((End.ESTOP,)), note="it never sends FINISHED"),
        Draw("way", "running"),
        Draw("rate", (30, 400)),
    ),
    *(
        Entry(f"steering_sensor_{name}", f"the steering angle measured {what}").by(
            reading(change, "steer_deg"), must, *draws
        )
        for name, what, change, must, *draws in (
            ("stuck", "stands still", "stuck", ODD),
            ("offset", "is off by so many deg", "offset", ODD, Draw("size", (-15.0, -4.0), (4.0, 15.0))),
            ("drifting", "drifts, in deg/s", "drifting", ODD, Draw("rate", (-6.0, -1.0), (1.0, 6.0))),
            ("noisy", "is noisy, sigma in deg", "noisy", ODD, Draw("size", (0.1, 5.0))),
            ("slightly_off", "is off by up to 1 deg", "offset", NOTHING, Draw("size", (-1.0, 1.0))),
        )
    ),
    Entry("brake_sensor_wrong", "brake pressures measured stand still, or are noise").by(
        reading("stuck or noise", *BRAKES), NOTHING, Draw("way", "stuck", "noise")
    ),
    *(
        Entry(f"gyro_{change}", f"the yaw rate of the PCAN-GPS {what}").by(
            reading(change, "yaw_rate_radps"), NOTHING, draw, missions=ROAD_MISSIONS, gps=True
        )
        for change, what, draw in (
            ("drifting", "drifts, in rad/s2", Draw("rate", (-0.5, 0.5))),
            ("noisy", "is noisy, sigma in rad/s", Draw("size", (0.05, 1.0))),
        )
    ),
    # ---------------------------------------------------------------- actuators
    *(
        Entry(f"steering_{name}", f"the steering {what}").by(ordered(change, "steer_deg"), ODD, *draws)
        for name, what, change, *draws in (
            ("stuck_rack", "sticks", "slow"),
            ("free", "does not follow: it returns to straight", "dead"),
            ("slow", "turns too slowly, in deg/s", "slow", Draw("rate", (2.0, 12.0))),
            ("weak", "reaches a part of its request only", "scaled", Draw("factor", (0.2, 0.7))),
            ("offset", "is off by so many deg", "offset", Draw("size", (-12.0, -5.0), (5.0, 12.0))),
            ("inverted", "turns the wrong way", "inverted"),
        )
    ),
    Entry("motor_dead", "no motor gives torque").by(ordered("dead", *TORQUES), ends(End.ON, note="as far as it rolls")),
    Entry("motor_weak", "the motors give a part of the torque").by(
        ordered("scaled", *TORQUES), NOTHING, Draw("factor", (0.1, 0.7))
    ),
    Entry("motor_one_axle", "one of the two driven axles gives no torque").by(
        ordered("dead", "front_torque_nm"), NOTHING, revisions=("2021",)
    ),
    Entry("motor_late", "torque comes and goes late, in ms").by(
        ordered("late", *TORQUES), NOTHING, Draw("delay", (20, 200))
    ),
    Entry("motor_runs_on", "the motors go on giving torque that is not requested, and the bridge is asked to stop").by(
        together(ordered("runs on", "rear_torque_nm"), manual_asked),
        INEFFECTIVE,
        Draw("torque", (20.0, 150.0)),
    ),
    *(
        Entry(f"brakes_{name}", f"{what}, and the bridge is asked to stop").by(
            together(ordered(change, *brakes), manual_asked), must, *draws
        )
        for name, what, change, brakes, must, *draws in (
            ("failing", "the service brake does nothing", "dead", BRAKES, NO_BRAKE),
            (
                "weak",
                "the service brake gives a part only",
                "scaled",
                BRAKES,
                INEFFECTIVE,
                Draw("factor", (0.02, 0.6)),
            ),
            (
                "slow",
                "brake pressure builds up slowly, in %/s",
                "builds up",
                BRAKES,
                INEFFECTIVE,
                Draw("rate", (5.0, 100.0)),
            ),
            ("front_only", "the rear brakes do nothing", "dead", BRAKES[1:], INEFFECTIVE),
            ("rear_only", "the front brakes do nothing", "dead", BRAKES[:1], INEFFECTIVE),
        )
    ),
    Entry("brakes_fail_driving", "the service brake does nothing while it drives").by(ordered("dead", *BRAKES), ROUGH),
    # ---------------------------------------------------------------- people, switches, the VCU
    *(
        Entry(name, what).by(put(f"world.vcu.switches.{switch}", value), ITSELF)
        for name, what, switch, value in (
            ("go_off", "the remote's Go is withdrawn", "go", False),
            ("asms_off", "ASMS is turned off", "asms", False),
            ("tsms_off", "TSMS is turned off", "tsms", False),
            ("remote_estop", "the remote E-stop is pressed", "remote_estop", True),
            ("car_estop", "an E-stop on the car is pressed", "car_estop", True),
            ("radio_lost", "the remote's radio is lost", "remote_radio_ok", False),
            ("dongle_out", "the autonomous dongle is pulled", "dongle", False),
            ("crash", "the crash sensor trips", "crash", True),
            ("bms_fault", "the battery reports a fault", "bms_fault", True),
            ("ebs_fault", "the EBS reports a fault", "ebs_fault", True),
            ("hvil_open", "the high-voltage interlock opens", "hvil_open", True),
        )
    ),
    Entry("ami_changed", "somebody turns the AMI in AS_DRIVING").by(
        put("world.vcu.switches.ami", Ami.STATIC_INSPECTION_A), STOP, missions=ROAD_MISSIONS
    ),
    Entry("steering_status_off", "STEERING_STATUS shows off: reported, no interlock").by(
        put("world.vcu.switches.steering_fault", True), NOTHING
    ),
    Entry("brake_status_fault", "STATUS_BRK shows fault: reported, no interlock").by(
        put("world.vcu.switches.brake_fault", True), NOTHING
    ),
    Entry("torque_derated", "the car lowers TRQ_MAX while it drives").by(
        derated, WITHIN_LIMIT, Draw("limit", "torque_limit_nm"), Draw("value", (0.0, 120.0))
    ),
    Entry("steering_derated", "the car lowers ANGLE_MAX while it drives").by(
        derated, WITHIN_LIMIT, Draw("limit", "steer_limit_deg"), Draw("value", (2.0, 20.0))
    ),
    Entry("vcu_reboots", "the VCU loses its power for a moment and starts again").by(
        put("world.vcu.switches.lvms", False),
        ends(End.OFF, End.SELF, End.ESTOP, note="a drive needs the whole sequence again"),
        lasts((5, 2000)),
    ),
    Entry("manual_asked", "manual mode is asked for while it drives").by(manual_asked, STOP),
    Entry("emergency_asked", "the emergency brake is asked for").by(
        lambda fault, rig, p, t_ns: rig.bridge.emergency_brake("asked by the campaign", t_ns), estop(0)
    ),
    Entry("refused_requests", "autonomous, an unknown mode and /reset are asked for while it drives: all refused").by(
        together(
            lambda fault, rig, p, t_ns: rig.bridge.set_mode("autonomous", t_ns),
            lambda fault, rig, p, t_ns: rig.bridge.set_mode("sideways", t_ns),
            lambda fault, rig, p, t_ns: rig.bridge.reset(t_ns),
        ),
        NOTHING,
    ),
    Entry("software_stopped", "this software is stopped in order while the car drives").by(
        lambda fault, rig, p, t_ns: rig.bridge.begin_stop(t_ns),
        ends(
            *(End.ESTOP, End.SELF, End.STOP),
            safe_ms=200,
            note="moving, ESTOP_REQUEST for five cycles, then silence",
        ),
    ),
)
