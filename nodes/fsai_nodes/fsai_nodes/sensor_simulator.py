"""sensor_simulator: what a cone sensor would see on the simulated car, as /raw_cones.

On the car a camera's or lidar's driver takes its place. It receives the true pose from the simulated car over a side
channel (UDP on this machine's loopback) that no other node reads.
"""

from __future__ import annotations

from functools import partial

from fsai_msgs.msg import ConeArray
from msgspec.structs import replace
from rclpy.node import Node

from fsai_hil.simulator.ground_truth import DEFAULT_PORT, Truth, TruthReceiver
from fsai_hil.simulator.sensing import ConeSensor, SensorSettings
from fsai_hil.simulator.tracks import TrackError, load_track
from fsai_nodes.clocks import Clocks
from fsai_nodes.conversions import cones_to_msg
from fsai_nodes.door import Door
from fsai_nodes.parameters import NodeError, NodeParameter, Settings
from fsai_nodes.process import run
from fsai_nodes.qos import publisher

_DEFAULT = SensorSettings()

SETTINGS = (
    NodeParameter(
        "noise_level",
        _DEFAULT.noise_level,
        "Scales all imperfections of the sensor: noise, misses, false cones. 0 is a perfect sensor.",
        low=0.0,
        high=10.0,
        live=True,
    ),
    NodeParameter("range_m", _DEFAULT.range_m, "How far the sensor sees, in metres.", low=2.0, high=50.0, live=True),
    NodeParameter(
        "field_of_view_deg",
        _DEFAULT.field_of_view_deg,
        "Horizontal field of view in degrees.",
        low=10.0,
        high=360.0,
        live=True,
    ),
    NodeParameter("rate_hz", 20.0, "How often the sensor looks, in Hz.", low=1.0, high=50.0),
    NodeParameter(
        "truth_port",
        DEFAULT_PORT,
        "UDP port of the loopback on which the simulated car tells its true pose.",
        low=1,
        high=65535,
    ),
)


class SensorSimulator(Node):
    """Looks at `rate_hz`; silent while no simulated car is received."""

    def __init__(self, **options: object) -> None:
        """Read the parameters and open the side channel. Raises NodeError where its port cannot be had."""
        super().__init__("sensor_simulator", **options)
        self._settings = Settings(self, SETTINGS, self._on_change)
        self._clocks = Clocks(self)
        port = self._settings.integer("truth_port")
        try:
            self._truth = TruthReceiver(port)
        except OSError as error:
            raise NodeError(
                f"cannot listen for the true pose on UDP port {port}: {error.strerror}; choose another truth_port"
            ) from error
        self._sensor: ConeSensor | None = None
        self._seeing: tuple[str, int] | None = None  # track and seed that the sensor was made for
        self._publisher = publisher(self, ConeArray, "raw_cones")
        Door(self)  # it takes nothing but parameters
        self._clocks.watch()
        self._clocks.every(1.0 / self._settings.number("rate_hz"), self._look)
        self.get_logger().info(f"listening for the true pose on UDP port {port}")

    def stop(self) -> None:
        self._truth.close()

    def _sensor_settings(self) -> SensorSettings:
        return replace(
            _DEFAULT,
            noise_level=self._settings.number("noise_level"),
            range_m=self._settings.number("range_m"),
            field_of_view_deg=self._settings.number("field_of_view_deg"),
        )

    def _on_change(self, _name: str) -> None:
        if self._sensor is not None:
            self._sensor.settings = self._sensor_settings()

    def _look(self) -> None:
        truth = self._truth.latest()
        if truth is None:
            return
        sensor = self._sensor_for(truth)
        if sensor is None:
            return
        self._clocks.now_ns()
        observation = sensor.see(truth.pose, truth.t_ns)
        self._publisher.publish(cones_to_msg(observation, self._clocks.stamp_of(truth.t_ns)))

    def _sensor_for(self, truth: Truth) -> ConeSensor | None:
        """The sensor on the track that the car says it is on; None when that cannot be loaded here."""
        seeing = (truth.track, truth.seed)
        if seeing != self._seeing:
            self._seeing = seeing
            try:
                self._sensor = ConeSensor(load_track(truth.track), self._sensor_settings(), truth.seed)
                self.get_logger().info(f"seeing the cones of track {truth.track}")
            except TrackError as error:
                self._sensor = None
                self.get_logger().error(f"the simulated car's track cannot be seen: {error}")
        return self._sensor


main = partial(run, [SensorSimulator], "sensor_simulator")


if __name__ == "__main__":
    raise SystemExit(main())
