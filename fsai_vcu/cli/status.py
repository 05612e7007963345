"""`fsai-vcu status`: mode, AS state, mission, and every condition that still stands between now and driving."""

from __future__ import annotations

import argparse
import json
import math
from functools import partial
from typing import Any

from fsai_vcu.cli.services import add_bridge_arguments, vehicle_state
from fsai_vcu.core.report import loop_fault_words
from fsai_vcu.printable import LINE, printable

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = "fsai-vcu status --json"
add_arguments = partial(add_bridge_arguments, wait_s=None)
_MOST = 50  # items of a list; any program on this machine can publish the message


def run(args: argparse.Namespace) -> int:
    state = vehicle_state(args)
    print(json.dumps(_as_dict(state)) if args.json else _as_text(state))
    return 0


def _as_dict(state: Any) -> dict[str, Any]:
    """The message's fields as JSON types; NaN (never received), and what else is no number, becomes null."""
    fields: dict[str, Any] = {}
    for name in state.get_fields_and_field_types():
        value = getattr(state, name)
        if name == "header":
            continue
        if isinstance(value, float):
            fields[name] = round(value, 6) if math.isfinite(value) else None
        elif isinstance(value, bool | int):
            fields[name] = value
        elif isinstance(value, str):
            fields[name] = printable(value, LINE)
        else:
            fields[name] = [printable(item, LINE) if isinstance(item, str) else int(item) for item in value[:_MOST]]
    return fields


def _as_text(state: Any) -> str:
    """Return the state of the car as lines for a person."""
    lines = [
        f"mode      {state.mode}" + ("   (listen only: nothing is sent)" if state.listen_only else ""),
        f"AS state  {state.as_state_label}",
        f"mission   {state.mission_label}",
        f"speed     {state.speed_mps:.1f} m/s   lap {state.laps}",
        f"steering  {math.degrees(state.steering_rad):+.1f} deg",
        "switches  "
        f"ASMS {'on' if state.as_switch else 'off'}, TSMS {'on' if state.ts_switch else 'off'}, "
        f"Go {'on' if state.go_signal else 'off'}",
    ]
    if state.operational_limits:
        lines.append(f"limits    {', '.join(state.operational_limits)}")
    if math.isnan(state.status_age_s):
        lines.append("car       nothing received (no 0x520)")
    elif state.status_age_s > 0.1:
        lines.append(f"car       silent for {state.status_age_s:.1f} s")
    if state.faults:
        lines.append(f"faults    {', '.join(state.faults)} (shutdown cause {state.shutdown_cause_label})")
    if state.emergency:
        lines.append(f"emergency {state.emergency}")
    if state.stopping:
        lines.append(f"stopping  {state.stopping}")
    if busy := loop_fault_words(state.loop_faults):
        lines.append(f"computer  {busy}")
    lines += [f"gate      {reason}" for reason in state.gate_reasons[:_MOST]]
    if state.why_not_driving:
        lines.append("why not driving:")
        lines += [f"  - {condition}" for condition in state.why_not_driving[:_MOST]]
    return "\n".join(printable(line, LINE) for line in lines)
