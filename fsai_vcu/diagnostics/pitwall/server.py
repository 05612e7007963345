"""The page over HTTP, to be read only: GET of its three files, and of a stream of events for each viewer.

The standard library's server: what is sent is made once for all viewers, and each has a thread that waits for it.
"""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, Final

MOST_CONNECTIONS: Final = 64
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
}
_LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
_SEND_BUFFER_BYTES: Final = 32768  # a few seconds of events: what a slow network cannot take is left out, not queued


class Server(ThreadingHTTPServer):
    """Serves in a thread from `with` on. `viewers`: how many streams there are."""

    daemon_threads = True
    request_queue_size = MOST_CONNECTIONS

    def __init__(self, host: str, port: int) -> None:
        """Raises OSError."""
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self.names = _LOOPBACK if host in _LOOPBACK else ()
        self.viewers = 0
        self.changed = threading.Condition()
        self._published: dict[str, tuple[int, bytes]] = {}
        self._number = 0
        self.ended = False
        self._free = threading.Semaphore(MOST_CONNECTIONS)
        super().__init__((host, port), _Handler)

    def server_bind(self) -> None:
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        super().server_bind()

    def __enter__(self) -> Server:
        threading.Thread(target=partial(self.serve_forever, 0.1), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        with self.changed:
            self.ended = True
            self.changed.notify_all()
        self.server_close()

    def publish(self, event: str, data: dict[str, Any]) -> None:
        """To every viewer, in place of the event of that name before."""
        text = json.dumps({"sent_s": round(time.monotonic(), 3), **data}, separators=(",", ":"))
        with self.changed:
            self._number += 1
            self._published[event] = self._number, f"event: {event}\ndata: {text}\n\n".encode()
            self.changed.notify_all()

    def newer(self, than: int) -> tuple[int, bytes]:
        """What was published after that number, waited for; and the number to ask with the next time."""
        with self.changed:
            self.changed.wait_for(lambda: self._number > than or self.ended)
            return self._number, b"".join(block for number, block in self._published.values() if number > than)

    def count(self, change: int) -> None:
        with self.changed:
            self.viewers += change

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), OSError):  # a viewer that went away is no error
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: Server
    timeout = 10.0  # of one read or write: who takes nothing for so long is gone

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        host = self.headers.get("Host", "").rpartition(":")[0] or self.headers.get("Host", "")
        if self.server.names and host.strip("[]") not in self.server.names:
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST)  # a foreign site's name that leads to this machine
        elif path == "/events":
            self._stream()
        elif path in _FILES:
            name, kind = _FILES[path]
            self._begin(HTTPStatus.OK, kind)
            self.wfile.write(files("fsai_vcu.diagnostics.pitwall").joinpath(name).read_bytes())
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _stream(self) -> None:
        self._begin(HTTPStatus.OK, "text/event-stream")
        self.server.count(1)
        try:
            self.wfile.write(b"retry: 1000\n\n")
            number = 0
            while not self.server.ended:
                number, block = self.server.newer(number)
                self.wfile.write(block)
        finally:
            self.server.count(-1)

    def _begin(self, status: int, kind: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": f"{kind}; charset=utf-8", **_HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """In one plain line. What is no GET finds no method here: 405."""
        status = HTTPStatus.METHOD_NOT_ALLOWED if code == HTTPStatus.NOT_IMPLEMENTED else HTTPStatus(code)
        self.close_connection = True
        self._begin(status, "text/plain")
        self.wfile.write(f"{status.value} {status.phrase}\n".encode())

    def version_string(self) -> str:
        return "fsai-vcu"

    def log_message(self, format: str, *args: Any) -> None:
        """Nobody reads who looks."""
