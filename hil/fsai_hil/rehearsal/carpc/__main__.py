"""`python -m fsai_hil.rehearsal.carpc`: a car PC in User-Mode Linux boots, drives, and recovers by itself.

The machine's root is this machine's, seen through an overlay: the unpacked Debian package lies on top of it, and
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

from msgspec.structs import replace

from fsai_hil import CHECKOUT
from fsai_hil.rehearsal.bus_watch import CODEC, HOUR_NS
from fsai_hil.rehearsal.carpc import scenes
from fsai_hil.rehearsal.stall_monitor import RUNS
from fsai_hil.rules.checker import checker_for, read_candump
from fsai_hil.vcan import VcanError, uml
from fsai_hil.vcan.clock import SKIPPED, SLOWEST_PACE, preloaded_clock
from fsai_vcu.interface.errors import UserError

PACKAGE = "fsai-vcu"
_DPKG = Path("var/lib/dpkg")
MODULES = ("can", "can-raw", "vcan", "overlay", "veth")
MEMORY_MIB = 3072
BOOT_TO_END_S = 900.0
SHORT_PACE = 3.0  # the short form is for changes of the sources, on any machine; figures are the full one's
INTERFACE = "vcan0"
# Without udev systemd sees no devices.
NEEDED = {"systemd": Path("/usr/lib/systemd/systemd"), "udev": Path("/usr/lib/systemd/systemd-udevd")}
APT = "sudo apt-get install -y"
NOT_TRIED = 77  # the status of a stage of scripts/test
# Of this machine's services none is wanted inside; and what systemd would look for there is not.
MASKED = ("getty.target", "systemd-logind.service", "systemd-firstboot.service", "systemd-udev-settle.service")
CAR = f"--auto --json {' '.join(scenes.LIGHT)}"
REHEARSAL = """[Unit]
Description=Rehearsal
[Service]
Type=exec
RuntimeDirectory=rehearsal
RuntimeDirectoryMode=0755
RuntimeDirectoryPreserve=yes
KillMode=mixed
TimeoutStopSec=90s
StandardOutput=tty
TTYPath=/dev/tty1"""


def main() -> int:
    """Build the package, boot the machine and play the rehearsal in it; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.rehearsal.carpc",
        description=__doc__.splitlines()[0],
        epilog="example: python -m fsai_hil.rehearsal.carpc --short",
    )
    parser.add_argument("--missions", default="static_inspection_a,acceleration", metavar="NAME[,NAME…]")
    parser.add_argument(
        "--short",
        action="store_true",
        help="this environment instead of a package; the boot, the doctor, the sandbox, and one drive in the middle of "
        "which the bridge is killed",
    )
    parser.add_argument("--results", type=Path, default=CHECKOUT / "out" / "carpc", metavar="DIR")
    parser.add_argument("--timeout", type=float, default=BOOT_TO_END_S, metavar="S", help="(%(default)g)")
    parser.add_argument(
        "--pace",
        type=float,
        metavar="N",
        help=f"how many seconds of this machine a second inside takes, as if it were so much faster (1; with --short "
        f"{SHORT_PACE:g})",
    )
    args = parser.parse_args()
    pace = args.pace if args.pace is not None else SHORT_PACE if args.short else 1.0
    if not 1.0 <= pace <= SLOWEST_PACE:
        parser.error(f"--pace is {pace:g}, but must be from 1 to {SLOWEST_PACE:g}")
    if missing := [name for name, program in NEEDED.items() if not program.exists()]:
        print(f"{' and '.join(missing)} not installed, without which nothing is rehearsed: {APT} {' '.join(missing)}")
        return NOT_TRIED
    try:
        return rehearse(args.missions, args.results.resolve(), args.timeout, args.short, pace)
    except (UserError, VcanError) as error:
        print(f"fsai_hil.rehearsal.carpc: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("fsai_hil.rehearsal.carpc: interrupted", file=sys.stderr)
        return 130


def rehearse(missions: str, results: Path, timeout_s: float, short: bool, pace: float) -> int:
    """0 when everything came up, drove and recovered in time; the report is `results`/report.json.

    All times are inside's, where a second takes `pace` seconds of this machine.
    """
    machine = uml.find_user_mode_linux()
    results.mkdir(parents=True, exist_ok=True)
    for old in (*results.glob("*.json"), *results.glob("*.txt"), *results.glob("*.log"), results / "again"):
        old.unlink(missing_ok=True)
    installed = results / ("laid-out" if short else "root")
    if short:
        shutil.rmtree(installed / "etc", ignore_errors=True)  # a configuration of an earlier rehearsal is not kept
        install_car("install", DESTDIR=installed, ENVIRONMENT=Path(sys.prefix))
    else:
        install_car("deb", results, PAYLOAD=results / "payload")
        unpack(max(results.glob(f"{PACKAGE}_*.deb"), key=lambda path: path.stat().st_mtime_ns), installed)
    if pace != 1.0:
        print(f"{pace:g} s of this machine for each second inside", flush=True)
    with tempfile.TemporaryDirectory(prefix="fsai-carpc-") as folder:
        exchange = Path(folder).resolve()
        lines = first_process(missions, installed, results, preloaded_clock(exchange, pace), short)
        (exchange / "up").touch()  # the time limit counts from here: a boot is what is rehearsed
        print(f"{'':5} {'took':>10} {'stated':>10}   what", flush=True)

        def boot() -> bool:
            log = results / "console.log"
            return uml.boot(machine, MODULES, lines, exchange, log, MEMORY_MIB, pace * timeout_s, pace)

        in_time = boot()
        for _ in range(RUNS):
            if in_time and (results / "again").exists():  # a reboot may end User-Mode Linux
                in_time = boot()
    if not in_time:
        raise UserError(f"not done after {timeout_s:g} s: {results / 'console.log'}")
    report = results / "report.json"
    if not report.is_file():
        raise UserError(f"the machine went off without a report: {results / 'console.log'}")
    if (results / "again").exists():
        raise UserError(f"the machine did not come back from its reboot: {results / 'console.log'}")
    kept = [rules_kept(log) for log in sorted(results.glob("bus-*.log"))]
    return 0 if all_well(json.loads(report.read_text())) and all(kept) else 1


def install_car(*words: str | Path, **variables: Path) -> None:
    """Install the car's software; parts that are up to date are left alone. Raises VcanError."""
    environment = {**os.environ, **{name: str(path) for name, path in variables.items()}}
    done = subprocess.run([CHECKOUT / "scripts" / "install-car", *words], env=environment, check=False)
    if done.returncode != 0:
        raise VcanError(f"scripts/install-car {words[0]} failed")


def unpack(package: Path, root: Path, dpkg: Path = Path("/") / _DPKG) -> None:
    """Unpack it below `root` by dpkg, beside what this machine says is installed; what is configured is left to do.

    Its dependencies are judged when it is configured, which is done in the rehearsed machine. Other packages' triggers,
    such as the manual pages' index, are left: their scripts are not below `root`.
    """
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    shutil.copytree(dpkg, root / _DPKG, symlinks=True)
    words = ["dpkg", f"--root={root}", "--force-unsafe-io", "--no-triggers", "--unpack", str(package)]
    if os.geteuid() != 0:
        if shutil.which("fakeroot") is None:
            raise VcanError("dpkg unpacks as root only; as another: sudo apt-get install -y fakeroot")
        words = ["fakeroot", *words]
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    done = subprocess.run(words, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise VcanError(f"dpkg does not unpack {package.name}: {done.stderr.strip()[-300:]}")


def all_well(steps: list[dict[str, object]]) -> bool:
    """Return whether every point passed; one that a disturbed machine made fail, and played again, does not count."""
    counting = [step for step in steps if step["counts"]]
    return bool(counting) and all(step["passed"] for step in counting)


def rules_kept(log: Path) -> bool:
    """The bus log of one drive, judged by the independent checker. Prints its line."""
    checker = checker_for(CODEC, busy_machine=True)
    first_ns: int | None = None
    for frame in read_candump(log):
        first_ns = frame.t_ns if first_ns is None else first_ns
        hours = round((frame.t_ns - first_ns) / HOUR_NS)  # the clock was stepped by whole ones
        checker.on_frame(replace(frame, t_ns=frame.t_ns - hours * HOUR_NS))
    print(f"{'ok   ' if checker.ok else 'WRONG'} {'':24} {log.name} keeps the safety rules")
    if not checker.ok:
        print(checker)
    return checker.ok


def first_process(missions: str, installed: Path, results: Path, clock: Mapping[str, str], short: bool) -> list[str]:
    """The first process: lays the root file system over this machine's, and hands over to systemd."""
    q = shlex.quote
    options = " --short" if short else ""
    variables = {**clock, "LD_PRELOAD": "/usr/lib/rehearsal-clock.so"} if clock else {}
    return [
        "set -x",
        "mount -t tmpfs -o size=2000M tmpfs /mnt",
        "mkdir /mnt/upper /mnt/work /mnt/root /mnt/installed",
        # A mount of its own for each: overlayfs wants its layers apart.
        f"hostfs {q(str(installed))} /mnt/installed rw",
        "mount -t overlay overlay -o lowerdir=/mnt/installed:/,upperdir=/mnt/upper,workdir=/mnt/work /mnt/root",
        "cd /mnt/root",
        "mount -t proc proc proc",
        "mount -t sysfs sysfs sys",
        "mount -t tmpfs -o mode=1777 tmpfs tmp",
        "mount -t tmpfs -o mode=755,size=160M tmpfs var/log",
        "mkdir -p results var/log/journal",
        f"hostfs {q(str(results))} results rw",
        "rm -f .dockerenv etc/systemd/system/*.wants/* etc/systemd/system/dbus-*",
        ": > etc/fstab",
        "echo car-pc > etc/hostname",
        *(f"ln -sf /dev/null etc/systemd/system/{unit}" for unit in MASKED),
        *([] if short else [f"chroot . dpkg --no-triggers --configure {PACKAGE}"]),
        # The bench: vcan0, the simulated car and what it is seen with.
        "cp -r usr/share/fsai/bench/fsai-* etc/systemd/system/",
        "cp usr/share/fsai/bench/70-* etc/systemd/network/",
        f"sed -i 's/^interface = .*/interface = \"{INTERFACE}\"/' etc/fsai/fsai.toml",
        "sed -i 's/^keep_mib = .*/keep_mib = 100\\nleave_free_mib = 30/' etc/fsai/fsai.toml",
        *preload(clock, variables),
        f"echo 'CAR_OPTIONS=--mission {missions} {CAR}' > etc/fsai/bench.env",
        "cat > etc/systemd/system/rehearsal.service <<'UNIT'",
        *REHEARSAL.splitlines(),
        *(f"Environment={name}={value}" for name, value in variables.items()),
        f"ExecStart=/opt/fsai/bin/python -m {scenes.__name__} {INTERFACE} {len(missions.split(','))}{options}",
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


def preload(clock: Mapping[str, str], variables: Mapping[str, str]) -> list[str]:
    """Shell lines that give every service the clock that can be read without a system call."""
    if not clock:
        return []
    words = " ".join(f"{name}={value}" for name, value in variables.items())
    page = f"BindReadOnlyPaths=-{SKIPPED}\\nDeviceAllow={SKIPPED} r\\n" if "FSAI_SKIPPED" in clock else ""
    return [
        *([f"chmod a+r {SKIPPED} || true"] if page else []),  # without it the services ask the kernel for the time
        f"cp {shlex.quote(clock['LD_PRELOAD'])} .{variables['LD_PRELOAD']}",
        "mkdir -p etc/systemd/system/fsai-.service.d",
        f"printf '[Service]\\nEnvironment={words}\\n{page}' > etc/systemd/system/fsai-.service.d/90-clock.conf",
    ]


if __name__ == "__main__":
    raise SystemExit(main())
