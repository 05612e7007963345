"""A car of a few lines: it reports what is set, and does at once what it is asked for."""

from __future__ import annotations

from typing import Final

from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    BrakeStatus,
    EbsState,
    EbsStatus,
    OpState,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.messages import (
    AiCommand,
    Image,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    WheelSpeeds,
)

WELL: Final = VcuStatus(
    as_switch=True,
    ts_switch=True,
    as_state=AsState.AS_OFF,
    ami=Ami.TRACKDRIVE,
    steering_status=SteeringStatus.ACTIVE,
    op_state=OpState.OP_AUTO,
    ts_state=TsState.TS_RUNNING,
    ebs_state=EbsState.EBS_ARMED,
)
"""0x520 of a car with which all is as it should be."""


class SmallCar:
    """Car that the fuzz, the bridge's tests and the rules' tests drive: its messages of one cycle."""

    angle_max_deg = 30.0
    torque_max_nm = 195.0
    angle_deg: float | None = None  # None: the steering follows at once
    rpm: int | tuple[int, int, int, int] = 0  # of all wheels, or of each
    status = WELL
    heard = AiCommand()  # the last command

    @property
    def wheels_rpm(self) -> tuple[int, int, int, int]:
        rpm = self.rpm
        return rpm if isinstance(rpm, tuple) else (rpm, rpm, rpm, rpm)

    def images(self) -> tuple[Image, ...]:
        """Return its messages but for the pulse counts."""
        heard = self.heard
        front_pct, rear_pct = heard.front_brake_pct, heard.rear_brake_pct
        angle_deg = heard.steer_deg if self.angle_deg is None else self.angle_deg
        return (
            self.status,
            VcuDriveFront(0.0, heard.front_torque_nm, self.torque_max_nm),
            VcuDriveRear(0.0, heard.rear_torque_nm, self.torque_max_nm),
            VcuSteer(angle_deg, self.angle_max_deg, heard.steer_deg),
            VcuBrake(front_pct, front_pct, rear_pct, rear_pct, BrakeStatus.READY, EbsStatus.ARMED),
            WheelSpeeds(*self.wheels_rpm),
        )
