"""vcan0 in User-Mode Linux: a Linux kernel that runs as an ordinary process, with this machine's files as its disk.

No disk image and no privileges: the root is the host's `/`, read-only; `/tmp`, `/run` and `/dev/shm` are memory; the
results folder is the one writable place, at the same path inside and outside. The kernel's own messages go to a log,
the command's output comes through a console of its own, live.

A write to that folder is a write of the host's, and the whole machine stands still until it is done: while the host
flushes its disk, for longer than a rehearsal in real time allows. So what is behind the folder is the host's memory,
where there is room, and its content is moved to the disk when the machine is off, however it ended.

What makes it fast: every system call and page fault of a process inside is a hand-over between two host processes. On
one host processor that is a context switch; across two it is a wake-up of an idle one, which costs several times more.
So the whole machine is kept on one processor and goes before all others there. Reading the clock would
be such a system call, and the commonest: `clock.c` gives programs one to read without. And Python files are to be
compiled beforehand, because nothing can be cached inside.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fsai_hil.vcan.clock import preloaded_clock, slowed_clock
from fsai_hil.vcan.native import BIN, BRING_UP, TIMED_OUT, VcanError, end_group
from fsai_hil.vcan.preload import COMPILER, built

MODULES = ("can", "can-raw", "can-bcm", "can-gw", "vcan", "sch_tbf")
MEMORY_MIB = 2048
INSTALL = (
    "apt-get install -y user-mode-linux can-utils iproute2 kmod gcc libc6-dev (Debian, x86-64; Ubuntu has no such"
    " package, but vcan in its own kernel: modprobe vcan)"
)

_MODULES = Path("/usr/lib/uml")  # the folder above modules/VERSION, as the package has it
_IN_MEMORY = ("/tmp", "/run", "/dev/shm")  # what the machine inside has of its own, and so hides of the host's
_SHARED_MEMORY = Path("/dev/shm")
_RESULTS_MIB = 1024  # far above what a suite leaves behind
_BOOT_S = 300.0
_LOOK_S = 0.2
_RELAYED_S = 10.0
_NICENESS = -20
_REGISTERS = "set fp regs failed"  # the kernel's word where registers.c was not built
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


@dataclass(frozen=True)
class UserModeLinux:
    """An installed User-Mode Linux."""

    kernel: Path
    version: str


def find_user_mode_linux() -> UserModeLinux:
    """The installed User-Mode Linux. Raises VcanError with what to install."""
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        raise VcanError(
            f"User-Mode Linux is for x86-64 Linux only, and this is {platform.system()} {platform.machine()}"
        )
    kernel = shutil.which("linux.uml", path=f"{os.environ.get('PATH', '')}:{BIN}")
    missing = [] if kernel else ["linux.uml"]
    missing += [tool for tool in ("modprobe", "ip", "candump") if not shutil.which(tool, path=BIN)]
    if kernel is None or missing:
        raise VcanError(f"this kernel has no vcan and {', '.join(missing)} is not installed; as root: {INSTALL}")
    version = subprocess.run([kernel, "--version"], capture_output=True, text=True, check=False).stdout.strip()
    if not (_MODULES / "modules" / version).is_dir():
        raise VcanError(f"User-Mode Linux {version} is installed without its modules; as root: {INSTALL}")
    return UserModeLinux(Path(kernel), version)


def run_in_uml(
    argv: Sequence[str],
    *,
    cwd: Path,
    env: Mapping[str, str],
    timeout_s: float,
    results_dir: Path,
    memory_mib: int = MEMORY_MIB,
    pace: float = 1.0,
) -> int:
    """Run a command in a freshly booted User-Mode Linux. Returns its exit status, 124 if it took over `timeout_s`.

    cwd: its working directory, at the same path inside (read-only).
    env: its whole environment.
    timeout_s: for the command; the boot (1 to 3 s) is not counted in.
    results_dir: the one writable folder, at the same path inside, where what was there before is not seen; the kernel's
    log goes there as `uml-kernel.log`. Its content appears outside at the end.
    pace: how long a second of work inside takes, in seconds of this machine, `timeout_s` not; as if the processor were
    so many times faster. Idle time then takes none. For 1 nothing is changed.
    Its output goes to this process's standard output, live. Everything is ended on Ctrl-C and when this process dies.
    Raises VcanError if User-Mode Linux is not there or does not come up.
    """
    uml = find_user_mode_linux()
    results_dir = results_dir.resolve()
    results_dir.mkdir(parents=True, exist_ok=True)
    cwd = cwd.resolve()
    needed = _hidden((cwd, Path(sys.prefix), Path(sys.base_prefix)))
    with tempfile.TemporaryDirectory(prefix="fsai-uml-") as folder, _in_memory(results_dir, memory_mib) as staged:
        exchange = Path(folder).resolve()
        for path in (cwd, results_dir, staged, exchange, *needed):
            if "," in str(path):
                raise VcanError(f"a comma in a path cannot be passed to User-Mode Linux: {path}")
        if any(character.isspace() for character in str(exchange)):
            raise VcanError(f"the folder for temporary files has a blank in its name: {exchange}")
        clock = preloaded_clock(exchange, pace)
        if "LD_PRELOAD" in clock and "LD_PRELOAD" in env:
            clock["LD_PRELOAD"] += f":{env['LD_PRELOAD']}"
        env = {**env, **clock}
        lines = _first_process(argv, cwd, env, (staged, results_dir), exchange, needed)
        in_time = boot(uml, MODULES, lines, exchange, staged / "uml-kernel.log", memory_mib, timeout_s, pace)
        try:
            return int((exchange / "exit-status").read_text())
        except (OSError, ValueError):
            if not in_time and (exchange / "up").exists():
                return TIMED_OUT
            why = _why((staged / "uml-kernel.log").read_text(errors="replace"))
            raise VcanError(
                f"User-Mode Linux {uml.version} did not come up: {why} (all of it: {results_dir / 'uml-kernel.log'})"
            ) from None


def _why(kernel_log: str) -> str:
    """Return the line of a kernel's log that says why it ended: the first that says so, or the last."""
    lines = kernel_log.strip().splitlines() or ["no message"]
    why = next((line for line in lines if "failed" in line or "panic" in line), lines[-1])
    return f"{why}: this processor needs a C compiler for it; as root: {COMPILER}" if _REGISTERS in why else why


@contextlib.contextmanager
def _in_memory(results_dir: Path, memory_mib: int) -> Iterator[Path]:
    """A folder in memory whose content ends up in `results_dir`; where memory has no room, `results_dir` itself."""
    if not _has_room(_SHARED_MEMORY, memory_mib + _RESULTS_MIB):
        yield results_dir
        return
    staged = Path(tempfile.mkdtemp(prefix="fsai-results-", dir=_SHARED_MEMORY)).resolve()
    try:
        yield staged
    finally:
        shutil.copytree(staged, results_dir, symlinks=True, dirs_exist_ok=True)
        shutil.rmtree(staged)


def _has_room(folder: Path, mib: int) -> bool:
    try:
        status = os.statvfs(folder)
    except OSError:
        return False
    return os.access(folder, os.W_OK) and status.f_bavail * status.f_frsize >= mib << 20


def _hidden(paths: Iterable[Path]) -> list[Path]:
    """Return the folders that the inside would not see, because memory is mounted above them; outer ones first."""
    hidden: list[Path] = []
    for path in sorted(path.resolve() for path in paths):
        under_memory = any(path.is_relative_to(root) and path != Path(root) for root in _IN_MEMORY)
        if under_memory and not any(path.is_relative_to(outer) for outer in hidden):
            hidden.append(path)
    return hidden


def _first_process(
    argv: Sequence[str],
    cwd: Path,
    env: Mapping[str, str],
    results: tuple[Path, Path],
    exchange: Path,
    needed: Sequence[Path],
) -> list[str]:
    """Return the script of the first process inside: it mounts what is needed, and runs the command."""

    def folder(path: Path, options: str, behind: Path | None = None) -> list[str]:
        # The mount point is the host's path, made where memory now hides it.
        return [f"mkdir -p {_q(path)}", f"hostfs {_q(behind or path)} {_q(path)} {options}"]

    staged, results_dir = results
    environment = [_q(f"{name}={value}") for name, value in env.items()]
    return [
        "mount -t sysfs sysfs /sys",
        *(f"mkdir -p {path}; mount -t tmpfs tmpfs {path}" for path in _IN_MEMORY),
        "mkdir -p /dev/pts; mount -t devpts devpts /dev/pts",
        *(line for path in needed for line in folder(path, "ro")),
        *folder(results_dir, "rw", staged),
        *folder(exchange, "rw"),
        "echo uml > /proc/sys/kernel/hostname",
        # The kernel would halt all real-time processes for 50 ms once they have used 95 % of a second, and here it
        # counts what the host took from the machine as used by them.
        "echo -1 > /proc/sys/kernel/sched_rt_runtime_us",
        BRING_UP,
        "set +e",
        f"touch {_q(exchange / 'up')}",
        # `env -i`: words of its command line that the kernel does not know are in the first process's environment.
        f"(cd {_q(cwd)} && exec env -i {' '.join(environment)} {shlex.join(argv)}) < /dev/null > /dev/tty1 2>&1",
        f"echo $? > {_q(exchange / 'exit-status')}",
    ]


def _q(value: Path | str) -> str:
    return shlex.quote(str(value))


def boot(
    uml: UserModeLinux,
    modules: Sequence[str],
    lines: Sequence[str],
    exchange: Path,
    log_path: Path,
    memory_mib: int,
    timeout_s: float,
    pace: float,
) -> bool:
    """Boot, pass the command's output on until the machine is off. False if it had to be ended for its time limit.

    lines: of shell, what the first process does once the modules are there; what is printed on /dev/tty1 is the output.
    log_path: for the kernel's messages. timeout_s: of this machine, from `exchange`/up on.
    """
    (exchange / "lib").unlink(missing_ok=True)
    (exchange / "lib").symlink_to(_MODULES)  # where modprobe looks below its root
    begin = [
        "#!/bin/sh",
        f"export PATH={BIN}",
        # Whatever fails ends the machine; the kernel's log has the failed command's message.
        "power_off() { sync; echo o > /proc/sysrq-trigger; sleep 60; }",
        "trap power_off EXIT",
        # hostfs FOLDER PLACE OPTION: since Linux 6.11 the folder has a name among the options; before, it had none.
        'hostfs() { mount -t hostfs -o "$3,hostfs=$1" none "$2" 2>/dev/null || mount -t hostfs -o "$3,$1" none "$2"; }',
        "set -e",
        "mount -t proc proc /proc",
        # Received frames are handed over before any program goes on. What an adapter's interrupt does on a PC, this
        # thread of the kernel's does for vcan. On the only processor it would wait for whatever else runs, and bridge
        # and car would receive nothing for tens of milliseconds, which the stall monitor does not see. The priority is
        # that of a real-time kernel's interrupt threads: above the bridge, below the stall monitor.
        "chrt --fifo --pid 50 $(grep -lx ksoftirqd/0 /proc/[0-9]*/comm | cut -d/ -f3)",
        f"modprobe -d {_q(exchange)} -a {shlex.join(modules)}",
        "stty -F /dev/tty1 -opost -echo",
    ]
    init = exchange / "init"
    init.write_text("\n".join((*begin, *lines, "")))
    init.chmod(0o755)
    clock = slowed_clock(exchange, pace)
    preloaded = [clock.pop("LD_PRELOAD", ""), str(built("registers", exchange) or "")]
    output, console = os.pipe()
    command = [
        str(uml.kernel),
        "rootfstype=hostfs",
        "rootflags=/",
        "ro",
        f"mem={memory_mib}M",
        f"init={init}",
        f"uml_dir={exchange}",
        "con=null",
        "con0=null,fd:1",  # the kernel's console: its log
        f"con1=null,fd:{console}",  # the command's
        *([f"iomem=mmapper,{clock['FSAI_SKIPPED']}"] if clock else []),
    ]
    environment = {"PATH": BIN, "HOME": str(exchange), "TMPDIR": str(_memory_folder(memory_mib)), **clock}
    environment["LD_PRELOAD"] = ":".join(filter(None, preloaded))
    sys.stdout.flush()
    with log_path.open("ab") as log, processor_of_its_own() as processor:
        process: subprocess.Popen[bytes] | None = None
        relay: subprocess.Popen[bytes] | None = None
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                pass_fds=(console,),
                env=environment,
                start_new_session=True,
                preexec_fn=lambda: _settle(processor),
            )
            os.close(console)
            # Not our own standard output: the machine would make it non-blocking for everybody who has it.
            relay = subprocess.Popen(["cat"], stdin=output, start_new_session=True)
            os.close(output)
            limit = time.monotonic() + _BOOT_S
            up = False
            while time.monotonic() < limit:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_LOOK_S)
                    return True
                if not up and (exchange / "up").exists():
                    up = True
                    limit = time.monotonic() + timeout_s
            return False
        finally:
            if process is not None:
                end_group(process)
            if relay is not None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    relay.wait(_RELAYED_S)  # what the machine has still printed, for a reader who takes his time
                end_group(relay)


def _settle(cpu: int) -> None:
    """Put the child onto one processor, ahead of others there where allowed; it ends with the parent."""
    os.sched_setaffinity(0, {cpu})
    # A rehearsal in real time shares that processor badly: each hand-over between two processes is a wake-up, at which
    # another's turn may come first. So others get a hundredth of it. (Real-time scheduling would be worse: what is
    # always busy there loses the processor for 50 ms in each second.) The session's own niceness counts where the
    # kernel groups processes by session (sched(7), autogroup), the process's elsewhere.
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)
        Path("/proc/self/autogroup").write_text(f"{_NICENESS}\n")
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


@contextlib.contextmanager
def processor_of_its_own() -> Iterator[int]:
    """A processor of this process that no other User-Mode Linux has claimed, claimed; if all are, the last."""
    processors = sorted(os.sched_getaffinity(0), reverse=True)  # the first often has the machine's interrupts
    with socket.socket(socket.AF_UNIX) as claim:
        for cpu in processors:
            # An abstract name: no file is left behind, and the kernel drops it with the process, however it dies.
            with contextlib.suppress(OSError):
                claim.bind(f"\0fsai-user-mode-linux/processor-{cpu}")
                yield cpu
                return
        yield processors[0]


def _memory_folder(memory_mib: int) -> Path:
    """Return where the file behind the machine's memory fits and may be mapped executable; memory rather than disk."""
    for folder in (_SHARED_MEMORY, Path(tempfile.gettempdir()), Path("/var/tmp")):
        if _has_room(folder, memory_mib) and not os.statvfs(folder).f_flag & os.ST_NOEXEC:
            return folder
    raise VcanError(f"no folder for temporary files has {memory_mib} MiB free for User-Mode Linux's memory")
