"""Every kind of fault, one row each: what it does, what is drawn by chance, where it applies, what must follow.

The demand of a row is a function of what was drawn, because the safety rules grade their reactions by time. Durations
lie in bands clear of those times: what happens exactly at a limit is for the exhaustive search, which knows no jitter.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Final

from fsai_hil.evidence.campaign import demands as d
from fsai_hil.evidence.campaign import injections as i
from fsai_hil.evidence.campaign.demands import ANY, CAR_STOPS, MAY_STOP_ITSELF, NOTHING, Demand, End, Onset, ends
from fsai_hil.evidence.campaign.injections import Injection, Params
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import Ami, ShutdownCause
from fsai_vcu.interface.messages import FAULT_NAMES, Faults
from fsai_vcu.interface.reserved import AI_IDS

PATH_MISSIONS: Final = frozenset({Ami.ACCELERATION, Ami.SKIDPAD, Ami.AUTOCROSS, Ami.TRACKDRIVE})
ROAD_MISSIONS: Final = PATH_MISSIONS | {Ami.AUTONOMOUS_DEMO}
EVERY_MISSION: Final = frozenset(Ami) - {Ami.NOT_SELECTED}
BOTH: Final = ("2021", "2026")


@dataclass(frozen=True, slots=True)
class Draw:
    """One parameter: a number from one of several bands, or one of several words."""

    name: str
    bands: tuple[tuple[float, float], ...] = ()
    words: tuple[str, ...] = ()

    def drawn(self, rng: random.Random) -> Any:
        if self.words:
            return rng.choice(self.words)
        low, high = rng.choice(self.bands)
        if isinstance(low, int) and isinstance(high, int):
            return rng.randint(low, high)
        return round(rng.uniform(low, high), 3)

    def parsed(self, text: str) -> Any:
        """The value in `text`; ValueError says what it may be."""
        if self.words:
            if text not in self.words:
                raise ValueError(f"{self.name} is {text!r}: choose one of {', '.join(self.words)}")
            return text
        whole = all(isinstance(bound, int) for band in self.bands for bound in band)
        try:
            return int(text) if whole else float(text)
        except ValueError:
            raise ValueError(f"{self.name} is {text!r}, but must be a {'whole ' if whole else ''}number") from None

    def __str__(self) -> str:
        if self.words:
            return f"{self.name} {'/'.join(self.words)}"
        return f"{self.name} {', '.join(f'{low:g}…{high:g}' for low, high in self.bands)}"


def between(name: str, *bands: tuple[float, float]) -> Draw:
    return Draw(name, bands)


def lasts(*bands: tuple[int, int]) -> Draw:
    """How long, in ms."""
    return Draw("duration", bands)


def one_of(name: str, *words: str) -> Draw:
    return Draw(name, words=words)


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultKind:
    """One row. `demanded` says in words what `demand` says in numbers. Without a drawn `duration` it lasts."""

    name: str
    what: str
    begin: Injection
    demanded: str
    demand: Callable[[Params], Demand]
    draws: tuple[Draw, ...] = ()
    missions: frozenset[Ami] = EVERY_MISSION
    revisions: tuple[str, ...] = BOTH
    gps: bool = False
    from_start: bool = False  # there from power-up on: such a run begins there, and the demand holds for all of it


def always(demand: Demand) -> Callable[[Params], Demand]:
    return lambda p: demand


def by(name: str, *steps: tuple[float, Demand]) -> Callable[[Params], Demand]:
    """The demand by the age that a parameter makes of a message."""
    return lambda p: d.by_age(p[name], *steps)


# ---------------------------------------------------------------- demands shared by several rows

Steps = tuple[tuple[float, Demand], ...]

LOST_STATUS = ((50, d.held(d.VCU_STALE_MS)), (100, CAR_STOPS))
LOST_STATUS_WORDS = "under 50 ms nothing; 50 ms torque 0, then on; 100 ms ESTOP_REQUEST (the car stops itself as well)"
STATUS_BANDS = ((10, 30), (82, 86), (130, 2500))

LOST_FEEDBACK = (
    (100, d.stop(d.FEEDBACK_STALE_MS)),
    (300, d.estop(d.FEEDBACK_LOST_MS, d.FEEDBACK_STALE_MS)),
)
LOST_FEEDBACK_WORDS = "under 100 ms nothing; 100 ms service-brake stop; 300 ms ESTOP_REQUEST"
FEEDBACK_BANDS = ((10, 60), (130, 240), (360, 2500))

LOST_LIMIT = ((100, ends(End.ON, End.HELD)),)
LOST_LIMIT_WORDS = "drives on; no torque on that axle while its limit is 100 ms old"

LOST_COMMAND = (
    (100, d.held(d.COMMAND_STALE_MS + d.CONTROL_MS)),
    (300, d.stop(d.COMMAND_LOST_MS + d.CONTROL_MS, d.COMMAND_STALE_MS + d.CONTROL_MS)),
)
LOST_COMMAND_WORDS = "under 100 ms nothing; 100 ms torque 0, then on; 300 ms service-brake stop"
COMMAND_BANDS = ((10, 60), (140, 240), (380, 2500))

OLD_DATA = ((600, d.stop(700 + d.PLAN_MS, d.SENSOR_STALE_MS + d.PLAN_MS)),)
OLD_DATA_WORDS = "under 500 ms nothing; data of 500 ms torque 0, 200 ms later service-brake stop"

CAR_HEARS = ((100, ends(End.SELF, safe_ms=d.CAR_PATIENCE_MS + d.SLACK_MS)),)
CAR_HEARS_WORDS = "under 100 ms nothing; 100 ms the car stops itself"
CAR_HEARS_TORQUE = ((0, MAY_STOP_ITSELF), *CAR_HEARS)
CAR_HEARS_TORQUE_WORDS = (
    "under 100 ms it drives on, or the car stops itself where torque meets brake there; 100 ms the car stops itself"
)
HEARS_BANDS = ((10, 65), (130, 2500))

STEERING_OFF = Demand(
    frozenset((End.ON, End.HELD, End.STOP, End.ESTOP)),
    brake_ms=d.IMPLAUSIBLE_MS + d.SLACK_MS,
    estop_ms=d.IMPLAUSIBLE_LOST_MS + d.SLACK_MS,
    onset=Onset.STEERING,
)
STEERING_OFF_WORDS = "once it is off by more than delay and play: 300 ms service-brake stop, 600 ms ESTOP_REQUEST"
WHEEL_OFF = Demand(
    frozenset((End.ON, End.HELD, End.STOP, End.ESTOP)),
    brake_ms=d.IMPLAUSIBLE_MS + d.SLACK_MS,
    estop_ms=d.IMPLAUSIBLE_LOST_MS + d.SLACK_MS,
    onset=Onset.WHEEL,
)
WHEEL_OFF_WORDS = "once beyond what slip explains: 300 ms service-brake stop, 600 ms ESTOP_REQUEST"
COUNTS_OFF = Demand(
    frozenset((End.ON, End.HELD, End.STOP, End.ESTOP)),
    brake_ms=d.FEEDBACK_STALE_MS + d.SLACK_MS,
    estop_ms=d.FEEDBACK_LOST_MS + d.SLACK_MS,
    onset=Onset.COUNTS,
)
COUNTS_OFF_WORDS = (
    "once speed and pulse count contradict each other the speeds are not believed: 100 ms service-brake stop, 300 ms"
    " ESTOP_REQUEST"
)
NOISE_WORDS = "noise comes and goes: drives on, and stops only where it is off for 300 ms without a break"

# Rules of the bus that hold in AS_DRIVING, and what an AS_STATE that nobody knows brings.
UNKNOWN_STATE = ((0, d.held(0)), (100, d.estop(d.CAR_PATIENCE_MS, 0)))
UNKNOWN_STATE_WORDS = "torque 0 at once, then on; 100 ms ESTOP_REQUEST"
EDGE_WORDS = "torque 0 and brake at once"
NO_DRIVE = ends(End.STOP, no_torque_ms=0)
NO_DRIVE_WORDS = "no torque ever; in AS_DRIVING at once a stop, FINISHED"
FAST_CLOCK_MS = 110 + 20  # the age of the oldest data behind a command, and how far ahead a stamp may be

ITSELF = ends(End.SELF, no_torque_ms=10 + d.SLACK_MS, safe_ms=2 * d.SLACK_MS)
ITSELF_WORDS = "the car stops itself; torque 0 at once"
INEFFECTIVE = ends(End.STOP, End.ESTOP, no_torque_ms=d.SLACK_MS, estop_ms=3000 + d.SLACK_MS, safe_ms=3000 + 60)
NO_BRAKE_MS = d.DECELERATION_MS + 2 * d.SLACK_MS + 10  # torque goes before the brake comes, and counting begins with it
NO_BRAKE = ends(End.STOP, End.ESTOP, no_torque_ms=d.SLACK_MS, estop_ms=NO_BRAKE_MS, safe_ms=3000 + 60)
NO_BRAKE_WORDS = "half a second without a deceleration: ESTOP_REQUEST; what comes to rest by itself is stopped"
INEFFECTIVE_WORDS = "no deceleration, or still moving 3 s after the stop began: ESTOP_REQUEST"
ROUGH = ends(End.ON, End.HELD, End.STOP, End.ESTOP)
ROUGH_WORDS = "limits and interlocks hold; drives on, or stops by one of the rules"
ANY_WORDS = "cannot be told from the truth: every rule on the wire holds; drives on, or stands in the end"
NOTHING_WORDS = "drives on"
MAY_WORDS = "drives on, or the car stops itself (the bus showed it nothing wrong)"
MAY_MEET_WORDS = "drives on, or the car stops itself where torque meets brake there"

EACH_WHEEL = one_of("wheel", *i.WHEELS)
OLD_MARKS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "switches": {"as_switch": False, "ts_switch": False},
        "shutdown_request": {"shutdown_request": True},
        "faults": {"faults": Faults(*(True for _ in fields(Faults)))},
        "cause": {"shutdown_cause": ShutdownCause.AI_COMMS_FAULT},
    }
)


def _message(
    prefix: str,
    can_id: int,
    of: str,
    *,
    lost: Steps,
    lost_words: str,
    lost_ms: tuple[tuple[int, int], ...],
    late_ms: tuple[tuple[int, int], ...],
    frozen: Callable[[Params], Demand],
    frozen_words: str,
    frozen_ms: tuple[tuple[int, int], ...],
    corrupted: Demand = ANY,
    corrupted_words: str = ANY_WORDS,
) -> tuple[FaultKind, ...]:
    """All that can happen to one message on its way: of the car's to us, or of ours to the car.

    `lost` grades by the time without a believable message, be it that none comes, that they come later or too short.
    """
    ours = can_id in AI_IDS
    on_wire = i.to_car if ours else i.from_car
    what = f"{of} (0x{can_id:03X})" + (", as the car hears it," if ours else "")

    def row(
        name: str,
        does: str,
        fault: i.WireFault,
        draws: tuple[Draw, ...],
        words: str,
        demand: Callable[[Params], Demand],
    ) -> FaultKind:
        return FaultKind(
            name=f"{prefix}_{name}",
            what=f"{what} {does}",
            begin=on_wire({can_id}, fault),
            draws=draws,
            demanded=words,
            demand=demand,
        )

    last_byte = BY_ID[can_id].dlc - 1
    return (
        row("lost", "stops coming", i.LOST, (lasts(*lost_ms),), lost_words, by("duration", *lost)),
        row(
            "late",
            "comes later, and goes on so",
            i.LATE,
            (between("delay", *late_ms),),
            lost_words,
            by("delay", *lost),
        ),
        row("frozen", "repeats one payload", i.FROZEN, (lasts(*frozen_ms),), frozen_words, frozen),
        row(
            "twice",
            "arrives several times",
            i.TWICE,
            (between("times", (2, 5)), lasts((100, 2500))),
            NOTHING_WORDS,
            always(NOTHING),
        ),
        row(
            "corrupted",
            "has bits flipped",
            i.FLIPPED,
            (lasts((10, 2000)), between("bits", (1, 8))),
            corrupted_words,
            always(corrupted),
        ),
        row(
            "wrong_length",
            "has too few bytes: no believable message comes",
            i.CUT,
            (lasts(*lost_ms), between("length", (0, last_byte))),
            lost_words,
            by("duration", *lost),
        ),
    )


def _feedback(prefix: str, can_id: int, of: str, frozen: Demand, frozen_words: str) -> tuple[FaultKind, ...]:
    """Wheel speeds and steering angle are supervised alike."""
    return _message(
        prefix,
        can_id,
        of,
        lost=LOST_FEEDBACK,
        lost_words=LOST_FEEDBACK_WORDS,
        lost_ms=FEEDBACK_BANDS,
        late_ms=((5, 60), (130, 240), (360, 800)),
        frozen=always(frozen),
        frozen_words=frozen_words,
        frozen_ms=((50, 2500),),
    )


def _limit(prefix: str, can_id: int, of: str) -> tuple[FaultKind, ...]:
    """The live torque limit of one axle."""
    return _message(
        prefix,
        can_id,
        of,
        lost=LOST_LIMIT,
        lost_words=LOST_LIMIT_WORDS,
        lost_ms=((10, 60), (130, 2500)),
        late_ms=((5, 60), (130, 800)),
        frozen=always(NOTHING),
        frozen_words=NOTHING_WORDS,
        frozen_ms=((50, 2500),),
        corrupted=ends(End.ON, End.HELD),
        corrupted_words="torque never above the limit that was read; drives on",
    )


def _needless(
    prefix: str, can_id: int, of: str, words: str, frozen: Demand = NOTHING, frozen_words: str = NOTHING_WORDS
) -> tuple[FaultKind, ...]:
    """What the car can be driven without."""
    return _message(
        prefix,
        can_id,
        of,
        lost=(),
        lost_words=words,
        lost_ms=((20, 2500),),
        late_ms=((5, 800),),
        frozen=always(frozen),
        frozen_words=frozen_words,
        frozen_ms=((50, 2500),),
        corrupted=NOTHING,
        corrupted_words=NOTHING_WORDS,
    )


def _heard(
    prefix: str, can_id: int, of: str, *, frozen: Demand, frozen_words: str, torque: bool = False
) -> tuple[FaultKind, ...]:
    """One message of ours, as the car hears it. `torque`: of it or of the brake, which must not meet there."""
    return _message(
        prefix,
        can_id,
        of,
        lost=CAR_HEARS_TORQUE if torque else CAR_HEARS,
        lost_words=CAR_HEARS_TORQUE_WORDS if torque else CAR_HEARS_WORDS,
        lost_ms=HEARS_BANDS,
        late_ms=((5, 60), (130, 600)),
        frozen=always(frozen),
        frozen_words=frozen_words,
        frozen_ms=((150, 2500),),
    )


def _switch(name: str, what: str, switch: str, value: object = True, **row: Any) -> FaultKind:
    given: dict[str, Any] = {"demanded": ITSELF_WORDS, "demand": always(ITSELF), **row}
    return FaultKind(name=name, what=what, begin=i.switched(switch, value), **given)


ROWS: Final[tuple[FaultKind, ...]] = (
    # ---------------------------------------------------------------- what the car says
    *_message(
        "status",
        i.STATUS,
        "the car's state",
        lost=LOST_STATUS,
        lost_words=LOST_STATUS_WORDS,
        lost_ms=STATUS_BANDS,
        late_ms=((5, 30), (65, 75), (130, 500)),
        frozen=by("duration", (100, CAR_STOPS)),
        frozen_words="under 100 ms nothing; 100 ms the car stops itself, for the handshake stands still",
        frozen_ms=((10, 60), (150, 3000)),
    ),
    FaultKind(
        name="status_jittering",
        what="0x520 comes at irregular times, in order",
        begin=i.from_car({i.STATUS}, i.JITTERING),
        draws=(between("delay", (1, 25)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="status_falls_back",
        what="0x520 shows another AS state for a while, the car drives",
        begin=i.says({i.STATUS}, i.fallen_back),
        draws=(lasts((15, 1500)), one_of("state", "AS_OFF", "AS_READY", "AS_FINISHED", "EMERGENCY_BRAKE")),
        demanded="zeros at once; back in AS_DRIVING it brakes to rest (NEUTRAL while moving: the car stops itself)",
        demand=always(ends(End.STOP, End.SELF, End.ESTOP, no_torque_ms=10 + d.SLACK_MS)),
    ),
    FaultKind(
        name="status_go_off",
        what="0x520 shows GO_SIGNAL 0, the car drives",
        begin=i.says({i.STATUS}, lambda p: {"go_signal": False}),
        draws=(lasts((15, 1500)),),
        demanded="torque 0 and brake at once",
        demand=always(d.stop(10)),
    ),
    FaultKind(
        name="status_fault_bit",
        what="0x520 shows FAULT_STATUS 1, the car drives",
        begin=i.says({i.STATUS}, lambda p: {"fault": True}),
        draws=(lasts((15, 1500)),),
        demanded="torque 0 and brake at once",
        demand=always(d.stop(10)),
    ),
    FaultKind(
        name="status_undefined_as_state",
        what="0x520 shows an AS_STATE that no table knows, the car drives",
        begin=i.from_car({i.STATUS}, i.UNDEFINED_AS_STATE),
        draws=(lasts((10, 40), (60, 86), (130, 2500)), between("state", (6, 15))),
        demanded=UNKNOWN_STATE_WORDS,
        demand=by("duration", *UNKNOWN_STATE),
    ),
    *(
        FaultKind(
            name=f"status_{name}",
            what=f"0x520 shows {what} while FAULT_STATUS stays 0, the car drives",
            begin=i.says({i.STATUS}, values),
            draws=(lasts((15, 1500)), *draws),
            demanded=EDGE_WORDS,
            demand=always(d.stop(10)),
        )
        for name, what, values, draws in (
            ("as_switch_off", "AS_SWITCH_STATUS 0", lambda p: {"as_switch": False}, ()),
            ("ts_switch_off", "TS_SWITCH_STATUS 0", lambda p: {"ts_switch": False}, ()),
            ("shutdown_request", "SHUTDOWN_REQUEST 1", lambda p: {"shutdown_request": True}, ()),
            (
                "one_fault_bit",
                "one fault bit",
                lambda p: {"faults": Faults(**{field: name == p["bit"] for field, name in FAULT_NAMES.items()})},
                (one_of("bit", *FAULT_NAMES.values()),),
            ),
            (
                "shutdown_cause",
                "a SHUTDOWN_CAUSE",
                lambda p: {"shutdown_cause": ShutdownCause[p["cause"]]},
                (one_of("cause", *(cause.name for cause in ShutdownCause if cause)),),
            ),
        )
    ),
    FaultKind(
        name="status_old_marks",
        what="0x520 shows switches off, SHUTDOWN_REQUEST, fault bits or a SHUTDOWN_CAUSE since before the run",
        begin=i.says({i.STATUS}, lambda p: OLD_MARKS[p["mark"]]),
        draws=(one_of("mark", *OLD_MARKS),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
        from_start=True,
    ),
    FaultKind(
        name="vcu_drives_without_mission",
        what="the AMI shows 0 all along, and the VCU goes on to AS_READY and AS_DRIVING",
        begin=i.together(
            i.says({i.STATUS}, lambda p: {"ami": Ami.NOT_SELECTED}),
            i.vcu_differs(ready_without_acknowledgement=lambda p: True),
        ),
        demanded=NO_DRIVE_WORDS,
        demand=always(NO_DRIVE),
        from_start=True,
    ),
    FaultKind(
        name="vcu_hasty",
        what="the VCU takes Go so many ms after AS_READY began, not after 5 s",
        begin=i.together(i.vcu_differs(ready_wait_ns=lambda p: i.MS), i.hasty_go),
        draws=(between("ready", (20, 60), (500, 4700)),),
        demanded=NO_DRIVE_WORDS,
        demand=always(NO_DRIVE),
        from_start=True,
    ),
    FaultKind(
        name="vcu_shows_go_all_along",
        what="0x520 shows GO_SIGNAL 1 from power-up on: no rising edge of Go was seen",
        begin=i.says({i.STATUS}, lambda p: {"go_signal": True}),
        demanded=NO_DRIVE_WORDS,
        demand=always(NO_DRIVE),
        from_start=True,
    ),
    FaultKind(
        name="handshake_inverted",
        what="HANDSHAKE toggles wrong on its way: inverted",
        begin=i.wild_handshake,
        draws=(lasts((10, 60), (150, 3000)), one_of("way", "inverted")),
        demanded="under 100 ms nothing; 100 ms the car stops itself, for the echo does not match",
        demand=by("duration", (100, CAR_STOPS)),
    ),
    FaultKind(
        name="handshake_random",
        what="HANDSHAKE toggles wrong on its way: by chance",
        begin=i.wild_handshake,
        draws=(lasts((10, 3000)), one_of("way", "random")),
        demanded=MAY_WORDS,
        demand=always(MAY_STOP_ITSELF),
    ),
    FaultKind(
        name="handshake_stuck",
        what="HANDSHAKE stands still on its way",
        begin=i.says({i.STATUS}, lambda p: {"handshake": p["bit"] == "1"}),
        draws=(lasts((10, 60), (150, 3000)), one_of("bit", "0", "1")),
        demanded="under 100 ms nothing; 100 ms the car stops itself, for the echo does not match",
        demand=by("duration", (100, CAR_STOPS)),
    ),
    FaultKind(
        name="handshake_slow",
        what="our echo reaches the car late, within its patience",
        begin=i.to_car({i.AI_STATUS}, i.LATE),
        draws=(between("delay", (20, 70)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    *_limit("front_limit", i.DRIVE_F, "the front axle's torque limit"),
    *_limit("rear_limit", i.DRIVE_R, "the rear axle's torque limit"),
    *_feedback("steering", i.STEER, "the steering angle", STEERING_OFF, STEERING_OFF_WORDS),
    *_needless("brakes", i.BRAKE, "brake feedback", "drives on: two complete zero cycles stand for its echo"),
    *_feedback("speeds", i.SPEEDS, "wheel speeds", ANY, ANY_WORDS),
    *_needless("counts", i.COUNTS, "wheel pulses", NOTHING_WORDS, COUNTS_OFF, COUNTS_OFF_WORDS),
    FaultKind(
        name="logging_corrupted",
        what="bits of the logging frames (0x120, 0x500, 0x502) are flipped",
        begin=i.from_car(i.LOGS, i.FLIPPED),
        draws=(lasts((20, 4000)), between("bits", (1, 12))),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="everything_thinned",
        what="each frame of the car is lost by chance",
        begin=i.from_car(i.FROM_CAR, i.THINNED),
        draws=(between("share", (0.01, 0.12)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="car_silent",
        what="we hear nothing of the car, it hears us",
        begin=i.from_car(i.FROM_CAR, i.LOST),
        draws=(lasts(*STATUS_BANDS),),
        demanded=LOST_STATUS_WORDS,
        demand=by("duration", *LOST_STATUS),
    ),
    FaultKind(
        name="vcu_hangs",
        what="the VCU neither speaks nor hears for a while",
        begin=i.both_ways,
        draws=(lasts(*STATUS_BANDS),),
        demanded=LOST_STATUS_WORDS,
        demand=by("duration", *LOST_STATUS),
    ),
    FaultKind(
        name="gps_lost",
        what="the PCAN-GPS stops sending",
        begin=i.from_car(i.GPS_IDS, i.LOST),
        draws=(lasts((50, 4000)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
        gps=True,
    ),
    FaultKind(
        name="gps_nan",
        what="NaN, infinity or a huge number in a float of the PCAN-GPS",
        begin=i.from_car(i.GPS_IDS, i.NOT_A_NUMBER),
        draws=(
            lasts((50, 4000)),
            one_of("message", "0x610", "0x611", "0x621", "0x622", "0x623", "0x624", "0x625", "0x626"),
            one_of("value", "nan", "inf", "huge"),
        ),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
        gps=True,
    ),
    FaultKind(
        name="gps_frozen",
        what="the PCAN-GPS repeats one payload",
        begin=i.from_car(i.GPS_IDS, i.FROZEN),
        draws=(lasts((50, 4000)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
        gps=True,
    ),
    FaultKind(
        name="gps_corrupted",
        what="bits of the PCAN-GPS's frames are flipped",
        begin=i.from_car(i.GPS_IDS, i.FLIPPED),
        draws=(lasts((50, 4000)), between("bits", (1, 12))),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
        gps=True,
    ),
    # ---------------------------------------------------------------- what the car hears
    *_heard(
        "ai_status",
        i.AI_STATUS,
        "our state",
        frozen=CAR_HEARS[0][1],
        frozen_words="100 ms the car stops itself, for the echo does not match",
    ),
    *_heard(
        "ai_front", i.AI_DRIVE_F, "our front torque", frozen=MAY_STOP_ITSELF, frozen_words=MAY_MEET_WORDS, torque=True
    ),
    *_heard(
        "ai_rear", i.AI_DRIVE_R, "our rear torque", frozen=MAY_STOP_ITSELF, frozen_words=MAY_MEET_WORDS, torque=True
    ),
    *_heard("ai_steer", i.AI_STEER, "our steering request", frozen=STEERING_OFF, frozen_words=STEERING_OFF_WORDS),
    *_heard(
        "ai_brake",
        i.AI_BRAKE,
        "our brake request",
        frozen=ends(End.ON, End.SELF, End.STOP, End.ESTOP),
        frozen_words=MAY_MEET_WORDS + "; a stop without effect becomes ESTOP_REQUEST",
        torque=True,
    ),
    FaultKind(
        name="ai_thinned",
        what="each of our frames is lost on its way by chance",
        begin=i.to_car(AI_IDS, i.THINNED),
        draws=(between("share", (0.01, 0.12)),),
        demanded=MAY_WORDS,
        demand=always(MAY_STOP_ITSELF),
    ),
    FaultKind(
        name="intruder",
        what="somebody else sends on one of our ids",
        begin=i.intruder,
        draws=(
            one_of("message", "0x510", "0x511", "0x512", "0x513", "0x514"),
            between("frames", (1, 50)),
            between("period", (1, 20)),
            one_of("payload", "zeros", "random"),
        ),
        demanded="first frame: ESTOP_REQUEST, also where the car stops itself for what it hears",
        demand=always(ends(End.ESTOP, End.SELF, no_torque_ms=d.SLACK_MS, estop_ms=d.SLACK_MS, safe_ms=60)),
    ),
    FaultKind(
        name="stranger",
        what="unknown, extended, remote and error frames every millisecond",
        begin=i.stranger,
        draws=(lasts((20, 1500)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    # ---------------------------------------------------------------- sensors
    *(
        FaultKind(
            name=f"wheel_{name}",
            what=f"one wheel speed {what}",
            begin=i.wheel_sensor(change),
            draws=(EACH_WHEEL, *draws),
            missions=ROAD_MISSIONS,
            demanded=words,
            demand=always(WHEEL_OFF),
        )
        for name, what, change, draws, words in (
            ("dead", "reads 0", i.dead, (), WHEEL_OFF_WORDS),
            ("stuck", "stands still", i.stuck, (), WHEEL_OFF_WORDS),
            ("drifting", "drifts, in rpm/s", i.drifting, (between("rate", (-300, -60), (60, 300)),), WHEEL_OFF_WORDS),
            ("very_noisy", "is noisy, sigma in rpm", i.noisy, (between("size", (80, 300)),), NOISE_WORDS),
            ("offset", "is too high by so many rpm", i.offset, (between("size", (150, 600)),), WHEEL_OFF_WORDS),
            ("scaled", "reads a multiple", i.scaled, (between("factor", (0.2, 0.6), (1.6, 3.0)),), WHEEL_OFF_WORDS),
        )
    ),
    FaultKind(
        name="wheel_noisy",
        what="one wheel speed is a little noisy, sigma in rpm",
        begin=i.wheel_sensor(i.noisy),
        draws=(EACH_WHEEL, between("size", (1, 8))),
        missions=ROAD_MISSIONS,
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="speeds_impossible",
        what="wheel speeds above what the signal database allows: they are not believed",
        begin=i.from_car({i.SPEEDS}, i.IMPOSSIBLE_SPEEDS),
        draws=(
            lasts(*FEEDBACK_BANDS),
            one_of("wheel", *i.WHEELS, "all"),
            one_of("rpm", "1251", "1300", "65535"),
        ),
        demanded="as if none had come. " + LOST_FEEDBACK_WORDS,
        demand=by("duration", *LOST_FEEDBACK),
    ),
    FaultKind(
        name="wheel_spiking",
        what="one wheel speed jumps in every so many frames by more than any tyre can follow",
        begin=i.spiking_speed,
        draws=(EACH_WHEEL, between("every", (2, 6))),
        demanded="such a frame is not believed: drives on",
        demand=always(NOTHING),
    ),
    FaultKind(
        name="wheels_jumping",
        what="all wheel speeds jump up by so many rpm, more than any tyre can follow, and stay there",
        begin=i.every_wheel(i.offset),
        draws=(between("size", (400, 800)),),
        demanded="as if none came: 100 ms service-brake stop, 300 ms ESTOP_REQUEST",
        demand=always(d.estop(d.FEEDBACK_LOST_MS, d.FEEDBACK_STALE_MS)),
    ),
    FaultKind(
        name="wheels_stuck",
        what="all wheel speeds stand still",
        begin=i.every_wheel(i.stuck),
        draws=(lasts((100, 4000)),),
        demanded=ANY_WORDS,
        demand=always(ANY),
    ),
    FaultKind(
        name="wheels_dead",
        what="all wheel speeds read 0",
        begin=i.every_wheel(i.dead),
        draws=(lasts((100, 4000)),),
        demanded=COUNTS_OFF_WORDS,
        demand=always(COUNTS_OFF),
    ),
    FaultKind(
        name="wheels_swapped",
        what="two wheels exchanged, speeds and pulses",
        begin=i.swapped_wheels,
        draws=(one_of("wheels", "fl-fr", "rl-rr", "fl-rr", "fr-rl", "fl-rl"),),
        missions=ROAD_MISSIONS,
        demanded="drives on, or a service-brake stop where curves make them implausible",
        demand=always(ends(End.ON, End.STOP, End.ESTOP)),
    ),
    FaultKind(
        name="pulses_wrong",
        what="wheel pulses stand still, run double, or are chance",
        begin=i.pulses,
        draws=(one_of("way", "stuck", "double", "random"),),
        demanded=NOTHING_WORDS + "; " + COUNTS_OFF_WORDS,
        demand=lambda p: COUNTS_OFF if p["way"] == "stuck" else NOTHING,
    ),
    FaultKind(
        name="pulses_running_on",
        what="the pulses of every wheel run on by themselves, so many a second, and we are asked to stop",
        begin=i.together(i.pulses, i.asked(lambda rig, t: rig.bridge.set_mode("manual", t))),
        draws=(one_of("way", "running"), between("rate", (30, 400))),
        demanded="it stops, and never says FINISHED; " + COUNTS_OFF_WORDS,
        demand=always(replace(COUNTS_OFF, ends=frozenset((End.ESTOP,)))),
    ),
    *(
        FaultKind(
            name=f"steering_sensor_{name}",
            what=f"the steering angle measured {what}",
            begin=i.reading("steer_deg", change),
            draws=draws,
            demanded=words,
            demand=always(STEERING_OFF),
        )
        for name, what, change, draws, words in (
            ("stuck", "stands still", i.stuck, (), STEERING_OFF_WORDS),
            (
                "offset",
                "is off by so many deg",
                i.offset,
                (between("size", (-15.0, -4.0), (4.0, 15.0)),),
                STEERING_OFF_WORDS,
            ),
            (
                "drifting",
                "drifts, in deg/s",
                i.drifting,
                (between("rate", (-6.0, -1.0), (1.0, 6.0)),),
                STEERING_OFF_WORDS,
            ),
            ("noisy", "is noisy, sigma in deg", i.noisy, (between("size", (0.1, 5.0)),), NOISE_WORDS),
        )
    ),
    FaultKind(
        name="steering_sensor_slightly_off",
        what="the steering angle measured is off by up to 1 deg",
        begin=i.reading("steer_deg", i.offset),
        draws=(between("size", (-1.0, 1.0)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="brake_sensor_wrong",
        what="brake pressures measured stand still, or are noise",
        begin=i.brake_pressure,
        draws=(one_of("way", "stuck", "noise"),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="gyro_drifting",
        what="the yaw rate of the PCAN-GPS drifts, in rad/s2",
        begin=i.reading("yaw_rate_radps", i.drifting),
        draws=(between("rate", (-0.5, 0.5)),),
        missions=ROAD_MISSIONS,
        gps=True,
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="gyro_noisy",
        what="the yaw rate of the PCAN-GPS is noisy, sigma in rad/s",
        begin=i.reading("yaw_rate_radps", i.noisy),
        draws=(between("size", (0.05, 1.0)),),
        missions=ROAD_MISSIONS,
        gps=True,
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    # ---------------------------------------------------------------- actuators
    *(
        FaultKind(
            name=f"steering_{name}",
            what=f"the steering {what}",
            begin=begin,
            draws=draws,
            demanded=STEERING_OFF_WORDS,
            demand=always(STEERING_OFF),
        )
        for name, what, begin, draws in (
            ("stuck_rack", "sticks", i.steering(lambda real, before, p: before), ()),
            ("free", "does not follow: it returns to straight", i.steering(lambda real, before, p: 0.0), ()),
            ("slow", "turns too slowly, in deg/s", i.slow_steering, (between("rate", (2.0, 12.0)),)),
            (
                "weak",
                "reaches a part of its request only",
                i.steering(lambda real, before, p: real * p["factor"]),
                (between("factor", (0.2, 0.7)),),
            ),
            (
                "offset",
                "is off by so many deg",
                i.steering(lambda real, before, p: real + p["size"]),
                (between("size", (-12.0, -5.0), (5.0, 12.0)),),
            ),
            ("inverted", "turns the wrong way", i.steering(lambda real, before, p: -real), ()),
        )
    ),
    FaultKind(
        name="motor_dead",
        what="no motor gives torque",
        begin=i.motor(lambda real, p: 0.0, "front", "rear"),
        demanded="drives on as far as it rolls: no rule asks for more",
        demand=always(NOTHING),
    ),
    FaultKind(
        name="motor_weak",
        what="the motors give a part of the torque",
        begin=i.motor(lambda real, p: real * p["factor"], "front", "rear"),
        draws=(between("factor", (0.1, 0.7)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="motor_one_axle",
        what="one of the two driven axles gives no torque",
        begin=i.motor(lambda real, p: 0.0, "front"),
        revisions=("2021",),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="motor_late",
        what="torque comes and goes late, in ms",
        begin=i.late_motor,
        draws=(between("delay", (20, 200)),),
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="motor_runs_on",
        what="the motors go on giving torque which nobody asks for, and we are asked to stop",
        begin=i.together(
            i.motor(lambda real, p: max(real, p["torque"]), "rear"),
            i.asked(lambda rig, t: rig.bridge.set_mode("manual", t)),
        ),
        draws=(between("torque", (20.0, 150.0)),),
        demanded=INEFFECTIVE_WORDS,
        demand=always(INEFFECTIVE),
    ),
    *(
        FaultKind(
            name=f"brakes_{name}",
            what=f"{what}, and we are asked to stop",
            begin=i.together(begin, i.asked(lambda rig, t: rig.bridge.set_mode("manual", t))),
            draws=draws,
            demanded=words,
            demand=always(demand),
        )
        for name, what, begin, draws, words, demand in (
            (
                "failing",
                "the service brake does nothing",
                i.service_brake(lambda real, p: 0.0),
                (),
                NO_BRAKE_WORDS,
                NO_BRAKE,
            ),
            (
                "weak",
                "the service brake gives a part only",
                i.service_brake(lambda real, p: real * p["factor"]),
                (between("factor", (0.02, 0.6)),),
                INEFFECTIVE_WORDS,
                INEFFECTIVE,
            ),
            (
                "slow",
                "brake pressure builds up slowly, in %/s",
                i.slow_brake,
                (between("rate", (5.0, 100.0)),),
                INEFFECTIVE_WORDS,
                INEFFECTIVE,
            ),
            (
                "front_only",
                "the rear brakes do nothing",
                i.service_brake(lambda real, p: 0.0, front=False),
                (),
                INEFFECTIVE_WORDS,
                INEFFECTIVE,
            ),
            (
                "rear_only",
                "the front brakes do nothing",
                i.service_brake(lambda real, p: 0.0, rear=False),
                (),
                INEFFECTIVE_WORDS,
                INEFFECTIVE,
            ),
        )
    ),
    FaultKind(
        name="brakes_fail_driving",
        what="the service brake does nothing while it drives",
        begin=i.service_brake(lambda real, p: 0.0),
        demanded="drives on; a stop without effect becomes ESTOP_REQUEST",
        demand=always(ends(End.ON, End.HELD, End.STOP, End.ESTOP)),
    ),
    # ---------------------------------------------------------------- people, switches, the VCU
    _switch("go_off", "the remote's Go is withdrawn", "go", False),
    _switch("asms_off", "ASMS is turned off", "asms", False),
    _switch("tsms_off", "TSMS is turned off", "tsms", False),
    _switch("remote_estop", "the remote E-stop is pressed", "remote_estop"),
    _switch("car_estop", "an E-stop on the car is pressed", "car_estop"),
    _switch("radio_lost", "the remote's radio is lost", "remote_radio_ok", False),
    _switch("dongle_out", "the autonomous dongle is pulled", "dongle", False),
    _switch("crash", "the crash sensor trips", "crash"),
    _switch("bms_fault", "the battery reports a fault", "bms_fault"),
    _switch("ebs_fault", "the EBS reports a fault", "ebs_fault"),
    _switch("hvil_open", "the high-voltage interlock opens", "hvil_open"),
    _switch(
        "ami_changed",
        "somebody turns the AMI in AS_DRIVING: it is latched",
        "ami",
        Ami.STATIC_INSPECTION_A,
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
        missions=ROAD_MISSIONS,
    ),
    _switch(
        "steering_status_off",
        "STEERING_STATUS says off: reported, no interlock of ours",
        "steering_fault",
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    _switch(
        "brake_status_fault",
        "STATUS_BRK says fault: reported, no interlock of ours",
        "brake_fault",
        demanded=NOTHING_WORDS,
        demand=always(NOTHING),
    ),
    FaultKind(
        name="torque_derated",
        what="the car lowers TRQ_MAX while it drives",
        begin=i.derated,
        draws=(one_of("limit", "torque_limit_nm"), between("value", (0.0, 120.0))),
        demanded="drives on within the live limit",
        demand=always(ends(End.ON, End.HELD)),
    ),
    FaultKind(
        name="steering_derated",
        what="the car lowers ANGLE_MAX while it drives",
        begin=i.derated,
        draws=(one_of("limit", "steer_limit_deg"), between("value", (2.0, 20.0))),
        demanded="drives on within the live limit, wherever that takes it",
        demand=always(ends(End.ON, End.HELD)),
    ),
    FaultKind(
        name="vcu_reboots",
        what="the VCU loses its power for a moment and starts anew",
        begin=i.switched("lvms", False),
        draws=(lasts((5, 2000)),),
        demanded="zeros; the EBS stops the car; a drive needs the whole sequence anew",
        demand=always(ends(End.OFF, End.SELF, End.ESTOP, no_torque_ms=d.VCU_STALE_MS + d.SLACK_MS)),
    ),
    FaultKind(
        name="manual_asked",
        what="manual mode is asked for while it drives",
        begin=i.asked(lambda rig, t: rig.bridge.set_mode("manual", t)),
        demanded="service-brake stop",
        demand=always(d.stop(0)),
    ),
    FaultKind(
        name="emergency_asked",
        what="the emergency brake is asked for",
        begin=i.asked(lambda rig, t: rig.bridge.emergency_brake("asked by the campaign", t)),
        demanded="ESTOP_REQUEST at once",
        demand=always(d.estop(0)),
    ),
    FaultKind(
        name="refused_requests",
        what="autonomous, an unknown mode and /reset are asked for while it drives",
        begin=i.asked(
            lambda rig, t: (
                rig.bridge.set_mode("autonomous", t),
                rig.bridge.set_mode("sideways", t),
                rig.bridge.reset(t),
            )
        ),
        demanded="refused: drives on",
        demand=always(NOTHING),
    ),
    FaultKind(
        name="software_stopped",
        what="this software is stopped in order while the car drives",
        begin=i.asked(lambda rig, t: rig.bridge.begin_stop(t)),
        demanded="moving: ESTOP_REQUEST for five cycles, then silence",
        demand=always(ends(End.ESTOP, End.SELF, End.STOP, no_torque_ms=d.SLACK_MS, safe_ms=200)),
    ),
    # ---------------------------------------------------------------- planner, controller, detector
    *(
        FaultKind(
            name=name,
            what=what,
            begin=begin,
            draws=(lasts((50, 280), (950, 3000)),),
            missions=PATH_MISSIONS,
            demanded=OLD_DATA_WORDS,
            demand=by("duration", *OLD_DATA),
        )
        for name, what, begin in (
            ("planner_silent", "the planner hangs for a while", i.paused("planner")),
            ("detector_silent", "the detector stops for a while", i.silent_detector),
        )
    ),
    FaultKind(
        name="planner_restarted",
        what="the planner ends and is started again in mid-drive",
        begin=i.restarted("planner"),
        draws=(lasts((0, 400), (950, 3000)),),
        missions=PATH_MISSIONS,
        demanded="it never drives on by itself: service-brake stop",
        demand=lambda p: ends(
            End.STOP,
            no_torque_ms=min(p["duration"] + d.CONTROL_MS, d.SENSOR_STALE_MS + d.PLAN_MS) + d.SLACK_MS,
            brake_ms=min(p["duration"] + d.CONTROL_MS, 700 + d.PLAN_MS) + d.SLACK_MS,
            safe_ms=min(p["duration"] + d.CONTROL_MS, 700 + d.PLAN_MS) + d.STOP_MS + d.SLACK_MS,
        ),
    ),
    FaultKind(
        name="planner_restarted_unneeded",
        what="the same where nobody needs its paths",
        begin=i.restarted("planner"),
        draws=(lasts((0, 2000)),),
        missions=EVERY_MISSION - PATH_MISSIONS,
        demanded="service-brake stop once it is back, for it knows nothing of the run",
        demand=lambda p: d.stop(p["duration"] + d.CONTROL_MS),
    ),
    FaultKind(
        name="planner_late",
        what="each plan comes late, with the stamp of its data",
        begin=i.late_plans,
        draws=(between("delay", (20, 200), (950, 1500)),),
        missions=PATH_MISSIONS,
        demanded=OLD_DATA_WORDS,
        demand=by("delay", *OLD_DATA),
    ),
    FaultKind(
        name="planner_empty",
        what="the planner finds no way: empty paths",
        begin=i.plans(i.no_plan),
        draws=(lasts((100, 4000)),),
        missions=PATH_MISSIONS,
        demanded=ROUGH_WORDS,
        demand=always(ROUGH),
    ),
    FaultKind(
        name="planner_absurd",
        what="the planner's paths go anywhere",
        begin=i.plans(i.absurd_plan),
        draws=(lasts((100, 4000)),),
        missions=PATH_MISSIONS,
        demanded=ROUGH_WORDS,
        demand=always(ROUGH),
    ),
    FaultKind(
        name="planner_oscillating",
        what="the planner's paths swing from left to right",
        begin=i.plans(i.swinging_plan),
        draws=(lasts((100, 4000)), between("period", (50, 500))),
        missions=PATH_MISSIONS,
        demanded=ROUGH_WORDS,
        demand=always(ROUGH),
    ),
    FaultKind(
        name="planner_nan",
        what="NaN or infinity in the planner's path",
        begin=i.plans(i.nan_plan),
        draws=(lasts((100, 4000)),),
        missions=PATH_MISSIONS,
        demanded=ROUGH_WORDS,
        demand=always(ROUGH),
    ),
    FaultKind(
        name="planner_finishes_early",
        what="the planner says that the mission is over, at full speed",
        begin=i.plans(i.finished_plan),
        missions=PATH_MISSIONS,
        demanded="service-brake stop, FINISHED at rest",
        demand=always(replace(d.stop(d.PLAN_MS + d.CONTROL_MS), own_word=False)),
    ),
    FaultKind(
        name="controller_silent",
        what="the controller hangs for a while",
        begin=i.commands(i.no_command),
        draws=(lasts(*COMMAND_BANDS),),
        demanded=LOST_COMMAND_WORDS,
        demand=by("duration", *LOST_COMMAND),
    ),
    FaultKind(
        name="controller_restarted",
        what="the controller ends and is started again in mid-drive",
        begin=i.restarted("controller"),
        draws=(lasts((0, 250), (400, 3000)),),
        demanded="it never drives on by itself: service-brake stop",
        demand=lambda p: ends(
            End.STOP,
            no_torque_ms=min(p["duration"], d.COMMAND_STALE_MS) + d.CONTROL_MS + d.SLACK_MS,
            brake_ms=min(p["duration"], d.COMMAND_LOST_MS) + d.CONTROL_MS + d.SLACK_MS,
            safe_ms=min(p["duration"], d.COMMAND_LOST_MS) + d.STOP_MS + d.CONTROL_MS + d.SLACK_MS,
        ),
    ),
    FaultKind(
        name="controller_nan",
        what="NaN, infinity or an out-of-range number in every command",
        begin=i.commands(i.no_number),
        draws=(
            lasts(*COMMAND_BANDS),
            one_of("field", "steering_rad", "throttle", "brake"),
            one_of("value", "nan", "inf", "beyond", "negative"),
        ),
        demanded="refused whole: as if none had come. " + LOST_COMMAND_WORDS,
        demand=by("duration", *LOST_COMMAND),
    ),
    FaultKind(
        name="controller_other_run",
        what="commands for another run",
        begin=i.commands(i.other_run),
        draws=(lasts(*COMMAND_BANDS), between("off", (-3, -1), (1, 3))),
        demanded="count as no command. " + LOST_COMMAND_WORDS,
        demand=by("duration", *LOST_COMMAND),
    ),
    FaultKind(
        name="controller_old_stamps",
        what="commands carry a stamp that is too old",
        begin=i.commands(i.old_stamp),
        draws=(between("age", (20, 180), (950, 3000)),),
        demanded="under 500 ms nothing; data of 700 ms: service-brake stop",
        demand=by("age", (600, d.stop(d.CONTROL_MS))),
    ),
    FaultKind(
        name="controller_future_stamps",
        what="commands carry a stamp of the future",
        begin=i.commands(i.future_stamp),
        draws=(lasts(*COMMAND_BANDS), between("ahead", (30, 5000))),
        demanded="refused whole: as if none had come. " + LOST_COMMAND_WORDS,
        demand=by("duration", *LOST_COMMAND),
    ),
    FaultKind(
        name="controller_fixed_future_stamp",
        what="every command carries one stamp of the future, so many ms ahead of the fault's beginning",
        begin=i.fixed_stamp,
        draws=(lasts(*COMMAND_BANDS), between("ahead", (450, 6000))),
        demanded="refused whole: as if none had come. " + LOST_COMMAND_WORDS,
        demand=by("duration", *LOST_COMMAND),
    ),
    FaultKind(
        name="sensor_clock_fast",
        what="the sensors' clock gains so many ms on every ms: its stamps lie more and more ahead of now",
        begin=i.fast_sensor_clock,
        draws=(between("gain", (0.2, 3.0)),),
        demanded="a stamp over 20 ms ahead is refused: once they all are, " + LOST_COMMAND_WORDS,
        demand=lambda p: d.stop(
            FAST_CLOCK_MS / p["gain"] + d.COMMAND_LOST_MS + d.CONTROL_MS,
            FAST_CLOCK_MS / p["gain"] + d.COMMAND_STALE_MS + d.CONTROL_MS,
        ),
    ),
    FaultKind(
        name="controller_frozen",
        what="one command is repeated, stamp and all",
        begin=i.frozen_command,
        draws=(lasts((50, 280), (950, 3000)),),
        demanded=OLD_DATA_WORDS,
        demand=by("duration", *OLD_DATA),
    ),
    FaultKind(
        name="both_pedals",
        what="throttle and brake in every command",
        begin=i.commands(i.both_pedals),
        draws=(lasts((10, 50), (160, 2000)), between("throttle", (0.05, 1.0)), between("brake", (0.05, 1.0))),
        demanded="the brake wins; 100 ms of it: ESTOP_REQUEST",
        demand=by(
            "duration",
            (0, d.held(d.CONTROL_MS)),
            (100, d.estop(d.BOTH_PEDALS_MS + d.CONTROL_MS, d.CONTROL_MS)),
        ),
    ),
    FaultKind(
        name="controller_gives_up",
        what="the controller asks for the emergency brake",
        begin=i.commands(i.gives_up),
        demanded="ESTOP_REQUEST at once",
        demand=always(d.estop(d.CONTROL_MS)),
    ),
    FaultKind(
        name="controller_finishes_early",
        what="the controller says that the mission is over, at full speed",
        begin=i.commands(i.says_finished),
        demanded="service-brake stop, FINISHED at rest",
        demand=always(d.stop(d.CONTROL_MS)),
    ),
    *(
        FaultKind(
            name=name,
            what=what,
            begin=i.commands(change),
            draws=(lasts((100, 4000)), *draws),
            demanded=ROUGH_WORDS,
            demand=always(ROUGH),
        )
        for name, what, change, draws in (
            ("controller_absurd", "commands of random numbers, each in range", i.absurd, ()),
            ("controller_swinging", "steering from lock to lock", i.swinging, (between("period", (20, 400)),)),
            ("controller_full_throttle", "full throttle for ever", i.full_throttle, ()),
            ("controller_pumping", "full throttle and full brake by turns", i.pumping, (between("period", (20, 80)),)),
        )
    ),
    *(
        FaultKind(
            name=f"detector_{name}",
            what=f"the detector {what}",
            begin=i.cones(change),
            draws=(lasts((100, 4000)), *draws),
            missions=PATH_MISSIONS,
            demanded=ROUGH_WORDS,
            demand=always(ROUGH),
        )
        for name, what, change, draws in (
            ("blind", "sees no cone", i.blind, ()),
            ("inventing", "sees cones that are not there", i.invented, (between("count", (1, 40)),)),
            ("shifted", "sees every cone beside its place, in m", i.shifted, (between("size", (-3.0, 3.0)),)),
            ("nan", "gives NaN and infinity as places", i.nan_cones, (between("share", (0.05, 1.0)),)),
            ("colour_blind", "takes blue for yellow and yellow for blue", i.swapped_colours, ()),
        )
    ),
    # ---------------------------------------------------------------- the bridge, its loop, clock and bus
    FaultKind(
        name="bridge_killed",
        what="the bridge's process is killed, and stays away",
        begin=i.restarted("bridge"),
        demanded="silence on the bus stops the car",
        demand=always(ends(End.SELF, no_torque_ms=0, safe_ms=d.CAR_PATIENCE_MS + d.SLACK_MS)),
    ),
    FaultKind(
        name="bridge_restarted",
        what="the bridge is killed and started again in mid-drive",
        begin=i.restarted("bridge"),
        draws=(lasts((0, 3000)),),
        demanded="silence stops the car; it never drives on by itself",
        demand=always(ends(End.SELF, no_torque_ms=0, safe_ms=d.CAR_PATIENCE_MS + d.SLACK_MS)),
    ),
    FaultKind(
        name="bridge_restarted_and_asked",
        what="the same, and somebody asks for autonomous all the while",
        begin=i.insisting_operator,
        draws=(between("gone", (0, 3000)),),
        demanded="silence stops the car; it never drives on by itself",
        demand=always(ends(End.SELF, no_torque_ms=0, safe_ms=d.CAR_PATIENCE_MS + d.SLACK_MS)),
    ),
    FaultKind(
        name="everything_restarted",
        what="bridge, planner and controller end and are started again together",
        begin=i.restarted("bridge", "planner", "controller"),
        draws=(lasts((0, 3000)),),
        demanded="silence stops the car; it never drives on by itself",
        demand=always(ends(End.SELF, no_torque_ms=0, safe_ms=d.CAR_PATIENCE_MS + d.SLACK_MS)),
    ),
    FaultKind(
        name="bridge_hung",
        what="the loop's process stands still for a while, and the car's frames wait for it",
        begin=i.hung_bridge,
        draws=(between("hang", (5, 35), (70, 82), (130, 2500)),),
        demanded="a backlog is reported; a deadline missed by 50 ms: ESTOP_REQUEST; silent for 100 ms the car stops"
        " itself",
        demand=lambda p: d.by_age(
            p["hang"],
            (50, d.estop(p["hang"], 0)),
            (100, ends(End.SELF, no_torque_ms=0, safe_ms=d.CAR_PATIENCE_MS + d.SLACK_MS)),
        ),
    ),
    FaultKind(
        name="edge_hung",
        what="the process between ROS and the loop stands still for a while",
        begin=i.hung_edge,
        draws=(between("hang", *COMMAND_BANDS),),
        demanded="no command comes through. " + LOST_COMMAND_WORDS,
        demand=by("hang", *LOST_COMMAND),
    ),
    FaultKind(
        name="edge_killed",
        what="the process between ROS and the loop is killed",
        begin=i.killed_edge,
        demanded=LOST_COMMAND_WORDS + "; at rest the loop ends, and the car takes the silence for an emergency",
        demand=always(
            ends(
                End.STOP,
                End.SELF,
                no_torque_ms=d.COMMAND_STALE_MS + d.CONTROL_MS + d.SLACK_MS,
                brake_ms=d.COMMAND_LOST_MS + d.CONTROL_MS + d.SLACK_MS,
                safe_ms=d.COMMAND_LOST_MS + d.CONTROL_MS + d.STOP_MS + d.SLACK_MS,
            )
        ),
    ),
    FaultKind(
        name="loop_late",
        what="the loop misses one deadline by so many ms",
        begin=i.late_loop,
        draws=(between("late", (49, 49), (51, 51)),),
        demanded="49 ms nothing; 51 ms ESTOP_REQUEST",
        demand=by("late", (50, d.estop(51 + 15, 15))),
    ),
    FaultKind(
        name="clock_stepped",
        what="the wall clock is set by less than the age of the data, in ms (the nodes' stamps stop larger ones)",
        begin=i.clock_step,
        draws=(between("step", (-50, -1), (1, 50)),),
        missions=PATH_MISSIONS,
        demanded="nothing: only monotonic time is used",
        demand=always(NOTHING),
    ),
    *(
        FaultKind(
            name=name,
            what=what,
            begin=i.full_queue,
            draws=(lasts((5, 30), (66, 72), (130, 2500)), *draws),
            demanded="dropped cycles are tried again; 50 ms without a complete one: commands dropped,"
            " service-brake stop; 100 ms the car stops itself",
            demand=lambda p: d.by_age(
                p["duration"],
                (50, ends(End.STOP, End.SELF, brake_ms=p["duration"] + d.SLACK_MS, safe_ms=3000 + 100)),
                (100, ends(End.SELF, safe_ms=d.CAR_PATIENCE_MS + d.SLACK_MS)),
            ),
        )
        for name, what, draws in (
            ("bus_full", "the transmit queue is full (ENOBUFS)", ()),
            ("bus_full_partly", "each cycle fits into the queue only partly", (between("taken", (1, 4)),)),
        )
    ),
    FaultKind(
        name="bus_busy",
        what="each frame finds the queue full by chance",
        begin=i.busy_queue,
        draws=(between("share", (0.002, 0.15)),),
        demanded="dropped cycles are tried again; 50 ms without a complete one: service-brake stop",
        demand=always(ends(End.ON, End.STOP, End.SELF)),
    ),
    *(
        FaultKind(
            name=name,
            what=what,
            begin=i.lost_bus,
            draws=(between("gone", (1, 45), (130, 3000)), one_of("why", why)),
            demanded="commands dropped, reopened with back-off, then a service-brake stop; 100 ms the car stops itself",
            demand=lambda p: d.by_age(
                p["gone"],
                (0, ends(End.STOP, End.SELF, no_torque_ms=0, safe_ms=3000 + 200)),
                (100, ends(End.SELF, no_torque_ms=0, safe_ms=d.CAR_PATIENCE_MS + d.SLACK_MS)),
            ),
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

KINDS: Final[Mapping[str, FaultKind]] = MappingProxyType({row.name: row for row in ROWS})


def kind_named(name: str) -> FaultKind:
    """The kind of that name; ValueError for an unknown one."""
    try:
        return KINDS[name]
    except KeyError:
        raise ValueError(f"unknown fault {name!r}: --list-faults shows the {len(KINDS)} there are") from None
