"""The load is what it says: busy processors, a busy disk, a bus filled to the car's bitrate."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from fsai_hil.rehearsal.scrutineering import load
from fsai_hil.rehearsal.scrutineering.conditions import (
    BY_NAME,
    CONDITIONS,
    SHORT,
    Load,
    LoadCondition,
    conditions_named,
)
from fsai_hil.rehearsal.scrutineering.load import (
    BUS_BITS_PER_S,
    BUSY,
    MEMORY_MOST_BYTES,
    VIEWERS,
    car_bits_per_s,
    fill_frames_per_s,
    frame_bits,
    loaded,
)
from fsai_hil.rehearsal.scrutineering.machine import (
    machine,
    scheduling_in_words,
    scheduling_of,
    source_revision,
    versions,
)
from fsai_hil.rehearsal.scrutineering.measurement import Measurement
from fsai_hil.rehearsal.stack import Stack, StackError, await_condition
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.errors import WrongUse


def test_a_frame_without_stuff_bits_has_its_standard_length() -> None:
    assert frame_bits(0) == 47
    assert frame_bits(8) == 111


def test_thinned_out_frames_leave_more_of_the_bus_to_fill() -> None:
    whole, thinned = car_bits_per_s("2026"), car_bits_per_s("2026", 20, 10)
    assert 0 < thinned < whole < BUS_BITS_PER_S
    assert fill_frames_per_s(thinned) > fill_frames_per_s(whole) > 0


def test_the_cars_frames_and_the_filling_are_one_full_bus() -> None:
    car_bits = car_bits_per_s("2021")
    assert car_bits + fill_frames_per_s(car_bits) * frame_bits(8) == pytest.approx(BUS_BITS_PER_S)
    assert fill_frames_per_s(BUS_BITS_PER_S + 1) == 0


def test_a_busy_machine_is_busy_only_while_it_is_measured(tmp_path: Path) -> None:
    disk_file = tmp_path / "disk-load"
    condition = LoadCondition("driving-loaded", AsState.AS_DRIVING, (Load.PROCESSORS, Load.DISK))
    with Stack("vcan0", tmp_path) as stack:
        with loaded(stack, condition, disk_file, 0.0):
            processes = list(stack.processes.values())
            busy = [process.popen.pid for process in processes if "processor" in process.name]
            assert len(busy) == machine()["processors"] == len(processes) - 1

            def cpu_ticks() -> int:
                path = Path(f"/proc/{busy[0]}/stat")
                return int(path.read_text().split()[13])

            before = cpu_ticks()
            await_condition(lambda: cpu_ticks() > before, 120.0, "the processor is used")
            written = disk_file.stat().st_mtime_ns
            await_condition(lambda: disk_file.stat().st_mtime_ns > written, 120.0, "the disk is written to")
        assert stack.processes == {}
        assert not any(process.alive for process in processes)
        assert not disk_file.exists()


def test_a_memory_hungry_neighbour_takes_a_bounded_share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    most_bytes = MEMORY_MOST_BYTES // 8
    monkeypatch.setattr(load, "MEMORY_MOST_BYTES", most_bytes)
    condition = LoadCondition("driving-memory", AsState.AS_DRIVING, (Load.MEMORY,))

    def resident_bytes(pid: int) -> int:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    with Stack("vcan0", tmp_path) as stack, loaded(stack, condition, tmp_path / "file", 0.0):
        (neighbour,) = stack.processes.values()
        pid = neighbour.popen.pid
        await_condition(lambda: resident_bytes(pid) > most_bytes // 2, 120.0, "it takes memory")
        assert Path(f"/proc/{pid}/oom_score_adj").read_text().strip() == "1000"
        most = 0
        before = resident_bytes(pid)
        while (now := resident_bytes(pid)) >= before:
            most = before = max(before, now)
        assert most <= most_bytes + (64 << 20), "and no more than it may"


def test_ten_viewers_watch_a_pit_wall_while_it_is_measured(tmp_path: Path) -> None:
    condition = LoadCondition("idle-pitwall", AsState.AS_OFF, (Load.PIT_WALL,))
    with (
        Stack(f"loopback:watched-{os.getpid()}", tmp_path) as stack,
        pytest.raises(StackError, match="pitwall-idle-pitwall ended"),
        loaded(stack, condition, tmp_path / "file", 0.0),
    ):
        wall, viewers = stack.processes.values()
        assert wall.alive and viewers.log() == f"{BUSY}\n"
        links = Path(f"/proc/{viewers.popen.pid}/fd").iterdir()
        assert sum(str(each.readlink()).startswith("socket:") for each in links) == VIEWERS
        wall.stop()
        viewers.wait(60.0)
        assert "the pit wall has ended" in viewers.log()


@pytest.mark.parametrize(("load", "how"), [(Load.DISK, "with status 1"), (Load.BUS, "")])
def test_a_load_that_ends_early_is_an_error_not_an_idle_machine(tmp_path: Path, load: Load, how: str) -> None:
    with (
        Stack("absent0", tmp_path) as stack,
        pytest.raises(StackError, match=f"driving-early ended {how}"),
        loaded(stack, LoadCondition("driving-early", AsState.AS_DRIVING, (load,)), tmp_path / "absent" / "file", 0.0),
    ):
        (program,) = stack.processes.values()
        program.wait(60.0)


# ------------------------------------------------------------ conditions


def test_between_conditions_the_car_only_has_to_be_switched_on() -> None:
    order = [AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING]
    states = [order.index(condition.car) for condition in CONDITIONS]
    assert states == sorted(states)
    assert len(BY_NAME) == len(CONDITIONS)
    assert all(BY_NAME[name].car is AsState.AS_OFF for name in SHORT)


def test_named_conditions_are_measured_in_the_tables_order() -> None:
    assert [each.name for each in conditions_named(["driving", "idle"])] == ["idle", "driving"]


@pytest.mark.parametrize("names", [["idle", "asleep"], [], [""]])
def test_an_unknown_condition_is_refused_with_the_known_ones(names: list[str]) -> None:
    with pytest.raises(WrongUse, match="choose from idle, idle-busy"):
        conditions_named(names)


# ------------------------------------------------------------ the machine


def test_the_machine_tells_what_a_figure_depends_on() -> None:
    facts = machine()
    assert facts["kernel"].startswith("Linux ") and facts["processors"] >= 1 and facts["memory_gib"] > 0
    assert versions()["cantools"][0].isdigit() and "python-can" in versions()


def test_scheduling_is_read_from_the_kernel(tmp_path: Path) -> None:
    with Stack("vcan0", tmp_path) as stack:
        process = stack.start("sleeper", ["sleep", "60"])
        found = scheduling_of(process.popen.pid)
    assert (found["policy"], found["priority"], found["memory_locked"]) == ("SCHED_OTHER", 0, False)
    assert "refused" in scheduling_in_words(found)


def test_the_source_is_a_commit_or_nothing(tmp_path: Path) -> None:
    assert source_revision(tmp_path) == ""


def test_a_load_that_starts_too_late_costs_its_own_condition(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(load, "_START_S", 0.0)
    condition = LoadCondition("idle-memory", AsState.AS_OFF, (Load.MEMORY,))
    measurement = Measurement("vcan0", tmp_path, seconds=1.0, revision="2021", slow_place=True)
    with Stack("vcan0", tmp_path) as stack:
        measurement._stack, measurement._car = stack, stack.start("car", [sys.executable, "-c", "input()"])
        measurement._try_to_measure(condition, (), lambda: ("", ""))
        assert list(stack.processes) == ["car"]
    assert "not measured: waited 0 s in vain: load-1-memory-idle-memory" in capfd.readouterr().out
    assert list(measurement._not_measured) == ["idle-memory"]
