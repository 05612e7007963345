"""The times within which the rehearsed car PC is well again: stated here, measured and judged in the rehearsal.

They are for one processor of User-Mode Linux, on which an interpreter takes several times as long to start as on a car
PC. What the bus shows is measured against the bridge's own times, and what such a machine may be held up besides.
"""

from __future__ import annotations

from fsai_hil.rehearsal.stall_monitor import STOOD_STILL_NS
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.runtime.loop import EDGE_HUNG_NS
from fsai_vcu.runtime.pacing import FALLBACK_AFTER_NS

_TIMES = BridgeConfig()
# What comes on top of each of them: at most one cycle, and what the machine may be held up without being excused.
_CYCLE_S = (FALLBACK_AFTER_NS + STOOD_STILL_NS) / 1e9

BOOT_S = 45.0  # from the kernel's start until all services are active
START_TO_FIRST_FRAME_S = 6.0  # of the bridge, which listens for 200 ms first; on a normal machine 1 s (`make bench`)
SERVICE_BACK_S = 20.0  # while the others drive on and take most of that processor; by itself a third of it
HUNG_BACK_S = SERVICE_BACK_S + 3.0 + EDGE_HUNG_NS / 1e9  # its watchdog, and what the loop waits for a silent edge
UNPLUGGED_S = 3.0
PURGED_S = 90.0  # some ten thousand files
RECORDS_AGAIN_S = 10.0
AT_REST_S = 8.0
SHUTDOWN_REST_S = 8.0

# The last torque that is asked for, after what has happened.
TORQUE_OF_A_DEAD_BRIDGE_S = _CYCLE_S
TORQUE_WITHOUT_COMMANDS_S = _TIMES.command_stale_ns / 1e9 + _CYCLE_S
TORQUE_WITHOUT_DATA_S = _TIMES.sensor_stale_ns / 1e9 + _CYCLE_S
# The car's own: what it needs to see that nobody speaks.
CAR_STOPS_ITSELF_S = COMMS_LOST_NS / 1e9 + _CYCLE_S
