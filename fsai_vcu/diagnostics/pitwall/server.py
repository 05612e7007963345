"""The page over HTTP, to be read only: GET of its three files, and of a stream of events for each viewer.

aiohttp serves it, in one thread. A viewer that has taken all that was sent gets the newest of each event since then.
"""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from functools import partial
from http import HTTPStatus
from importlib.resources import files
from typing import Any, Final

from aiohttp import web

MOST_CONNECTIONS: Final = 64
TIMEOUT_S = 10.0  # who asks nothing, or takes nothing, for so long is gone
_FILES: Final = {
    "/": ("page.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
}
_HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Connection": "close",
    "Server": "fsai-vcu",
}
_LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
_SEND_BUFFER_BYTES: Final = 32768  # a few seconds of events: what a slow network cannot take is left out, not queued


class Server:
    """Serves in a thread from `with` on. `viewers`: how many streams there are."""

    def __init__(self, host: str, port: int) -> None:
        """Raises OSError."""
        self.names = _LOOPBACK if host in _LOOPBACK else ()
        self.socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        try:
            self.socket.bind((host, port))
            self.socket.listen(MOST_CONNECTIONS)
        except OSError:
            self.socket.close()
            raise
        self.server_address = self.socket.getsockname()
        self._loop = asyncio.new_event_loop()
        self._ended, self._news = asyncio.Event(), asyncio.Event()
        self._published: dict[str, tuple[int, bytes]] = {}
        self._number = self.viewers = 0

    def __enter__(self) -> Server:
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._serve(),), daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join()
        left = asyncio.all_tasks(self._loop)
        for task in left:
            task.cancel()
        if left:
            self._loop.run_until_complete(asyncio.wait(left))
        self._loop.close()

    def publish(self, event: str, data: dict[str, Any]) -> None:
        """To every viewer, in place of the event of that name before."""
        text = json.dumps({"sent_s": round(time.monotonic(), 3), **data}, separators=(",", ":"))
        self._loop.call_soon_threadsafe(self._put, event, f"event: {event}\ndata: {text}\n\n".encode())

    def _put(self, event: str, block: bytes) -> None:
        self._number += 1
        self._published[event] = self._number, block
        self._news.set()
        self._news = asyncio.Event()

    async def _serve(self) -> None:
        manager = web.Server(self._answer, handler_cancellation=True)
        listener = await self._loop.create_server(partial(_Connection, manager, self._loop), sock=self.socket)
        await self._ended.wait()
        listener.close()
        self._news.set()
        await manager.shutdown(0.2)

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        host = request.headers.get("Host", "")
        if request.method != "GET":
            return _error(HTTPStatus.METHOD_NOT_ALLOWED)
        if self.names and (host.rpartition(":")[0] or host).strip("[]") not in self.names:
            return _error(HTTPStatus.MISDIRECTED_REQUEST)  # a foreign site's name that leads to this machine
        if request.path == "/events":
            return await self._stream(request)
        if request.path not in _FILES:
            return _error(HTTPStatus.NOT_FOUND)
        name, kind = _FILES[request.path]
        return _begun(web.Response(body=files("fsai_vcu.diagnostics.pitwall").joinpath(name).read_bytes()), kind)

    async def _stream(self, request: web.BaseRequest) -> web.StreamResponse:
        response = _begun(web.StreamResponse(), "text/event-stream")
        connection, writer = request.protocol, await response.prepare(request)
        assert isinstance(connection, _Connection) and connection.transport and writer
        connection.transport.set_write_buffer_limits(0)  # what was sent is the kernel's before more is
        number, block = 0, b"retry: 1000\n\n"
        self.viewers += 1
        try:
            while not self._ended.is_set():
                connection.end_within(TIMEOUT_S)
                await writer.write(block)
                await writer.drain()
                connection.end_within(None)
                if number == self._number:
                    await self._news.wait()
                block = b"".join(each for at, each in self._published.values() if at > number)
                number = self._number
        except ConnectionError:
            pass  # a viewer that went away is no error
        finally:
            self.viewers -= 1
        return response


class _Connection(web.RequestHandler):
    """It has its time: a stream for each write, any other connection for all that it does."""

    def __init__(self, manager: web.Server, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(manager, loop=loop)
        self.manager, self.loop = manager, loop
        self.deadline: asyncio.TimerHandle | None = None

    def end_within(self, timeout_s: float | None) -> None:
        """Cut the connection then, unless this is called again before; None: let it be."""
        if self.deadline:
            self.deadline.cancel()
        self.deadline = self.loop.call_later(timeout_s, self.transport.abort) if self.transport and timeout_s else None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if len(self.manager.connections) > MOST_CONNECTIONS:
            self.force_close()

    async def start(self) -> None:
        self.end_within(TIMEOUT_S)
        try:
            await super().start()
        finally:
            self.end_within(None)

    def handle_error(self, request: web.BaseRequest, status: int = 500, *why: Any, **words: Any) -> web.StreamResponse:
        """Of what is no request, or of an error of ours."""
        if status == HTTPStatus.INTERNAL_SERVER_ERROR:
            super().handle_error(request, status, *why, **words)  # logs it
        return _error(HTTPStatus(status))


def _begun(response: web.StreamResponse, kind: str) -> web.StreamResponse:
    """With what every answer has."""
    response.headers.update({"Content-Type": f"{kind}; charset=utf-8", **_HEADERS})
    response.force_close()
    return response


def _error(status: HTTPStatus) -> web.StreamResponse:
    return _begun(web.Response(status=status, body=f"{status.value} {status.phrase}\n".encode()), "text/plain")
