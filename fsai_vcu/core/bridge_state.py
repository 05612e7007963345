"""Everything that the bridge remembers, as one immutable value: put back, the same happens again."""

from __future__ import annotations

from typing import Annotated, Final

from msgspec import field

from fsai_vcu.core.ages import Ages, NoAge, NotSearched, Within
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.gate import GateState
from fsai_vcu.core.supervision.plausibility import SteeringCheck, WheelCheck
from fsai_vcu.core.supervision.supervisor import Decision, SupervisorState
from fsai_vcu.core.supervision.wheel_speeds import WheelBelief
from fsai_vcu.core.vehicle.odometry import OdometryState
from fsai_vcu.interface.messages import AiCommand, GpsImu, VehicleState
from fsai_vcu.interface.values import Value

_AXLE: Final = Within(t_rx_ns=Ages("feedback_stale_ns"))
_NOT_SENT: Final = NotSearched("the searched car does not send it")
_OF_THE_CYCLE: Final = NotSearched("each cycle makes its own before it is looked at")


class BridgeState(Value, frozen=True):
    """State that decides what is sent next. Times are of the monotonic clock, None: never.

    What the bridge only counts, for its report, is in `tally.Tally`.
    """

    supervisor: SupervisorState
    odometry: Annotated[OdometryState, NotSearched("it fills a logging field")]
    gate: GateState = field(default_factory=GateState)
    decision: Annotated[Decision, _OF_THE_CYCLE] = field(default_factory=Decision)  # of the last cycle
    asked: Annotated[AiCommand, _OF_THE_CYCLE] = field(default_factory=AiCommand)  # the command of the last cycle

    # Received from the bus
    vehicle: Annotated[
        VehicleState,
        Within(
            status=Within(
                t_rx_ns=NotSearched("the supervisor remembers it"),
                handshake=NotSearched("`handshake` is the newest that was received"),
            ),
            drive_front=_AXLE,
            drive_rear=_AXLE,
            steer=Within(t_rx_ns=Ages("feedback_stale_ns", "feedback_lost_ns")),
            brake=Within(t_rx_ns=NoAge("it is compared with GateState.zero_since_ns: newer or not")),
            speeds=Within(t_rx_ns=NotSearched("the supervisor remembers it")),
            counts=_NOT_SENT,
            log_dynamics=_NOT_SENT,
            log_status=_NOT_SENT,
            system=_NOT_SENT,
        ),
    ] = field(default_factory=VehicleState)
    gps: Annotated[GpsImu, NotSearched("odometry alone looks at it")] = field(default_factory=GpsImu)
    status_doubt: str = ""  # why the newest 0x520 is none that is known
    speeds_doubt: Annotated[str, NotSearched("words")] = ""  # why the newest 0x525 is not believed
    belief: Annotated[
        WheelBelief, NotSearched("it follows from the speeds believed last: the searched car sends no counts")
    ] = field(default_factory=WheelBelief)

    # Checks that the car does what it is asked
    steering: SteeringCheck = field(default_factory=SteeringCheck)
    wheels: WheelCheck = field(default_factory=WheelCheck)

    # The command slot
    command: Annotated[
        VehicleCommand | None,
        Within(
            t_sensor_ns=NotSearched("it counts together with `command_ns`"),
            run_id=NotSearched("a command of another run is none"),
        ),
    ] = None
    command_ns: Annotated[int, Ages("command_stale_ns", "command_lost_ns")] = 0  # when it was handed in

    # The loop and the bus
    # The first cycle: on start a process listens, then sends
    listening_since_ns: Annotated[int | None, Ages("listen_first_ns")] = None
    bus_lost: str | None = None  # why
    # The end of a bus loss, until 0x520 is received again, or has had its time
    reopened_ns: Annotated[int | None, Ages("vcu_lost_ns")] = None
    # The last cycle that went out whole, or the first that was tried
    last_complete_ns: Annotated[int | None, Ages("send_lost_ns")] = None
    stop_cycles_left: int | None = None  # None: no stop asked for

    @property
    def stopped(self) -> bool:
        """The orderly end is over: nothing is sent any more."""
        return self.stop_cycles_left is not None and self.stop_cycles_left <= 0
