"""Topics over Foxglove's WebSocket protocol, to be seen only: a client subscribes, and gets what comes.

What is sent is what Foxglove's own SDK sends of channels in JSON; that has no means to refuse a client, so it is not
used. A slow client loses the oldest messages, not the newest.
"""

from __future__ import annotations

import asyncio
import json
import struct
import time
from collections import deque
from collections.abc import Iterable, Sequence
from http import HTTPStatus
from typing import Any, Final

import aiohttp
from aiohttp import web

from fsai_vcu.diagnostics import serving
from fsai_vcu.diagnostics.serving import Connection, error_page

PROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
_MESSAGE: Final = struct.Struct("<BIQ")  # 1 for a message, the subscription, its time in ns
_MOST_WAITING: Final = 4096  # messages for one client
_MOST_OF_A_CHANNEL: Final = 4  # subscriptions of one client, each of which is sent every message; Foxglove has one
_ALIVE_S: Final = 30.0  # a client answers a ping in half of it, or is gone
_MOST_BYTES: Final = 1 << 20  # of what a client says at once

Message = tuple[str, int, dict[str, Any]]  # topic, time in ns, values


class _Client:
    def __init__(self) -> None:
        self.subscribed: dict[int, list[int]] = {}  # by channel
        self.waiting: deque[bytes] = deque(maxlen=_MOST_WAITING)
        self.news = asyncio.Event()


class Server(serving.Server):
    """Shows topics that are named beforehand."""

    # Foxglove in a browser, on the desktop (its pages are files), and a Foxglove that this machine serves itself.
    origins = ("https://app.foxglove.dev", "file://", "http://localhost:*", "http://127.0.0.1:*")

    def __init__(self, host: str, port: int, name: str, topics: Sequence[str]) -> None:
        """Listen on host and port. Raises OSError."""
        super().__init__(host, port)
        self._name = name
        self._numbers = {topic: number for number, topic in enumerate(topics, 1)}
        self._clients: set[_Client] = set()
        self._session = str(time.time_ns() // 1_000_000)
        self._over = False

    def __enter__(self) -> Server:
        super().__enter__()
        return self

    def publish(self, messages: Iterable[Message]) -> None:
        """Publish messages to the clients that want them. Raises UserError where nobody listens any more."""
        self.check()
        wanted = {number for client in tuple(self._clients) for number in tuple(client.subscribed)}
        found = [
            (number, t_ns, json.dumps(values, separators=(",", ":")).encode())
            for topic, t_ns, values in (messages if wanted else ())
            if (number := self._numbers[topic]) in wanted
        ]
        if found:
            self.loop.call_soon_threadsafe(self._put, found)

    def _put(self, messages: list[tuple[int, int, bytes]]) -> None:
        for client in self._clients:
            for number, t_ns, payload in messages:
                for subscription in client.subscribed.get(number, ()):
                    client.waiting.append(_MESSAGE.pack(1, subscription, t_ns) + payload)
            client.news.set()

    def end(self) -> None:
        self._over = True
        for client in self._clients:
            client.news.set()

    async def answer(self, request: web.BaseRequest, connection: Connection) -> web.StreamResponse:
        """Answer a client: upgrade to the WebSocket, then serve it until it leaves."""
        asked = {each.strip() for each in request.headers.get("Sec-WebSocket-Protocol", "").split(",")}
        if request.headers.get("Upgrade", "").lower() != "websocket" or not asked.intersection(PROTOCOLS):
            return error_page(HTTPStatus.UPGRADE_REQUIRED)
        response = web.WebSocketResponse(
            protocols=PROTOCOLS, max_msg_size=_MOST_BYTES, compress=False, heartbeat=_ALIVE_S
        )
        try:
            await response.prepare(request)
        except (web.HTTPException, ValueError):  # its version or its key is none
            return error_page(HTTPStatus.BAD_REQUEST)
        client = _Client()
        connection.wait(None)
        about = {"capabilities": [], "metadata": {}, "sessionId": self._session}
        channels = [
            {"id": number, "topic": topic, "encoding": "json"}
            | {"schemaName": topic.rpartition("/")[2], "schemaEncoding": "jsonschema", "schema": ""}
            for topic, number in self._numbers.items()
        ]
        self._clients.add(client)
        writing = asyncio.ensure_future(self._write(response, connection, client))
        try:
            await response.send_str(json.dumps({"op": "serverInfo", "name": self._name, **about}))
            await response.send_str(json.dumps({"op": "advertise", "channels": channels}))
            async for message in response:
                if message.type is aiohttp.WSMsgType.TEXT and (problem := self._take(client, message.data)):
                    await response.send_str(json.dumps({"op": "status", "level": 2, "message": problem}))
        except ConnectionError:
            pass  # a client that went away is no error
        finally:
            self._clients.discard(client)
            writing.cancel()
        return response

    async def _write(self, response: web.WebSocketResponse, connection: Connection, client: _Client) -> None:
        while not self._over:
            await client.news.wait()
            client.news.clear()
            while client.waiting:
                connection.wait(serving.TIMEOUT_S)
                await response.send_bytes(client.waiting.popleft())
            connection.wait(None)
        await response.close()

    def _take(self, client: _Client, text: str) -> str:
        """Take in what a client asks and return why it is not understood, or ''."""
        try:
            words = json.loads(text)
            if words["op"] == "subscribe":
                for each in words["subscriptions"]:
                    subscription, channel = int(each["id"]), int(each["channelId"])
                    if not 0 <= subscription < 1 << 32 or channel not in self._numbers.values():
                        raise ValueError(channel)
                    held = client.subscribed.setdefault(channel, [])
                    if len(held) >= _MOST_OF_A_CHANNEL:
                        return "too many subscriptions"
                    held.append(subscription)
                return ""
            if words["op"] == "unsubscribe":
                gone = {int(each) for each in words["subscriptionIds"]}
                for channel, held in list(client.subscribed.items()):
                    client.subscribed[channel] = [each for each in held if each not in gone]
                    if not client.subscribed[channel]:
                        del client.subscribed[channel]
                return ""
        except (ValueError, LookupError, TypeError, OverflowError, RecursionError):
            pass
        return "not understood: this server takes subscribe and unsubscribe"
