"""Faults of messages on their way to and from the car, of its VCU's state machine, and frames of other senders."""

from __future__ import annotations

import itertools
import math
import random
import struct
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.campaign.endings import (
    ANY,
    CAR_STOPS,
    LOST_FEEDBACK,
    MAY_STOP_ITSELF,
    NOTHING,
    ODD,
    PAUSE,
    SILENT,
    STOP,
    UNBELIEVED,
    WITHIN_LIMIT,
    End,
    Graded,
    Must,
    Params,
    ends,
    estop,
)
from fsai_hil.evidence.campaign.faults.kind import (
    EVERY_MISSION,
    FEEDBACK_BANDS,
    WHEELS,
    Bands,
    Draw,
    Entry,
    FaultKind,
    Ids,
    Injection,
    Ongoing,
    lasts,
    together,
)
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
from fsai_hil.simulator.lockstep import Lockstep
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import Ami, AsState, EbsState, OpState, ShutdownCause, TsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import FAULT_NAMES, Faults
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.units import MS

STATUS, DRIVE_F, DRIVE_R, STEER, BRAKE, SPEEDS, COUNTS = VCU_IDS
LOGS: Final = frozenset({0x120, 0x500, 0x502})
GPS_IDS: Final = frozenset(range(0x600, 0x641))
FROM_CAR: Final = frozenset({*LOGS, *VCU_IDS})
AI_STATUS, AI_DRIVE_F, AI_DRIVE_R, AI_STEER, AI_BRAKE = AI_IDS


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
    """Every other frame shows an undefined AS_STATE; HANDSHAKE stays what it is."""
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
    """Return an injection into the frames of `ids` on one side of the VCU, or of the id in a parameter `message`."""
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


# ---------------------------------------------------------------- endings and draws

MAY_MEET = ends(End.ON, End.SELF, note="torque and brake may meet at the car")
NO_DRIVE = ends(End.STOP, note="no torque ever")
AXLE_IDLE = ends(End.ON, note="no torque on that axle while its limit is 100 ms old")
ECHO_REPLACED = ends(End.ON, note="two complete zero cycles stand for its echo")
LOST_STATUS = Graded(((50, PAUSE), (100, CAR_STOPS)))
STATUS_BANDS = ((10, 30), (82, 86), (130, 2500))
NO_ECHO = Graded(((100, CAR_STOPS),))
LOST_LIMIT = Graded(((0, AXLE_IDLE), (100, WITHIN_LIMIT)))
AI_SILENT = Graded(((100, SILENT),))
AI_SILENT_TORQUE = Graded(((0, MAY_MEET), (100, SILENT)))
SHOWN = lasts((15, 1500))
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
    on_wire = partial(to_car if ours else from_car, {can_id})
    no_message = "has too few bytes: no believable message comes"
    late, cut = Draw("delay", *late_ms), Draw("length", (0, BY_ID[can_id].dlc - 1))
    times, bits = Draw("times", (2, 5)), Draw("bits", (1, 8))
    return tuple(
        Entry(f"{prefix}_{name}", f"{of} (0x{can_id:03X}){', as the car receives it,' if ours else ''} {does}").by(
            on_wire(fault), must, *draws
        )
        for name, does, fault, must, *draws in (
            ("lost", "stops coming", "lost", lost, lasts(*lost_ms)),
            ("late", "comes late, and stays late", "late", replace(lost, of="delay"), late),
            ("frozen", "repeats one payload", "frozen", frozen, lasts(*frozen_ms)),
            ("twice", "arrives several times", "twice", NOTHING, times, lasts((100, 2500))),
            ("corrupted", "has bits flipped", "flipped", corrupted, lasts((10, 2000)), bits),
            ("wrong_length", no_message, "cut", lost, lasts(*lost_ms), cut),
        )
    )


# Wheel speeds and steering angle are supervised alike; the live torque limit of an axle; what the car can be driven
# without; one message of the AI computer as the car receives it, torque and brake too, which must not meet there.
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
        STATUS,
        "the car's state",
        lost=LOST_STATUS,
        lost_ms=STATUS_BANDS,
        late_ms=((5, 30), (65, 75), (130, 500)),
        frozen=NO_ECHO,
        frozen_ms=((10, 60), (150, 3000)),
    ),
    Entry("status_jittering", "0x520 comes at irregular times, in order").by(
        from_car({STATUS}, "jittering"), NOTHING, Draw("delay", (1, 25))
    ),
    Entry("status_falls_back", "0x520 shows another AS state for a while, the car drives").by(
        status_shows(lambda p: {"as_state": AsState[p["state"]]}),
        ends(End.STOP, End.SELF, End.ESTOP, note="back in AS_DRIVING it brakes to rest"),
        SHOWN,
        Draw("state", "AS_OFF", "AS_READY", "AS_FINISHED", "EMERGENCY_BRAKE"),
    ),
    Entry("status_go_off", "0x520 shows GO_SIGNAL 0, the car drives").by(
        status_shows(lambda p: {"go_signal": False}), STOP, SHOWN
    ),
    Entry("status_fault_bit", "0x520 shows FAULT_STATUS 1, the car drives").by(
        status_shows(lambda p: {"fault": True}), STOP, SHOWN
    ),
    Entry("status_undefined_as_state", "0x520 shows an undefined AS_STATE, the car drives").by(
        from_car({STATUS}, "undefined AS_STATE"),
        Graded(((0, PAUSE), (100, estop(100)))),
        lasts((10, 40), (60, 86), (130, 2500)),
        Draw("state", (6, 15)),
    ),
    Entry("status_flickering_as_state", "0x520 shows an undefined AS_STATE in every other frame").by(
        from_car({STATUS}, "flickering AS_STATE"), PAUSE, lasts((30, 1500)), Draw("state", (6, 15))
    ),
    Entry("status_state_fault", "0x520 shows one of its states as FAULT while FAULT_STATUS stays 0, the car drives").by(
        status_shows(lambda p: {p["state"]: FAULT_STATES[p["state"]]}),
        STOP,
        SHOWN,
        Draw("state", *FAULT_STATES),
        revisions=("2026",),
    ),
    Entry("status_ami", "0x520 shows another mission, or none, the car drives").by(
        status_shows(lambda p: {"ami": Ami[p["ami"]]}),
        STOP,
        SHOWN,
        Draw("ami", Ami.NOT_SELECTED.name, Ami.AUTONOMOUS_DEMO.name),
        missions=EVERY_MISSION - {Ami.AUTONOMOUS_DEMO},
    ),
    *(
        Entry(f"status_{name}", f"0x520 shows {what} while FAULT_STATUS stays 0, the car drives").by(
            status_shows(shown), STOP, SHOWN, *draws
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
    ).by(status_shows(lambda p: OLD_MARKS[p["mark"]]), NOTHING, Draw("mark", *OLD_MARKS), from_start=True),
    Entry("vcu_drives_without_mission", "the AMI shows 0 all along, and the VCU goes on to AS_READY and AS_DRIVING").by(
        together(
            status_shows(lambda p: {"ami": Ami.NOT_SELECTED}),
            vcu_differs(ready_without_acknowledgement=True),
        ),
        NO_DRIVE,
        from_start=True,
    ),
    Entry("vcu_hasty", "the VCU takes Go so many ms after AS_READY began, not after 5 s").by(
        together(vcu_differs(ready_wait_ns=MS), hasty_go),
        NO_DRIVE,
        Draw("ready", (20, 60), (500, 4700)),
        from_start=True,
    ),
    Entry("vcu_shows_go_all_along", "0x520 shows GO_SIGNAL 1 from power-up on: no rising edge of Go was seen").by(
        status_shows(lambda p: {"go_signal": True}), NO_DRIVE, from_start=True
    ),
    Entry("handshake_inverted", "HANDSHAKE toggles wrong on its way: inverted").by(
        wild_handshake, NO_ECHO, lasts((10, 60), (150, 3000)), Draw("way", "inverted")
    ),
    Entry("handshake_random", "HANDSHAKE toggles wrong on its way: by chance").by(
        wild_handshake, MAY_STOP_ITSELF, lasts((10, 3000)), Draw("way", "random")
    ),
    Entry("handshake_stuck", "HANDSHAKE stands still on its way").by(
        status_shows(lambda p: {"handshake": p["bit"] == "1"}),
        NO_ECHO,
        lasts((10, 60), (150, 3000)),
        Draw("bit", "0", "1"),
    ),
    Entry("handshake_slow", "the echo reaches the car late, within its timeout").by(
        to_car({AI_STATUS}, "late"), NOTHING, Draw("delay", (20, 70))
    ),
    *_limit("front_limit", DRIVE_F, "the front axle's torque limit"),
    *_limit("rear_limit", DRIVE_R, "the rear axle's torque limit"),
    *_feedback("steering", STEER, "the steering angle", frozen=ODD),
    *_needless("brakes", BRAKE, "brake feedback", lost=Graded(((0, ECHO_REPLACED),))),
    *_feedback("speeds", SPEEDS, "the wheel speed message", frozen=ANY),
    *_needless("counts", COUNTS, "the wheel pulse message", frozen=UNBELIEVED),
    Entry("logging_corrupted", "bits of the logging frames (0x120, 0x500, 0x502) are flipped").by(
        from_car(LOGS, "flipped"), NOTHING, lasts((20, 4000)), Draw("bits", (1, 12))
    ),
    Entry("everything_thinned", "each frame of the car is lost by chance").by(
        from_car(FROM_CAR, "thinned"), NOTHING, Draw("share", (0.01, 0.12))
    ),
    Entry("car_silent", "the bridge receives nothing from the car, and the car still receives the bridge").by(
        from_car(FROM_CAR, "lost"), LOST_STATUS, lasts(*STATUS_BANDS)
    ),
    Entry("vcu_hangs", "the VCU neither sends nor receives for a while").by(
        together(from_car(FROM_CAR, "lost"), to_car(AI_IDS, "lost")),
        LOST_STATUS,
        lasts(*STATUS_BANDS),
    ),
    *(
        Entry(f"gps_{name}", what).by(from_car(GPS_IDS, fault), NOTHING, lasts((50, 4000)), *draws, gps=True)
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
    *_incoming("ai_status", AI_STATUS, "the AI computer's state", frozen=SILENT),
    *_incoming_torque("ai_front", AI_DRIVE_F, "the front torque request", frozen=MAY_MEET),
    *_incoming_torque("ai_rear", AI_DRIVE_R, "the rear torque request", frozen=MAY_MEET),
    *_incoming("ai_steer", AI_STEER, "the steering request", frozen=ODD),
    *_incoming_torque("ai_brake", AI_BRAKE, "the brake request", frozen=ends(End.ON, End.SELF, End.STOP, End.ESTOP)),
    Entry("ai_thinned", "each frame of the AI computer is lost at random").by(
        to_car(AI_IDS, "thinned"), MAY_STOP_ITSELF, Draw("share", (0.01, 0.12))
    ),
    Entry("intruder", "a second sender uses an id of the AI computer").by(
        intruder,
        ends(End.ESTOP, End.SELF, safe_ms=35, asks=True),
        Draw("message", "0x510", "0x511", "0x512", "0x513", "0x514"),
        Draw("frames", (1, 50)),
        Draw("period", (1, 20)),
        Draw("payload", "zeros", "random"),
    ),
    Entry("other_revision", "frames that only another revision has come beside the car's: they are named").by(
        other_revision, NOTHING, lasts((20, 4000)), revisions=("2026",)
    ),
    Entry("stranger", "unknown, extended, remote and error frames every millisecond").by(
        stranger, NOTHING, lasts((20, 1500))
    ),
)
