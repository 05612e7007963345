"""A place gives a command a vcan0 of its own, carries its output and exit status out, and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Literal

import pytest

from fsai_hil.vcan import VcanError, choose_place, native, run_in_uml, uml
from fsai_hil.vcan.native import TIMED_OUT

CHECKOUT = Path(__file__).parents[2]
ENVIRONMENT = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "SAID": 'it\'s "quoted" $HOME'}


def _uml_missing() -> str | None:
    try:
        uml.find_user_mode_linux()
    except VcanError as error:
        return str(error)
    return None


# A machine whose own kernel has vcan needs no User-Mode Linux, and `make setup` does not install it there.
needs_uml = pytest.mark.skipif(_uml_missing() is not None, reason=str(_uml_missing()))


# How long a command may take before it is ended: first too little for any, then what a busy machine needs to begin it.
LIMITS_S = (1, 10, 60)
PATIENCE_S = 60.0


def processes_of(folder: Path) -> list[int]:
    """Processes with something under `folder` on their command line."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and str(folder).encode() in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except OSError:  # it ended meanwhile
            continue
    return found


def left_of(folder: Path) -> list[int]:
    """Those that do not end either: a killed process is soon gone, but some other one has to be there to reap it."""
    until = time.monotonic() + PATIENCE_S
    while (left := processes_of(folder)) and time.monotonic() < until:
        time.sleep(0.02)
    return left


@needs_uml
def test_a_command_in_uml_keeps_environment_folder_and_status(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    results = tmp_path / "results of it"
    command = (
        'seq 1 50000; ip -color=never -br link show vcan0; pwd; echo "$SAID"; env | cut -d= -f1 | sort | tr "\\n" " "; '
        f'touch {CHECKOUT}/written-inside; echo kept > "{results}/kept"; exit 7'
    )
    status = run_in_uml(["sh", "-c", command], cwd=CHECKOUT, env=ENVIRONMENT, timeout_s=60, results_dir=results)
    lines = capfdbinary.readouterr().out.decode().splitlines()
    assert status == 7
    assert lines[:50000] == [str(number) for number in range(1, 50001)], "the output is complete and in order"
    assert lines[50000].startswith("vcan0") and "UP" in lines[50000]
    assert lines[50001:50003] == [str(CHECKOUT), ENVIRONMENT["SAID"]]
    assert set(lines[50003].partition(" touch")[0].split()) <= {
        "PATH",
        "SAID",
        "PWD",
        "LD_PRELOAD",
        "FSAI_NS_PER_COUNT",
    }
    assert not (CHECKOUT / "written-inside").exists(), "the checkout is read-only inside"
    assert (results / "kept").read_text() == "kept\n"
    assert "Linux version" in (results / "uml-kernel.log").read_text()


@needs_uml
def test_every_clock_in_uml_goes_by_the_pace(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    """Work does, by the kernel's clock, by the one that programs are given, and by the wall clock."""
    pace = 2.0
    # At each reading of the kernel's clock a folder is made, and this machine stamps it by its own.
    kernel = "import os, sys, time; os.mkdir(sys.argv[1]); print(time.monotonic())"
    inside = (
        "import subprocess, sys, time\n"
        "def asked(stamp):\n"
        f"    kernel = [sys.executable, '-S', '-c', {kernel!r}, {str(tmp_path)!r} + '/' + stamp]\n"
        "    return float(subprocess.run(kernel, env={}, stdout=subprocess.PIPE, check=True).stdout)\n"
        "before = asked('first'); began, wall = time.monotonic(), time.time()\n"
        "while time.monotonic() < began + 1.0: pass\n"
        "print(time.monotonic() - began, time.time() - wall, asked('second') - before)"
    )
    status = run_in_uml(
        [sys.executable, "-c", inside], cwd=Path("/"), env=ENVIRONMENT, timeout_s=60, results_dir=tmp_path, pace=pace
    )
    assert status == 0
    by_program_s, by_wall_s, by_kernel_s = map(float, capfdbinary.readouterr().out.split())
    assert 1.0 <= by_program_s <= by_kernel_s
    assert by_wall_s == pytest.approx(by_program_s, abs=0.1)
    took_s = (tmp_path / "second").stat().st_mtime - (tmp_path / "first").stat().st_mtime
    assert took_s == pytest.approx(pace * by_kernel_s, rel=0.1)


@needs_uml
@pytest.mark.parametrize("room_in_memory", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_command_too_long_in_uml_is_ended_and_its_files_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room_in_memory: bool
) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    monkeypatch.setattr(uml, "_SHARED_MEMORY", shared if room_in_memory else tmp_path / "absent")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    results = tmp_path / "results"
    (results / "log").mkdir(parents=True)
    (results / "log" / "earlier").write_text("kept")
    command = ["sh", "-c", f"mkdir -p {results}/log; echo begun > {results}/log/now; sleep 1000 & while :; do :; done"]
    begun = results / "log" / "now"
    for limit_s in LIMITS_S:
        status = run_in_uml(command, cwd=CHECKOUT, env=ENVIRONMENT, timeout_s=limit_s, results_dir=results)
        assert status == TIMED_OUT
        assert left_of(tmp_path) == []
        if begun.exists() and begun.stat().st_size:
            break
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results", "shared"]
    assert begun.read_text() == "begun\n"
    assert (results / "log" / "earlier").read_text() == "kept"
    assert (results / "uml-kernel.log").exists()
    assert list(shared.iterdir()) == []


def test_two_at_once_take_different_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    lower, higher = (1_000_000_000 + 10 * os.getpid() + each for each in (1, 3))  # whoever else runs this has others
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {lower, higher})
    with uml.processor_of_its_own() as first, uml.processor_of_its_own() as second, uml.processor_of_its_own() as third:
        assert (first, second, third) == (higher, lower, higher)
    with uml.processor_of_its_own() as again:
        assert again == higher


@needs_uml
def test_ctrl_c_ends_uml_and_leaves_nothing_behind(tmp_path: Path) -> None:
    program = (
        "import sys, pathlib; from fsai_hil.vcan import run_in_uml; "
        "run_in_uml(['sh', '-c', 'echo begun; exec sleep 1000'], cwd=pathlib.Path('/'), env={'PATH': '/bin:/usr/bin'}, "
        "timeout_s=100, results_dir=pathlib.Path(sys.argv[1]) / 'results')"
    )
    caller = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert caller.stdout is not None
    assert caller.stdout.readline() == b"begun\n", "its output comes out while it runs"
    caller.send_signal(signal.SIGINT)
    _, complaint = caller.communicate(timeout=PATIENCE_S)
    assert b"KeyboardInterrupt" in complaint
    assert left_of(tmp_path) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results"]


@needs_uml
def test_uml_that_does_not_come_up_says_so_and_where_its_log_is(tmp_path: Path) -> None:
    with pytest.raises(VcanError, match=r"did not come up: .*uml-kernel\.log") as refused:
        run_in_uml(["true"], cwd=CHECKOUT, env={}, timeout_s=5, results_dir=tmp_path, memory_mib=8)
    assert "\n" not in str(refused.value)


@needs_uml
def test_uml_without_its_modules_says_how_to_get_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uml, "_MODULES", tmp_path)
    with pytest.raises(VcanError, match=r"is installed without its modules; as root: .*user-mode-linux"):
        uml.find_user_mode_linux()


@needs_uml
def test_by_a_slower_clock_idle_time_takes_none(tmp_path: Path) -> None:
    status = run_in_uml(["sleep", "600"], cwd=CHECKOUT, env=ENVIRONMENT, timeout_s=60, results_dir=tmp_path, pace=3.0)
    assert status == 0, "ten minutes are over in less than one"


@needs_uml
def test_a_native_place_has_interfaces_of_its_own(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    # User-Mode Linux is here a kernel that has vcan: inside, the native way is the one that is taken.
    inner = "ls /sys/class/net; cansend vcan0 123#01; exit 5"
    program = (
        "import sys, pathlib; from fsai_hil.vcan import choose_place; place = choose_place(); print(place.name); "
        f"sys.exit(place.run(['sh', '-c', {inner!r}], cwd=pathlib.Path('/'), env={{'PATH': '/bin:/usr/bin'}}, "
        f"timeout_s=180, results_dir=pathlib.Path({str(tmp_path)!r})))"
    )
    outer = 'ip link add dev vcan7 type vcan; "$@"; echo "status $?"; cat /sys/class/net/vcan0/statistics/tx_packets'
    status = run_in_uml(
        ["sh", "-c", outer, "sh", sys.executable, "-u", "-c", program],
        cwd=CHECKOUT,
        env=ENVIRONMENT,
        timeout_s=180,
        results_dir=tmp_path,
    )
    assert status == 0
    assert capfdbinary.readouterr().out.decode().split() == ["native", "lo", "vcan0", "status", "5", "0"]


def test_a_native_command_too_long_is_ended_with_its_children(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "namespace_prefix", lambda: None)
    monkeypatch.setattr(native, "existing_vcan", lambda: True)
    mark = tmp_path / "child-of-a-native-command"
    command = ["sh", "-c", f"sh -c 'sleep 1000; : {mark}' & : > {mark}; wait"]
    for limit_s in LIMITS_S:
        status = native.run_natively(command, cwd=CHECKOUT, env=ENVIRONMENT, timeout_s=limit_s, results_dir=tmp_path)
        assert status == TIMED_OUT
        if mark.exists():
            break
    assert mark.exists(), "it had started its child"
    assert left_of(mark) == []


@pytest.mark.parametrize(
    ("wanted", "words"),
    [("auto", r"no vcan .*linux\.uml.* apt-get install -y user-mode-linux"), ("native", "modprobe vcan")],
)
def test_without_vcan_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, wanted: Literal["auto", "native"], words: str
) -> None:
    monkeypatch.setattr("fsai_hil.vcan.native_vcan_available", lambda: False)
    monkeypatch.setattr("shutil.which", lambda *_, **__: None)
    with pytest.raises(VcanError, match=words) as refused:
        choose_place(wanted)
    assert "\n" not in str(refused.value)


def test_the_kernels_own_vcan_is_preferred(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsai_hil.vcan.native_vcan_available", lambda: True)
    monkeypatch.setattr("shutil.which", lambda *_, **__: None)
    assert choose_place().name == "native"
