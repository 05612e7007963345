"""Starts the driving chain: ros2 launch fsai_nodes fsai.launch.py can_interface:=vcan0 max_speed:=5.0

With simulated_car:=true the car as well, which drives a mission by itself. Arguments left empty leave the parameter
file's value in force. What is started is in fsai_nodes/launch.py.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from fsai_nodes.launch import arguments, programs
from launch import LaunchDescription


def rviz():
    """RViz with the package's own view."""
    try:
        get_package_prefix("rviz2")
    except PackageNotFoundError:
        raise RuntimeError("rviz:=true, but rviz2 is not installed: apt install ros-jazzy-rviz2") from None
    view = PathJoinSubstitution([FindPackageShare("fsai_nodes"), "rviz", "fsai.rviz"])
    return Node(package="rviz2", executable="rviz2", name="rviz2", arguments=["-d", view])


def start(context):
    """Return the processes to start by the launch arguments, and RViz where it is asked for."""
    # ROS ignores an argument that nobody declares; those of a launch file that includes this one are seen here, too.
    given = dict(context.launch_configurations)
    actions = [rviz()] if given.get("rviz") == "true" else []
    for program in programs(given):
        if program.ros_words:
            actions.append(
                Node(
                    package="fsai_nodes",
                    executable=program.name,
                    output="screen",
                    arguments=list(program.words),
                    ros_arguments=list(program.ros_words),
                    # Time for the bridge's goodbye to the car.
                    sigterm_timeout="15",
                )
            )
        else:
            then = [Shutdown(reason="the simulated car has ended")] if program.needed else None
            actions.append(ExecuteProcess(cmd=program.argv, name=program.name, output="screen", on_exit=then))
    return actions


def generate_launch_description():
    declared = [
        DeclareLaunchArgument(
            each.name, default_value=each.default, description=each.words, choices=list(each.choices) or None
        )
        for each in arguments()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
