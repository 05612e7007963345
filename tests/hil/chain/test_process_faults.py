"""Faults of processes and of the bus while the car drives: what safety.md's table says of each, seen on the bus.

One interactive car lives through all of these tests. Each begins with its power cycle, which is also the proof that
the one before has been recovered from, and ends with a car at rest that does not set off again; or what it does is
nothing to the car, which drives on into the next test. Those go first: power-up and drive cost most of a test.
"""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from chain.conftest import (
    FLOOD_ID,
    INTRUDER,
    MISSION,
    POWER_CYCLE_S,
    POWER_UP_S,
    START_S,
    STOP_S,
    Chain,
    rules_kept,
)
from conftest import ip, logged, new_folder
from fsai_hil.rehearsal.bus_watch import BusWatch, send_signal
from fsai_hil.rehearsal.stack import NODES, await_condition
from fsai_hil.rehearsal.stall_monitor import STOOD_STILL_NS
from fsai_hil.rules.checker import MS
from fsai_hil.vcan.native import TX_QUEUE_FRAMES
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiStatus, VcuStatus
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.runtime.bus import open_bus
from fsai_vcu.runtime.pacing import FALLBACK_AFTER_NS

DEADLINES = BridgeConfig()
# What comes on top of each deadline: at most one cycle, and what the machine may be held up without being excused.
CYCLE_NS = FALLBACK_AFTER_NS + STOOD_STILL_NS
VCU_PATIENCE_NS = 100 * MS  # interface specification v4.0: AI_COMMS_LOST
AT_EASE_S = 0.5  # so long after the end of a run the bus is still watched
BITRATE = 500_000
FRAME_BITS = 128  # as the queue counts a classic frame of 8 bytes; on a wire it is 111 and stuff bits
CAN_ERR_BUSOFF = 0x040  # linux/can/error.h
ADJ_SETOFFSET, TIMEX_TIME_AT = 0x0100, 72  # linux/timex.h, where a long has 64 bits

long = pytest.mark.long


def first_gap(drive: BusWatch, since_ns: int, gap_ns: int) -> int:
    """When first for `gap_ns` no whole cycle had been on the bus; 0 if there always was one."""
    last_ns, expected = since_ns, sorted(AI_IDS)
    ids = [(frame.t_ns, frame.can_id) for frame in drive.frames if frame.can_id in AI_IDS and frame.t_ns >= since_ns]
    for index, (t_ns, _) in enumerate(ids):
        if t_ns - last_ns >= gap_ns:
            return last_ns + gap_ns
        if [can_id for _, can_id in ids[index - 4 : index + 1]] == expected:
            last_ns = t_ns
    return 0


def state_after(drive: BusWatch, since_ns: int, state: AsState) -> float:
    return drive.first(VcuStatus, since_ns, lambda status: status.as_state is state)


def comes_to_rest(chain: Chain, *states: AsState) -> None:
    """The run ends in one of `states`, the car stands, and all is quiet for a while."""
    state = chain.operator.await_state(
        lambda s: s.as_state in (AsState.AS_FINISHED, AsState.EMERGENCY_BRAKE), STOP_S, "the run ends"
    )
    assert state.as_state in states, chain.operator.describe()
    chain.operator.await_state(lambda s: s.standing, STOP_S, "the car stands")
    until = time.monotonic() + AT_EASE_S
    while time.monotonic() < until:
        chain.operator.spin()
    assert chain.state.as_state in states, chain.operator.describe()


# ---------------------------------------------------------------- nothing to the car


@pytest.mark.skipif(os.environ.get("FSAI_HIL_PLACE") != "uml", reason="it would step the clock of the whole machine")
def test_a_car_drives_on_when_the_clock_is_stepped(chain: Chain, drive: BusWatch) -> None:
    for step_s in (3600, -7200, 3600):
        step_clock(step_s)
        chain.drives_on(1.0)  # longer than any deadline of the table
    rules_kept(drive)


def test_a_second_bridge_is_refused_and_the_first_goes_on(chain: Chain, drive: BusWatch) -> None:
    bridge = [sys.executable, "-m", "fsai_nodes.vcu_bridge", "--ros-args", "-p", f"can_interface:={chain.stack.bus}"]
    # Only idle time: on one slow processor its import of ROS would keep the nodes of the first waiting.
    second = chain.stack.start("second_bridge", ["chrt", "--idle", "0", *bridge])
    begun_ns = time.time_ns()
    try:
        assert second.wait(START_S) != 0
    finally:
        second.stop()
        del chain.stack.processes["second_bridge"]
    lines = [line for line in second.log().splitlines() if not line.startswith("[INFO]")]
    assert len(lines) == 1 and "already drives 'vcan0'" in lines[0], second.log()
    chain.stack.check_alive(*NODES)
    state = chain.operator.await_new_state(STOP_S, "the first bridge goes on")
    # The car may have been stopped for a controller that was kept waiting all the same: that is the first one's duty.
    assert state.as_state in (AsState.AS_DRIVING, AsState.AS_FINISHED), chain.operator.describe()
    assert not state.emergency, chain.operator.describe()
    assert first_gap(drive, begun_ns, VCU_PATIENCE_NS) == 0, "the first bridge was never silent"
    rules_kept(drive)


# ---------------------------------------------------------------- processes


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("path_planner", signal.SIGKILL),
        *(
            pytest.param(name, number, marks=long)
            for name in ("path_planner", "cone_detector", "sensor_simulator", "vehicle_controller")
            for number in (signal.SIGKILL, signal.SIGSTOP)
            if (name, number) != ("path_planner", signal.SIGKILL)
        ),
    ],
)
def test_without_fresh_data_the_car_stops_for_good(
    chain: Chain, drive: BusWatch, name: str, number: signal.Signals
) -> None:
    """Without data the controller goes on commanding; its commands carry the stamp of the oldest data behind them."""
    struck_ns, late_ns = send_signal(chain.stack.processes[name].popen.pid, number)
    try:
        comes_to_rest(chain, AsState.AS_FINISHED)
    finally:
        if number == signal.SIGSTOP:
            chain.stack.processes[name].signal(signal.SIGCONT)
        else:
            chain.stack.start_node(name)
    assert chain.state.mode == "manual", "a stop for lost commands is latched"
    chain.operator.await_state(lambda s: s.command_age_s < 0.5, START_S, "commands with fresh data come again")
    comes_to_rest(chain, AsState.AS_FINISHED)
    data_ns = 0 if name == "vehicle_controller" else DEADLINES.sensor_stale_ns
    assert drive.torque_ends(struck_ns) <= late_ns + data_ns + DEADLINES.command_stale_ns + CYCLE_NS
    assert drive.brakes_after(struck_ns) <= late_ns + data_ns + DEADLINES.command_lost_ns + CYCLE_NS
    rules_kept(drive)


@long
@pytest.mark.parametrize("hang_s", [0.2, 5.0])
def test_a_hanging_loop_is_silent_and_wakes_with_estop(chain: Chain, drive: BusWatch, hang_s: float) -> None:
    loop = chain.pids["CAN loop"]
    stopped_ns, late_ns = send_signal(loop, signal.SIGSTOP)
    try:
        if hang_s > 1.0:
            chain.operator.await_state(
                lambda s: any("the CAN loop has reported nothing" in line for line in s.why_not_driving),
                STOP_S,
                "the edge names the silent loop",
            )
        time.sleep(hang_s)  # the length of the hang is what is tested
    finally:
        woken_ns = time.time_ns()
        os.kill(loop, signal.SIGCONT)
    comes_to_rest(chain, AsState.EMERGENCY_BRAKE)
    spoken = [t_ns for t_ns, _ in drive.images(AiStatus, stopped_ns)]
    silent_ns = stopped_ns + late_ns + CYCLE_NS
    assert not [t_ns for t_ns in spoken if silent_ns < t_ns < woken_ns], "it is silent while it hangs"
    emergency = state_after(drive, stopped_ns, AsState.EMERGENCY_BRAKE)
    assert emergency <= late_ns + VCU_PATIENCE_NS + CYCLE_NS, "the car stops itself"
    assert drive.images(AiStatus, woken_ns)[0][1].estop_request, "the first that it says is ESTOP_REQUEST"
    assert drive.torque_ends(woken_ns) == 0
    assert "late" in chain.state.emergency
    rules_kept(drive)


@long
def test_a_killed_loop_is_silence_and_its_edge_ends(chain: Chain, drive: BusWatch) -> None:
    bridge = chain.stack.processes["vcu_bridge"]
    killed_ns, late_ns = send_signal(chain.pids["CAN loop"], signal.SIGKILL)
    assert bridge.wait(STOP_S) == 1
    assert "the CAN loop ended by itself: its process was killed by signal 9" in bridge.log()
    chain.stack.start_node("vcu_bridge")
    chain.operator.await_bridge(START_S)
    # The killed one's services may still be found, so it is this that awaits the start.
    chain.operator.await_state(lambda s: s.as_state == AsState.EMERGENCY_BRAKE, START_S, "the car has stopped itself")
    emergency = state_after(drive, killed_ns, AsState.EMERGENCY_BRAKE)
    assert emergency <= late_ns + VCU_PATIENCE_NS + CYCLE_NS
    assert drive.torque_ends(killed_ns + late_ns + CYCLE_NS) == 0


@long
def test_an_edge_that_hangs_is_a_stale_command(chain: Chain, drive: BusWatch) -> None:
    """No command reaches the loop, which answers the car all the while and brakes it to rest."""
    edge = chain.stack.processes["vcu_bridge"]
    stopped_ns, late_ns = send_signal(edge.popen.pid, signal.SIGSTOP)
    try:
        time.sleep(5.0)  # the length of the hang is what is tested
    finally:
        woken_ns = time.time_ns()
        edge.signal(signal.SIGCONT)
    comes_to_rest(chain, AsState.AS_FINISHED)
    assert chain.state.mode == "manual", "a stop for lost commands is latched"
    assert drive.torque_ends(stopped_ns) <= late_ns + DEADLINES.command_stale_ns + CYCLE_NS
    assert drive.brakes_after(stopped_ns) <= late_ns + DEADLINES.command_lost_ns + CYCLE_NS
    assert not first_gap(drive, stopped_ns, VCU_PATIENCE_NS), "the loop is never silent"
    assert not any(status.estop_request for t_ns, status in drive.images(AiStatus, stopped_ns) if t_ns < woken_ns)
    rules_kept(drive)


@long  # what every run shows of it: the drive of `python -m fsai_hil.rehearsal.carpc --short`
def test_a_killed_edge_leaves_the_car_to_the_service_brake(chain: Chain, drive: BusWatch) -> None:
    """The loop brakes the car to rest, says FINISHED, and ends; the next bridge may start."""
    loop = chain.pids["CAN loop"]
    killed_ns, late_ns = send_signal(chain.stack.processes["vcu_bridge"].popen.pid, signal.SIGKILL)
    chain.operator.state = None
    await_condition(lambda: ended(loop), STOP_S, "the loop's process ends by itself")
    ended_ns = time.time_ns()
    chain.stack.start_node("vcu_bridge")
    chain.operator.await_bridge(START_S)
    # The killed one's services may still be found, so it is this that awaits the start.
    state = chain.operator.await_state(lambda s: s.as_state == AsState.EMERGENCY_BRAKE, START_S, "an emergency")
    assert (state.mode, state.shutdown_cause_label) == ("manual", "AI_COMMS_FAULT")
    accepted, _ = chain.operator.set_mode("autonomous")
    assert not accepted, "autonomous was accepted in EMERGENCY_BRAKE"
    finished = state_after(drive, killed_ns, AsState.AS_FINISHED)
    assert finished <= ended_ns - killed_ns
    assert drive.torque_ends(killed_ns) <= late_ns + DEADLINES.command_stale_ns + CYCLE_NS
    assert drive.brakes_after(killed_ns) <= late_ns + DEADLINES.command_lost_ns + CYCLE_NS
    until_finished = [status for t_ns, status in drive.images(AiStatus, killed_ns) if t_ns < killed_ns + finished]
    assert not any(status.estop_request for status in until_finished)


@long
def test_a_vcu_that_restarts_needs_the_whole_sequence_anew(chain: Chain, drive: BusWatch) -> None:
    car = chain.shared_car()
    car.vcu.signal(signal.SIGKILL)
    car.vcu.wait(STOP_S)
    chain.operator.await_state(lambda s: s.emergency and s.status_age_s > POWER_CYCLE_S, STOP_S, "the car is missed")
    car.vcu = chain.start_vcu("car", auto=False)
    car.type("on")
    chain.operator.await_state(lambda s: s.as_state == AsState.AS_OFF, POWER_UP_S, "AS_OFF")
    car.type(f"ami {MISSION}")
    chain.operator.await_state(lambda s: s.as_state == AsState.AS_READY, POWER_UP_S, "AS_READY")
    assert not chain.state.emergency, "a power cycle of the car clears the latch"
    heard_ns = [t_ns for t_ns, _ in drive.images(VcuStatus)]
    last_ns = max(pairwise(heard_ns), key=lambda pair: pair[1] - pair[0])[0]
    assert drive.torque_ends(last_ns) <= DEADLINES.vcu_stale_ns + CYCLE_NS
    assert drive.estop_after(last_ns) <= DEADLINES.vcu_lost_ns + CYCLE_NS
    rules_kept(drive)


# ---------------------------------------------------------------- the bus


def test_a_foreign_0x511_is_an_emergency(chain: Chain, drive: BusWatch, interface: str) -> None:
    subprocess.run(["cansend", interface, f"511#{INTRUDER.hex()}"], check=True)
    comes_to_rest(chain, AsState.EMERGENCY_BRAKE)
    assert chain.state.shutdown_cause_label == "AI_COMPUTER_REQUEST"
    assert "0x511" in chain.state.emergency and INTRUDER.hex(" ").upper() in chain.state.emergency
    seen_ns = next(frame.t_ns for frame in drive.frames if frame.data == INTRUDER)
    assert drive.estop_after(seen_ns) <= CYCLE_NS
    assert drive.torque_ends(seen_ns + 1) <= CYCLE_NS
    rules_kept(drive)


@long
def test_on_a_flooded_bus_dropped_cycles_are_counted_and_stop_it(chain: Chain, drive: BusWatch, interface: str) -> None:
    """A bus of 500 kbit/s, and somebody who sends as fast as he can. A queue has no arbitration: even ours wait."""
    before = chain.operator.diagnostics("loop")
    with flooded(interface):
        chain.operator.await_state(lambda s: s.as_state != AsState.AS_DRIVING, STOP_S, "too many are missing")
    comes_to_rest(chain, AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED)
    after = chain.operator.diagnostics("loop")
    assert _more(after, before, "incomplete cycles", 1), "dropped cycles are counted"
    flood_ns = [frame.t_ns for frame in drive.frames if frame.can_id == FLOOD_ID]
    lost_ns = first_gap(drive, flood_ns[0], DEADLINES.send_lost_ns)
    assert drive.torque_ends(lost_ns) <= CYCLE_NS
    assert first_gap(drive, flood_ns[-1] + DEADLINES.vcu_lost_ns, DEADLINES.send_lost_ns) == 0, "it speaks again"
    rules_kept(drive, lost_ns=lost_ns)


@long
def test_a_bus_that_is_busy_but_not_full_changes_nothing(chain: Chain, drive: BusWatch, interface: str) -> None:
    with flooded(interface, gap_ms="0.5"):
        chain.drives_on(2.0)  # far longer than any deadline of the table
    rules_kept(drive)


@long
def test_after_bus_off_the_car_is_at_rest(chain: Chain, drive: BusWatch, interface: str) -> None:
    """The controller's own error frame, as a socket hears it: both sides lose the bus, ours is back at once."""
    before = chain.operator.diagnostics("loop")
    off_ns = time.time_ns()
    with open_bus(interface) as bus:
        assert bus.send(Frame(CAN_ERR_BUSOFF, bytes(8), error=True))
    comes_to_rest(chain, AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED)
    assert drive.torque_ends(off_ns) <= CYCLE_NS
    assert _more(chain.operator.diagnostics("loop"), before, "bus reopened", 1)
    # A cycle that was being sent at that very instant goes out whole; that it is the last one was asserted above.
    rules_kept(drive, lost_ns=off_ns + CYCLE_NS)


def test_after_an_interface_was_down_the_car_has_stopped(chain: Chain, drive: BusWatch, interface: str) -> None:
    ip("link", "set", interface, "down")
    down_ns = time.time_ns()
    try:
        await_lost(chain)
    finally:
        up_ns = time.time_ns()
        ip("link", "set", interface, "up")
    comes_to_rest(chain, AsState.EMERGENCY_BRAKE)
    assert not [frame for frame in drive.frames if down_ns < frame.t_ns < up_ns]
    assert drive.torque_ends(up_ns) == 0
    assert drive.images(AiStatus, up_ns), "it speaks again"
    rules_kept(drive, lost_ns=down_ns)


@long
def test_an_interface_plugged_in_again_is_used_again(
    chain: Chain, drive: BusWatch, interface: str, results: Path
) -> None:
    ip("link", "del", interface)
    unplugged_ns = time.time_ns()
    try:
        await_lost(chain)
    finally:
        ip("link", "add", "dev", interface, "type", "vcan")
        ip("link", "set", interface, "txqueuelen", str(TX_QUEUE_FRAMES), "up")
    again = logged(interface, new_folder(f"{results.name}.again"))
    try:
        comes_to_rest(chain, AsState.EMERGENCY_BRAKE)
    finally:
        again.stop()
    assert drive.torque_ends(unplugged_ns) == 0
    assert again.images(AiStatus), "it speaks again"
    assert again.torque_ends(0) == 0
    rules_kept(drive)


def ended(pid: int) -> bool:
    """Whether there is no such process, or only what is left for its parent to see."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "XZ"
    except (FileNotFoundError, ProcessLookupError):
        return True


def await_lost(chain: Chain) -> None:
    """Until the bridge says that it has lost the bus, and the car has had the time to miss it."""
    chain.operator.await_that(
        lambda: "bus lost" in chain.operator.diagnostics("link")["message"], STOP_S, "the bridge reports the loss"
    )


def step_clock(seconds: int) -> None:
    """By whole seconds, at once: read and set, the time between the two would be missing from the log's intervals."""
    timex = bytearray(256)  # linux/timex.h; more than any kernel's struct
    struct.pack_into("=I", timex, 0, ADJ_SETOFFSET)
    struct.pack_into("=qq", timex, TIMEX_TIME_AT, seconds, 0)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.adjtimex((ctypes.c_char * len(timex)).from_buffer(timex)) < 0:
        raise OSError(ctypes.get_errno(), "adjtimex")


def _more(now: dict[str, str], before: dict[str, str], key: str, count: int) -> bool:
    return int(now[key]) >= int(before[key]) + count


@contextmanager
def flooded(interface: str, gap_ms: str = "0") -> Iterator[None]:
    """A queue that lets out 500 kbit/s and holds ten frames, and cangen at the other end of it."""
    limits = ["rate", str(BITRATE), "burst", "1600", "limit", str(TX_QUEUE_FRAMES * FRAME_BITS // 8)]
    subprocess.run(["tc", "qdisc", "add", "dev", interface, "root", "tbf", *limits], check=True)
    # The last in line for the processor: it is the bus that is to be full.
    flood = ["nice", "-n", "19", "cangen", interface, "-g", gap_ms, "-I", f"{FLOOD_ID:X}", "-L", "8", "-i"]
    cangen = subprocess.Popen(flood)
    try:
        yield
    finally:
        cangen.terminate()
        cangen.wait()
        subprocess.run(["tc", "qdisc", "del", "dev", interface, "root"], check=True)
