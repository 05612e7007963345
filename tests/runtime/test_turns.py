"""What the CAN loop decides, in virtual time: when it answers, and what it does when something goes wrong around it."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

import pytest

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig, Reason
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiStatus, VcuStatus
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS
from fsai_vcu.runtime.link import Alive, Answer, Ask, Ended, Message, Request, ResetConfirmed
from fsai_vcu.runtime.turns import Action, Do, Note, Send, Turns

REVISION = revision("2026")
CODEC = Codec(REVISION)
OFF, DRIVING = AsState.AS_OFF, AsState.AS_DRIVING
LISTENING = BridgeConfig(listen_only=True)


class Rig:
    """A loop in virtual time that carries out its actions and keeps those of the last turn; the bus opens when told."""

    def __init__(self, config: BridgeConfig | None = None, watchdog_period_ns: int | None = None) -> None:
        self.bridge = Bridge(CODEC, REVISION, CARS["2026"], config)
        self.turns = Turns(self.bridge, CODEC, 0, bus="can9", watchdog_period_ns=watchdog_period_ns)
        self.now_ns = 0
        self.takes = True  # the bus takes every frame, or none
        self.sending_ns = 0  # how long it takes to send a cycle
        self.done: list[Action] = []

    def turn(
        self, now_ns: int, frames: Sequence[Frame] = (), edge: Iterable[Message] | None = (Alive(),)
    ) -> list[Action]:
        self.now_ns, self.done = now_ns, []
        self.turns.awake(now_ns)
        self.turns.on_frames(frames, now_ns)
        self.do(self.turns.on_edge(edge, now_ns))
        self.do(self.turns.act(now_ns))
        return self.done

    def do(self, actions: Iterable[Action]) -> None:
        for action in actions:
            self.done.append(action)
            if isinstance(action, Send):
                left_ns = self.now_ns if action.frames else None
                self.do(self.turns.sent(self.takes or left_ns is None, left_ns, self.now_ns + self.sending_ns))
            elif isinstance(action, Ask):
                self.do(self.turns.answer(action, self.now_ns))

    def sent(self) -> list[int]:
        """The ids of what the last turn sent."""
        return [frame.can_id for action in self.done if isinstance(action, Send) for frame in action.frames]

    def follow(self, state: AsState, until_ns: int, edge: Iterable[Message] | None = (Alive(),)) -> list[Action]:
        """The car reports `state` every 10 ms until then; all that was done meanwhile."""
        done: list[Action] = []
        for now_ns in range(self.now_ns + 10 * MS, until_ns + 1, 10 * MS):
            done += self.turn(now_ns, [status(state, now_ns)], edge)
        return done

    def lose(self) -> None:
        self.done = []
        self.do(self.turns.lost("Network is down", self.now_ns))

    def ask(self, what: Request, argument: str | None = None, **changes: int | bool) -> list[Action]:
        """Ask at this instant; the edge waits for a millisecond more."""
        given = {"until_ns": self.now_ns + MS, "better_late": False, **changes}
        self.done = []
        self.do(self.turns.on_edge([Ask(number=7, what=what, argument=argument, **given)], self.now_ns))  # type: ignore[arg-type]
        return self.done

    @property
    def ending(self) -> bool:
        """The orderly end has begun."""
        return self.bridge.state.stop_cycles_left is not None


def status(state: AsState, t_ns: int) -> Frame:
    return Frame(0x520, CODEC.encode(VcuStatus(as_state=state, go_signal=state is DRIVING)).data, t_ns)


def settled(state: AsState = OFF, config: BridgeConfig | None = None, watchdog_period_ns: int | None = None) -> Rig:
    """One that has listened for its 200 ms and has just answered a 0x520 at 300 ms."""
    rig = Rig(config, watchdog_period_ns)
    rig.follow(state, 300 * MS)
    assert rig.sent() == ([] if config is LISTENING else list(AI_IDS))
    return rig


# ---------------------------------------------------------------- the answer


@pytest.mark.parametrize("kind", ["", "extended", "remote", "error"])
def test_a_0x520_is_answered_at_once_what_only_looks_so_is_not(kind: str) -> None:
    rig = settled()
    data = b"" if kind == "remote" else status(OFF, 0).data
    rig.turn(310 * MS, [Frame(0x520, data, 310 * MS, **({kind: True} if kind else {}))])  # type: ignore[arg-type]
    assert rig.sent() == ([] if kind else list(AI_IDS))


def test_the_next_cycle_keeps_its_gap_from_the_actual_send() -> None:
    rig = settled()
    rig.turns.on_frames([status(OFF, 310 * MS)], 310 * MS)
    assert rig.turns.act(310 * MS)
    rig.turns.sent(True, 314 * MS, 315 * MS)
    rig.turns.on_frames([status(OFF, 320 * MS)], 320 * MS)
    assert rig.turns.due_ns() == 322 * MS


def test_of_several_commands_the_newest_counts() -> None:
    rig = settled()
    commands = [VehicleCommand(rig.now_ns, rig.bridge.run.run_id, laps=laps) for laps in (3, 4)]
    rig.turn(311 * MS, edge=[ResetConfirmed("planner", rig.bridge.run.run_id), *commands, Ended("strange")])
    assert rig.bridge.state.command is commands[-1] and rig.bridge.state.command_ns == 311 * MS
    assert rig.bridge.state.supervisor.confirmed == {"planner"}
    assert rig.done == [Note(logging.ERROR, "Ended is not a message for the CAN loop")]


# ---------------------------------------------------------------- late


def test_frames_that_waited_for_20_ms_are_named() -> None:
    rig = settled(DRIVING)
    for oldest_ns, named in ((20 * MS - 1, 0), (20 * MS, 1)):
        now_ns = rig.now_ns + 25 * MS
        rig.turn(now_ns, [status(DRIVING, now_ns - oldest_ns), status(DRIVING, now_ns)])
        assert rig.bridge.tally.counts["backlog"] == named


@pytest.mark.parametrize(("known", "waited", "stops"), [(DRIVING, OFF, True), (OFF, DRIVING, False)])
def test_a_missed_deadline_counts_in_the_state_before_reading(known: AsState, waited: AsState, stops: bool) -> None:
    rig = settled(known)
    now_ns = rig.turns.due_ns() + 50 * MS
    rig.turn(now_ns, [status(waited, now_ns)])
    emergency = rig.bridge.state.supervisor.emergency
    assert (emergency is not None and emergency.cause is Reason.LOOP_FAULT) is stops
    assert rig.turns.deadline_misses == rig.bridge.tally.loop_faults == 1
    assert rig.sent() == list(AI_IDS)


@pytest.mark.parametrize(("late_ns", "sending_ns"), [(0, 50 * MS), (49 * MS, MS), (50 * MS, 0), (50 * MS, 50 * MS)])
def test_each_late_cycle_is_one_fault_and_feeds_no_watchdog(late_ns: int, sending_ns: int) -> None:
    rig = settled(DRIVING, watchdog_period_ns=1)
    rig.sending_ns = sending_ns
    assert Do.FEED not in rig.turn(rig.turns.due_ns() + late_ns)
    assert rig.turns.deadline_misses == rig.bridge.tally.loop_faults == 1
    rig.sending_ns = 0
    assert Do.FEED in rig.turn(rig.turns.due_ns() + 50 * MS - 1)
    assert rig.turns.deadline_misses == 1


def test_what_comes_between_reading_and_sending_is_late_too() -> None:
    rig = settled(DRIVING)
    due_ns = rig.turns.due_ns()
    rig.turns.awake(due_ns)
    (action,) = rig.turns.act(due_ns + 50 * MS)
    assert isinstance(action, Send) and rig.turns.deadline_misses == 1
    image = CODEC.decode(action.frames[0]).image
    assert isinstance(image, AiStatus) and image.estop_request


# ---------------------------------------------------------------- the bus


def test_a_bus_that_breaks_within_a_cycle_is_silent_until_opened() -> None:
    rig = settled()
    (action,) = rig.turns.act(rig.turns.due_ns())
    assert isinstance(action, Send)
    rig.lose()
    assert rig.done == [Note(logging.ERROR, "bus lost: Network is down"), Do.CLOSE, Do.REPORT]
    assert not rig.turns.has_bus and rig.bridge.state.bus_lost == "Network is down"
    assert rig.turns.due_ns() == 310 * MS
    assert rig.turn(310 * MS - 1) == []
    assert rig.turn(310 * MS) == [Do.OPEN]
    assert rig.turns.opened(311 * MS) == (Note(logging.WARNING, "bus back: can9"),)
    assert rig.turns.has_bus and rig.bridge.state.bus_lost is None and rig.turns.reopened == 1
    rig.turn(311 * MS, [status(OFF, 311 * MS)])
    assert rig.sent() == list(AI_IDS) and rig.turns.deadline_misses == 0


def test_pauses_grow_to_a_second_until_a_cycle_is_sent_whole() -> None:
    rig = settled()

    def refused_pauses(times: int) -> list[float]:
        pauses = []
        for _ in range(times):
            pauses.append((rig.turns.due_ns() - rig.now_ns) / MS)
            assert rig.turn(rig.turns.due_ns()) == [Do.OPEN]
            assert Note(logging.DEBUG, "no such device") in rig.turns.refused("no such device", rig.now_ns)
        return pauses

    rig.lose()
    assert refused_pauses(9) == [10, 20, 40, 80, 160, 320, 640, 1000, 1000]
    rig.now_ns = rig.turns.due_ns()
    rig.turns.opened(rig.now_ns)
    rig.takes = False
    assert rig.turn(rig.now_ns)[0] == Send(()), "until the car is received"
    rig.turn(rig.now_ns + 10 * MS, [status(OFF, rig.now_ns)])
    rig.lose()
    assert rig.done[0] == Note(logging.DEBUG, "bus lost: Network is down"), "it took nothing: it is not back"
    assert refused_pauses(1) == [1000]
    rig.now_ns = rig.turns.due_ns()
    rig.turns.opened(rig.now_ns)
    rig.takes = True
    rig.turn(rig.now_ns, [status(OFF, rig.now_ns)])
    rig.lose()
    assert rig.done[0] == Note(logging.ERROR, "bus lost: Network is down")
    assert refused_pauses(2) == [10, 20]
    assert rig.turns.deadline_misses == 0, "nothing is due on a lost bus"


def test_a_loop_that_only_listens_takes_a_silent_cycle_for_whole() -> None:
    rig = settled(config=LISTENING)
    for _ in range(2):
        rig.lose()
        assert rig.turns.due_ns() - rig.now_ns == 10 * MS
        rig.turns.opened(rig.turns.due_ns())
        rig.turn(rig.turns.due_ns())


def test_a_bus_that_takes_nothing_whole_for_50_ms_is_given_up() -> None:
    rig = settled()
    for whole_ns in (300 * MS, 350 * MS):
        rig.takes = False
        for now_ns in range(whole_ns + 10 * MS, whole_ns + 50 * MS, 10 * MS):
            assert Do.CLOSE not in rig.turn(now_ns, [status(OFF, now_ns)])
        rig.takes = whole_ns == 300 * MS
        rig.turn(whole_ns + 50 * MS, [status(OFF, whole_ns + 50 * MS)])
    why = "can9: no complete cycle sent for 50 ms"
    assert rig.done[1:] == [Note(logging.ERROR, f"bus lost: {why}"), Do.CLOSE, Do.REPORT]
    assert rig.bridge.state.bus_lost == why and not rig.turns.has_bus
    assert rig.bridge.tally.incomplete_cycles == 4 + 5


def test_a_bus_that_never_took_a_cycle_counts_from_the_first_try() -> None:
    rig = Rig()
    rig.takes = False
    assert Do.CLOSE not in rig.follow(OFF, 250 * MS), "it only listens for 200 ms"
    assert Do.CLOSE in rig.follow(OFF, 260 * MS)


def test_a_lost_bus_is_reported_and_the_watchdog_fed_meanwhile() -> None:
    rig = settled(watchdog_period_ns=5 * MS)
    rig.lose()
    for _ in range(3):
        rig.turn(rig.turns.due_ns())
        assert rig.turns.refused("no such device", rig.now_ns)[1:] == (Do.REPORT, Do.FEED)
    assert rig.turn(rig.now_ns + 9 * MS) == []
    assert rig.turn(rig.now_ns + 1 * MS) == [Do.REPORT]


# ---------------------------------------------------------------- the edge, and the end


def test_a_gone_edge_ends_a_loop_whose_car_does_not_drive() -> None:
    rig = settled(OFF)
    done = rig.follow(OFF, 400 * MS, None)
    sends = [action for action in done[: done.index(Do.END)] if isinstance(action, Send)]
    assert len(sends) == rig.bridge.config.stop_cycles and done[done.index(Do.END) - 1] is Do.REPORT


def test_a_gone_edge_leaves_a_driving_car_to_the_reactions() -> None:
    rig = settled(DRIVING)
    rig.follow(DRIVING, 390 * MS, None)
    assert not rig.ending
    silent_ns = 390 * MS + rig.bridge.config.vcu_lost_ns
    rig.turn(silent_ns - 1, edge=None)
    assert not rig.ending
    rig.turn(silent_ns, edge=None)
    assert rig.ending, "with the car silent there is nothing left to do"


@pytest.mark.parametrize("lost", [False, True])
def test_a_stop_ends_after_its_cycles_or_at_once_without_a_bus(lost: bool) -> None:
    rig = settled()
    if lost:
        rig.lose()
    assert [type(action) for action in rig.ask("deactivate", until_ns=0)] == [Ask], "answered after the end, never late"
    assert rig.turns.stop_number == 7
    if lost:
        gone = Note(logging.INFO, "stopped while the bus was gone")
        assert rig.turn(301 * MS) == [gone, Do.REPORT, Do.END]
        return
    for number in range(1, rig.bridge.config.stop_cycles + 1):
        assert Do.END not in rig.done
        rig.turn(300 * MS + number * 10 * MS, [status(OFF, 300 * MS + number * 10 * MS)])
        assert rig.sent() == list(AI_IDS)
    assert rig.done[1:] == [Do.REPORT, Do.END]


def test_a_stop_before_anything_was_sent_ends_without_a_word() -> None:
    rig = Rig()
    rig.turn(0)
    rig.ask("deactivate")
    assert rig.turn(MS) == [Do.REPORT, Do.END]


@pytest.mark.parametrize(
    ("what", "argument", "better_late", "late", "accepted", "words"),
    [
        ("emergency_brake", "now", False, False, True, "ESTOP_REQUEST is latched"),
        ("emergency_brake", "now", True, True, True, "ESTOP_REQUEST is latched"),
        ("emergency_brake", "now", False, True, False, "the CAN loop was late: nothing was done"),
        ("set_mode", "autonomous", False, False, True, "mode is autonomous"),
        ("set_mode", "autonomous", False, True, False, "the CAN loop was late: nothing was done"),
        ("set_mode", None, False, False, False, "set_mode is no request to a CAN loop that runs, or not with that"),
        ("reset", None, False, False, True, "nothing was latched"),
        ("reset", None, False, True, False, "the CAN loop was late: nothing was done"),
        ("activate", None, False, False, False, "activate is no request to a CAN loop that runs"),
    ],
)
def test_a_request_is_done_in_time_or_refused(
    what: Request, argument: str | None, better_late: bool, late: bool, accepted: bool, words: str
) -> None:
    rig = settled()
    before = rig.bridge.state
    until_ns = rig.now_ns + (not late)
    _, answer = rig.ask(what, argument, until_ns=until_ns, better_late=better_late)
    assert isinstance(answer, Answer) and (answer.number, answer.accepted) == (7, accepted)
    assert answer.message.startswith(words)
    assert (rig.bridge.state is before) is (not accepted or what == "reset")


@pytest.mark.parametrize(("state", "fed"), [(OFF, False), (DRIVING, True)])
def test_a_hung_edge_starves_the_watchdog_but_in_a_drive(state: AsState, fed: bool) -> None:
    rig = settled(state, watchdog_period_ns=100 * MS)
    done = rig.follow(state, 3290 * MS, ())
    assert done.count(Do.FEED) == 29, "it has sent something less than 3 s ago"
    assert rig.follow(state, 3600 * MS, ()).count(Do.FEED) == (4 if fed else 0)
    if not fed:
        assert Do.FEED in rig.follow(state, 3610 * MS)


# ---------------------------------------------------------------- the loop itself


def test_a_failure_of_the_loop_is_one_emergency_request() -> None:
    assert Rig().turns.failed("a bug", 0) == (), "while it only listens it may not speak"
    rig = settled(DRIVING)
    frames = rig.turns.failed("a bug", 301 * MS)
    image = CODEC.decode(frames[0]).image
    assert [frame.can_id for frame in frames] == list(AI_IDS)
    assert isinstance(image, AiStatus) and image.estop_request
