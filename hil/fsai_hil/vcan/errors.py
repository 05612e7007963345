"""What goes wrong with the place, as opposed to the command that runs in it."""

from __future__ import annotations

TIMED_OUT = 124  # the exit status of a command that was ended by its time limit, as timeout(1) has it


class VcanError(Exception):
    """No vcan0 to be had; the message is one clear line with what to do about it."""
