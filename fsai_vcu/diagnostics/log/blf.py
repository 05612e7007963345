"""BLF through python-can, which unpacks and keeps as much as a file says: here with bounds on both."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from types import SimpleNamespace
from typing import IO, Any, Final

import can.io.blf as blf

_CONTAINER_BYTES: Final = 16 << 20  # python-can and Vector's tools pack 128 KiB
_OBJECT_BYTES: Final = 256 << 10  # a frame takes less than 200 bytes, a comment some KiB


class _Container:
    """zlib's decompressobj; what unpacks to more than a container has is an error."""

    def __init__(self, *arguments: Any) -> None:
        self._unpacking = zlib.decompressobj(*arguments)

    def decompress(self, data: bytes) -> bytes:
        unpacked = self._unpacking.decompress(data, _CONTAINER_BYTES)
        if self._unpacking.unconsumed_tail:
            raise zlib.error(f"a container unpacks to more than {_CONTAINER_BYTES >> 20} MiB")
        return unpacked


class BoundedBlfReader(blf.BLFReader):
    """Raises zlib.error and BLFParseError where a container or an object in it is larger than any that is written."""

    def __init__(self, stream: IO[bytes]) -> None:
        bounded = {
            "decompressobj": _Container,
            "decompress": lambda data, *arguments: _Container(*arguments[:1]).decompress(data),
        }
        blf.zlib = SimpleNamespace(**(vars(zlib) | bounded))  # type: ignore[attr-defined, assignment]
        super().__init__(stream)  # type: ignore[arg-type]

    def _parse_container(self, data: bytes) -> Iterator[Any]:
        if len(self._tail) > _OBJECT_BYTES:  # kept until the rest of it comes
            raise blf.BLFParseError(f"an object of more than {_OBJECT_BYTES >> 10} KiB")
        yield from super()._parse_container(data)
