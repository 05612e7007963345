"""The stages of `make test`: what a stage lacks on this machine is said, and is no pass."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("name", "status", "verdict"),
    [
        ("rehearsal", 0, "passed"),
        ("rehearsal", 1, "FAILED (status 1)"),
        ("rehearsal", -9, "FAILED (status -9)"),
        ("rehearsal", 77, "not tried (udev not installed)"),
        ("hil", 77, "FAILED (status 77)"),
    ],
)
def test_a_stage_is_passed_failed_or_not_tried(tmp_path: Path, name: str, status: int, verdict: str) -> None:
    stage = runpy.run_path(str(CHECKOUT / "scripts/test"))["Stage"]
    log = tmp_path / "rehearsal.log"
    log.write_text("installed\nudev not installed\n\n")
    assert stage(name, log, status=status).verdict == verdict


def test_services_are_not_rehearsed_without_systemd(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from fsai_hil.rehearsal.carpc import __main__ as carpc

    monkeypatch.setattr(carpc, "NEEDED", {"systemd": tmp_path / "absent", "udev": tmp_path})
    monkeypatch.setattr("sys.argv", ["carpc", "--short"])
    assert carpc.main() == 77
    assert "sudo apt-get install -y systemd\n" in capsys.readouterr().out


def test_a_failed_stage_is_the_failure_of_all(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("true", "false"):
        (tmp_path / name).symlink_to(f"/usr/bin/{name}")
    (tmp_path / "python").symlink_to("/usr/bin/true")
    main = runpy.run_path(str(CHECKOUT / "scripts/test"))["main"]
    for programs, status in ((("true", "false"), 1), (("true", "true"), 0)):
        stages = dict(zip(("lint", "types"), (("", ((program,),)) for program in programs), strict=True))
        known = {
            "STAGES": stages,
            "BIN": tmp_path,
            "LOGS": tmp_path,
            "LANES": (("lint", "types"),),
            "SOURCES": (),
        }
        for name, value in known.items():
            monkeypatch.setitem(main.__globals__, name, value)
        monkeypatch.setattr("sys.argv", ["test"])
        assert main() == status
