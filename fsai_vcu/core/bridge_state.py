"""Everything that the bridge remembers, as one immutable value: put back, the same happens again."""

from __future__ import annotations

from msgspec import field

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.gate import GateState
from fsai_vcu.core.supervision.plausibility import SteeringCheck, WheelCheck
from fsai_vcu.core.supervision.supervisor import Decision, SupervisorState
from fsai_vcu.core.supervision.wheel_speeds import WheelBelief
from fsai_vcu.core.vehicle.odometry import OdometryState
from fsai_vcu.interface.messages import AiCommand, GpsImu, VehicleState
from fsai_vcu.interface.values import Value


class BridgeState(Value, frozen=True):
    """State that decides what is sent next. Times are of the monotonic clock, None: never.

    What the bridge only counts, for its report, is in `tally.Tally`.
    """

    supervisor: SupervisorState
    odometry: OdometryState
    gate: GateState = field(default_factory=GateState)
    decision: Decision = field(default_factory=Decision)  # of the last cycle
    asked: AiCommand = field(default_factory=AiCommand)  # the command of the last cycle

    # Received from the bus
    vehicle: VehicleState = field(default_factory=VehicleState)
    gps: GpsImu = field(default_factory=GpsImu)
    status_doubt: str = ""  # why the newest 0x520 is none that is known
    speeds_doubt: str = ""  # why the newest 0x525 is not believed
    belief: WheelBelief = field(default_factory=WheelBelief)

    # Checks that the car does what it is asked
    steering: SteeringCheck = field(default_factory=SteeringCheck)
    wheels: WheelCheck = field(default_factory=WheelCheck)

    # The command slot
    command: VehicleCommand | None = None
    command_ns: int = 0  # when it was handed in

    # The loop and the bus
    listening_since_ns: int | None = None  # the first cycle: on start a process listens, then sends
    bus_lost: str | None = None  # why
    reopened_ns: int | None = None  # the end of a bus loss, until 0x520 is received again, or has had its time
    last_complete_ns: int | None = None  # the last cycle that went out whole, or the first that was tried
    stop_cycles_left: int | None = None  # None: no stop asked for

    @property
    def stopped(self) -> bool:
        """The orderly end is over: nothing is sent any more."""
        return self.stop_cycles_left is not None and self.stop_cycles_left <= 0
