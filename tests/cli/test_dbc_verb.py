"""`fsai-vcu dbc`: messages, signals, differences."""

from __future__ import annotations

import json

import pytest

from fsai_vcu.cli.main import main


@pytest.mark.parametrize("name", ["0x513", "513", "AI2VCU_Steer", "ai2vcu_st?er"])
def test_a_message_is_shown_by_number_name_or_pattern(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "show", name]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "0x513 AI2VCU_Steer: 2 bytes, every 10 ms, from AI",
        "    Steering request. Believed in AS_DRIVING only.",
        "    STEER_REQUEST: bit 0, 16 bits signed, x 0.1 deg, -30 to 30, little-endian",
        "        Bicycle-model road angle, positive to the left (ISO 8855)."
        " ANGLE_MAX in 0x523 may be lower than the range.",
    ]


@pytest.mark.parametrize("argv", ["513", "show steer_request", "STEER_REQUEST"])
def test_show_may_be_left_out_and_a_signal_finds_its_message(argv: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", *argv.split()]) == 0
    assert capsys.readouterr().out.startswith("0x513 AI2VCU_Steer: ")


@pytest.mark.parametrize("word", ["steer", "steering", "Steer"])
def test_a_word_finds_the_messages_that_have_it_in_their_names(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "show", word]) == 0
    heads = [line.split()[1] for line in capsys.readouterr().out.splitlines() if line.startswith("0x")]
    assert heads == ["AI2VCU_Steer:", "VCU2AI_Steer:"]


def test_the_mark_of_a_fault_bit_is_no_unit(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "show", "0x520"]) == 0
    said = capsys.readouterr().out
    assert "EBS_FAULT: bit 43, 1 bit unsigned: " in said and "__F__" not in said


def test_two_revisions_differ_message_by_message(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "diff", "2021", "2026"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert "- 0x120 VCU_STATUS: 8 bytes, every 10 ms, from VCU" in lines
    assert any(line.startswith("+ 0x520 VCU2AI_Status: TS_STATE: bit 28, 4 bits unsigned: 0 TS_INIT") for line in lines)


def test_a_database_does_not_differ_from_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "diff", "2026", "2026"]) == 0
    assert capsys.readouterr().out == "no difference\n"


def test_what_is_shown_is_json_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "show", "0x513", "--json"]) == 0
    message = json.loads(capsys.readouterr().out)
    assert (message["id"], message["message"], message["period_ms"], message["from"]) == (
        0x513,
        "AI2VCU_Steer",
        10,
        ["AI"],
    )
    assert message["signals"][0] | {"scale": 0.1, "unit": "deg"} == message["signals"][0]
    assert main(["dbc", "diff", "2021", "2026", "--json"]) == 1
    differences = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {"only_in": "2021", "words": "0x120 VCU_STATUS: 8 bytes, every 10 ms, from VCU"} in differences
    assert main(["dbc", "diff", "2026", "2026", "--json"]) == 0 and capsys.readouterr().out == ""
