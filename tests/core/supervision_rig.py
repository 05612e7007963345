"""A car of a few lines on the other end of a Bridge, in virtual time, and the checker of the rules on the wire."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache

from msgspec.structs import replace

from fsai_hil.evidence.small_car import SmallCar
from fsai_hil.rules.checker import WireChecker
from fsai_vcu.core.bridge import Bridge, BridgeConfig, BridgeReport
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiCommand, Image, WheelCounts, command_of
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS, S

CYCLE = 10 * MS


@cache
def codec_of(name: str) -> Codec:
    return Codec(revision(name))


class Rig(SmallCar):
    """A bridge, a car that says what the test sets, and a controller that commands what the test sets."""

    def __init__(
        self,
        config: BridgeConfig | None = None,
        *,
        revision_name: str = "2026",
        start_ns: int = 0,
    ) -> None:
        self.codec = codec_of(revision_name)
        self.config = config or BridgeConfig()
        self.car = CARS[revision_name]
        entry = revision(revision_name)
        self.bridge = Bridge(self.codec, entry, self.car, self.config, now_ns=start_ns)
        self.now_ns = start_ns
        self.wire = WireChecker(
            self.codec,
            in_flight_ns=0,
            handshake_in_flight_ns=0,
            clock_slack_ns=0,
            car=self.car,
            from_start=True,
        )
        # What the car says
        self.angle_max_deg = entry.steer_limit_deg
        self.pulse_rpm: tuple[int, int, int, int] | None = None  # None: the counts run as the wheel speeds say
        self.turns = [0.0, 0.0, 0.0, 0.0]
        self.mute: set[type] = set()  # messages that do not come
        self.off = False  # the car is switched off
        self.alive: Callable[[Rig], None] = lambda rig: None  # called before each cycle
        # What the controller asks for
        self.command: VehicleCommand | None = VehicleCommand(0, 0)
        self.confirming = True
        self.confirmed_run_id: int | None = None
        self.complete = True
        self.asked: AiCommand | None = None
        self.log: list[tuple[int, AiCommand]] = []

    # ------------------------------------------------------------ the car

    def say(self, image: Image) -> None:
        """One message of the car's, now."""
        frame = self.codec.encode(image)
        self.receive(Frame(frame.can_id, frame.data, self.now_ns))

    def receive(self, frame: Frame) -> None:
        """A frame reaches the bridge; who watches the bus takes those of the AI computer's ids for the bridge's own."""
        self.bridge.on_frame(frame)
        if frame.can_id not in AI_IDS:
            self.wire.on_frame(frame)

    def speak(self) -> None:
        """All that the car says in one cycle."""
        if self.off:
            return
        self.status = replace(self.status, handshake=not self.status.handshake)
        for image in (*self.images(), self.counted()):
            if type(image) not in self.mute:
                self.say(image)

    def counted(self) -> WheelCounts:
        """The pulse counts after another cycle."""
        for wheel, rpm in enumerate(self.pulse_rpm or self.wheels_rpm):
            self.turns[wheel] += rpm / 60.0 * CYCLE / S
        return WheelCounts(*(int(turns * self.car.wheel_pulses_per_rev) % 65536 for turns in self.turns))

    def say_state(self, as_state: AsState, **changes: object) -> None:
        """Change what the next 0x520 says."""
        self.status = replace(self.status, as_state=as_state, **changes)  # type: ignore[arg-type]

    # ------------------------------------------------------------ time

    def step(self, cycles: int = 1) -> AiCommand | None:
        """`cycles` times 10 ms: the car speaks, the controller commands, the bridge answers."""
        for _ in range(cycles):
            self.now_ns += CYCLE
            self.speak()
            run = self.bridge.run
            if self.confirming and run.run_id != self.confirmed_run_id:  # once for each run
                self.confirmed_run_id = run.run_id
                self.bridge.on_reset_confirmed("planner", run.run_id)
                self.bridge.on_reset_confirmed("controller", run.run_id)
            if self.command is not None:
                self.bridge.on_command(
                    replace(self.command, t_sensor_ns=self.now_ns, run_id=self.bridge.run.run_id), self.now_ns
                )
            self.alive(self)
            self.cycle()
        return self.asked

    def cycle(self) -> AiCommand | None:
        """Only the bridge's part, at the time that it is."""
        asked = self.bridge.cycle(self.now_ns)
        self.asked = asked
        if asked is not None:
            if self.complete:
                images = [self.wire.on_frame(frame) for frame in self.codec.encode_command(asked, self.now_ns)]
                self.wire.cycle_over(self.now_ns)
                self.heard = command_of({type(image): image for image in images})  # type: ignore[misc]
                assert not self.wire.violations, self.wire.violations
            self.bridge.on_sent(self.complete, self.now_ns)
            self.log.append((self.now_ns, asked))
        return asked

    def run_ms(self, milliseconds: int) -> AiCommand | None:
        return self.step(milliseconds // 10)

    @property
    def sent(self) -> AiCommand:
        """The last cycle, which was not silence."""
        assert self.asked is not None
        return self.asked

    @property
    def report(self) -> BridgeReport:
        return self.bridge.report(self.now_ns)

    # ------------------------------------------------------------ the life of a run

    def wake(self) -> Rig:
        """The car speaks, the bridge has listened its 200 ms."""
        self.run_ms(300)
        return self

    def autonomous(self) -> Rig:
        self.wake()
        done, message = self.bridge.set_mode("autonomous", self.now_ns)
        assert done, message
        self.step(2)
        return self

    def ready(self) -> Rig:
        self.autonomous()
        assert self.sent.mission_status is MissionStatus.SELECTED
        self.say_state(AsState.AS_READY)
        self.wait_in_ready()
        return self

    def wait_in_ready(self) -> None:
        """5 s of AS_READY, of which only the last 50 ms are at the bus's own pace: 0x520 every 80 ms is enough."""
        for _ in range(62):
            self.now_ns += 7 * CYCLE
            self.step()
        self.run_ms(50)

    def launched(self) -> Rig:
        """The first frame of AS_DRIVING has been answered."""
        self.ready()
        self.say_state(AsState.AS_DRIVING, go_signal=True)
        self.step()
        return self

    def driving(self, rpm: int = 200, throttle: float = 0.5) -> Rig:
        """AS_DRIVING for 3.2 s, with torque, at `rpm` of every wheel."""
        self.launched()
        self.command = VehicleCommand(0, 0, throttle=throttle, speed_limit_mps=10.0)
        self.run_ms(3200)
        for now_rpm in (*range(200, rpm, 200), rpm):  # as a tyre can follow
            self.rpm = now_rpm
            self.step(2)
        assert self.sent.torque_requested
        return self

    def copied(self) -> Rig:
        """Another rig in the same state, which goes on by itself."""
        return copy.deepcopy(self)

    def latency_ns(self, since_ns: int, condition: Callable[[AiCommand], bool]) -> int | None:
        """How long after `since_ns` a cycle first met `condition`."""
        return next((t - since_ns for t, asked in self.log if t >= since_ns and condition(asked)), None)


@cache
def _driven(rpm: int) -> Rig:
    return Rig().driving(rpm)


def driven(rpm: int = 200) -> Rig:
    """`Rig().driving(rpm)`, as a copy of one that has driven there."""
    return _driven(rpm).copied()
