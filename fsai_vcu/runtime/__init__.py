"""Runtime: decisions meet the machine here, with the 10 ms loop, the bus, clocks, real-time scheduling and recording.

It knows neither ROS nor what a decision means.
"""
