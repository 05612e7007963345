"""A run in a few figures, and the way it drove: dead reckoning by the rear wheels and the steering, in columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.actuation import sampled
from fsai_vcu.diagnostics.explain.record import Record, Signal, Values
from fsai_vcu.diagnostics.explain.signals import car_of, label
from fsai_vcu.diagnostics.log.frames import Ints
from fsai_vcu.interface.units import KMH_PER_MPS, MS, S

BRIDGED_NS: Final = 250 * MS  # over a longer gap of 0x525 nothing is known of the way
SHORT_M: Final = 1.0  # less is no way to be drawn
POINTS: Final = 600
SIDE: Final = 480.0
MARGIN: Final = 12.0


@dataclass(frozen=True)
class Way:
    """t_ns [n]; x_m, y_m [n] in a frame with its origin and x axis where the car began; speed_mps [n]."""

    t_ns: Ints
    x_m: Values
    y_m: Values
    speed_mps: Values

    @property
    def length_m(self) -> float:
        return float(np.hypot(np.diff(self.x_m), np.diff(self.y_m)).sum())


def way_of(record: Record) -> Way | None:
    """The way driven; None without wheel speeds."""
    rear = [record.series(Signal("VCU2AI_Speeds", f"{wheel}_WHEEL_SPEED")) for wheel in ("RL", "RR")]
    if not all(len(series) for series in rear):
        return None
    car = car_of(record)
    t_ns = rear[0].t_ns
    speed = car.speed_of_wheel_rpm(1.0) * (rear[0].values + rear[1].values) / 2.0
    steps_ns = np.diff(t_ns, prepend=t_ns[0])
    way_m = speed * np.where(steps_ns < BRIDGED_NS, steps_ns, 0) / S
    curvature = np.tan(np.radians(sampled(record.series(sig.ANGLE), t_ns))) / car.wheelbase_m
    heading = np.cumsum(way_m * curvature)
    return Way(t_ns, np.cumsum(way_m * np.cos(heading)), np.cumsum(way_m * np.sin(heading)), speed)


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


def drawing(way: Way | None) -> str:
    """The way as an SVG picture that takes the page's colours; empty where the car did not move."""
    if way is None or way.length_m < SHORT_M:
        return ""
    moved = np.concatenate(([True], np.hypot(np.diff(way.x_m), np.diff(way.y_m)) > 0.0))
    x, y = way.x_m[moved], -way.y_m[moved]  # SVG's y axis points down
    thin = np.unique(np.linspace(0, len(x) - 1, POINTS).astype(np.int64))
    scale = (SIDE - 2 * MARGIN) / max(float(np.ptp(x)), float(np.ptp(y)))
    points = np.stack([(x[thin] - x.min()) * scale + MARGIN, (y[thin] - y.min()) * scale + MARGIN], axis=1)
    width, height = (float(side) * scale + 2 * MARGIN for side in (np.ptp(x), np.ptp(y)))
    line = " ".join(f"{px:.1f},{py:.1f}" for px, py in points)
    (ax, ay), (bx, by) = points[0], points[-1]
    return (
        f'<svg class="way" viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="the way driven, from above:'
        f' {way.length_m:.0f} m"><polyline points="{line}"/><circle class="from" cx="{ax:.1f}" cy="{ay:.1f}" r="5"/>'
        f'<circle class="to" cx="{bx:.1f}" cy="{by:.1f}" r="5"/></svg>'
    )
