#!/usr/bin/env python3
"""The whole AI side of this project as one program without ROS, on any bus: bridge, planner and controller.

    .venv/bin/python examples/without_ros/without_ros.py vcan0

It has no detector, so it drives what needs no cones (the static inspections and the autonomous demo); give
`computer.on_cones` yours, and it drives the rest.
"""

from __future__ import annotations

import signal
import sys
import time

from fsai_hil.simulator.ai_computer import OnboardComputer
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime.bus import BusError, open_bus
from fsai_vcu.runtime.loop import RECEIVE_IDS

REVISION = "2026"
WAKE_S = 0.002
END_S = 1.0  # what the bridge needs at the most for its orderly end at rest


def main() -> int:
    """Drive the car on the bus that is named, until a signal ends the program; return its exit status."""
    if len(sys.argv) != 2:
        print(f"usage: {sys.argv[0]} BUS", file=sys.stderr)
        return 2
    car, codec, now_ns = CARS[REVISION], Codec(revision(REVISION)), time.monotonic_ns()
    bridge = Bridge(codec, revision(REVISION), car, BridgeConfig(), first_run_id=now_ns % 2**31, now_ns=now_ns)
    computer = OnboardComputer(bridge, codec, Planner(car), Controller(car), now_ns)
    ended_s: list[float] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended_s.append(time.monotonic()))
    autonomous = False
    try:
        bus = open_bus(sys.argv[1], receive=RECEIVE_IDS, may_send=AI_IDS)
    except BusError as error:
        print(error, file=sys.stderr)
        return 1
    with bus:
        while not (ended_s and (bridge.stopped or time.monotonic() > ended_s[0] + END_S)):
            first = bus.recv(WAKE_S)
            if first is not None:
                computer.on_frames([first, *bus.drain()])
            now_ns = time.monotonic_ns()
            if ended_s:
                bridge.begin_stop(now_ns)
            elif not autonomous:  # what an operator types, or `autonomous_at_power_up` does
                autonomous = bridge.set_mode("autonomous", now_ns)[0]
            for frame in computer.advance(now_ns):
                bus.send(frame)
    return 0


if __name__ == "__main__":
    sys.exit(main())
