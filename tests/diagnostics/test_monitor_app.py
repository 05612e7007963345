"""The monitor's pages: what keys do, on terminals of two sizes, for a log and a bus."""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import pytest
from story_runs import branch, driving
from textual.events import Key
from textual.pilot import Pilot

from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.monitor.app import MonitorApp
from fsai_vcu.diagnostics.monitor.sources import Live, PlayedLog, Source
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.interface.units import S

LARGE, SMALL = (80, 24), (40, 14)
WITHIN_S = 60.0
Walk = Callable[[MonitorApp, Pilot[None]], Coroutine[Any, Any, None]]


@pytest.fixture(scope="module")
def frames() -> Frames:
    """A drive that ends with Go off, two seconds before the end."""
    return branch(driving(), lambda run: run.switch(go=False), 2.0).frames


def chunks(frames: Frames) -> Iterator[Frames]:
    for begin_ns in range(int(frames.t_ns[0]), int(frames.t_ns[-1]) + 1, S):
        yield frames.only((frames.t_ns >= begin_ns) & (frames.t_ns < begin_ns + S))


def log_of(frames: Frames, at_s: float | None = None, rate: float | None = None) -> PlayedLog:
    return PlayedLog(chunks(frames), View("run.log"), at_s, rate)


def walk(source: Source, size: tuple[int, int], steps: Walk, *, signals: tuple[str, ...] = ()) -> MonitorApp:
    """The app headless, while `steps` press its keys."""
    app = MonitorApp(source, 0.25, signals)

    async def run() -> None:
        async with app.run_test(size=size) as pilot:
            await pilot.pause()
            await steps(app, pilot)

    asyncio.run(run())
    return app


async def until(condition: Callable[[], bool], app: MonitorApp) -> None:
    """What a key or a frame leads to: where the machine is busy it is drawn later than a pause of the pilot lasts."""
    until_s = time.monotonic() + WITHIN_S
    while not condition():
        assert time.monotonic() < until_s, text(app)
        await asyncio.sleep(0.02)


def lines(app: MonitorApp) -> list[str]:
    return [strip.text.rstrip() for strip in app.screen._compositor.render_strips()]


def text(app: MonitorApp) -> str:
    return "\n".join(lines(app))


@pytest.mark.parametrize("size", [LARGE, SMALL])
def test_every_page_fits_and_says_its_keys(size: tuple[int, int], frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        for key, part in (
            ("1", "why not driving:"),
            ("tab", "510 "),
            ("tab", "AS_STATE" if size is SMALL else "AI2VCU_Status.HANDSHAKE"),
            ("tab", "Go off"),
            ("tab", "the remote's Go went off"),
            ("question_mark", "end; the last picture"),
        ):
            await pilot.press(key)
            await pilot.pause()
            await until(lambda part=part: part in text(app) or size is SMALL, app)  # type: ignore[misc]
            if key == "1":
                await until(lambda: any("why not driving:" in each for each in lines(app)[:8]), app)
                assert "EMERGENCY_BRAKE for 2.0 s" in text(app)
            assert len(lines(app)) == size[1] and max(map(len, lines(app))) <= size[0]
            assert lines(app)[0].startswith(" run.log") and lines(app)[0].endswith(" s")
            beyond = "" if size is SMALL else "  Tab  page  n N  state  g  second  /  find"
            assert lines(app)[-1].strip() == "q  quit  ?  help  p  pause  ← →  1 s" + beyond  # whole keys only

    walk(log_of(frames), size, steps)


def test_keys_move_in_a_log(frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        log = app._source
        assert isinstance(log, PlayedLog)

        def shown_s() -> float:
            return float(lines(app)[0].split("■")[1].split(" of ")[0])

        async def shows(expected_s: object, *keys: str) -> None:
            await pilot.press(*keys)
            await pilot.pause()
            await until(lambda: shown_s() == expected_s, app)
            assert shown_s() == pytest.approx((log.position_ns - log.begin_ns) / S, abs=0.051)

        async def begins(as_state: str, key: str) -> None:
            await pilot.press(key)
            await until(lambda: (app.moment.picture.as_state, app.moment.picture.as_state_s) == (as_state, 0.0), app)

        end_s = round((log.end_ns - log.begin_ns) / S, 1)
        await shows(end_s)
        await shows(pytest.approx(end_s - 2, abs=0.11), "left", "left")
        await shows(pytest.approx(end_s - 12, abs=0.11), "comma")
        await shows(end_s, "full_stop", "full_stop")
        await begins("EMERGENCY_BRAKE", "N")
        await begins("AS_DRIVING", "N")
        await begins("EMERGENCY_BRAKE", "n")
        await shows(3.5, "g", *"3.5", "enter")
        await shows(3.5, "g", *"q1", "escape")
        await shows(end_s, "g", *"1e9", "enter")

    walk(log_of(frames), SMALL, steps)


def test_an_event_is_gone_to(frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        await pilot.press("4")
        await until(lambda: "AS_STATE AS_DRIVING → EMERGENCY_BRAKE" in text(app), app)
        while app._rows[at := app._list.highlighted or 0][0].plain.split(maxsplit=2)[2] != "Go on":
            await pilot.press("up")
            await until(lambda at=at: app._list.highlighted != at, app)  # type: ignore[misc]
        await pilot.press("enter")
        await until(lambda: "driving" in lines(app), app)
        assert app.moment.picture.as_state == "AS_DRIVING" and app.moment.picture.as_state_s == 0.0

    walk(log_of(frames), LARGE, steps)


def test_a_log_plays_at_its_rate_and_pauses(frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        def position_s() -> float:
            return (app.moment.picture.t_ns - int(frames.t_ns[0])) / S

        await until(lambda: position_s() > 0.0, app)
        await pilot.press("space")
        await until(lambda: not app._source.playing, app)
        paused_s = position_s()
        assert paused_s % 2.5 == 0.0, "ten times what passes from one picture to the next"
        await pilot.pause(0.3)
        assert position_s() == paused_s

    walk(log_of(frames, rate=10.0), LARGE, steps)


@pytest.mark.parametrize("size", [LARGE, SMALL])
def test_a_message_has_a_page_of_bytes_and_signals(size: tuple[int, int], frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        await pilot.press("2", *["down"] * 5, "enter")
        await until(lambda: lines(app)[1].startswith("520 ") and "byte 7" in text(app), app)
        rows = [row.plain for row, _ in app._rows]
        (state,) = (row for row in rows if row.startswith("AS_STATE"))
        assert "EMERGENCY_BRAKE" in state
        assert size is SMALL or "2.0 s ago, 4×, was AS_" in state
        await pilot.press("escape")
        await until(lambda: app._page == "messages", app)

    walk(log_of(frames), size, steps)


def test_signals_are_found_by_a_part_of_their_name(frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        keys = {" ": "space", "_": "underscore", ",": "comma", "*": "asterisk"}
        for typed, first, count in (
            ("as_st", "AS_STATE", 1),
            ("AS_STATE,go_*", "AS_STATE", 2),
            ("nothing at all", "no signal received fits *nothing at all*", 1),
        ):
            await pilot.press("slash", *(keys.get(char, char) for char in typed), "enter")
            await pilot.pause()
            await until(lambda first=first: first in "".join(row.plain for row, _ in app._rows), app)  # type: ignore[misc]
            assert len(app._rows) == count

    walk(log_of(frames), LARGE, steps)


def test_keys_typed_while_it_was_held_up_are_all_taken(frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        for key, character in (("slash", "/"), *((each, each) for each in "go"), ("enter", "\r")):
            app.post_message(Key(key, character))
        await until(lambda: len(app._rows) == 2 and "GO_SIGNAL" in text(app), app)
        for key in ("2", "down", "enter"):
            app.post_message(Key(key, None))
        await until(lambda: app._page == "message", app)

    walk(log_of(frames), LARGE, steps)


def test_signals_asked_for_are_shown_first(frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        assert "VCU2AI_Status.AS_STATE" in text(app) and len(app._rows) == 1

    walk(log_of(frames), LARGE, steps, signals=("AS_STATE",))


def test_bars_and_trends_take_the_right_half_of_a_wide_terminal(frames: Frames) -> None:
    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        def right() -> str:
            return "\n".join(each[72:] for each in lines(app))

        await until(lambda: "of 500 kbit/s" in right() and "█" in right(), app)
        assert lines(app)[1].startswith("● EMERGENCY_BRAKE")
        assert all(name in right() for name in ("speed", "steering", "torque rear", "brake front", "bus load"))
        await pilot.press("2")
        await until(lambda: "of 500 kbit/s" not in text(app), app)

    walk(log_of(frames), (120, 30), steps)


class Bus:
    """A bus on which the frames of a run come as fast as they are taken, until `end`."""

    def __init__(self, frames: Frames) -> None:
        self.end = threading.Event()
        self._frames = frames

    def chunks(self) -> Iterator[Frames]:
        now_ns = time.time_ns()
        yield self._frames.at(self._frames.t_ns - self._frames.t_ns[-1] + now_ns)
        self.end.wait(600.0)
        print("fsai-vcu monitor: can0: Network is down", file=sys.stderr)


def test_a_lost_bus_ends_it_and_what_was_said_is_kept(frames: Frames) -> None:
    bus = Bus(frames)

    async def steps(app: MonitorApp, pilot: Pilot[None]) -> None:
        await until(lambda: "EMERGENCY_BRAKE" in text(app), app)
        assert "listening only" in lines(app)[0]
        await pilot.press("right", "n", "g")  # nothing to be moved in
        assert "second" not in lines(app)[-1] and not app._input.display
        await pilot.press("4")
        await until(lambda: "AS_STATE AS_DRIVING → EMERGENCY_BRAKE" in text(app), app)
        bus.end.set()
        await until(lambda: app._exit, app)

    app = walk(live := Live(bus.chunks(), View("can0")), LARGE, steps)
    assert "".join(app.printed) == "fsai-vcu monitor: can0: Network is down\n"
    assert live.ended and app._exit
    assert app.moment.picture.as_state_heard == "EMERGENCY_BRAKE"
