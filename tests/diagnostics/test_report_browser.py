"""The page in a real browser: it draws, it fits a phone, it asks nobody for anything."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browsing import heard, needs_browser, set_screen, started, until
from selenium.webdriver import Chrome
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from story_runs import branch, driving

from fsai_vcu.diagnostics.explain import Record
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.page.curves import plots
from fsai_vcu.diagnostics.page.document import of_log
from fsai_vcu.diagnostics.page.server import Server
from fsai_vcu.diagnostics.verdict.judging import Judged, judged
from fsai_vcu.interface.enums import AsState, MissionStatus
from fsai_vcu.interface.lights import LIGHTS
from fsai_vcu.interface.units import MS

pytestmark = needs_browser

# Pixels of a canvas that have the colour of the first line.
COLOURED = """
    const [canvas, name] = arguments; // of CSS, or a colour
    const probe = document.createElement("canvas").getContext("2d");
    const style = getComputedStyle(document.documentElement);
    probe.fillStyle = name.startsWith("#") ? name : style.getPropertyValue(name).trim();
    probe.fillRect(0, 0, 1, 1);
    const [r, g, b] = probe.getImageData(0, 0, 1, 1).data;
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let i = 0; i < data.length; i += 4)
        if (data[i + 3] > 200 && Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) < 24)
            count++;
    return count;
"""


@pytest.fixture(scope="module")
def frames() -> Frames:
    """A run that ended in an emergency brake."""
    from fsai_hil.simulator.faults import WrongValues

    def spoil(run: Any) -> None:
        values = {"mission_status": MissionStatus.FINISHED}
        run.spoil(WrongValues(frozenset({0x510}), run.lockstep.world.codec, values))

    return branch(driving(), spoil, 1.0).frames


@pytest.fixture(scope="module")
def found(frames: Frames) -> Judged:
    return judged(frames)


@pytest.fixture(scope="module")
def html(found: Judged, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its page has everything on it."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(of_log(found, "a <b>run</b> & its log with a rather long name, 2026-11-21_23-05-17.log"))
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    with started(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


@pytest.fixture
def shown(browser: Chrome, html: Path) -> Callable[..., Chrome]:
    """Opens the page as on a screen of that width."""

    def show(width: int, height: int = 900, *, mobile: bool = False, scheme: str = "light") -> Chrome:
        set_screen(browser, width, height, mobile=mobile, scheme=scheme)
        heard(browser, "browser"), heard(browser, "performance")
        browser.get(html.as_uri())
        until(browser, lambda: browser.find_element(By.ID, "now").text)
        return browser

    return show


def canvases(browser: Chrome) -> list[Any]:
    return browser.find_elements(By.CSS_SELECTOR, "canvas[id^=plot-]")


# Of a scheme only the colours differ.
@pytest.mark.parametrize(
    ("width", "mobile", "scheme"), [(1280, False, "light"), (360, True, "dark")], ids=["desk", "phone"]
)
def test_every_plot_is_drawn_and_the_console_is_silent(
    shown: Callable[..., Chrome], width: int, mobile: bool, scheme: str
) -> None:
    browser = shown(width, mobile=mobile, scheme=scheme)
    assert heard(browser, "browser") == []  # before the pixels are read back, of which the browser disapproves
    drawn = canvases(browser)
    slugs = [canvas.get_attribute("id") for canvas in drawn]
    assert slugs == ["plot-speed", "plot-steering", "plot-torque", "plot-brake", "plot-handshake", "plot-load"]
    for canvas in drawn:
        numbers = range(len(browser.find_elements(By.CSS_SELECTOR, f"#legend-{canvas.get_attribute('id')[5:]} .key")))
        pixels = [browser.execute_script(COLOURED, canvas, f"--c{number}") for number in numbers]
        assert any(count > 40 for count in pixels), (canvas.get_attribute("id"), pixels)
    lanes = browser.find_element(By.ID, "lanes")
    for state, least in ((AsState.AS_DRIVING, 200), (AsState.EMERGENCY_BRAKE, 20)):
        assert browser.execute_script(COLOURED, lanes, LIGHTS[state].fill) > least, f"{state.label} is not to be seen"


def test_the_page_is_never_wider_than_the_screen(shown: Callable[..., Chrome]) -> None:
    browser = shown(320, 800, mobile=True)
    for width in (320, 390, 768):
        set_screen(browser, width, 800, mobile=width < 700, scheme="light")
        inner, needed = browser.execute_script("return [innerWidth, document.documentElement.scrollWidth]")
        assert inner == width
        assert needed <= width


def test_nothing_is_requested_but_the_page_itself(shown: Callable[..., Chrome], html: Path) -> None:
    browser = shown(1280)
    ActionChains(browser).move_to_element(canvases(browser)[0]).perform()
    asked = [
        message["params"]["request"]["url"]
        for entry in heard(browser, "performance")
        if (message := json.loads(entry["message"])["message"])["method"] == "Network.requestWillBeSent"
    ]
    assert html.as_uri() in asked, "the log of requests sees nothing at all"
    assert [url for url in asked if url != html.as_uri() and not url.startswith("data:")] == []
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0


def test_the_policy_forbids_what_the_page_does_not_ask_for(shown: Callable[..., Chrome]) -> None:
    browser = shown(1280)
    blocked = browser.execute_async_script(
        """
        const done = arguments[0], seen = [];
        document.addEventListener("securitypolicyviolation", (e) => {
            seen.push(e.effectiveDirective);
            if (seen.length === 3) done(seen.sort());
        });
        fetch("https://example.invalid/x").catch(() => {});
        document.body.append(Object.assign(new Image(), { src: "https://example.invalid/x.png" }));
        const script = document.createElement("script");
        script.textContent = "document.title = 'taken'";
        document.body.append(script);
        """
    )
    assert blocked == ["connect-src", "img-src", "script-src-elem"]
    assert "taken" not in browser.title
    heard(browser, "browser")


def test_a_time_in_the_story_leads_to_that_moment_in_the_plots(shown: Callable[..., Chrome]) -> None:
    browser = shown(1280)
    before = browser.find_element(By.ID, "range").text
    button = browser.find_element(By.CSS_SELECTOR, "article .time")
    t_s = float(button.get_attribute("data-t") or "nan")
    button.click()
    until(browser, lambda: browser.find_element(By.ID, "range").text != before)
    shown_s = browser.find_element(By.ID, "range").text.removesuffix(" s").split(" to ")
    assert float(shown_s[0]) <= t_s <= float(shown_s[1]) <= float(shown_s[0]) + 2.0
    values = [key.text for key in browser.find_elements(By.CSS_SELECTOR, "#legend-speed b")]
    assert all(float(value) > 1.0 for value in values[:5]), values
    assert browser.find_element(By.ID, "now").text == f"{t_s:.2f} s"
    assert "ASMS on" in browser.find_element(By.ID, "legend-lanes").text


def test_dragging_zooms_and_a_double_click_shows_all(shown: Callable[..., Chrome]) -> None:
    browser = shown(1280)
    canvas = canvases(browser)[0]
    whole = browser.find_element(By.ID, "range").text
    drag = ActionChains(browser).move_to_element_with_offset(canvas, -100, 0).click_and_hold()
    drag.move_by_offset(200, 0).release().perform()
    until(browser, lambda: whole not in browser.find_element(By.ID, "range").text)

    def all_again() -> bool:
        ActionChains(browser).double_click(canvas).perform()  # two clicks of their own where the driver is held up
        return whole in browser.find_element(By.ID, "range").text

    until(browser, all_again)


def test_plots_work_with_the_keyboard_and_have_text_alternatives(shown: Callable[..., Chrome]) -> None:
    browser = shown(1280)
    for canvas in canvases(browser):
        assert canvas.get_attribute("role") == "img"
        assert " from " in canvas.get_attribute("aria-label")
    canvas = canvases(browser)[0]
    before = browser.find_element(By.ID, "now").text
    canvas.send_keys("+")
    canvas.send_keys("\ue012")  # arrow to the left
    until(browser, lambda: browser.find_element(By.ID, "now").text != before)


# Moves the slider as a person does, and gives what the page then shows: state, speed, steering, legends of the plots.
SLID = """
    const [t, done] = arguments, slider = document.getElementById("time");
    slider.value = t;
    slider.dispatchEvent(new Event("input"));
    const texts = (selector) => [...document.querySelectorAll(selector)].map((one) => one.textContent);
    requestAnimationFrame(() => requestAnimationFrame(() => done({
        t: Number(slider.value), state: texts("#state-name")[0], speed: texts("#speed b")[0],
        given: texts("#actuators tr td:last-child"), asked: texts("#actuators tr td:nth-child(3)"),
        values: Object.fromEntries([...document.querySelectorAll(".legend[id^=legend-]")].map((one) =>
            [one.id, [...one.querySelectorAll("b")].map((each) => each.textContent)])),
    })));
"""


def test_the_slider_shows_state_and_values_of_that_time(shown: Callable[..., Chrome], frames: Frames) -> None:
    browser, record = shown(1280), Record(frames)
    length_s = (record.end_ns - record.begin_ns) / 1e9
    for share in (0.31, 0.93, 0.5, 0.99):
        seen = browser.execute_async_script(SLID, round(share * length_s, 2))
        t_ns = record.begin_ns + round(seen["t"] * 1e9) + MS // 10 - 1  # the page knows tenths of ms
        assert seen["t"] == pytest.approx(share * length_s, abs=0.011)
        assert seen["state"] == sig.label(sig.AS_STATE, record.at(sig.AS_STATE, t_ns))
        wheels = [record.at(signal, t_ns) or 0.0 for signal in sig.WHEELS]
        speed_mps = record.car.speed_of_wheel_rpm(sum(wheels) / 4)
        assert float(seen["speed"]) == pytest.approx(speed_mps, abs=0.0551)
        pairs = ((sig.STEER, sig.ANGLE), (sig.TORQUE_F, sig.CAR_TORQUE[0]), (sig.TORQUE_R, sig.CAR_TORQUE[1]))
        for row, signals in enumerate((*pairs, (sig.BRAKE_REQ_F, sig.BRAKE_F), (sig.BRAKE_REQ_R, sig.BRAKE_R))):
            told = (seen["asked"][row], seen["given"][row].split(" ")[0])
            assert [float(each) for each in told] == pytest.approx([record.at(s, t_ns) for s in signals], abs=0.0551)
        for plot in plots(record):
            curves = [curve for curve in plot.curves if curve.drawn]
            for curve, value in zip(curves, seen["values"][f"legend-{plot.slug}"], strict=True):
                if plot.slug not in ("handshake", "load"):  # between whose points a line is drawn
                    expected = curve.series.at(t_ns)
                    assert float(value) == pytest.approx(expected, abs=0.51 * 10**-plot.digits), curve.name


def test_a_served_log_is_allowed_all_that_it_needs(browser: Chrome, found: Judged) -> None:
    with Server("127.0.0.1", 0) as server:
        server.html = of_log(found, "run.log", whole=False)
        browser.get("about:blank")
        heard(browser, "browser")
        browser.get(f"http://127.0.0.1:{server.server_address[1]}/")
        until(browser, lambda: browser.find_element(By.ID, "state").text == "EMERGENCY_BRAKE")
        assert heard(browser, "browser") == []
        assert browser.find_element(By.TAG_NAME, "main").value_of_css_property("display") == "grid"


def test_a_log_plays_from_its_first_frame_when_it_is_asked_to(browser: Chrome, found: Judged, tmp_path: Path) -> None:
    path = tmp_path / "played.html"
    path.write_text(of_log(found, "run.log", rate=8.0))
    browser.get(path.as_uri())
    times = []

    def played() -> bool:
        times.append(float(browser.find_element(By.ID, "now").text.removesuffix(" s") or "nan"))
        return times[-1] > 2.0

    until(browser, played)
    browser.find_element(By.ID, "play").click()
    until(browser, lambda: browser.find_element(By.ID, "play").text == "▶")
    assert times == sorted(times)
