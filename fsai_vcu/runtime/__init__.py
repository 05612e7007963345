"""Where decisions meet the machine: the 10 ms loop, the bus, clocks, real-time scheduling, recording.

It knows neither ROS nor what a decision means.
"""
