"""`fsai-vcu reset`: clear the latched emergency request, through the bridge's /reset service."""

from functools import partial

from fsai_vcu.cli.services import add_bridge_arguments as add_arguments
from fsai_vcu.cli.services import call

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = "fsai-vcu reset"
run = partial(call, service="reset")
