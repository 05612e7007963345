"""ROS messages in a recording: raw, with their definitions, in a file that opens as a ROS 2 bag."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fsai_msgs.msg import RunState, VehicleCommand
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import deserialize_message
from ros_rig import PATIENCE_S, RosRig
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from fsai_nodes.qos import TOPICS
from fsai_nodes.recorder import PROJECT_TOPICS, TopicRecorder, class_of, definition_of
from fsai_vcu.diagnostics.export.mcap_file import McapTables, RosMessage
from fsai_vcu.runtime.bus import open_bus


@pytest.fixture
def recorder() -> Iterator[TopicRecorder]:
    started = TopicRecorder((*PROJECT_TOPICS, "/extra"))
    started.start()
    yield started
    started.stop()


def await_it(condition: Callable[[], bool], what: str) -> None:
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until, f"waited in vain: {what}"
        time.sleep(0.01)


def gather(recorder: TopicRecorder, topics: set[str], publish: Callable[[], None]) -> list[RosMessage]:
    """Publish again and again until something of each topic was received."""
    received: list[RosMessage] = []

    def all_received() -> bool:
        publish()
        received.extend(recorder.fetch())
        return {each.topic.name for each in received} == topics

    await_it(all_received, f"messages of {topics}")
    return received


def test_every_topic_of_the_project_is_recorded_by_default() -> None:
    assert set(TOPICS) < set(PROJECT_TOPICS)


def test_messages_are_recorded_raw_latched_ones_too(rig: RosRig, recorder: TopicRecorder) -> None:
    rig.tester.create_publisher(RunState, "/run_state", TOPICS["run_state"]).publish(RunState(run_id=7))
    command = rig.tester.create_publisher(VehicleCommand, "/vehicle_cmd", TOPICS["vehicle_cmd"])
    said = VehicleCommand(run_id=7, throttle=0.25)
    received = gather(recorder, {"/run_state", "/vehicle_cmd"}, lambda: command.publish(said))
    by_topic = {each.topic.name: each for each in received}
    assert deserialize_message(by_topic["/run_state"].data, RunState).run_id == 7
    assert deserialize_message(by_topic["/vehicle_cmd"].data, VehicleCommand) == said
    assert by_topic["/vehicle_cmd"].topic.type_name == "fsai_msgs/msg/VehicleCommand"
    now_ns = time.time_ns()
    assert all(0 < each.published_ns <= each.log_ns <= now_ns for each in received)


def test_topics_that_nobody_asked_for_are_left_alone(rig: RosRig, recorder: TopicRecorder) -> None:
    extra = rig.tester.create_publisher(String, "/extra", 1)
    other = rig.tester.create_publisher(String, "/other", 1)

    def publish() -> None:
        extra.publish(String(data="recorded"))
        other.publish(String(data="not recorded"))

    gather(recorder, {"/extra"}, publish)
    assert recorder.topics == ["/extra"]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_receiver_that_fails_is_said_once(recorder: TopicRecorder, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ArithmeticError("of the test")

    assert recorder.news() == []
    monkeypatch.setattr(recorder._executor, "spin_once", fails)
    recorder._thread.join()
    assert recorder.news() == ["ROS messages are not recorded any more: ArithmeticError('of the test')"]
    assert recorder.news() == []


def test_a_definition_has_every_type_in_it() -> None:
    text = definition_of("nav_msgs/msg/Path")
    parts = text.split("=" * 80 + "\n")
    assert [part.splitlines()[0] for part in parts[1:]] == [
        f"MSG: {name}"
        for name in (
            "std_msgs/Header",
            "geometry_msgs/PoseStamped",
            "builtin_interfaces/Time",
            "geometry_msgs/Pose",
            "geometry_msgs/Point",
            "geometry_msgs/Quaternion",
        )
    ]
    with pytest.raises(LookupError, match="there is no definition of nav_msgs/msg/Nothing"):
        definition_of("nav_msgs/msg/Nothing")


@pytest.mark.parametrize(
    "name", ["", "Type", "a/b", "a/b/c/d", "../msg/Type", "/msg/Type", "os/path/join", "std_msgs/msg/\x1b", "x" * 9999]
)
def test_a_type_that_is_none_of_ros_is_said_in_words(name: str) -> None:
    with pytest.raises(LookupError) as refused:
        class_of(name)
    assert "is not a ROS type" in str(refused.value) and str(refused.value).isprintable()
    assert len(str(refused.value)) < 200


def test_a_recorded_message_is_read_by_its_own_definition(rig: RosRig, recorder: TopicRecorder, tmp_path: Path) -> None:
    path = rig.tester.create_publisher(PathMessage, "/path", TOPICS["path"])
    said = PathMessage(poses=[PoseStamped(), PoseStamped()])
    said.poses[1].pose.position.x = 2.5
    (first, *_) = gather(recorder, {"/path"}, lambda: path.publish(said))
    stream = io.BytesIO()
    tables = McapTables(stream)
    tables.write_message(first)
    tables.finish()
    bag_path = tmp_path / "run.mcap"
    bag_path.write_bytes(stream.getvalue())
    with AnyReader([bag_path]) as bag:
        (connection,) = bag.connections
        assert (connection.topic, connection.msgtype) == ("/path", "nav_msgs/msg/Path")
        ((_, taken_ns, data),) = list(bag.messages())
        read = bag.deserialize(data, connection.msgtype)
    assert taken_ns == first.log_ns
    assert read.poses[1].pose.position.x == 2.5  # type: ignore[attr-defined]


def test_record_puts_frames_and_ros_messages_into_one_bag(rig: RosRig, tmp_path: Path) -> None:
    bus = f"loopback:ros-record-{os.getpid()}"
    argv = [sys.executable, "-m", "fsai_vcu.cli.main", "record", "-i", bus, "-o", str(tmp_path / "run.log")]
    process = subprocess.Popen([*argv, "--mcap", "--ros"], stderr=subprocess.PIPE, text=True)
    command = rig.tester.create_publisher(VehicleCommand, "/vehicle_cmd", TOPICS["vehicle_cmd"])
    log, mcap = tmp_path / "run.log", tmp_path / "run.mcap"
    try:
        from fsai_vcu.interface.frames import Frame

        with open_bus(bus) as ours:

            def both_are_there() -> bool:
                ours.send(Frame(0x523, bytes(6)))
                command.publish(VehicleCommand(run_id=3))
                assert process.poll() is None, process.communicate()[1]
                return log.exists() and log.stat().st_size > 0 and b"vehicle_cmd" in _topics(mcap)

            await_it(both_are_there, "frames and messages in the file")
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=PATIENCE_S)[1]
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, said
    assert " ROS messages in " in said
    with AnyReader([mcap]) as bag:
        assert {connection.topic for connection in bag.connections} == {
            f"/{bus.partition(':')[2].replace('-', '_')}/VCU2AI_Steer",
            "/vehicle_cmd",
        }


def _topics(mcap: Path) -> bytes:
    """Names of the topics in an MCAP that is being written."""
    from mcap.reader import NonSeekingReader

    names = []
    if mcap.exists():
        try:
            for _, channel, _ in NonSeekingReader(io.BytesIO(mcap.read_bytes())).iter_messages(log_time_order=False):
                names.append(channel.topic.encode())
        except Exception as error:  # it has no end yet
            assert not isinstance(error, AssertionError)
    return b" ".join(names)
