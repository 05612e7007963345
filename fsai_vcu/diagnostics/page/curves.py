"""The drawings of a log: curves thinned out without losing a peak, lanes of states, the driven path; figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.record import Record, Series, Values
from fsai_vcu.diagnostics.explain.signals import Signal, label
from fsai_vcu.diagnostics.log.frames import Ints
from fsai_vcu.diagnostics.statistics.measure import BITRATE, LOAD_WINDOW_NS
from fsai_vcu.diagnostics.statistics.wire_bits import wire_bits
from fsai_vcu.interface.enums import AsState, MissionStatus
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import KMH_PER_MPS, MS, S

BUCKETS: Final = 1000  # a wide screen has not many more points than twice as many
BREAK_NS: Final = 250 * MS  # a value so old is not drawn on: a message that stopped must not look alive
LANE_SPANS: Final = 400
CURVES: Final = 7  # of any signals on one axis: as many as there are colours
BRIDGED_NS: Final = 250 * MS  # over a longer gap of 0x525 nothing is known of the way
PATH_POINTS: Final = 2000  # of the driven path
SPACING_M: Final = 0.25


@dataclass(frozen=True, slots=True)
class Curve:
    """One line of a plot. `quiet` lines are drawn thin: they are there for comparison. `tile`: whose trend it is on the
    board; a line that is not `drawn` is there for that alone."""

    name: str
    series: Series
    quiet: bool = False
    tile: str = ""
    drawn: bool = True


@dataclass(frozen=True, slots=True)
class Plot:
    """Several lines that share an axis. `digits`: decimals that mean something."""

    slug: str
    title: str
    unit: str
    digits: int
    curves: tuple[Curve, ...]

    def summary(self) -> str:
        """Summary of the plot in words, for people who do not see it."""
        parts = []
        for curve in self.curves:
            values = curve.series.values
            if not curve.drawn:
                continue
            parts.append(f"{curve.name} from {values.min():.{self.digits}f} to {values.max():.{self.digits}f}")
        return f"{self.title} in {self.unit} over time: {'; '.join(parts)}."


def _axles(*signals: Signal) -> tuple[tuple[Signal, str], ...]:
    return tuple(zip(signals, ("front asked", "front given", "rear asked", "rear given"), strict=True))


_TILES: Final = ("steering", "torque", "brake")


LONGITUDINAL: Final = Signal("AI2LOG_Dynamics2", "Accel_longitudinal_mps2")
LATERAL: Final = Signal("AI2LOG_Dynamics2", "Accel_lateral_mps2")
YAW_RATE: Final = Signal("AI2LOG_Dynamics2", "Yaw_rate_degps")
# slug, title, unit, digits, pairs of (signal, name)
_OF_SIGNALS: Final = (
    ("steering", "Steering", "deg", 1, ((sig.STEER, "asked"), (sig.ANGLE, "given"))),
    ("torque", "Axle torque", "Nm", 1, _axles(sig.TORQUE_F, sig.CAR_TORQUE[0], sig.TORQUE_R, sig.CAR_TORQUE[1])),
    ("brake", "Brake", "%", 1, _axles(sig.BRAKE_REQ_F, sig.BRAKE_F, sig.BRAKE_REQ_R, sig.BRAKE_R)),
    ("acceleration", "Acceleration", "m/s²", 1, ((LONGITUDINAL, "longitudinal"), (LATERAL, "lateral"))),
    ("yaw", "Yaw rate", "deg/s", 1, ((YAW_RATE, "to the left"),)),
)


def plots(record: Record) -> list[Plot]:
    """Every plot for which the log has something."""
    found = [Plot("speed", "Speed", "m/s", 2, _speeds(record))]
    for slug, title, unit, digits, signals in _OF_SIGNALS:
        tile = f"{slug} " if slug in _TILES else ""
        curves = [Curve(name, record.series(signal), tile=tile and tile + name) for signal, name in signals]
        pairs = [curves[at : at + 2] for at in range(0, len(curves), 2)]
        # An axle that nobody drives is not drawn; what is asked and never given is shown as the flat line that it is.
        moved = [any(curve.series.values.any() for curve in pair) for pair in pairs]
        moved[0] |= not any(moved)
        shown = zip(pairs, moved, strict=True)
        found.append(
            Plot(slug, title, unit, digits, tuple(replace(one, drawn=drawn) for pair, drawn in shown for one in pair))
        )
    found.append(Plot("handshake", "Handshake response", "ms", 2, _handshake(record)))
    found.append(Plot("load", "Bus load", "%", 1, (Curve("load over 100 ms", _load(record), tile="load"),)))
    kept = [replace(plot, curves=tuple(curve for curve in plot.curves if len(curve.series))) for plot in found]
    return [plot for plot in kept if any(curve.drawn for curve in plot.curves)]


def plots_of(groups: Mapping[str, Sequence[tuple[str, Series]]]) -> list[Plot]:
    """Plots of any signals, given by unit: a few to an axis."""
    found: list[Plot] = []
    for unit, group in groups.items():
        for at in range(0, len(group), CURVES):
            curves = (Curve(name, _finite(series)) for name, series in group[at : at + CURVES])
            known = tuple(curve for curve in curves if len(curve.series))
            whole = all((curve.series.values % 1 == 0).all() for curve in known)
            if known:
                found.append(Plot(f"signals{len(found)}", "Signals", unit or "raw", 0 if whole else 3, known))
    return found


def _finite(series: Series, factor: float = 1.0) -> Series:
    finite = np.isfinite(series.values)
    return Series(series.t_ns[finite], series.values[finite] * factor)


def _speeds(record: Record) -> tuple[Curve, ...]:
    """Return the curves of speed: the mean of the wheels, each wheel, and what other sources measured."""
    per_rpm = record.car.speed_of_wheel_rpm(1.0)
    wheels = [_finite(record.series(signal), per_rpm) for signal in sig.WHEELS]
    of_all = [wheel.values for wheel in wheels if len(wheel) == len(wheels[0])]
    mean = Series(wheels[0].t_ns, np.mean(of_all, axis=0))
    curves = [Curve("mean of the wheels", mean, tile="speed")]
    for wheel, name in zip(wheels, ("front left", "front right", "rear left", "rear right"), strict=True):
        curves.append(Curve(f"wheel {name}", wheel, quiet=True))
    for signal, name in (
        (Signal("GPS_CourseSpeed", "GPS_Speed"), "GPS"),
        (Signal("AI2VCU_Status", "VEH_SPEED_ACTUAL"), "AI's odometry (0x510)"),
    ):
        series = _finite(record.series(signal), 1 / KMH_PER_MPS)
        if series.values.any():
            curves.append(Curve(name, series, quiet=True))
    return tuple(curves)


def _handshake(record: Record) -> tuple[Curve, ...]:
    answers = record.answers
    waits = Series(answers.toggle_ns[answers.echoed], answers.waited_ns[answers.echoed] / MS)
    return (Curve("from toggle to echo", waits, tile="handshake"),)


def _load(record: Record) -> Series:
    """The share of the bus that was busy, in each window of 100 ms that has frames, or one beside it that has."""
    bits = wire_bits(record.frames)
    places = (record.frames.t_ns - record.begin_ns) // LOAD_WINDOW_NS
    last = int(places[-1])
    windows = np.unique(np.concatenate((places - 1, places, places + 1)))  # a log may jump by years
    busy = np.bincount(np.searchsorted(windows, places), weights=bits, minlength=len(windows))
    whole = (windows >= 0) & (windows < max(last, 1))  # the last window is cut off by the log's end
    middles = record.begin_ns + windows[whole] * LOAD_WINDOW_NS + LOAD_WINDOW_NS // 2
    per_window = BITRATE * LOAD_WINDOW_NS / 1e9
    return Series(middles, np.asarray(100.0 * busy[whole] / per_window, np.float64))


# ---------------------------------------------------------------- thinning out


def thinned(series: Series, begin_ns: int, end_ns: int, buckets: int = BUCKETS) -> tuple[Ints, Values]:
    """Return (times, values) with at most four points in each of `buckets` slices of the time.

    They are the first, the lowest, the highest and the last, so that no peak is lost. NaN where the message was
    missing.
    """
    t_ns, values = series.t_ns, series.values
    if not len(t_ns):
        return t_ns, values
    turns = np.ones(len(values), np.bool_)
    turns[1:-1] = (values[1:-1] != values[:-2]) | (values[1:-1] != values[2:])
    breaks = np.flatnonzero(np.diff(t_ns) > BREAK_NS)
    turns[breaks] = turns[breaks + 1] = True
    rows = np.flatnonzero(turns)
    if len(rows) > 4 * buckets:
        slices = (t_ns[rows] - begin_ns) * buckets // max(end_ns - begin_ns + 1, 1)
        ends = np.flatnonzero(np.diff(slices, append=buckets))
        starts = np.append(0, ends[:-1] + 1)
        # In each slice by value, the first of equals first
        lows, highs = (np.lexsort((sign * values[rows], slices))[starts] for sign in (1, -1))
        rows = np.unique(np.concatenate((rows[starts], rows[lows], rows[highs], rows[ends], breaks, breaks + 1)))
    t_out, v_out = t_ns[rows], values[rows]
    holes = np.flatnonzero(np.isin(rows, breaks)) + 1
    return np.insert(t_out, holes, t_out[holes - 1] + 1), np.insert(v_out, holes, np.nan)


def packed(curve: Curve, digits: int, zero_ns: int, begin_ns: int, end_ns: int) -> dict[str, Any]:
    """A curve for the page: times since `zero_ns` in steps of 0.1 ms, each from the one before; whole numbers."""
    t_ns, values = thinned(curve.series, begin_ns, end_ns)
    steps = np.diff((t_ns - zero_ns) // (MS // 10), prepend=0)
    scaled = np.round(values * 10**digits)
    numbers: list[int | None] = [None if np.isnan(value) else int(value) for value in scaled]
    found = {"name": curve.name, "quiet": curve.quiet, "tile": curve.tile, "drawn": curve.drawn}
    return {**found, "dt": steps.tolist(), "v": numbers}


# ---------------------------------------------------------------- lanes


def lanes(record: Record, zero_ns: int) -> list[dict[str, Any]]:
    """States over time: for each lane spans of [from s, to s, label, kind], since `zero_ns`. Kinds are colours: off,
    plain, bad; of an AS state its label."""
    found: list[dict[str, Any]] = []

    def add(name: str, spans: list[tuple[int, int, str, str]]) -> None:
        if spans:
            if many := spans[LANE_SPANS:]:
                spans = [*spans[:LANE_SPANS], (many[0][0], many[-1][1], f"{len(many)} more changes", many[-1][3])]
            shown = [
                [round((b - zero_ns) / 1e9, 4), round((e - zero_ns) / 1e9, 4), text, kind] for b, e, text, kind in spans
            ]
            found.append({"name": name, "spans": shown})

    def of(name: str, signal: Signal, kinds: Mapping[float, str], words: Callable[[float], str] | None = None) -> None:
        word = words or partial(label, signal)
        spans = record.series(signal).spans_within(BREAK_NS)
        add(name, [(s.begin_ns, s.end_ns, word(s.value), kinds.get(s.value, "plain")) for s in spans])

    off = {0.0: "off"}
    of("AS state", sig.AS_STATE, dict.fromkeys(range(16), "off") | {float(state): state.label for state in AsState})
    of("mission", sig.AMI, off)
    of("AI says", sig.MISSION_STATUS, {MissionStatus.NOT_SELECTED: "off"})
    of("direction", sig.DIRECTION, off)
    for signal, name in ((sig.AS_SWITCH, "ASMS"), (sig.TS_SWITCH, "TSMS"), (sig.GO, "Go")):
        of(name, signal, off, lambda value: "on" if value else "off")
    ebs = sig.EBS_STATE if len(record.series(sig.EBS_STATE)) else sig.STATUS_EBS
    if record.series(ebs).values.any():
        values = {span.value for span in record.series(ebs).spans}
        of("EBS", ebs, {v: "bad" for v in values if any(word in label(ebs, v) for word in ("TRIGGERED", "FAULT"))})
    bad: dict[str, list[tuple[int, int, str, str]]] = {}
    for signal in (sig.ESTOP, *sig.FAULTS, sig.SHUTDOWN_CAUSE):
        for span in record.series(signal).spans_within(BREAK_NS):
            text = f"SHUTDOWN_CAUSE {label(signal, span.value)}" if signal is sig.SHUTDOWN_CAUSE else signal.name
            if span.value:
                bad.setdefault(text, []).append((span.begin_ns, span.end_ns, text, "bad"))
    for text, spans in bad.items():
        add(text, spans)
    silent = [
        (gap.begin_ns, gap.over_ns, f"0x{can_id:03X}", "bad")
        for can_id in (*AI_IDS, *VCU_IDS[:-1])
        for gap in record.gaps(can_id, COMMS_LOST_NS)
    ]
    add("missing", sorted(silent))
    add("intruder", [(i.begin_ns, i.end_ns, Reason.INTRUDER.words, "bad") for i in record.second_senders])
    add("second car", [(i.begin_ns, i.end_ns, "two cars", "bad") for i in record.second_cars])
    add("bus errors", [(int(t), int(t), "error frame", "bad") for t in record.error_ns[:LANE_SPANS]])
    return found


# ---------------------------------------------------------------- the driven path


@dataclass(frozen=True)
class Way:
    """x_m, y_m, heading_rad [n] in a frame with its origin and x axis where the car began; speed_mps [n]; t_ns [n]."""

    t_ns: Ints
    x_m: Values
    y_m: Values
    heading_rad: Values
    speed_mps: Values

    @property
    def length_m(self) -> float:
        return float(np.hypot(np.diff(self.x_m), np.diff(self.y_m)).sum())


def way_of(record: Record) -> Way | None:
    """The driven path; None without wheel speeds."""
    rear = [record.series(signal) for signal in sig.WHEELS[2:]]
    if not all(len(series) for series in rear):
        return None
    car = record.car
    t_ns = rear[0].t_ns
    speed = car.speed_of_wheel_rpm(1.0) * (rear[0].values + rear[1].values) / 2.0
    steps_ns = np.diff(t_ns, prepend=t_ns[0])
    way_m = speed * np.where(steps_ns < BRIDGED_NS, steps_ns, 0) / S
    curvature = np.tan(np.radians(record.series(sig.ANGLE).sampled(t_ns))) / car.wheelbase_m
    heading = np.cumsum(way_m * curvature)
    return Way(t_ns, np.cumsum(way_m * np.cos(heading)), np.cumsum(way_m * np.sin(heading)), heading, speed)


def packed_way(way: Way | None, zero_ns: int) -> dict[str, list[int]]:
    """The path for the page, in equal steps of its length: times in 0.1 ms since `zero_ns`, cm, mrad."""
    if way is None:
        return {"t": [], "x": [], "y": [], "heading": []}
    along = np.append(0.0, np.cumsum(np.hypot(np.diff(way.x_m), np.diff(way.y_m))))
    steps = np.linspace(0.0, along[-1], min(PATH_POINTS, 2 + int(along[-1] / SPACING_M)))
    # The last row of each place: there a car that stood moves off.
    rows = np.append(0, np.searchsorted(along, steps, side="right") - 1)
    found = ((way.t_ns - zero_ns) / (MS / 10), 100 * way.x_m, 100 * way.y_m, 1000 * way.heading_rad)
    packed = [np.rint(column[rows]).astype(np.int64).tolist() for column in found]
    return dict(zip(("t", "x", "y", "heading"), packed, strict=True))


def figures(record: Record, way: Way | None) -> Iterator[tuple[str, str]]:
    """(name, text) of each figure of the run."""
    if way is not None:
        top = float(way.speed_mps.max())
        yield "top speed", f"{top:.1f} m/s ({top * KMH_PER_MPS:.0f} km/h)"
        yield "distance", f"{way.length_m:.0f} m, by the rear wheels"
    spent: dict[float, int] = {}
    for span in record.series(sig.AS_STATE).spans:
        spent[span.value] = spent.get(span.value, 0) + span.end_ns - span.begin_ns
    if spent:
        yield "time in each state", ", ".join(f"{label(sig.AS_STATE, v)} {ns / S:.1f} s" for v, ns in spent.items())
    missions = dict.fromkeys(label(sig.AMI, span.value) for span in record.series(sig.AMI).spans if span.value)
    if missions:
        yield "mission", ", ".join(missions)
