"""Server that only shows, for page and Foxglove alike: who may ask, how many, and for how long it waits for them.

aiohttp serves it, in one thread. A web page of others that runs in a browser on this machine must get nothing: by a
name of its own that leads here (Host), or by asking from where it is (Origin).
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import socket
import threading
from collections import Counter
from functools import partial
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import urlsplit

from aiohttp import web

from fsai_vcu.interface.errors import UserError

MOST_CONNECTIONS: Final = 64
MOST_OF_ONE: Final = 16  # connections from one address: nobody can hold all places
TIMEOUT_S = 10.0  # a client that asks nothing, or takes nothing, for so long is gone
HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Connection": "close",
    "Server": "fsai-vcu",
}
_SEND_BUFFER_BYTES: Final = 32768  # a few seconds of events: what a slow network cannot take is left out, not queued


class Server:
    """Serves in a thread from `with` on what `answer` gives to a GET that is allowed."""

    origins: tuple[str, ...] = ()
    """Origins from which a page may be besides this server. '*' as its port: from any."""

    def __init__(self, host: str, port: int) -> None:
        """Listen on host and port. Raises OSError."""
        if not host:  # a script's variable that is not set would open it to every network
            raise OSError(errno.EINVAL, "no name of a host")
        self.host = host
        self.socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        try:
            self.socket.bind((host, port))
            self.socket.listen(MOST_CONNECTIONS)
        except OSError:
            self.socket.close()
            raise
        except (TypeError, ValueError) as error:  # a host that is no name at all
            self.socket.close()
            raise OSError(errno.EINVAL, "no name of a host") from error
        self.server_address = self.socket.getsockname()
        self.names = {"localhost", host.lower(), *_names_of_this_machine()} - {""}
        self.connected: Counter[str] = Counter()  # by address
        self.loop = asyncio.new_event_loop()
        self._ended = False
        self._failed: BaseException | None = None

    @property
    def beyond(self) -> str:
        """Warning where the server listens to more than this machine; '' where it does not."""
        if ipaddress.ip_address(self.server_address[0]).is_loopback:
            return ""
        return f"everybody who reaches {self.host} of this machine over a network can watch"

    @property
    def url(self) -> str:
        """Host and port as they stand in an address."""
        return f"{f'[{self.host}]' if ':' in self.host else self.host}:{self.server_address[1]}"

    def __enter__(self) -> Server:
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="server", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        if self._thread.is_alive():
            self.loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()
        self.loop.close()

    def check(self) -> None:
        """Raise UserError where nobody listens any more."""
        if not self._ended and not self._thread.is_alive():
            raise UserError(f"nobody listens on {self.url} any more: {self._failed or 'its thread has ended'}")

    def _run(self) -> None:
        try:
            self.loop.run_until_complete(self._serve())
        except BaseException as error:
            self._failed = error

    async def _serve(self) -> None:
        manager = web.Server(self._answer, handler_cancellation=True)
        listener = await self.loop.create_server(partial(Connection, manager, self), sock=self.socket)
        await self._stop.wait()
        listener.close()
        self.end()
        await manager.shutdown(0.2)

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        connection = request.protocol
        if request.method != "GET":
            return error_page(HTTPStatus.METHOD_NOT_ALLOWED)
        host = request.headers.get("Host", "")
        if not (isinstance(connection, Connection) and self.is_named(_name_in(host), connection.own)):
            return error_page(HTTPStatus.MISDIRECTED_REQUEST)
        if any(not self.is_origin(origin, host) for origin in request.headers.getall("Origin", ())):
            return error_page(HTTPStatus.FORBIDDEN)
        return await self.answer(request, connection)

    def is_named(self, name: str, own: str) -> bool:
        """Return true where `name` means this server, whose address is `own`: no other site can be called so."""
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return name in self.names
        here = _plain(ipaddress.ip_address(own))
        return _plain(address) == here or ((address.is_loopback or address.is_unspecified) and here.is_loopback)

    def is_origin(self, origin: str, host: str) -> bool:
        """Return true where a page from there may ask."""
        if origin == f"http://{host}" or origin in self.origins:
            return True
        try:
            parts = urlsplit(origin)
            place = f"{parts.scheme}://{parts.hostname}"
            alone = origin.lower() in (place, f"{place}:{parts.port}")  # a list, or one with more in it, is none
            return alone and f"{place}:*" in self.origins
        except ValueError:
            return False

    # Methods that each kind of server has of its own.

    async def answer(self, request: web.BaseRequest, connection: Connection) -> web.StreamResponse:
        raise NotImplementedError

    def end(self) -> None:
        """Stop what still waits for something."""


class Connection(web.RequestHandler):
    """One connection, ended when its patience is: a request, or what is written, must come to its end in time."""

    def __init__(self, manager: web.Server, server: Server) -> None:
        # A request that is answered here needs no body: what somebody sends of one is neither waited for nor unpacked.
        super().__init__(manager, loop=server.loop, lingering_time=0.0, auto_decompress=False)
        self.server = server
        self.own = self._peer = ""
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.own = str(transport.get_extra_info("sockname")[0]).partition("%")[0]
        self._peer = str(transport.get_extra_info("peername")[0])
        connected = self.server.connected
        connected[self._peer] += 1
        if connected[self._peer] > MOST_OF_ONE or connected.total() > MOST_CONNECTIONS:
            self.force_close()
        self.wait(TIMEOUT_S)

    def connection_lost(self, exc: BaseException | None) -> None:
        self.wait(None)
        self.server.connected[self._peer] -= 1
        self.server.connected += Counter()  # without those that have none
        super().connection_lost(exc)

    def wait(self, patience_s: float | None) -> None:
        """Be patient for so long from now on; None: for as long as it takes."""
        if self._timer is not None:
            self._timer.cancel()
        transport = self.transport
        self._timer = None
        if patience_s is not None and transport is not None:
            self._timer = self.server.loop.call_later(patience_s, transport.abort)

    def handle_error(self, request: web.BaseRequest, status: int = 500, *why: Any, **words: Any) -> web.StreamResponse:
        """The answer to what is no request, and to an error of this server."""
        gone = any(isinstance(each, ConnectionError) for each in why)  # a client that went away is no error
        if status == HTTPStatus.INTERNAL_SERVER_ERROR and not gone:
            super().handle_error(request, status, *why, **words)  # logs it
        return error_page(HTTPStatus(status))


def begun(response: web.StreamResponse, kind: str) -> web.StreamResponse:
    """Give the response what every answer has."""
    response.headers.update({"Content-Type": f"{kind}; charset=utf-8", **HEADERS})
    response.force_close()
    return response


def error_page(status: HTTPStatus) -> web.StreamResponse:
    return begun(web.Response(status=status, body=f"{status.value} {status.phrase}\n".encode()), "text/plain")


def _name_in(host: str) -> str:
    """The name in a Host header, without its port, in lower case."""
    name = host if host.endswith("]") or ":" not in host else host.rpartition(":")[0]
    return name.strip("[]").lower()


def _plain(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """The IPv4 address in an address that is written as IPv6."""
    return getattr(address, "ipv4_mapped", None) or address


def _names_of_this_machine() -> set[str]:
    name = socket.gethostname().lower()
    return {name, f"{name}.local"} if name else set()
