"""Judgement of a running ROS stack from its messages."""
