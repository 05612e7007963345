"""The pit wall's page in a real browser: it fits every screen, and never shows old values as if they were of now."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest
from aiohttp.web import BaseRequest, StreamResponse
from browsing import heard, needs_browser, set_screen, started, until
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from fsai_vcu.diagnostics.log.reader import read_log
from fsai_vcu.diagnostics.monitor.snapshot import Picture
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.diagnostics.page.board import events_of, state_of
from fsai_vcu.diagnostics.page.server import Server
from fsai_vcu.diagnostics.serving import Connection
from fsai_vcu.interface.lights import light_of
from fsai_vcu.interface.units import S

pytestmark = needs_browser

NAME = "can0 <b>& its</b> <script>document.title = 'taken'</script>"
T = TypeVar("T")
# Of a scheme only the colours differ.
SCREENS = [(1600, 900, "light"), (1280, 760, "light"), (1366, 640, "light"), (1024, 768, "dark"), (390, 844, "light")]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    with started(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


@pytest.fixture(scope="module")
def driving() -> tuple[dict[str, Any], dict[str, Any]]:
    """State and story of a car at speed, on a bus with a strange name."""
    frames, _ = read_log(str(Path(__file__).parent / "golden" / "bends.log.gz"))
    view = View(NAME)
    view.update(frames.only(frames.t_ns < frames.t_ns[0] + 20 * S))
    end_ns = view.memory.newest_ns or 0
    state = {**state_of(view.picture(end_ns)), "clock": "12:00:00", "pose": [30.0, 4.0, 0.5], "run": "1"}
    events = events_of(view.events(), end_ns, lambda t_ns: f"{t_ns / S:.3f} s")
    return state, {"way_cm": [0, 0, 1000, 0, 2000, 150], "events": events, "run": "1"}


@pytest.fixture(scope="module")
def with_nodes(driving: tuple[dict[str, Any], dict[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The same where the nodes run: two cones seen, three remembered, half of the path borne out, a place to stop."""
    drawn = {
        "nodes": [
            ["bridge: the steering is held: it moves faster than the car can follow", "warning"],
            ["bridge: AS_DRIVING, driving by command", ""],
            ["planner: path of 14 m along its map, 97 % sure, stop in 10 m", ""],
            ["controller: at most 5.0 m/s", ""],
        ],
        "seen_cm": [3400, 700, 1, 3600, 400, 2],
        "path_cm": [3000, 400, 3400, 550, 3800, 700, 4200, 850],
        "borne_out": 3,
        "stop": 2,
    }
    before = {"cones_cm": [500, 200, 1, 500, -200, 2, 1000, 200, 4]}
    return {**driving[0], **drawn}, {**driving[1], **before}


@contextmanager
def publishing(server: Server, state: dict[str, Any], story: dict[str, Any]) -> Iterator[None]:
    """The same again and again, as the verb does."""
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.1):
            server.publish("story", story)
            server.publish("state", state)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def text(browser: Chrome, name: str) -> str:
    return browser.find_element(By.ID, name).text


def stale(browser: Chrome) -> bool:
    return "stale" in (browser.find_element(By.TAG_NAME, "body").get_attribute("class") or "").split()


def while_fresh(browser: Chrome, look: Callable[[], T]) -> T:
    """What is seen while the page is not stale, as it is whenever the publisher here is held up."""
    while True:
        until(browser, lambda: not stale(browser))
        seen = look()
        if not stale(browser):
            return seen


def opened(browser: Chrome, server: Server) -> None:
    browser.get("about:blank")  # the page before asks for its server, which has ended, again and again
    heard(browser, "browser")
    browser.get(f"http://127.0.0.1:{server.server_address[1]}/")
    until(browser, lambda: not stale(browser))


def test_a_driving_car_is_shown_and_names_stay_text(browser: Chrome, driving: tuple[Any, Any]) -> None:
    with Server("127.0.0.1", 0) as server, publishing(server, *driving):
        opened(browser, server)
        assert (text(browser, "state"), text(browser, "channel")) == ("AS_DRIVING", NAME)
        assert while_fresh(browser, lambda: browser.title) == f"AS_DRIVING · {NAME}"
        assert "lights yellow, flashing" in text(browser, "held")
        tile, lamp = (browser.find_element(By.ID, name) for name in ("state-tile", "lamp"))
        assert tile.value_of_css_property("background-color") == "rgba(255, 200, 0, 1)"  # while the lamp flashes
        assert [each.value_of_css_property("animation-name") for each in (tile, lamp)] == ["none", "flash"]
        assert not browser.find_element(By.ID, "why-name").is_displayed()
        assert float(text(browser, "speed").split()[0]) > 3.0
        assert "no faults" in text(browser, "chips") and not browser.find_element(By.ID, "faults-name").is_displayed()
        assert text(browser, "lap").split() == ["1", "of", "1"] and "of 500 kbit/s" in text(browser, "load")
        until(browser, lambda: "AS_READY → AS_DRIVING" in text(browser, "events"))
        assert points(browser, "way") == 4 and cones(browser) == {}
        until(browser, lambda: not stale(browser))
        assert (text(browser, "track-name"), text(browser, "bus-name")) == ("driven path", "bus")
        given = browser.find_elements(By.CSS_SELECTOR, "#actuators i")
        assert len(given) == 5 and max(bar.size["width"] for bar in given) > 20
        assert heard(browser, "browser") == []  # nothing was refused by the policy either


def points(browser: Chrome, name: str) -> int:
    return (browser.find_element(By.ID, name).get_attribute("points") or "").count(",")


def cones(browser: Chrome) -> dict[str, int]:
    """How many of each colour, of those seen and before."""
    script = (
        "return [...document.querySelectorAll('[data-color]')].map((one) =>"
        " [`${one.parentNode.id} ${one.dataset.color}`, (one.getAttribute('d') || '').split('M').length - 1])"
    )
    return {name: count for name, count in browser.execute_script(script) if count}


def test_cones_path_and_words_of_the_nodes_are_shown(browser: Chrome, with_nodes: tuple[Any, Any]) -> None:
    with Server("127.0.0.1", 0) as server, publishing(server, *with_nodes):
        opened(browser, server)
        until(browser, lambda: len(cones(browser)) == 5)
        assert cones(browser) == {"seen 1": 1, "seen 2": 1, "before 1": 1, "before 2": 1, "before 4": 1}
        assert [points(browser, name) for name in ("way", "path", "doubted", "stop")] == [4, 3, 2, 2]
        assert (text(browser, "track-name"), text(browser, "bus-name")) == ("track", "bus and nodes")
        assert "planner: path of 14 m along its map, 97 % sure, stop in 10 m" in text(browser, "bus")
        assert heard(browser, "browser") == []


def test_of_silent_nodes_the_page_shows_the_silence_alone(
    browser: Chrome, driving: tuple[Any, Any], with_nodes: tuple[Any, Any]
) -> None:
    silence = {"nodes": [["/vehicle_state of vcu_bridge: nothing received for 2000 ms", "warning"]]}
    with Server("127.0.0.1", 0) as server:
        with publishing(server, *with_nodes):
            opened(browser, server)
            until(browser, lambda: len(cones(browser)) == 5)
        with publishing(
            server, {**driving[0], **silence, "run": "2"}, with_nodes[1]
        ):  # the story is not told again yet
            until(browser, lambda: "nothing received for 2000 ms" in text(browser, "bus"))
            assert cones(browser) == {} and text(browser, "track-name") == "driven path"
            assert [points(browser, name) for name in ("way", "path", "doubted", "stop")] == [1, 0, 0, 0]


CUT = (
    "[...document.querySelectorAll('section, #state, td, th, li, header')].filter((one) =>"
    " one.clientWidth && (one.scrollWidth > one.clientWidth + 1 || (one.id != 'news-tile'"
    " && one.tagName == 'SECTION' && one.scrollHeight > one.clientHeight + 1))).map((one) => one.outerHTML)"
)
SIZE = "document.documentElement.scrollWidth, document.documentElement.scrollHeight"


@pytest.fixture(scope="module")
def states(driving: tuple[Any, Any], with_nodes: tuple[Any, Any]) -> list[dict[str, Any]]:
    """A drive and an emergency brake, without and with what the nodes say."""
    braking = {
        "as_state": "EMERGENCY_BRAKE",
        "driving": False,
        "estop_request": True,
        "states": {
            "OP_STATE": "OP_AUTO",
            "TS_STATE": "TS_SHUTDOWN",
            "EBS_STATE": "EBS_TRIGGERED",
            "STEERING_STATUS": "OFF",
            "STATUS_BRK": "READY",
        },
        "faults": [{"names": ["EBS_FAULT"], "text": "the emergency brake system failed", "remedy": "check the air"}],
        "why_not_driving": [{"text": "the VCU braked because of an EBS fault", "remedy": "power-cycle"}],
        "light": light_of("EMERGENCY_BRAKE")._asdict(),
    }
    (state, _), (more, _) = driving, with_nodes
    return [{**each, "channel": "can0"} for each in (state, {**state, **braking}, more, {**more, **braking})]


PLACES = (
    "[...document.querySelectorAll('main section')].map((one) => {"
    " const box = one.getBoundingClientRect(); return [one.id, box.x, box.y, box.width, box.height]; })"
)


@pytest.mark.parametrize(("width", "height", "scheme"), SCREENS)
def test_no_state_cuts_anything_off_or_moves_the_grid(
    browser: Chrome, with_nodes: tuple[Any, Any], states: list[dict[str, Any]], width: int, height: int, scheme: str
) -> None:
    silent = {**state_of(Picture(0, "can0", "2026", "", 0)), "clock": "", "pose": [0, 0, 0], "run": "1"}
    set_screen(browser, width, height, mobile=width < 700, scheme=scheme)
    places: list[Any] = []
    look = f"return [{PLACES}, {CUT}, {SIZE}]"
    with Server("127.0.0.1", 0) as server:
        for shown in (*states, silent):
            with publishing(server, shown, with_nodes[1]):
                if not places:
                    opened(browser, server)
                name = shown["as_state"] or "no AS state"
                until(browser, lambda name=name: text(browser, "state") == name)  # type: ignore[misc]
                found, cut, needed, high = while_fresh(browser, lambda: browser.execute_script(look))
                places.append(found)
                if shown is silent:
                    continue
                assert cut == []
                word = browser.find_element(By.ID, "state")
                lines = word.size["height"] / float(word.value_of_css_property("font-size").removesuffix("px"))
                assert lines < 1.5, "the AS state is broken into lines"
                assert needed <= width and (high <= height or width < 1200), "a wall does not scroll"
    assert len(places[0]) == 7 and all(each == places[0] for each in places)


def test_lost_values_are_grey_at_once_until_they_come_again(
    browser: Chrome, driving: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    stream = Server._stream

    async def counted(server: Server, request: BaseRequest, connection: Connection) -> StreamResponse:
        asked.append(request)
        return await stream(server, request, connection)

    monkeypatch.setattr(Server, "_stream", counted)
    with Server("127.0.0.1", 0) as server:
        with publishing(server, *driving):
            opened(browser, server)
            assert not while_fresh(browser, browser.find_element(By.ID, "banner").is_displayed)
        until(browser, lambda: stale(browser))  # the server lives, and says nothing
        until(browser, lambda: text(browser, "banner").startswith("no data for "))
        assert browser.title.startswith("no data")
        main = browser.find_element(By.TAG_NAME, "main")
        assert main.value_of_css_property("filter") == "grayscale(1)"
        assert browser.find_element(By.ID, "lamp").value_of_css_property("animation-name") == "none"
        until(browser, lambda: len(asked) > 1)  # it asks again: a network may have lost the connection unsaid
        with publishing(server, *driving):
            assert not while_fresh(browser, browser.find_element(By.ID, "banner").is_displayed)


def test_a_server_that_comes_again_is_found(browser: Chrome, driving: tuple[Any, Any]) -> None:
    with Server("127.0.0.1", 0) as server, publishing(server, *driving):
        opened(browser, server)
        port = server.server_address[1]
    until(browser, lambda: stale(browser))
    with Server("127.0.0.1", port) as again, publishing(again, {**driving[0], "as_state": "AS_FINISHED"}, driving[1]):
        until(browser, lambda: not stale(browser) and text(browser, "state") == "AS_FINISHED")
    heard(browser, "browser")


def test_what_a_network_held_back_is_not_shown_as_of_now(browser: Chrome, driving: tuple[Any, Any]) -> None:
    with Server("127.0.0.1", 0) as server, publishing(server, *driving):
        opened(browser, server)
        # As if the first event had come 3 s sooner; no new connection is tried, for which another would be the first.
        sooner = "if (quickestMs < Infinity) { quickestMs -= 3000; triedMs = Infinity; return true; }"
        until(browser, lambda: browser.execute_script(sooner))
        until(browser, lambda: stale(browser) and text(browser, "banner").startswith("no data for 3."))


def test_a_silent_bus_is_said_though_the_server_speaks(browser: Chrome) -> None:
    state = {**state_of(Picture(0, "can0", "2026", "", 0)), "clock": "", "pose": [0, 0, 0], "run": "1"}
    with Server("127.0.0.1", 0) as server:
        with publishing(server, state, {"way_cm": [], "events": [], "run": "1"}):
            opened(browser, server)
            assert while_fresh(browser, lambda: text(browser, "banner")) == "nothing is received on can0"
            assert text(browser, "state") == "no AS state"
        last = {**state, "silent_s": 12.4, "as_state_heard": "AS_DRIVING"}
        with publishing(server, last, {"way_cm": [], "events": [], "run": "1"}):
            until(browser, lambda: text(browser, "banner") == "can0 has been silent for 12 s")
            until(browser, lambda: not stale(browser))
            assert text(browser, "state") == "car silent"
            assert text(browser, "speed") == "– m/s"
