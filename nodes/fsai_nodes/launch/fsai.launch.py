"""Starts the driving chain: ros2 launch fsai_nodes fsai.launch.py can_interface:=vcan0 max_speed:=5.0

Arguments left empty leave the parameter file's value in force.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from fsai_nodes.parameters import misspelt
from launch import LaunchDescription

# launch argument, which is the nodes' parameter -> (nodes, type, what it is)
ARGUMENTS = {
    "can_interface": (("vcu_bridge",), str, "the bus, for example can0 or vcan0"),
    "revision": (("vcu_bridge",), str, "interface revision of the car: 2021 or 2026"),
    "car": (("vcu_bridge", "path_planner", "vehicle_controller"), str, "vehicle parameters: 2021 or 2026"),
    "limits": (("vcu_bridge",), str, "operational limits: a TOML file, or max_speed_mps=5.0,..."),
    "listen_only": (("vcu_bridge",), bool, "never send: true or false"),
    "autonomous_at_power_up": (("vcu_bridge",), bool, "true or false"),
    "noise_level": (("sensor_simulator",), float, "imperfection of the simulated sensor; 0 is perfect"),
    "truth_port": (("sensor_simulator",), int, "UDP port of the simulated car's true pose"),
    "confidence_threshold": (("cone_detector",), float, "0 to 1"),
    "laps": (("path_planner",), int, "laps of a trackdrive"),
    "max_speed": (("vehicle_controller",), float, "highest speed in every mission, in m/s"),
    "lap_max_speed": (("vehicle_controller",), float, "highest speed on laps, in m/s"),
    "race_max_speed": (("vehicle_controller",), float, "highest speed on laps along a map, in m/s"),
    "skidpad_max_speed": (("vehicle_controller",), float, "highest speed in the skidpad, in m/s"),
    "acceleration_max_speed": (("vehicle_controller",), float, "highest speed in the acceleration, in m/s"),
}
NODES = ("sensor_simulator", "cone_detector", "path_planner", "vehicle_controller", "vcu_bridge", "visualization")
SWITCHES = {
    "simulated": ("true", "start the sensor simulator"),
    "composed": ("false", "all nodes but the bridge in one process"),
    "markers": ("false", "start visualization: /markers, the car's model and frames for RViz and Foxglove"),
    "rviz": ("false", "open RViz with what visualization publishes; starts it, too"),
}


def typed(text, kind):
    """A launch argument's text as its parameter's type."""
    if kind is bool:
        if text.lower() not in ("true", "false"):
            raise ValueError(f"'{text}' is neither true nor false")
        return text.lower() == "true"
    return kind(text)


def rviz():
    """RViz with the package's own view."""
    try:
        get_package_prefix("rviz2")
    except PackageNotFoundError:
        raise RuntimeError("rviz:=true, but rviz2 is not installed: apt install ros-jazzy-rviz2") from None
    view = PathJoinSubstitution([FindPackageShare("fsai_nodes"), "rviz", "fsai.rviz"])
    return Node(package="rviz2", executable="rviz2", name="rviz2", arguments=["-d", view])


def start(context):
    """The nodes, with the parameter file first and the arguments given on top."""
    # ROS ignores an argument that nobody declares; those of a launch file that includes this one are seen here, too.
    wrong = misspelt(context.launch_configurations, [*ARGUMENTS, *SWITCHES, "params_file"])
    if wrong:
        raise ValueError(wrong)
    parameters = {name: {} for name in NODES}
    for argument, (nodes, kind, _) in ARGUMENTS.items():
        text = LaunchConfiguration(argument).perform(context)
        if text:
            for node in nodes:
                parameters[node][argument] = typed(text, kind)
    file = LaunchConfiguration("params_file").perform(context)
    on = {name: typed(LaunchConfiguration(name).perform(context), bool) for name in SWITCHES}
    optional = {"sensor_simulator": on["simulated"], "visualization": on["markers"] or on["rviz"]}
    separate = [name for name in NODES if optional.get(name, True)]
    actions = [rviz()] if on["rviz"] else []
    if on["composed"]:
        together = [name for name in separate if name != "vcu_bridge"]
        separate = ["vcu_bridge"]
        # One process, several nodes: arguments go by node name, as in a parameter file.
        given = [
            word
            for name in together
            for parameter, value in parameters[name].items()
            for word in ("-p", f"{name}:{parameter}:={str(value).lower() if isinstance(value, bool) else value}")
        ]
        actions.append(
            Node(
                package="fsai_nodes",
                executable="composed",
                output="screen",
                arguments=["--nodes", ",".join(together)],
                ros_arguments=["--params-file", file, *given],
            )
        )
    actions += [
        Node(
            package="fsai_nodes",
            executable=name,
            name=name,
            output="screen",
            parameters=[file, parameters[name]],
            # Time for the bridge's goodbye to the car.
            sigterm_timeout="15",
        )
        for name in separate
    ]
    return actions


def generate_launch_description():
    own_file = PathJoinSubstitution([FindPackageShare("fsai_nodes"), "config", "fsai.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=own_file, description="YAML file of parameters"),
            *(
                DeclareLaunchArgument(name, default_value=value, description=words)
                for name, (value, words) in SWITCHES.items()
            ),
            *(
                DeclareLaunchArgument(name, default_value="", description=words)
                for name, (_, _, words) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=start),
        ]
    )
