"""The whole chain on a real bus: five ROS 2 nodes, each its own process, and the simulated car on vcan0."""
