"""The numbers of the safety rules and of the interface specification, as an observer of the bus knows them.

One copy for all of the evidence. It is written down apart from the core's configuration on purpose: a wrong number
there must show here.
"""

from __future__ import annotations

from typing import Final

MS: Final = 1_000_000
S: Final = 1_000_000_000

# Safety: on start a process listens, then sends; what is sent at the orderly end; two sends are never closer
LISTEN_FIRST_NS: Final = 200 * MS
STOP_CYCLES: Final = 5
CYCLE_NS: Final = 10 * MS  # interface specification v4.0: five messages every 10 ms
CYCLE_GAP_NS: Final = 8 * MS

# Safety rule 2
STATUS_FRESH_NS: Final = 50 * MS
LAUNCH_NS: Final = 3 * S
COMMAND_FRESH_NS: Final = 100 * MS
DATA_FRESH_NS: Final = 500 * MS
FUTURE_NS: Final = 20 * MS  # a stamp further ahead than clocks and rounding explain hides how old the data is

# A whole sequence: 5 s in AS_READY and Go rising after them, less the 100 ms that 0x520 may be missing
READY_SEEN_NS: Final = 4900 * MS

# Safety rule 3
SPEEDS_FRESH_NS: Final = 100 * MS
STILL_NS: Final = 500 * MS
STILL_RPM: Final = 10
COUNTED_NS: Final = 500 * MS
TURNING_PULSES: Final = 2  # one pulse may be an edge at rest

# Wheel speeds that are not believed
SPEED_MOST_RPM: Final = 1250  # signal database: 0 … 1250
SPEED_CHANGE_MOST_RPM: Final = 300  # no tyre follows more from one frame to the next
SPEED_JUMP_NS: Final = 350 * MS  # what stays there for so long is believed again; it was reacted to at 300 ms
COUNT_SLACK: Final = 2  # a count that moves by so much more than the highest speed explains has started again
DOUBT_SURE_TURNS: Final = 0.75  # speed and count that contradict each other by so many turns of the wheel
DOUBT_OPEN_TURNS: Final = 0.25  # from here on it may be taken for a contradiction

# Safety rule 6
POWER_CYCLE_NS: Final = 1 * S

# Graded reactions
STATUS_LOST_NS: Final = 100 * MS
AS_STATE_KNOWN_NS: Final = 100 * MS  # so long known again before torque returns
COMMAND_LOST_NS: Final = 300 * MS
FEEDBACK_STALE_NS: Final = 100 * MS
FEEDBACK_LOST_NS: Final = 300 * MS
ODD_NS: Final = 300 * MS
ODD_LOST_NS: Final = 600 * MS
CERTAINLY_NS: Final = 25 * MS  # so much later at most the supervisor finds odd what an observer is certain of
PEDALS_NS: Final = 100 * MS
SEND_LOST_NS: Final = 50 * MS  # so long without one complete cycle counts as bus loss
STOP_TIMEOUT_NS: Final = 3 * S  # still moving so long after a stop began
BACKLOG_NS: Final = 20 * MS  # frames of the car that waited so long before they were read are named

# Interface specification v4.0
CAR_PATIENCE_NS: Final = 100 * MS  # without a matching echo for so long, AI_COMMS_LOST
MOST_TORQUE_NM: Final = 195.0  # axle torque request 0-195 Nm
MOST_MOTOR_RPM: Final = 4000.0  # MOTOR_SPEED_MAX 0-4000 rpm

# Protection against an over-current trip: the most torque above a speed of the axle's fastest wheel
CONSTANT_POWER: Final = ((700, 50.0), (600, 85.0), (500, 100.0), (400, 120.0), (300, 150.0))


def constant_power_nm(fastest_rpm: float) -> float:
    """The most torque of an axle by its fastest wheel."""
    return next((most_nm for above_rpm, most_nm in CONSTANT_POWER if fastest_rpm > above_rpm), MOST_TORQUE_NM)
