"""A database that a tool or a person wrote is read: what belongs to nothing in it costs itself and a note."""

from __future__ import annotations

from pathlib import Path

import pytest

from fsai_vcu.diagnostics.decode.databases import Databases, load_databases
from fsai_vcu.interface.database import DatabaseError, load_database
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.revisions import dbc_dir

HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: Box\n\n'
INDEPENDENT = (
    'BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n SG_ Lost : 0|8@1+ (1,0) [0|0] "" Vector__XXX\n\n'
)
MESSAGE = 'BO_ 1280 Temp: 8 Box\n SG_ A : 0|8@1+ (0.5,0) [0|0] "°C" Box\n\n'
ATTRIBUTES = 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 3600000;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'


def loaded(path: Path, text: str, encoding: str = "utf-8") -> Databases:
    path.write_bytes(text.encode(encoding))
    return load_databases([path])


ORPHANS = [
    (INDEPENDENT, 'VAL_ 3221225472 Lost 0 "OFF" 1 "O;N" ;\n', "value tables of unknown signals left out: Lost"),
    ("", 'VAL_ 1280 Gone 0 "OFF" 1 "ON" ;\n', "value tables of unknown signals left out: Gone"),
    ("", 'VAL_ 1999 Gone 0 "OFF" ;\nVAL_ 1280 Gone\n 0 "OFF" ;\n', "left out: Gone, Gone"),
    ("", "SIG_VALTYPE_ 1280 Gone : 1;\n", "types of unknown signals left out: Gone"),
    (ATTRIBUTES, 'BA_ "NotDefined" BO_ 1280 10;\n', "values of unknown attributes left out: NotDefined"),
    (
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN";\nBA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n',
        'BA_ "VFrameFormat" BO_ 1280 99;\n',
        "values of unknown words of attributes left out: VFrameFormat",
    ),
    ("", 'BA_REL_ "Q" BU_SG_REL_ Box SG_ 1280 A 5;\n', "left out: Q"),
    ("BO_ 4000 Big: 8 Box\n\n", 'VAL_ 4000 B 1 "x" ;\n', "identifiers of more than 11 bits left out: Big"),
]
LARGE = f'CM_ "{"x" * 200_000}";\n'  # such a database is read in a process of its own


@pytest.mark.parametrize(
    ("before", "behind", "words"), [*ORPHANS, (ORPHANS[0][0], LARGE + ORPHANS[0][1], ORPHANS[0][2])]
)
def test_an_entry_that_belongs_to_nothing_costs_itself(before: str, behind: str, words: str, tmp_path: Path) -> None:
    databases = loaded(tmp_path / "team.dbc", HEAD + before + MESSAGE + behind + 'VAL_ 1280 A 1 "one" ;\n')
    assert len(databases.left_out) == 1 and words in databases.left_out[0]
    (layout,) = databases.layouts.values()
    assert (layout.name, layout.signals[0].unit, dict(layout.signals[0].choices)) == ("Temp", "°C", {1: "one"})


@pytest.mark.parametrize(
    ("behind", "words"),
    [
        ('BO_ 1280 Again: 8 Box\n SG_ B : 0|8@1+ (1,0) [0|0] "" Box\n', "has a message already: Again"),
        ('BO_ 1281 Two: 8 Box\n SG_ B : 0|8@1+ (1,0) [0|0] "" Box\n SG_ B : 8|8@1+ (1,0) [0|0] "" Box\n', "Two.B"),
        ('BO_ 1281 Long: 2 Box\n SG_ B : 12|8@1+ (1,0) [0|0] "" Box\n', "beyond their bytes: Long (B)"),
        ('BO_ 1281 Long: 2 Box\n SG_ B : 8|9@0+ (1,0) [0|0] "" Box\n', "beyond their bytes: Long (B)"),
        ('BO_ 1281 Full: 2 Box\n SG_ B : 7|16@0+ (1,0) [0|0] "" Box\n', ""),
    ],
    ids=["identifier twice", "name twice", "too long", "too long, big-endian", "as long as its message"],
)
def test_what_a_database_hides_is_said(behind: str, words: str, tmp_path: Path) -> None:
    said = loaded(tmp_path / "team.dbc", HEAD + MESSAGE + behind).left_out
    assert len(said) == bool(words) and words in "".join(said)


def test_what_is_wrong_beside_an_orphan_is_still_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="not a database that cantools can read"):
        loaded(tmp_path / "team.dbc", HEAD + MESSAGE + 'VAL_ 1280 Gone 1 "x" ;\nwhat is this;\n')


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize("name", ["team.dbc", "team.DBC", "team.dbc.txt"])
def test_the_encoding_of_a_database_is_told_by_its_bytes(encoding: str, name: str, tmp_path: Path) -> None:
    text = HEAD + MESSAGE + 'VAL_ 1280 A 0 "kühl" 1 "heiß" ;\n'
    (layout,) = loaded(tmp_path / name, text, encoding).layouts.values()
    assert (layout.signals[0].unit, dict(layout.signals[0].choices)) == ("°C", {0: "kühl", 1: "heiß"})


@pytest.mark.parametrize("end", ["Box", "Box\n", "Vector__XXX", "Box\n\x1a"])
def test_a_complete_database_is_never_called_cut_off(end: str, tmp_path: Path) -> None:
    text = HEAD + MESSAGE + f'BO_ 1281 Next: 8 Box\n SG_ B : 0|8@1+ (1,0) [0|0] "" {end}'
    assert len(loaded(tmp_path / "team.dbc", text).layouts) == 2


@pytest.mark.parametrize("cut", [1, 2, 9, 15, 25])
def test_a_database_cut_in_a_statement_is_refused(cut: int, tmp_path: Path) -> None:
    text = HEAD + MESSAGE + 'BO_ 1281 Next: 8 Box\n SG_ B : 0|8@1+ (1,0) [0|0] "" Box'
    with pytest.raises(UserError):
        loaded(tmp_path / "team.dbc", text[:-cut])


def test_a_packed_database_is_named_so(tmp_path: Path) -> None:
    (tmp_path / "team.dbc.gz").write_bytes(b"\x1f\x8b\x08\x00 what")
    with pytest.raises(UserError, match="packed: unpack it first"):
        load_databases([tmp_path / "team.dbc.gz"])


OURS = (dbc_dir() / "ads_dv_2026.dbc").read_text(encoding="utf-8")
OVERLAPPING = 'BO_ {} Team: 8 AI\n SG_ X : 0|16@1+ (1,0) [0|0] "" AI\n SG_ Y : 8|16@1+ (1,0) [0|0] "" AI\n\n'


def test_the_bridge_is_strict_with_its_own_messages_alone(tmp_path: Path) -> None:
    path = tmp_path / "official.dbc"
    orphans = "".join(f'VAL_ 3221225472 Old{n} 0 "OFF" 1 "ON" ;\n' for n in range(46))
    begin, _, rest = OURS.partition("\nBO_ ")
    path.write_text(f"{begin}\n{OVERLAPPING.format(1999)}BO_ {rest}{orphans}")
    names = {message.name for message in load_database([path]).messages}
    assert {"Team", "VCU2AI_Status", "AI2VCU_Status"} <= names
    at = rest.index(" SG_ ")
    twice = rest[at : rest.index("\n", at) + 1].replace(" SG_ ", " SG_ TWICE_", 1)
    path.write_text(f"{begin}\nBO_ {rest[:at]}{twice}{rest[at:]}")
    with pytest.raises(DatabaseError, match="overlapping"):
        load_database([path])
