"""Faults upon faults on a car that drives a real mission: the whole lockstep, with the bus checker on its wire.

The cases of `fuzz_cases` put strange things before a bridge; here the planner, the controller, the VCU and the car are
the real ones, and what goes wrong comes from the catalogue of wire faults, from spoilt commands and from services.
"""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random
from typing import Final

from fsai_hil.evidence.fuzz_cases import MODES, fields_of_a_command
from fsai_hil.rules.checker import WireChecker
from fsai_hil.rules.violation import Violation
from fsai_hil.simulator.faults import Delay, Drop, FlipBits, FrameFault, Freeze, Repeat, Window, WrongLength
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import MS, S

LONGEST_NS: Final = 45 * S  # of one drive
AFTER_NS: Final = 6 * S  # what is watched after the last fault
_MISSIONS: Final = (Ami.ACCELERATION, Ami.AUTONOMOUS_DEMO, Ami.STATIC_INSPECTION_A, Ami.SKIDPAD)
_VCU_IDS: Final = (0x520, 0x521, 0x522, 0x523, 0x524, 0x525, 0x526)


def _fault(chance: Random, window: Window, mask: bytes) -> FrameFault:
    seed = chance.randrange(1 << 30)
    match chance.randrange(6):
        case 0:
            return Drop(window, probability=chance.choice((1.0, 0.5, 0.1)), seed=seed)
        case 1:
            return Freeze(window)
        case 2:
            return Delay(window, chance.choice((5, 40, 60, 120)) * MS, chance.choice((0, 20)) * MS, seed)
        case 3:
            return FlipBits(window, mask)
        case 4:
            return WrongLength(window, chance.randrange(9))
        case _:
            return Repeat(window, chance.randrange(2, 5))


class Drive:
    """One mission with what goes wrong in it, all made from a lineage."""

    def __init__(self, origin: str) -> None:
        self.origin = origin
        self.notes: list[str] = []
        self._chance = chance = Random(f"drive {origin}")
        revision = chance.choice(("2026", "2026", "2021"))
        mission = chance.choice(_MISSIONS)
        self.lockstep = Lockstep(WorldSetup(missions=(mission,), revision=revision, seed=chance.randrange(1000)))
        self.lockstep.wire = WireChecker(self.lockstep.world.codec, car=CARS[revision])
        self.notes.append(f"{mission.label} on the car of {revision}")
        self._services: list[tuple[int, str, str]] = []
        self._spoilt: tuple[int, int] = (0, 0)
        self._spoil = fields_of_a_command(chance)
        self._spoil.pop("run_offset", None)
        self._age_ns = round(self._spoil.pop("age_ms", 0.0) * MS)
        self._last_ns = LONGEST_NS
        self._planned = False

    def _plan(self, driving_ns: int) -> None:
        """AS_DRIVING has begun: what goes wrong, and when."""
        chance = self._chance
        last_ns = driving_ns
        for _ in range(chance.randrange(1, 4)):
            from_ns = driving_ns + chance.randrange(8 * S)
            until_ns = from_ns + chance.choice((30, 60, 120, 350, 1200)) * MS
            outgoing = chance.random() < 0.75
            ids = chance.sample(_VCU_IDS if outgoing else AI_IDS, chance.choice((1, 1, 2, 5)))
            window = Window(frozenset(ids), from_ns, until_ns)
            fault = _fault(chance, window, chance.randbytes(8))
            vcu = self.lockstep.world.vcu
            (vcu.outgoing if outgoing else vcu.incoming).add(fault)
            self.notes.append(f"{'to' if outgoing else 'from'} the AI computer: {fault}")
            last_ns = max(last_ns, until_ns)
        if chance.random() < 0.5:
            from_ns = driving_ns + chance.randrange(8 * S)
            self._spoilt = (from_ns, from_ns + chance.choice((20, 90, 250, 800)) * MS)
            self.lockstep.computer.command_filter = self._spoiler
            self.notes.append(
                f"commands from {from_ns} to {self._spoilt[1]} ns say {self._spoil}, {self._age_ns} ns older"
            )
            last_ns = max(last_ns, self._spoilt[1])
        if chance.random() < 0.4:
            at_ns = driving_ns + chance.randrange(8 * S)
            kind = chance.choice(("mode", "mode", "emergency", "reset"))
            self._services.append((at_ns, kind, chance.choice(MODES)))
            self.notes.append(f"service {kind} {self._services[-1][2]!r} at {at_ns} ns")
            last_ns = max(last_ns, at_ns)
        self._last_ns = min(self._last_ns, last_ns + AFTER_NS)

    def _spoiler(self, command: VehicleCommand, now_ns: int) -> VehicleCommand | None:
        if not self._spoilt[0] <= now_ns < self._spoilt[1]:
            return command
        spoilt = replace(command, t_sensor_ns=command.t_sensor_ns - self._age_ns, **self._spoil)
        return None if math.isinf(spoilt.throttle) else spoilt

    def run(self) -> list[Violation]:
        """Drive until nothing more goes wrong for a while. What broke a rule; an exception is a problem too."""
        lockstep = self.lockstep
        try:
            while lockstep.now_ns < self._last_ns and not lockstep.world.done:
                lockstep.step()
                status = lockstep.bridge.state.vehicle.status
                if not self._planned and status is not None and status.as_state is AsState.AS_DRIVING:
                    self._planned = True
                    self._plan(lockstep.now_ns)
                while self._services and self._services[0][0] <= lockstep.now_ns:
                    self._call(*self._services.pop(0)[1:])
                if lockstep.wire.violations:
                    break
        except Exception as error:
            return [Violation("never an exception", f"{type(error).__name__}: {error}")]
        return [Violation("the bus", violation) for violation in lockstep.wire.violations]

    def _call(self, kind: str, text: str) -> None:
        bridge, now_ns = self.lockstep.bridge, self.lockstep.now_ns
        if kind == "mode":
            bridge.set_mode(text, now_ns)
        elif kind == "emergency":
            bridge.emergency_brake(text, now_ns)
        else:
            bridge.reset(now_ns)
