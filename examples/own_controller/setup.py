"""One module as an ament_python package, so that `ros2 run own_controller own_controller` finds it."""

from setuptools import setup

NAME = "own_controller"

setup(
    name=NAME,
    version="0.1.0",
    py_modules=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    options={"develop": {"script_dir": f"$base/lib/{NAME}"}, "install": {"install_scripts": f"$base/lib/{NAME}"}},
    entry_points={"console_scripts": [f"{NAME} = {NAME}:main"]},
)
