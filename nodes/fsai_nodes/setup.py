"""fsai_nodes as an ament_python package; pip installs it as well. The fsai_vcu library is installed beside it."""

from pathlib import Path

from setuptools import setup

NAME = "fsai_nodes"
NODES = (
    "sensor_simulator",
    "cone_detector",
    "path_planner",
    "vehicle_controller",
    "vcu_bridge",
    "visualization",
    "composed",
    "ackermann_adapter",
)


def files(folder: str) -> list[str]:
    return sorted(str(path) for path in Path(folder).iterdir() if path.is_file())


setup(
    name=NAME,
    version="0.1.0",
    description="The ROS 2 nodes between cone detections and the ADS-DV's VCU",
    license="MIT",
    packages=[NAME],
    package_data={NAME: ["*.urdf"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", files("launch")),
        (f"share/{NAME}/config", files("config")),
        (f"share/{NAME}/rviz", files("rviz")),
        (f"share/{NAME}/urdf", [f"{NAME}/fsai.urdf"]),
    ],
    zip_safe=False,
    entry_points={"console_scripts": [f"{node} = {NAME}.{node}:main" for node in NODES]},
)
