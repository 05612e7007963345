"""The items that an AI-side program is asked for, one by one.

A new item is an entry here, what the judge sees of it, and a scene in which it can be seen.
"""

from __future__ import annotations

from typing import Final, NamedTuple

SPECIFICATION: Final = "interface specification v4.0"
RULES: Final = "rules of the event"
ADVICE: Final = "good practice"


class Item(NamedTuple):
    """One thing asked. `scene`: the first one that shows it; the judge looks at it in all of them."""

    slug: str
    title: str
    asks: str
    source: str
    scene: str


# The messages of the car whose silence a program must notice, what of it, and how soon torque has to be gone, in ms
SILENCES: Final = {
    0x520: ("the car's state and the handshake", 500),
    0x521: ("front torque and its limit", None),
    0x522: ("rear torque and its limit", None),
    0x523: ("measured steering", 1000),
    0x524: ("brakes", None),
    0x525: ("wheel speeds", 1000),
    0x526: ("pulse counts", None),
}


def _silence(can_id: int, what: str, within_ms: int | None) -> Item:
    name = f"silence-{can_id:x}"
    if within_ms is None:
        asks = f"0x{can_id:03X} ({what}) falls silent in AS_DRIVING: the program does not treat old values as new"
        return Item(name, f"0x{can_id:03X} silent", asks, ADVICE, name)
    asks = f"0x{can_id:03X} ({what}) falls silent in AS_DRIVING: no torque is asked for {within_ms} ms later"
    return Item(name, f"0x{can_id:03X} silent", asks, RULES, name)


ITEMS: Final = (
    Item(
        "messages",
        "five messages",
        "0x510 to 0x514 every 10 ms with 8, 4, 4, 2 and 2 bytes, and no identifier of the car's; ten missing in a row"
        " are AI_COMMS_LOST",
        SPECIFICATION,
        "bus",
    ),
    Item(
        "order",
        "order of the five",
        "the VCU receives them one after another: each cycle brings all five, always in one order, so that a change"
        " is seen whole",
        ADVICE,
        "bus",
    ),
    Item(
        "handshake",
        "handshake",
        "0x510 carries the HANDSHAKE bit of the last 0x520; an echo that does not match for 100 ms is AI_COMMS_LOST",
        SPECIFICATION,
        "handshake",
    ),
    Item(
        "response",
        "response time",
        "from the VCU's toggle to its echo; 100 ms are AI_COMMS_LOST, more than 10 ms a missed cycle",
        SPECIFICATION,
        "bus",
    ),
    Item(
        "load",
        "response time under load",
        "the same with every processor of the computer busy",
        SPECIFICATION,
        "bus",
    ),
    Item(
        "selected",
        "SELECTED",
        "MISSION_STATUS is NOT_SELECTED while the AMI shows no mission, and SELECTED once it shows one",
        SPECIFICATION,
        "static-a",
    ),
    Item(
        "ami",
        "AMI changed",
        "a mission that is taken back on the AMI in AS_OFF is no longer SELECTED, and the one shown at Go is driven",
        SPECIFICATION,
        "static-a",
    ),
    Item(
        "before-go",
        "zeros before Go",
        "in AS_OFF and AS_READY: axle torques 0, steering 0, NEUTRAL, at most SELECTED, ESTOP_REQUEST 0",
        SPECIFICATION,
        "static-a",
    ),
    Item(
        "ready",
        "5 s of AS_READY, then Go",
        "at least 5 s in AS_READY, then a rising edge of Go: AS_DRIVING",
        SPECIFICATION,
        "static-a",
    ),
    Item(
        "running",
        "RUNNING",
        "in AS_DRIVING: MISSION_STATUS RUNNING, DIRECTION_REQUEST FORWARD",
        SPECIFICATION,
        "static-a",
    ),
    Item("launch", "3 s at rest", "the car does not move for 3 s after AS_DRIVING began", RULES, "static-b"),
    Item(
        "limits",
        "within the limits",
        "axle torque at most AXLE_TRQ_MAX, steering at most ANGLE_MAX, as the car sends them",
        SPECIFICATION,
        "static-a",
    ),
    Item(
        "axle",
        "the driven axle",
        "torque is requested only from an axle with a motor (AXLE_TRQ_MAX above 0)",
        SPECIFICATION,
        "static-a",
    ),
    Item(
        "torque-brake",
        "torque or brake",
        "axle torque above 0 and brake above 0 never meet at the VCU: BRAKE_PLAUSIBILITY_FAULT",
        SPECIFICATION,
        "demo",
    ),
    Item(
        "rest",
        "NEUTRAL, FINISHED at rest",
        "NEUTRAL or FINISHED only while every wheel is under 10 rpm: AUTONOMOUS_BRAKING_FAULT, MISSION_STATUS_FAULT",
        SPECIFICATION,
        "static-a",
    ),
    Item(
        "static-a",
        "static inspection A",
        "steering over its full range and back to straight, driven wheels to 200 rpm within 10 s and to rest within"
        " 5 s, AS_FINISHED",
        RULES,
        "static-a",
    ),
    Item(
        "static-b",
        "static inspection B",
        "driven wheels to 50 rpm, then ESTOP_REQUEST: EMERGENCY_BRAKE",
        RULES,
        "static-b",
    ),
    Item(
        "power-cycle",
        "power cycle",
        "after an emergency brake and a power cycle of the car the same process starts the next mission:"
        " ESTOP_REQUEST 0, SELECTED",
        SPECIFICATION,
        "demo",
    ),
    Item(
        "demo",
        "autonomous demo",
        "steer left, right, straight; 15 km/h within 10 m, stop within 10 m, 15 km/h within 10 m, ESTOP_REQUEST",
        RULES,
        "demo",
    ),
    Item(
        "estop",
        "remote E-stop",
        "after the remote's E-stop (EMERGENCY_BRAKE) no torque is asked for any more",
        SPECIFICATION,
        "estop",
    ),
    *(_silence(can_id, *what) for can_id, what in SILENCES.items()),
    Item(
        "end",
        "clean end",
        "asked to end (SIGTERM) the program ends within 5 s, and nothing is sent after it",
        ADVICE,
        "end",
    ),
)
BY_SLUG: Final = {item.slug: item for item in ITEMS}
