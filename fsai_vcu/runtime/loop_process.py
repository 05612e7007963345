"""The process of the CAN loop: `python -m fsai_vcu.runtime.loop_process DESCRIPTORS BUS`, started by its edge.

It imports neither ROS nor its middleware. The edge hands it one end of a link and the settings; it reads the database,
and runs the loop whenever it is asked to activate, until it is asked to deactivate. It ends with the link: when its
edge is gone, and the car does not drive any more.
"""

from __future__ import annotations

import logging
import select
import signal
import socket
import sys
import time

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.revisions import REVISIONS
from fsai_vcu.interface.values import shortened
from fsai_vcu.runtime.link import Answer, Ask, Lanes, LinkEnd, LinkHandler, LoopSettings
from fsai_vcu.runtime.loop import BridgeLoop

logger = logging.getLogger("fsai_vcu.runtime.loop_process")  # started as a program it has another name


def serve(link: LinkEnd) -> None:
    """Serve the edge from the settings to the end of the link."""
    settings: LoopSettings | None = None
    codec: Codec | None = None
    while not link.closed:
        select.select(link.descriptors, [], [])
        for message in link.receive():
            match message:
                case Ask(what="configure", argument=LoopSettings() as settings):
                    try:
                        files = settings.dbc_files or None
                        codec = Codec(REVISIONS[settings.revision], files, settings.wheel_mapping)
                    except Exception as error:  # an invalid database, or an unknown revision
                        link.send(Answer(message.number, False, shortened(str(error))))
                    else:
                        if codec.unknown:
                            logger.warning("%s", codec.unknown)
                        link.send(Answer(message.number, True))
                case Ask(what="activate", argument=int() as first_run_id) if settings is not None and codec is not None:
                    _run(link, settings, codec, message.number, first_run_id)
                case _:
                    pass  # what was meant for a run that has ended


def _run(link: LinkEnd, settings: LoopSettings, codec: Codec, number: int, first_run_id: int) -> None:
    """Make the bridge and run its loop; the answer to request `number` says when it has begun, or why it has not."""
    try:
        bridge = Bridge(
            codec,
            REVISIONS[settings.revision],
            CARS[settings.car],
            settings.config,
            settings.limits,
            first_run_id=first_run_id,
            now_ns=time.monotonic_ns(),
        )
        loop = BridgeLoop(bridge, codec, settings, link)
    except Exception as error:  # the bus or its lock is not to be had
        link.send(Answer(number, False, shortened(str(error))))
        return
    loop.run(number)


def main() -> int:
    # Ctrl-C, and a service manager's SIGTERM, go to every process of a group: the edge decides what they mean, and
    # without it the table of reactions does.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    ordinary, urgent = (socket.socket(fileno=int(descriptor)) for descriptor in sys.argv[1].split(","))
    link = LinkEnd(Lanes(ordinary, urgent))
    source = logging.getLogger("fsai_vcu")
    source.setLevel(logging.INFO)
    source.addHandler(LinkHandler(link))
    source.propagate = False
    serve(link)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
