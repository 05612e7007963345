"""A driver for tests of the simulated world: it answers the VCU as an AI computer must, and accelerates straight on."""

from __future__ import annotations

from collections.abc import Callable

from fsai_hil.simulator.world import World
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiCommand, VcuStatus

STEP_NS = 2_000_000
SECOND_NS = 1_000_000_000
WAIT_NS = 3_050_000_000  # the rules: no torque in the first 3 s of AS_DRIVING


class ScriptedDriver:
    def __init__(self, world: World) -> None:
        self.world = world
        self.silent = False

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """Let both sides live until the world is done, `until` holds, or the time is over."""
        world = self.world
        now = world.now_ns
        end_ns = now + round(seconds * SECOND_NS)
        while now < end_ns and not world.done and not (until is not None and until()):
            now += STEP_NS
            for frame in world.advance(now):
                if frame.can_id == 0x520 and not self.silent:
                    image = world.codec.decode(frame).image
                    assert isinstance(image, VcuStatus)
                    for answer in world.codec.encode_command(self._command(image)):
                        world.on_frame(Frame(answer.can_id, answer.data, now))

    def _command(self, status: VcuStatus) -> AiCommand:
        if status.as_state is AsState.AS_DRIVING:
            return AiCommand(
                handshake=status.handshake,
                mission_status=MissionStatus.RUNNING,
                direction=Direction.FORWARD,
                rear_torque_nm=195.0 if self.world.vcu.in_state_ns >= WAIT_NS else 0.0,
                rear_motor_speed_max_rpm=4000,
            )
        selected = status.ami is not Ami.NOT_SELECTED
        mission = MissionStatus.SELECTED if selected else MissionStatus.NOT_SELECTED
        return AiCommand(handshake=status.handshake, mission_status=mission)
