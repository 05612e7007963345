"""visualization: /markers of cones, path and car, the car's model and its frames, for RViz and Foxglove.

It only listens: no other node waits for it or reads what it publishes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from importlib.resources import files
from xml.etree import ElementTree

import numpy as np
from builtin_interfaces.msg import Duration, Time
from fsai_msgs.msg import ConeArray, PlannerStatus, VehicleState
from geometry_msgs.msg import Point, TransformStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from std_msgs.msg import ColorRGBA, Header, String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from fsai_nodes.clocks import Clocks
from fsai_nodes.conversions import BASE_FRAME, ODOM_FRAME, cones_from_msg
from fsai_nodes.door import Door
from fsai_nodes.parameters import NodeParameter, Settings
from fsai_nodes.process import run
from fsai_nodes.qos import publisher
from fsai_nodes.scene import Scene
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.planning.pose import lengths_along
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026 as CAR

SETTINGS = (
    NodeParameter("rate_hz", 10.0, "How often markers are published while somebody looks, in Hz.", low=1.0, high=30.0),
)
FAST_MPS = 15.0
SHOWN_S = 0.5  # cones and path without news disappear

RGB = {
    ConeColor.UNKNOWN: (0.6, 0.6, 0.6),
    ConeColor.BLUE: (0.1, 0.35, 0.9),
    ConeColor.YELLOW: (0.95, 0.8, 0.0),
    ConeColor.ORANGE: (1.0, 0.55, 0.1),
    ConeColor.BIG_ORANGE: (0.9, 0.3, 0.0),
}


class Visualization(Node):
    """Draws the scene while somebody looks."""

    def __init__(self, **options: object) -> None:
        """Subscribe to what is drawn, and publish the car's model and its fixed frames once."""
        super().__init__("visualization", **options)
        self._settings = Settings(self, SETTINGS, lambda _name: None)
        self._clocks = Clocks(self)
        self._scene = scene = Scene(self._clocks)
        self._markers = publisher(self, MarkerArray, "markers")
        self._frames = publisher(self, TFMessage, "/tf_static")
        self._model = publisher(self, String, "robot_description")
        door = Door(self)
        door.subscription(VehicleState, "vehicle_state", scene.on_state)
        door.subscription(ConeArray, "raw_cones", scene.on_raw_cones)
        door.subscription(ConeArray, "detected_cones", scene.on_cones)
        door.subscription(PlannerStatus, "planner_status", scene.on_status)
        door.subscription(Path, "path", scene.on_path)
        self._clocks.watch()
        model = files("fsai_nodes").joinpath("fsai.urdf").read_text(encoding="utf-8")
        self._model.publish(String(data=model))
        stamp = self._clocks.stamp_of(self._clocks.now_ns())
        self._frames.publish(TFMessage(transforms=static_frames(model, stamp)))
        self._clocks.every(1.0 / self._settings.number("rate_hz"), self._publish)

    def _publish(self) -> None:
        if not self._markers.get_subscription_count():
            return
        scene, header = self._scene, Header(frame_id=ODOM_FRAME)  # without a stamp: as of now, whatever now is
        before = cone_marker("remembered cones", header, scene.remembered[:, :2], scene.remembered[:, 2], alpha=0.35)
        driven = driven_marker(header, scene.driven)
        raw = cones_from_msg(scene.raw, 0)
        unsure = cone_marker("raw cones", scene.raw.header, raw.xy_m, raw.color, size_m=0.1)
        seen = cone_marker("cones", scene.cones.header, scene.seen.xy_m, scene.seen.color)
        planned = path_markers(scene.path, scene.status)
        self._markers.publish(MarkerArray(markers=[before, driven, unsure, seen, *planned, *self._car()]))

    def _car(self) -> list[Marker]:
        """Draw the car's outline, and over it what it is doing."""
        state, status = self._scene.state, self._scene.status
        header = Header(frame_id=BASE_FRAME)
        outline = _marker("car", header, Marker.LINE_STRIP, (0.06, 0.0, 0.0), (1.0, 1.0, 1.0))
        nose, half = CAR.nose_ahead_of_rear_axle_m, CAR.width_m / 2
        tail = nose - CAR.length_m
        outline.points = _points([(nose, half), (nose, -half), (tail, -half), (tail, half), (nose, half)], 0.1)
        words = _marker("words", header, Marker.TEXT_VIEW_FACING, (0.0, 0.0, 0.5), (1.0, 1.0, 1.0))
        words.pose.position.z = 1.8
        words.text = f"{state.as_state_label} {state.mission_label}\n{state.speed_mps:.1f} m/s, lap {status.laps}"
        words.text += f"\n{status.note or status.late}" if status.note or status.late else ""
        return [outline, words]


# ---------------------------------------------------------------- what is drawn


def cone_marker(
    name: str, header: Header, xy_m: np.ndarray, colors: np.ndarray, alpha: float = 1.0, size_m: float = 0.3
) -> Marker:
    """All cones as one marker, each in its colour; those seen disappear with the sensor's silence."""
    marker = _marker(name, header, Marker.SPHERE_LIST, (size_m, size_m, size_m), (1.0, 1.0, 1.0))
    marker.points = _points(xy_m.tolist(), 0.15)
    marker.colors = [_rgba(RGB[ConeColor(int(color))], alpha) for color in colors]
    if not len(xy_m):
        marker.action = Marker.DELETE
    return marker


def driven_marker(header: Header, driven: Sequence[tuple[float, float, float]]) -> Marker:
    """The driven path, from blue (at rest) to red (`FAST_MPS`)."""
    line = _marker("driven", header, Marker.LINE_STRIP, (0.08, 0.0, 0.0), (1.0, 1.0, 1.0))
    line.points = _points([(x, y) for x, y, _ in driven], 0.02)
    fast = [min(max(speed / FAST_MPS, 0.0), 1.0) for _, _, speed in driven]
    line.colors = [_rgba((share, 0.2, 1.0 - share)) for share in fast]
    if len(driven) < 2:
        line.action = Marker.DELETE
    return line


def path_markers(path: Path, status: PlannerStatus) -> list[Marker]:
    """The path from green (sure) to red, pale where no cones bear it out; and the place to stop at, if one is known."""
    xy_m = np.array([(pose.pose.position.x, pose.pose.position.y) for pose in path.poses]).reshape(-1, 2)
    line = _marker("path", path.header, Marker.LINE_STRIP, (0.12, 0.0, 0.0), (1.0, 1.0, 1.0))
    stop = _marker("stop", path.header, Marker.CUBE, (0.15, 3.0, 0.05), (0.9, 0.0, 0.0))
    stop.action = Marker.DELETE
    if len(xy_m) < 2:
        line.action = Marker.DELETE
        return [line, stop]
    along = lengths_along(xy_m)
    supported_m = status.supported_m or math.inf
    sure = min(max(status.confidence, 0.0), 1.0)
    color = (1.0 - sure, 0.8 * sure, 0.1)
    line.points = _points(xy_m.tolist(), 0.05)
    line.colors = [_rgba(color, 1.0 if at <= supported_m else 0.3) for at in along.tolist()]
    if math.isfinite(status.stop_distance_m) and status.stop_distance_m <= along[-1]:
        stop.action = Marker.ADD
        stop.pose = path.poses[int(np.searchsorted(along, status.stop_distance_m))].pose
    return [line, stop]


def _marker(
    name: str, header: Header, kind: int, scale: tuple[float, float, float], rgb: tuple[float, float, float]
) -> Marker:
    marker = Marker(header=header, ns=name, type=kind, color=_rgba(rgb))
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    marker.lifetime = Duration(nanosec=round(SHOWN_S * 1e9))
    return marker


def _points(xy_m: Sequence[Sequence[float]], z_m: float) -> list[Point]:
    return [Point(x=float(x), y=float(y), z=z_m) for x, y in xy_m]


def _rgba(rgb: tuple[float, float, float], alpha: float = 1.0) -> ColorRGBA:
    return ColorRGBA(r=rgb[0], g=rgb[1], b=rgb[2], a=alpha)


def static_frames(model: str, stamp: Time) -> list[TransformStamped]:
    """The fixed joints of a URDF. The wheels are fixed, too: nothing measured moves them."""
    frames = []
    for joint in ElementTree.fromstring(model).iter("joint"):
        if joint.get("type") != "fixed":
            continue
        origin, frame = joint.find("origin"), TransformStamped()
        parent, child = joint.find("parent"), joint.find("child")
        assert origin is not None and parent is not None and child is not None, "as the package's own model has it"
        frame.header.stamp, frame.header.frame_id = stamp, parent.get("link", "")
        frame.child_frame_id = child.get("link", "")
        x, y, z = (float(word) for word in origin.get("xyz", "0 0 0").split())
        frame.transform.translation.x, frame.transform.translation.y, frame.transform.translation.z = x, y, z
        frames.append(frame)
    return frames


main = partial(run, [Visualization], "visualization")


if __name__ == "__main__":
    raise SystemExit(main())
