"""The ground truth as a side channel: where the simulated car really is, for simulated sensors in other processes.

A real camera looks at the world; a simulated one has to be given it. The process that simulates the car sends datagrams
to a port of this machine's loopback address, a sensor simulator listens there. It is not part of the car: nothing of
the AI side but the sensor simulator may read it.
"""

from __future__ import annotations

import contextlib
import json
import math
import socket
from typing import TYPE_CHECKING, Final, get_type_hints

from msgspec.structs import asdict

from fsai_hil.simulator.car import Pose
from fsai_vcu.interface.values import Value

if TYPE_CHECKING:
    from typing_extensions import Self

HOST: Final = "127.0.0.1"
DEFAULT_PORT: Final = 25_510
MOST_BYTES: Final = 4096
_TYPES: Final = {int: (int,), float: (int, float), str: (str,)}


class Truth(Value, frozen=True):
    """The car at one instant. The pose is the rear axle's in the world's frame, the track's own.

    `t_ns` is CLOCK_MONOTONIC of the simulating machine (virtual time in lockstep), `track` what `load_track` takes.
    """

    t_ns: int
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float
    steer_deg: float
    as_state: str
    mission: str
    track: str
    seed: int
    laps: int = 0

    @property
    def pose(self) -> Pose:
        return Pose(self.x_m, self.y_m, self.yaw_rad)


def pack(truth: Truth) -> bytes:
    return json.dumps(asdict(truth), separators=(",", ":")).encode()


def unpack(datagram: bytes) -> Truth:
    """The truth in a datagram; ValueError with one line for anything else."""
    try:
        truth = Truth(**json.loads(datagram))
    except (TypeError, ValueError) as error:
        raise ValueError(f"not a ground-truth datagram: {error}") from None
    for name, kind in get_type_hints(Truth).items():
        value = getattr(truth, name)
        if type(value) not in _TYPES[kind] or (isinstance(value, float) and not math.isfinite(value)):
            raise ValueError(f"not a ground-truth datagram: {name} is {value!r}")
    return truth


class _Socket:
    """A datagram socket at this machine's loopback address that never blocks. Raises OSError if the port is taken."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((HOST, port))
        except OSError:
            self._socket.close()
            raise

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class TruthSender(_Socket):
    """Sends to the one who listens; nobody listening is no error."""

    def __init__(self, port: int = DEFAULT_PORT) -> None:
        super().__init__(0)  # bound: else an answer would be taken from any network
        self._address = (HOST, port)

    def send(self, truth: Truth) -> None:
        # a full buffer or an absent listener loses this datagram; the next one comes within milliseconds
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.sendto(pack(truth), self._address)


class TruthReceiver(_Socket):
    """Receives the truth."""

    def __init__(self, port: int = DEFAULT_PORT) -> None:
        super().__init__(port)
        self.port: int = self._socket.getsockname()[1]

    def latest(self) -> Truth | None:
        """The newest truth that has arrived since the last call; older and malformed ones are skipped."""
        newest: Truth | None = None
        with contextlib.suppress(BlockingIOError):
            while True:
                datagram = self._socket.recv(MOST_BYTES)
                with contextlib.suppress(ValueError):
                    newest = unpack(datagram)
        return newest
