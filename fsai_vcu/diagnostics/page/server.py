"""The page over HTTP, to be read only: GET of its three files, and of a stream of events for each viewer.

A viewer that has taken all that was sent gets the newest of each event since then.
"""

from __future__ import annotations

import asyncio
import json
import time
from http import HTTPStatus
from typing import Any, Final

from aiohttp import web

from fsai_vcu.diagnostics import serving
from fsai_vcu.diagnostics.page.document import part
from fsai_vcu.diagnostics.serving import Connection, begun, error_page

_PARTS: Final = {"/page.css": "text/css", "/page.js": "text/javascript"}


class Server(serving.Server):
    """Server of the page. `viewers`: how many streams there are. `html`: the page; it shows what is published unless a
    log is put here.
    """

    def __init__(self, host: str, port: int) -> None:
        """Listen on host and port. Raises OSError."""
        super().__init__(host, port)
        self.html = part("page.html")
        self._news = asyncio.Event()
        self._published: dict[str, tuple[int, bytes]] = {}
        self._number = self.viewers = 0
        self._over = False

    def __enter__(self) -> Server:
        super().__enter__()
        return self

    def publish(self, event: str, data: dict[str, Any]) -> None:
        """Publish to every viewer, in place of the event of that name before. Raises UserError where nobody listens."""
        self.check()
        text = json.dumps({"sent_s": round(time.monotonic(), 3), **data}, separators=(",", ":"))
        self.loop.call_soon_threadsafe(self._put, event, f"event: {event}\ndata: {text}\n\n".encode())

    def _put(self, event: str, block: bytes) -> None:
        self._number += 1
        self._published[event] = self._number, block
        self._news.set()
        self._news = asyncio.Event()

    def end(self) -> None:
        self._over = True
        self._news.set()

    async def answer(self, request: web.BaseRequest, connection: Connection) -> web.StreamResponse:
        if request.path == "/events":
            return await self._stream(request, connection)
        if request.path == "/":
            return begun(web.Response(body=self.html.encode()), "text/html")
        if request.path not in _PARTS:
            return error_page(HTTPStatus.NOT_FOUND)
        return begun(web.Response(body=part(request.path[1:]).encode()), _PARTS[request.path])

    async def _stream(self, request: web.BaseRequest, connection: Connection) -> web.StreamResponse:
        """Send events to one viewer until it leaves or the server ends."""
        response = begun(web.StreamResponse(), "text/event-stream")
        writer = await response.prepare(request)
        assert connection.transport and writer
        connection.transport.set_write_buffer_limits(0)  # what was sent is the kernel's before more is
        number, block = 0, b"retry: 1000\n\n"
        self.viewers += 1
        try:
            while not self._over:
                connection.wait(serving.TIMEOUT_S)
                await writer.write(block)
                await writer.drain()
                connection.wait(None)
                if number == self._number:
                    await self._news.wait()
                block = b"".join(each for at, each in self._published.values() if at > number)
                number = self._number
        except ConnectionError:
            pass  # a viewer that went away is no error
        finally:
            self.viewers -= 1
        return response
