"""The wheel and the sdist: what is in them, and that the wheel drives the car with what it declares to need."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import venv
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

CHECKOUT = Path(__file__).resolve().parents[2]
NAME = "fsai-vcu"
RUBBISH = re.compile(r"(^|/)(out|\.venv|__pycache__|\.[a-z]+_cache)/|\.pyc$|\.log$")


def build(kind: str, source: Path, folder: Path) -> Path:
    """The wheel or the sdist of `source`, in `folder`. No network: the backend is the environment's own."""
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", folder], cwd=source, check=True)
    return next(folder.iterdir())


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("sdist", CHECKOUT, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made from the sdist, as a packager makes it."""
    folder = tmp_path_factory.mktemp("unpacked")
    # tarfile's own filter is not in the oldest Python 3.11 that a distribution has.
    subprocess.run(["tar", "-xf", sdist, "-C", folder], check=True)
    return build("wheel", next(folder.iterdir()), tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def clean(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment that has the wheel, what it declares to need, and nothing else of this one."""
    folder = tmp_path_factory.mktemp("clean")
    venv.create(folder)
    site = next(folder.glob("lib/python3*/site-packages"))
    for name in needed():
        found = distribution(name)
        for top in {file.parts[0] for file in found.files or () if file.parts[0] not in ("..", "__pycache__")}:
            (site / top).symlink_to(Path(str(found.locate_file(top))))
    pip = [sys.executable, "-m", "pip", "--python", folder / "bin" / "python", "install", "--no-compile"]
    subprocess.run([*pip, "--quiet", "--no-deps", "--no-index", wheel], check=True)
    return folder


def needed() -> set[str]:
    """Names of the distributions that pip would install with this one."""
    names, new = set(), [NAME]
    while new:
        for requirement in map(Requirement, distribution(new.pop()).requires or ()):
            if requirement.name not in names and (not requirement.marker or requirement.marker.evaluate({"extra": ""})):
                names.add(requirement.name)
                new.append(requirement.name)
    return names


def names_in(archive: Path) -> set[str]:
    """Of the files, without the sdist's own folder."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as packed:
            return set(packed.namelist())
    with tarfile.open(archive) as packed:
        return {member.name.partition("/")[2] for member in packed if member.isfile()}


def test_the_wheel_has_every_file_of_both_packages(wheel: Path) -> None:
    tracked = subprocess.run(["git", "ls-files"], cwd=CHECKOUT, capture_output=True, text=True, check=False).stdout
    sources = {name.removeprefix("hil/") for name in tracked.split("\n") if name.startswith(("fsai_vcu/", "hil/"))}
    databases = {f"fsai_vcu/interface/dbc/{path.name}" for path in (CHECKOUT / "dbc").glob("*.dbc")}
    assert len(databases) == 3
    names = {name for name in names_in(wheel) if ".dist-info/" not in name}
    assert databases | {"fsai_vcu/py.typed", "fsai_hil/py.typed"} <= names
    if (CHECKOUT / ".git").exists():
        assert sources, "git does not list the files of this checkout"
        assert sources | databases <= names
        assert {name for name in names if RUBBISH.search(name)} == set()


def test_the_sdist_has_the_sources_and_no_leavings(sdist: Path) -> None:
    names = names_in(sdist)
    assert {"pyproject.toml", "README.md", "LICENSE", "Makefile", "dbc/ads_dv_2026.dbc", "scripts/setup"} <= names
    assert {"fsai_vcu/cli/main.py", "nodes/build-messages", "tests/packaging/test_wheel.py", ".ci/run"} <= names
    assert {name for name in names if RUBBISH.search(name)} == set()
    assert not [name for name in names if name.startswith("nodes/fsai_vcu/fsai_")], "the sources are there once"
    assert sdist.stat().st_size < 2_700_000  # of which the hashes of locked packages are 0.2 MB


def test_the_wheel_drives_the_car_in_an_empty_folder(clean: Path, tmp_path: Path) -> None:
    environment = {"PATH": f"{clean / 'bin'}:/usr/bin:/bin", "HOME": str(tmp_path)}
    command = ["fsai-vcu", "drive", "--mission", "autonomous_demo"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "autonomous_demo: PASS" in done.stdout, done.stdout + done.stderr
    where = "import fsai_vcu, fsai_hil; print(fsai_vcu.__path__[0], fsai_hil.__path__[0])"
    found = subprocess.run([clean / "bin" / "python", "-c", where], cwd=tmp_path, capture_output=True, check=True)
    assert all(path.startswith(os.fsencode(clean)) for path in found.stdout.split())
    assert list(tmp_path.iterdir()) == [], "it leaves nothing behind"


def test_each_verb_of_the_wheel_says_how_it_is_used(clean: Path, tmp_path: Path) -> None:
    ask = (
        "from fsai_vcu.cli.main import main\n"
        "import contextlib, re, io, sys\n"
        "def said(*words):\n"
        "    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):\n"
        "        main([*words, '--help'] if words else ['help', '--all'])\n"
        "    return out.getvalue()\n"
        "verbs = re.findall(r'^  +([a-z][a-z-]+)  ', said(), re.M)\n"
        "print(*(verb for verb in verbs if 'usage: fsai-vcu ' + verb in said(verb)))\n"
    )
    done = subprocess.run(
        [clean / "bin" / "python", "-c", ask], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert {"drive", "decode", "pitwall", "hil", "campaign"} <= set(done.stdout.split()), done.stdout
