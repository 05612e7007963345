"""What lies where others may write is opened only if it is what it is meant to be."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from fsai_vcu.files import (
    is_file,
    is_folder,
    is_there,
    open_found,
    open_lock,
    open_named,
    open_new,
    read_found,
    read_named,
    write_whole,
)

WORDS = b"of somebody else\n"


def _link(place: Path, victim: Path) -> None:
    place.symlink_to(victim)


def _hard_link(place: Path, victim: Path) -> None:
    place.hardlink_to(victim)


def _pipe(place: Path, victim: Path) -> None:
    os.mkfifo(place)


def _socket(place: Path, victim: Path) -> None:
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(place))


def _device(place: Path, victim: Path) -> None:
    place.symlink_to("/dev/zero")


TRAPS: dict[str, Callable[[Path, Path], None]] = {
    "a link": _link,
    "a hard link": _hard_link,
    "a pipe": _pipe,
    "a socket": _socket,
    "a link to a device": _device,
}


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    path = tmp_path / "victim"
    path.write_bytes(WORDS)
    return path


@pytest.mark.parametrize("trap", TRAPS)
def test_only_a_regular_file_of_one_name_is_opened_where_found(trap: str, tmp_path: Path, victim: Path) -> None:
    place = tmp_path / "found"
    TRAPS[trap](place, victim)
    for write in (False, True):
        with pytest.raises(OSError, match=r"it is a (link|pipe|socket)|a hard link"):
            open_found(place, write=write)
    with pytest.raises(OSError, match=r"it is|it has"):
        read_found(place, 100)
    with pytest.raises(FileExistsError):
        open_new(place)
    assert victim.read_bytes() == WORDS


def test_what_becomes_a_link_while_it_is_opened_is_refused(
    tmp_path: Path, victim: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "found").symlink_to(victim)
    regular = victim.lstat()
    monkeypatch.setattr(Path, "lstat", lambda _: regular)
    with pytest.raises(OSError, match="it is a link, not a file"):
        open_found(tmp_path / "found", write=True)


@pytest.mark.parametrize("trap", TRAPS)
def test_a_lock_takes_the_place_of_what_cannot_be_one(trap: str, tmp_path: Path, victim: Path) -> None:
    place = tmp_path / ".lock"
    TRAPS[trap](place, victim)
    open_lock(place).close()
    assert place.lstat().st_nlink == 1 and place.is_file() and not place.is_symlink()
    assert victim.read_bytes() == WORDS
    place.write_text("kept")
    open_lock(place).close()
    assert place.read_text() == "kept"


def test_a_folder_in_the_place_of_a_lock_is_moved_aside(tmp_path: Path) -> None:
    (tmp_path / ".lock").mkdir()
    (tmp_path / ".lock" / "kept").touch()
    open_lock(tmp_path / ".lock").close()
    assert (tmp_path / ".lock").is_file() and [path.name for path in tmp_path.glob(".lock.*/*")] == ["kept"]


def test_a_new_file_is_not_made_behind_a_link_to_nowhere(tmp_path: Path) -> None:
    (tmp_path / "new").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileExistsError):
        open_new(tmp_path / "new")
    assert not (tmp_path / "elsewhere").exists()


def test_what_a_person_names_may_be_a_link_and_no_device(tmp_path: Path, victim: Path) -> None:
    _link(tmp_path / "named", victim)
    assert read_named(tmp_path / "named", 100) == WORDS.decode()
    for path in ("/dev/zero", "/dev/null"):
        with pytest.raises(OSError, match="it is a device, not a file"):
            open_named(path, pipes=True)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="it is a pipe, not a file"):
        open_named(tmp_path / "pipe")


def test_no_more_is_read_than_was_allowed(tmp_path: Path) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    for read in (read_named, read_found):
        with pytest.raises(OSError, match="it is larger than 2 MiB"):
            read(path, 2 << 20)
    os.truncate(path, 64)
    assert read_found(path, 64) == bytes(64)


def test_a_file_is_replaced_whole_and_stays_as_private(victim: Path) -> None:
    victim.chmod(0o600)
    with victim.open("rb") as before:
        write_whole(victim, b"new")
        assert before.read() == WORDS, "who reads the old one reads it to its end"
    assert victim.read_bytes() == b"new" and victim.stat().st_mode & 0o777 == 0o600
    assert list(victim.parent.iterdir()) == [victim]


def test_a_file_that_cannot_be_replaced_stays(victim: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_whole(victim, b"new")
    assert caught.value.filename == str(victim)
    assert victim.read_bytes() == WORDS and list(victim.parent.iterdir()) == [victim]


@pytest.mark.parametrize("name", ["ü" * 127, "absent/x", "victim/x", "ü" * 128])
def test_a_place_that_cannot_be_is_named_in_the_error(name: str, victim: Path) -> None:
    place = victim.parent / name
    if name == "ü" * 127:  # the longest that there is
        write_whole(place, b"new")
        assert place.read_bytes() == b"new"
        return
    with pytest.raises(OSError) as caught:
        write_whole(place, b"new")
    assert caught.value.filename == str(place)
    assert list(victim.parent.iterdir()) == [victim]


def test_a_link_and_a_device_are_not_replaced(tmp_path: Path, victim: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(victim)
    write_whole(link, b"new")
    assert link.is_symlink() and victim.read_bytes() == b"new"
    null = tmp_path / "null"
    null.symlink_to(os.devnull)
    write_whole(null, b"new")
    assert Path(os.devnull).is_char_device()
    with pytest.raises(OSError, match="No space left"):
        write_whole("/dev/full", b"new")


@pytest.mark.parametrize(("error", "there"), [(PermissionError(), True), (OSError(36, "File name too long"), False)])
def test_what_cannot_be_looked_at_is_no_error_yet(
    error: OSError, there: bool, victim: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> os.stat_result:
        raise error

    assert (is_there(victim), is_file(victim), is_folder(victim.parent)) == (True, True, True)
    with monkeypatch.context() as patch:
        for name in ("exists", "is_file", "is_dir"):
            patch.setattr(Path, name, refused)
        assert (is_there(victim), is_file(victim), is_folder(victim.parent)) == (there, False, False)
