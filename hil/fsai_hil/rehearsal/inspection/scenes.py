"""The scenes of a rehearsal: what people and faults do at the car, as scripts of the simulator's operator. Pure.

Each scene begins with a car that is off and ends with one; the program runs on. A script that waits in vain says so to
the stage, and goes on to switching off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple, Protocol

from fsai_hil.rehearsal.inspection.items import SILENCES
from fsai_hil.simulator.operator import ENDED, FINISHED_NS, READY, READY_FOR_GO, Await, Script, power_down, power_on
from fsai_hil.simulator.power import PowerUp
from fsai_hil.simulator.switches import Assi, Switches
from fsai_hil.simulator.vcu import SimulatedVcu
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import MS, S

ALIVE_S: Final = 20.0  # from power-up until the display offers the missions; a stack of ROS nodes needs its time
STARTS_S: Final = 60.0  # until the first frame of a program that has just been started
READY_S: Final = 12.0  # from the choice of a mission to AS_READY: planners are reset
GO_S: Final = 1.5
DRIVES_S: Final = 95.0  # the longest that a mission without a track may take
TURNS_S: Final = 30.0
PATTERN_NS: Final = 3 * S
MEASURE_NS: Final = 3 * S
LOADED_NS: Final = 5 * S
NO_MISSION_NS: Final = 1500 * MS
LOOK_NS: Final = 1500 * MS
SILENT_NS: Final = 1500 * MS
SILENT_STEERING_NS: Final = 16 * S  # until what comes after the sweep has begun
END_S: Final = 5.0
_OFF: Final = ("asms", "tsms", "lvms")
# In which frames of 0x520 the bit has changed: runs of 1 to 4, so that an echo a frame late and an inverse differ.
PATTERN: Final = (1, 0, 0, 1, 0, 1, 1, 0, 0, 0, 1, 1, 1, 1, 0, 1, 0, 0, 1, 1)


class Stage(Protocol):
    """The stage of a script: it offers what can be done besides the switches, and be seen besides the car."""

    power_up: PowerUp

    def pattern(self, on: bool) -> None:
        """The HANDSHAKE bit of 0x520 follows PATTERN and waits for no echo; set while the car is off."""

    def measure(self, *, loaded: bool) -> None:
        """A measurement of response times begins here; the computer is kept busy meanwhile."""

    def measured(self) -> None:
        """It ends here."""

    def silence(self, can_id: int | None) -> None:
        """The car does not send that message; None: it sends all."""

    def stuck(self, why: str, *, for_all: bool = False) -> None:
        """The scene does not get on. for_all: no other would."""

    def show(self, slug: str, fact: str = "") -> None:
        """An item can be seen here."""

    def wrong(self, slug: str, words: str) -> None:
        """Note what an item does not allow."""

    def end_program(self) -> None:
        """The program is asked to end."""

    @property
    def heard(self) -> bool:
        """A frame of the program has come."""

    @property
    def asks_torque(self) -> bool: ...

    @property
    def steers(self) -> bool: ...

    @property
    def program_is_gone(self) -> bool: ...

    def why_not_ready(self) -> str:
        """Say what the VCU waits for between the choice of a mission and AS_READY."""

    def why_not_driving(self) -> str:
        """Say what keeps it from AS_DRIVING after Go."""


class InspectionScene(NamedTuple):
    """One scene; `mission` is what its drive is judged as, where it is."""

    words: str
    script: Callable[[Stage], Script]
    mission: str = ""


# ---------------------------------------------------------------- parts of scripts


def _do(work: Callable[[], object]) -> Callable[[Switches, bool], Script]:
    def done(switches: Switches, seen: bool) -> Script:
        work()
        return ()

    return done


def _reach(
    what: str,
    seen: Callable[[SimulatedVcu], bool],
    patience_s: float,
    then: Callable[[], Script],
    otherwise: Callable[[], object],
    delay_ns: int = 0,
) -> Script:
    """Wait for it; `then` goes on, unless it does not come: `otherwise`, and whatever follows in the script."""

    def on(switches: Switches, came: bool) -> Script:
        if came:
            return then()
        otherwise()
        return ()

    return Await(what, seen, delay_ns, int(patience_s * S)), on


def _off() -> Script:
    return ("go", False), ("remote_estop", False), *power_down(_OFF)


def _alive(stage: Stage, then: Callable[[], Script]) -> Script:
    """Power on, until the display offers the missions."""

    def not_alive() -> None:
        why = "the car did not leave power-up: its VCU did not get all five messages with matching echoes"
        stage.stuck(why if stage.heard else "no frame of the program was received", for_all=True)

    return (
        *power_on(stage.power_up),
        *_reach(
            "waiting until the car is alive",
            lambda car: car.mission_selectable,
            ALIVE_S,
            then,
            not_alive,
        ),
    )


def _ready(stage: Stage, mission: Ami, then: Callable[[], Script]) -> Script:
    """The mission is chosen, and AS_READY reached."""

    def not_ready() -> None:
        why = f"never AS_READY: {stage.why_not_ready()}"
        stage.wrong("selected", f"{mission.label} was on the AMI for {READY_S:g} s and the car stayed in AS_OFF: {why}")
        stage.stuck(why)

    return (
        Await("choosing the mission"),
        ("ami", mission),
        *_reach("waiting for AS_READY", lambda car: car.assi in READY, READY_S, then, not_ready),
    )


def _drive(stage: Stage, mission: Ami, then: Callable[[], Script]) -> Script:
    """The mission is chosen in AS_OFF, Go is given after 5 s of AS_READY, and AS_DRIVING reached."""

    def not_driving() -> None:
        why = f"never AS_DRIVING after Go: {stage.why_not_driving()}"
        stage.show("ready")
        stage.wrong("ready", why)
        stage.stuck(why)

    def left_ready() -> None:
        stage.show("ready")
        stage.wrong("ready", "the car did not stay in AS_READY for 5 s")
        stage.stuck("the car did not stay in AS_READY for 5 s")

    def driving() -> Script:
        stage.show("ready", "5 s in AS_READY, then Go: AS_DRIVING")
        return then()

    def go() -> Script:
        return (
            ("go", True),
            *_reach("giving Go", lambda car: car.state is AsState.AS_DRIVING, GO_S, driving, not_driving),
        )

    wait = _reach("5 s of AS_READY", lambda car: car.assi in READY_FOR_GO, 8.0, go, left_ready, 500 * MS)
    return _ready(stage, mission, lambda: wait)


def _to_the_end(stage: Stage) -> Script:
    """The mission is over, and the car is watched at standstill for 3 s."""
    return _reach(
        "waiting for the end of the mission",
        lambda car: car.assi in ENDED,
        DRIVES_S,
        lambda: (Await("waiting 3 s at standstill", delay_ns=FINISHED_NS),),
        lambda: stage.stuck(f"still AS_DRIVING after {DRIVES_S:g} s"),
    )


# ---------------------------------------------------------------- the scenes


def _handshake(stage: Stage) -> Script:
    """Switch the car on, and let its handshake change in a pattern while the program answers."""
    pause = Await("letting the handshake change in a pattern", delay_ns=PATTERN_NS)

    def heard() -> Script:
        stage.show("handshake")
        return (pause,)

    return (
        _do(lambda: stage.pattern(True)),
        *power_on(stage.power_up),
        *_reach(
            "waiting for the program's first frame",
            lambda car: stage.heard,
            STARTS_S,
            heard,
            lambda: stage.stuck("no frame of the program was received", for_all=True),
        ),
        *_off(),
        _do(lambda: stage.pattern(False)),
    )


def _bus(stage: Stage) -> Script:
    def alive() -> Script:
        stage.show("selected")
        return (
            _do(lambda: stage.measure(loaded=False)),
            Await("measuring the response time", delay_ns=MEASURE_NS),
            _do(stage.measured),
            _do(lambda: stage.measure(loaded=True)),
            Await("measuring the response time with busy processors", delay_ns=LOADED_NS),
            _do(stage.measured),
        )

    return *_alive(stage, alive), *_off()


def _static_a(stage: Stage) -> Script:
    """Static inspection A is driven after another mission was chosen and taken back."""

    def chosen() -> Script:
        return (
            Await("ASMS off: the mission is taken back", delay_ns=S),
            ("asms", False),
            Await("looking at AS_OFF"),
            ("ami", Ami.NOT_SELECTED),
            Await("looking what the program says without a mission", delay_ns=NO_MISSION_NS),
            _do(lambda: stage.show("ami")),
            ("asms", True),
            *_drive(stage, Ami.STATIC_INSPECTION_A, lambda: _to_the_end(stage)),
        )

    return *_alive(stage, lambda: _ready(stage, Ami.AUTONOMOUS_DEMO, chosen)), *_off()


def _mission(mission: Ami) -> Callable[[Stage], Script]:
    return lambda stage: (
        *_alive(stage, lambda: _drive(stage, mission, lambda: _to_the_end(stage))),
        *_off(),
    )


def _estop(stage: Stage) -> Script:
    def torque() -> Script:
        return (
            Await("a moment of torque", delay_ns=200 * MS),
            ("remote_estop", True),
            Await("the remote's E-stop", lambda car: car.assi is Assi.BLUE_FLASHING, LOOK_NS),
            _do(lambda: stage.show("estop", "no torque in EMERGENCY_BRAKE")),
        )

    return (
        *_alive(stage, lambda: _drive(stage, Ami.STATIC_INSPECTION_A, lambda: _asking(stage, torque))),
        *_off(),
    )


def _asking(stage: Stage, then: Callable[[], Script]) -> Script:
    return _reach(
        "waiting until the program asks for torque",
        lambda car: stage.asks_torque,
        TURNS_S,
        then,
        lambda: stage.stuck("the program asked for no torque"),
    )


def _silent(can_id: int) -> Callable[[Stage], Script]:
    """The autonomous demo asks for torque for two seconds; steering is lost while inspection A sweeps it."""
    steering = can_id == 0x523

    def script(stage: Stage) -> Script:
        """Drive, and let the message be missing for so long that the program must react."""

        def silent() -> Script:
            return (
                _do(lambda: stage.silence(can_id)),
                Await(f"0x{can_id:03X} is silent", delay_ns=SILENT_STEERING_NS if steering else SILENT_NS),
                _do(lambda: stage.silence(None)),
            )

        def begun() -> Script:
            if not steering:
                return _asking(stage, silent)
            return _reach(
                "waiting until the program steers",
                lambda car: stage.steers,
                TURNS_S,
                silent,
                lambda: stage.stuck("the program did not steer"),
            )

        mission = Ami.STATIC_INSPECTION_A if steering else Ami.AUTONOMOUS_DEMO
        return *_alive(stage, lambda: _drive(stage, mission, begun)), *_off()

    return script


def _end(stage: Stage) -> Script:
    return (
        *power_on(stage.power_up),
        Await("looking at the car for a moment", delay_ns=S),
        _do(stage.end_program),
        Await(
            "waiting until the program has ended", lambda car: stage.program_is_gone, 300 * MS, int((END_S + 2.0) * S)
        ),
        *_off(),
    )


SCENES: Final[Mapping[str, InspectionScene]] = {
    "handshake": InspectionScene("the car's HANDSHAKE changes in a pattern", _handshake),
    "bus": InspectionScene("the car is on and no mission chosen; then every processor is busy", _bus),
    "static-a": InspectionScene(
        "autonomous demo chosen and taken back, then static inspection A", _static_a, "static-a"
    ),
    "static-b": InspectionScene("static inspection B", _mission(Ami.STATIC_INSPECTION_B), "static-b"),
    "demo": InspectionScene("power cycle, then the autonomous demo", _mission(Ami.AUTONOMOUS_DEMO), "demo"),
    "estop": InspectionScene("static inspection A, and the remote's E-stop while wheels turn", _estop),
    **{
        f"silence-{can_id:x}": InspectionScene(f"0x{can_id:03X} ({what}) falls silent in AS_DRIVING", _silent(can_id))
        for can_id, (what, _) in SILENCES.items()
    },
    "end": InspectionScene("the program is asked to end", _end),
}
