"""`fsai-vcu enclaves`: the keys with which the nodes' DDS is encrypted, and who may do what with them (SROS2)."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

EXAMPLE = "fsai-vcu enclaves --keystore /etc/fsai/keystore"

_INSTALLED_POLICY = Path("/usr/share/fsai/security/policy.xml")
_CHECKOUT_POLICY = Path(__file__).resolve().parents[2] / "systemd" / "security" / "policy.xml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--keystore", type=Path, default=Path("/etc/fsai/keystore"), metavar="DIR", help="(default: %(default)s)"
    )
    parser.add_argument("--policy", type=Path, metavar="FILE", help="who may do what (default: the installed one)")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.main import UserError

    policy = args.policy or next((path for path in (_INSTALLED_POLICY, _CHECKOUT_POLICY) if path.is_file()), None)
    if policy is None or not policy.is_file():
        raise UserError(f"no policy {policy or _INSTALLED_POLICY}")
    ros2 = shutil.which("ros2")
    if ros2 is None or not _offers_security(ros2):
        raise UserError(
            "no `ros2 security` here: it is part of the distribution (sudo apt install ros-jazzy-sros2) and not on the "
            "package index; source /opt/ros/jazzy/setup.bash first"
        )
    if not args.keystore.is_dir():
        _call(ros2, "create_keystore", str(args.keystore))
    _call(ros2, "generate_artifacts", "-k", str(args.keystore), "-p", str(policy))
    # Keys are for the services' user alone.
    for path in (args.keystore, *args.keystore.rglob("*")):
        if not path.is_symlink():
            path.chmod(0o750 if path.is_dir() else 0o640)
    print(f"keys are in {args.keystore}; now: sudo chgrp -R fsai {args.keystore}, and in /etc/fsai/fsai.toml")
    print(f'[ros]\nkeystore = "{args.keystore}"')
    return 0


def _offers_security(ros2: str) -> bool:
    done = subprocess.run([ros2, "security", "--help"], capture_output=True, stdin=subprocess.DEVNULL, check=False)
    return done.returncode == 0


def _call(ros2: str, *words: str) -> None:
    from fsai_vcu.cli.main import UserError

    print(f"ros2 security {' '.join(words)}", file=sys.stderr, flush=True)
    done = subprocess.run([ros2, "security", *words], stdin=subprocess.DEVNULL, check=False)
    if done.returncode != 0:
        raise UserError(f"ros2 security {words[0]} failed (exit status {done.returncode})")
