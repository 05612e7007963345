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
from story_runs import branch, driving, page

from fsai_vcu.interface.enums import MissionStatus

pytestmark = needs_browser

# Pixels of a canvas that have the colour of the first line.
COLOURED = """
    const [canvas, name] = arguments;
    const probe = document.createElement("canvas").getContext("2d");
    probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
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
def html(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a run that ended in an emergency brake: it has everything on it."""
    from fsai_hil.simulator.faults import WrongValues

    def spoil(run: Any) -> None:
        values = {"mission_status": MissionStatus.FINISHED}
        run.spoil(WrongValues(frozenset({0x510}), run.lockstep.world.codec, values))

    log = branch(driving(), spoil, 1.0)
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page(log.frames, "a <b>run</b> & its log with a rather long name, 2026-11-21_23-05-17.log"))
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
        until(browser, lambda: browser.find_element(By.ID, "range").text)
        return browser

    return show


def canvases(browser: Chrome) -> list[Any]:
    return browser.find_elements(By.CSS_SELECTOR, "canvas[id^=plot-]")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "mobile"), [(1280, False), (360, True)], ids=["desk", "phone"])
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
    assert browser.execute_script(COLOURED, lanes, "--go") > 200, "AS_DRIVING is not to be seen"
    assert browser.execute_script(COLOURED, lanes, "--alarm") > 20, "the emergency brake is not to be seen"


@pytest.mark.parametrize("width", [320, 390, 768])
def test_the_page_is_never_wider_than_the_screen(shown: Callable[..., Chrome], width: int) -> None:
    browser = shown(width, 800, mobile=width < 700)
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
    shown_s = browser.find_element(By.ID, "range").text.split("s, ")[-1].removesuffix(" s").split(" to ")
    assert float(shown_s[0]) <= t_s <= float(shown_s[1]) <= float(shown_s[0]) + 2.0
    values = [key.text for key in browser.find_elements(By.CSS_SELECTOR, "#legend-speed b")]
    assert all(float(value) > 1.0 for value in values[:4]), values
    assert "ASMS on" in browser.find_element(By.ID, "legend-lanes").text


def test_dragging_zooms_and_a_double_click_shows_all(shown: Callable[..., Chrome]) -> None:
    browser = shown(1280)
    canvas = canvases(browser)[0]
    whole = browser.find_element(By.ID, "range").text.split("s, ")[-1]
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
    canvas.send_keys("+")
    canvas.send_keys("\ue014")  # arrow to the right
    until(browser, lambda: browser.find_element(By.ID, "range").text.startswith("at "))
