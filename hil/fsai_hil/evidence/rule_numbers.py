"""The numbers of the safety rules and of the interface specification, as one beside the bus knows them.

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

# Safety rule 3
SPEEDS_FRESH_NS: Final = 100 * MS
STILL_NS: Final = 500 * MS
STILL_RPM: Final = 10

# Safety rule 6
POWER_CYCLE_NS: Final = 1 * S

# Graded reactions
STATUS_LOST_NS: Final = 100 * MS
COMMAND_LOST_NS: Final = 300 * MS
FEEDBACK_STALE_NS: Final = 100 * MS
FEEDBACK_LOST_NS: Final = 300 * MS
ODD_NS: Final = 300 * MS
ODD_LOST_NS: Final = 600 * MS
PEDALS_NS: Final = 100 * MS
SEND_LOST_NS: Final = 50 * MS  # so long without one complete cycle counts as bus loss
STOP_TIMEOUT_NS: Final = 3 * S  # still moving so long after a stop began
DEADLINE_MISS_NS: Final = 50 * MS  # a deadline missed by so much is a fault of the loop

# Interface specification v4.0
CAR_PATIENCE_NS: Final = 100 * MS  # without a matching echo for so long, AI_COMMS_LOST
MOST_TORQUE_NM: Final = 195.0  # axle torque request 0-195 Nm
MOST_MOTOR_RPM: Final = 4000.0  # MOTOR_SPEED_MAX 0-4000 rpm

# Protection against an over-current trip: the most torque above a speed of the axle's fastest wheel
CONSTANT_POWER: Final = ((700, 50.0), (600, 85.0), (500, 100.0), (400, 120.0), (300, 150.0))


def constant_power_nm(fastest_rpm: float) -> float:
    """The most torque of an axle by its fastest wheel."""
    return next((most_nm for above_rpm, most_nm in CONSTANT_POWER if fastest_rpm > above_rpm), MOST_TORQUE_NM)
