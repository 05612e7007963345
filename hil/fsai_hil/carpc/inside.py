"""Runs as a service of the rehearsed car PC: waits, looks, breaks things, and measures how long it takes to be well.

Nothing is touched by hand but what a person beside the car may touch; faults are what befalls a machine.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

RESULTS = Path("/results")
NODES = ("fsai-detector", "fsai-planner", "fsai-controller")
_POLL_S = 0.1


class Rehearsal:
    def __init__(self, interface: str, missions: int) -> None:
        self.interface = interface
        self.missions = missions
        self.bridge = f"fsai-bridge@{interface}"
        self.recorder = f"fsai-recorder@{interface}"
        self.car = f"fsai-simulated-car@{interface}"
        self.services = (*NODES, self.bridge, self.recorder)
        self.steps: list[dict[str, object]] = []

    def run(self) -> None:
        self.step("all services are active after the boot", self.all_active, 120.0)
        self.note("the bridge's start, from its process to READY", self.bridge_start_s())
        self.step("fsai.target is reached", lambda: is_active("fsai.target"), 60.0)
        self.doctor()
        exposure = output("systemd-analyze", "security", "--no-pager", f"{self.bridge}.service").strip().splitlines()
        self.note(exposure[-1].strip("→ ") if exposure else "no exposure", None)
        systemctl("start", self.car)
        self.driven()
        for service in self.services:
            self.killed(service)
        self.hung()
        self.unplugged()
        self.step("at the end all services are active", self.all_active, 60.0)

    # ------------------------------------------------------------ steps

    def driven(self) -> None:
        """The car's operator walks the switches, chooses each mission, gives Go; the judge decides."""
        began = time.monotonic()
        while (verdict := self.verdict()) is None and time.monotonic() - began < 400.0:
            time.sleep(_POLL_S * 10)
        (RESULTS / "verdict.json").write_text(json.dumps(verdict))
        missions = verdict["missions"] if verdict is not None else []
        words = "; ".join(f"{each['mission']}: {each['result']} {each['reasons'] or ''}".strip() for each in missions)
        passed = len(missions) == self.missions and all(each["result"] == "pass" for each in missions)
        what = f"{self.missions} missions driven, one after the other"
        self.note(what, time.monotonic() - began, passed=passed, words=words)
        (RESULTS / "journal.txt").write_text(output("journalctl", "-b", "--no-pager"))

    def killed(self, service: str) -> None:
        before = main_pid(service)
        os.kill(before, signal.SIGKILL)
        self.step(f"{service} is back after kill -9", lambda: self.anew(service, before), 60.0)

    def hung(self) -> None:
        before = main_pid(self.bridge)
        os.kill(before, signal.SIGSTOP)
        self.step(f"{self.bridge} is back after it hung (watchdog)", lambda: self.anew(self.bridge, before), 60.0)

    def unplugged(self) -> None:
        before = main_pid(self.bridge)
        output("ip", "link", "del", self.interface)
        self.step("without the interface the bridge is stopped", lambda: not is_active(self.bridge), 30.0)
        output("ip", "link", "add", "dev", self.interface, "type", "vcan")
        self.step("plugged in again, the bridge comes back", lambda: self.anew(self.bridge, before), 60.0)
        self.step("and the recorder", lambda: is_active(self.recorder), 60.0)

    def doctor(self) -> None:
        done = subprocess.run(["fsai-vcu", "doctor", "--json"], capture_output=True, text=True, check=False)
        (RESULTS / "doctor.json").write_text(done.stdout)
        # The car is not switched on yet, so it says nothing; nothing else may be wrong.
        try:
            findings = json.loads(done.stdout)["findings"]
        except (ValueError, KeyError):
            self.note(f"doctor failed: {done.stderr.strip()}", None, passed=False)
            return
        wrong = [f"{each['topic']}: {each['words']}" for each in findings if each["level"] == "wrong"]
        wrong = [words for words in wrong if not words.startswith("bus: ")]
        self.note(
            "doctor finds nothing wrong but a car that says nothing", None, passed=not wrong, words="; ".join(wrong)
        )

    # ------------------------------------------------------------ conditions

    def all_active(self) -> bool:
        return all(is_active(service) for service in self.services)

    def anew(self, service: str, before: int) -> bool:
        return is_active(service) and main_pid(service) not in (0, before)

    def verdict(self) -> dict[str, list[dict[str, object]]] | None:
        """The judge's, once the car has ended."""
        for line in reversed(output("journalctl", "-b", "-o", "cat", "-u", self.car).splitlines()):
            if line.startswith("{"):
                found: dict[str, list[dict[str, object]]] = json.loads(line)
                return found
        return None

    def bridge_start_s(self) -> float:
        times = output(
            "systemctl", "show", self.bridge, "-p", "ExecMainStartTimestampMonotonic,ActiveEnterTimestampMonotonic"
        )
        found = dict(line.split("=") for line in times.splitlines())
        begun, ready = found["ExecMainStartTimestampMonotonic"], found["ActiveEnterTimestampMonotonic"]
        return (int(ready) - int(begun)) / 1e6

    # ------------------------------------------------------------ telling

    def step(self, what: str, condition: Callable[[], bool], patience_s: float) -> None:
        """Await `condition`; how long it took is the step's time."""
        began = time.monotonic()
        passed = False
        while not passed and time.monotonic() - began < patience_s:
            passed = condition()
            if not passed:
                time.sleep(_POLL_S)
        self.note(what, time.monotonic() - began, passed=passed)

    def note(self, what: str, seconds: float | None, *, passed: bool = True, words: str = "") -> None:
        self.steps.append({"what": what, "seconds": seconds, "passed": passed, "words": words})
        (RESULTS / "report.json").write_text(json.dumps(self.steps, indent=1))


def output(*argv: str) -> str:
    return subprocess.run(argv, capture_output=True, text=True, check=False).stdout


def systemctl(*words: str) -> None:
    subprocess.run(["systemctl", *words], check=False)


def is_active(unit: str) -> bool:
    return output("systemctl", "is-active", unit).strip() == "active"


def main_pid(service: str) -> int:
    return int(output("systemctl", "show", service, "-p", "MainPID", "--value").strip() or 0)


def main() -> int:
    rehearsal = Rehearsal(sys.argv[1], int(sys.argv[2]))
    try:
        rehearsal.run()
    except Exception as error:
        rehearsal.note(f"the rehearsal itself failed: {type(error).__name__}: {error}", None, passed=False)
        raise
    finally:
        (RESULTS / "journal.txt").write_text(output("journalctl", "-b", "--no-pager"))
        systemctl("poweroff", "--force")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
