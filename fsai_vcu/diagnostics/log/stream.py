"""A log's bytes as they were before somebody packed them or saved them as text of Windows."""

from __future__ import annotations

import bz2
import codecs
import io
import lzma
import re
import zipfile
import zlib
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import IO, Any, Final, Protocol

from fsai_vcu.files import MIB, TOO_MUCH_PACKED, UNPACKED_BYTES, UNPACKED_TIMES

HEAD_BYTES: Final = 4096
"""Number of first bytes that tell a format."""
_BLOCK_BYTES: Final = 1 << 18
_PACKED_BLOCK_BYTES: Final = 1 << 14
_LZMA_BYTES: Final = 128 * MIB  # `xz -9` takes 65


class _Unpacker(Protocol):
    """Unpacker with the methods of the decompressors of bz2 and lzma."""

    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


class _Gzip:
    """zlib's, which keeps what it has not unpacked yet beside it, for gzip."""

    def __init__(self) -> None:
        self._zlib = zlib.decompressobj(31)

    @property
    def eof(self) -> bool:
        return self._zlib.eof

    @property
    def unused_data(self) -> bytes:
        return self._zlib.unused_data

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        return self._zlib.decompress(self._zlib.unconsumed_tail + data, max_length)


def _zstandard() -> _Unpacker:
    for name in ("compression.zstd", "backports.zstd"):
        if find_spec(name.partition(".")[0]) and find_spec(name):
            unpacker: _Unpacker = import_module(name).ZstdDecompressor()
            return unpacker
    raise OSError("packed with zstd: unpack it first (zstd -d), or pip install backports.zstd")


_PACKED: Final[tuple[tuple[bytes, Callable[[], _Unpacker]], ...]] = (
    (b"\x1f\x8b", _Gzip),
    (b"\xfd7zXZ\0", lambda: lzma.LZMADecompressor(memlimit=_LZMA_BYTES)),
    (b"BZh", bz2.BZ2Decompressor),
    (b"\x28\xb5\x2f\xfd", _zstandard),
)
_ZIP: Final = b"PK\x03\x04"
_MACS: Final = re.compile(r"^__MACOSX/|(^|/)(\._[^/]*|\.DS_Store)$")  # what a Mac puts into an archive beside the files


class _Bounded(io.RawIOBase):
    """A stream of unpacked bytes, no more of them than a packed log can be."""

    _in = _out = 0  # bytes packed and unpacked

    def readable(self) -> bool:
        return True

    def _handed_over(self, data: bytes, buffer: Any) -> int:
        self._out += len(data)
        if self._out > UNPACKED_BYTES and self._out > UNPACKED_TIMES * self._in:
            raise OSError(TOO_MUCH_PACKED)
        buffer[: len(data)] = data
        return len(data)


class _Unpacked(_Bounded):
    """Content of a packed file; OSError where that is more than a packed log can be, or where it is cut off."""

    def __init__(self, packed: IO[bytes], magic: bytes, new: Callable[[], _Unpacker]) -> None:
        self._packed, self._magic, self._new = packed, magic, new
        self._unpacker = new()
        self._waiting = False  # for more input

    def readinto(self, buffer: Any) -> int:
        most = len(buffer)
        while True:
            try:
                data = self._more(most)
            except (zlib.error, lzma.LZMAError, EOFError, ValueError, MemoryError) as error:
                raise OSError(f"it cannot be unpacked: {error}") from None
            if data is None:
                return 0
            if data:
                break
        return self._handed_over(data, buffer)

    def _more(self, most: int) -> bytes | None:
        """Return some more; nothing where there may be more behind; None at the end."""
        if self._unpacker.eof:
            behind = (self._unpacker.unused_data or self._read()).lstrip(b"\0")
            if not behind:
                return None if not (more := self._read()) else self._next(more, most)
            return self._next(behind, most)
        given = self._read() if self._waiting or not self._in else b""
        if self._waiting and not given:
            raise EOFError("it is cut off")
        data = self._unpacker.decompress(given, most)
        self._waiting = len(data) < most and not self._unpacker.eof
        return data

    def _next(self, behind: bytes, most: int) -> bytes | None:
        """Go on with the packed file behind: together they are as one."""
        behind = behind.lstrip(b"\0")
        if not behind:
            return b""
        while len(behind) < len(self._magic) and (more := self._read()):
            behind += more
        if not behind.startswith(self._magic):
            raise ValueError("extra data follow the packed part")
        self._unpacker = self._new()
        data = self._unpacker.decompress(behind, most)
        self._waiting = len(data) < most and not self._unpacker.eof
        return data

    def _read(self) -> bytes:
        data = self._packed.read1(_PACKED_BLOCK_BYTES)  # type: ignore[attr-defined]
        self._in += len(data)
        return bytes(data)

    def close(self) -> None:
        self._packed.close()
        super().close()


class _Member(_Bounded):
    """The one file in a zip archive."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file: IO[bytes] | None = None  # until it is known to be one: what is none is read in another way
        try:
            archive = zipfile.ZipFile(file)
            members = [
                member for member in archive.infolist() if not (member.is_dir() or _MACS.search(member.filename))
            ]
            if len(members) != 1:
                raise OSError(f"a zip archive of {len(members)} files: unpack it first")
            self._in = max(members[0].compress_size, 1)
            self._member = archive.open(members[0])
        except zipfile.BadZipFile:  # what a file is whose end, the list of its members, is missing
            raise OSError("a zip archive that is cut off, or broken") from None
        except (RuntimeError, NotImplementedError, ValueError) as error:
            raise OSError(f"a zip archive that cannot be unpacked: {error}") from None
        self._file = file

    def readinto(self, buffer: Any) -> int:
        try:
            data = self._member.read(len(buffer))
        except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, ValueError) as error:
            raise OSError(f"it cannot be unpacked: {error or 'it is cut off'}") from None
        return self._handed_over(data, buffer)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
        super().close()


class _Utf8(io.RawIOBase):
    """Text in UTF-16, or with the line ends of an old Mac, as lines of UTF-8."""

    def __init__(self, text: IO[bytes], encoding: str, *, mac: bool) -> None:
        self._text, self._mac = text, mac
        self._decoder = codecs.getincrementaldecoder(encoding)("replace")
        self._left = b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        while not self._left:
            read = self._text.read1(_PACKED_BLOCK_BYTES)  # type: ignore[attr-defined]
            text = self._decoder.decode(read, final=not read)
            self._left = (text.replace("\r", "\n") if self._mac else text).encode("utf-8", "replace")
            if not read:
                break
        data, self._left = self._left[: len(buffer)], self._left[len(buffer) :]
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._text.close()
        super().close()


def head_of(stream: IO[bytes]) -> bytes:
    """The first bytes, without taking them from the stream."""
    try:
        return bytes(stream.peek(HEAD_BYTES)[:HEAD_BYTES])  # type: ignore[attr-defined]
    except OSError:
        return b""  # what is wrong is reported when the frames are asked for


def unpacked(stream: IO[bytes]) -> IO[bytes]:
    """The stream, or what is packed in it. Raises OSError."""
    head = head_of(stream)
    for magic, new in _PACKED:
        if head.startswith(magic):
            return io.BufferedReader(_Unpacked(stream, magic, new), _BLOCK_BYTES)
    if head.startswith(_ZIP):
        return io.BufferedReader(_Member(stream), _BLOCK_BYTES)
    return stream


def as_utf8(stream: IO[bytes]) -> IO[bytes]:
    """A text without marks, in UTF-8 where it was UTF-16; anything else as it is."""
    head = head_of(stream)
    if head.startswith(codecs.BOM_UTF8):
        stream.read(len(codecs.BOM_UTF8))
        head = head_of(stream)
    encoding = ""
    for mark, name, at in ((codecs.BOM_UTF16_LE, "utf-16-le", 0), (codecs.BOM_UTF16_BE, "utf-16-be", 1)):
        marked = head.startswith(mark)
        few = head[2:4] if marked else head[:20]  # characters of ASCII, as a text begins
        if len(few) == (2 if marked else 20) and all(few[at::2]) and not any(few[1 - at :: 2]):
            encoding = name
            stream.read(len(mark) if marked else 0)
            break
    mac = not encoding and b"\n" not in head and b"\0" not in head and b"\r" in head[:-1]
    if encoding or mac:
        return io.BufferedReader(_Utf8(stream, encoding or "latin-1", mac=mac), _BLOCK_BYTES)
    return stream
