"""ackermann_adapter: the interface that a team's stack has to its own CAN node or simulator, on top of vcu_bridge.

It takes the place of path_planner and vehicle_controller: the stack publishes Ackermann commands and a few flags, and
this node makes a vehicle command of them. Whose interface it is: a preset (adapter_presets), or parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from fsai_msgs.msg import ConeArray, ResetConfirmation, RunState, VehicleCommand, VehicleState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.task import Future
from rclpy.validate_topic_name import validate_topic_name
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from fsai_nodes.adapter_outputs import ANSWERS, OUTPUTS, ros_type
from fsai_nodes.adapter_presets import MODES, PRESETS, SERVICE, TOPIC, TYPES, Preset
from fsai_nodes.clocks import Clocks, Input, nanoseconds
from fsai_nodes.complaints import complaints_of
from fsai_nodes.conversions import BASE_FRAME
from fsai_nodes.door import Door
from fsai_nodes.parameters import NodeError, NodeParameter, Settings
from fsai_nodes.process import run
from fsai_nodes.qos import SENSOR, profile, publisher
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.forces import brake_for, throttle_for
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.units import S

PERIOD_S = 0.02  # 50 Hz, as the bridge asks for; stacks speak more slowly, and teams' CAN nodes repeat a command
HOLDING_BRAKE = 0.2  # while the stack does not drive
ASKED_BRAKE = 0.5  # of full pressure, where the stack only says that it brakes: as fsai_api's node does
COASTING_MPS2 = 0.5  # a smaller deceleration is left to the resistance of air and tyres
SPEED_GAIN_1PS = 1.0  # acceleration per speed error, where commands are speeds
BRIDGE = BridgeConfig()
# A command that is repeated longer than so is stale for the bridge: its data would be older than 500 ms.
MOST_REPEATED_S = (BRIDGE.sensor_stale_ns - BRIDGE.command_stale_ns) / S
ONCE = profile(10)  # what may be said once only, and reliably
NONE = "none"

_AS_PRESET = f"Empty: the preset's; {NONE}: there is none."
_WAY = f"{TOPIC}:NAME of a std_msgs/Bool or {SERVICE}:NAME of a std_srvs/Trigger. {_AS_PRESET}"
INTERFACE = (
    NodeParameter("command", "", "Topic of the stack's commands, of ackermann_msgs. Empty: the preset's."),
    NodeParameter("command_type", "", "Their type. Empty: the preset's.", choices=("", *TYPES)),
    NodeParameter(
        "command_mode",
        "",
        "What counts of a command: its acceleration, or its speed; with speed_or_finish a negative speed says that the "
        "mission is finished. Empty: the preset's.",
        choices=("", *MODES),
    ),
    NodeParameter("driving", "", f"Topic of the std_msgs/Bool that lets the car drive. {_AS_PRESET}"),
    NodeParameter("finish", "", f"How the stack says that the mission is finished: {_WAY}"),
    NodeParameter("brake", "", f"How it asks for the brake, at half of its pressure: {_WAY}"),
    NodeParameter("emergency", "", f"How it asks for the emergency brake: {_WAY}"),
    NodeParameter("reset", "", f"Name of the service that is vcu_bridge's /reset. {_AS_PRESET}"),
    NodeParameter(
        "outputs",
        "",
        f"What the stack receives and may call: NAME=KIND separated by commas, of {', '.join((*OUTPUTS, *ANSWERS))}. "
        f"{_AS_PRESET}",
    ),
)
SETTINGS = (
    NodeParameter("preset", "eufs", "Whose interface it is.", choices=tuple(PRESETS)),
    *INTERFACE,
    NodeParameter("car", "2026", "Vehicle parameters to drive with.", choices=tuple(CARS)),
    NodeParameter("max_speed", 30.0, "The car is driven no faster than this, in m/s.", low=0.5, high=30.0, live=True),
    NodeParameter(
        "cmd_timeout",
        0.2,
        "How long a command is repeated, in s. If no other command comes, the bridge takes torque away 0.1 s later "
        "and brakes 0.3 s later: together the 0.5 s of ros_can and hydrakon_can.",
        low=0.05,
        high=MOST_REPEATED_S,
    ),
)


def interface_of(settings: Settings) -> Preset:
    """The preset, with what parameters change of it. Raises NodeError for what cannot be."""
    given: dict[str, Any] = {each.name: settings.text(each.name) for each in INTERFACE}
    given = {name: "" if text == NONE else text for name, text in given.items() if text}
    if "outputs" in given:
        pairs = [each.partition("=") for each in given["outputs"].split(",") if each]
        given["outputs"] = {name.strip(): kind.strip() for name, _, kind in pairs}
    interface = replace(PRESETS[settings.text("preset")], **given)
    if not interface.command:
        raise NodeError("parameter command: without commands there is nothing to adapt")
    for name in ("finish", "brake", "emergency"):
        way = getattr(interface, name)
        by, _, named = way.partition(":")
        if way and (by not in (TOPIC, SERVICE) or not named):
            raise NodeError(f"parameter {name} must be {TOPIC}:NAME or {SERVICE}:NAME, not {way}")
    for name, kind in interface.outputs.items():
        if kind not in OUTPUTS and kind not in ANSWERS:
            raise NodeError(f"parameter outputs: {name} is of no known kind: {kind or 'none'}")
    ways = (each.partition(":")[2] for each in (interface.finish, interface.brake, interface.emergency) if each)
    for name in filter(None, (interface.command, interface.driving, interface.reset, *ways, *interface.outputs)):
        try:
            validate_topic_name(name)
        except NameValidationException as error:
            why = str(error).partition(": ")[2].partition(":\n")[0]
            raise NodeError(f"'{name}' is not a name of a topic or service: {why}") from error
    return interface


class AckermannAdapter(Node):
    """Vehicle commands at a steady rate: from the newest command while the stack drives, else at rest."""

    def __init__(self, **options: object) -> None:
        """Read the parameters and connect the interface. Raises NodeError for what cannot be."""
        super().__init__("ackermann_adapter", **options)
        self._settings = Settings(self, SETTINGS, lambda _name: None)
        self._car = CARS[self._settings.text("car")]
        self._clocks = Clocks(self)
        self._interface = interface_of(self._settings)
        self._repeated_ns = round(self._settings.number("cmd_timeout") * S)
        self._input = Input(self, self._interface.command, silent_ns=self._repeated_ns, clocks=self._clocks)
        self._run = RunState()
        self._confirmed: int | None = None
        self._state: VehicleState | None = None
        self._emergency = self._told = False  # the stack asks for it; the bridge was told
        self._ask_ns = 0  # when the bridge is asked the next time
        self._forget()
        self._command = publisher(self, VehicleCommand, "vehicle_cmd")
        self._confirmation = publisher(self, ResetConfirmation, "reset_confirmation")
        # A group of their own: a service of this node waits for their answers.
        group = ReentrantCallbackGroup()
        self._asked = {
            name: self.create_client(Trigger, name, callback_group=group) for name in ("emergency_brake", "reset")
        }
        self._door = Door(self)
        self._door.subscription(RunState, "run_state", self._on_run)
        self._door.subscription(VehicleState, "vehicle_state", self._on_state)
        self._door.subscription(ConeArray, "detected_cones", self._on_cones)
        try:
            self._connect()
        except ImportError as error:
            raise NodeError(f"{error}: docs/bring-your-own-stack.md says who builds these messages") from error
        self._clocks.watch()
        self._clocks.every(PERIOD_S, self._tick)
        one, timeout_s = self._interface, self._repeated_ns / S
        self.get_logger().info(
            f"{self.resolve_topic_name(one.command)} ({one.command_type}, its {one.command_mode.partition('_')[0]}) is "
            f"repeated for {timeout_s:g} s; after {timeout_s + BRIDGE.command_stale_ns / S:g} s without another one "
            f"torque is zero, after {timeout_s + BRIDGE.command_lost_ns / S:g} s the car is braked to rest"
        )

    def _connect(self) -> None:
        """Connect what the interface has: commands, flags, services, and what the stack is told."""
        one, door = self._interface, self._door
        # A best-effort subscription receives it, whatever the stack promises.
        commands = ros_type(f"ackermann_msgs/{one.command_type}")
        door.subscription(commands, one.command, self._on_command, qos=SENSOR, refused=self._input.refused)
        if one.driving:
            self._listen(one.driving, self._on_driving)
        for way, on_flag, on_request in (
            (one.finish, self._on_finish, partial(self._on_request, self._on_finish)),
            (one.brake, self._on_brake, partial(self._on_request, self._on_brake)),
            (one.emergency, self._on_emergency, partial(self._ask, self._asked["emergency_brake"])),
        ):
            kind, _, name = way.partition(":")
            if kind == TOPIC:
                self._listen(name, on_flag)
            elif kind == SERVICE:
                door.service(Trigger, name, on_request)
        if one.reset:
            door.service(Trigger, one.reset, partial(self._ask, self._asked["reset"]))
        self._outputs = []
        for name, kind in one.outputs.items():
            if kind in ANSWERS:
                type_name, why_not = ANSWERS[kind]
                door.service(ros_type(type_name, "srv"), name, partial(self._answer, why_not))
            else:
                output = OUTPUTS[kind]
                made = ros_type(output.kind)
                self._outputs.append((output, made, self.create_publisher(made, name, 1)))

    def _listen(self, topic: str, on_flag: Callable[[bool], None]) -> None:
        """Listen to a flag, reliably, for it may be said only once; a publisher that promises less is heard too."""
        for qos in (ONCE, SENSOR):
            self._door.subscription(Bool, topic, lambda message: on_flag(message.data), qos=qos)

    def _forget(self) -> None:
        self._drive: Any = None  # the newest command
        self._drive_ns, self._stamp = 0, None  # when it came, and what it is stamped with
        self._flag = self._finished = self._braking = False
        self._commanded = False  # the stack has commanded since the car may move
        if self._emergency == self._told:  # else the bridge still has to hear of it
            self._emergency = self._told = False
        self._input.forget()

    # ------------------------------------------------------------ from the bridge to the stack

    def _on_run(self, message: RunState) -> None:
        if message.run_id != self._run.run_id:
            self._state = None
            self._forget()
        self._run = message

    def _on_state(self, state: VehicleState) -> None:
        if state.run_id != self._run.run_id:
            return
        self._state = state
        if state.as_state != AsState.AS_DRIVING:
            self._flag = False  # it counts in AS_DRIVING only
        self._tell(state)

    def _on_cones(self, message: ConeArray) -> None:
        self._tell(message)

    def _tell(self, message: Any) -> None:
        for output, made, to in self._outputs:
            if isinstance(message, output.of):
                to.publish(output.make(made, message, self._drives()))

    # ------------------------------------------------------------ from the stack to the bridge

    def _on_command(self, message: Any) -> None:
        stamped = hasattr(message, "drive")
        self._drive, self._stamp = (message.drive, message.header.stamp) if stamped else (message, None)
        self._drive_ns = self._clocks.now_ns()
        self._input.received(self._drive_ns)
        if self._drives() and self._run.may_move:
            self._commanded = True
            if self._interface.command_mode == "speed_or_finish" and self._drive.speed < 0.0:
                self._finished = True

    def _on_driving(self, flag: bool) -> None:
        self._flag = flag and self._state is not None and self._state.as_state == AsState.AS_DRIVING

    def _on_finish(self, flag: bool) -> None:
        # It cannot be taken back; before the car may move it is the last run's.
        self._finished = self._finished or (flag and self._run.may_move)

    def _on_brake(self, flag: bool) -> None:
        self._braking = flag

    def _on_emergency(self, flag: bool) -> None:
        if flag != self._emergency:
            self._emergency, self._ask_ns = flag, 0
            self._pass_emergency()

    def _drives(self) -> bool:
        if self._interface.driving:
            return self._flag
        return self._state is not None and self._state.as_state == AsState.AS_DRIVING

    def _tick(self) -> None:
        """Send the due command: the stack's newest while it drives, else at rest; none once that one is too old."""
        self._pass_emergency()
        state = self._state
        if state is None:
            return
        self._confirm()
        command = VehicleCommand(run_id=self._run.run_id, estop_request=self._emergency)
        command.header.stamp, command.header.frame_id = state.header.stamp, BASE_FRAME
        if self._run.may_move:
            command.speed_limit_mps = self._settings.number("max_speed")
            now_ns = self._clocks.now_ns()
            command.mission_finished = self._finished
            if self._finished or not self._drives():
                command.brake = HOLDING_BRAKE
            elif not self._commanded:
                command.brake, command.note = HOLDING_BRAKE, self._input.silence(now_ns)
            elif self._input.watch(now_ns):
                return  # the bridge takes silence for what it is
            else:
                self._fill(command, state)
        self._command.publish(command)

    def _confirm(self) -> None:
        """Confirm for planner and controller both, once a stack is there: teams have no word for it but AS_OFF."""
        if self._confirmed != self._run.run_id and self.count_publishers(self._interface.command):
            self._confirmed = self._run.run_id
            for role in (ResetConfirmation.PLANNER, ResetConfirmation.CONTROLLER):
                self._confirmation.publish(ResetConfirmation(role=role, run_id=self._run.run_id))

    def _fill(self, command: VehicleCommand, state: VehicleState) -> None:
        """Fill the command in from the stack's Ackermann command, within the car's limits."""
        drive, limit = self._drive, self._car.steer_max_rad
        # Many stacks leave the stamp empty: then the command is as old as its arrival.
        unset = self._stamp is None or not nanoseconds(self._stamp)
        command.header.stamp = self._clocks.stamp_of(self._drive_ns) if unset else self._stamp
        command.steering_rad = min(max(drive.steering_angle, -limit), limit)  # teams' CAN nodes cut it off as well
        acceleration_mps2 = drive.acceleration
        if self._interface.command_mode != "acceleration":
            acceleration_mps2 = SPEED_GAIN_1PS * (drive.speed - state.speed_mps)
        if self._braking:
            command.brake = ASKED_BRAKE
        elif acceleration_mps2 < -COASTING_MPS2:
            command.brake = brake_for(self._car, -acceleration_mps2, state.speed_mps)
        elif acceleration_mps2 > 0.0 and state.speed_mps < command.speed_limit_mps:
            command.throttle = throttle_for(self._car, acceleration_mps2, state.speed_mps)

    # ------------------------------------------------------------ services, and the emergency as a topic

    async def _ask(self, client: Client, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Ask the bridge and return its answer."""
        if not client.service_is_ready():
            response.message = f"no bridge offers {client.srv_name}"
            return response
        return await client.call_async(Trigger.Request())

    def _on_request(
        self, on_flag: Callable[[bool], None], _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Take a request as a flag that is set, and stays so in this run."""
        response.success = self._run.may_move
        if response.success:
            on_flag(True)
        else:
            response.message = "the car may not move now"
        return response

    def _answer(self, why_not: Callable[[Any, VehicleState | None], str], request: Any, response: Any) -> Any:
        response.message = why_not(request, self._state)
        response.success = not response.message
        return response

    def _pass_emergency(self) -> None:
        """Tell the bridge what the emergency's topic says: brake, or, released, reset; once a second until it does."""
        if self._emergency == self._told:
            return
        client = self._asked["emergency_brake" if self._emergency else "reset"]
        now_ns = self._clocks.now_ns()
        if now_ns < self._ask_ns or not client.service_is_ready():
            return
        self._ask_ns = now_ns + S
        client.call_async(Trigger.Request()).add_done_callback(partial(self._on_passed, self._emergency))

    def _on_passed(self, emergency: bool, future: Future) -> None:
        answer = future.result()
        if answer.success:
            self._told = emergency
        else:
            words = f"{'the emergency brake' if emergency else 'its release'} is refused: {answer.message}"
            complaints_of(self).say("emergency", words)


main = partial(run, [AckermannAdapter], "ackermann_adapter")


if __name__ == "__main__":
    raise SystemExit(main())
