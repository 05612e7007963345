"""Every kind of fault, one row each: what it does, what is drawn by chance, where it applies, what must follow.

How a run must end depends on what was drawn, because the safety rules grade their reactions by time. Durations lie in
bands clear of those times: what happens exactly at a limit is for the exhaustive search, which knows no jitter.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.campaign import injections as inject
from fsai_hil.evidence.campaign.endings import (
    ANY,
    CAR_STOPS,
    IN_TIME_MS,
    MAY_STOP_ITSELF,
    NOTHING,
    ODD,
    PAUSE,
    SLACK_MS,
    STOP,
    UNBELIEVED,
    End,
    Graded,
    Must,
    ends,
    estop,
)
from fsai_hil.evidence.campaign.injections import Injection
from fsai_hil.rules import numbers as n
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import Ami, AsState, EbsState, OpState, ShutdownCause, TsState
from fsai_vcu.interface.errors import did_you_mean
from fsai_vcu.interface.messages import FAULT_NAMES, Faults
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import PERIOD_NS
from fsai_vcu.interface.units import MS
from fsai_vcu.interface.values import Value
from fsai_vcu.runtime.pacing import FALLBACK_AFTER_NS

PATH_MISSIONS: Final = frozenset({Ami.ACCELERATION, Ami.SKIDPAD, Ami.AUTOCROSS, Ami.TRACKDRIVE})
ROAD_MISSIONS: Final = PATH_MISSIONS | {Ami.AUTONOMOUS_DEMO}
EVERY_MISSION: Final = frozenset(Ami) - {Ami.NOT_SELECTED}
BOTH: Final = ("2021", "2026")

Bands = tuple[tuple[float, float], ...]


class Draw:
    """One parameter: a number from one of several bands, or one of several words."""

    def __init__(self, name: str, *of: tuple[float, float] | str) -> None:
        self.name = name
        self.words = [one for one in of if isinstance(one, str)]
        self.bands = [one for one in of if not isinstance(one, str)]

    def drawn(self, rng: random.Random) -> Any:
        if self.words:
            return rng.choice(self.words)
        low, high = rng.choice(self.bands)
        if isinstance(low, int) and isinstance(high, int):
            return rng.randint(low, high)
        return round(rng.uniform(low, high), 3)

    def parsed(self, text: str) -> Any:
        """The value in `text`; ValueError: what it may be."""
        if self.words:
            if text not in self.words:
                raise ValueError(f"{self.name} is {text!r}: choose one of {', '.join(self.words)}")
            return text
        whole = all(isinstance(bound, int) for band in self.bands for bound in band)
        of_0 = min(low for low, _ in self.bands) >= 0
        try:
            value = int(text) if whole else float(text)
        except ValueError:
            value = math.nan
        if math.isnan(value) or (of_0 and value < 0):
            number = f"{'whole ' if whole else ''}number{' of 0 or more' if of_0 else ''}"
            raise ValueError(f"{self.name} is {text!r}, but must be a {number}")
        return value

    def __str__(self) -> str:
        if self.words:
            return f"{self.name} {', '.join(self.words)}"
        return f"{self.name} {', '.join(f'{low:g}…{high:g}' for low, high in self.bands)}"


lasts = partial(Draw, "duration")  # how long, in ms
CONTROL_MS: Final = 20  # a command comes every 20 ms: what is wrong with it shows that much later


class FaultKind(Value, frozen=True):
    """One row. Without a drawn `duration` the fault lasts."""

    name: str
    what: str
    begin: Injection
    must: Must | Graded
    draws: tuple[Draw, ...] = ()
    missions: frozenset[Ami] = EVERY_MISSION
    revisions: tuple[str, ...] = BOTH
    gps: bool = False
    from_start: bool = False  # there from power-up on: such a run begins there, and the demand holds for all of it

    @property
    def parameters(self) -> str:
        return "; ".join(str(draw) for draw in self.draws)


class Entry(Value, frozen=True):
    """The beginning of a row: its name, and what it is."""

    name: str
    what: str

    def by(self, begin: Injection, must: Must | Graded, *draws: Draw, **where: Any) -> FaultKind:
        return FaultKind(self.name, self.what, begin, must, draws, **where)


# ---------------------------------------------------------------- endings shared by several rows

MAY_MEET = ends(End.ON, End.SELF, note="torque and brake may meet at the car")
ROUGH = ends(End.ON, End.HELD, End.STOP, End.ESTOP, note="every limit and interlock holds")
ITSELF = ends(End.SELF, safe_ms=2 * SLACK_MS)
NO_DRIVE = ends(End.STOP, note="no torque ever")
WITHIN_LIMIT = ends(End.ON, End.HELD, note="never above the live limit")
AXLE_IDLE = ends(End.ON, note="no torque on that axle while its limit is 100 ms old")
ECHO_REPLACED = ends(End.ON, note="two complete zero cycles stand for its echo")
SILENT = ends(End.SELF, safe_ms=IN_TIME_MS)
SILENT_OURS = replace(SILENT, note="it never drives on by itself")
RESTARTED = ends(End.STOP, note="it never drives on by itself")
# Cones come every 50 ms, and are planned with after 40 ms: what is old then stops the car at its age of 700 ms.
PLAN_MS: Final = 90
OLD_STOPS = replace(STOP, brake_ms=700 + PLAN_MS + SLACK_MS)

LOST_STATUS = Graded(((50, PAUSE), (100, CAR_STOPS)))
STATUS_BANDS = ((10, 30), (82, 86), (130, 2500))
NO_ECHO = Graded(((100, CAR_STOPS),))
LOST_FEEDBACK = Graded(((100, STOP), (300, estop(n.FEEDBACK_LOST_NS // MS))))
FEEDBACK_BANDS = ((10, 60), (130, 240), (360, 2500))
LOST_LIMIT = Graded(((0, AXLE_IDLE), (100, WITHIN_LIMIT)))
LOST_COMMAND = Graded(((100, PAUSE), (300, STOP)))
COMMAND_BANDS = ((10, 60), (140, 240), (380, 2500))
OLD_DATA = Graded(((600, OLD_STOPS),))
AI_SILENT = Graded(((100, SILENT),))
AI_SILENT_TORQUE = Graded(((0, MAY_MEET), (100, SILENT)))

INEFFECTIVE = ends(
    *(End.STOP, End.ESTOP), safe_ms=3060, note="no deceleration, or still moving 3 s after the stop began"
)
# Torque goes before the brake comes, and 0.5 s without a deceleration count from the brake on.
NO_BRAKE = replace(INEFFECTIVE, safe_ms=500 + 10 + 2 * SLACK_MS + 10, note="no deceleration for 0.5 s")


EACH_WHEEL = Draw("wheel", *inject.WHEELS)
BUS_LOST = "commands are dropped, and the bus is opened again with growing pauses"
SWINGS = Draw("period", (50, 500))
SHOWN = lasts((15, 1500))
UPSET = lasts((100, 4000))
FAULT_STATES: Final[Mapping[str, Any]] = MappingProxyType(
    {"ebs_state": EbsState.EBS_FAULT, "ts_state": TsState.TS_FAULT, "op_state": OpState.OP_FAULT}
)
OLD_MARKS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "switches": {"as_switch": False, "ts_switch": False},
        "shutdown_request": {"shutdown_request": True},
        "faults": {"faults": Faults(*(True for _ in Faults.__struct_fields__))},
        "cause": {"shutdown_cause": ShutdownCause.AI_COMMS_FAULT},
        "states": FAULT_STATES,
    }
)


def _message(
    prefix: str,
    can_id: int,
    of: str,
    *,
    lost: Graded,
    lost_ms: Bands,
    late_ms: Bands,
    frozen: Must | Graded = NOTHING,
    frozen_ms: Bands = ((50, 2500),),
    corrupted: Must = ANY,
) -> tuple[FaultKind, ...]:
    """All that can happen to one message on its way: the car's to us, or ours to the car.

    `lost` grades by the time without a believable message, be it that none comes, that they come later or too short.
    """
    ours = can_id in AI_IDS
    on_wire = partial(inject.to_car if ours else inject.from_car, {can_id})
    no_message = "has too few bytes: no believable message comes"
    late, cut = Draw("delay", *late_ms), Draw("length", (0, BY_ID[can_id].dlc - 1))
    times, bits = Draw("times", (2, 5)), Draw("bits", (1, 8))
    return tuple(
        Entry(f"{prefix}_{name}", f"{of} (0x{can_id:03X}){', as the car receives it,' if ours else ''} {does}").by(
            on_wire(fault), must, *draws
        )
        for name, does, fault, must, *draws in (
            ("lost", "stops coming", "lost", lost, lasts(*lost_ms)),
            ("late", "comes later, and goes on so", "late", replace(lost, of="delay"), late),
            ("frozen", "repeats one payload", "frozen", frozen, lasts(*frozen_ms)),
            ("twice", "arrives several times", "twice", NOTHING, times, lasts((100, 2500))),
            ("corrupted", "has bits flipped", "flipped", corrupted, lasts((10, 2000)), bits),
            ("wrong_length", no_message, "cut", lost, lasts(*lost_ms), cut),
        )
    )


# Wheel speeds and steering angle are supervised alike; the live torque limit of an axle; what the car can be driven
# without; one message of ours as the car receives it, and of those torque and brake, which must not meet there.
_feedback = partial(_message, lost=LOST_FEEDBACK, lost_ms=FEEDBACK_BANDS, late_ms=((5, 60), (130, 240), (360, 800)))
_limit = partial(
    _message,
    lost=LOST_LIMIT,
    lost_ms=((10, 60), (130, 2500)),
    late_ms=((5, 60), (130, 800)),
    corrupted=WITHIN_LIMIT,
)
_needless = partial(_message, lost=Graded(), lost_ms=((20, 2500),), late_ms=((5, 800),), corrupted=NOTHING)
_incoming = partial(
    _message,
    lost=AI_SILENT,
    lost_ms=((10, 65), (130, 2500)),
    late_ms=((5, 60), (130, 600)),
    frozen_ms=((150, 2500),),
)
_incoming_torque = partial(_incoming, lost=AI_SILENT_TORQUE)


ROWS: Final[tuple[FaultKind, ...]] = (
    # ---------------------------------------------------------------- what the car sends
    *_message(
        "status",
        inject.STATUS,
        "the car's state",
        lost=LOST_STATUS,
        lost_ms=STATUS_BANDS,
        late_ms=((5, 30), (65, 75), (130, 500)),
        frozen=NO_ECHO,
        frozen_ms=((10, 60), (150, 3000)),
    ),
    Entry("status_jittering", "0x520 comes at irregular times, in order").by(
        inject.from_car({inject.STATUS}, "jittering"), NOTHING, Draw("delay", (1, 25))
    ),
    Entry("status_falls_back", "0x520 shows another AS state for a while, the car drives").by(
        inject.status_shows(lambda p: {"as_state": AsState[p["state"]]}),
        ends(End.STOP, End.SELF, End.ESTOP, note="back in AS_DRIVING it brakes to rest"),
        SHOWN,
        Draw("state", "AS_OFF", "AS_READY", "AS_FINISHED", "EMERGENCY_BRAKE"),
    ),
    Entry("status_go_off", "0x520 shows GO_SIGNAL 0, the car drives").by(
        inject.status_shows(lambda p: {"go_signal": False}), STOP, SHOWN
    ),
    Entry("status_fault_bit", "0x520 shows FAULT_STATUS 1, the car drives").by(
        inject.status_shows(lambda p: {"fault": True}), STOP, SHOWN
    ),
    Entry("status_undefined_as_state", "0x520 shows an AS_STATE that no table knows, the car drives").by(
        inject.from_car({inject.STATUS}, "undefined AS_STATE"),
        Graded(((0, PAUSE), (100, estop(100)))),
        lasts((10, 40), (60, 86), (130, 2500)),
        Draw("state", (6, 15)),
    ),
    Entry("status_flickering_as_state", "0x520 shows an AS_STATE that no table knows in every other frame").by(
        inject.from_car({inject.STATUS}, "flickering AS_STATE"), PAUSE, lasts((30, 1500)), Draw("state", (6, 15))
    ),
    Entry("status_state_fault", "0x520 shows one of its states as FAULT while FAULT_STATUS stays 0, the car drives").by(
        inject.status_shows(lambda p: {p["state"]: FAULT_STATES[p["state"]]}),
        STOP,
        SHOWN,
        Draw("state", *FAULT_STATES),
        revisions=("2026",),
    ),
    Entry("status_ami", "0x520 shows another mission, or none, the car drives").by(
        inject.status_shows(lambda p: {"ami": Ami[p["ami"]]}),
        STOP,
        SHOWN,
        Draw("ami", Ami.NOT_SELECTED.name, Ami.AUTONOMOUS_DEMO.name),
        missions=EVERY_MISSION - {Ami.AUTONOMOUS_DEMO},
    ),
    *(
        Entry(f"status_{name}", f"0x520 shows {what} while FAULT_STATUS stays 0, the car drives").by(
            inject.status_shows(shown), STOP, SHOWN, *draws
        )
        for name, what, shown, *draws in (
            ("as_switch_off", "AS_SWITCH_STATUS 0", lambda p: {"as_switch": False}),
            ("ts_switch_off", "TS_SWITCH_STATUS 0", lambda p: {"ts_switch": False}),
            ("shutdown_request", "SHUTDOWN_REQUEST 1", lambda p: {"shutdown_request": True}),
            (
                "one_fault_bit",
                "one fault bit",
                lambda p: {"faults": Faults(**{field: name == p["bit"] for field, name in FAULT_NAMES.items()})},
                Draw("bit", *FAULT_NAMES.values()),
            ),
            (
                "shutdown_cause",
                "a SHUTDOWN_CAUSE",
                lambda p: {"shutdown_cause": ShutdownCause[p["cause"]]},
                Draw("cause", *(cause.name for cause in ShutdownCause if cause)),
            ),
        )
    ),
    Entry(
        "status_old_marks",
        "0x520 shows switches off, SHUTDOWN_REQUEST, fault bits, a SHUTDOWN_CAUSE or states since before the run",
    ).by(inject.status_shows(lambda p: OLD_MARKS[p["mark"]]), NOTHING, Draw("mark", *OLD_MARKS), from_start=True),
    Entry("vcu_drives_without_mission", "the AMI shows 0 all along, and the VCU goes on to AS_READY and AS_DRIVING").by(
        inject.together(
            inject.status_shows(lambda p: {"ami": Ami.NOT_SELECTED}),
            inject.vcu_differs(ready_without_acknowledgement=True),
        ),
        NO_DRIVE,
        from_start=True,
    ),
    Entry("vcu_hasty", "the VCU takes Go so many ms after AS_READY began, not after 5 s").by(
        inject.together(inject.vcu_differs(ready_wait_ns=MS), inject.hasty_go),
        NO_DRIVE,
        Draw("ready", (20, 60), (500, 4700)),
        from_start=True,
    ),
    Entry("vcu_shows_go_all_along", "0x520 shows GO_SIGNAL 1 from power-up on: no rising edge of Go was seen").by(
        inject.status_shows(lambda p: {"go_signal": True}), NO_DRIVE, from_start=True
    ),
    Entry("handshake_inverted", "HANDSHAKE toggles wrong on its way: inverted").by(
        inject.wild_handshake, NO_ECHO, lasts((10, 60), (150, 3000)), Draw("way", "inverted")
    ),
    Entry("handshake_random", "HANDSHAKE toggles wrong on its way: by chance").by(
        inject.wild_handshake, MAY_STOP_ITSELF, lasts((10, 3000)), Draw("way", "random")
    ),
    Entry("handshake_stuck", "HANDSHAKE stands still on its way").by(
        inject.status_shows(lambda p: {"handshake": p["bit"] == "1"}),
        NO_ECHO,
        lasts((10, 60), (150, 3000)),
        Draw("bit", "0", "1"),
    ),
    Entry("handshake_slow", "our echo reaches the car late, within its patience").by(
        inject.to_car({inject.AI_STATUS}, "late"), NOTHING, Draw("delay", (20, 70))
    ),
    *_limit("front_limit", inject.DRIVE_F, "the front axle's torque limit"),
    *_limit("rear_limit", inject.DRIVE_R, "the rear axle's torque limit"),
    *_feedback("steering", inject.STEER, "the steering angle", frozen=ODD),
    *_needless("brakes", inject.BRAKE, "brake feedback", lost=Graded(((0, ECHO_REPLACED),))),
    *_feedback("speeds", inject.SPEEDS, "the wheel speed message", frozen=ANY),
    *_needless("counts", inject.COUNTS, "the wheel pulse message", frozen=UNBELIEVED),
    Entry("logging_corrupted", "bits of the logging frames (0x120, 0x500, 0x502) are flipped").by(
        inject.from_car(inject.LOGS, "flipped"), NOTHING, lasts((20, 4000)), Draw("bits", (1, 12))
    ),
    Entry("everything_thinned", "each frame of the car is lost by chance").by(
        inject.from_car(inject.FROM_CAR, "thinned"), NOTHING, Draw("share", (0.01, 0.12))
    ),
    Entry("car_silent", "we receive nothing of the car, it receives us").by(
        inject.from_car(inject.FROM_CAR, "lost"), LOST_STATUS, lasts(*STATUS_BANDS)
    ),
    Entry("vcu_hangs", "the VCU neither sends nor receives for a while").by(
        inject.together(inject.from_car(inject.FROM_CAR, "lost"), inject.to_car(AI_IDS, "lost")),
        LOST_STATUS,
        lasts(*STATUS_BANDS),
    ),
    *(
        Entry(f"gps_{name}", what).by(
            inject.from_car(inject.GPS_IDS, fault), NOTHING, lasts((50, 4000)), *draws, gps=True
        )
        for name, what, fault, *draws in (
            ("lost", "the PCAN-GPS stops sending", "lost"),
            (
                "nan",
                "NaN, infinity or a huge number in a float of the PCAN-GPS",
                "no number",
                Draw("message", "0x610", "0x611", "0x621", "0x622", "0x623", "0x624", "0x625", "0x626"),
                Draw("value", "nan", "inf", "huge"),
            ),
            ("frozen", "the PCAN-GPS repeats one payload", "frozen"),
            ("corrupted", "bits of the PCAN-GPS's frames are flipped", "flipped", Draw("bits", (1, 12))),
        )
    ),
    # ---------------------------------------------------------------- what the car receives
    *_incoming("ai_status", inject.AI_STATUS, "our state", frozen=SILENT),
    *_incoming_torque("ai_front", inject.AI_DRIVE_F, "our front torque", frozen=MAY_MEET),
    *_incoming_torque("ai_rear", inject.AI_DRIVE_R, "our rear torque", frozen=MAY_MEET),
    *_incoming("ai_steer", inject.AI_STEER, "our steering request", frozen=ODD),
    *_incoming_torque(
        "ai_brake", inject.AI_BRAKE, "our brake request", frozen=ends(End.ON, End.SELF, End.STOP, End.ESTOP)
    ),
    Entry("ai_thinned", "each of our frames is lost on its way by chance").by(
        inject.to_car(AI_IDS, "thinned"), MAY_STOP_ITSELF, Draw("share", (0.01, 0.12))
    ),
    Entry("intruder", "somebody else sends on one of our ids").by(
        inject.intruder,
        ends(End.ESTOP, End.SELF, safe_ms=35, asks=True),
        Draw("message", "0x510", "0x511", "0x512", "0x513", "0x514"),
        Draw("frames", (1, 50)),
        Draw("period", (1, 20)),
        Draw("payload", "zeros", "random"),
    ),
    Entry("other_revision", "frames that only another revision has come beside the car's: they are named").by(
        inject.other_revision, NOTHING, lasts((20, 4000)), revisions=("2026",)
    ),
    Entry("stranger", "unknown, extended, remote and error frames every millisecond").by(
        inject.stranger, NOTHING, lasts((20, 1500))
    ),
    # ---------------------------------------------------------------- sensors
    *(
        Entry(f"wheel_{name}", f"one wheel speed {what}").by(
            inject.reading(change, "wheel_rpm"), must, EACH_WHEEL, *draws, missions=ROAD_MISSIONS
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
        inject.from_car({inject.SPEEDS}, "impossible speeds"),
        LOST_FEEDBACK,
        lasts(*FEEDBACK_BANDS),
        Draw("wheel", *inject.WHEELS, "all"),
        Draw("rpm", "1251", "1300", "65535"),
    ),
    Entry(
        "wheel_spiking",
        "one wheel speed jumps in every so many frames by more than any tyre can follow: such a frame is not believed",
    ).by(inject.spiking_speed, NOTHING, EACH_WHEEL, Draw("every", (2, 6))),
    Entry(
        "wheels_jumping",
        "all wheel speeds jump up by so many rpm, more than any tyre can follow, and stay there: not believed",
    ).by(inject.reading("offset", "wheel_rpm"), LOST_FEEDBACK.steps[-1][1], Draw("size", (400, 800))),
    Entry("wheels_stuck", "all wheel speeds stand still").by(inject.reading("stuck", "wheel_rpm"), ANY, UPSET),
    Entry("wheels_dead", "all wheel speeds read 0").by(inject.reading("dead", "wheel_rpm"), UNBELIEVED, UPSET),
    Entry("wheels_swapped", "two wheels exchanged, speeds and pulses").by(
        inject.swapped_wheels,
        ends(End.ON, End.STOP, End.ESTOP, note="curves may make them implausible"),
        Draw("wheels", "fl-fr", "rl-rr", "fl-rr", "fr-rl", "fl-rl"),
        missions=ROAD_MISSIONS,
    ),
    Entry("pulses_wrong", "wheel pulses stand still, run double, or are chance").by(
        inject.reading("wrong pulses", "pulses"),
        Graded((("stuck", UNBELIEVED),), "way"),
        Draw("way", "stuck", "double", "random"),
    ),
    Entry(
        "pulses_running_on",
        "the pulses of every wheel run on by themselves, so many a second, and we are asked to stop",
    ).by(
        inject.together(inject.reading("wrong pulses", "pulses"), inject.manual_asked),
        replace(UNBELIEVED, ends=frozenset((End.ESTOP,)), note="it never sends FINISHED"),
        Draw("way", "running"),
        Draw("rate", (30, 400)),
    ),
    *(
        Entry(f"steering_sensor_{name}", f"the steering angle measured {what}").by(
            inject.reading(change, "steer_deg"), must, *draws
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
        inject.reading("stuck or noise", *inject.BRAKES), NOTHING, Draw("way", "stuck", "noise")
    ),
    *(
        Entry(f"gyro_{change}", f"the yaw rate of the PCAN-GPS {what}").by(
            inject.reading(change, "yaw_rate_radps"), NOTHING, draw, missions=ROAD_MISSIONS, gps=True
        )
        for change, what, draw in (
            ("drifting", "drifts, in rad/s2", Draw("rate", (-0.5, 0.5))),
            ("noisy", "is noisy, sigma in rad/s", Draw("size", (0.05, 1.0))),
        )
    ),
    # ---------------------------------------------------------------- actuators
    *(
        Entry(f"steering_{name}", f"the steering {what}").by(inject.ordered(change, "steer_deg"), ODD, *draws)
        for name, what, change, *draws in (
            ("stuck_rack", "sticks", "slow"),
            ("free", "does not follow: it returns to straight", "dead"),
            ("slow", "turns too slowly, in deg/s", "slow", Draw("rate", (2.0, 12.0))),
            ("weak", "reaches a part of its request only", "scaled", Draw("factor", (0.2, 0.7))),
            ("offset", "is off by so many deg", "offset", Draw("size", (-12.0, -5.0), (5.0, 12.0))),
            ("inverted", "turns the wrong way", "inverted"),
        )
    ),
    Entry("motor_dead", "no motor gives torque").by(
        inject.ordered("dead", *inject.TORQUES), ends(End.ON, note="as far as it rolls")
    ),
    Entry("motor_weak", "the motors give a part of the torque").by(
        inject.ordered("scaled", *inject.TORQUES), NOTHING, Draw("factor", (0.1, 0.7))
    ),
    Entry("motor_one_axle", "one of the two driven axles gives no torque").by(
        inject.ordered("dead", "front_torque_nm"), NOTHING, revisions=("2021",)
    ),
    Entry("motor_late", "torque comes and goes late, in ms").by(
        inject.ordered("late", *inject.TORQUES), NOTHING, Draw("delay", (20, 200))
    ),
    Entry("motor_runs_on", "the motors go on giving torque which nobody asks for, and we are asked to stop").by(
        inject.together(inject.ordered("runs on", "rear_torque_nm"), inject.manual_asked),
        INEFFECTIVE,
        Draw("torque", (20.0, 150.0)),
    ),
    *(
        Entry(f"brakes_{name}", f"{what}, and we are asked to stop").by(
            inject.together(inject.ordered(change, *brakes), inject.manual_asked), must, *draws
        )
        for name, what, change, brakes, must, *draws in (
            ("failing", "the service brake does nothing", "dead", inject.BRAKES, NO_BRAKE),
            (
                "weak",
                "the service brake gives a part only",
                "scaled",
                inject.BRAKES,
                INEFFECTIVE,
                Draw("factor", (0.02, 0.6)),
            ),
            (
                "slow",
                "brake pressure builds up slowly, in %/s",
                "builds up",
                inject.BRAKES,
                INEFFECTIVE,
                Draw("rate", (5.0, 100.0)),
            ),
            ("front_only", "the rear brakes do nothing", "dead", inject.BRAKES[1:], INEFFECTIVE),
            ("rear_only", "the front brakes do nothing", "dead", inject.BRAKES[:1], INEFFECTIVE),
        )
    ),
    Entry("brakes_fail_driving", "the service brake does nothing while it drives").by(
        inject.ordered("dead", *inject.BRAKES), ROUGH
    ),
    # ---------------------------------------------------------------- people, switches, the VCU
    *(
        Entry(name, what).by(inject.put(f"world.vcu.switches.{switch}", value), ITSELF)
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
        inject.put("world.vcu.switches.ami", Ami.STATIC_INSPECTION_A), STOP, missions=ROAD_MISSIONS
    ),
    Entry("steering_status_off", "STEERING_STATUS shows off: reported, no interlock").by(
        inject.put("world.vcu.switches.steering_fault", True), NOTHING
    ),
    Entry("brake_status_fault", "STATUS_BRK shows fault: reported, no interlock").by(
        inject.put("world.vcu.switches.brake_fault", True), NOTHING
    ),
    Entry("torque_derated", "the car lowers TRQ_MAX while it drives").by(
        inject.derated, WITHIN_LIMIT, Draw("limit", "torque_limit_nm"), Draw("value", (0.0, 120.0))
    ),
    Entry("steering_derated", "the car lowers ANGLE_MAX while it drives").by(
        inject.derated, WITHIN_LIMIT, Draw("limit", "steer_limit_deg"), Draw("value", (2.0, 20.0))
    ),
    Entry("vcu_reboots", "the VCU loses its power for a moment and starts again").by(
        inject.put("world.vcu.switches.lvms", False),
        ends(End.OFF, End.SELF, End.ESTOP, note="a drive needs the whole sequence again"),
        lasts((5, 2000)),
    ),
    Entry("manual_asked", "manual mode is asked for while it drives").by(inject.manual_asked, STOP),
    Entry("emergency_asked", "the emergency brake is asked for").by(
        lambda fault, rig, p, t_ns: rig.bridge.emergency_brake("asked by the campaign", t_ns), estop(0)
    ),
    Entry("refused_requests", "autonomous, an unknown mode and /reset are asked for while it drives: all refused").by(
        inject.together(
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
    # ---------------------------------------------------------------- planner, controller, detector
    *(
        Entry(name, what).by(inject.put(part, False), OLD_DATA, lasts((50, 280), (950, 3000)), missions=PATH_MISSIONS)
        for name, what, part in (
            ("planner_silent", "the planner hangs for a while", "computer.planner_running"),
            ("detector_silent", "the detector stops for a while", "detects"),
        )
    ),
    Entry("planner_restarted", "the planner ends and is started again in mid-drive").by(
        inject.restarted("planner"),
        replace(RESTARTED, brake_ms=OLD_STOPS.brake_ms),
        lasts((0, 400), (950, 3000)),
        missions=PATH_MISSIONS,
    ),
    Entry("planner_restarted_unneeded", "the same where nobody needs its paths").by(
        inject.restarted("planner"),
        RESTARTED,
        lasts((0, 2000)),
        missions=EVERY_MISSION - PATH_MISSIONS,
    ),
    Entry("planner_late", "each plan comes late, with the stamp of its data").by(
        inject.late_plans,
        replace(OLD_DATA, of="delay"),
        Draw("delay", (20, 200), (950, 1500)),
        missions=PATH_MISSIONS,
    ),
    *(
        Entry(f"planner_{name}", what).by(inject.plans(change), ROUGH, UPSET, *draws, missions=PATH_MISSIONS)
        for name, what, change, *draws in (
            ("empty", "the planner finds no way: empty paths", lambda plan, at: None),
            ("absurd", "the planner's paths go anywhere", inject.absurd_plan),
            ("oscillating", "the planner's paths swing from left to right", inject.swinging_plan, SWINGS),
            ("nan", "NaN or infinity in the planner's path", inject.nan_plan),
        )
    ),
    Entry("planner_finishes_early", "the planner reports that the mission is over, at full speed").by(
        inject.plans(lambda plan, at: replace(plan, finished=True, stop_distance_m=0.0)),
        replace(STOP, own_word=False, brake_ms=PLAN_MS + CONTROL_MS + SLACK_MS),
        missions=PATH_MISSIONS,
    ),
    Entry("controller_silent", "the controller hangs for a while").by(
        inject.commands(lambda command, at: None), LOST_COMMAND, lasts(*COMMAND_BANDS)
    ),
    Entry("controller_restarted", "the controller ends and is started again in mid-drive").by(
        inject.restarted("controller"),
        RESTARTED,
        lasts((0, 250), (400, 3000)),
    ),
    Entry(
        "controller_nan", "NaN, infinity or an out-of-range number in every command: refused whole, as if none had come"
    ).by(
        inject.commanded(inject.no_number),
        LOST_COMMAND,
        lasts(*COMMAND_BANDS),
        Draw("field", "steering_rad", "throttle", "brake"),
        Draw("value", "nan", "inf", "beyond", "negative"),
    ),
    Entry("controller_other_run", "commands for another run: they count as no command").by(
        inject.commanded(lambda command, at: {"run_id": command.run_id + at.p["off"]}),
        LOST_COMMAND,
        lasts(*COMMAND_BANDS),
        Draw("off", (-3, -1), (1, 3)),
    ),
    Entry("controller_old_stamps", "commands carry a stamp that is too old").by(
        inject.commanded(lambda command, at: {"t_sensor_ns": command.t_sensor_ns - at.p["age"] * MS}),
        Graded(((510, STOP),), "age"),
        Draw("age", (20, 180), (510, 570), (950, 3000)),
    ),
    Entry("controller_future_stamps", "commands carry a stamp of the future: they are refused whole").by(
        inject.commanded(lambda command, at: {"t_sensor_ns": at.t_ns + at.p["ahead"] * MS}),
        LOST_COMMAND,
        lasts(*COMMAND_BANDS),
        Draw("ahead", (30, 5000)),
    ),
    Entry(
        "controller_fixed_future_stamp",
        "every command carries one stamp of the future, so many ms ahead of the fault's beginning",
    ).by(
        inject.commanded(lambda command, at: {"t_sensor_ns": at.t_ns - at.since_ns + at.p["ahead"] * MS}),
        LOST_COMMAND,
        lasts(*COMMAND_BANDS),
        Draw("ahead", (450, 6000)),
    ),
    Entry(
        "sensor_clock_fast",
        "the sensors' clock gains so many ms on every ms: its stamps lie more and more ahead of now",
    ).by(
        inject.commanded(lambda command, at: {"t_sensor_ns": command.t_sensor_ns + round(at.p["gain"] * at.since_ns)}),
        ends(End.STOP, note="a stamp over 20 ms ahead is refused; once they all are, they are lost"),
        Draw("gain", (0.2, 3.0)),
    ),
    Entry("controller_frozen", "one command is repeated, stamp and all").by(
        inject.commands(lambda command, at: at.kept.setdefault("first", command)),
        OLD_DATA,
        lasts((50, 280), (950, 3000)),
    ),
    Entry("both_pedals", "throttle and brake in every command: the brake wins").by(
        inject.commanded(lambda command, at: {"throttle": at.p["throttle"], "brake": at.p["brake"]}),
        Graded(((0, PAUSE), (100, estop(n.PEDALS_NS // MS + CONTROL_MS)))),
        lasts((10, 50), (160, 2000)),
        Draw("throttle", (0.05, 1.0)),
        Draw("brake", (0.05, 1.0)),
    ),
    Entry("controller_gives_up", "the controller asks for the emergency brake").by(
        inject.commanded(lambda command, at: {"estop_request": True}), estop(CONTROL_MS)
    ),
    Entry("controller_finishes_early", "the controller reports that the mission is over, at full speed").by(
        inject.commanded(lambda command, at: {"mission_finished": True}), STOP
    ),
    *(
        Entry(f"controller_{name}", what).by(inject.commanded(change), ROUGH, UPSET, *draws)
        for name, what, change, *draws in (
            ("absurd", "commands of random numbers, each in range", inject.absurd),
            ("swinging", "steering from lock to lock", inject.swinging, Draw("period", (20, 400))),
            (
                "full_throttle",
                "full throttle for ever",
                lambda command, at: {"throttle": 1.0, "brake": 0.0, "speed_limit_mps": 30.0},
            ),
            ("pumping", "full throttle and full brake by turns", inject.pumping, Draw("period", (20, 80))),
        )
    ),
    *(
        Entry(f"detector_{name}", f"the detector {what}").by(
            inject.cones(change), ROUGH, UPSET, *draws, missions=PATH_MISSIONS
        )
        for name, what, change, *draws in (
            ("blind", "sees no cone", inject.blind),
            ("inventing", "sees cones that are not there", inject.invented, Draw("count", (1, 40))),
            ("shifted", "sees every cone beside its place, in m", inject.shifted, Draw("size", (-3.0, 3.0))),
            ("nan", "gives NaN and infinity as places", inject.nan_cones, Draw("share", (0.05, 1.0))),
            ("colour_blind", "takes blue for yellow and yellow for blue", inject.swapped_colours),
        )
    ),
    # ---------------------------------------------------------------- the bridge, its loop, clock and bus
    Entry("bridge_killed", "the bridge's process is killed, and stays away").by(
        inject.restarted("bridge"), SILENT_OURS
    ),
    Entry("bridge_restarted", "the bridge is killed and started again in mid-drive").by(
        inject.restarted("bridge"), SILENT_OURS, lasts((0, 3000))
    ),
    Entry("bridge_restarted_and_asked", "the same, and somebody asks for autonomous all the while").by(
        inject.insisting_operator, SILENT_OURS, Draw("gone", (0, 3000))
    ),
    Entry("everything_restarted", "bridge, planner and controller end and are started again together").by(
        inject.restarted("bridge", "planner", "controller"), SILENT_OURS, lasts((0, 3000))
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
        inject.commanded(inject.clock_step),
        ends(End.ON, note="only monotonic time is used"),
        Draw("step", (-50, -1), (1, 50)),
        missions=PATH_MISSIONS,
    ),
    *(
        Entry(name, what).by(
            inject.full_queue,
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
        inject.busy_queue,
        ends(End.ON, End.STOP, End.SELF, note="dropped cycles are tried again"),
        Draw("share", (0.002, 0.15)),
    ),
    *(
        Entry(name, what).by(
            inject.lost_bus,
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

KINDS: Final[Mapping[str, FaultKind]] = MappingProxyType({kind.name: kind for kind in ROWS})


def kind_named(name: str) -> FaultKind:
    """The kind of that name; ValueError for an unknown one."""
    try:
        return KINDS[name]
    except KeyError:
        raise ValueError(
            f"unknown fault {name!r}{did_you_mean(name, KINDS) or f'; --list-faults shows the {len(KINDS)} there are'}"
        ) from None
