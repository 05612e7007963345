"""A real browser without a screen, for the pages that people look at."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("selenium", reason="selenium is not installed: pip install 'selenium>=4.20,<5'")

from selenium.common.exceptions import WebDriverException
from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

DRIVER, BROWSER = shutil.which("chromedriver"), shutil.which("chromium") or shutil.which("chromium-browser")


def _works(driver: str) -> bool:
    """Tell a driver from Ubuntu's, which only says that it comes as a snap."""
    return subprocess.run([driver, "--version"], capture_output=True, check=False).returncode == 0


needs_browser = pytest.mark.skipif(
    DRIVER is None or BROWSER is None or not _works(DRIVER),
    reason="no chromium here that a driver starts: apt-get install -y chromium chromium-driver (Debian)",
)

WITHIN_S = 60.0
STARTS = 3  # of a driver for which selenium, which waits half a minute, was too impatient, or whose port was taken
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@contextmanager
def started(profile: Path) -> Iterator[Chrome]:
    """With its logs of the console and of the network on."""
    options = ChromeOptions()
    options.binary_location = str(BROWSER)
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = begun(options)
    try:
        driver.set_script_timeout(WITHIN_S)
        yield driver
    finally:
        driver.quit()


def begun(options: ChromeOptions) -> Chrome:
    for _ in range(STARTS - 1):
        with suppress(WebDriverException):
            return Chrome(options=options, service=Service(str(DRIVER)))
    return Chrome(options=options, service=Service(str(DRIVER)))


def until(browser: Chrome, condition: Callable[[], object]) -> None:
    WebDriverWait(browser, WITHIN_S, 0.05).until(lambda _: condition())


def set_screen(browser: Chrome, width: int, height: int, *, mobile: bool, scheme: str) -> None:
    """As on a screen of that size; scheme: light or dark."""
    screen = {"width": width, "height": height, "deviceScaleFactor": 2 if mobile else 1, "mobile": mobile}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})


def heard(browser: Chrome, log: str) -> list[dict[str, Any]]:
    """What the browser has written into one of its logs since the last time."""
    untyped: Any = browser
    entries: list[dict[str, Any]] = untyped.get_log(log)
    return entries
