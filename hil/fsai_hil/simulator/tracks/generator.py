"""Circuits by the rulebook, drawn from a seed: straights, turns, hairpins, chicanes and slaloms, closed to a lap.

Each element begins with a straight. Where a lap of them ends is linear in the lengths of the straights, so those are
what closes it: the lengths nearest to the ones drawn. What breaks a rule is thrown away and drawn again.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np

from fsai_hil.simulator.tracks.built_in import BEND_APART_M, circuit_from
from fsai_hil.simulator.tracks.layout import Track, closest_m
from fsai_vcu.core.arrays import Floats
from fsai_vcu.interface.values import Value

STRAIGHT_MAX_M: Final = 80.0
TURN_DIAMETER_MAX_M: Final = 50.0  # outside, as all diameters of the rules
LENGTH_M: Final = (200.0, 500.0)
START_STRAIGHT_M: Final = 22.0
BETWEEN_LANES_M: Final = 2.0  # at least, from border to border of lanes that run beside each other
CONES_APART_M: Final = 4.0  # the rules' 5 m also where the gate's cones stand between
STEP_M: Final = 0.25

Arc = tuple[float, float]  # its length, m, and its curvature, 1/m, left positive


class Style(Value, frozen=True):
    """The ranges from which a circuit is drawn."""

    lane_m: tuple[float, float]
    hairpin_m: tuple[float, float]  # outside diameter; the rules' least is 9 m
    shares: tuple[int, ...]  # of KINDS; none of those that are left out
    island_m: float = BETWEEN_LANES_M  # at least, from border to border inside a hairpin
    bend_apart_m: tuple[float, float] | None = None  # from cone to cone in bends, drawn once; None: as they bend


STYLES: Final[Mapping[str, Style]] = MappingProxyType(
    {
        "mixed": Style((3.0, 5.0), (12.0, 20.0), (5, 3, 1, 1)),
        "open": Style((3.0, 5.0), (16.0, 24.0), (5, 1, 1, 0)),
        # Straights on both sides of an island as wide as a lane, where nothing but colours tells it from one.
        "islands": Style((3.0, 4.0), (9.5, 14.0), (1, 4, 0, 0)),
        "tight": Style((3.0, 3.5), (9.0, 12.0), (2, 3, 1, 1)),  # tighter than the car can turn with 21 deg of steering
        # Inside radii of 1.4 m (9 m outside is 1.5 m with the narrowest lane) to 4 m. The rules ask for cones closer
        # together in bends, but do not say by how much.
        "sharp": Style((3.0, 3.5), (8.8, 14.0), (0, 2, 0, 0, 4, 2), 2.8, (1.5, 5.0)),
    }
)


def generated_circuit(seed: int, style: str = "mixed") -> Track:
    """A circuit that keeps the rules, always the same for a seed and a style."""
    draw = random.Random(seed)
    name = f"generated-{seed}" + ("" if style == "mixed" else f"-{style}")
    kind = STYLES[style]
    while True:
        lane_m = draw.uniform(*kind.lane_m)
        bend_apart_m = BEND_APART_M if kind.bend_apart_m is None else draw.uniform(*kind.bend_apart_m)
        elements = _elements(draw, kind, lane_m)
        closed = _closed(draw, elements)
        if closed is None:
            continue
        middle, straight_m = closed
        length_m = STEP_M * len(middle)
        if LENGTH_M[0] <= length_m <= LENGTH_M[1] and closest_m(middle, 12.0) >= lane_m + BETWEEN_LANES_M:
            if draw.random() < 0.5:
                middle[:, 1] *= -1.0  # the other way round
            return circuit_from(name, middle, straight_m * 0.55, lane_m, CONES_APART_M, bend_apart_m)


def _elements(draw: random.Random, style: Style, lane_m: float) -> list[list[Arc]]:
    """Draw what is between the straights; the last one completes the turn of the lap, where it can."""
    tightest_m = max(style.hairpin_m[0], 2.0 * lane_m + style.island_m)
    elements: list[list[Arc]] = []
    for _ in range(draw.randint(4, 8)):
        kind = draw.choices(KINDS[: len(style.shares)], style.shares)[0]
        diameter_m = draw.uniform(tightest_m, max(style.hairpin_m[1], tightest_m)) - lane_m
        side = 1.0 if draw.random() < 0.62 else -1.0
        elements.append([(length, side * bend) for length, bend in kind(draw, diameter_m / 2.0, lane_m)])
    left = 2.0 * math.pi - sum(length * bend for element in elements for length, bend in element)
    radius = draw.uniform((tightest_m - lane_m) / 2.0, 16.0)
    return [*elements, [(radius * abs(left), math.copysign(1.0 / radius, left))]]


def _turn(draw: random.Random, least_m: float, lane_m: float) -> list[Arc]:
    radius = draw.uniform(least_m, (TURN_DIAMETER_MAX_M - lane_m) / 2.0)
    return [(radius * math.radians(draw.uniform(40.0, 130.0)), 1.0 / radius)]


def _hairpin(draw: random.Random, radius_m: float, lane_m: float) -> list[Arc]:
    return [(radius_m * math.pi, 1.0 / radius_m)]


def _chicane(draw: random.Random, least_m: float, lane_m: float) -> list[Arc]:
    radius, angle = least_m + draw.uniform(2.0, 6.0), math.radians(draw.uniform(25.0, 50.0))
    return [(radius * angle, 1.0 / radius), (radius * angle, -1.0 / radius)]


def _slalom(draw: random.Random, least_m: float, lane_m: float) -> list[Arc]:
    """Round cones that would stand 7.5 to 12 m apart in a line."""
    angle, apart_m = math.radians(draw.uniform(22.0, 35.0)), draw.uniform(7.5, 12.0)
    radius = apart_m / 2.0 / math.sin(angle)
    swings = draw.randint(2, 4)
    arcs = [(radius * 2.0 * angle, (-1.0) ** i / radius) for i in range(swings + 1)]
    arcs[0], arcs[-1] = ((length / 2.0, bend) for length, bend in (arcs[0], arcs[-1]))
    return arcs


def _corner(draw: random.Random, radius_m: float, lane_m: float) -> list[Arc]:
    return [(radius_m * math.radians(draw.uniform(50.0, 140.0)), 1.0 / radius_m)]


def _chicane_into_hairpin(draw: random.Random, radius_m: float, lane_m: float) -> list[Arc]:
    """A chicane to either side, and the hairpin without a straight between."""
    angle, side = math.radians(draw.uniform(25.0, 60.0)), draw.choice((-1.0, 1.0))
    chicane = [(radius_m * angle, side / radius_m), (radius_m * angle, -side / radius_m)]
    return [*chicane, *_hairpin(draw, radius_m, lane_m)]


KINDS: Final = (_turn, _hairpin, _chicane, _slalom, _corner, _chicane_into_hairpin)


def _closed(draw: random.Random, elements: Sequence[Sequence[Arc]]) -> tuple[Floats, float] | None:
    """The middle of the lane and the length of its first straight, or None where no straights close the lap."""
    from scipy.optimize import lsq_linear  # type: ignore[import-untyped]  # slow to import

    last_turn = sum(abs(length * bend) for length, bend in elements[-1])
    if not math.radians(40.0) <= last_turn <= math.pi:
        return None
    heading, moved, along = 0.0, np.zeros(2), []
    for element in elements:
        cos, sin = math.cos(heading), math.sin(heading)
        along.append((cos, sin))
        moved += np.array([[cos, -sin], [sin, cos]]) @ line_of(element)[-1]
        heading += sum(length * bend for length, bend in element)
    count = len(elements)
    drawn = [draw.uniform(START_STRAIGHT_M, 60.0), *(draw.uniform(2.0, 45.0) for _ in range(count - 1))]
    least = [START_STRAIGHT_M] + [1.0] * (count - 1)
    directions = np.array(along).T
    straights = lsq_linear(
        np.vstack([1e3 * directions, np.eye(count)]),
        np.concatenate([-1e3 * moved, drawn]),
        (least, [STRAIGHT_MAX_M] * count),
    ).x
    if math.hypot(*(directions @ straights + moved)) > 0.05:
        return None
    line = line_of(
        [arc for straight, element in zip(straights, elements, strict=True) for arc in ((straight, 0.0), *element)]
    )
    open_m = line[-1] - line[0]
    return line[:-1] - np.linspace(0.0, 1.0, len(line) - 1, endpoint=False)[:, None] * open_m, float(straights[0])


def line_of(arcs: Sequence[Arc], step_m: float = STEP_M) -> Floats:
    """(N, 2) points along arcs about every `step_m`, from the origin along x."""
    counts = [max(1, round(length / step_m)) for length, _ in arcs]
    step = np.repeat([length / count for (length, _), count in zip(arcs, counts, strict=True)], counts)
    turn = step * np.repeat([bend for _, bend in arcs], counts)
    heading = np.cumsum(turn) - turn / 2.0
    chord = (step * np.sinc(turn / (2.0 * math.pi)))[:, None]
    steps = chord * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
