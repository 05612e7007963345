"""Names that others give are text: on a terminal, in a table, in a picture, whatever is in them."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.printable import PrintableStream, cell, drawn, printable

NASTY = "\x1b]0;PWN\x07 \x9b31m \r\x00 ‮ \x7f"
DBC = ["--dbc", "nasty.dbc"]
UNSEEN = [chr(code) for code in (*range(0x20), *range(0x7F, 0xA0), 0x200B, 0x202E, 0x2066, 0xFEFF)]
LOG = "".join(f"({1000 + n / 100:.6f}) \x1b]0;PWN\x07X 511#{n % 3:02X}000000{n % 3:02X}000000\n" for n in range(30))


def database(unit: str, word: str, long_name: str) -> str:
    return (
        'VERSION ""\nNS_ :\nBS_:\nBU_: AI VCU\nBO_ 1297 M1: 8 VCU\n'
        f' SG_ S1 : 0|16@1+ (1,0) [0|0] "{unit}" AI\n SG_ S2 : 32|8@1+ (1,0) [0|0] "" AI\n\n'
        'BA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;\nBA_DEF_ BO_ "SystemMessageLongSymbol" STRING ;\n'
        'BA_DEF_DEF_ "SystemSignalLongSymbol" "";\nBA_DEF_DEF_ "SystemMessageLongSymbol" "";\n'
        f'BA_ "SystemSignalLongSymbol" SG_ 1297 S2 "{long_name}";\n'
        f'BA_ "SystemMessageLongSymbol" BO_ 1297 "{long_name}";\n'
        f'VAL_ 1297 S2 0 "{word}" 1 "{word}1" ;\n'
    )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    nasty = NASTY.replace("\0", "")
    (tmp_path / "bus.log").write_text(LOG)
    (tmp_path / "plain.log").write_text(LOG.replace("\x1b]0;PWN\x07X", "can0"))
    (tmp_path / "nasty.dbc").write_text(database(nasty, nasty, nasty), encoding="cp1252", errors="replace", newline="")
    (tmp_path / "sheet.dbc").write_text(database("=1+1", "=HYPERLINK(1)", "@SUM(1)"))
    (tmp_path / "dollar.dbc").write_text(database("$\\\\frac$", "$x", "a$b$"))
    return tmp_path


def test_what_cannot_be_seen_is_written_out() -> None:
    assert printable("steering, °") == "steering, °"
    assert printable("\x1b[2J\n") == "\\x1b[2J\\n"
    assert all(printable(char).isprintable() for char in UNSEEN)


@pytest.mark.parametrize("terminal", [False, True])
def test_a_stream_shows_lines_and_its_own_colours_alone(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    PrintableStream(stream).write(f"\r\x1b[K\x1b[31mred\x1b[0m\n\t{NASTY}\x1b[2J\n")
    own = "\r\x1b[K\x1b[31mred\x1b[0m" if terminal else "\\r\\x1b[K\\x1b[31mred\\x1b[0m"
    assert stream.getvalue() == f"{own}\n\t{printable(NASTY)}\\x1b[2J\n"


@pytest.mark.parametrize(
    "words",
    [
        *([verb, "bus.log", *more] for verb in ("dump", "decode", "check", "explain") for more in ([], DBC)),
        ["check", "bus.log", "--figures", *DBC],
        ["compare", "bus.log", "plain.log", *DBC],
        ["plot", "bus.log", "-o", "p.svg", "S1", *DBC],
        ["dbc", "list", "nasty.dbc"],
        ["dbc", "show", "nasty.dbc", "511"],
        ["export", "bus.log", "--format", "csv", "-o", "out", *DBC],
        ["report", "bus.log", "-o", "r.html", *DBC],
        ["send", "--dry-run", "--dbc", "nasty.dbc", "M1"],
        ["check", NASTY],
        ["track", f"{NASTY}.yaml"],
        ["config", "check", NASTY],
        [NASTY],
        ["check", "--" + NASTY],
    ],
    ids=lambda words: " ".join(words).encode("unicode_escape").decode()[:40],
)
def test_no_verb_sends_a_name_to_the_terminal(
    words: list[str], folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    if words[0] == "plot":
        pytest.importorskip("matplotlib", reason="matplotlib is not installed (pip install 'fsai-vcu[plot]')")
    try:
        main([word.replace("\0", "") for word in words])
    except SystemExit as end:
        assert end.code == 2
    said = "".join(capfd.readouterr())
    assert said
    shown = {char for char in said if not char.isprintable()} - {"\n", "\t"}
    assert not shown, [line for line in said.splitlines() if not line.isprintable()][:3]


def test_no_cell_of_a_table_begins_a_formula(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "bus.log", "--format", "csv", "-o", "out", "--words", "--dbc", "sheet.dbc"]) == 0
    assert main(["export", "bus.log", "--format", "csv", "-o", "wide.csv", "--wide", "--dbc", "sheet.dbc"]) == 0
    cells = set()
    for path in (*(folder / "out").iterdir(), folder / "wide.csv"):
        with path.open(newline="") as file:
            cells |= {each for row in csv.reader(file) for each in row}
    assert "'=HYPERLINK(1)" in cells and any(each.startswith("'@SUM(1)") for each in cells)
    assert not [each for each in cells if each.startswith(tuple("=+@\t\r-")) and not each.lstrip("-").isdecimal()]
    for text in ("=1", "+1", "-1", "@1", "\t=1", "\r=1", "＝1"):
        assert not cell(text).startswith(tuple("=+-@\t\r＝"))


@pytest.mark.parametrize("form", ["png", "svg"])
def test_dollars_in_a_picture_are_dollars(form: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (pip install 'fsai-vcu[plot]')")
    assert main(["plot", "plain.log", "--dbc", "dollar.dbc", "-o", f"p.{form}", "S1", "a$b$"]) == 0, capsys.readouterr()
    assert drawn("$1$") == r"\$1\$"
