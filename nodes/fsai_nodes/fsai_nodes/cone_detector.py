"""cone_detector: /raw_cones to /detected_cones. Keeps the cones that a sensor is sure enough of."""

from __future__ import annotations

from functools import partial

from fsai_msgs.msg import ConeArray
from rclpy.node import Node
from rclpy.timer import Timer

from fsai_nodes.clocks import WATCH_S, Clocks, Input
from fsai_nodes.door import Door
from fsai_nodes.parameters import Settings, of_the_file
from fsai_nodes.process import run
from fsai_nodes.qos import publisher

SETTINGS = of_the_file("cone_detector", live=True)


class ConeDetector(Node):
    """Keeps stamp and frame of the raw cones, so that the age of a command tells the age of its measurement."""

    def __init__(self, **options: object) -> None:
        super().__init__("cone_detector", **options)
        self._settings = Settings(self, SETTINGS, self._on_change)
        self._on_change("confidence_threshold")
        self._clocks = Clocks(self)
        self._raw = Input(self, "raw_cones", clocks=self._clocks)
        self._publisher = publisher(self, ConeArray, "detected_cones")
        Door(self).subscription(ConeArray, "raw_cones", self._on_cones, refused=self._raw.refused)
        self._clocks.watch()
        self._watch: Timer | None = None

    def _on_change(self, _name: str) -> None:
        self._threshold = self._settings.number("confidence_threshold")

    def _on_cones(self, raw: ConeArray) -> None:
        self._raw.received(self._clocks.now_ns())
        if self._watch is None:  # only who has spoken can fall silent
            self._watch = self._clocks.every(WATCH_S, lambda: self._raw.watch(self._clocks.now_ns()))
        raw.cones = [cone for cone in raw.cones if cone.confidence >= self._threshold]
        self._publisher.publish(raw)


main = partial(run, [ConeDetector], "cone_detector")


if __name__ == "__main__":
    raise SystemExit(main())
