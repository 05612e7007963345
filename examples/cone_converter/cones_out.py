"""The other way round: /detected_cones as lists by colour, CSV in a string, or a PointCloud2. Keep yours."""

from importlib import import_module

import numpy as np
from fsai_msgs.msg import ConeArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import String

from fsai_nodes.process import run
from fsai_nodes.qos import TOPICS

COLORS = ("unknown_color", "blue", "yellow", "orange", "big_orange")  # by their numbers in fsai_msgs/Cone


def lists(seen):
    of = import_module("eufs_msgs.msg")
    message = of.ConeArrayWithCovariance(header=seen.header)
    for each in seen.cones:
        cone = of.ConeWithCovariance()
        cone.point.x, cone.point.y = each.x, each.y
        getattr(message, f"{COLORS[each.color]}_cones").append(cone)
    return message


def text(seen):
    return String(data="\n".join(f"{COLORS[each.color]},{each.x},{each.y}" for each in seen.cones))


def cloud(seen):
    points = np.array([(each.x, each.y, 0.0, each.color) for each in seen.cones], "<f4").reshape(-1, 4)
    message = PointCloud2(header=seen.header, height=1, width=len(points), point_step=16, row_step=16 * len(points))
    for index, name in enumerate(("x", "y", "z", "color")):
        message.fields.append(PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1))
    message.data, message.is_dense = points.tobytes(), True
    return message


class ConesOut(Node):
    """Publishes /detected_cones in the form that the parameter `way` names."""

    def __init__(self, **options):
        super().__init__("cones_out", **options)
        self.make = {"lists": lists, "text": text, "cloud": cloud}[self.declare_parameter("way", "lists").value]
        self.cones = self.create_publisher(type(self.make(ConeArray())), "cones", 1)
        self.create_subscription(ConeArray, "detected_cones", self.on_cones, TOPICS["detected_cones"])

    def on_cones(self, seen):
        self.cones.publish(self.make(seen))


def main():
    return run([ConesOut], "cones_out")


if __name__ == "__main__":
    raise SystemExit(main())
