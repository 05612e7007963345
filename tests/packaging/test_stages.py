"""The stages of `make test`: what a stage lacks on this machine is said, and is no pass."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("status", "verdict"),
    [(0, "passed"), (1, "FAILED (status 1)"), (-9, "FAILED (status -9)"), (77, "not tried (udev not installed)")],
)
def test_a_stage_is_passed_failed_or_not_tried(tmp_path: Path, status: int, verdict: str) -> None:
    stage = runpy.run_path(str(CHECKOUT / "scripts/test"))["Stage"]
    log = tmp_path / "rehearsal.log"
    log.write_text("installed\nudev not installed\n\n")
    assert stage("rehearsal", log, status=status).verdict == verdict


def test_services_are_not_rehearsed_without_systemd(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from fsai_hil.rehearsal.carpc import __main__ as carpc

    monkeypatch.setattr(carpc, "NEEDED", {"systemd": tmp_path / "absent", "udev": tmp_path})
    monkeypatch.setattr("sys.argv", ["carpc", "--short"])
    assert carpc.main() == 77
    assert "sudo apt-get install -y systemd\n" in capsys.readouterr().out
