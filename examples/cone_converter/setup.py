"""Two modules as an ament_python package, so that `ros2 run cone_converter cone_converter` finds them."""

from setuptools import setup

NAME = "cone_converter"
OUT = "cones_out"

setup(
    name=NAME,
    version="0.1.0",
    py_modules=[NAME, OUT],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    options={"develop": {"script_dir": f"$base/lib/{NAME}"}, "install": {"install_scripts": f"$base/lib/{NAME}"}},
    entry_points={"console_scripts": [f"{each} = {each}:main" for each in (NAME, OUT)]},
)
