"""What the car's CAN interface says: databases, names, enums, scaling, reserved ids, limits of a revision.

Nothing here knows time, sockets or ROS, nor who asks.
"""
