"""`python -m fsai_hil.carpc`: boot a car PC in User-Mode Linux, and see that everything starts and recovers by itself.

The machine's root is this machine's, seen through an overlay: what `make install` would install lies on top of it, and
whatever is written inside stays in memory. Nothing of this machine is changed.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from fsai_hil.vcan import VcanError, uml
from fsai_hil.vcan.clock import preloaded_clock

CHECKOUT = Path(__file__).resolve().parents[3]
MODULES = ("can", "can-raw", "vcan", "overlay")
MEMORY_MIB = 3072
BOOT_TO_END_S = 600.0
INTERFACE = "vcan0"
# Of this machine's services none is wanted inside; and what systemd would look for there is not.
MASKED = ("getty.target", "systemd-logind.service", "systemd-firstboot.service", "systemd-udev-settle.service")
# What one processor of User-Mode Linux has time for, as in the suite on vcan0.
CAR = "--auto --truth 25510 --quiet --json --gps-decimation 20 --log-decimation 10"


class CarPcError(Exception):
    """The rehearsal cannot be held; the message is one clear line."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fsai_hil.carpc", description=__doc__.splitlines()[0])
    parser.add_argument("--missions", default="static_inspection_a,acceleration", metavar="NAME[,NAME…]")
    parser.add_argument("--results", type=Path, default=CHECKOUT / "out" / "carpc", metavar="DIR")
    parser.add_argument("--timeout", type=float, default=BOOT_TO_END_S, metavar="S", help="(%(default)g)")
    args = parser.parse_args()
    try:
        return rehearse(args.missions, args.results.resolve(), args.timeout)
    except (CarPcError, VcanError) as error:
        print(f"fsai_hil.carpc: {error}", file=sys.stderr)
        return 1


def rehearse(missions: str, results: Path, timeout_s: float) -> int:
    """0 when everything came up, drove and recovered; the report is `results`/report.json."""
    machine = uml.find_user_mode_linux()
    results.mkdir(parents=True, exist_ok=True)
    for name in ("report.json", "journal.txt"):
        (results / name).unlink(missing_ok=True)
    installed = results / "root"
    install(installed)
    udev = udev_files(results)
    with tempfile.TemporaryDirectory(prefix="fsai-carpc-") as folder:
        exchange = Path(folder).resolve()
        init = exchange / "init"
        clock = preloaded_clock(exchange)
        modules = uml.module_files(machine.modules, MODULES)
        init.write_text(init_script(missions, installed, udev, results, modules, clock))
        init.chmod(0o755)
        (exchange / "up").touch()  # the time limit counts from here: a boot is what is rehearsed
        with (results / "console.log").open("wb") as log, uml.processor_of_its_own() as processor:
            in_time = uml.boot(machine, init, exchange, log, processor, MEMORY_MIB, timeout_s)
    if not in_time:
        raise CarPcError(f"not done after {timeout_s:g} s: {results / 'console.log'}")
    report = results / "report.json"
    if not report.is_file():
        raise CarPcError(f"the machine went off without a report: {results / 'console.log'}")
    steps = json.loads(report.read_text())
    for step in steps:
        took = "" if step["seconds"] is None else f"{step['seconds']:6.1f} s"
        print(f"{'ok   ' if step['passed'] else 'WRONG'} {took:>9}  {step['what']}  {step['words']}")
    return 0 if steps and all(step["passed"] for step in steps) else 1


def install(root: Path) -> None:
    """What `make install` installs, below `root`; what is up to date there is left alone."""
    # A configuration of an earlier rehearsal is not kept.
    shutil.rmtree(root / "etc", ignore_errors=True)
    done = subprocess.run(
        [CHECKOUT / "scripts" / "install-car", "install"], env={**os.environ, "DESTDIR": str(root)}, check=False
    )
    if done.returncode != 0:
        raise CarPcError("scripts/install-car failed")


def udev_files(results: Path) -> Path | None:
    """A folder with udev, without which systemd sees no devices; None where this machine has it."""
    if Path("/usr/lib/systemd/systemd-udevd").exists():
        return None
    folder = results / "udev"
    if (
        not (folder / "usr" / "lib" / "systemd" / "systemd-udevd").exists()
        and not (folder / "usr/bin/udevadm").exists()
    ):
        raise CarPcError("udev is not installed: sudo apt-get install -y udev")
    return folder


def init_script(
    missions: str, installed: Path, udev: Path | None, results: Path, modules: list[Path], clock: Mapping[str, str]
) -> str:
    """The first process: lays the root file system over this machine's, and hands over to systemd."""
    q = shlex.quote
    lower = "/mnt/installed" + (":/mnt/udev" if udev is not None else "") + ":/"
    inside = "/usr/lib/fsai/rehearsal"
    lines = [
        "#!/bin/sh",
        "export PATH=/usr/sbin:/usr/bin:/sbin:/bin",
        "trap 'echo o > /proc/sysrq-trigger; sleep 60' EXIT",
        "set -ex",
        "mount -t proc proc /proc",
        *(f"insmod {q(str(path))}" for path in modules),
        "mount -t tmpfs -o size=2000M tmpfs /mnt",
        "mkdir /mnt/upper /mnt/work /mnt/root /mnt/installed /mnt/udev",
        # A mount of its own for each: overlayfs wants its layers apart.
        f"mount -t hostfs none /mnt/installed -o {q(str(installed))}",
        *([f"mount -t hostfs none /mnt/udev -o {q(str(udev))}"] if udev is not None else []),
        f"mount -t overlay overlay -o lowerdir={lower},upperdir=/mnt/upper,workdir=/mnt/work /mnt/root",
        "cd /mnt/root",
        "mount -t proc proc proc",
        "mount -t sysfs sysfs sys",
        "mount -t tmpfs -o mode=1777 tmpfs tmp",
        "mount -t tmpfs -o mode=755,size=400M tmpfs var/log",
        "mkdir -p results var/log/journal",
        f"mount -t hostfs none results -o {q(str(results))}",
        "rm -f .dockerenv etc/systemd/system/*.wants/* etc/systemd/system/dbus-*",
        ": > etc/fstab",
        "echo car-pc > etc/hostname",
        *(f"ln -sf /dev/null etc/systemd/system/{unit}" for unit in MASKED),
        # The bench: vcan0, the simulated car and what it is seen with.
        "cp -r usr/share/fsai/bench/fsai-* etc/systemd/system/",
        "cp usr/share/fsai/bench/70-* etc/systemd/network/",
        f"sed -i 's/^interface = .*/interface = \"{INTERFACE}\"/' etc/fsai/fsai.toml",
        "sed -i 's/^keep_mib = .*/keep_mib = 200\\nleave_free_mib = 50/' etc/fsai/fsai.toml",
        *preload(clock),
        f"echo 'CAR_OPTIONS=--mission {missions} {CAR}' > etc/fsai/bench.env",
        f"cp {q(str(Path(__file__).with_name('inside.py')))} .{inside}",
        "cat > etc/systemd/system/rehearsal.service <<'UNIT'",
        "[Unit]",
        "Description=Rehearsal",
        "[Service]",
        "Type=exec",
        f"ExecStart=/opt/fsai/bin/python {inside} {INTERFACE} {len(missions.split(','))}",
        "UNIT",
        f"chroot . /usr/lib/fsai/settle {INTERFACE}",
        "chroot . systemctl enable systemd-networkd.service fsai-simulated-sensors.service",
        "mkdir -p etc/systemd/system/basic.target.wants",
        "ln -s ../rehearsal.service etc/systemd/system/basic.target.wants/",
        # Not a mere chroot: inside one there are no user namespaces, and services have one each.
        "pivot_root . mnt",
        "trap - EXIT",
        "exec chroot . /usr/lib/systemd/systemd --log-target=kmsg < /dev/console > /dev/console 2>&1",
    ]
    return "\n".join(lines) + "\n"


def preload(clock: Mapping[str, str]) -> list[str]:
    """Shell lines that give every service the clock that can be read without a system call."""
    if not clock:
        return []
    library = "/usr/lib/fsai/clock.so"
    variables = {**clock, "LD_PRELOAD": library}
    words = " ".join(f"{name}={value}" for name, value in variables.items())
    return [
        f"cp {shlex.quote(clock['LD_PRELOAD'])} .{library}",
        f"printf '[Service]\\nEnvironment={words}\\n' > usr/lib/systemd/system/fsai-.service.d/90-clock.conf",
    ]


if __name__ == "__main__":
    raise SystemExit(main())
