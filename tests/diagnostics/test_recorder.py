"""The recorder's files on the disk, whatever happens to disk, folder or power."""

from __future__ import annotations

import errno
import io
import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mcap.reader import NonSeekingReader, make_reader

from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.export.mcap_file import RosMessage, RosTopic
from fsai_vcu.diagnostics.log.reader import read_log
from fsai_vcu.diagnostics.recorder.recording import AGAIN_NS, Recording
from fsai_vcu.diagnostics.recorder.repair import repair_mcap, repair_text
from fsai_vcu.diagnostics.recorder.segments import Bounds, SegmentFolder
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import S

BEGAN_NS = 1_700_000_000 * S
LINE_BYTES = len("(1700000000.000000) can0 523#640064006400\n")


@pytest.fixture(autouse=True)
def synced(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the files that were synced to the disk for good. Disks that really do so are slow."""
    sizes: list[int] = []
    monkeypatch.setattr(os, "fdatasync", lambda descriptor: sizes.append(os.fstat(descriptor).st_size))
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    return sizes


def received(count: int, first: int = 0) -> list[tuple[Frame, int]]:
    """Frames of 0x523, ten milliseconds apart, each with its own number in it."""
    return [
        (Frame(0x523, number.to_bytes(2, "little") + b"\x64\0\x64\0"), BEGAN_NS + number * S // 100)
        for number in range(first, first + count)
    ]


def numbers(*logs: Path) -> list[int]:
    """The frames in logs, every one of which is whole."""
    found = []
    for path in logs:
        frames, problems = read_log(path)
        assert not problems, problems.texts
        found += [frame.data[0] | frame.data[1] << 8 for frame in frames]
    return found


class Rig:
    """A recording in a folder, its clocks and its reports."""

    def __init__(self, folder: Path, bounds: Bounds | None = None, *, mcap: bool = False) -> None:
        self.reports: list[str] = []
        self.now_ns = 0
        self.path = folder
        self.place = SegmentFolder(folder, "can0", bounds or Bounds())
        self.recording = Recording(
            self.place,
            "can0",
            {"revision": "2026"},
            self.reports.append,
            decoder=Decoder(load_databases()) if mcap else None,
            wall_ns=lambda: BEGAN_NS + self.now_ns,
            now_ns=0,
        )

    def turn(self, frames: list[tuple[Frame, int]], after_ns: int = S // 2) -> None:
        self.now_ns += after_ns
        self.recording.take(frames)
        self.recording.turn(self.now_ns)

    def close(self) -> None:
        self.recording.close(self.now_ns)

    def logs(self) -> list[Path]:
        return sorted(self.path.glob("*.log"))

    def bytes(self) -> int:
        return sum(path.stat().st_size for path in self.path.iterdir())


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path / "run")


def recorded(folder: Path, first: int = 0, **how: Any) -> Rig:
    """A recording of ten frames, in a segment of its own, that has ended."""
    rig = Rig(folder, **how)
    rig.turn(received(10, first))
    rig.close()
    return rig


def count_of(mcap: Path) -> int:
    with mcap.open("rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages())


# ---------------------------------------------------------------- segments


def test_after_each_turn_every_frame_is_on_the_disk(rig: Rig, synced: list[int]) -> None:
    rig.turn(received(30))
    assert numbers(*rig.logs()) == list(range(30))
    assert synced == [30 * LINE_BYTES]
    rig.turn(received(30, 30))
    assert numbers(*rig.logs()) == list(range(60))
    assert [path.name for path in rig.logs()] == ["can0-000001.log"]


def test_segments_turn_at_size_or_time_without_a_lost_frame(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "run", Bounds(segment_bytes=10 * LINE_BYTES, segment_ns=60 * S))
    for turn in range(5):
        rig.turn(received(10, 10 * turn))
    assert len(rig.logs()) == 5
    rig.turn(received(1, 50), after_ns=61 * S)
    rig.turn(received(1, 51), after_ns=61 * S)
    rig.close()
    assert len(rig.logs()) == 7
    assert numbers(*rig.logs()) == list(range(52))


def test_the_oldest_segments_are_deleted_to_keep_the_bound(tmp_path: Path) -> None:
    bounds = Bounds(segment_bytes=1 << 20, total_bytes=40_000)
    rig = Rig(tmp_path / "run", bounds, mcap=True)
    most = 0
    for turn in range(100):
        rig.turn(received(50, 50 * turn))
        most = max(most, rig.bytes())
    rig.close()
    assert 20_000 < most <= 40_000 and rig.bytes() <= 40_000
    kept = numbers(*rig.logs())
    assert kept == list(range(kept[0], 5_000)), "there is a hole in what is kept"
    stems = {path.stem for path in rig.logs()}
    assert {path.stem for path in rig.path.iterdir() if not path.name.startswith(".")} == stems


def test_what_must_stay_free_on_the_disk_stays_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path / "run", Bounds(segment_bytes=10 * LINE_BYTES, keep_free_bytes=1 << 20))
    disk = 2 << 20

    def usage(_: object) -> Any:
        return SimpleNamespace(free=disk - rig.bytes())

    monkeypatch.setattr(shutil, "disk_usage", usage)
    for turn in range(10):
        rig.turn(received(10, 10 * turn))
    assert len(rig.logs()) == 10
    disk = (1 << 20) + 2000  # somebody else needs the room
    rig.turn(received(10, 100))
    assert disk - rig.bytes() >= 1 << 20
    assert not rig.recording.in_trouble and numbers(rig.logs()[-1]) == list(range(100, 110))
    disk = 1 << 20
    rig.turn(received(10, 110))
    assert rig.recording.in_trouble
    assert len(rig.reports) == 1
    assert rig.reports[0].endswith("free on the disk, but 1 MB must stay free; trying again every second")
    disk = 2 << 20
    rig.turn([], after_ns=AGAIN_NS)
    assert rig.reports[-1] == f"writing again in {rig.path}"
    assert numbers(rig.logs()[-1])[-1] == 119


def test_a_second_recorder_of_the_same_bus_is_refused(rig: Rig) -> None:
    with pytest.raises(UserError, match=r"another program records 'can0' in .*run already"):
        SegmentFolder(rig.path, "can0", Bounds())
    assert SegmentFolder(rig.path, "can1", Bounds()).number == 0
    rig.close()
    SegmentFolder(rig.path, "can0", Bounds()).close()


def test_each_segment_has_what_was_in_force_beside_it(rig: Rig) -> None:
    rig.turn(received(10))
    begun = json.loads((rig.path / "can0-000001.json").read_text())
    assert (begun["revision"], begun["ended"], begun["frames"]) == ("2026", None, None)
    rig.close()
    ended = json.loads((rig.path / "can0-000001.json").read_text())
    assert (ended["began"], ended["ended"]) == ("2023-11-14T22:13:20.000+00:00", "2023-11-14T22:13:20.500+00:00")
    assert ended["frames"] == 10


# ---------------------------------------------------------------- a disk that does not take it


class Disk:
    """Writes fail while there is an `error`, after the first bytes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.error: int | None = None
        self._pwrite = os.pwrite
        monkeypatch.setattr(os, "pwrite", self._write)

    def _write(self, descriptor: int, data: Any, at: int) -> int:
        if self.error is None:
            return self._pwrite(descriptor, data, at)
        if len(data) > 5:
            return self._pwrite(descriptor, data[:5], at)
        raise OSError(self.error, os.strerror(self.error))


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


def test_a_full_disk_is_reported_once_and_leaves_no_hole(tmp_path: Path, disk: Disk) -> None:
    rig = Rig(tmp_path / "run", mcap=True)
    rig.turn(received(10))
    disk.error = errno.ENOSPC
    for turn in range(1, 11):
        rig.turn(received(10, 10 * turn), after_ns=AGAIN_NS)
        assert numbers(*rig.logs()) == list(range(10)), "half a line is in the log"
    assert rig.reports == [f"cannot write in {rig.path}: No space left on device; trying again every second"]
    disk.error = None
    rig.turn(received(10, 110), after_ns=AGAIN_NS)
    assert rig.reports[1:] == [f"writing again in {rig.path}"]
    rig.close()
    assert numbers(*rig.logs()) == list(range(120))
    assert count_of(rig.path / "can0-000001.mcap") == 120
    assert rig.recording.lost == 0


def test_frames_lost_while_the_disk_is_full_are_counted(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsai_vcu.diagnostics.recorder.recording._MOST_WAITING", 100)
    rig = Rig(tmp_path / "run")
    disk.error = errno.ENOSPC
    for turn in range(21):
        rig.turn(received(10, 10 * turn), after_ns=AGAIN_NS)
    disk.error = None
    rig.turn([], after_ns=AGAIN_NS)
    kept = numbers(*rig.logs())
    assert rig.recording.lost == 210 - len(kept) > 0
    assert kept[-1] == 209, "the newest are the last to go"
    assert rig.reports[-1] == f"writing again in {rig.path}; {rig.recording.lost} frames were lost"


def test_frames_that_a_full_disk_never_took_are_lost(rig: Rig, disk: Disk) -> None:
    rig.turn(received(10))
    disk.error = errno.ENOSPC
    rig.turn(received(20, 10))
    rig.turn(received(5, 30))
    rig.close()
    assert numbers(*rig.logs()) == list(range(10))
    assert (rig.recording.taken, rig.recording.lost) == (10, 25)


def test_a_broken_disk_is_followed_by_a_new_segment(rig: Rig, disk: Disk) -> None:
    rig.turn(received(10))
    disk.error = errno.EIO
    rig.turn(received(10, 10))
    disk.error = None
    rig.turn(received(10, 20), after_ns=AGAIN_NS)
    assert [path.name for path in rig.logs()] == ["can0-000001.log", "can0-000002.log"]
    assert numbers(*rig.logs()) == [*range(10), *range(20, 30)]
    assert (rig.recording.taken, rig.recording.lost) == (20, 10)


def test_a_deleted_segment_is_followed_by_another(rig: Rig) -> None:
    rig.turn(received(10))
    rig.logs()[0].unlink()
    rig.turn(received(10, 10))
    assert rig.reports == [f"{rig.path / 'can0-000001.log'} has been deleted; going on in a new one"]
    assert numbers(*rig.logs()) == list(range(10, 20))


# ---------------------------------------------------------------- what others put into the folder


def test_links_in_the_folder_lead_the_recorder_to_no_other_file(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    words = {name: f"{name} without a line's end".encode() for name in ("lock", "torn", "sidecar", "mcap", "hard")}
    for name, content in words.items():
        (tmp_path / name).write_bytes(content)
    (folder / ".can0.lock").symlink_to("../lock")
    (folder / "can0-000004.mcap").hardlink_to(tmp_path / "hard")
    (folder / "can0-000005.log").symlink_to("../torn")
    (folder / "can0-000005.mcap").symlink_to("../mcap")
    for name in ("can0-000006.json", "can0-000006.json.new", "can0-000007.log"):
        (folder / name).symlink_to("../sidecar")
    rig = recorded(folder, mcap=True)
    assert {name: (tmp_path / name).read_bytes() for name in words} == words
    assert numbers(folder / "can0-000008.log") == list(range(10))
    assert rig.reports == [
        f"{folder / 'can0-000007.log'} is left as it is: it is a link, not a file",
        f"{folder / 'can0-000004.mcap'} is left as it is: it has another name elsewhere (a hard link)",
        f"{folder / 'can0-000005.mcap'} is left as it is: it is a link, not a file",
    ]


@pytest.mark.parametrize(
    "make", [lambda path: path.symlink_to("../victim"), lambda path: (path / "kept").mkdir(parents=True)]
)
def test_what_is_in_the_place_of_a_sidecar_is_replaced(make: Callable[[Path], None], rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("three")
    for name in ("can0-000001.json.new", "can0-000001.json"):
        (rig.path / name).unlink(missing_ok=True)
        make(rig.path / name)
    rig.turn(received(10))
    rig.close()
    assert (tmp_path / "victim").read_text() == "three"
    assert json.loads((rig.path / "can0-000001.json").read_text())["frames"] == 10
    assert len(list(rig.path.glob("*/kept"))) in (0, 2)


@pytest.mark.parametrize(
    "name", [".can0.lock", "can0-000001.log", "can0-000001.json", "can0-000001.json.new", "can0-000001.mcap"]
)
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_pipe_or_a_folder_is_passed_over_where_a_file_was(
    name: str, make: Callable[[Path], None], tmp_path: Path
) -> None:
    (tmp_path / "run").mkdir()
    make(tmp_path / "run" / name)
    rig = Rig(tmp_path / "run", Bounds(segment_bytes=10 * LINE_BYTES, total_bytes=30 * LINE_BYTES), mcap=False)
    for turn in range(10):
        rig.turn(received(10, 10 * turn))
    assert not rig.recording.in_trouble
    assert numbers(rig.logs()[-1]) == list(range(90, 100))


def test_a_file_with_holes_takes_no_room_from_the_recording(tmp_path: Path) -> None:
    bounds = Bounds(segment_bytes=1000 * LINE_BYTES, total_bytes=4000 * LINE_BYTES)
    recorded(tmp_path / "run", bounds=bounds)
    with (tmp_path / "run" / "can0-000002.log").open("wb") as file:
        file.truncate(10 << 30)
    logs = recorded(tmp_path / "run", 10, bounds=bounds).logs()
    assert numbers(logs[0]) == list(range(10)) and numbers(logs[-1]) == list(range(10, 20))


def test_a_number_in_other_digits_is_no_segment(tmp_path: Path) -> None:
    rig = recorded(tmp_path / "run")
    (tmp_path / "run" / "can0-٠٠٠٩٠٥.log").write_bytes(bytes(2 << 20))
    assert recorded(tmp_path / "run", 10, bounds=Bounds(total_bytes=1 << 20)).place.number == 2
    assert numbers(*(rig.place.file(".log", number) for number in (1, 2))) == list(range(20))


@pytest.mark.parametrize("there", [[], [999_999], [999_998], [1, 999_999], [21, 22, 999_999]])
def test_each_restart_begins_a_segment_whatever_numbers_exist(there: list[int], tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    for number in there:
        (tmp_path / "run" / f"can0-{number:06d}.log").touch()
    for run in range(4):
        rig = recorded(tmp_path / "run", 10 * run)
    oldest_first = rig.place.all_files(".log")
    assert oldest_first[-1] == rig.place.file(".log")
    written = [path for path in oldest_first if path.stat().st_size]
    assert len(written) == 4 and numbers(*written) == list(range(40))


# ---------------------------------------------------------------- a power cut


def test_a_torn_segment_is_made_whole_on_resuming(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "run", mcap=True)
    rig.turn(received(10))
    log = rig.logs()[0]
    rig.place.close()
    whole = log.read_bytes()
    log.write_bytes(whole + whole[:LINE_BYTES].replace(b"523#", b"523#FF")[:30] + bytes(4096))
    again = Rig(tmp_path / "run", mcap=True)
    assert again.reports == [
        f"{log} was cut off in its last line: 4126 bytes removed",
        f"{log.with_suffix('.mcap')} had no end; an end was added",
    ]
    assert numbers(log) == list(range(10))


@pytest.mark.parametrize("tail", [b"", b"\0" * 10, b"(17000000", b"(1700000000.000000) can0 523#64006400"])
def test_only_what_is_no_whole_line_is_taken_away(tail: bytes, tmp_path: Path) -> None:
    path, whole = tmp_path / "run.log", b"(1.000000) can0 523#640064006400\n" * 5000
    path.write_bytes(whole + tail)
    assert repair_text(path) == len(tail)
    assert path.read_bytes() == whole
    assert repair_text(path) == 0


def recorded_mcap(folder: Path) -> bytes:
    """Ten turns of ten frames; the bytes of the MCAP."""
    rig = Rig(folder, mcap=True)
    for turn in range(10):
        frames = received(10, 10 * turn)
        if turn >= 5:
            frames += [(Frame(0x520, bytes(8)), frames[-1][1])]
        rig.turn(frames)
    return (folder / "can0-000001.mcap").read_bytes()


def streamed(data: bytes) -> list[int]:
    """Log times that a streaming reader gets out of what there is of an MCAP."""
    times = []
    try:
        for _, _, message in NonSeekingReader(io.BytesIO(data)).iter_messages(log_time_order=False):
            times.append(message.log_time)
    except Exception as error:  # how it ends is its own affair: what it read before counts
        assert not isinstance(error, AssertionError)
    return times


def test_a_cut_mcap_is_repaired_and_loses_at_most_one_turn(tmp_path: Path) -> None:
    data = recorded_mcap(tmp_path / "run")
    path = tmp_path / "cut.mcap"
    chance = random.Random(1)
    before = 0
    for length in sorted({0, 5, 8, 20, len(data) - 1, len(data), *chance.sample(range(len(data)), 50)}):
        path.write_bytes(data[:length])
        expected = streamed(data[:length])
        assert repair_mcap(path) is not None
        count = count_of(path)
        with path.open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            steer = list(reader.iter_messages(topics=["/can0/VCU2AI_Steer"]))
        assert summary is not None and summary.statistics is not None
        assert count == len(expected) == summary.statistics.message_count >= before
        assert len(steer) == sum(
            summary.statistics.channel_message_counts.get(c.id, 0)
            for c in summary.channels.values()
            if c.topic == "/can0/VCU2AI_Steer"
        )
        before = count
        assert repair_mcap(path) is None, "it is whole now"
    assert before == 105
    assert len(streamed(data[:-40])) >= 94, "more than the last turn is lost"
    path.write_bytes(data[:-1200] + bytes(1200))
    assert repair_mcap(path) is not None
    assert 80 <= count_of(path) < 105, "garbage in the place of the last chunk"


# ---------------------------------------------------------------- the MCAP


def test_the_mcap_is_a_ros_2_bag_with_signals_and_configuration(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    rig = Rig(tmp_path / "run", mcap=True)
    topic = RosTopic("/spoken", "std_msgs/msg/String", "string data\n")
    rig.recording.take_messages([RosMessage(topic, b"\0\1\0\0\3\0\0\0Go\0", BEGAN_NS + 5, BEGAN_NS + 4)])
    rig.turn(received(10))
    rig.close()
    path = rig.path / "can0-000001.mcap"
    with AnyReader([path]) as bag:
        assert {c.topic: c.msgcount for c in bag.connections} == {"/can0/VCU2AI_Steer": 10, "/spoken": 1}
        said: dict[str, list[Any]] = {"/can0/VCU2AI_Steer": [], "/spoken": []}
        for connection, _, data in bag.messages():
            said[connection.topic].append(bag.deserialize(data, connection.msgtype))
    assert [message.data for message in said["/spoken"]] == ["Go"]
    assert [message.angle for message in said["/can0/VCU2AI_Steer"]] == [n * 0.1 for n in range(10)]
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        (metadata,) = list(reader.iter_metadata())
        assert metadata.metadata["revision"] == "2026"


@pytest.mark.parametrize("error", [True, False], ids=["error", "extended"])
def test_unknown_frames_are_in_the_log_and_not_in_the_mcap(tmp_path: Path, error: bool) -> None:
    rig = Rig(tmp_path / "run", mcap=True)
    frame = Frame(0x40, bytes(8), extended=not error, error=error)
    rig.turn([(frame, BEGAN_NS), *received(1)])
    rig.close()
    frames, problems = read_log(rig.logs()[0])
    assert not problems and [f.error for f in frames] == [error, False]
    assert count_of(rig.path / "can0-000001.mcap") == 1
