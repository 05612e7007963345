"""The bridge as it is searched: its frames have an image and no bytes, and the search chooses what its checks say."""

from __future__ import annotations

from typing import Any

from msgspec import field

from fsai_hil.evidence.abstraction import FITTING
from fsai_hil.rules.checker import WireChecker
from fsai_hil.simulator.profiles import SPECIFICATION, Profile
from fsai_hil.simulator.watched_bridge import WatchedBridge, process_of
from fsai_vcu.core.bridge import Bridge, BridgeConfig, BridgeState
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.supervision.plausibility import SteeringCheck, WheelCheck
from fsai_vcu.core.vehicle.odometry import OdometryState
from fsai_vcu.core.vehicle.parameters import CARS, VehicleParameters
from fsai_vcu.interface.codec import Codec, codec_of
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiCommand
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.values import Value


class SearchSetting(Value, frozen=True):
    """The subject of a search: the configuration of the AI side and the car at the other end."""

    config: BridgeConfig = field(default_factory=lambda: BridgeConfig(steer_rate_degps=1500.0))
    revision: str = "2026"
    car: VehicleParameters = CARS["2026"]
    profile: Profile = SPECIFICATION
    first_state: AsState = AsState.AS_INIT
    limits: OperationalLimits = field(default_factory=lambda: OperationalLimits(8.0, 120.0, 12.0))

    @property
    def codec(self) -> Codec:
        return codec_of(revision(self.revision))

    def checker(self, **process: Any) -> WireChecker:
        """The checker of the rules at the sender's own place; `process`: what else it knows of the configuration."""
        config = self.config
        return WireChecker(
            self.codec,
            in_flight_ns=0,
            handshake_in_flight_ns=0,
            clock_slack_ns=0,
            car=self.car,
            limits=self.limits,
            steer_rate_degps=config.steer_rate_degps,
            from_start=True,
            motor_brakes=config.motor_brakes,
            short_sequence=config.short_sequence_allowed,
            process=process_of(config, **process),
        )


class SearchedBridge(WatchedBridge):
    """The bridge, whose plausibility checks say what the environment wants."""

    steer_odd = False
    wheel_odd = False

    def on_frame(self, frame: Frame) -> None:
        """Take in a frame that has an image and no bytes; the checker is given it decoded."""
        Bridge.on_frame(self, frame)

    def _on_revision(self, frame: Frame) -> None:
        """A searched frame has an image and no bytes; what they tell of its revision reaches words only."""

    def _moved(self, state: BridgeState) -> OdometryState:
        return state.odometry

    def _checked(self, state: BridgeState, asked: AiCommand, now_ns: int) -> tuple[SteeringCheck, WheelCheck]:
        if not (self.steer_odd or self.wheel_odd):
            return FITTING

        def since_ns(odd: bool, before_ns: int | None) -> int | None:
            return (now_ns if before_ns is None else before_ns) if odd and state.supervisor.driving else None

        return (
            SteeringCheck(implausible_since_ns=since_ns(self.steer_odd, state.steering.implausible_since_ns)),
            WheelCheck(implausible_since_ns=since_ns(self.wheel_odd, state.wheels.implausible_since_ns)),
        )
