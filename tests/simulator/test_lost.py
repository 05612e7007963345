"""A car that does not know where the lane is: it stops in it, whatever the sensor, and says so."""

from __future__ import annotations

import pytest

from fsai_hil.evidence.hard_sensing import DriveEnd, HardDrive, Trouble, drawn
from fsai_hil.simulator.tracks import generated_circuit, load_track
from fsai_vcu.core.driving import LOST
from fsai_vcu.interface.enums import Ami


@pytest.mark.parametrize(
    ("mission", "track", "trouble"),
    [
        (Ami.AUTOCROSS, "generated-15", Trouble(6.0, 90.0, 4.0, colours=False, jump_m=10.0)),
        (Ami.SKIDPAD, "skidpad", Trouble(12.0, 60.0, 4.0, blind_s=8.0)),
    ],
    ids=lambda value: value.name.lower() if isinstance(value, Ami) else "",
)
def test_a_lost_car_stops_in_its_lane_and_says_why(mission: Ami, track: str, trouble: Trouble) -> None:
    drive = HardDrive(mission, load_track(track), trouble, seed=6)
    assert drive.ending is DriveEnd.STOPPED
    assert all(note.startswith(LOST) and len(note) > len(LOST) for note in drive.notes)
    assert any(words.startswith(f"the controller reports: {LOST}") for words in drive.told), drive.told


@pytest.mark.long
@pytest.mark.parametrize("seed", range(60))
@pytest.mark.parametrize("mission", [Ami.AUTOCROSS, Ami.SKIDPAD, Ami.ACCELERATION], ids=lambda ami: ami.name.lower())
def test_with_any_sensor_the_car_drives_or_stops_in_its_lane(mission: Ami, seed: int) -> None:
    track = generated_circuit(seed) if mission is Ami.AUTOCROSS else load_track(mission.name.lower())
    assert HardDrive(mission, track, drawn(seed), seed).ending is not DriveEnd.LEFT


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("colours", [True, False])
def test_an_ordinary_sensor_is_never_lost(seed: int, colours: bool) -> None:
    drive = HardDrive(Ami.AUTOCROSS, generated_circuit(seed), Trouble(colours=colours), seed)
    assert drive.ending is DriveEnd.DRIVEN and not drive.notes
