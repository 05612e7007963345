"""Cones of your own perception as /detected_cones: of lists by colour, of CSV in a string, or of a PointCloud2.

Keep the function of yours and change it. It makes (colour, x, y) of one message, in metres, x forward, y to the left.
"""

import csv
from importlib import import_module

import numpy as np
from fsai_msgs.msg import Cone, ConeArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Header

from fsai_nodes.process import run
from fsai_nodes.qos import TOPICS

COLORS = {"blue": Cone.BLUE, "yellow": Cone.YELLOW, "orange": Cone.ORANGE, "big_orange": Cone.BIG_ORANGE}
FORMATS = ("", "i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")  # of sensor_msgs/PointField, by their numbers


def lists(message):  # eufs_msgs/ConeArrayWithCovariance: blue_cones, yellow_cones, …
    return [(COLORS[c], each.point.x, each.point.y) for c in COLORS for each in getattr(message, f"{c}_cones")]


def text(message):  # std_msgs/String, a cone in each line: blue,5.0,1.5
    return [(COLORS.get(c, Cone.UNKNOWN), float(x), float(y)) for c, x, y in csv.reader(message.data.splitlines())]


def cloud(message):  # sensor_msgs/PointCloud2 with fields x, y and color: the numbers of fsai_msgs/Cone
    fields = {field.name: field for field in message.fields if field.name in ("x", "y", "color")}
    kinds = [(">" if message.is_bigendian else "<") + FORMATS[field.datatype] for field in fields.values()]
    places = {"offsets": [field.offset for field in fields.values()], "itemsize": message.point_step}
    points = np.frombuffer(bytes(message.data), np.dtype({"names": [*fields], "formats": kinds, **places}))
    return [(int(point["color"]), float(point["x"]), float(point["y"])) for point in points]


WAYS = {
    "lists": ("eufs_msgs", "ConeArrayWithCovariance", lists),
    "text": ("std_msgs", "String", text),
    "cloud": ("sensor_msgs", "PointCloud2", cloud),
}


class ConeConverter(Node):
    """Publishes each message about cones as /detected_cones."""

    def __init__(self, **options):
        super().__init__("cone_converter", **options)
        package, name, self.read = WAYS[self.declare_parameter("way", "lists").value]
        self.cones = self.create_publisher(ConeArray, "detected_cones", TOPICS["detected_cones"])
        kind = getattr(import_module(f"{package}.msg"), name)
        self.create_subscription(kind, "cones", self.on_cones, qos_profile_sensor_data)

    def on_cones(self, message):
        header = Header(frame_id="base_link")  # when it was measured; a string does not say it, so: when it came
        header.stamp = message.header.stamp if hasattr(message, "header") else self.get_clock().now().to_msg()
        cones = [Cone(color=color, x=x, y=y, confidence=1.0) for color, x, y in self.read(message)]
        self.cones.publish(ConeArray(header=header, cones=cones))


def main():
    return run([ConeConverter], "cone_converter")


if __name__ == "__main__":
    raise SystemExit(main())
