"""The topics on which the bridge publishes what its CAN loop reports of the car."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from fsai_msgs.msg import RunState, VehicleState
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import Imu, NavSatFix

from fsai_nodes.clocks import Clocks
from fsai_nodes.conversions import (
    BASE_FRAME,
    ODOM_FRAME,
    fix_to_msg,
    imu_to_msg,
    odometry_to_msg,
    run_to_msg,
    state_to_msg,
)
from fsai_nodes.diagnosis import diagnostics_of
from fsai_nodes.parameters import Settings
from fsai_nodes.qos import publisher
from fsai_vcu.core.driving import Run
from fsai_vcu.core.report import BridgeReport


class BridgeOutputs:
    """Publishers of the bridge. Each publishes what is new; of what costs something to make, what somebody reads."""

    def __init__(self, node: LifecycleNode, settings: Settings, clocks: Clocks) -> None:
        self._settings, self._clocks = settings, clocks
        self._vehicle_state = publisher(node, VehicleState, "vehicle_state")
        self._run_state = publisher(node, RunState, "run_state")
        self._odometry = publisher(node, Odometry, "odometry")
        self._imu = publisher(node, Imu, "imu")
        self._fix = publisher(node, NavSatFix, "gps/fix")
        self._diagnostics = publisher(node, DiagnosticArray, "diagnostics")
        self._transforms = _TransformSender(node)
        self.run: Run | None = None  # as published
        self._said: tuple[Run, str] | None = None
        self._last_fix_ns = self._last_imu_ns = self._last_motion_ns = 0

    def begin(self) -> None:
        """Forget the run that was published: the bridge has been activated."""
        self.run = self._said = None

    def state(self, report: BridgeReport, command_age_s: float) -> None:
        """Publish run and car.

        command_age_s: age of the data behind the last command that came in; NaN before the first.
        """
        # The run goes out before the first state that belongs to it, so that nobody drives a new run with old memory.
        run = (report.run, report.mode)
        if run != self._said:
            self._said, self.run = run, report.run
            self._run_state.publish(run_to_msg(report.run, report.mode, self._clocks.stamp_of(report.t_ns)))
        stamp = self._clocks.stamp_of(report.motion.t_ns)
        self._vehicle_state.publish(state_to_msg(report, stamp, command_age_s))

    def motion(self, report: BridgeReport) -> None:
        """Publish the motion and the sensors' values, where somebody reads them."""
        if report.motion.t_ns != self._last_motion_ns:  # of a car that is not received there is no motion
            self._last_motion_ns = report.motion.t_ns
            stamp = self._clocks.stamp_of(report.motion.t_ns)
            # Making a message costs more than asking whether anybody wants it.
            if self._odometry.get_subscription_count():
                self._odometry.publish(odometry_to_msg(report.motion, stamp))
            if self._settings.flag("publish_tf"):
                self._transforms.send(report, stamp)
        if self._imu.get_subscription_count():
            measured = report.gps.acceleration or report.gps.dynamics
            if measured is not None and measured.t_rx_ns != self._last_imu_ns:
                self._last_imu_ns = measured.t_rx_ns
                self._imu.publish(imu_to_msg(report.gps, self._settings.text("imu_frame_id"), self._clocks.stamp_of))
        if self._fix.get_subscription_count():
            latitude = report.gps.latitude
            if latitude is not None and latitude.t_rx_ns != self._last_fix_ns:
                fix = fix_to_msg(report.gps, self._settings.text("gps_frame_id"), self._clocks.stamp_of)
                if fix is not None:
                    self._last_fix_ns = latitude.t_rx_ns
                    self._fix.publish(fix)

    def diagnostics(self, report: BridgeReport, more: dict[str, object]) -> None:
        """Publish the diagnostics, with `more` values of the loop."""
        stamp = self._clocks.stamp_of(self._clocks.now_ns())
        self._diagnostics.publish(diagnostics_of(report, stamp, more))


class _TransformSender:
    """odom -> base_link on /tf, where tf2_msgs is installed; a bridge without it works."""

    def __init__(self, node: LifecycleNode) -> None:
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            self._publisher = None
            node.get_logger().info("tf2_msgs is not installed: no transform odom -> base_link; /odometry has the pose")
        else:
            self._publisher, self._message = publisher(node, TFMessage, "/tf"), TFMessage

    def send(self, report: BridgeReport, stamp: Time) -> None:
        if self._publisher is None or not self._publisher.get_subscription_count():
            return
        from geometry_msgs.msg import TransformStamped

        motion = report.motion
        message = TransformStamped()
        message.header.stamp = stamp
        message.header.frame_id = ODOM_FRAME
        message.child_frame_id = BASE_FRAME
        message.transform.translation.x, message.transform.translation.y = float(motion.x_m), float(motion.y_m)
        message.transform.rotation.z = math.sin(motion.yaw_rad / 2)
        message.transform.rotation.w = math.cos(motion.yaw_rad / 2)
        self._publisher.publish(self._message(transforms=[message]))
