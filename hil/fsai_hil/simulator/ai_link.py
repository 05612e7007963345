"""The VCU's side of the link to the AI computer: the handshake it alternates, and the watch over the five messages.

No socket, no clock. Source: the vehicle's interface specification v4.0, handshake and loss of communication.
"""

from __future__ import annotations

from typing import Final

from fsai_hil.simulator.profiles import Profile
from fsai_vcu.interface.messages import AiBrake, AiDriveFront, AiDriveRear, AiImage, AiStatus, AiSteer
from fsai_vcu.interface.specification import COMMS_LOST_NS

# The five messages, and the attribute of the link that holds the last of each
AI_MESSAGES: Final = {
    AiStatus: "status",
    AiDriveFront: "drive_front",
    AiDriveRear: "drive_rear",
    AiSteer: "steer",
    AiBrake: "brake",
}


class AiLink:
    """The last messages of the AI computer, and whether it is still there.

    `bit` is the HANDSHAKE that the VCU sends; `response_times_ns` has one entry per toggle that was answered.
    """

    def __init__(self, profile: Profile) -> None:
        """Begin as a VCU that has received nothing."""
        self._profile = profile
        self._takes_any = profile.echo_timeout_ns is None
        self.bit = False
        self._toggled_ns = 0  # when the present bit first went out
        self._echoed = True  # the first 0x520 says 1
        self._echo_since_ns = 0  # the echo has been missing since (only meaningful while it is awaited)
        self._received_ns: dict[type, int] = {}  # empty before the first AI data
        self._never_received: set[type] = set(AI_MESSAGES)
        self.response_times_ns: list[int] = []
        self.status = AiStatus()
        self.drive_front = AiDriveFront()
        self.drive_rear = AiDriveRear()
        self.steer = AiSteer()
        self.brake = AiBrake()

    # ------------------------------------------------------------ what happens

    def next_bit(self, t_ns: int) -> bool:
        """The HANDSHAKE of the 0x520 that goes out at `t_ns`: toggled if the last bit was answered."""
        if self._echoed or not self._profile.handshake_waits_for_echo:
            if self._echoed:
                self._echo_since_ns = t_ns
            self.bit = not self.bit
            self._toggled_ns = t_ns
            self._echoed = False
        return self.bit

    def on_image(self, image: AiImage, t_ns: int) -> None:
        """One message of the AI computer has arrived."""
        if not self.received:
            self._received_ns = dict.fromkeys(AI_MESSAGES, t_ns)  # none is overdue before the others began
            if not self._echoed:
                self._echo_since_ns = t_ns
        self._received_ns[type(image)] = t_ns
        self._never_received.discard(type(image))
        setattr(self, AI_MESSAGES[type(image)], image)
        if isinstance(image, AiStatus) and not self._echoed and (image.handshake == self.bit or self._takes_any):
            self._echoed = True
            self.response_times_ns.append(t_ns - self._toggled_ns)

    # ------------------------------------------------------------ what follows from it

    @property
    def received(self) -> bool:
        """AI data has arrived since the VCU was switched on."""
        return bool(self._received_ns)

    def missing(self, message: type, now_ns: int) -> bool:
        """Return whether that message has failed to come ten times in a row."""
        return self.received and now_ns - self._received_ns[message] >= COMMS_LOST_NS

    def echo_missing(self, now_ns: int) -> bool:
        """The echo has not matched for the time the VCU grants."""
        patience_ns = self._profile.echo_timeout_ns
        if patience_ns is None or self._echoed or not self.received:
            return False
        return now_ns - self._echo_since_ns >= patience_ns

    def lost(self, now_ns: int) -> bool:
        """AI_COMMS_LOST: the echo, or any one of the five messages, is missing. Never before the first AI data."""
        if not self.received:
            return False
        silent_ns = now_ns - min(self._received_ns.values())
        return silent_ns >= COMMS_LOST_NS or self.echo_missing(now_ns)

    def valid(self, now_ns: int) -> bool:
        """All five messages have arrived and go on arriving, and the echo matches."""
        return not self._never_received and not self.lost(now_ns)
