"""fsai-vcu mode, emergency-brake, reset, status: what they ask of a bridge, and the line when nobody answers."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.cli.services import ASK_AGAIN_S
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.messages import VcuStatus
from fsai_vcu.runtime.bus import open_bus

LONG_S = 60.0
WAITING = "Ctrl-C ends it\n"


@pytest.fixture
def bridge(bus: str) -> Iterator[subprocess.Popen[bytes]]:
    """A bridge in the namespace /car1 that sends."""
    argv = [sys.executable, "-m", "fsai_nodes.vcu_bridge", "--ros-args", "-p", f"can_interface:={bus}"]
    with open_bus(bus) as listener:
        process = subprocess.Popen([*argv, "-r", "__ns:=/car1"], stderr=subprocess.DEVNULL)
        until = time.monotonic() + LONG_S
        while listener.recv(0.1) is None:
            assert time.monotonic() < until, "the bridge never sent"
    yield process
    process.send_signal(signal.SIGTERM)
    process.wait(LONG_S)


def test_the_emergency_brake_is_asked_for_and_reset_by_verbs(
    bridge: subprocess.Popen[bytes], bus: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from ros_rig import ScriptedVcu, held_up

    def verb(*arguments: str, namespace: str = "/car1") -> tuple[int, str, str]:
        for _ in range(20):
            said = (main([*arguments, "--namespace", namespace, "--wait", f"{LONG_S:g}"]), *capsys.readouterr())
            if not held_up(said[1] + said[2]):
                break
        status, out, err = said  # a busy machine lets the verb wait, which it says on lines of their own
        return status, out, "".join(line for line in err.splitlines(True) if not line.endswith(WAITING))

    state = json.loads(verb("status", "--json")[1])
    assert (state["mode"], state["status_age_s"]) == ("manual", None)
    assert any("0x520" in condition for condition in state["why_not_driving"])
    told = json.loads(verb("emergency-brake", "--json")[1])
    again = "already latched because the emergency brake was asked for: by /emergency_brake"  # a first answer was lost
    assert told in [{"success": True, "message": words} for words in ("ESTOP_REQUEST is latched", again)]
    status, out, err = verb("reset")  # no car has said its AS state
    assert (status, out, err.count("\n")) == (1, "", 1) and err.startswith("reset refused: ")
    with ScriptedVcu(bus, VcuStatus(as_state=AsState.AS_OFF)) as car:
        assert json.loads(verb("status", "--json", namespace="car1")[1])["emergency"]
        assert car.hears(lambda said: said.estop_request)
        status, out, err = verb("reset", "--json")
        assert (status, err) == (0, "") and json.loads(out).keys() == {"success", "message"}
        assert car.hears(lambda said: not said.estop_request)
        told = json.loads(verb("mode", "autonomous", "--json")[1])
        assert told.keys() == {"mode", "success", "message"} and told["mode"] == "autonomous"


def test_a_bridge_that_hangs_is_said_within_the_deadline(bus: str) -> None:
    from ros_rig import RosRig

    from fsai_nodes.vcu_bridge import VcuBridge

    with RosRig() as rig:
        rig.start(VcuBridge, can_interface=bus, real_time=False)
        for wait in ("4", "10", f"{LONG_S:g}"):  # a held up machine may not find the service in time
            argv = [sys.executable, "-m", "fsai_vcu.cli.main", "reset", "--wait", wait]
            said = subprocess.run(argv, capture_output=True, text=True)  # meanwhile nobody lets the node answer
            if "no bridge offers" not in said.stderr:
                break
    assert said.returncode == 1
    words = f"the bridge offers /reset, but did not answer within {wait} s; does it hang?"
    assert said.stderr.splitlines()[-1] == f"fsai-vcu reset: {words}"


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["mode", "manual"], "fsai-vcu mode: no bridge offers /set_mode (waited 0.5 s); is vcu_bridge running"),
        (["emergency-brake"], "fsai-vcu emergency-brake: no bridge offers /emergency_brake (waited 0.5 s)"),
        (["reset", "--namespace", "/car2"], "fsai-vcu reset: no bridge offers /car2/reset (waited 0.5 s)"),
        (["status", "--namespace", "/car2"], "fsai-vcu status: nothing on /car2/vehicle_state for 0.5 s"),
        (["reset", "--namespace", "car two"], "fsai-vcu reset: --namespace car two is not a ROS namespace"),
    ],
)
def test_without_a_bridge_every_verb_says_so_in_one_line(
    argv: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*argv, "--wait", "0.5"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(words) and said.err.count("\n") == 1, said.err


def test_status_without_any_node_does_not_wait_for_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "100")  # that of no other test
    assert main(["status"]) == 1
    words = "no ROS node runs here, on ROS_DOMAIN_ID 100; --wait S waits for one"
    words += ", and fsai-vcu monitor shows a bus without ROS"
    assert capsys.readouterr().err == f"fsai-vcu status: {words}\n"


def test_status_waits_for_a_node_that_discovery_finds_late(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "100")
    monkeypatch.setattr("fsai_vcu.cli.services._STATE_S", 2.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:  # a node's port, and nothing is heard of its node
        late.bind(("127.0.0.1", 7400 + 250 * 100 + 10 + 2 * 7))
        assert main(["status"]) == 1
    waiting, given_up = capsys.readouterr().err.splitlines()
    assert waiting == "waiting for /vehicle_state, 2 s at most"
    assert given_up.startswith("fsai-vcu status: nothing on /vehicle_state for 2 s; is vcu_bridge")


@pytest.mark.parametrize("name", ["reset", "status"])
def test_ctrl_c_ends_the_waiting(name: str) -> None:
    argv = [sys.executable, "-m", "fsai_vcu.cli.main", name, "--wait", "3600"]
    from ros_rig import RosRig

    with RosRig() as rig, subprocess.Popen(argv, stderr=subprocess.PIPE, text=True) as process:
        rig.spin_until(lambda: "fsai_operator" in rig.tester.get_node_names(), "the verb's node", LONG_S)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=LONG_S)
    assert (process.returncode, said.splitlines()[-1]) == (130, f"fsai-vcu {name}: interrupted")


def asking(*words: str) -> subprocess.Popen[str]:
    argv = [sys.executable, "-m", "fsai_vcu.cli.main", "emergency-brake", *words]
    return subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_an_emergency_brake_asks_until_a_slow_loop_answers(bus: str) -> None:
    from ros_rig import RosRig

    from fsai_nodes.vcu_bridge import VcuBridge

    with RosRig() as rig:
        bridge = rig.start(VcuBridge, can_interface=bus, real_time=False)
        os.kill(bridge._loop.pid, signal.SIGSTOP)
        with asking() as process:
            rig.spin_until(lambda: "does not answer" in bridge._last_answer, "the loop's silence", LONG_S)
            os.kill(bridge._loop.pid, signal.SIGCONT)
            rig.spin_until(lambda: process.poll() is not None, "the verb's end", LONG_S)
            said = process.communicate()[0]
    assert process.returncode == 0 and "latched" in said


def test_an_emergency_brake_that_gives_up_says_on_whom(bus: str) -> None:
    from ros_rig import RosRig

    from fsai_nodes.vcu_bridge import VcuBridge

    with RosRig() as rig:
        bridge = rig.start(VcuBridge, can_interface=bus, real_time=False)
        os.kill(bridge._loop.pid, signal.SIGSTOP)
        for wait_s in (5.0, LONG_S):  # a held up machine may not find the service in time
            with asking("--wait", f"{wait_s:g}") as process:
                rig.spin_until(lambda process=process: process.poll() is not None, "the verb's end", 3 * LONG_S)
                said = process.communicate()
            if said[1].endswith("\nthe CAN loop does not answer\n"):
                break
        os.kill(bridge._loop.pid, signal.SIGCONT)  # it ends in order
    assert (process.returncode, said[0], said[1].splitlines()[-1]) == (1, "", "the CAN loop does not answer")


def test_an_emergency_brake_asks_until_a_slow_bridge_answers() -> None:
    from ros_rig import RosRig
    from std_srvs.srv import Trigger

    def answered(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        time.sleep(1.5 * ASK_AGAIN_S)
        response.success, response.message = True, "latched"
        return response

    with RosRig() as rig, asking() as process:
        assert process.stderr is not None and process.stdout is not None
        try:
            said = process.stderr.readline()
            assert said.startswith("PRESS THE REMOTE'S E-STOP: no bridge offers /emergency_brake; asking for ")
            rig.tester.create_service(Trigger, "emergency_brake", answered)
            rig.spin_until(lambda: process.poll() is not None, "the answer", LONG_S)
        finally:
            process.kill()
        assert (process.returncode, process.stdout.read()) == (0, "latched\n")
