"""Facts of the car's CAN interface: databases, names, enums, scaling, reserved ids, limits of a revision.

Nothing here knows time, sockets, ROS or its callers.
"""
