"""A car of a few lines on the other end of a Bridge, in virtual time, and a witness who knows the safety rules.

The witness knows nothing of the supervisor or the gate: it looks at the frames that went out and at those that came in.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

from fsai_vcu.core.bridge import Bridge, BridgeConfig, BridgeReport
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec, command_of
from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    BrakeStatus,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiCommand,
    Image,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS, S

CYCLE = 10 * MS


@cache
def codec_of(name: str) -> Codec:
    return Codec(revision(name))


@dataclass
class Witness:
    """Holds each cycle to safety rules 1 to 5 and 9 by what is on the bus."""

    codec: Codec
    limits: OperationalLimits
    steer_limit_deg: float
    steer_rate_degps: float
    motor_rpm_limit: float
    motor_brakes: bool = False
    status: VcuStatus | None = None
    brake: VcuBrake | None = None
    speeds: WheelSpeeds | None = None
    steer: VcuSteer | None = None
    counts: WheelCounts | None = None
    pulses: list[tuple[int, str]] = field(default_factory=list)  # (when, which wheel), of the last 0.5 s
    axles: dict[type, VcuDriveFront | VcuDriveRear] = field(default_factory=dict)
    history: list[AsState] = field(default_factory=list)
    changed_ns: int | None = None  # when the AS state last changed
    still_since_ns: int | None = None
    # At the VCU: what may be there
    torque_there: bool = True
    brake_there: bool = True
    zero_cycles: int = 0
    zero_ns: int = 0
    last: AiCommand | None = None
    last_ns: int = 0

    def on_image(self, image: Image) -> None:
        if isinstance(image, VcuStatus):
            if not self.history or self.history[-1] is not image.as_state:
                self.history.append(image.as_state)
                self.changed_ns = image.t_rx_ns
            self.status = image
        elif isinstance(image, VcuBrake):
            self.brake = image
        elif isinstance(image, WheelCounts):
            before = self.counts or image
            self.pulses = [pulse for pulse in self.pulses if image.t_rx_ns - pulse[0] < 500 * MS]
            for wheel in ("fl", "fr", "rl", "rr"):
                step = (getattr(image, wheel) - getattr(before, wheel)) % 65536
                self.pulses += [(image.t_rx_ns, wheel)] * min(step, 2)
            self.counts = image
        elif isinstance(image, WheelSpeeds):
            if self.speeds is not None and image.t_rx_ns - self.speeds.t_rx_ns < 350 * MS:
                jumps = [abs(a - b) for a, b in zip(image.all_rpm, self.speeds.all_rpm, strict=True)]
                if max(jumps) > 300:
                    return  # no tyre can follow
            if max(image.all_rpm) > 1250:
                return
            if max(image.all_rpm) >= 10:
                self.still_since_ns = None
            elif self.still_since_ns is None or (
                self.speeds is not None and image.t_rx_ns - self.speeds.t_rx_ns >= 100 * MS
            ):
                self.still_since_ns = image.t_rx_ns
            self.speeds = image
        elif isinstance(image, VcuSteer):
            self.steer = image
        elif isinstance(image, (VcuDriveFront, VcuDriveRear)):
            self.axles[type(image)] = image

    def on_cycle(self, asked: AiCommand, handshake: bool, now_ns: int) -> None:
        status = self.status
        state = None if status is None else status.as_state
        driving = state is AsState.AS_DRIVING
        braked_by_motor = (
            self.motor_brakes and max(asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm) == 0
        )
        # Rule 9
        assert asked.handshake == handshake
        # Rule 1
        assert not (asked.torque_requested and asked.brake_requested)
        if asked.torque_requested:
            assert not self.brake_there
            if self.last is None or not self.last.torque_requested:
                assert not self.torque_there
                echoed = (
                    self.brake is not None
                    and self.brake.t_rx_ns > self.zero_ns
                    and self.brake.front_request_pct == self.brake.rear_request_pct == 0.0
                )
                assert self.zero_cycles >= 2 or (self.zero_cycles == 1 and echoed)
        if asked.brake_requested:
            assert not self.torque_there
        # Rule 2
        if asked.torque_requested:
            assert driving and status is not None
            assert now_ns - status.t_rx_ns < 50 * MS
            assert asked.direction is Direction.FORWARD and not asked.estop_request
            if not braked_by_motor:
                assert status.go_signal
                assert self.changed_ns is not None and now_ns - self.changed_ns >= 3 * S
                assert self.history[-2] is AsState.AS_READY
                assert self.history[-3] in (AsState.AS_OFF, AsState.AS_INIT)
        # Rule 3
        if driving and (asked.direction is not Direction.FORWARD or asked.mission_status is MissionStatus.FINISHED):
            assert self.speeds is not None and now_ns - self.speeds.t_rx_ns < 100 * MS
            assert self.still_since_ns is not None and now_ns - self.still_since_ns >= 500 * MS
            recent = [wheel for t_ns, wheel in self.pulses if now_ns - t_ns < 500 * MS]
            assert len(recent) == len(set(recent)), "a wheel counted two pulses"
        # Rule 4
        if driving:
            live_deg = 0.0 if self.steer is None else self.steer.angle_max_deg
            limit_deg = min(self.steer_limit_deg, live_deg, self.limits.max_steer_deg)
            assert abs(asked.steer_deg) <= limit_deg + 1e-9
            before_deg = 0.0 if self.last is None else self.last.steer_deg
            step_deg = self.steer_rate_degps * (now_ns - self.last_ns) / 1e9 + 0.1
            assert abs(asked.steer_deg - before_deg) <= step_deg + 1e-9 or abs(before_deg) > limit_deg
        else:
            assert asked.steer_deg == 0.0
        for torque_nm, kind in ((asked.front_torque_nm, VcuDriveFront), (asked.rear_torque_nm, VcuDriveRear)):
            if torque_nm > 0.0:
                assert self.speeds is not None
                rpm = self.speeds.all_rpm[:2] if kind is VcuDriveFront else self.speeds.all_rpm[2:]
                assert torque_nm <= constant_power(max(rpm)) + 1e-9
                assert torque_nm <= min(195.0, self.axles[kind].torque_max_nm, self.limits.max_axle_torque_nm) + 1e-9
        assert max(asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm) <= self.motor_rpm_limit
        # Rule 5
        if state in (None, AsState.AS_INIT, AsState.AS_OFF, AsState.AS_READY):
            assert not asked.torque_requested
            assert asked.direction is Direction.NEUTRAL
            assert asked.mission_status in (MissionStatus.NOT_SELECTED, MissionStatus.SELECTED)
        # Rule 8: the frames of a cycle are the five, and the codec takes every value
        assert [frame.can_id for frame in self.codec.encode_command(asked)] == [0x510, 0x511, 0x512, 0x513, 0x514]
        self.last, self.last_ns = asked, now_ns

    def on_sent(self, complete: bool, now_ns: int) -> None:
        assert self.last is not None
        torque, brake = self.last.torque_requested, self.last.brake_requested
        if complete:
            self.torque_there, self.brake_there = torque, brake
            if torque or brake:
                self.zero_cycles = 0
            else:
                self.zero_cycles += 1
                if self.zero_cycles == 1:
                    self.zero_ns = now_ns
        else:
            self.torque_there |= torque
            self.brake_there |= brake
            if torque or brake:
                self.zero_cycles = 0


def constant_power(rpm: int) -> float:
    for above, torque in ((700, 50.0), (600, 85.0), (500, 100.0), (400, 120.0), (300, 150.0)):
        if rpm > above:
            return torque
    return 195.0


class Rig:
    """A bridge, a car that says what the test sets, and a controller that commands what the test sets."""

    def __init__(
        self,
        config: BridgeConfig | None = None,
        *,
        revision_name: str = "2026",
        limits: OperationalLimits | None = None,
        start_ns: int = 0,
    ) -> None:
        self.codec = codec_of(revision_name)
        self.config = config or BridgeConfig()
        self.car = CARS[revision_name]
        entry = revision(revision_name)
        self.bridge = Bridge(self.codec, entry, self.car, self.config, limits, now_ns=start_ns)
        self.now_ns = start_ns
        official = limits or UNLIMITED
        rpm_per_mps = 60.0 / (2.0 * math.pi * self.car.rolling_radius_m) * self.car.gear_ratio
        self.witness = Witness(
            self.codec,
            official,
            entry.steer_limit_deg,
            math.degrees(self.car.steer_rate_radps),
            min(4000.0, official.max_speed_mps * rpm_per_mps),
            self.config.motor_brakes,
        )
        # What the car says
        self.status = VcuStatus(
            as_switch=True,
            ts_switch=True,
            as_state=AsState.AS_OFF,
            ami=Ami.TRACKDRIVE,
            steering_status=SteeringStatus.ACTIVE,
            op_state=OpState.OP_AUTO,
            ts_state=TsState.TS_RUNNING,
            ebs_state=EbsState.EBS_ARMED,
        )
        self.rpm: tuple[int, int, int, int] = (0, 0, 0, 0)
        self.pulse_rpm: tuple[int, int, int, int] | None = None  # None: the counts run as the wheel speeds say
        self.turns = [0.0, 0.0, 0.0, 0.0]
        self.steer_deg: float | None = None  # None: the steering follows at once
        self.angle_max_deg = entry.steer_limit_deg
        self.torque_max_nm = 195.0
        self.mute: set[type] = set()  # messages that do not come
        self.off = False  # the car is switched off
        self.alive: Callable[[Rig], None] = lambda rig: None  # called before each cycle
        # What the controller asks for
        self.command: VehicleCommand | None = VehicleCommand(0, 0)
        self.confirming = True
        self.confirmed_run_id: int | None = None
        self.complete = True
        self.asked: AiCommand | None = None
        self.echo = AiCommand()
        self.log: list[tuple[int, AiCommand]] = []

    # ------------------------------------------------------------ the car

    def say(self, image: Image) -> None:
        """One message of the car's, now."""
        frame = self.codec.encode(image)
        self.bridge.on_frame(Frame(frame.can_id, frame.data, self.now_ns))
        heard = replace(image, t_rx_ns=self.now_ns)
        self.witness.on_image(heard)

    def speak(self) -> None:
        """All that the car says in one cycle."""
        if self.off:
            return
        self.status = replace(self.status, handshake=not self.status.handshake)
        steer_deg = self.echo.steer_deg if self.steer_deg is None else self.steer_deg
        for image in (
            self.status,
            VcuDriveFront(0.0, 0.0, self.torque_max_nm),
            VcuDriveRear(0.0, 0.0, self.torque_max_nm),
            VcuSteer(steer_deg, self.angle_max_deg, self.echo.steer_deg),
            VcuBrake(
                0.0,
                self.echo.front_brake_pct,
                0.0,
                self.echo.rear_brake_pct,
                BrakeStatus.READY,
                EbsStatus.ARMED,
            ),
            WheelSpeeds(*self.rpm),
            self.counted(),
        ):
            if type(image) not in self.mute:
                self.say(image)

    def counted(self) -> WheelCounts:
        """The pulse counts after another cycle."""
        for wheel, rpm in enumerate(self.pulse_rpm or self.rpm):
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
            handshake = self.bridge.state.vehicle.handshake
            self.witness.on_cycle(asked, handshake, self.now_ns)
            if self.complete:
                frames = self.codec.encode_command(asked)
                images = [self.codec.decode(frame).image for frame in frames]
                self.echo = command_of({type(image): image for image in images})  # type: ignore[misc]
            self.bridge.on_sent(self.complete, self.now_ns)
            self.witness.on_sent(self.complete, self.now_ns)
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
            self.rpm = (now_rpm, now_rpm, now_rpm, now_rpm)
            self.step(2)
        assert self.sent.torque_requested
        return self

    def latency_ns(self, since_ns: int, condition: Callable[[AiCommand], bool]) -> int | None:
        """How long after `since_ns` a cycle first met `condition`."""
        return next((t - since_ns for t, asked in self.log if t >= since_ns and condition(asked)), None)
