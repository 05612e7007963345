"""`fsai-vcu emergency-brake`: ask the car for an emergency stop, through the bridge."""

from functools import partial

from fsai_vcu.cli.services import add_bridge_arguments as add_arguments
from fsai_vcu.cli.services import call

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = "fsai-vcu emergency-brake"
run = partial(call, service="emergency_brake")
