"""The AI side's decisions, pure: state in, state and outputs out, and time is an argument.

Nothing here opens a file or a socket, starts a thread, reads a clock or knows ROS.
"""
