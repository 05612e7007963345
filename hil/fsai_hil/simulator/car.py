"""The simulated car: what steering, torque and brake requests do to an ADS-DV on a flat, dry track.

A dynamic bicycle with saturating tyres, blended into the kinematic one at walking pace so that it stands still, pulls
away and stops without a numerical twitch. The actuators have the delays, rates and play which the official simulator
gives them; figures that were never published (tyres, efficiency, drag) are chosen so that the published results come
out: 1.9 m/s2 off the line, 75 m in about 9.8 s, about 21 m/s at most.

The clock is an argument in integer nanoseconds. Plain floats and `math`: one substep costs a few microseconds.
Frames: the world's x east, y north, yaw counter-clockwise from x; the vehicle frame has its origin at the rear axle.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final, TypeVar

from fsai_hil.simulator.car_signals import Actuation, CarFeedback
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.vehicle.parameters import GRAVITY_MPS2, VehicleParameters
from fsai_vcu.interface.values import Value

Coordinate = TypeVar("Coordinate", float, Floats)

SUBSTEP_NS: Final = 2_000_000
RPM_PER_RADPS: Final = 60.0 / (2.0 * math.pi)
EARTH_METRES_PER_DEGREE: Final = 111_320.0

# The dynamic bicycle divides by the speed: below the first the kinematic one drives alone, above the second not at all.
BLEND_FROM_MPS: Final = 1.0
BLEND_TO_MPS: Final = 3.0
STANDSTILL_MPS: Final = 0.01
AT_REST: Final = (0.0, 0.0, 0.0, 0.0)

# What was never published, chosen so that 1.9 m/s2, 75 m in 9.8 s and 21 m/s come out. It may differ from what the AI
# side believes: that is what testing is for.
DRIVELINE_EFFICIENCY: Final = 0.89
ROTATING_MASS_KG: Final = 27.0  # wheels and motor as the road feels them
ROLLING_RESISTANCE: Final = 0.016
DRAG_AREA_M2: Final = 0.22
FRICTION: Final = 1.05
TYRE_B: Final = 9.0  # Magic Formula's B and C for the lateral force by slip angle
TYRE_C: Final = 1.45
SLIP_STIFFNESS: Final = 22.0  # longitudinal force by slip and load
AXLE_INERTIA_KGM2: Final = 1.4  # an axle's two wheels and its motor, at the wheel
AIR_DRAG_NM: Final = 6.0  # what slows an axle whose wheels hang in the air
BRAKE_RATE_PCTPS: Final = 1000.0
BRAKE_FRONT_SHARE: Final = 0.58
MOTOR_LIMIT_BAND_RPM: Final = 60.0  # torque fades within so much below MOTOR_SPEED_MAX and brakes above it
RPM_REST: Final = 9.0  # what a wheel-speed reading may rest at after the car has stopped
RPM_REST_NS: Final = 1_000_000_000

# Where on the earth the world's origin lies: an airfield in England; any place would do
ORIGIN_LATITUDE_DEG: Final = 52.0706
ORIGIN_LONGITUDE_DEG: Final = -1.0174


class Pose(Value, frozen=True):
    """The place of the rear axle's centre in the world, and the direction in which the car points."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def ahead(self, distance_m: float, left_m: float = 0.0) -> tuple[float, float]:
        """The world point that lies so far ahead and to the left of the rear axle."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + distance_m * c - left_m * s, self.y_m + distance_m * s + left_m * c

    def seen(self, x_m: Coordinate, y_m: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Return how far ahead of it (negative: behind) and to its left world points lie."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        dx, dy = x_m - self.x_m, y_m - self.y_m
        return dx * c + dy * s, dy * c - dx * s


class CarTruth(Value, frozen=True):
    """The true state of the car at one instant."""

    t_ns: int
    pose: Pose
    speed_mps: float
    yaw_rate_radps: float
    steer_deg: float
    wheel_rpm: tuple[float, float, float, float]
    distance_m: float  # driven since the car was last placed


@dataclass(slots=True)
class _DeadTime:
    """A request that takes effect later; requests keep their order."""

    delay_ns: int
    value: float = 0.0
    pending: deque[tuple[int, float]] = field(default_factory=deque)

    def request(self, now_ns: int, value: float) -> None:
        pending = self.pending
        if value != (pending[-1][1] if pending else self.value):
            pending.append((now_ns + self.delay_ns, value))

    def at(self, now_ns: int) -> float:
        pending = self.pending
        while pending and pending[0][0] <= now_ns:
            self.value = pending.popleft()[1]
        return self.value


@dataclass(slots=True)
class _Axle:
    """The figures that each axle has of its own."""

    driven: bool
    weight_n: float
    brake_share: float  # of the whole car's braking
    brake: _DeadTime
    brake_pct: float = 0.0
    magnitude_nm: float = 0.0  # of the torque that is asked for, slewed
    torque_nm: float = 0.0
    slip_mps: float = 0.0  # tyre surface against road; positive spins, negative locks
    air_radps: float = 0.0  # with the wheels in the air


class Car:
    """One car. `advance` moves it on; `feedback` is what its sensors read, `truth` what really happened."""

    def __init__(
        self, facts: VehicleParameters, pose: Pose | None = None, now_ns: int = 0, wheels_in_air: bool = False
    ) -> None:
        """Place a car at rest, at the origin unless a pose is given."""
        self.t_ns = now_ns
        self._metres_per_degree_east = EARTH_METRES_PER_DEGREE * math.cos(math.radians(ORIGIN_LATITUDE_DEG))
        self._pulse_revs = [0.0, 0.0, 0.0, 0.0]
        self.facts = f = facts
        # what a substep needs of the model and need not work out 500 times a second
        self._cog_to_front_m = f.wheelbase_m - f.cog_ahead_of_rear_axle_m
        self._weight_n = f.mass_kg * GRAVITY_MPS2
        self._brake_full_n = f.brake_full_mps2 * f.mass_kg
        self._rolling_n = ROLLING_RESISTANCE * self._weight_n
        # Of a force that drives or drags the car, what moves its mass: the rest turns wheels and motor. (Brakes are
        # given by what the car does.)
        self._mass_share = f.mass_kg / (f.mass_kg + ROTATING_MASS_KG)
        self._steer_limit_deg = math.degrees(f.steer_max_rad)
        self._steer_rate_degps = math.degrees(f.steer_rate_radps)
        self._steer_backlash_deg = math.degrees(f.steer_backlash_rad)
        self.place(pose if pose is not None else Pose(), wheels_in_air)

    def place(self, pose: Pose, wheels_in_air: bool = False) -> None:
        """Put the car somewhere, at rest with straight wheels (people push it; its pulse counters do not notice)."""
        f = self.facts
        self.wheels_in_air = wheels_in_air
        self._yaw = pose.yaw_rad
        self._x, self._y = pose.ahead(f.cog_ahead_of_rear_axle_m)  # the centre of gravity
        self._vx = self._vy = self._yaw_rate = 0.0
        self._ax = self._ay = 0.0
        self._distance = 0.0
        self._rack_deg = self._road_deg = 0.0
        self._steer_request = _DeadTime(round(f.steer_dead_time_s * 1e9))
        front_n = self._weight_n * f.cog_ahead_of_rear_axle_m / f.wheelbase_m
        rear_n = self._weight_n * self._cog_to_front_m / f.wheelbase_m
        share, dead_ns = BRAKE_FRONT_SHARE, round(f.brake_dead_time_s * 1e9)
        self._front = _Axle(f.driven_front, front_n, share, _DeadTime(dead_ns))
        self._rear = _Axle(f.driven_rear, rear_n, 1.0 - share, _DeadTime(dead_ns))
        self._rpm = AT_REST
        self._stopped_ns: int | None = None

    # ------------------------------------------------------------ what can be read

    @property
    def pose(self) -> Pose:
        back = self.facts.cog_ahead_of_rear_axle_m
        return Pose(self._x - back * math.cos(self._yaw), self._y - back * math.sin(self._yaw), self._yaw)

    @property
    def speed_mps(self) -> float:
        return self._vx

    @property
    def standing(self) -> bool:
        """Neither the car nor any of its wheels moves."""
        return max(self._rpm) < 0.5 and self._vx < STANDSTILL_MPS

    def truth(self) -> CarTruth:
        return CarTruth(self.t_ns, self.pose, self._vx, self._yaw_rate, self._road_deg, self._rpm, self._distance)

    def feedback(self) -> CarFeedback:
        """Return what the car's sensors read now."""
        per_rev = self.facts.wheel_pulses_per_rev
        rpm = self._rpm
        if self._stopped_ns is not None and self.t_ns - self._stopped_ns < RPM_REST_NS:
            # missions.md, the car: a reading may rest at 9 rpm for a second, so "stopped" is under 10, never equal to 0
            rpm = (max(rpm[0], RPM_REST), max(rpm[1], RPM_REST), max(rpm[2], RPM_REST), max(rpm[3], RPM_REST))
        fl, fr, rl, rr = [int(revs * per_rev) & 0xFFFF for revs in self._pulse_revs]
        return CarFeedback(
            rpm,
            (fl, fr, rl, rr),
            self._road_deg,
            self._front.torque_nm,
            self._rear.torque_nm,
            self._front.brake_pct,
            self._rear.brake_pct,
            self._vx,
            (self._ax, self._ay, GRAVITY_MPS2),
            self._yaw_rate,
            ORIGIN_LATITUDE_DEG + self._y / EARTH_METRES_PER_DEGREE,
            ORIGIN_LONGITUDE_DEG + self._x / self._metres_per_degree_east,
            (90.0 - math.degrees(self._yaw)) % 360.0,
        )

    # ------------------------------------------------------------ what happens

    def advance(self, to_ns: int, order: Actuation) -> None:
        """Live on until `to_ns` under one order."""
        now = self.t_ns
        self._steer_request.request(now, order.steer_deg)
        for axle, asked_pct in ((self._front, order.front_brake_pct), (self._rear, order.rear_brake_pct)):
            # the EBS is a full braking of both axles, whatever is asked
            axle.brake.request(now, 100.0 if order.ebs_engaged else self._pressure(asked_pct))
        while now < to_ns:
            step_ns = min(SUBSTEP_NS, to_ns - now)
            now += step_ns
            self.t_ns = now
            self._substep(step_ns * 1e-9, order)

    def _pressure(self, request_pct: float) -> float:
        f = self.facts
        if request_pct <= 0.0:
            return 0.0
        return min(100.0, max(100.0 * f.brake_minimum, f.brake_excess * request_pct))

    def available_torque_nm(self, motor_rpm: float) -> float:
        """The most that a motor can give to its axle at a speed."""
        table = self.facts.torque_curve_rpm_nm
        low_rpm, low_nm = table[0]
        for high_rpm, high_nm in table[1:]:
            if motor_rpm < high_rpm:
                return low_nm + (high_nm - low_nm) * (motor_rpm - low_rpm) / (high_rpm - low_rpm)
            low_rpm, low_nm = high_rpm, high_nm
        return low_nm if motor_rpm < self.facts.motor_speed_max_rpm else 0.0

    def _motor_torque(self, magnitude_nm: float, motor_rpm: float, limit_rpm: float) -> float:
        """Signed axle torque: a request is absolute; it drives below MOTOR_SPEED_MAX and brakes above it."""
        share = (limit_rpm - motor_rpm) / MOTOR_LIMIT_BAND_RPM
        if share >= 1.0:
            available = self.available_torque_nm(motor_rpm)
            return magnitude_nm if magnitude_nm < available else available
        limited = min(magnitude_nm, self.available_torque_nm(motor_rpm))
        return limited * max(-1.0, share)

    def _substep(self, dt: float, order: Actuation) -> None:
        """Move the car by one short step under an order: steering, brakes, tyres, wheels, pose."""
        f = self.facts
        now = self.t_ns

        # steering: dead time, then a rate, then the play between rack and road wheels
        target = _between(-self._steer_limit_deg, self._steer_request.at(now), self._steer_limit_deg)
        if self._rack_deg != target:
            self._rack_deg = _toward(self._rack_deg, target, self._steer_rate_degps * dt)
            backlash_deg = self._steer_backlash_deg
            self._road_deg = _between(self._rack_deg - backlash_deg, self._road_deg, self._rack_deg + backlash_deg)

        rpm = self._rpm
        ratio = 0.5 * f.gear_ratio
        for axle, asked_nm, limit_rpm, wheels_rpm in (
            (self._front, order.front_torque_nm, order.front_motor_speed_max_rpm, rpm[0] + rpm[1]),
            (self._rear, order.rear_torque_nm, order.rear_motor_speed_max_rpm, rpm[2] + rpm[3]),
        ):
            asked_pct = axle.brake.at(now)
            if axle.brake_pct != asked_pct:
                axle.brake_pct = _toward(axle.brake_pct, asked_pct, BRAKE_RATE_PCTPS * dt)
            axle.torque_nm = 0.0
            if order.tractive_system_live and axle.driven:
                if axle.magnitude_nm != asked_nm:
                    axle.magnitude_nm = _toward(axle.magnitude_nm, asked_nm, f.torque_rate_nmps * dt)
                if axle.magnitude_nm > 0.0:
                    axle.torque_nm = self._motor_torque(axle.magnitude_nm, wheels_rpm * ratio, limit_rpm)
            else:
                axle.magnitude_nm = 0.0

        if self.wheels_in_air:
            self._spin(dt)
        else:
            self._roll(dt)

        rpm = self._rpm
        if rpm is AT_REST:
            return
        count = dt / 60.0
        revs = self._pulse_revs
        revs[0] += rpm[0] * count
        revs[1] += rpm[1] * count
        revs[2] += rpm[2] * count
        revs[3] += rpm[3] * count

    def _spin(self, dt: float) -> None:
        """Wheels in the air: only the axles turn."""
        full_nm = self._brake_full_n * self.facts.rolling_radius_m
        gain = dt / AXLE_INERTIA_KGM2
        moved = self._front.air_radps > 0.0 or self._rear.air_radps > 0.0
        for axle in (self._front, self._rear):
            hold_nm = AIR_DRAG_NM + full_nm * axle.brake_share * axle.brake_pct / 100.0
            axle.air_radps = _slowed(axle.air_radps, axle.torque_nm, hold_nm, gain)
        front, rear = self._front.air_radps * RPM_PER_RADPS, self._rear.air_radps * RPM_PER_RADPS
        self._rpm = (front, front, rear, rear)
        if moved and front == 0.0 and rear == 0.0:
            self._stopped_ns = self.t_ns
        elif front > 0.0 or rear > 0.0:
            self._stopped_ns = None

    def _roll(self, dt: float) -> None:
        """Wheels on the ground."""
        f, front, rear = self.facts, self._front, self._rear
        vx, vy, yaw_rate = self._vx, self._vy, self._yaw_rate
        radius = f.rolling_radius_m
        drive_share = self._mass_share
        front_drive = front.torque_nm * DRIVELINE_EFFICIENCY / radius * drive_share
        rear_drive = rear.torque_nm * DRIVELINE_EFFICIENCY / radius * drive_share
        front_brake = self._brake_full_n * front.brake_share * front.brake_pct / 100.0
        rear_brake = self._brake_full_n * rear.brake_share * rear.brake_pct / 100.0

        if vx <= 0.0:
            rest = self._rolling_n * drive_share + front_brake + rear_brake
            if front_drive + rear_drive <= rest:
                self._ax = self._ay = 0.0
                return

        # loads on the axles, with the transfer of the last substep
        transfer = f.mass_kg * self._ax * f.cog_height_m / f.wheelbase_m
        front_force, front_grip = self._grip(front, front.weight_n - transfer, front_drive - front_brake, vx, dt)
        rear_force, rear_grip = self._grip(rear, rear.weight_n + transfer, rear_drive - rear_brake, vx, dt)

        steer = math.radians(self._road_deg)
        drag_n = 0.6 * DRAG_AREA_M2 * vx * vx  # half of 1.2 kg/m3 of air
        resistance = (self._rolling_n + drag_n) * drive_share

        blend = (vx - BLEND_FROM_MPS) / (BLEND_TO_MPS - BLEND_FROM_MPS)
        to_front, to_rear = self._cog_to_front_m, f.cog_ahead_of_rear_axle_m
        cos_steer, sin_steer = math.cos(steer), math.sin(steer)
        if blend > 0.0:
            front_angle = steer - math.atan2(vy + to_front * yaw_rate, vx)
            rear_angle = -math.atan2(vy - to_rear * yaw_rate, vx)
            front_side = self._side_n(front_force, front_grip, front_angle)
            rear_side = self._side_n(rear_force, rear_grip, rear_angle)
            along = front_force * cos_steer - front_side * sin_steer + rear_force - resistance
            across = front_force * sin_steer + front_side * cos_steer + rear_side
            vx_rate = along / f.mass_kg + yaw_rate * vy
            vy_next = vy + (across / f.mass_kg - yaw_rate * vx) * dt
            turn = to_front * (front_force * sin_steer + front_side * cos_steer) - to_rear * rear_side
            yaw_rate_next = yaw_rate + turn / f.yaw_inertia_kgm2 * dt
        else:
            vx_rate = (front_force + rear_force - resistance) / f.mass_kg
            vy_next = yaw_rate_next = 0.0
        vx_next = vx + vx_rate * dt
        if vx_next < 0.0:
            vx_next = 0.0  # brakes and rolling resistance stop a car; they do not drive it backwards
        if blend < 1.0:
            kinematic_rate = vx_next * math.tan(steer) / f.wheelbase_m
            share = max(0.0, blend)
            yaw_rate_next = share * yaw_rate_next + (1.0 - share) * kinematic_rate
            vy_next = share * vy_next + (1.0 - share) * kinematic_rate * to_rear

        self._ax = (vx_next - vx) / dt - yaw_rate * vy
        self._ay = (vy_next - vy) / dt + yaw_rate * vx
        yaw = self._yaw + 0.5 * (yaw_rate + yaw_rate_next) * dt
        c, s = math.cos(yaw), math.sin(yaw)
        self._x += (vx_next * c - vy_next * s) * dt
        self._y += (vx_next * s + vy_next * c) * dt
        self._yaw = yaw
        self._distance += vx_next * dt
        self._vx, self._vy, self._yaw_rate = vx_next, vy_next, yaw_rate_next

        if vx_next == 0.0:
            self._vy = self._yaw_rate = front.slip_mps = rear.slip_mps = 0.0
            self._rpm = AT_REST
            if vx > 0.0:
                self._stopped_ns = self.t_ns
            return
        self._stopped_ns = None
        half = 0.5 * f.track_m * yaw_rate_next
        sideways = (vy_next + to_front * yaw_rate_next) * sin_steer
        per_mps = RPM_PER_RADPS / radius
        self._rpm = (
            _positive((vx_next - half) * cos_steer + sideways + front.slip_mps) * per_mps,
            _positive((vx_next + half) * cos_steer + sideways + front.slip_mps) * per_mps,
            _positive(vx_next - half + rear.slip_mps) * per_mps,
            _positive(vx_next + half + rear.slip_mps) * per_mps,
        )

    def _grip(self, axle: _Axle, load_n: float, asked_n: float, vx: float, dt: float) -> tuple[float, float]:
        """Return what the tyres carry along, and what they could at most; the rest spins or locks the wheels.

        A driven or braked tyre's surface creeps over the road: a little always, a lot beyond its grip.
        """
        grip_n = FRICTION * load_n
        force_n = _between(-grip_n, asked_n, grip_n)
        excess_n = asked_n - force_n
        if excess_n != 0.0:
            slip_mps = axle.slip_mps + excess_n * self.facts.rolling_radius_m**2 / AXLE_INERTIA_KGM2 * dt
            axle.slip_mps = max(-vx, slip_mps)
        else:
            creep, share = force_n / load_n / SLIP_STIFFNESS * vx, dt / 0.02
            axle.slip_mps += (creep - axle.slip_mps) * (share if share < 1.0 else 1.0)
        return force_n, grip_n

    def _side_n(self, force_n: float, grip_n: float, angle_rad: float) -> float:
        """An axle's lateral force by its slip angle, of what the longitudinal one leaves of the grip."""
        left_n = math.sqrt(_positive(1.0 - (force_n / grip_n) ** 2)) * grip_n
        return left_n * math.sin(TYRE_C * math.atan(TYRE_B * angle_rad))


def _positive(value: float) -> float:
    return value if value > 0.0 else 0.0


def _between(low: float, value: float, high: float) -> float:
    return low if value < low else value if value < high else high


def _toward(value: float, target: float, most: float) -> float:
    """The next value on the way to a target, at most so much nearer."""
    if target > value + most:
        return value + most
    return value - most if target < value - most else target


def _slowed(speed: float, drive_nm: float, hold_nm: float, gain: float) -> float:
    """An axle's next speed under a driving torque and torques that only ever hold it back."""
    pushed = speed + drive_nm * gain
    if pushed > 0.0:
        pushed = max(0.0, pushed - hold_nm * gain)
    return max(0.0, pushed)
