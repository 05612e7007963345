"""The library and the simulated car as an ament_python package, for a colcon workspace. (pip installs the root.)

The folders beside this file are links to the checkout's own; names, version and entry points are pyproject.toml's.
"""

from pathlib import Path

from setuptools import find_namespace_packages, setup

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

NAME = "fsai_vcu"
# With --symlink-install the modules are found where they are, and the databases beside them.
DATABASES = {f"{NAME}.interface.dbc": "dbc"} if Path("dbc").is_dir() else {}
PROJECT = tomllib.loads(Path(__file__).resolve().parents[2].joinpath("pyproject.toml").read_text())["project"]
PACKAGES = find_namespace_packages(include=["fsai_vcu*", "fsai_hil*"])

setup(
    name=NAME,
    version=PROJECT["version"],
    description=PROJECT["description"],
    license=PROJECT["license"],
    python_requires=PROJECT["requires-python"],
    packages=[*(each for each in PACKAGES if "__pycache__" not in each), *DATABASES],
    package_dir=DATABASES,
    package_data={"": ["*.xml", "*.json", "*.js", "*.css", "*.html", "*.c", "*.dbc", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [f"{name} = {target}" for name, target in PROJECT["scripts"].items()],
        **{
            group: [f"{name} = {target}" for name, target in points.items()]
            for group, points in PROJECT["entry-points"].items()
        },
    },
)
