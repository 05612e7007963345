"""`fsai-vcu emergency-brake`: ask the car for an emergency stop, through the bridge."""

from functools import partial

from fsai_vcu.cli.services import add_bridge_arguments, call

EXAMPLE = "fsai-vcu emergency-brake"
add_arguments = partial(add_bridge_arguments, wait_s=60.0)
run = partial(call, service="emergency_brake")
