"""`fsai-vcu monitor`: on a log, on a live bus, on a terminal that it leaves as it was; it never sends."""

from __future__ import annotations

import codecs
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.interface.frames import Frame

DRIVING = bytes.fromhex("211E433020000000")  # AS_DRIVING, TRACKDRIVE, Go, ASMS and TSMS on, everything up
OFF = bytes.fromhex("2106013020000000")
WITHIN_S = 90.0
# Of those who run the tests: a size in the environment goes before the real one
HIDDEN = ("NO_COLOR", "COLUMNS", "LINES")
VERB = [sys.executable, "-m", "fsai_vcu.cli.main", "monitor"]


@pytest.fixture
def log(tmp_path: Path) -> str:
    """Three seconds of AS_OFF without a mission, then three of AS_DRIVING, for 2 s of which no wheel speed comes.

    Most messages are missing: it is not OK.
    """
    path = tmp_path / "run.log"
    lines = []
    for step in range(600):
        at_s = 1_700_000_000 + step / 100
        lines.append(f"({at_s:.6f}) can0 520#{(OFF if step < 300 else DRIVING).hex().upper()}\n")
        if not 350 <= step < 550:
            lines.append(f"({at_s + 0.001:.6f}) can0 525#0001000100010001\n")
        lines.append(f"({at_s + 0.002:.6f}) can0 510#{'0000000000000000' if step < 300 else '0060000000000000'}\n")
    path.write_text("".join(lines))
    return str(path)


def shown(capsys: pytest.CaptureFixture[str], *argv: str, status: int = 1) -> list[str]:
    assert main(["monitor", *argv]) == status
    return capsys.readouterr().out.splitlines()


def test_a_log_is_shown_as_it_stood_at_its_end(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, log)
    assert lines[0].startswith(" run.log   revision 2026")
    assert lines[0].endswith("6.0 s into the log")
    assert lines[1].startswith("● AS_DRIVING for 3.0 s  Go on  ASMS on  TSMS on  mode autonomous")
    assert "driving" in lines
    assert max(map(len, lines)) <= 80


def test_signals_can_be_added_to_lines_and_objects(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = shown(capsys, log, "--plain", "--signals", "AS_STATE,VCU2AI_Speeds.FL*")
    assert "| VCU2AI_Status.AS_STATE AS_DRIVING | VCU2AI_Speeds.FL_WHEEL_SPEED 256 rpm" in line
    (entry,) = (json.loads(each) for each in shown(capsys, log, "--json", "--signals", "*_Status.as_state"))
    assert entry["signals"] == {"VCU2AI_Status.AS_STATE": "AS_DRIVING"}


def test_findings_and_status_of_a_log_are_those_of_check(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", log]) == 1
    *lines, verdict = capsys.readouterr().out.splitlines()[1:]
    found = [line for line in lines if not line.startswith("    what to do")]
    gap = [line for line in found if "VCU2AI_Speeds (0x525) was silent" in line]
    assert len(gap) == 1 and gap[0].startswith("problem: at 3.491 s (22:13:23 UTC): ")
    (late,), (early,) = (map(json.loads, shown(capsys, log, "--json", *at)) for at in ((), ("--at", "3.2")))
    assert late["findings"] == [verdict.replace("verdict", "whole log"), *found]
    assert set(late["findings"]) - set(early["findings"]) == set(gap)
    text = " ".join(shown(capsys, log))
    assert all(one in text for one in late["findings"])


def test_without_textual_plain_lines_and_how_to_get_it(
    log: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "textual", None)
    assert main(["monitor", log]) == 1
    found = capsys.readouterr()
    assert found.err == "fsai-vcu monitor: for pages and keys: pip install 'fsai-vcu[monitor]'\n"
    assert found.out.startswith("6.0 s into the log | AS_DRIVING |") and found.out.count("\n") == 1


def test_textual_is_loaded_only_where_pages_are_shown(log: str) -> None:
    code = (
        "import sys; from fsai_vcu.cli.main import main\n"
        "for how in ('--plain', '--json'): assert main(['monitor', sys.argv[1], how]) == 1\n"
        "sys.exit(any(each in sys.modules for each in ('textual', 'rich')))"
    )
    assert subprocess.run([sys.executable, "-c", code, log], capture_output=True).returncode == 0


def test_a_moment_of_a_log_is_shown_with_what_stood_in_the_way(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = shown(capsys, log, "--at", "2", "--plain")
    assert shown(capsys, log, "--at", "22:13:22", "--plain") == [line]
    assert line.startswith("2.0 s into the log | AS_OFF | NOT_SELECTED |")
    assert "no mission is chosen on the AMI" in line


def test_a_log_is_played_a_line_for_each_second_of_it(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, log, "--rate", "0", "--plain")
    assert [line.split(" | ")[:2] for line in lines] == [
        ["1.0 s into the log", "AS_OFF"],
        ["2.0 s into the log", "AS_OFF"],
        ["3.0 s into the log", "AS_DRIVING"],
        ["4.0 s into the log", "AS_DRIVING"],
        ["5.0 s into the log", "AS_DRIVING"],
        ["6.0 s into the log", "AS_DRIVING"],
    ]


def test_several_logs_are_one_and_a_part_of_them_is_judged(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = Path(log).read_text().splitlines(keepends=True)
    logs = [str(tmp_path / name) for name in ("first.log", "second.log")]
    for path, some in zip(logs, (lines[:300], lines[300:]), strict=True):
        Path(path).write_text("".join(some))
    part = ("--from", "4.2", "--to", "5.9")
    assert main(["check", log, *part]) == 1
    verdict = capsys.readouterr().out.splitlines()[-1].replace("verdict", "part")
    assert main(["monitor", *logs, *part, "--rate", "0", "--plain"]) == 1
    first, last = capsys.readouterr().out.splitlines()
    assert first.startswith("5.2 s into the log | AS_DRIVING") and last.startswith("5.9 s into the log")
    assert verdict in last
    assert main(["monitor", log, "--from", "60", "--plain"]) == 1
    assert capsys.readouterr().err == f"fsai-vcu monitor: no frame of {log} is in the chosen part\n"


def test_played_at_a_rate_a_log_takes_its_time(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    begun_s = time.monotonic()
    lines = shown(capsys, log, "--rate", "10", "--every", "0.1", "--plain")
    assert len(lines) == 6
    assert time.monotonic() - begun_s >= 0.5


def test_json_is_one_object_for_each_look_with_the_promised_keys(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    entries = [json.loads(line) for line in shown(capsys, log, "--rate", "0", "--json", "--every", "2")]
    assert [entry["as_state"] for entry in entries] == ["AS_OFF", "AS_DRIVING", "AS_DRIVING"]
    promised = {
        "t", "channel", "revision", "as_state", "as_state_s", "mission", "mode", "go", "as_switch", "ts_switch",
        "driving", "why_not_driving", "wheels_rpm", "speed_mps", "actuators", "faults", "warnings", "shutdown_cause",
        "handshake", "load", "link", "messages",
    }  # fmt: skip
    assert entries[0].keys() >= promised
    assert entries[0]["t"] == pytest.approx(1_700_000_002.0)
    assert "no mission is chosen on the AMI" in [one["words"] for one in entries[0]["why_not_driving"]]
    messages = {message["id"]: message for message in entries[-1]["messages"]}
    assert messages[0x520]["freshness"] == "ok" and messages[0x511]["freshness"] == "never received"


def test_a_broken_log_is_shown_as_far_as_readable_and_fails(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    with Path(log).open("a") as file:
        file.write("garbage\n")
    assert main(["monitor", log, "--plain"]) == 1
    said = capsys.readouterr()
    assert "AS_DRIVING" in said.out
    assert "line 1601: not a line of candump" in said.err and said.err.count("\n") == 1


# ---------------------------------------------------------------- live


def test_a_live_bus_is_shown_and_nothing_is_ever_sent_on_it() -> None:
    name = f"loopback:monitor-{os.getpid()}"
    argv = [*VERB, name, "--json", "--every", "0.2", "--seconds", "300"]
    with talking(name, Frame(0x520, DRIVING)) as received, subprocess.Popen(argv, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        entries = map(json.loads, process.stdout)
        received_well = {"id": 0x520, "freshness": "ok"}.items()  # not so where the talker was held up
        entry = next(entry for entry in entries if any(received_well <= m.items() for m in entry["messages"]))
        assert (entry["as_state"], entry["driving"]) == ("AS_DRIVING", True)
        next(entries)
        process.send_signal(signal.SIGINT)
        assert process.wait(WITHIN_S) == 0
        assert received == []


def test_a_live_bus_is_shown_for_so_long(capsys: pytest.CaptureFixture[str]) -> None:
    (*_, last) = shown(capsys, f"loopback:monitor-silent-{os.getpid()}", "--json", "--seconds", "0.1", status=0)
    assert json.loads(last)["as_state"] is None


class Terminal:
    """The verb on a pseudo-terminal of 80 by 24."""

    def __init__(self, *argv: str, **environment: str) -> None:
        self.master, slave = pty.openpty()
        self.resize(80, 24)
        self.before = termios.tcgetattr(self.master)
        self.seen = ""
        self._text = codecs.getincrementaldecoder("utf-8")()  # a character may come in two pieces
        self.process = subprocess.Popen(
            [*VERB, *argv],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            env={**{k: v for k, v in os.environ.items() if k not in HIDDEN}, "TERM": "xterm", **environment},
        )
        os.close(slave)

    def resize(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def read(self, pattern: str) -> str:
        """What is shown from here on, until it has the pattern."""
        begin = len(self.seen)
        until_s = time.monotonic() + WITHIN_S
        while not re.search(pattern, self.seen[begin:]):
            assert time.monotonic() < until_s, f"{pattern} never came: {self.seen[-2000:]!r}"
            if select.select([self.master], [], [], 0.1)[0]:
                try:
                    self.seen += self._text.decode(os.read(self.master, 65536))
                except OSError:  # Linux's way to say that the other side is closed
                    break
        assert re.search(pattern, self.seen[begin:]), self.seen[-2000:]
        return self.seen[begin:]

    def type(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.master)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    found = Terminal(f"loopback:monitor-tty-{os.getpid()}")
    yield found
    found.close()


ENTER, LEAVE = re.escape("\x1b[?1049h"), re.escape("\x1b[?1049l")
NOTHING = "nothing is received on this bus"


def begun(terminal: Terminal) -> None:
    terminal.read(NOTHING)
    assert re.search(ENTER, terminal.seen)
    assert termios.tcgetattr(terminal.master)[3] & termios.ECHO == 0


def ended(terminal: Terminal, last: str = NOTHING, status: int = 0) -> None:
    """The terminal is as it was before."""
    terminal.read(f"{LEAVE}[^\x00]*{last}")  # the last picture stays to be read
    assert terminal.process.wait(WITHIN_S) == status
    assert termios.tcgetattr(terminal.master) == terminal.before
    assert terminal.seen.count("\x1b[?25l") <= terminal.seen.count("\x1b[?25h")  # the cursor


# In the tests below it is ended by its key, by that of Ctrl-C, and by Ctrl-C as a signal.
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGHUP])
def test_ended_from_outside_it_leaves_the_terminal_as_it_was(terminal: Terminal, how: signal.Signals) -> None:
    begun(terminal)
    if how is signal.SIGTERM:
        terminal.process.send_signal(signal.SIGCONT)  # as timeout does beside it, in case that it was stopped
    terminal.process.send_signal(how)
    ended(terminal)


def test_p_holds_the_picture_and_a_new_size_is_drawn(terminal: Terminal) -> None:
    begun(terminal)
    terminal.type("p")
    terminal.read("paused at [0-9:]+")
    terminal.type("p")
    terminal.read(r"listening only")
    terminal.resize(40, 14)
    terminal.process.send_signal(signal.SIGWINCH)  # as the kernel does for a controlling terminal
    terminal.read(r"\x1b\[14;1H[^\n]* q [^\n]* quit ")
    terminal.type("\x03")
    ended(terminal)


def test_while_it_is_stopped_the_terminal_is_given_back(terminal: Terminal) -> None:
    begun(terminal)
    os.kill(terminal.process.pid, signal.SIGTSTP)
    terminal.read(LEAVE)
    os.waitpid(terminal.process.pid, os.WUNTRACED)  # until it has stopped
    os.kill(terminal.process.pid, signal.SIGCONT)
    terminal.read(ENTER)
    terminal.process.send_signal(signal.SIGINT)
    ended(terminal)


def test_a_log_is_moved_in_and_no_color_is_honoured(log: str) -> None:
    terminal = Terminal(log, "--at", "1", NO_COLOR="1")
    try:
        terminal.read("1.0 of 6.0 s")
        terminal.type("n")
        terminal.read("AS_DRIVING")
        terminal.type("q")
        ended(terminal, "3.0 s into the log[^\x00]*AS_DRIVING", 1)
        assert terminal.seen[terminal.seen.index("\x1b[?1049l") :].count("\n") < 24
        assert not re.search(r"\x1b\[([\d;]*;)?[349][0-7](;[\d;]*)?m", terminal.seen)
    finally:
        terminal.close()


def test_a_terminal_that_can_do_nothing_gets_plain_lines(
    log: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for stream in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(f"sys.{stream}.isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")
    lines = shown(capsys, log, "--rate", "0")
    assert len(lines) == 6 and "\x1b" not in "".join(lines)
