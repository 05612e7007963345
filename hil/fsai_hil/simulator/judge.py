"""The judge: pass or fail of each mission, from the car's true motion and the lamps on the car, never from what the AI
side claims.

It sees what marshals see: where the car really is, how its wheels turn, which AS state the ASSI shows, and, once the
car has stopped itself, the cause on its display. Rules: general FS rules for driverless cars; a cone knocked over costs
2 s and is reported, leaving the track with all four wheels fails the run.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from msgspec.structs import asdict

from fsai_hil.rules.numbers import LAUNCH_NS
from fsai_hil.simulator.car import CarTruth, Pose
from fsai_hil.simulator.tracks.layout import (
    ACCELERATION_STOP_M,
    CIRCUIT_STOP_M,
    CONE_RADIUS_M,
    KIND_IS,
    SKIDPAD_CENTRES_APART_M,
    SKIDPAD_STOP_M,
    Track,
    TrackKind,
)
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.enums import Ami, AsState, ShutdownCause
from fsai_vcu.interface.specification import STANDING_RPM
from fsai_vcu.interface.units import KMH_PER_MPS, S
from fsai_vcu.interface.values import Value

STILL_M: Final = 0.10  # a car that must not move may settle by this much
ROUNDING_M: Final = 1e-6
CONE_PENALTY_S: Final = 2.0
LINE_HALF_WIDTH_M: Final = 4.0  # a line is crossed within so much of its middle
RPM_TOLERANCE: Final = 0.95  # a wheel speed asked for counts as reached from here
INSPECTION_A_RPM: Final = 200.0
INSPECTION_A_SPIN_UP_S: Final = 10.0
INSPECTION_A_SPIN_DOWN_S: Final = 5.0
INSPECTION_B_RPM: Final = 50.0
SWEEP_TOLERANCE_DEG: Final = 2.0
DEMO_SPEED_KMH: Final = 15.0
DEMO_ACCELERATE_M: Final = 10.0
DEMO_STOP_M: Final = 10.0
DEMO_SWEEP_DEG: Final = 10.0
LAP_TIMEOUT_S: Final = 180.0  # each lap of a circuit; a car slower than that is not racing


class JudgeVerdict(Value, frozen=True):
    """The judge's report at the end, or as it would be if the run ended now. Times in s since the world began."""

    mission: str
    result: str  # 'pass' or 'fail'; 'not judged' where the computer was too busy
    reasons: tuple[str, ...]  # why it did not pass
    as_states: tuple[tuple[str, float], ...]  # (state, when it was entered)
    laps: int
    lap_times_s: tuple[float, ...]
    cones_hit: int
    penalty_s: float
    off_course: int
    max_lateral_error_m: float
    mean_speed_mps: float
    top_speed_mps: float
    distance_m: float
    driving_time_s: float
    stop_distance_m: float | None  # beyond the finish line
    shutdown_cause: str | None
    finished: bool = True  # the run is over

    @property
    def passed(self) -> bool:
        return self.result == "pass"

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as an object for JSON; as_states become objects."""
        found = asdict(self)
        found["as_states"] = [{"state": state, "t_s": round(t, 3)} for state, t in self.as_states]
        return found

    def summary(self) -> str:
        """One line for people."""
        parts = [f"{self.mission}: {self.result.upper()}"]
        if self.lap_times_s:
            times = ", ".join(f"{t:.2f} s" for t in self.lap_times_s)
            parts.append(
                f"{times} from line to line" if self.mission == "acceleration" else f"laps {self.laps} ({times})"
            )
        parts.append(f"{self.distance_m:.1f} m, mean {self.mean_speed_mps:.1f} m/s, top {self.top_speed_mps:.1f} m/s")
        parts.append(f"cones hit {self.cones_hit}, off course {self.off_course}")
        if self.reasons:
            parts.append("because " + "; ".join(self.reasons))
        return " - ".join(parts)


# ---------------------------------------------------------------- where the car is on the track


class _Crossing:
    """Notices when a point crosses a line forward, and when exactly."""

    def __init__(self, line: Pose | None) -> None:
        assert line is not None  # check_track has looked
        self.line = line
        self._ahead_m: float | None = None
        self._t_ns = 0

    def watch(self, t_ns: int, x_m: float, y_m: float) -> float | None:
        """The time of the crossing in ns, between the last look and this one."""
        (ahead, left), before = self.line.seen(x_m, y_m), self._ahead_m
        earlier = self._t_ns
        self._ahead_m, self._t_ns = ahead, t_ns
        if before is None or before >= 0.0 or ahead < 0.0 or abs(left) > LINE_HALF_WIDTH_M:
            return None
        return earlier + (t_ns - earlier) * before / (before - ahead)


class _Route:
    """Follows the car along the centreline, so that progress is driven and never jumped."""

    BACK, ON = 6, 14  # points of 0.25 to 0.5 m: what a car can pass between two looks, with a margin
    LOST_M = 8.0

    def __init__(self, track: Track) -> None:
        assert track.centreline_m is not None  # callers ask only for tracks that have one
        self._closed, self._count = track.closed, len(track.centreline_m)
        # A closed line has no ends; an open one stays at them.
        around, mode = range(-self.BACK, self._count + self.ON), "wrap" if track.closed else "clip"
        self._around: list[tuple[float, float]] = track.centreline_m.take(around, axis=0, mode=mode).tolist()  # type: ignore[call-overload]
        self._index: int | None = None
        self.step_m = track.length_m / max(1, self._count - (0 if track.closed else 1))
        self.progress_m = 0.0  # along the centreline since the run began
        self.lateral_m = 0.0  # positive: left of it

    def _points(self, begin: int, end: int) -> list[tuple[float, float]]:
        return self._around[begin + self.BACK : end + self.BACK]

    def _nearest(self, begin: int, end: int, x: float, y: float) -> int:
        apart = [(px - x) * (px - x) + (py - y) * (py - y) for px, py in self._points(begin, end)]
        return begin + apart.index(min(apart))

    def follow(self, x: float, y: float) -> float:
        """Follow the car, and return how far left of the route it is now."""
        closed, count = self._closed, self._count
        if self._index is None or (closed and abs(self.lateral_m) > self.LOST_M):
            # found again: no progress is credited for the way here. An open route is entered at its first pass
            self._index = self._nearest(0, count, x, y)
        best = self._nearest(self._index - self.BACK, self._index + self.ON + 1, x, y)
        if not closed:
            best = max(0, best)
        self.progress_m += (best - self._index) * self.step_m
        self._index = best % count
        (ax, ay), (px, py), (bx, by) = self._points(self._index - 1, self._index + 2)
        length = math.hypot(bx - ax, by - ay)
        across = (bx - ax) * (y - py) - (by - ay) * (x - px)
        self.lateral_m = across / length if length else math.hypot(x - px, y - py)
        return self.lateral_m


class _Surroundings:
    """Cones and borders around the car."""

    def __init__(self, track: Track, car: VehicleParameters) -> None:
        self._track = track
        self._car = car
        self.hit: set[int] = set()
        self.left_m: list[tuple[float, float]] = []  # where the car left the lane
        self._off = False
        self._clear_m = 0.0  # how far the nearest cone was that was not hit, when the car was `_there`
        self._there = Pose()

    def look(self, pose: Pose, lateral_m: float | None) -> None:
        car = self._car
        middle = Pose(*pose.ahead(car.nose_ahead_of_rear_axle_m - car.length_m / 2.0), pose.yaw_rad)
        self._look_at_cones(middle)
        half = car.track_m / 2.0
        wheels = ((along, across) for along in (0.0, car.wheelbase_m) for across in (half, -half))
        near = lateral_m is not None and abs(lateral_m) < 1.2  # no lane is narrower than 3 m; spares the exact look
        off = not near and not any(self._track.on_lane(*pose.ahead(*wheel)) for wheel in wheels)
        if off and not self._off:
            self.left_m.append((middle.x_m, middle.y_m))
        self._off = off

    def _look_at_cones(self, middle: Pose) -> None:
        car, there = self._car, self._there
        turned = abs(middle.yaw_rad - there.yaw_rad) * math.hypot(car.length_m, car.width_m) / 2.0
        if math.hypot(middle.x_m - there.x_m, middle.y_m - there.y_m) + turned < self._clear_m - ROUNDING_M:
            return  # no point of the car has moved as far as that
        ahead, left = middle.seen(*self._track.cones_xy_m.T)
        along, across = np.abs(ahead) - car.length_m / 2.0, np.abs(left) - car.width_m / 2.0
        apart_m = np.hypot(np.maximum(0.0, along), np.maximum(0.0, across)) - CONE_RADIUS_M[self._track.cone_colors]
        self.hit.update(np.flatnonzero(apart_m < 0.0).tolist())
        self._clear_m, self._there = float(apart_m[apart_m >= 0.0].min(initial=math.inf)), middle


# ---------------------------------------------------------------- the missions


class _Referee:
    """Watches what one mission asks for: in AS_DRIVING, and after it until the car stands."""

    def __init__(self, track: Track, car: VehicleParameters, laps: int) -> None:
        self.track, self.car, self.wanted = track, car, laps
        self.lap_times_s: list[float] = []
        self.crossings_ns: list[float] = []  # of the lines that begin and end a lap
        self.stop_distance_m: float | None = None  # beyond the finish line, once it has been crossed

    @property
    def laps(self) -> int:
        return len(self.lap_times_s)

    def watch(self, truth: CarTruth, nose: tuple[float, float], route: _Route | None) -> None:
        raise NotImplementedError

    def complaints(self) -> list[str]:
        raise NotImplementedError


class _TimedReferee(_Referee):
    """A referee of a mission that is timed from a line on."""

    LINE = "start"
    STOP_M: float  # how far beyond the finish line the car may stop

    _crossed_ns: float | None = None  # the start line, for the lap in hand
    _crossed_at_m = 0.0

    def __init__(self, track: Track, car: VehicleParameters, laps: int) -> None:
        super().__init__(track, car, laps)
        self._start, self._finish = _Crossing(track.start_line), _Crossing(track.finish_line)

    def _cross(self, crossed_ns: float, at_m: float) -> None:
        """A lap ends, if one was in hand, and the next begins."""
        if self._crossed_ns is not None:
            self.lap_times_s.append((crossed_ns - self._crossed_ns) / S)
        self._crossed_ns, self._crossed_at_m = crossed_ns, at_m
        self.crossings_ns.append(crossed_ns)

    def complaints(self) -> list[str]:
        if self._crossed_ns is None:
            return [f"the {self.LINE} line was never crossed"]
        if unfinished := self._unfinished():
            return [unfinished]
        distance_m = self.stop_distance_m or 0.0
        if distance_m <= self.STOP_M:
            return []
        return [f"stopped {distance_m:.1f} m after the finish line, allowed are {self.STOP_M:g} m"]

    def _unfinished(self) -> str | None:
        """Say what was not driven."""
        raise NotImplementedError


class _AccelerationReferee(_TimedReferee):
    STOP_M = ACCELERATION_STOP_M

    def watch(self, truth: CarTruth, nose: tuple[float, float], route: _Route | None) -> None:
        started, finished = self._start.watch(truth.t_ns, *nose), self._finish.watch(truth.t_ns, *nose)
        if started is not None and self._crossed_ns is None:
            self._cross(started, truth.distance_m)
        if finished is not None and self._crossed_ns is not None and not self.laps:
            self._cross(finished, truth.distance_m)
        if self.laps:
            self.stop_distance_m = self._finish.line.seen(*nose)[0]

    def _unfinished(self) -> str | None:
        return None if self.laps else "the finish line was never crossed"


class _SkidpadReferee(_TimedReferee):
    """Counts the turns round both centres between one crossing of the timing line and the next."""

    LINE, STOP_M = "timing", SKIDPAD_STOP_M
    ORDER = ("right", "right", "left", "left")

    def __init__(self, track: Track, car: VehicleParameters, laps: int) -> None:
        super().__init__(track, car, laps)
        line, half = self._start.line, SKIDPAD_CENTRES_APART_M / 2.0
        self._centres = {"left": line.ahead(0.0, half), "right": line.ahead(0.0, -half)}
        self._turned = {"left": 0.0, "right": 0.0}  # rad, counter-clockwise, since the last crossing
        self._angles: dict[str, float] = {}
        self.sequence: list[str] = []

    def watch(self, truth: CarTruth, nose: tuple[float, float], route: _Route | None) -> None:
        for side, (cx, cy) in self._centres.items():
            angle = math.atan2(nose[1] - cy, nose[0] - cx)
            before = self._angles.get(side, angle)
            self._turned[side] += math.remainder(angle - before, 2.0 * math.pi)
            self._angles[side] = angle
        crossed = self._start.watch(truth.t_ns, *nose)
        if crossed is not None and (self._crossed_ns is None or truth.distance_m - self._crossed_at_m > 20.0):
            if self._crossed_ns is not None:
                self.sequence.append(self._side())
            self._cross(crossed, truth.distance_m)
            self._turned = {"left": 0.0, "right": 0.0}
        if len(self.sequence) >= len(self.ORDER):
            self.stop_distance_m = self._start.line.seen(*nose)[0]

    def _side(self) -> str:
        nearly = 0.9 * 2.0 * math.pi
        if self._turned["right"] < -nearly:
            return "right"
        return "left" if self._turned["left"] > nearly else "no circle"

    def _unfinished(self) -> str | None:
        if tuple(self.sequence) != self.ORDER:
            return f"laps driven: {', '.join(self.sequence) or 'none'}; asked for: {', '.join(self.ORDER)}"
        left = self.stop_distance_m is not None and self.stop_distance_m >= 0.0
        return None if left else "did not leave the skidpad through the exit lane"


class _CircuitReferee(_TimedReferee):
    """Laps: a crossing of the line counts when the track before it was really driven."""

    STOP_M = CIRCUIT_STOP_M
    SHARE_OF_LAP = 0.85
    LEAST_LAP_M = 30.0  # where no centreline is known

    _finished_at_m = 0.0

    @property
    def _least_m(self) -> float:
        return self.track.length_m * self.SHARE_OF_LAP if self.track.closed else self.LEAST_LAP_M

    def watch(self, truth: CarTruth, nose: tuple[float, float], route: _Route | None) -> None:
        at_m = route.progress_m if route is not None else truth.distance_m
        crossed = self._start.watch(truth.t_ns, *nose)
        if crossed is not None and (self._crossed_ns is None or at_m - self._crossed_at_m > self._least_m):
            self._cross(crossed, at_m)
            if self.laps == self.wanted:
                self._finished_at_m = truth.distance_m
        if self.laps >= self.wanted:
            self.stop_distance_m = truth.distance_m - self._finished_at_m

    def _unfinished(self) -> str | None:
        if self.laps < self.wanted:
            return f"{self.laps} of {self.wanted} laps driven"
        return f"{self.laps} laps driven where {self.wanted} were asked for" if self.laps > self.wanted else None


class _StandReferee(_Referee):
    """A referee of a mission that needs no track: it looks how the car steers, moves, and turns its driven wheels."""

    def __init__(self, track: Track, car: VehicleParameters, laps: int) -> None:
        super().__init__(track, car, laps)
        self._looks = array("d")

    def watch(self, truth: CarTruth, nose: tuple[float, float], route: _Route | None) -> None:
        fl, fr, rl, rr = truth.wheel_rpm
        driven = (fl, fr) * self.car.driven_front + (rl, rr) * self.car.driven_rear
        self._looks.extend(
            (truth.t_ns, truth.distance_m, truth.speed_mps, truth.steer_deg, min(driven), max(truth.wheel_rpm))
        )

    def _seen(self) -> Floats:
        """Return all looks as columns: time, distance, speed, steering, rpm of slowest driven and fastest wheel."""
        return np.array(self._looks).reshape(-1, 6).T


def _swept_too_little(steer_deg: Floats, least_deg: float) -> list[str]:
    return [
        f"steered {deg:.1f} deg to the {side}, asked for are {least_deg:.1f} deg"
        for side, deg in (("left", steer_deg.max(initial=0.0)), ("right", -steer_deg.min(initial=0.0)))
        if deg < least_deg
    ]


def _too_slow(rpm: Floats, wanted_rpm: float) -> list[str]:
    reached = rpm.max()
    if reached >= wanted_rpm * RPM_TOLERANCE:
        return []
    return [f"driven wheels reached {reached:.0f} of {wanted_rpm:.0f} rpm"]


class _InspectionAReferee(_StandReferee):
    def complaints(self) -> list[str]:
        """Say what static inspection A asks for and was not seen: the sweep, the speed of the wheels, their times."""
        t_ns, _, _, steer_deg, rpm, fastest_rpm = self._seen()
        found = _swept_too_little(steer_deg, math.degrees(self.car.steer_max_rad) - SWEEP_TOLERANCE_DEG)
        if abs(steer_deg[-1]) > SWEEP_TOLERANCE_DEG:
            found.append(f"steering ended at {steer_deg[-1]:.1f} deg instead of straight")
        if too_slow := _too_slow(rpm, INSPECTION_A_RPM):
            return found + too_slow
        began, reached = np.argmax(rpm > STANDING_RPM), np.flatnonzero(rpm >= INSPECTION_A_RPM * RPM_TOLERANCE)
        up_s = (t_ns[reached[0]] - t_ns[began]) / S
        if up_s > INSPECTION_A_SPIN_UP_S:
            found.append(f"driven wheels took {up_s:.1f} s to reach {INSPECTION_A_RPM:.0f} rpm")
        at_rest_ns = t_ns[reached[-1] :][fastest_rpm[reached[-1] :] < STANDING_RPM]
        if not len(at_rest_ns):
            found.append("the wheels did not come to rest")
        elif (down_s := (at_rest_ns[0] - t_ns[reached[-1]]) / S) > INSPECTION_A_SPIN_DOWN_S:
            found.append(f"the wheels took {down_s:.1f} s to come to rest")
        return found


class _InspectionBReferee(_StandReferee):
    def complaints(self) -> list[str]:
        return _too_slow(self._seen()[4], INSPECTION_B_RPM)


class _DemoReferee(_StandReferee):
    """Sweep, accelerate, stop, accelerate: each step begins where the last one ended."""

    def complaints(self) -> list[str]:
        """Say what the autonomous demonstration asks for and was not seen: the sweep, two drives, two stops."""
        _, at_m, speed_mps, steer_deg, _, _ = self._seen()
        known = np.flatnonzero((speed_mps > 0.2) | (speed_mps < 0.02))
        changes = known[np.flatnonzero(np.diff(speed_mps[known] > 0.2, prepend=False))]
        begins, stops = changes[::2], changes[1::2]
        found = _swept_too_little(steer_deg[: begins[0]] if len(begins) else steer_deg, DEMO_SWEEP_DEG)
        if len(begins) and abs(straight_deg := steer_deg[begins[0]]) > 3.0:
            found.append(f"pulled away with the steering at {straight_deg:.1f} deg instead of straight")
        for number, (begin, stop) in enumerate(zip_longest(begins[:2], stops[:2]), 1):
            fast = np.flatnonzero(speed_mps[begin:stop] * KMH_PER_MPS >= DEMO_SPEED_KMH)
            if not len(fast):
                found.append(f"acceleration {number} did not reach {DEMO_SPEED_KMH:g} km/h")
            elif (took_m := at_m[begin + fast[0]] - at_m[begin]) > DEMO_ACCELERATE_M:
                found.append(f"acceleration {number} took {took_m:.1f} m to {DEMO_SPEED_KMH:g} km/h")
        if len(begins) != 2:
            found.append(f"{len(begins)} accelerations instead of 2")
        if len(stops):
            length, most = at_m[stops[0]] - at_m[begins[0]], DEMO_ACCELERATE_M + DEMO_STOP_M
            if length > most:
                found.append(f"the first stop came after {length:.1f} m, allowed are {most:g} m")
        return found


class _Criteria(Value, frozen=True):
    """The criteria by which one mission is judged."""

    referee: type[_Referee]
    ends_in: AsState
    timeout_s: float | None  # in AS_DRIVING; None: LAP_TIMEOUT_S a lap
    track: TrackKind | None = None  # on which it can be driven; None: on any
    laps: int = 1


_CRITERIA: Final[Mapping[Ami, _Criteria]] = MappingProxyType(
    {
        Ami.ACCELERATION: _Criteria(_AccelerationReferee, AsState.AS_FINISHED, 60.0, TrackKind.ACCELERATION),
        Ami.SKIDPAD: _Criteria(_SkidpadReferee, AsState.AS_FINISHED, 180.0, TrackKind.SKIDPAD, laps=4),
        Ami.AUTOCROSS: _Criteria(_CircuitReferee, AsState.AS_FINISHED, None, TrackKind.CIRCUIT),
        Ami.TRACKDRIVE: _Criteria(_CircuitReferee, AsState.AS_FINISHED, None, TrackKind.CIRCUIT, laps=10),
        Ami.STATIC_INSPECTION_A: _Criteria(_InspectionAReferee, AsState.AS_FINISHED, 90.0),
        Ami.STATIC_INSPECTION_B: _Criteria(_InspectionBReferee, AsState.EMERGENCY_BRAKE, 90.0),
        Ami.AUTONOMOUS_DEMO: _Criteria(_DemoReferee, AsState.EMERGENCY_BRAKE, 90.0),
    }
)


def check_track(track: Track, mission: Ami) -> str | None:
    """Return why a mission cannot be judged on a track; None when it can."""
    criteria = _CRITERIA.get(mission)
    if criteria is None:
        return f"{mission.label} is no mission"
    if criteria.track is not None and criteria.track is not track.kind:
        return (
            f"mission {mission.name.lower()} needs a track of kind {criteria.track.value} ({KIND_IS[criteria.track]}), "
            f"but {track.name} is of kind {track.kind.value}"
        )
    return None


# ---------------------------------------------------------------- the judge


class Judge:
    """Judges one run. `observe` wants a look every 10 ms or so; `verdict` may be asked at any time.

    Raises ValueError where the mission cannot be driven on the track.
    """

    def __init__(
        self,
        track: Track,
        mission: Ami,
        car: VehicleParameters,
        laps: int | None = None,
        start_timeout_s: float | None = 120.0,
        now_ns: int = 0,
        epoch_ns: int = 0,
    ) -> None:
        """`laps`: of a trackdrive, ten where None. `start_timeout_s`: until AS_DRIVING, None waits for ever.

        `epoch_ns` is the instant from which the verdict counts its times.
        """
        problem = check_track(track, mission)
        if problem is not None:
            raise ValueError(problem)
        self.mission = mission
        self._start_timeout_s = start_timeout_s
        self._car = car
        self._epoch_ns = epoch_ns
        self._begin_ns = now_ns
        self._criteria = _CRITERIA[mission]
        self.laps_wanted = laps if mission is Ami.TRACKDRIVE and laps is not None else self._criteria.laps
        self._referee = self._criteria.referee(track, car, self.laps_wanted)
        self._route = _Route(track) if track.centreline_m is not None else None
        self._surroundings = _Surroundings(track, car)
        self._states: list[tuple[AsState, int]] = []
        self._reasons: list[str] = []
        self._stay: tuple[float, float, int] | None = None  # where and since when the car must not move
        self.early_ns: int | None = None  # when it moved before or soon after AS_DRIVING began; none in EMERGENCY_BRAKE
        self._driving_ns: int | None = None
        self._over_ns: int | None = None  # left AS_DRIVING
        self._stood_ns: int | None = None
        self._moved_ns: int | None = None
        self._still_ns: int | None = None
        self._top_mps = 0.0
        self._worst_m = 0.0
        self._begin_m = 0.0
        self._distance_m = 0.0
        self._cause: ShutdownCause | None = None
        self._last_ns = now_ns
        self.done = False

    # ------------------------------------------------------------ what it sees

    def observe(self, truth: CarTruth, as_state: AsState, cause: ShutdownCause | None = None) -> None:
        """One look at the car. `cause` is the SHUTDOWN_CAUSE on its display."""
        if self.done:
            return
        now = truth.t_ns
        self._last_ns = now
        if not self._states or self._states[-1][0] is not as_state:
            self._enter(as_state, truth)
        if cause is not None and cause is not ShutdownCause.NO_SHUTDOWN:
            self._cause = cause
        self._watch_stay(truth, as_state)
        if self._driving_ns is not None:
            self._watch_drive(truth)
        self._watch_end(truth, as_state)

    def _enter(self, state: AsState, truth: CarTruth) -> None:
        now = truth.t_ns
        self._states.append((state, now))
        pose = truth.pose
        self._stay = None if state is AsState.EMERGENCY_BRAKE else (pose.x_m, pose.y_m, now)
        if state is AsState.AS_DRIVING and self._driving_ns is not None:
            self._blame("drove a second time without a new run")
        elif state is AsState.AS_DRIVING:
            self._driving_ns, self._begin_m = now, truth.distance_m
        elif self._driving_ns is not None and self._over_ns is None:
            self._over_ns = now

    def _watch_stay(self, truth: CarTruth, state: AsState) -> None:
        """Blame a car that moves where it must stay: before AS_DRIVING, in its first seconds, and after it."""
        if self._stay is None:
            return
        x_m, y_m, since_ns = self._stay
        since_s = (truth.t_ns - since_ns) / S
        if state is AsState.AS_DRIVING and truth.t_ns - since_ns >= LAUNCH_NS:
            self._stay = None
            return
        moved = math.hypot(truth.pose.x_m - x_m, truth.pose.y_m - y_m) > STILL_M
        if moved or (max(truth.wheel_rpm) > STANDING_RPM and since_s > 0.1):
            self._stay = None  # once is enough
            if self.early_ns is None and self._over_ns is None:
                self.early_ns = truth.t_ns
            if state is AsState.AS_DRIVING:
                self._blame(f"moved {since_s:.2f} s after entering AS_DRIVING, must wait {LAUNCH_NS / S:g} s")
            else:
                self._blame(f"moved in {state.label}")

    def _watch_drive(self, truth: CarTruth) -> None:
        pose = truth.pose
        lateral = self._route.follow(pose.x_m, pose.y_m) if self._route is not None else None
        self._referee.watch(truth, pose.ahead(self._car.nose_ahead_of_rear_axle_m), self._route)
        self._surroundings.look(pose, lateral)
        speed = truth.speed_mps
        if lateral is not None and speed > 0.1:
            self._worst_m = max(self._worst_m, abs(lateral))
        self._top_mps = max(self._top_mps, speed)
        self._distance_m = truth.distance_m - self._begin_m
        if speed > 0.1:
            self._moved_ns = self._moved_ns or truth.t_ns
            self._still_ns = truth.t_ns

    def _watch_end(self, truth: CarTruth, state: AsState) -> None:
        """End the run where it is over, has failed or takes too long."""
        now = truth.t_ns
        if self._driving_ns is None:
            if state is AsState.EMERGENCY_BRAKE:
                self._end("EMERGENCY_BRAKE before the run began")
            elif self._start_timeout_s is not None and now - self._begin_ns > self._start_timeout_s * S:
                self._end(f"did not start: no AS_DRIVING within {self._start_timeout_s:g} s")
            return
        if state is AsState.AS_DRIVING:
            most_s = self._criteria.timeout_s or LAP_TIMEOUT_S * self.laps_wanted
            if now - self._driving_ns > most_s * S:
                self._end(f"did not finish: still in AS_DRIVING after {most_s:g} s")
            return
        if state in (AsState.AS_FINISHED, AsState.EMERGENCY_BRAKE):
            # over once it has stood for a second: a car that ought to stand may still roll on
            standing = truth.speed_mps < 0.02 and max(truth.wheel_rpm) < STANDING_RPM
            self._stood_ns = (self._stood_ns or now) if standing else None
            overdue = now - (self._over_ns or now) > 30.0 * S
            if overdue:
                self._end(f"still moving 30 s after {state.label}")
            elif self._stood_ns is not None and now - self._stood_ns >= S:
                self._end(None)
        else:
            self._end(f"the run ended in {state.label}")

    def _end(self, why: str | None) -> None:
        if why is not None:
            self._blame(why)
        self.done = True

    def _blame(self, why: str) -> None:
        if why not in self._reasons:
            self._reasons.append(why)

    # ------------------------------------------------------------ what it reports

    @property
    def laps(self) -> int:
        return self._referee.laps

    @property
    def waiting(self) -> bool:
        """The car has not been in AS_DRIVING yet."""
        return self._driving_ns is None and not self.done

    @property
    def ends_in(self) -> AsState:
        """The state in which the mission ends where it is fulfilled."""
        return self._criteria.ends_in

    @property
    def hit_cones(self) -> list[int]:
        """The cones that the car has hit, by their index on the track."""
        return sorted(self._surroundings.hit)

    @property
    def left_course_m(self) -> list[tuple[float, float]]:
        """Return where the car left the track, in the world."""
        return self._surroundings.left_m

    @property
    def crossings_s(self) -> list[float]:
        """Return when the car crossed a line that begins or ends a lap, as the verdict counts time."""
        return [(t_ns - self._epoch_ns) / S for t_ns in self._referee.crossings_ns]

    def _reasons_now(self) -> list[str]:
        """Return the reasons to fail the run if it ended now."""
        found = list(self._reasons)
        if self._driving_ns is None:
            return found or ["never entered AS_DRIVING"]
        wanted = self.ends_in
        last = self._states[-1][0]
        if last is not wanted:
            by = f" ({self._cause.label})" if self._cause is not None and last is AsState.EMERGENCY_BRAKE else ""
            found.append(f"ended in {last.label}{by}, the mission ends in {wanted.label}")
        elif wanted is AsState.EMERGENCY_BRAKE and self._cause is not ShutdownCause.AI_COMPUTER_REQUEST:
            by = "an open shutdown circuit" if self._cause is None else self._cause.label
            found.append(f"the emergency brake came by {by}, not by the AI computer's request")
        found += self._referee.complaints()
        if times := len(self._surroundings.left_m):
            found.append(f"off course {'once' if times == 1 else f'{times} times'}")
        return found

    def verdict(self) -> JudgeVerdict:
        """Return the verdict, as if the run ended now."""
        reasons = self._reasons_now()
        if not self.done:
            reasons.append("the run is not over")
        moving_s = (self._still_ns - self._moved_ns) / S if self._still_ns and self._moved_ns else 0.0
        driving_end = self._over_ns or self._last_ns
        hit = len(self._surroundings.hit)
        return JudgeVerdict(
            mission=self.mission.name.lower(),
            result="fail" if reasons else "pass",
            reasons=tuple(reasons),
            as_states=tuple((state.label, (t - self._epoch_ns) / S) for state, t in self._states),
            laps=self._referee.laps,
            lap_times_s=tuple(round(t, 3) for t in self._referee.lap_times_s),
            cones_hit=hit,
            penalty_s=CONE_PENALTY_S * hit,
            off_course=len(self.left_course_m),
            max_lateral_error_m=round(self._worst_m, 3),
            mean_speed_mps=round(self._distance_m / moving_s, 3) if moving_s > 0.0 else 0.0,
            top_speed_mps=round(self._top_mps, 3),
            distance_m=round(self._distance_m, 2),
            driving_time_s=round((driving_end - (self._driving_ns or driving_end)) / S, 3),
            stop_distance_m=None if (d := self._referee.stop_distance_m) is None else round(d, 2),
            shutdown_cause=None if self._cause is None else self._cause.label,
            finished=self.done,
        )
