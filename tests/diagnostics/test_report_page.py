"""The page as a file: small, whole, allowed nothing, and true to the log it was made of."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from story_runs import branch, driving, log_of, of_ids, page, twice

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.explain import Record
from fsai_vcu.diagnostics.explain.record import Series
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import Frames, joined
from fsai_vcu.diagnostics.page.curves import BUCKETS, Curve, lanes, packed, plots, thinned
from fsai_vcu.interface.units import MS, S


@pytest.fixture(scope="module")
def frames() -> Frames:
    return branch(driving(), lambda run: run.switch(ebs_fault=True), 0.5).frames


@pytest.fixture(scope="module")
def html(frames: Frames) -> str:
    return page(frames, "run.log")


def data_of(html: str) -> Any:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def unpacked(curve: dict[str, Any], digits: int) -> tuple[np.ndarray, np.ndarray]:
    values = [np.nan if v is None else v / 10**digits for v in curve["v"]]
    return np.cumsum(curve["dt"]) / 1e4, np.array(values)


def test_the_policy_allows_only_the_pages_own_style_and_script(html: str) -> None:
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', html)
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy[1].split(";"))
    assert rules["default-src"] == "'none'"
    for tag, rule in (("style", "style-src"), ("script", "script-src")):
        inside = re.findall(rf"<{tag}>(.*?)</{tag}>", html, re.DOTALL)
        assert len(inside) == 1
        digest = base64.b64encode(hashlib.sha256(inside[0].encode()).digest()).decode()
        assert rules[rule] == f"'sha256-{digest}'"
    assert set(rules) == {"default-src", "style-src", "script-src", "img-src", "base-uri", "form-action"}
    assert " style=" not in html and " onclick=" not in html


def test_the_page_names_no_place_outside_itself(html: str) -> None:
    assert re.findall(r"(?:https?:)?//[a-z0-9.-]+\.[a-z]{2,}", html) == []


def test_the_page_has_the_story_of_explain(html: str) -> None:
    assert "Because the emergency brake system failed (EBS_FAULT)." in html
    assert "What to do:" in html
    assert "AS_DRIVING → EMERGENCY_BRAKE" in html


def test_the_page_has_a_row_of_figures_for_every_message(html: str, frames: Frames) -> None:
    rows = set(re.findall(r'<th scope="row">0x([0-9A-F]{3})</th>', html))
    assert rows == {f"{can_id:03X}" for can_id in np.unique(frames.can_id).tolist()}


def test_a_page_opens_where_the_car_was_last_heard() -> None:
    whole = log_of(driving().frames)
    end_ns, silent_ns = int(whole.t_ns[-1]), int(whole.t_ns[-1]) - 2 * S
    off = whole.only((whole.can_id != 0x520) | (whole.t_ns < silent_ns))
    data = data_of(page(off, "run.log"))
    assert data["extent"][1] == pytest.approx((end_ns - int(whole.t_ns[0])) / S, abs=1e-3)
    assert data["extent"][1] - 2.02 < data["heard"] < data["extent"][1] - 1.98


def test_a_logs_name_is_text_and_data_cannot_end_their_script() -> None:
    text = page(log_of(driving().frames), "</script><script>alert(1)</script>")
    assert '<h1 id="channel">&lt;/script&gt;' in text
    assert data_of(text)["plots"] and text.count("</script") == 2


def test_every_curve_begins_ends_and_peaks_as_the_log_does(html: str, frames: Frames) -> None:
    record = Record(frames)
    shown = {plot["slug"]: plot for plot in data_of(html)["plots"]}
    for plot in plots(record):
        for curve, drawn in zip(plot.curves, shown[plot.slug]["curves"], strict=True):
            t_s, values = unpacked(drawn, plot.digits)
            real = curve.series
            half = 0.5001 * 10**-plot.digits
            assert abs(np.nanmax(values) - real.values.max()) <= half
            assert abs(np.nanmin(values) - real.values.min()) <= half
            assert abs(t_s[0] - (real.t_ns[0] - record.begin_ns) / 1e9) < 2e-4
            assert abs(t_s[-1] - (real.t_ns[-1] - record.begin_ns) / 1e9) < 2e-4


def test_thinning_keeps_a_spike_of_one_frame_in_an_hour() -> None:
    t_ns = np.arange(360_000, dtype=np.int64) * 10 * MS
    values = np.sin(np.arange(360_000) / 50.0)
    values[123_456] = 9.0
    values[234_567] = -9.0
    t_out, v_out = thinned(Series(t_ns, values), 0, int(t_ns[-1]))
    assert len(t_out) <= 4 * BUCKETS + 8
    assert v_out.max() == 9.0 and v_out.min() == -9.0
    assert t_out[v_out.argmax()] == t_ns[123_456]
    assert (np.diff(t_out) >= 0).all()


def test_a_message_that_was_missing_leaves_a_hole_in_its_curve() -> None:
    t_ns = np.concatenate((np.arange(50), np.arange(150, 200))).astype(np.int64) * 10 * MS
    curve = Curve("x", Series(t_ns, np.ones(100)))
    drawn = packed(curve, 0, 0, 0, int(t_ns[-1]))
    t_s, values = unpacked(drawn, 0)
    hole = int(np.flatnonzero(np.isnan(values))[0])
    assert abs(t_s[hole - 1] - 0.49) < 1e-3 and abs(t_s[hole + 1] - 1.5) < 1e-3


def test_lanes_show_the_as_states_one_behind_the_other(frames: Frames) -> None:
    lane = next(lane for lane in lanes(Record(frames), 0) if lane["name"] == "AS state")
    assert [span[2] for span in lane["spans"]] == ["AS_INIT", "AS_OFF", "AS_READY", "AS_DRIVING", "EMERGENCY_BRAKE"]
    for one, following in zip(lane["spans"], lane["spans"][1:], strict=False):
        assert one[1] == following[0]


def test_a_second_car_has_a_lane(frames: Frames) -> None:
    record = Record(twice(frames, of_ids(frames, [0x520], frames.t_ns[-1] - 2 * S)))
    (span,) = next(lane["spans"] for lane in lanes(record, record.begin_ns) if lane["name"] == "second car")
    assert span[1] - span[0] == pytest.approx(2.0, abs=0.2)


def test_a_lane_of_two_senders_is_drawn_to_its_end(frames: Frames) -> None:
    ours = of_ids(frames, [0x510])
    record = Record(twice(frames, replace(ours, word=np.zeros_like(ours.word))))
    spans = next(lane["spans"] for lane in lanes(record, 0) if lane["name"] == "AI says")
    assert spans[-1][1] == pytest.approx(record.end_ns / S, abs=0.02)
    assert len(spans) < 500 and "more changes" in spans[-1][2]


def test_the_run_is_summed_up_with_its_response_time(html: str) -> None:
    run = html[html.index('<h2 id="run">') : html.index('<h2 id="figures">')]
    assert all(
        f"<dt>{name}</dt>" in run for name in ("top speed", "distance", "time in each state", "handshake response")
    )


def test_what_is_not_known_is_on_the_page(frames: Frames) -> None:
    assert "<b>unknown</b>: no 0x520 was received" in page(frames.only(frames.can_id != 0x520), "run.log")


def test_a_silence_of_the_car_is_a_hole_in_its_lanes() -> None:
    def away(run: Any) -> None:
        run.switch(lvms=False)
        run.go_on(1.0)
        run.switch(lvms=True)

    frames = branch(driving(), away, 1.0).frames
    lane = next(lane for lane in lanes(Record(frames), 0) if lane["name"] == "AS state")
    assert any(b[0] - a[1] > 0.9 for a, b in zip(lane["spans"], lane["spans"][1:], strict=False))


def test_a_hundred_seconds_stay_well_under_a_megabyte_and_a_half() -> None:
    """The whole bus of a car with its GPS: 100 s, every signal restless."""
    base = log_of(driving().frames)
    whole = base.only(base.t_ns >= int(base.t_ns[-1]) - 2 * S)
    restless = np.random.default_rng(1)
    parts = []
    for number in range(50):
        noise = restless.integers(0, 1 << 12, len(whole), dtype=np.uint64)
        loud = np.isin(whole.can_id, (0x511, 0x512, 0x513, 0x521, 0x522, 0x523, 0x524, 0x525))
        parts.append(
            replace(whole, t_ns=whole.t_ns + number * 2 * S, word=np.where(loud, whole.word ^ noise, whole.word))
        )
    assert len(page(joined(parts), "long.log").encode()) < 1_500_000


# ---------------------------------------------------------------- the verb


def test_the_verb_writes_the_page_and_says_where(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = tmp_path / "run.log", tmp_path / "run.html"
    log.write_bytes(b"\n".join(log_lines(frames)) + b"\n")
    assert main(["report", str(log), "-o", str(out)]) == 1  # the verdict's status: it ends in an emergency brake
    assert re.fullmatch(rf"saved {out} \(\d+ kB\); verdict: NOT OK: 1 problem.*\n", capsys.readouterr().out)
    assert out.read_text().startswith("<!doctype html>")


@pytest.mark.parametrize("ending", ["log", "log.gz"])
def test_the_page_has_the_logs_name_packed_or_not(ending: str, frames: Frames, tmp_path: Path) -> None:
    lines = b"\n".join(log_lines(frames)) + b"\n"
    (tmp_path / f"run.{ending}").write_bytes(gzip.compress(lines) if ending.endswith("gz") else lines)
    main(["report", str(tmp_path / f"run.{ending}")])
    assert (tmp_path / "run.html").is_file()


def test_any_signals_can_be_on_the_page_of_a_foreign_dbc_too(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out, dbc = tmp_path / "run.log", tmp_path / "run.html", tmp_path / "team.dbc"
    lines = [*log_lines(frames), b"(12.000000) vcan0 18FF0001#0A", b"(12.100000) vcan0 18FF0001#14"]
    log.write_bytes(b"\n".join(lines) + b"\n")
    dbc.write_text('VERSION ""\n\nBU_: AI\n\nBO_ 2566848513 Team: 1 AI\n SG_ TEMP : 0|8@1+ (0.5,0) [0|0] "C" AI\n')
    assert main(["report", str(log), "-o", str(out), "--signals", "AS_STATE,VCU2AI_Speeds.*"]) == 1
    first = data_of(out.read_text())["plots"][0]
    assert [curve["name"] for curve in first["curves"]] == ["VCU2AI_Status.AS_STATE"]
    assert "<figcaption>Signals, rpm" in out.read_text()
    assert main(["report", str(log), "-o", str(out), "--dbc", str(dbc), "--signals", "TEMP"]) == 1
    curve = data_of(out.read_text())["plots"][0]["curves"][0]
    assert (curve["name"], unpacked(curve, 0)[1].tolist()) == ("Team.TEMP", [5.0, 10.0])
    assert main(["report", str(log), "-o", str(out), "--signals", "NO_SUCH"]) == 1
    assert "no signal NO_SUCH" in capsys.readouterr().err


@pytest.mark.parametrize("where", ["absent/run.html", "."])
def test_a_page_that_cannot_be_written_is_one_clear_line(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    log = tmp_path / "run.log"
    log.write_bytes(b"\n".join(log_lines(frames.only(frames.t_ns > frames.t_ns[-1] - S // 2))) + b"\n")
    assert main(["report", str(log), "-o", str(tmp_path / where)]) == 1
    assert "cannot write" in capsys.readouterr().err
