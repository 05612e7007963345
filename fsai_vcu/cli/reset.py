"""`fsai-vcu reset`: clear the latched emergency request, through the bridge's /reset service."""

from functools import partial

from fsai_vcu.cli.services import add_bridge_arguments, call

EXAMPLE = "fsai-vcu reset"
add_arguments = add_bridge_arguments
run = partial(call, service="reset")
