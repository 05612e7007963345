"""What RViz and Foxglove are given: markers of what the nodes say, the car's model, and its frames."""

from __future__ import annotations

import math
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
import yaml
from builtin_interfaces.msg import Time
from fsai_msgs.msg import Cone, ConeArray, PlannerStatus, VehicleState
from nav_msgs.msg import Path
from ros_rig import RosRig, ScriptedVcu
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from fsai_nodes import qos
from fsai_nodes.clocks import Clocks
from fsai_nodes.conversions import path_to_msg
from fsai_nodes.scene import Scene, remembered
from fsai_nodes.vcu_bridge import VcuBridge
from fsai_nodes.visualization import RGB, Visualization, driven_marker, path_markers
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026 as CAR
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.messages import VcuStatus, WheelSpeeds

PACKAGE = FilePath(__file__).parents[2] / "nodes" / "fsai_nodes"


def by_name(markers: MarkerArray) -> dict[str, Marker]:
    return {marker.ns: marker for marker in markers.markers}


def rgb(color: Any) -> tuple[float, ...]:
    return tuple(round(value, 3) for value in (color.r, color.g, color.b))


def test_cones_are_seen_in_their_colours_and_then_remembered(rig: RosRig) -> None:
    rig.start(Visualization, rate_hz=30.0)
    received = rig.subscribe(MarkerArray, "/markers", qos.VIEW)
    states = rig.tester.create_publisher(VehicleState, "/vehicle_state", qos.STATE)
    cones = rig.tester.create_publisher(ConeArray, "/detected_cones", qos.SENSOR)
    raw = rig.tester.create_publisher(ConeArray, "/raw_cones", qos.SENSOR)

    def at(run_id: int, x: float) -> Time:
        """The car is there; when."""
        state = VehicleState(run_id=run_id, x=x, as_state_label="AS_DRIVING")
        state.header.stamp = rig.stamp()
        states.publish(state)
        rig.turns()
        return state.header.stamp

    def published(run_id: int, x: float, *seen: Cone) -> dict[str, Marker]:
        array = ConeArray(cones=list(seen))
        array.header.stamp = at(run_id, x)
        cones.publish(array)
        raw.publish(array)
        return by_name(received[-1]) if received else {}

    pair = Cone(x=4.0, y=1.5, color=Cone.BLUE, confidence=0.9), Cone(x=4.0, y=-1.5, color=Cone.YELLOW, confidence=0.9)
    rig.spin_until(lambda: len(published(7, 10.0, *pair).get("cones", Marker()).points) == 2, "two cones")
    now = by_name(received[-1])
    assert [(p.x, p.y) for p in now["cones"].points] == [(4.0, 1.5), (4.0, -1.5)]
    assert now["raw cones"].points == now["cones"].points and now["raw cones"].scale.x < now["cones"].scale.x
    assert [rgb(c) for c in now["cones"].colors] == [RGB[ConeColor.BLUE], RGB[ConeColor.YELLOW]]
    assert "AS_DRIVING" in now["words"].text and len(now["car"].points) == 5

    at(7, 10.0)  # still: to where it is next, nothing has moved when the cones were seen, by whatever clock

    def gone() -> bool:
        now = published(7, 20.0)
        return now["cones"].action == Marker.DELETE and len(now["remembered cones"].points) == 2

    rig.spin_until(gone, "what is behind the car is remembered")
    before = by_name(received[-1])["remembered cones"]
    assert before.header.frame_id == "odom"
    for point, y in zip(before.points, (1.5, -1.5), strict=True):
        assert (point.x, point.y) == pytest.approx((14.0, y), abs=1e-3)
    driven = by_name(received[-1])["driven"]
    assert [(p.x, driven.header.frame_id) for p in driven.points] == [(10.0, "odom"), (20.0, "odom")]
    rig.spin_until(lambda: not published(8, 0.0)["remembered cones"].points, "a new run has no cones")


def test_a_cone_seen_again_is_one_cone() -> None:
    def seen(x: float, color: ConeColor) -> ConeObservation:
        return ConeObservation(0, np.array([[x, 1.0]]), np.array([int(color)]), np.array([1.0]))

    cones = remembered(np.empty((0, 3)), Motion(x_m=1.0), seen(5.0, ConeColor.UNKNOWN))
    cones = remembered(cones, Motion(x_m=2.0), seen(4.2, ConeColor.BLUE))
    assert cones.tolist() == [[6.2, 1.0, float(ConeColor.BLUE)]]
    assert len(remembered(cones, Motion(x_m=4.0), seen(5.0, ConeColor.BLUE))) == 2


def test_what_was_on_its_way_in_a_new_run_is_of_the_last(rig: RosRig) -> None:
    scene = Scene(Clocks(rig.tester))

    def comes(message: Any, age_ms: float) -> Any:
        message.header.stamp = rig.stamp(age_ms)
        return message

    def cones_and_path(age_ms: float) -> tuple[int, int, int]:
        """Cones remembered and seen, and points of the path."""
        scene.on_cones(comes(ConeArray(cones=[Cone(x=4.0)]), age_ms))
        scene.on_path(comes(path(0.0, 2.0), age_ms))
        return len(scene.remembered), len(scene.seen.xy_m), len(scene.path.poses)

    scene.on_state(comes(VehicleState(run_id=7), 1000.0))
    assert cones_and_path(900.0) == (1, 1, 2)
    scene.on_state(comes(VehicleState(run_id=8), 500.0))
    assert cones_and_path(600.0) == (0, 0, 0)
    assert cones_and_path(400.0) == (1, 1, 2)


def test_the_way_driven_is_blue_where_slow_and_red_where_fast() -> None:
    line = driven_marker(Header(), [(0.0, 0.0, 0.0), (1.0, 0.0, 7.5), (2.0, 0.0, 20.0)])
    assert [rgb(color) for color in line.colors] == [(0.0, 0.2, 1.0), (0.5, 0.2, 0.5), (1.0, 0.2, 0.0)]
    assert driven_marker(Header(), [(0.0, 0.0, 0.0)]).action == Marker.DELETE


def path(*x: float) -> Path:
    return path_to_msg(np.array([(each, 0.0) for each in x]), VehicleState().header.stamp)


def test_a_path_is_as_green_as_it_is_sure_and_pale_unsupported() -> None:
    status = PlannerStatus(confidence=0.25, supported_m=4.0, stop_distance_m=math.nan)
    line, stop = path_markers(path(0.0, 2.0, 4.0, 6.0), status)
    assert [point.x for point in line.points] == [0.0, 2.0, 4.0, 6.0]
    assert rgb(line.colors[0]) == (0.75, 0.2, 0.1)
    assert [round(color.a, 1) for color in line.colors] == [1.0, 1.0, 1.0, 0.3]
    assert stop.action == Marker.DELETE and line.action == Marker.ADD


def test_the_place_to_stop_at_is_on_the_path() -> None:
    status = PlannerStatus(stop_distance_m=4.0)
    _, stop = path_markers(path(0.0, 2.0, 4.0, 6.0), status)
    assert (stop.action, stop.pose.position.x) == (Marker.ADD, 4.0)
    for none in (math.nan, 7.0):
        assert path_markers(path(0.0, 6.0), PlannerStatus(stop_distance_m=none))[1].action == Marker.DELETE
    assert {each.action for each in path_markers(Path(), status)} == {Marker.DELETE}


def test_model_and_fixed_frames_are_there_for_who_comes_later(rig: RosRig) -> None:
    rig.start(Visualization)
    rig.turns()
    models = rig.subscribe(String, "/robot_description", qos.STATE)
    frames = rig.subscribe(TFMessage, "/tf_static", qos.FRAMES["/tf_static"])
    rig.spin_until(lambda: bool(models and frames), "model and frames")
    at = {each.child_frame_id: each.transform.translation for each in frames[0].transforms}
    assert {"imu_link", "gps_link", "camera_link"} < set(at)
    assert {each.header.frame_id for each in frames[0].transforms} == {"base_link"}
    wheel = at["front_right_wheel"]
    assert (wheel.x, wheel.y, wheel.z) == (CAR.wheelbase_m, -CAR.track_m / 2, CAR.rolling_radius_m)
    assert f'size="{CAR.length_m} ' in models[0].data and f'radius="{CAR.rolling_radius_m}"' in models[0].data


def test_the_bridge_sends_where_the_car_is_on_tf(rig: RosRig, bus: str) -> None:
    with ScriptedVcu(bus, VcuStatus(as_state=AsState.AS_OFF, ami=Ami.TRACKDRIVE)) as vcu:
        vcu.speeds = WheelSpeeds(0, 0, 0, 0)
        rig.start(VcuBridge, can_interface=bus, real_time=False)
        received = rig.subscribe(TFMessage, "/tf", qos.FRAMES["/tf"])
        rig.spin_until(lambda: bool(received), "odom -> base_link")
    (transform,) = received[0].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
    assert transform.transform.rotation.w == 1.0 and transform.header.stamp.sec > 0


@pytest.mark.parametrize("topic", ["/markers", "/robot_description"])
def test_the_rviz_view_shows_topics_that_there_are(topic: str) -> None:
    view = yaml.safe_load((PACKAGE / "rviz" / "fsai.rviz").read_text())["Visualization Manager"]
    shown = {
        display[key]["Value"]: display[key]
        for display in view["Displays"]
        for key in ("Topic", "Description Topic")
        if key in display
    }
    assert view["Global Options"]["Fixed Frame"] == "odom" and {name[1:] for name in shown} <= set(qos.TOPICS)
    wanted = qos.TOPICS[topic[1:]]
    words = {"Volatile": "VOLATILE", "Transient Local": "TRANSIENT_LOCAL"}
    assert words[shown[topic]["Durability Policy"]] == wanted.durability.name
