"""Faults of the AI computer: planner, controller and detector, the bridge, its loop, clock and bus."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

import numpy as np
from msgspec.structs import replace

from fsai_hil.evidence.campaign.endings import PAUSE, ROUGH, SILENT, SLACK_MS, STOP, End, Graded, Params, ends, estop
from fsai_hil.evidence.campaign.faults.kind import (
    CONTROL_MS,
    EVERY_MISSION,
    PATH_MISSIONS,
    UPSET,
    At,
    Draw,
    Entry,
    FaultKind,
    Injection,
    Ongoing,
    filtered,
    lasts,
    late,
    put,
)
from fsai_hil.rules.numbers import PEDALS_NS
from fsai_hil.simulator.lockstep import Lockstep, confident
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.driving import ConeColor, ConeObservation, Plan
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import PERIOD_NS
from fsai_vcu.interface.units import MS
from fsai_vcu.runtime.pacing import FALLBACK_AFTER_NS


def _filter_of(name: str, change: Callable[[Any, At], Any]) -> Injection:
    """Put a filter of the AI computer over what passes it; None takes its place."""
    return lambda fault, rig, p, now_ns: fault.put(rig.computer, name, filtered(change, p, now_ns))


commands = partial(_filter_of, "command_filter")  # what becomes of the controller's commands on their way


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
    return _filter_of("plan_filter", lambda plan, at: None if plan is None else change(plan, at))


def late_plans(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Each plan comes `delay` ms later, with the stamp of its data."""
    first = rig.computer.plan
    fault.put(rig.computer, "plan_filter", filtered(lambda plan, at: late(plan, first, at), p, now_ns))


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
        detector = filtered(change, p, now_ns)
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


def full_queue(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """The transmit queue takes no frame (or only the first few of a cycle)."""
    taken = AI_IDS[: p.get("taken", 0)]
    fault.put(rig.computer, "takes_frame", lambda frame: frame.can_id in taken)


def busy_queue(fault: Ongoing, rig: Lockstep, p: Params, now_ns: int) -> None:
    """Each frame finds the transmit queue full by chance."""
    rng = random.Random(p["chance"])
    fault.put(rig.computer, "takes_frame", lambda frame: rng.random() >= float(p["share"]))


# ---------------------------------------------------------------- endings and draws

SILENT_OURS = replace(SILENT, note="it never drives on by itself")
RESTARTED = ends(End.STOP, note="it never drives on by itself")
# Cones come every 50 ms, and are planned with after 40 ms: what is old then stops the car at its age of 700 ms.
PLAN_MS: Final = 90
OLD_STOPS = replace(STOP, brake_ms=700 + PLAN_MS + SLACK_MS)
LOST_COMMAND = Graded(((100, PAUSE), (300, STOP)))
COMMAND_BANDS = ((10, 60), (140, 240), (380, 2500))
OLD_DATA = Graded(((600, OLD_STOPS),))
BUS_LOST = "commands are dropped, and the bus is opened again with growing pauses"
SWINGS = Draw("period", (50, 500))


ROWS: Final[tuple[FaultKind, ...]] = (
    # ---------------------------------------------------------------- planner, controller, detector
    *(
        Entry(name, what).by(put(part, False), OLD_DATA, lasts((50, 280), (950, 3000)), missions=PATH_MISSIONS)
        for name, what, part in (
            ("planner_silent", "the planner hangs for a while", "computer.planner_running"),
            ("detector_silent", "the detector stops for a while", "detects"),
        )
    ),
    Entry("planner_restarted", "the planner ends and is started again in mid-drive").by(
        restarted("planner"),
        replace(RESTARTED, brake_ms=OLD_STOPS.brake_ms),
        lasts((0, 400), (950, 3000)),
        missions=PATH_MISSIONS,
    ),
    Entry("planner_restarted_unneeded", "the same where nobody needs its paths").by(
        restarted("planner"),
        RESTARTED,
        lasts((0, 2000)),
        missions=EVERY_MISSION - PATH_MISSIONS,
    ),
    Entry("planner_late", "each plan comes late, with the stamp of its data").by(
        late_plans,
        replace(OLD_DATA, of="delay"),
        Draw("delay", (20, 200), (950, 1500)),
        missions=PATH_MISSIONS,
    ),
    *(
        Entry(f"planner_{name}", what).by(plans(change), ROUGH, UPSET, *draws, missions=PATH_MISSIONS)
        for name, what, change, *draws in (
            ("empty", "the planner finds no way: empty paths", lambda plan, at: None),
            ("absurd", "the planner's paths go anywhere", absurd_plan),
            ("oscillating", "the planner's paths swing from left to right", swinging_plan, SWINGS),
            ("nan", "NaN or infinity in the planner's path", nan_plan),
        )
    ),
    Entry("planner_finishes_early", "the planner reports that the mission is over, at full speed").by(
        plans(lambda plan, at: replace(plan, finished=True, stop_distance_m=0.0)),
        replace(STOP, own_word=False, brake_ms=PLAN_MS + CONTROL_MS + SLACK_MS),
        missions=PATH_MISSIONS,
    ),
    Entry("controller_silent", "the controller hangs for a while").by(
        commands(lambda command, at: None), LOST_COMMAND, lasts(*COMMAND_BANDS)
    ),
    Entry("controller_restarted", "the controller ends and is started again in mid-drive").by(
        restarted("controller"),
        RESTARTED,
        lasts((0, 250), (400, 3000)),
    ),
    Entry(
        "controller_nan", "NaN, infinity or an out-of-range number in every command: refused whole, as if none had come"
    ).by(
        commanded(no_number),
        LOST_COMMAND,
        lasts(*COMMAND_BANDS),
        Draw("field", "steering_rad", "throttle", "brake"),
        Draw("value", "nan", "inf", "beyond", "negative"),
    ),
    Entry("controller_other_run", "commands for another run: they count as no command").by(
        commanded(lambda command, at: {"run_id": command.run_id + at.p["off"]}),
        LOST_COMMAND,
        lasts(*COMMAND_BANDS),
        Draw("off", (-3, -1), (1, 3)),
    ),
    Entry("controller_old_stamps", "commands carry a stamp that is too old").by(
        commanded(lambda command, at: {"t_sensor_ns": command.t_sensor_ns - at.p["age"] * MS}),
        Graded(((510, STOP),), "age"),
        Draw("age", (20, 180), (510, 570), (950, 3000)),
    ),
    Entry("controller_future_stamps", "commands carry a stamp of the future: they are refused whole").by(
        commanded(lambda command, at: {"t_sensor_ns": at.t_ns + at.p["ahead"] * MS}),
        LOST_COMMAND,
        lasts(*COMMAND_BANDS),
        Draw("ahead", (30, 5000)),
    ),
    Entry(
        "controller_fixed_future_stamp",
        "every command carries one stamp of the future, so many ms ahead of the fault's beginning",
    ).by(
        commanded(lambda command, at: {"t_sensor_ns": at.t_ns - at.since_ns + at.p["ahead"] * MS}),
        LOST_COMMAND,
        lasts(*COMMAND_BANDS),
        Draw("ahead", (450, 6000)),
    ),
    Entry(
        "sensor_clock_fast",
        "the sensors' clock gains so many ms on every ms: its stamps lie more and more ahead of now",
    ).by(
        commanded(lambda command, at: {"t_sensor_ns": command.t_sensor_ns + round(at.p["gain"] * at.since_ns)}),
        ends(End.STOP, note="a stamp over 20 ms ahead is refused; once they all are, they are lost"),
        Draw("gain", (0.2, 3.0)),
    ),
    Entry("controller_frozen", "one command is repeated, stamp and all").by(
        commands(lambda command, at: at.kept.setdefault("first", command)),
        OLD_DATA,
        lasts((50, 280), (950, 3000)),
    ),
    Entry("both_pedals", "throttle and brake in every command: the brake wins").by(
        commanded(lambda command, at: {"throttle": at.p["throttle"], "brake": at.p["brake"]}),
        Graded(((0, PAUSE), (100, estop(PEDALS_NS // MS + CONTROL_MS)))),
        lasts((10, 50), (160, 2000)),
        Draw("throttle", (0.05, 1.0)),
        Draw("brake", (0.05, 1.0)),
    ),
    Entry("controller_gives_up", "the controller asks for the emergency brake").by(
        commanded(lambda command, at: {"estop_request": True}), estop(CONTROL_MS)
    ),
    Entry("controller_finishes_early", "the controller reports that the mission is over, at full speed").by(
        commanded(lambda command, at: {"mission_finished": True}), STOP
    ),
    *(
        Entry(f"controller_{name}", what).by(commanded(change), ROUGH, UPSET, *draws)
        for name, what, change, *draws in (
            ("absurd", "commands of random numbers, each in range", absurd),
            ("swinging", "steering from lock to lock", swinging, Draw("period", (20, 400))),
            (
                "full_throttle",
                "full throttle for ever",
                lambda command, at: {"throttle": 1.0, "brake": 0.0, "speed_limit_mps": 30.0},
            ),
            ("pumping", "full throttle and full brake by turns", pumping, Draw("period", (20, 80))),
        )
    ),
    *(
        Entry(f"detector_{name}", f"the detector {what}").by(
            cones(change), ROUGH, UPSET, *draws, missions=PATH_MISSIONS
        )
        for name, what, change, *draws in (
            ("blind", "sees no cone", blind),
            ("inventing", "sees cones that are not there", invented, Draw("count", (1, 40))),
            ("shifted", "sees every cone beside its place, in m", shifted, Draw("size", (-3.0, 3.0))),
            ("nan", "gives NaN and infinity as places", nan_cones, Draw("share", (0.05, 1.0))),
            ("colour_blind", "takes blue for yellow and yellow for blue", swapped_colours),
        )
    ),
    # ---------------------------------------------------------------- the bridge, its loop, clock and bus
    Entry("bridge_killed", "the bridge's process is killed, and stays away").by(restarted("bridge"), SILENT_OURS),
    Entry("bridge_restarted", "the bridge is killed and started again in mid-drive").by(
        restarted("bridge"), SILENT_OURS, lasts((0, 3000))
    ),
    Entry("bridge_restarted_and_asked", "the same, and somebody asks for autonomous all the while").by(
        insisting_operator, SILENT_OURS, Draw("gone", (0, 3000))
    ),
    Entry("everything_restarted", "bridge, planner and controller end and are started again together").by(
        restarted("bridge", "planner", "controller"), SILENT_OURS, lasts((0, 3000))
    ),
    Entry("bridge_hung", "the loop's process stands still for a while, and the car's frames wait for it").by(
        lambda fault, rig, p, t_ns: rig.computer.hang_bridge(t_ns + p["hang"] * MS),
        Graded(((50, estop(82)), (100, SILENT_OURS)), "hang"),
        Draw("hang", (5, 35), (70, 82), (130, 2500)),
    ),
    Entry("edge_hung", "the process between ROS and the loop stands still for a while: no command comes through").by(
        lambda fault, rig, p, t_ns: rig.computer.hang_edge(t_ns + p["hang"] * MS),
        replace(LOST_COMMAND, of="hang"),
        Draw("hang", *COMMAND_BANDS),
    ),
    Entry("edge_killed", "the process between ROS and the loop is killed").by(
        lambda fault, rig, p, t_ns: rig.computer.kill_edge(),
        ends(End.STOP, End.SELF, note="at rest the loop ends, and the car takes the silence for an emergency"),
    ),
    Entry("loop_late", "the loop misses one deadline by so many ms").by(
        # The deadline that is missed is the answer to the car's next 0x520, which is due before the loop's own clock.
        lambda fault, rig, p, t_ns: rig.computer.hang_bridge(
            rig.computer.due_ns() - FALLBACK_AFTER_NS + PERIOD_NS + p["late"] * MS
        ),
        Graded(((50, estop(51 + 15)),), "late"),
        Draw("late", (49, 49), (51, 51)),
    ),
    Entry(
        "clock_stepped",
        "the wall clock is set by less than the age of the data, in ms (the nodes' stamps stop larger ones)",
    ).by(
        commanded(clock_step),
        ends(End.ON, note="only monotonic time is used"),
        Draw("step", (-50, -1), (1, 50)),
        missions=PATH_MISSIONS,
    ),
    *(
        Entry(name, what).by(
            full_queue,
            Graded(((50, ends(End.STOP, End.SELF, note="dropped cycles are tried again")), (100, SILENT))),
            lasts((5, 30), (66, 72), (130, 2500)),
            *draws,
        )
        for name, what, *draws in (
            ("bus_full", "the transmit queue is full (ENOBUFS)"),
            ("bus_full_partly", "each cycle fits into the queue only partly", Draw("taken", (1, 4))),
        )
    ),
    Entry("bus_busy", "each frame finds the queue full by chance").by(
        busy_queue,
        ends(End.ON, End.STOP, End.SELF, note="dropped cycles are tried again"),
        Draw("share", (0.002, 0.15)),
    ),
    *(
        Entry(name, what).by(
            lambda fault, rig, p, t_ns: rig.computer.lose_bus(p["why"], t_ns, t_ns + p["gone"] * MS),
            Graded(((0, ends(End.STOP, End.SELF, note=BUS_LOST)), (100, SILENT_OURS)), "gone"),
            Draw("gone", (1, 45), (130, 3000)),
            Draw("why", why),
        )
        for name, what, why in (
            ("bus_off", "the controller goes bus-off and comes back", "bus-off"),
            (
                "interface_down",
                "the interface is taken down and up again (in lockstep the same silence as bus-off)",
                "down",
            ),
        )
    ),
)
