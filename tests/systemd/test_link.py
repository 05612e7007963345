"""The link script with a stand-in for `ip`: what vcan cannot show (bitrate, restart-ms, bus-off)."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from install_rig import CHECKOUT

LINK = CHECKOUT / "systemd" / "link"

# An adapter as a folder: `state` is what `ip -details link show` says; `refuses` is there for one without restart-ms.
# Nothing here reports a change by itself, as gs_usb does not.
FAKE_IP = """#!/bin/sh
here=${0%/*}
echo "$*" >> $here/calls
case "$*" in
  "-details link show"*) cat $here/state ;;
  "link show dev can0 up") grep -q "<.*UP" $here/state && cat $here/state; true ;;
  *restart-ms*) if [ -e $here/refuses ]; then echo "RTNETLINK answers: Operation not supported" >&2; exit 2; fi
    sed -i "s/bitrate [0-9]*/bitrate 500000/; s/restart-ms [0-9]*/restart-ms 100/" $here/state ;;
  *"type can bitrate"*) sed -i "s/bitrate [0-9]*/bitrate 500000/" $here/state ;;
  *" up") sed -i "s/<NOARP>/<NOARP,UP>/; s/state [A-Z-]*/state ERROR-ACTIVE/" $here/state ;;
  *" down") sed -i "s/<NOARP,UP>/<NOARP>/" $here/state ;;
esac
"""
# Whatever is waited for, a look later the adapter is in the state of the next file `then.*`; after the last it is gone.
FAKE_SLEEP = """#!/bin/sh
here=${0%/*}
echo "sleep $*" >> $here/calls
for next in $here/then.*; do
  if [ -e "$next" ]; then exec mv $next $here/state; fi
done
rm -f $here/state
"""
DOWN = "3: can0: <NOARP> mtu 16\n    can state STOPPED restart-ms 0 \n\tbitrate 250000 sample-point 0.875\n"
RIGHT = "3: can0: <NOARP,UP> mtu 16\n    can state ERROR-ACTIVE restart-ms 100 \n\tbitrate 500000 sample-point 0.875\n"
BUS_OFF = RIGHT.replace("ERROR-ACTIVE", "BUS-OFF")
VIRTUAL = "3: vcan0: <NOARP,UP> mtu 72\n    vcan \n"
RESTART = ["link set dev can0 down", "link set dev can0 up"]


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    no_networkd = "#!/bin/sh\nexit 3\n"
    for tool, script in (("ip", FAKE_IP), ("sleep", FAKE_SLEEP), ("systemctl", no_networkd)):
        (tmp_path / tool).write_text(script)
        (tmp_path / tool).chmod(0o755)
    return tmp_path


def link(adapter: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [LINK, *words],
        env={"PATH": os.environ["PATH"], "FSAI_LINK_PATH": str(adapter)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def calls(adapter: Path) -> list[str]:
    return (adapter / "calls").read_text().splitlines()


def test_a_link_comes_up_with_bitrate_short_queue_and_restart(adapter: Path) -> None:
    (adapter / "state").write_text(DOWN)
    assert link(adapter, "up", "can0").returncode == 0
    state = (adapter / "state").read_text()
    assert "UP" in state and "bitrate 500000" in state and "restart-ms 100" in state
    assert "link set dev can0 txqueuelen 10 up" in calls(adapter)


def test_an_adapter_that_refuses_restart_comes_up_without(adapter: Path) -> None:
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


def watched(adapter: Path, *states: str) -> list[str]:
    """What is done to an adapter that is in these states, look by look, and then unplugged."""
    (adapter / "state").write_text(RIGHT)
    for number, state in enumerate(states):
        (adapter / f"then.{number}").write_text(state)
    done = link(adapter, "watch", "can0")
    assert done.returncode == 0, "it ends with the interface"
    found = [call for call in calls(adapter) if " set " in call]
    assert done.stdout.count("bus-off") == len(found) / len(RESTART), "each restart is reported"
    return found


@pytest.mark.parametrize("restart_ms", [0, 100])
def test_an_adapter_that_stays_off_the_bus_is_restarted(adapter: Path, restart_ms: int) -> None:
    off = BUS_OFF.replace("restart-ms 100", f"restart-ms {restart_ms}")
    assert watched(adapter, RIGHT, off, off, RIGHT, RIGHT) == RESTART
    assert set(calls(adapter)) >= {"sleep 1"}, "it looks once a second"


def test_an_adapter_is_restarted_after_each_bus_off(adapter: Path) -> None:
    assert watched(adapter, *[BUS_OFF] * 4) == RESTART * 2


def test_an_adapter_that_restarts_itself_is_left_alone(adapter: Path) -> None:
    assert watched(adapter, BUS_OFF, RIGHT, BUS_OFF, RIGHT) == []


def test_a_virtual_interface_is_not_looked_at_again(adapter: Path) -> None:
    (adapter / "state").write_text(VIRTUAL)
    assert link(adapter, "watch", "vcan0").returncode == 0
    assert calls(adapter) == ["-details link show dev vcan0", "sleep infinity"]


def test_wrong_use_is_reported(adapter: Path) -> None:
    done = link(adapter, "up")
    assert done.returncode == 2 and done.stderr.startswith("usage: ")
