"""sd_notify: one datagram to systemd, when it is there."""

from __future__ import annotations

import os
import socket


class Notifier:
    """Tells systemd READY, WATCHDOG, STOPPING and STATUS. Silent where nobody listens."""

    def __init__(self, environ: dict[str, str] | None = None) -> None:
        env = dict(os.environ) if environ is None else environ
        address = env.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)
        words = env.get("WATCHDOG_USEC", "")  # systemd writes digits; anything else is not its word
        usec = int(words) if words.isascii() and words.isdecimal() and len(words) < 20 else 0
        mine = env.get("WATCHDOG_PID", "") in ("", str(os.getpid()))
        # Half of the time that systemd allows, as its documentation recommends.
        self.watchdog_period_ns: int | None = usec * 500 if usec and mine else None

    def send(self, message: str) -> None:
        """Send e.g. "READY=1". Never raises and never blocks: a full or absent socket must not stop the loop."""
        if self._socket is not None:
            try:
                self._socket.sendto(message.encode(), self._address)
            except OSError:
                return
