"""What a person or a script gets from the command line: exit statuses, one clear line, one JSON object."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fsai_vcu.cli.guesses import MEANT
from fsai_vcu.cli.main import GROUPS, all_verbs, main

# People script against these.
DRIVE_KEYS = {
    "mission",
    "result",
    "reasons",
    "as_states",
    "laps",
    "lap_times_s",
    "cones_hit",
    "off_course",
    "max_lateral_error_m",
    "mean_speed_mps",
    "top_speed_mps",
    "faults",
    "gate_reasons",
    "sim_time_s",
    "wall_time_s",
    "seed",
}


def test_drive_json_ends_with_one_object_of_the_promised_keys(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["drive", "--mission", "static_inspection_b", "--seed", "3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result.keys() >= DRIVE_KEYS
    assert (result["mission"], result["result"], result["seed"]) == ("static_inspection_b", "pass", 3)
    assert [entry["state"] for entry in result["as_states"]][-1] == "EMERGENCY_BRAKE"


@pytest.mark.parametrize("unit", ["1e300", "-20000"])
def test_a_cone_that_is_too_far_away_to_be_in_metres_is_refused(
    unit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    track = tmp_path / "far.csv"
    track.write_text(f"tag,x,y\ncar_start,0,0\nblue,{unit},1\n")
    assert main(["drive", "--track", str(track)]) == 1
    assert "far.csv: line 3:" in capsys.readouterr().err


def test_help_shows_the_groups_that_a_person_thinks_in(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help"]) == 0
    usual = capsys.readouterr().out
    assert main(["--help"]) == 0 and capsys.readouterr().out == usual
    assert main(["help", "--all"]) == 0
    everything = capsys.readouterr().out
    assert {group for _, _, group in all_verbs().values()} == set(GROUPS)
    for verb, (_, summary, group) in all_verbs().items():
        assert any(line.split() == [verb, *summary.split()] for line in everything.splitlines())
        assert (f"  {verb} " in usual) is (group != GROUPS[-1])


def test_help_of_a_verb_is_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    said = []
    for words in (["help", "explain"], ["explain", "--help"]):
        with pytest.raises(SystemExit) as ended:
            main(words)
        said.append((ended.value.code, capsys.readouterr().out))
    assert said[0] == said[1] and said[0][0] == 0
    assert main(["help", "explian"]) == 2
    assert "did you mean explain" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("task", "guesses", "verb"),
    [
        ("see what is on the bus", "candump watch", "dump"),
        ("see why the car does not start", "why state", "status"),
        ("learn why it stopped last night", "why analyse", "explain"),
        ("play last night's log to the team", "play view", "pitwall"),
        ("put a log on vcan0 again", "canplayer play", "replay"),
        ("rehearse scrutineering with our CAN node", "test node", "rehearse"),
        ("send one frame on the bench", "cansend transmit", "send"),
        ("learn which missions there are, and drive one", "missions sim", "drive"),
        ("drive with a fault", "fault inject", "drive"),
        ("have a car on vcan0 for our node", "simulator car", "vcu"),
        ("brake now", "estop stop", "emergency-brake"),
        ("go to manual", "manual stop", "mode"),
        ("have a table for a spreadsheet", "csv convert", "export"),
        ("record the bus", "log capture", "record"),
        ("see the steering over time", "graph curves", "plot"),
        ("see what last night did differently", "diff", "compare"),
        ("know whether this computer is ready", "diagnose setup", "doctor"),
        ("know the signals of a message", "signals message", "dbc"),
        ("see what our ROS stack does wrong", "ros stack", "check-stack"),
        ("show it on the television", "web live", "pitwall"),
        ("a name that is mistyped", "monitr mnoitor", "monitor"),
    ],
)
def test_a_task_is_found_by_each_word_that_is_tried_for_it(
    task: str, guesses: str, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for guess in guesses.split():
        assert main([guess]) == 2
        said = capsys.readouterr().err
        assert verb in said.partition("did you mean ")[2].rstrip("?\n").split(" or "), (task, said)


@pytest.mark.parametrize("word", ["stop", "sotp", "stopp", "estop", "e-stop", "brake", "braek", "halt", "panic"])
def test_who_wants_to_brake_is_not_sent_elsewhere_first(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([word]) == 2
    assert "did you mean emergency-brake" in capsys.readouterr().err


def test_every_verb_that_is_guessed_at_exists() -> None:
    assert MEANT.keys() <= all_verbs().keys()


INTERRUPTED = """
import os, signal, sys
from fsai_vcu.cli import completion, main

def run(args):
    try:
        exec("os.kill(os.getpid(), signal.SIGINT)\\nwhile True: pass")
    except KeyboardInterrupt:
        if sys.argv[1] == "0":  # the normal end of what goes on until Ctrl-C
            return 0
        raise

completion.run = run
sys.exit(main.main(["completion", "bash"]))
"""


@pytest.mark.parametrize("status", [0, 130])
def test_ctrl_c_while_a_class_is_made_is_answered_as_ever(status: int, tmp_path: Path) -> None:
    """In an exec, that is: Python would kill itself by SIGINT at its end, whatever was answered."""
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    argv = [sys.executable, "-m", "interrupted", str(status)]
    done = subprocess.run(argv, cwd=tmp_path, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (status, "fsai-vcu completion: interrupted\n" * (status != 0))
