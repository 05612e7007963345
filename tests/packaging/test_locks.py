"""What the car's environment is made of: one version of each package, by hash, that the project's ranges allow."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import tomli
from packaging.requirements import Requirement

CHECKOUT = Path(__file__).resolve().parents[2]
LOCKS = {path.stem: path.read_text() for path in (CHECKOUT / "scripts" / "locks").glob("*.txt")}
PROJECT = tomli.loads((CHECKOUT / "pyproject.toml").read_text())
NODES = tomli.loads((CHECKOUT / "nodes" / "fsai_nodes" / "pyproject.toml").read_text())
OF_THE_DISTRIBUTION = {"numpy", "scipy"}


def pins(lock: str) -> list[tuple[Requirement, list[str]]]:
    """Each package and its hashes; nothing else is in the list."""
    lines = [line for line in LOCKS[lock].replace("\\\n", " ").splitlines() if not line.startswith("#")]
    return [(Requirement(line.partition(" --hash")[0]), re.findall(r" --hash=(\S+)", line)) for line in lines]


def asked_for(lock: str) -> set[str]:
    """What the project asks for of that list, as it is written."""
    if lock == "build":
        environment = (CHECKOUT / "scripts" / "environment.bash").read_text()
        (pip,) = re.findall(r'^PIP="(.*)"$', environment, re.M)
        return {pip, *PROJECT["build-system"]["requires"], *NODES["build-system"]["requires"]}
    extras = PROJECT["project"]["optional-dependencies"]
    wanted = {*PROJECT["project"]["dependencies"], *extras["monitor"], *extras["pitwall"]}
    if lock == "distribution":
        return {each for each in wanted if Requirement(each).name not in OF_THE_DISTRIBUTION}
    listed = subprocess.run([CHECKOUT / "nodes" / "build-messages", "--wheels"], capture_output=True, check=True)
    return wanted | set(extras["ros"]) | set(listed.stdout.decode().split())


def test_there_is_a_list_for_each_kind_of_installation() -> None:
    assert LOCKS.keys() == {"build", "wheels", "distribution"}


@pytest.mark.parametrize("minor", [10, 11, 12, 13])
@pytest.mark.parametrize("lock", LOCKS)
def test_every_python_gets_what_the_project_asks_for(lock: str, minor: int) -> None:
    machine = {"python_version": f"3.{minor}", "python_full_version": f"3.{minor}.5", "sys_platform": "linux"}
    holds = [each for each, _ in pins(lock) if each.marker is None or each.marker.evaluate(machine)]
    versions = {each.name.lower().replace("_", "-"): str(each.specifier) for each in holds}
    assert len(versions) == len(holds), "two versions of one package"
    assert all(re.fullmatch(r"==[\w.]+", version) for version in versions.values())
    assert lock != "distribution" or not versions.keys() & OF_THE_DISTRIBUTION
    for wanted in map(Requirement, asked_for(lock)):
        if wanted.marker is None or wanted.marker.evaluate(machine):
            version = versions[wanted.name.lower().replace("_", "-")].removeprefix("==")
            assert wanted.specifier.contains(version), f"{wanted}: {version} is locked; make lock"


@pytest.mark.parametrize("lock", LOCKS)
def test_every_package_has_hashes_and_no_place(lock: str) -> None:
    for package, hashes in pins(lock):
        assert hashes and all(re.fullmatch(r"sha256:[0-9a-f]{64}", each) for each in hashes), package
    assert "://" not in LOCKS[lock], "where packages come from is for the machine to say"


def test_the_installer_takes_nothing_without_its_hash() -> None:
    script = re.sub(r"\\\n\s*", "", (CHECKOUT / "scripts" / "install-car").read_text())
    installs = [line for line in script.splitlines() if re.search(r"\bpip install ", line) and line[0] != "#"]
    assert installs and all("--require-hashes" in line or "--no-index" in line for line in installs), installs
    assert re.search(r"PIP_NO_INDEX=1 run nodes/build-messages", script)


def test_the_contents_have_versions_and_checked_hashes(tmp_path: Path) -> None:
    site = tmp_path / "site"
    for name, suffix in (("wheel-1.0", "dist-info"), ("within-2.0", "egg-info"), ("built-3.0", "egg-info")):
        info = site / f"{name}.{suffix}"
        info.mkdir(parents=True)
        text = "Name: {}\nVersion: {}\n".format(*name.split("-"))
        (info / ("METADATA" if suffix == "dist-info" else "PKG-INFO")).write_text(text)
    (site / "wheel-1.0.dist-info" / "RECORD").write_text("wheel.py,,\nwithin-2.0.egg-info/PKG-INFO,,\n")
    download = {"url": "https://index.invalid/a/wheel-1.0.whl", "archive_info": {"hashes": {"sha256": "f" * 64}}}
    report, listed = tmp_path / "report.json", tmp_path / "list"
    report.write_text(
        json.dumps({"install": [{"metadata": {"name": "Wheel", "version": "1.0"}, "download_info": download}]})
    )
    for source in (report, listed):  # a later list has it from an earlier one
        command = [sys.executable, CHECKOUT / "scripts" / "car-contents", site, source]
        listed.write_text(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
        assert listed.read_text().splitlines()[1:] == [
            "built 3.0  -  built here, or copied",
            f"wheel 1.0  sha256:{'f' * 64}  wheel-1.0.whl",
        ]
