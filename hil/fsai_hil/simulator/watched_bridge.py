"""The bridge that tells its checker everything it is given, in order: the one stream that the rules are held against.

What it decides is not told, but for its mode and what it takes for implausible: the checker has its own view of what is
due. What leaves is told by whoever sends it.
"""

from __future__ import annotations

from fsai_hil.rules.checker import WireChecker
from fsai_hil.rules.numbers import STOP_TIMEOUT_NS
from fsai_hil.rules.seen import Process
from fsai_vcu.core.bridge import Bridge, BridgeConfig
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiCommand


def process_of(config: BridgeConfig, **known: bool) -> Process:
    """The part of a configuration that the rules name; `known`: what else the checker can rely on."""
    return Process(
        listen_only=config.listen_only,
        autonomous_at_power_up=config.autonomous_at_power_up,
        service_brake_pct=config.stop_brake_pct,
        stop_cycles=config.stop_cycles,
        stop_timeout_ns=config.stop_timeout_ns if config.motor_brakes else STOP_TIMEOUT_NS,  # motors may take longer
        **known,
    )


class WatchedBridge(Bridge):
    """The bridge: what it receives, what is asked of it and happens to it, and how it answers, its checker is told."""

    checker: WireChecker

    def on_frame(self, frame: Frame) -> None:
        super().on_frame(frame)
        self.checker.received((frame,))

    def cycle(self, now_ns: int) -> AiCommand | None:
        command = super().cycle(now_ns)
        state = self.state
        odd_ns = state.steering.implausible_since_ns, state.wheels.implausible_since_ns
        self.checker.on_cycle(now_ns, state.supervisor.mode.value, *odd_ns)
        return command

    def on_sent(self, complete: bool, now_ns: int) -> None:
        super().on_sent(complete, now_ns)
        self.checker.cycle_over(now_ns)

    def on_command(self, command: VehicleCommand, now_ns: int) -> tuple[str, ...]:
        current = command.run_id == self.state.supervisor.run_id
        problems = super().on_command(command, now_ns)
        self.checker.on_command(command, bool(problems), now_ns, current=current)
        return problems

    def on_reset_confirmed(self, role: str, run_id: int) -> None:
        super().on_reset_confirmed(role, run_id)
        if run_id == self.state.supervisor.run_id:
            self.checker.on_confirmed(role)

    def set_mode(self, mode: str, now_ns: int) -> tuple[bool, str]:
        answer = super().set_mode(mode, now_ns)
        self.checker.on_mode(mode, answer, now_ns)
        return answer

    def emergency_brake(self, why: str, now_ns: int) -> tuple[bool, str]:
        answer = super().emergency_brake(why, now_ns)
        self.checker.on_emergency(answer[0])
        return answer

    def reset(self, now_ns: int) -> tuple[bool, str]:
        answer = super().reset(now_ns)
        self.checker.on_reset(answer[0], now_ns)
        return answer

    def bus_lost(self, why: str, now_ns: int) -> None:
        super().bus_lost(why, now_ns)
        self.checker.on_bus_lost(now_ns)

    def bus_back(self, now_ns: int) -> None:
        super().bus_back(now_ns)
        self.checker.on_bus_back(now_ns)

    def loop_fault(self, why: str, now_ns: int) -> None:
        super().loop_fault(why, now_ns)
        self.checker.on_loop_fault()

    def begin_stop(self, now_ns: int) -> None:
        super().begin_stop(now_ns)
        self.checker.on_end()
