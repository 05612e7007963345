"""The link script with a stand-in for `ip`: what vcan cannot show (bitrate, restart-ms, bus-off)."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import pytest
from install_rig import CHECKOUT

LINK = CHECKOUT / "systemd" / "link"

# An adapter as a folder: `state` is what `ip -details link show` says; `refuses` is there for one without restart-ms.
FAKE_IP = """#!/bin/sh
here=${0%/*}
echo "$*" >> $here/calls
case "$*" in
  "-details link show"*) cat $here/state ;;
  "link show dev can0 up") grep -q "<.*UP" $here/state && cat $here/state; true ;;
  "-o monitor"*) cat $here/monitor ;;
  *restart-ms*) if [ -e $here/refuses ]; then echo "RTNETLINK answers: Operation not supported" >&2; exit 2; fi
    sed -i "s/bitrate [0-9]*/bitrate 500000/; s/restart-ms [0-9]*/restart-ms 100/" $here/state ;;
  *"type can bitrate"*) sed -i "s/bitrate [0-9]*/bitrate 500000/" $here/state ;;
  *" up") sed -i "s/<NOARP>/<NOARP,UP>/; s/state [A-Z-]*/state ERROR-ACTIVE/" $here/state ;;
  *" down") sed -i "s/<NOARP,UP>/<NOARP>/" $here/state ;;
esac
"""
DOWN = "3: can0: <NOARP> mtu 16\n    can state STOPPED restart-ms 0 \n\tbitrate 250000 sample-point 0.875\n"
RIGHT = "3: can0: <NOARP,UP> mtu 16\n    can state ERROR-ACTIVE restart-ms 100 \n\tbitrate 500000 sample-point 0.875\n"
BUS_OFF = "3: can0: <NOARP,UP> mtu 16\n    can state BUS-OFF restart-ms 0 \n\tbitrate 500000 sample-point 0.875\n"


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    (tmp_path / "ip").write_text(FAKE_IP)
    (tmp_path / "ip").chmod(0o755)
    (tmp_path / "systemctl").write_text("#!/bin/sh\nexit 3\n")  # networkd does not run
    (tmp_path / "systemctl").chmod(0o755)
    return tmp_path


def link(adapter: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [LINK, *words],
        env={"PATH": os.environ["PATH"], "FSAI_LINK_PATH": str(adapter)},
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )


def calls(adapter: Path) -> list[str]:
    return (adapter / "calls").read_text().splitlines()


def test_a_link_that_is_down_comes_up_with_the_cars_bitrate_a_short_queue_and_restart(adapter: Path) -> None:
    (adapter / "state").write_text(DOWN)
    assert link(adapter, "up", "can0").returncode == 0
    state = (adapter / "state").read_text()
    assert "UP" in state and "bitrate 500000" in state and "restart-ms 100" in state
    assert "link set dev can0 txqueuelen 10 up" in calls(adapter)


def test_an_adapter_that_refuses_restart_comes_up_without_and_says_so(adapter: Path) -> None:
    (adapter / "state").write_text(DOWN)
    (adapter / "refuses").touch()
    done = link(adapter, "up", "can0")
    assert done.returncode == 0
    assert "refuses restart-ms" in done.stdout
    assert "bitrate 500000" in (adapter / "state").read_text()


def test_a_link_that_is_right_already_is_not_taken_down(adapter: Path) -> None:
    (adapter / "state").write_text(RIGHT)
    assert link(adapter, "up", "can0").returncode == 0
    assert not any(call.endswith("down") for call in calls(adapter))
    assert "link set dev can0 txqueuelen 10" in calls(adapter)


def test_an_adapter_that_does_not_restart_itself_is_restarted_after_bus_off(adapter: Path) -> None:
    (adapter / "state").write_text(BUS_OFF)
    (adapter / "monitor").write_text("3: can0: <NO-CARRIER,NOARP,UP>\n")
    assert link(adapter, "watch", "can0").returncode == 0
    assert "ERROR-ACTIVE" in (adapter / "state").read_text()
    assert calls(adapter)[-2:] == ["link set dev can0 down", "link set dev can0 up"]


def test_an_adapter_that_restarts_itself_is_left_alone(adapter: Path) -> None:
    (adapter / "state").write_text(RIGHT)
    process = subprocess.Popen(
        [LINK, "watch", "can0"], env={"PATH": os.environ["PATH"], "FSAI_LINK_PATH": str(adapter)}
    )
    try:
        until = time.monotonic() + 10.0
        while "sleep" not in Path(f"/proc/{process.pid}/cmdline").read_text():
            assert time.monotonic() < until, "it does not rest"
        assert not any("set" in call for call in calls(adapter))
    finally:
        process.kill()
        process.wait()


def test_wrong_use_is_told(adapter: Path) -> None:
    done = link(adapter, "up")
    assert done.returncode == 2 and done.stderr.startswith("usage: ")
