"""The driving chain as ROS 2 nodes: cones in, CAN frames out."""
