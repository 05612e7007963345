"""The safety rules held against the wire by one who also knows what the process was told.

`WireChecker` judges frames alone, as anybody beside the bus can. Here it is made exact (what was received before a
frame was sent is known, nothing is in flight), and what it cannot see is added: commands, modes, services,
confirmations, lost buses, restarts. Nothing is taken from supervisor or gate: what the AI computer says is decoded from
its frames, and the limits come from the revision, the car's parameters, the operational limits and the safety rules'
own times.

What is added to each rule:

2.  torque needs a mission for which SELECTED went out whole, and
    autonomous accepted (or entered by itself at power-up: in AS_INIT and AS_OFF, at proven rest), neither
    manual asked for since nor a command lost for 300 ms, which turns the mode to manual; and a command that was in
    order, of the run in hand, younger than 100 ms on data younger than 500 ms, that pushes and does not brake; never
    more than its share. The mode that the process shows is held against the same.
4.  steering moves only towards such a command and never in manual, or back behind a limit that was lowered; it is zero
    in the first 3 s.
5.  SELECTED needs a mission on the AMI, both resets confirmed since it was chosen, and outside AS_READY autonomous and
    no emergency latched.
6.  from a granted emergency brake on, and from the first ESTOP_REQUEST seen, every 0x510 asks for it, until a granted
    reset or a power cycle; a reset is granted in AS_INIT and AS_OFF only.
7.  a command out of order is refused with words, and nothing on the wire follows it.
8.  each frame is one of the five with its length, and cantools decodes it within its ranges and encodes it back to the
    same bytes; nothing is sent by a process that only listens, in the first 200 ms, on a lost bus, or after the end.
10. a lost bus and a restart break the sequence. A planner or controller that confirms a second time for one run has
    been restarted: no torque in that run any more.

And the graded reactions and the output table: what must stop the run (no torque from then on), what must ask for the
emergency brake, that a brake is there where one is due (from the second whole cycle on, as rule 1 has it), and what is
sent at the orderly end. Plausibility of steering and wheels is judged only where it is beyond all doubt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from fsai_hil.rules.checker import WireChecker
from fsai_hil.rules.numbers import (
    COMMAND_FRESH_NS,
    COMMAND_LOST_NS,
    DATA_FRESH_NS,
    FEEDBACK_LOST_NS,
    FEEDBACK_STALE_NS,
    LAUNCH_NS,
    LISTEN_FIRST_NS,
    MOST_TORQUE_NM,
    MS,
    ODD_LOST_NS,
    PEDALS_NS,
    POWER_CYCLE_NS,
    SEND_LOST_NS,
    STATUS_LOST_NS,
    STILL_RPM,
    STOP_CYCLES,
    STOP_TIMEOUT_NS,
    S,
)
from fsai_hil.rules.violation import Violation
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiBrake,
    AiDriveFront,
    AiDriveRear,
    AiImage,
    AiStatus,
    AiSteer,
    VcuStatus,
    VcuSteer,
)
from fsai_vcu.interface.reserved import AI_IDS

OFF: Final = (AsState.AS_INIT, AsState.AS_OFF)
IDLE: Final = (*OFF, AsState.AS_READY)
STATUS_ID: Final = 0x520
ROLES: Final = ("planner", "controller")
STEER_STEP_DEG: Final = 0.1  # the signal's resolution
ODD_WHEEL_RPM: Final = 400  # of a wheel without a motor, all others nearly standing: no slip explains that
ODD_STEER_DEG: Final = 20.0  # far beyond delay, backlash and margin


@dataclass(frozen=True, slots=True)
class Terms:
    """What holds for the process under test: car, venue, and the parts of its configuration that the rules name."""

    car: VehicleParameters
    limits: OperationalLimits = UNLIMITED
    listen_only: bool = False
    autonomous_at_power_up: bool = False
    motor_brakes: bool = False
    stop_timeout_ns: int = STOP_TIMEOUT_NS
    service_brake_pct: float = 80.0  # what a stop is made with
    short_sequence: bool = False  # AS_DRIVING may come sooner than after 5 s in AS_READY, and without an edge of Go


class WireOracle:
    """Tell it everything that happens, in order; `problems` has what broke a rule. Times are monotonic ns."""

    def __init__(self, codec: Codec, terms: Terms) -> None:
        self.problems: list[Violation] = []
        self.frames = 0
        self._codec = codec
        self._terms = terms
        self._wire = WireChecker(
            codec,
            in_flight_ns=0,
            handshake_in_flight_ns=0,
            clock_slack_ns=0,
            car=terms.car,
            limits=terms.limits,
            from_start=True,
            motor_brakes=terms.motor_brakes,
            short_sequence=terms.short_sequence,
        )
        self._steer_limit_deg = min(codec.revision.steer_limit_deg, terms.limits.max_steer_deg)
        self._torque_limit_nm = min(MOST_TORQUE_NM, terms.car.axle_torque_max_nm, terms.limits.max_axle_torque_nm)
        self._well_formed: set[tuple[int, bytes]] = set()
        self._reported = 0
        self._know_nothing()

    def _know_nothing(self) -> None:
        # what the car said
        self._as_state: AsState | None = None
        self._go = False
        self._fault = False
        self._status_ns: int | None = None
        self._heard_ns: int | None = None
        self._was_off = False  # a power cycle's silence lies before the next believed 0x520
        self._driving_ns: int | None = None
        self._supervised_ns = 0  # when supervision of command, wheels and steering begins
        self._mission = Ami.NOT_SELECTED
        self._angle_deg = 0.0
        self._angle_max_deg = 0.0
        self._steer_ns: int | None = None
        # what it was told
        self._autonomous = False
        self._power_up = self._terms.autonomous_at_power_up  # may choose autonomous by itself yet
        self._confirmed: set[str] = set()
        self._latched = False
        self._alarm: str | None = None
        self._command: VehicleCommand | None = None
        self._command_ns = 0
        self._command_current = False
        self._both_ns: int | None = None
        self._stopped: tuple[int, str] | None = None  # torque is over in this run: since when, and why
        self._lost = False
        self._back_ns = 0  # what could not be heard before then is not missing
        self._first_poll_ns: int | None = None
        self._end_cycles: int | None = None
        # what went out
        self._steer_sent = 0.0
        self._steer_sent_ns = 0
        self._brake_sent = 0.0
        self._steer_known = True  # the last cycle's 0x513 went out
        self._asked_deg: tuple[float, int] = (0.0, 0)  # and since when it has been the same
        self._whole_cycles_due = 0  # whole cycles in a row in which a brake was due
        self._brake_due: str | None = None
        self._service_due = False  # and a holding brake is not enough
        self._cycle: list[int] = []
        self._whole_ns: int | None = None
        self._whole_in_a_row = 0
        self._odd_wheel_ns: int | None = None
        self._odd_steer_ns: int | None = None

    # ------------------------------------------------------------ what the process receives

    def received(self, frame: Frame) -> None:
        """A frame that reached the process, of whoever's."""
        if frame.error:
            return
        now_ns = frame.t_ns
        strange = frame.extended or frame.remote
        if frame.can_id in AI_IDS and not frame.extended:
            if self._as_state is AsState.AS_DRIVING and not self._lost:
                self._alarm = f"0x{frame.can_id:03X} of somebody else was received"
            return
        if strange or not self._codec.knows(frame.can_id):
            return
        if frame.can_id == STATUS_ID:
            if self._heard_ns is not None and now_ns - self._heard_ns >= POWER_CYCLE_NS:
                self._was_off = True
            self._heard_ns = now_ns
        image = self._wire.on_frame(frame)
        if isinstance(image, VcuStatus):
            self._on_status(image, now_ns)
        elif isinstance(image, VcuSteer):
            self._angle_deg, self._angle_max_deg = image.angle_deg, max(0.0, image.angle_max_deg)
            self._steer_ns = now_ns

    def _on_status(self, status: VcuStatus, now_ns: int) -> None:
        state, before = status.as_state, self._as_state
        entered_off = state in OFF and before is not None and (before not in OFF or self._was_off)
        changed = status.ami is not self._mission and (state in IDLE or before is None)
        if entered_off or changed:
            self._mission = status.ami
            self._confirmed.clear()
            self._command_current = False
        if self._was_off:
            self._power_up = self._terms.autonomous_at_power_up
            if state in OFF:
                self._latched = False
        if state is not before or self._was_off:
            driving = state is AsState.AS_DRIVING
            self._driving_ns = now_ns if driving else None
            self._supervised_ns = now_ns + LAUNCH_NS
            self._stopped, self._both_ns, self._odd_wheel_ns, self._odd_steer_ns = None, None, None, None
            self._alarm = None
        self._was_off = False
        self._as_state, self._go, self._fault, self._status_ns = state, status.go_signal, status.fault, now_ns

    # ------------------------------------------------------------ what it is told

    def on_command(
        self, command: VehicleCommand, problems: tuple[str, ...], now_ns: int, *, current: bool, fit: bool
    ) -> None:
        """A command of the run in hand (`current`) or of another; `fit`: made in order. `problems` are the answer."""
        if not fit and not problems:
            self._wrong("7", f"a command out of order was taken: {command}")
        if fit and current and not self._lost and problems:
            self._wrong("7", f"a command in order was refused: {'; '.join(problems)}")
        if fit and current and not self._lost:
            self._command, self._command_ns, self._command_current = command, now_ns, True

    def on_mode(self, mode: str, answer: tuple[bool, str], now_ns: int) -> None:
        done, words = answer
        known = self._status_ns is not None and now_ns - self._status_ns < STATUS_LOST_NS
        if mode == "manual":
            if not done:
                self._wrong("modes", f"manual was refused: {words}")
            self._autonomous = self._power_up = False
            if self._as_state is AsState.AS_DRIVING:
                self._stop("manual was asked for", now_ns)
        elif mode == "autonomous":
            if done and (not known or self._as_state not in IDLE or self._terms.listen_only):
                self._wrong("modes", f"autonomous was accepted in {self._where}")
            self._autonomous = self._autonomous or done
            self._power_up = self._power_up and not done
        elif done or "manual" not in words or "autonomous" not in words:
            self._wrong("modes", f"mode {mode!r} was answered with {done}, {words!r}")

    def on_mode_shown(self, mode: str) -> None:
        """What the process says of its mode after a cycle."""
        if mode == "autonomous" and not self._autonomous:
            self._wrong("modes", f"the mode is autonomous in {self._where}, and nothing made it so")

    def on_emergency(self, answer: tuple[bool, str]) -> None:
        """The operator asked for the emergency brake."""
        if answer[0]:
            self._latched = True

    def on_reset(self, answer: tuple[bool, str], now_ns: int) -> None:
        if not answer[0]:
            return
        if self._as_state not in OFF or self._status_ns is None or now_ns - self._status_ns >= STATUS_LOST_NS:
            self._wrong("6", f"a reset was granted in {self._where}")
        self._latched = False

    def on_confirmed(self, role: str, now_ns: int, *, current: bool) -> None:
        """Planner or controller says that it has reset itself for the run in hand (`current`) or another."""
        if role not in ROLES or not current:
            return
        if role in self._confirmed and self._as_state is AsState.AS_DRIVING:
            self._stop(f"the {role} was restarted", now_ns)
        self._confirmed.add(role)

    def on_loop_fault(self, now_ns: int) -> None:
        if self._as_state is AsState.AS_DRIVING:
            self._alarm = "the loop missed its deadline"

    def on_bus_lost(self, now_ns: int) -> None:
        if self._heard_ns is not None and now_ns - self._heard_ns >= POWER_CYCLE_NS:
            self._was_off = True
        self._lost = True
        self._command = None
        self._wire.on_bus_lost()
        self._stop("the bus was lost", now_ns)

    def on_bus_back(self, now_ns: int) -> None:
        self._lost = False
        self._back_ns = now_ns
        if self._heard_ns is not None:
            self._heard_ns = now_ns
        self._supervised_ns = now_ns + LAUNCH_NS  # nothing could be heard: nothing is missing yet
        self._whole_cycles_due = 0
        self._whole_ns = None
        if self._stopped is not None:
            self._stopped = (now_ns, self._stopped[1])

    def on_restart(self) -> None:
        """The process has died and another begins: it knows nothing, and the VCU keeps what it saw last."""
        self._wire.restarted()
        self._know_nothing()

    def on_end(self, now_ns: int) -> None:
        """The software is told to stop in order."""
        if self._end_cycles is None:
            self._end_cycles = 0
            self._stop("the software was stopped", now_ns)

    # ------------------------------------------------------------ what goes out

    def before_cycle(self, now_ns: int) -> None:
        """The process is about to decide what to send; what is due by now is due in these frames."""
        if self._first_poll_ns is None:
            self._first_poll_ns = now_ns
        self._cycle = []
        if (
            self._power_up
            and not self._terms.listen_only
            and self._as_state in OFF
            and self._wire.wheels.may_stand(now_ns)
        ):
            self._autonomous, self._power_up = True, False
        self._age(now_ns)

    def sent(self, frame: Frame) -> AiImage | None:
        """A frame of the process went out. Returns what it says, None for what should never have been sent."""
        now_ns = frame.t_ns
        self.frames += 1
        if self._terms.listen_only:
            self._wrong("8", "a process that only listens sends")
        if self._lost:
            self._wrong("8", "frames are sent on a lost bus")
        if self._first_poll_ns is None or now_ns - self._first_poll_ns < LISTEN_FIRST_NS:
            self._wrong("8", "frames are sent before the process has listened for 200 ms")
        if not self._check_form(frame):
            return None
        self._cycle.append(frame.can_id)
        image = self._wire.on_frame(frame)
        if isinstance(image, AiStatus):
            self._on_ai_status(image, now_ns)
        elif isinstance(image, AiDriveFront | AiDriveRear):
            self._on_torque(image, now_ns)
        elif isinstance(image, AiSteer):
            self._on_steer(image.steer_deg, now_ns)
        elif isinstance(image, AiBrake):
            self._on_brake(image, now_ns)
        else:
            return None
        return image

    def after_cycle(self, made: bool, now_ns: int) -> None:
        """All of the cycle's frames that were taken have gone out; `made`: it was to be sent at all."""
        self._wire.cycle_over()
        whole = tuple(self._cycle) == AI_IDS
        self._whole_in_a_row = self._whole_in_a_row + 1 if whole else 0
        if whole:
            self._whole_cycles_due = self._whole_cycles_due + 1 if self._brake_due else 0
            self._whole_ns = now_ns
        elif made:
            if self._whole_ns is None:
                self._whole_ns = now_ns
            elif now_ns - self._whole_ns >= SEND_LOST_NS and self._as_state is AsState.AS_DRIVING:
                self._stop("no cycle went out whole for 50 ms", now_ns)
                self._wire.on_bus_lost()
                self._whole_ns = now_ns
        if made:
            self._steer_known = AI_IDS[3] in self._cycle
        for text in self._wire.violations[self._reported :]:
            _, rule, words = text.split(": ", 2)
            self.problems.append(Violation(rule.removeprefix("rule "), words))
        self._reported = len(self._wire.violations)

    # ------------------------------------------------------------ what is due

    def _age(self, now_ns: int) -> None:
        """Let the clock say what is over and what is due, as the safety rules have it, before a cycle is decided."""
        self._brake_due, self._service_due = None, False
        state = self._as_state
        if state in (AsState.AS_READY, AsState.AS_FINISHED):
            self._brake_due = self._where
        if state is not AsState.AS_DRIVING or self._driving_ns is None:
            return
        if not self._wire.came_the_whole_way:
            self._stop("AS_OFF, AS_READY for 5 s before Go, and AS_DRIVING were not seen in turn", now_ns)
        if not self._wire.acknowledged:
            self._stop("no mission was acknowledged", now_ns)
        if self._wire.turned is not None:
            self._stop(f"in AS_DRIVING {self._wire.turned[1]}", now_ns)
        if not self._go:
            self._stop("Go is off", now_ns)
        if self._fault:
            self._stop("FAULT_STATUS is 1", now_ns)
        if self._status_ns is None or now_ns - max(self._status_ns, self._back_ns) >= STATUS_LOST_NS:
            self._alarm = self._alarm or "0x520 is lost for 100 ms"
        if len(self._confirmed) < len(ROLES):
            self._stop("not both resets are confirmed", now_ns)
        if now_ns >= self._supervised_ns:
            self._supervise(now_ns)
        if self._stopped is not None:
            self._brake_due = self._stopped[1]
            wheels = self._wire.wheels
            slow = (
                wheels.rpm is not None
                and (max(wheels.rpm) < STILL_RPM or wheels.open)
                and wheels.may_count_ns is not None
                and now_ns - wheels.may_count_ns < FEEDBACK_STALE_NS
            )
            # A stop began no later than it is known here, but what began it may have been seen a cycle before.
            if now_ns - self._stopped[0] >= self._terms.stop_timeout_ns + 100 * MS and not slow:
                self._alarm = self._alarm or "the car still moves long after the stop began"
        emergency = self._latched or self._alarm is not None
        self._service_due = emergency or (self._stopped is not None and not self._wire.wheels.may_stand(now_ns))
        if emergency:
            self._brake_due = self._alarm or "an emergency is latched"
        if now_ns - self._driving_ns < LAUNCH_NS:
            self._brake_due = "the first 3 s of AS_DRIVING"

    def _supervise(self, now_ns: int) -> None:
        for name, t_ns in (("wheel speeds", self._wire.wheels.may_count_ns), ("steering feedback", self._steer_ns)):
            age_ns = FEEDBACK_LOST_NS if t_ns is None else now_ns - t_ns
            if age_ns >= FEEDBACK_STALE_NS:
                self._stop(f"{name} missing for 100 ms", now_ns)
            if age_ns >= FEEDBACK_LOST_NS:
                self._alarm = self._alarm or f"{name} missing for 300 ms"
        quiet_ns = now_ns - self._supervised_ns
        if self._command is not None and self._command_current:
            old_data_ns = now_ns - self._command.t_sensor_ns - (DATA_FRESH_NS - COMMAND_FRESH_NS)
            quiet_ns = min(quiet_ns, max(now_ns - self._command_ns, old_data_ns))
        if quiet_ns >= COMMAND_LOST_NS:
            if self._surely_runs:
                self._autonomous = False
            self._stop("no valid command for 300 ms", now_ns)
        obeyed = self._valid(now_ns)
        if obeyed is not None and self._stopped is None and self._autonomous:
            if obeyed.mission_finished:
                self._stop("the mission is done", now_ns)
            if obeyed.estop_request:
                self._alarm = self._alarm or "the mission asks for the emergency brake"
        if obeyed is not None and obeyed.throttle > 0.0 and obeyed.brake > 0.0 and self._obeys(obeyed.brake):
            self._both_ns = self._both_ns or now_ns
            if now_ns - self._both_ns >= PEDALS_NS and self._autonomous:
                self._alarm = self._alarm or "throttle and brake together for 100 ms"
        else:
            self._both_ns = None
        self._look_at_wheels(now_ns)
        self._look_at_steering(now_ns)

    def _look_at_steering(self, now_ns: int) -> None:
        """The angle is far from a request that has not changed for two seconds: no delay explains that."""
        asked_deg, since_ns = self._asked_deg
        fresh = self._steer_ns is not None and now_ns - self._steer_ns < FEEDBACK_STALE_NS
        settled = now_ns - max(since_ns, self._supervised_ns) >= 2 * S and self._steer_known
        if not (fresh and settled and abs(self._angle_deg - asked_deg) > ODD_STEER_DEG):
            self._odd_steer_ns = None
        elif self._odd_steer_ns is None:
            self._odd_steer_ns = now_ns
        elif now_ns - self._odd_steer_ns >= ODD_LOST_NS:
            self._alarm = self._alarm or "the steering does not follow for 600 ms"

    def _look_at_wheels(self, now_ns: int) -> None:
        """One wheel without a motor spins while the three others nearly stand: nothing explains that."""
        wheels = self._wire.wheels
        rpm, fresh = wheels.rpm, wheels.believed_ns is not None and now_ns - wheels.believed_ns < FEEDBACK_STALE_NS
        odd = False
        if rpm is not None and fresh and not self._terms.car.driven_front:
            odd = any(
                rpm[wheel] > ODD_WHEEL_RPM and max(rpm[:wheel] + rpm[wheel + 1 :]) < STILL_RPM for wheel in (0, 1)
            )
        if not odd or self._mission in (Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B):
            self._odd_wheel_ns = None
        elif self._odd_wheel_ns is None:
            self._odd_wheel_ns = now_ns
        elif now_ns - self._odd_wheel_ns >= ODD_LOST_NS:
            self._alarm = self._alarm or "one wheel does not fit the other three for 600 ms"

    def _valid(self, now_ns: int) -> VehicleCommand | None:
        """The command that may be obeyed now."""
        command = self._command
        if command is None or not self._command_current:
            return None
        if now_ns - self._command_ns >= COMMAND_FRESH_NS or now_ns - command.t_sensor_ns >= DATA_FRESH_NS:
            return None
        return command

    def _obeys(self, brake: float) -> bool:
        """The planner still brakes, not a stop for a reason that cannot be seen here (wheels that do not fit)."""
        said = self._brake_sent == 0.0 or abs(self._brake_sent - 100.0 * brake) <= 0.25
        return said and self._stopped is None and not self._terms.motor_brakes

    def _stop(self, why: str, now_ns: int) -> None:
        if self._stopped is None and self._as_state is AsState.AS_DRIVING:
            self._stopped = (now_ns, why)

    # ------------------------------------------------------------ the five frames

    def _check_form(self, frame: Frame) -> bool:
        """One of the five ids, its length, and values that cantools takes strictly and gives back unchanged."""
        key = (frame.can_id, frame.data)
        if key in self._well_formed:
            return True
        if frame.extended or frame.remote or frame.error or frame.can_id not in AI_IDS:
            self._wrong("8", f"0x{frame.can_id:X} was sent")
            return False
        if len(frame.data) != BY_ID[frame.can_id].dlc:
            self._wrong("8", f"0x{frame.can_id:03X} was sent with {len(frame.data)} bytes")
            return False
        message = self._codec.database.get_message_by_frame_id(frame.can_id)
        values = message.decode(frame.data, decode_choices=False, allow_truncated=False)
        assert isinstance(values, dict)
        for signal in message.signals:
            value = values[signal.name]
            low, high = signal.minimum, signal.maximum
            assert isinstance(value, int | float)
            if (low is not None and value < low) or (high is not None and value > high):
                self._wrong("7", f"{signal.name} is {value} on the wire, outside {low} … {high}")
                return False
        if bytes(message.encode(values, strict=True)) != frame.data:
            self._wrong("7", f"0x{frame.can_id:03X} carries bits of no signal: {frame.data.hex(' ')}")
            return False
        if len(self._well_formed) < 200_000:
            self._well_formed.add(key)
        return True

    def _on_ai_status(self, ai: AiStatus, now_ns: int) -> None:
        state = self._as_state
        if self._latched and not ai.estop_request:
            self._wrong("6", "ESTOP_REQUEST is 0 though it was asked for, and nobody cleared it")
        if ai.estop_request:
            self._latched = True
        elif state is AsState.AS_DRIVING and self._alarm is not None:
            self._wrong("reactions", f"no ESTOP_REQUEST: {self._alarm}")
        if ai.mission_status is MissionStatus.SELECTED:
            self._check_selected(state)
        if (
            state is AsState.EMERGENCY_BRAKE
            and ai.direction is Direction.FORWARD
            and self._wire.wheels.surely_stand(now_ns)
        ):
            self._wrong("output table", "FORWARD in EMERGENCY_BRAKE though the wheels have stood for 0.5 s")
        if self._end_cycles is not None:
            self._end_cycles += 1
            if self._end_cycles > STOP_CYCLES:
                self._wrong("end", "frames are sent after the orderly end")
            if ai.direction is Direction.NEUTRAL:
                self._brake_due = None
            elif state is AsState.AS_DRIVING and not ai.estop_request:
                self._wrong("end", "the software ends in AS_DRIVING, neither at rest nor with ESTOP_REQUEST")

    def _check_selected(self, state: AsState | None) -> None:
        if self._mission is Ami.NOT_SELECTED:
            self._wrong("5", "SELECTED without a mission on the AMI")
        if len(self._confirmed) < len(ROLES):
            self._wrong("5", "SELECTED before planner and controller have confirmed their reset")
        if state is not AsState.AS_READY:
            if not self._autonomous:
                self._wrong("5", "SELECTED though autonomous was not chosen")
            if self._latched:
                self._wrong("5", "SELECTED with an emergency latched")

    def _on_torque(self, axle: AiDriveFront | AiDriveRear, now_ns: int) -> None:
        command = self._valid(now_ns)
        if axle.torque_nm <= 0.0:
            return
        if self._terms.motor_brakes and axle.motor_speed_max_rpm == 0:
            return  # this brakes
        name = "front" if isinstance(axle, AiDriveFront) else "rear"
        if not self._autonomous:
            self._wrong("2", f"{name} torque though autonomous was not chosen")
        if self._latched:
            self._wrong("2", f"{name} torque with an emergency latched")
        if command is None:
            self._wrong("2", f"{name} torque without a valid command")
        else:
            if command.brake > 0.0 or command.throttle <= 0.0:
                self._wrong("2", f"{name} torque though the command does not ask for it")
            most_nm = command.throttle * self._torque_limit_nm
            if axle.torque_nm > most_nm + 0.051:
                self._wrong("2", f"{name} torque {axle.torque_nm} Nm of a command for {most_nm:.2f} Nm at most")
            most_rpm = command.speed_limit_mps * self._terms.car.wheel_rpm_of_speed(1.0) * self._terms.car.gear_ratio
            if axle.motor_speed_max_rpm > most_rpm + 1e-6:
                self._wrong("4", f"{name} motor speed limit {axle.motor_speed_max_rpm} of a command for {most_rpm:.1f}")
        if self._stopped is not None:
            self._wrong("reactions", f"{name} torque in a run that is over: {self._stopped[1]}")

    def _on_steer(self, steer_deg: float, now_ns: int) -> None:
        before, before_ns, known = self._steer_sent, self._steer_sent_ns, self._steer_known
        self._steer_sent, self._steer_sent_ns = steer_deg, now_ns
        if steer_deg != self._asked_deg[0]:
            self._asked_deg = (steer_deg, now_ns)
        if self._as_state is not AsState.AS_DRIVING or self._driving_ns is None:
            return
        over = self._stopped is not None or self._latched  # then it may be held where it was
        if now_ns - self._driving_ns < LAUNCH_NS and steer_deg != 0.0 and not over:
            self._wrong("output table", f"steering {steer_deg} deg in the first 3 s of AS_DRIVING")
        moved = abs(steer_deg - before) > STEER_STEP_DEG + 1e-6
        if not moved or not known:
            return
        if steer_deg == 0.0 and before_ns < self._driving_ns:
            return  # AS_DRIVING began between the two: before it, zero was due at once
        limit_deg = min(self._steer_limit_deg, self._angle_max_deg)
        if abs(before) > limit_deg + STEER_STEP_DEG / 2 and abs(steer_deg) <= abs(before):
            return  # back behind a limit that was lowered
        command = self._valid(now_ns)
        if self._end_cycles is not None and steer_deg == 0.0:
            return
        if command is None:
            self._wrong("4", f"steering moves from {before} to {steer_deg} deg without a valid command")
            return
        if not self._autonomous:
            self._wrong("modes", f"steering moves from {before} to {steer_deg} deg, and the mode is manual")
            return
        target_deg = max(-limit_deg, min(limit_deg, math.degrees(command.steering_rad)))
        low, high = min(before, target_deg) - STEER_STEP_DEG, max(before, target_deg) + STEER_STEP_DEG
        if not low - 1e-6 <= steer_deg <= high + 1e-6:
            self._wrong("4", f"steering moves from {before} to {steer_deg} deg, the command says {target_deg:.2f}")

    def _on_brake(self, brake: AiBrake, now_ns: int) -> None:
        let_go = self._brake_sent > 0.0 and brake.front_pct == 0.0 and self._whole_in_a_row > 0
        self._brake_sent = brake.front_pct
        drives = self._as_state is AsState.AS_DRIVING and now_ns >= self._supervised_ns and self._end_cycles is None
        if let_go and drives and self._valid(now_ns) is None:
            self._wrong("output table", "the brake is let go, and no command counts")
        if self._brake_due is None or self._whole_cycles_due < 2 or self._terms.motor_brakes:
            return
        if brake.front_pct <= 0.0 and brake.rear_pct <= 0.0:
            self._wrong("output table", f"no brake: {self._brake_due}")
        elif self._service_due and min(brake.front_pct, brake.rear_pct) < self._terms.service_brake_pct:
            self._wrong("output table", f"brake {brake.front_pct} %, not the service brake: {self._brake_due}")

    # ------------------------------------------------------------ bookkeeping

    @property
    def _where(self) -> str:
        return "no AS state yet" if self._as_state is None else self._as_state.label

    @property
    def _surely_runs(self) -> bool:
        """No stop or emergency has begun, for a reason seen here or not: there would be a brake."""
        unbraked = self._whole_in_a_row > 2 and self._brake_sent == 0.0 and not self._terms.motor_brakes
        return unbraked and self._stopped is None and not self._latched and self._alarm is None

    def _wrong(self, rule: str, words: str) -> None:
        self.problems.append(Violation(rule, words))
