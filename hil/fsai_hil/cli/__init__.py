"""The verbs that this package adds to `fsai-vcu`, by the entry point `fsai_vcu.verbs`."""

from typing import Final

# verb -> (module, what it does in one line, the group of `fsai-vcu --help`)
VERBS: Final = {
    "drive": (
        "fsai_hil.cli.drive",
        "drive a mission, or one with a fault, against the simulated car, without ROS or hardware",
        "simulate",
    ),
    "track": ("fsai_hil.cli.track", "make a circuit by the rules from a seed, or describe a track", "simulate"),
    "campaign": (
        "fsai_hil.cli.campaign",
        "drive thousands of runs with a fault in each, judged by the safety rules",
        "other",
    ),
    "vcu": ("fsai_hil.simulator.process", "run the simulated VCU and car as a process on a bus", "simulate"),
    "hil": ("fsai_hil.cli.hil", "run the hardware-in-the-loop suite on a real vcan0", "your stack"),
    "rehearse": (
        "fsai_hil.cli.rehearse",
        "test your CAN node, or any AI-side program, against scrutineering and the specification",
        "your stack",
    ),
    "scrutineering": (
        "fsai_hil.cli.scrutineering",
        "measure the handshake's response time on a real vcan0, and report it",
        "other",
    ),
}
