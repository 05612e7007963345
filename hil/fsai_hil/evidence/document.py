"""`python -m fsai_hil.evidence.document > docs/supervision.md`: the tables of supervisor and gate, for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.gate import LIMITERS
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.core.supervision.supervisor import (
    NEXT,
    OUTPUT,
    REACTIONS,
    STEERS_WHILE_STOPPING,
    Brake,
    Consequence,
    Output,
    Steer,
    Step,
)
from fsai_vcu.interface.units import MS

_FOLLOWS = {
    Consequence.REPORT: "reported",
    Consequence.HOLD: "torque 0 while it lasts",
    Consequence.STOP: "service-brake stop, latched",
    Consequence.STOP_MANUAL: "service-brake stop, latched, and manual mode",
    Consequence.ESTOP: "ESTOP_REQUEST, latched",
}
_STEERING = {
    Steer.ZERO: "0",
    Steer.HELD: "held",
    Steer.COMMAND: "by command",
    Steer.HELD_OR_COMMAND: "held, or by command where the cause lets the planner speak",
}
_BRAKE = {
    Brake.ZERO: "0",
    Brake.HOLDING: "holding brake",
    Brake.COMMAND: "by command",
    Brake.KEPT: "as before",
    Brake.SERVICE: "service brake",
}


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


def _sent(row: Output) -> list[str]:
    status = "SELECTED once the mission is acknowledged" if row.mission_status is None else row.mission_status.label
    torque = "by command" if row.torque else "0"
    return [status, row.direction.label, _STEERING[row.steer], _BRAKE[row.brake], torque]


def _after(step: Step) -> str:
    return "at once" if step.after is None else f"{getattr(BridgeConfig(), step.after) / MS:.0f} ms"


def _reaction(reason: Reason, steps: Sequence[Step]) -> list[str]:
    steers = "yes" if reason in STEERS_WHILE_STOPPING else ""
    follows = "; ".join(f"{_after(step)}: {_FOLLOWS[step.consequence]}" for step in steps)
    return [f"`{reason.slug}`", reason.words, follows, steers]


def _flow() -> list[str]:
    """What ends a drive: reasons that do the same are one box."""
    alike: dict[tuple[Step, ...], list[Reason]] = {}
    for reason, steps in REACTIONS.items():
        alike.setdefault(steps, []).append(reason)
    lines = [f'{one.name}(["{words}"])' for one, words in _FOLLOWS.items()]
    for number, (steps, reasons) in enumerate(alike.items()):
        lines.append(f'R{number}["{"<br>".join(reason.slug for reason in reasons)}"]')
        lines += [f"R{number} -->|{_after(step)}| {step.consequence.name}" for step in steps]
    return lines


def _diagram(kind: str, lines: Iterable[str]) -> str:
    return "\n".join(["```mermaid", kind, *(f"  {line}" for line in lines), "```"])


def document() -> str:
    """The whole page."""
    sequence = [f"{before.name} --> {then.name}: {state.label}" for (before, state), then in NEXT.items()]
    chain = [(str(place), f"`{one.__name__}`", (one.__doc__ or "").strip()) for place, one in enumerate(LIMITERS, 1)]
    sent = ([phase.value, *_sent(row)] for phase, row in OUTPUT.items())
    reactions = (_reaction(reason, steps) for reason, steps in REACTIONS.items())
    return f"""# Supervision: the tables of supervisor and gate

Made from the tables in the code by `python -m fsai_hil.evidence.document > docs/supervision.md`: not to be edited.
The words at the top of `fsai_vcu/core/supervision/supervisor.py` and `gate.py` say how they are used.

## What is sent, by where the run stands

{_table(("phase", "MISSION_STATUS", "direction", "steering", "brake", "torque"), sent)}

With an emergency latched ESTOP_REQUEST is 1 in every phase.

## What follows when something breaks in AS_DRIVING

{_diagram("flowchart LR", _flow())}

{_table(("reason", "what it says", "after, and what follows", "the planner steers in that stop"), reactions)}

## What a drive needs to have seen

Every step that is not here leads to NONE; only COMPLETE lets the car drive.

{_diagram("stateDiagram-v2", ["[*] --> NONE", *sequence])}

## What the gate takes from a request, in this order

{_table(("", "limiter", "rule"), chain)}
"""


if __name__ == "__main__":
    print(document(), end="")
