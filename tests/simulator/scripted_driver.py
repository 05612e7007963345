"""A driver for tests of the simulated world: it answers the VCU as an AI computer must, and drives by what a test says.

It is no AI: it knows the true pose. What it is for is to see the world's own parts work together, good runs and bad.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from fsai_hil.simulator.world import World
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiCommand, VcuStatus

STEP_NS = 2_000_000
SECOND_NS = 1_000_000_000


@dataclass
class Wish:
    """What the driver wants now."""

    steer_deg: float = 0.0
    torque_nm: float = 0.0
    brake_pct: float = 0.0
    motor_rpm: int = 4000
    finished: bool = False
    estop: bool = False


Style = Callable[[World, float], Wish]  # (world, seconds since AS_DRIVING)


@dataclass
class ScriptedDriver:
    world: World
    style: Style
    wait_s: float = 3.05
    heard: list[Frame] = field(default_factory=list)
    silent: bool = False
    _driving_ns: int | None = None
    _braking: bool = False

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """Let both sides live until the world is done, `until` holds, or the time is over."""
        world = self.world
        now = world.now_ns
        end_ns = now + round(seconds * SECOND_NS)
        while now < end_ns and not world.done and not (until is not None and until()):
            now += STEP_NS
            for frame in world.advance(now):
                self.heard.append(frame)
                if frame.can_id == 0x520 and not self.silent:
                    image = world.codec.decode(frame).image
                    assert isinstance(image, VcuStatus)
                    for answer in world.codec.encode_command(self._command(image, frame.t_ns)):
                        world.on_frame(Frame(answer.can_id, answer.data, now))

    def _command(self, status: VcuStatus, t_ns: int) -> AiCommand:
        state = status.as_state
        if state is not AsState.AS_DRIVING:
            self._driving_ns = None
        if state is AsState.AS_DRIVING:
            self._driving_ns = self._driving_ns or t_ns
            since_s = (t_ns - self._driving_ns) / SECOND_NS
            wish = self.style(self.world, since_s) if since_s >= self.wait_s else Wish()
            if self._braking and wish.torque_nm and not wish.brake_pct:
                wish.torque_nm = 0.0  # one cycle of neither: the VCU hears the new torque before the brake's end
            self._braking = wish.brake_pct > 0.0
            standing = max(self.world.car.feedback().wheel_rpm) < 10.0
            finished = wish.finished and standing
            return AiCommand(
                handshake=status.handshake,
                estop_request=wish.estop,
                mission_status=MissionStatus.FINISHED if finished else MissionStatus.RUNNING,
                direction=Direction.NEUTRAL if finished else Direction.FORWARD,
                steer_deg=round(wish.steer_deg, 1),
                rear_torque_nm=0.0 if wish.brake_pct else wish.torque_nm,
                rear_motor_speed_max_rpm=wish.motor_rpm,
                front_brake_pct=wish.brake_pct,
                rear_brake_pct=wish.brake_pct,
            )
        selected = status.ami is not Ami.NOT_SELECTED and state in (
            AsState.AS_INIT,
            AsState.AS_OFF,
            AsState.AS_READY,
        )
        ended = state is AsState.AS_FINISHED
        mission = MissionStatus.FINISHED if ended else MissionStatus.NOT_SELECTED
        if selected:
            mission = MissionStatus.SELECTED
        return AiCommand(handshake=status.handshake, mission_status=mission)


def follow(speed_mps: float, laps: int = 1, stop_brake_pct: float = 50.0) -> Style:
    """Pure pursuit along the centreline; brake to rest once the judge has counted the laps."""
    at: dict[int, int] = {}

    def style(world: World, since_s: float) -> Wish:
        line = world.track.centreline_m
        assert line is not None
        pose, speed = world.car.pose, world.car.speed_mps
        index = at.get(id(world.track))
        count = len(line)
        if index is None:
            index = int(np.argmin(np.hypot(line[:, 0] - pose.x_m, line[:, 1] - pose.y_m)))
        around = [(index + k) % count if world.track.closed else min(count - 1, index + k) for k in range(12)]
        index = min(around, key=lambda i: math.hypot(line[i, 0] - pose.x_m, line[i, 1] - pose.y_m))
        at[id(world.track)] = index
        reach_m = 1.5 + 0.35 * speed
        target = index
        while math.hypot(line[target, 0] - pose.x_m, line[target, 1] - pose.y_m) < reach_m:
            following = (target + 1) % count if world.track.closed else target + 1
            if following >= count:
                break
            target = following
        dx, dy = line[target, 0] - pose.x_m, line[target, 1] - pose.y_m
        left = dy * math.cos(pose.yaw_rad) - dx * math.sin(pose.yaw_rad)
        distance = max(1.0, math.hypot(dx, dy))
        steer = math.degrees(math.atan(2.0 * world.model.wheelbase_m * left / distance**2))
        if world.judge.laps >= laps:
            return Wish(steer_deg=_limited(steer, world), brake_pct=stop_brake_pct, finished=True)
        rpm = speed_mps / world.model.wheel_radius_m * 60.0 / (2.0 * math.pi) * world.model.gear_ratio
        return Wish(steer_deg=_limited(steer, world), torque_nm=100.0, motor_rpm=min(4000, round(rpm)))

    return style


def _limited(steer_deg: float, world: World) -> float:
    most = world.model.steer_limit_deg
    return max(-most, min(most, steer_deg))
