"""The cone sensor: field of view, range, noise, misses, ghosts, colours."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.sensing import ConeSensor, SensorSettings
from fsai_hil.simulator.tracks import Track, TrackKind, load_track
from fsai_vcu.core.driving import ConeColor

PERFECT = SensorSettings(noise_level=0.0)


def field_of(*cones: tuple[float, float, ConeColor]) -> Track:
    xy = np.array([(x, y) for x, y, _ in cones], dtype=np.float64).reshape(-1, 2)
    return Track("field", TrackKind.STATIC, xy, np.array([int(c) for *_, c in cones], dtype=np.int64))


def test_a_perfect_sensor_sees_exact_cones_in_the_vehicle_frame() -> None:
    track = field_of((10.0, 5.0, ConeColor.BLUE), (10.0, 2.0, ConeColor.YELLOW))
    seen = ConeSensor(track, PERFECT).see(Pose(8.0, -1.0, math.pi / 2.0), 77)  # looks north
    assert seen.t_ns == 77
    assert seen.xy_m == pytest.approx(np.array([[6.0, -2.0], [3.0, -2.0]]))
    assert list(seen.color) == [ConeColor.BLUE, ConeColor.YELLOW]
    assert list(seen.confidence) == [1.0, 1.0]


def test_cones_behind_beside_and_too_far_are_not_seen() -> None:
    s = replace(PERFECT, ahead_of_rear_axle_m=0.0)
    edge = math.radians(55.0)
    track = field_of(
        (-5.0, 0.0, ConeColor.BLUE),
        (14.1, 0.0, ConeColor.BLUE),
        (5.0 * math.cos(edge + 0.02), 5.0 * math.sin(edge + 0.02), ConeColor.BLUE),
        (5.0 * math.cos(edge - 0.02), 5.0 * math.sin(edge - 0.02), ConeColor.YELLOW),
        (13.9, 0.0, ConeColor.ORANGE),
        (0.3, 0.0, ConeColor.ORANGE),
    )
    assert list(ConeSensor(track, s).see(Pose(), 0).color) == [ConeColor.YELLOW, ConeColor.ORANGE]


def test_the_same_seed_sees_the_same_and_another_seed_does_not() -> None:
    track = load_track("small_oval")
    looks = [[ConeSensor(track, seed=seed).see(Pose(), t) for t in range(5)] for seed in (1, 1, 2)]
    assert all(np.array_equal(a.xy_m, b.xy_m) for a, b in zip(looks[0], looks[1], strict=True))
    assert not all(np.array_equal(a.xy_m, b.xy_m) for a, b in zip(looks[0], looks[2], strict=True))


def test_noise_grows_with_distance_and_with_its_level() -> None:
    quiet = SensorSettings(miss_near=0.0, miss_far=0.0, false_per_scan=0.0, unknown_far=0.0, confused_far=0.0)

    def spread(distance_m: float, level: float) -> float:
        sensor = ConeSensor(field_of((distance_m, 0.0, ConeColor.BLUE)), replace(quiet, noise_level=level), seed=4)
        return float(np.std([sensor.see(Pose(), 0).xy_m[0, 1] for _ in range(400)]))

    assert 1.5 * spread(3.0, 1.0) < spread(13.0, 1.0)
    assert spread(8.0, 3.0) == pytest.approx(3.0 * spread(8.0, 1.0), rel=0.15)


def test_cones_are_missed_more_often_far_away() -> None:
    def missed(distance_m: float) -> float:
        settings = SensorSettings(false_per_scan=0.0)
        sensor = ConeSensor(field_of((distance_m, 0.0, ConeColor.BLUE)), settings, seed=4)
        return sum(len(sensor.see(Pose(), 0).xy_m) == 0 for _ in range(1000)) / 1000

    assert 0.0 < missed(2.0) < 0.04
    assert 0.05 < missed(13.5) < 0.15


def test_ghosts_come_as_set_with_less_confidence_than_true_cones() -> None:
    sensor = ConeSensor(field_of(), SensorSettings(false_per_scan=0.5), seed=1)
    looks = [sensor.see(Pose(), 0) for _ in range(500)]
    assert sum(len(look.xy_m) for look in looks) / 500 == pytest.approx(0.5, rel=0.2)
    assert max(float(look.confidence.max(initial=0.0)) for look in looks) < 0.5
    true = ConeSensor(field_of((13.0, 0.0, ConeColor.BLUE)), SensorSettings(false_per_scan=0.0), seed=1)
    certain = [float(c) for _ in range(200) for c in true.see(Pose(), 0).confidence]
    assert min(certain) >= 0.5
    assert max(certain) <= 1.0


def test_far_colours_are_sometimes_unknown_and_seldom_wrong() -> None:
    sensor = ConeSensor(field_of((13.5, 0.0, ConeColor.BLUE)), SensorSettings(false_per_scan=0.0), seed=9)
    colors = [int(c) for _ in range(2000) for c in sensor.see(Pose(), 0).color]
    unknown = colors.count(ConeColor.UNKNOWN) / len(colors)
    wrong = sum(c not in (ConeColor.UNKNOWN, ConeColor.BLUE) for c in colors) / len(colors)
    assert 0.15 < unknown < 0.3
    assert 0.005 < wrong < 0.04


def test_a_track_without_cones_is_no_error() -> None:
    seen = ConeSensor(load_track("static"), PERFECT).see(Pose(), 3)
    assert seen.xy_m.shape == (0, 2)


def test_a_sensor_without_colours_sees_the_same_cones_unknown() -> None:
    track = load_track("small_oval")
    coloured, colourless = (ConeSensor(track, SensorSettings(colours=on), 3).see(Pose(), 0) for on in (True, False))
    assert np.array_equal(coloured.xy_m, colourless.xy_m) and coloured.color.any() and not colourless.color.any()


def test_a_mistaken_cone_has_the_other_colour_in_every_look() -> None:
    sensor = ConeSensor(
        field_of(*((5.0, 0.01 * one, ConeColor.BLUE) for one in range(200))),
        SensorSettings(
            mistaken=0.1, miss_near=0.0, miss_far=0.0, unknown_far=0.0, confused_far=0.0, false_per_scan=0.0
        ),
    )
    first, second = (sensor.see(Pose(), look).color for look in range(2))
    assert (first == second).all()
    assert 5 < np.count_nonzero(first == ConeColor.YELLOW) < 40
