"""`fsai-vcu enclaves`: the keys with which the nodes' DDS is encrypted, and who may do what with them (SROS2)."""

from __future__ import annotations

import argparse
import grp
import os
import pwd
import shutil
import subprocess
import sys
from pathlib import Path

from fsai_vcu.files import is_file, is_folder
from fsai_vcu.interface.errors import UserError
from fsai_vcu.runtime.configuration import usual_environment
from fsai_vcu.runtime.transport import DISTRIBUTIONS

EXAMPLE = "fsai-vcu enclaves --keystore /etc/fsai/keystore"

SERVICE_USER, OPERATORS = "fsai", "fsai-operators"
# Owners of these keys; the others (sensors, observer) stay root's, who hands them to where they are needed.
OF_SERVICES = frozenset({"vcu_bridge", "cone_detector", "path_planner", "vehicle_controller"})
OF_OPERATORS = frozenset({"operator", "listener", "visualization"})
_INSTALLED_POLICY = Path("/usr/share/fsai/security/policy.xml")
_CHECKOUT_POLICY = Path(__file__).resolve().parents[2] / "systemd" / "security" / "policy.xml"
_DISTRIBUTIONS = Path("/opt/ros")
# What the distribution's setup file is to say again: our own ROS 2 may be another one, from the package index.
_OUR_OWN = {"LD_LIBRARY_PATH", "PYTHONPATH", "AMENT_PREFIX_PATH"}


_Tool = tuple[list[str], dict[str, str]]
"""`ros2 security`, with the environment that its own setup file makes."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--keystore", type=Path, default=Path("/etc/fsai/keystore"), metavar="DIR", help="(default: %(default)s)")
    add("--policy", type=Path, metavar="FILE", help="who may do what (default: the installed one)")


def run(args: argparse.Namespace) -> int:
    """Make the keys that the policy asks for, and give them to their users."""
    policy = args.policy or next((path for path in (_INSTALLED_POLICY, _CHECKOUT_POLICY) if path.is_file()), None)
    if policy is None or not is_file(policy):
        raise UserError(f"no policy {policy or _INSTALLED_POLICY}")
    tool = _find_tool()
    if tool is None:
        raise UserError(
            f"`ros2 security` is not on the PATH and not in {_DISTRIBUTIONS}: install it from the ROS distribution "
            "(sudo apt install ros-$ROS_DISTRO-sros2); the package index does not have it"
        )
    keystore = args.keystore.absolute()
    new = not is_folder(keystore / "enclaves")
    try:
        keystore.mkdir(mode=0o700, parents=True, exist_ok=True)  # a configuration that names it is right from here on
        # What the keys permit, they permit in one domain only.
        domain = {**usual_environment(), **os.environ}.get("ROS_DOMAIN_ID", "0")
    except OSError as error:
        raise UserError(f"{keystore} cannot be made: {error.strerror}") from error
    if new:
        _call(tool, domain, "create_keystore", str(keystore))
    _call(tool, domain, "generate_artifacts", "-k", str(keystore), "-p", str(policy))
    lacking = _give(keystore)
    print(f"keys for ROS domain {domain} are in {keystore}; now in /etc/fsai/fsai.toml:")
    print(f'[ros]\nkeystore = "{keystore}"')
    if lacking:
        print(f"fsai-vcu enclaves: only this user can read them: {lacking}", file=sys.stderr)
    else:
        print(f"to let a user operate the car: sudo usermod -aG {OPERATORS} NAME")
    return 0


def _give(keystore: Path) -> str:
    """Give each key to its users, and to nobody else; return why that could not be done, or ''.

    The key that signs them, and with it what they permit, stays root's. What has no secret in it is everybody's. The
    folders stay root's, too: into one of its own a service could put links, which lead the next call elsewhere.
    """
    lacking = ""
    try:
        service, operators = pwd.getpwnam(SERVICE_USER).pw_uid, grp.getgrnam(OPERATORS).gr_gid
    except KeyError:
        lacking = f"user {SERVICE_USER} or group {OPERATORS} is missing here; make install, or the package, makes both"
    else:
        if os.geteuid() != 0:
            lacking = f"sudo fsai-vcu enclaves gives them to user {SERVICE_USER} and group {OPERATORS}"
    enclaves = {path.parent for path in keystore.rglob("key.pem") if not path.is_symlink()}
    for path in (keystore, *keystore.rglob("*")):
        if path.is_symlink():
            continue
        mode, owner, group = 0o755, 0, 0
        enclave = next((each for each in enclaves if path.is_relative_to(each)), None)
        if path.is_relative_to(keystore / "private"):
            mode = 0o700
        elif enclave is not None:
            mode = 0o700
            if not lacking and enclave.name in OF_SERVICES:
                owner, mode = (0, 0o755) if path.is_dir() else (service, 0o400)
            elif not lacking and enclave.name in OF_OPERATORS:
                group, mode = operators, 0o750
        if os.geteuid() == 0:
            os.chown(path, owner, group)
        path.chmod(mode if path.is_dir() else mode & 0o644)
    return lacking


def _find_tool() -> _Tool | None:
    """None where there is no `ros2 security`. sudo has a PATH of its own, so the usual place is looked at, too."""
    usual = os.pathsep.join(str(_DISTRIBUTIONS / name / "bin") for name in DISTRIBUTIONS)
    ros2 = shutil.which("ros2") or shutil.which("ros2", path=usual)
    if ros2 is None:
        return None
    command, environ = [ros2, "security"], dict(os.environ)
    setup = Path(ros2).parents[1] / "setup.bash"
    if setup.is_file():
        command = ["bash", "-c", '. "$0" && exec ros2 security "$@"', str(setup)]
        environ = {name: value for name, value in environ.items() if name not in _OUR_OWN}
    offers = subprocess.run([*command, "--help"], env=environ, capture_output=True, stdin=subprocess.DEVNULL)
    return (command, environ) if offers.returncode == 0 else None


def _call(tool: _Tool, domain: str, *words: str) -> None:
    print(f"ros2 security {' '.join(words)}", file=sys.stderr, flush=True)
    command, environ = tool
    environ = {**environ, "ROS_DOMAIN_ID": domain}
    done = subprocess.run([*command, *words], env=environ, stdin=subprocess.DEVNULL, umask=0o077)
    if done.returncode != 0:
        raise UserError(f"ros2 security {words[0]} failed (exit status {done.returncode})")
