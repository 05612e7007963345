"""Car, scenes and judge of a rehearsal together, in virtual time. Pure: give it frames and time, pass on what it sends.

It is a `World` whose people follow the scenes one after another. What only a process can do (start and end a program,
keep processors busy) it asks for, and is told when it is done.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from msgspec.structs import replace

from fsai_hil.rehearsal.inspection.items import ITEMS, Item
from fsai_hil.rehearsal.inspection.judge import InspectionJudge, Result
from fsai_hil.rehearsal.inspection.scenes import END_S, PATTERN, SCENES, InspectionScene
from fsai_hil.simulator.faults import Changed, Drop
from fsai_hil.simulator.operator import Operator
from fsai_hil.simulator.power import POWER_UP
from fsai_hil.simulator.profiles import SPECIFICATION
from fsai_hil.simulator.world import World, WorldSetup
from fsai_vcu.interface.enums import Ami, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import STATUS_ID
from fsai_vcu.interface.specification import PERIOD_NS
from fsai_vcu.interface.units import S

NEVER_NS: Final = 1 << 62
STUCK_TWICE: Final = 2  # scenes that did not get to the same: no other will


class RehearsalWorld(World):
    """See the module. `load_wanted`, `end_wanted`: what it asks of the process round it.

    Raises ValueError for an unknown revision or profile.
    """

    def __init__(
        self,
        items: Sequence[Item] = ITEMS,
        *,
        revision: str = "2026",
        profile: str = SPECIFICATION.name,
        pedals_by_frame: bool = True,
        start_ns: int = 0,
        gps: bool = True,
    ) -> None:
        """Begin with a car that is switched off, and with the scenes that these items need."""
        super().__init__(
            WorldSetup(
                missions=[Ami.STATIC_INSPECTION_A],
                revision=revision,
                profile=profile,
                auto=False,
                gps=gps,
                start_ns=start_ns,
            )
        )
        self.vcu.behave(replace(self.vcu.profile, pedals_judged_by_frame=pedals_by_frame))
        self.items = tuple(items)
        self.power_up = POWER_UP[revision]
        self.inspector = InspectionJudge(self.codec, self.vcu.profile, start_ns)
        wanted = {item.scene for item in items}
        self._ahead = [(name, scene) for name, scene in SCENES.items() if name in wanted]
        if "demo" in wanted and any(item.slug == "power-cycle" for item in items) and "static-b" not in wanted:
            self._ahead.insert(0, ("static-b", SCENES["static-b"]))  # an emergency goes before its power cycle
        self.planned = tuple(name for name, _ in self._ahead)
        self.scene = ""
        self._scene: InspectionScene | None = None
        self._over = False
        self._normal = self.vcu.profile
        self._stuck: dict[str, int] = {}
        self._transitions = 0
        self._judged = 0  # verdicts on missions that have been looked at
        self._mark: tuple[int, int, bool] | None = None  # of a measurement: echoes, losses, whether under load
        self.load_wanted = False
        self.load_failed = ""  # told by the process: why there was none
        self.end_wanted_ns: int | None = None

    # ------------------------------------------------------------ what goes in

    def on_frame(self, frame: Frame) -> None:
        """A frame of somebody else than this car has been received, at `frame.t_ns`."""
        self.inspector.on_ai(frame)
        super().on_frame(frame)

    def advance(self, to_ns: int) -> list[Frame]:
        sent = super().advance(to_ns)
        for frame in sent:
            self.inspector.on_car(frame)
        return sent

    def program_ended(self, status: int) -> None:
        """The program has ended, with that exit status."""
        asked_ns = self.end_wanted_ns
        self.inspector.program_ended(status, None if asked_ns is None else (self.now_ns - asked_ns) / S)
        if asked_ns is None:
            self._give_up("the program ended by itself")

    def nobody_to_end(self) -> None:
        """The program was started by somebody else, and is left to him."""
        self.inspector.ended_ns = NEVER_NS
        self.inspector.why_not["end"] = "the program was started by somebody else"

    def program_was_killed(self) -> None:
        self.inspector.program_would_not_end()

    # ------------------------------------------------------------ scene by scene

    @property
    def done(self) -> bool:
        return self._over

    def results(self) -> list[Result]:
        """Return the result of each item, in the order of the table; once, at the end."""
        return self.inspector.results(self.items)

    def _look(self, now: int) -> None:
        super()._look(now)
        vcu = self.vcu
        for transition in vcu.transitions[self._transitions :]:
            self.inspector.on_transition(transition, vcu.shutdown_cause)
        self._transitions = len(vcu.transitions)
        if not vcu.powered and self.inspector.state is not None:
            self.inspector.car_is_off(now)
        if self.operator.done and not self._over:
            self._end_scene()
            self._begin_scene(now)

    def _end_scene(self) -> None:
        """End the scene, and hand its mission's verdict to the judge of the items."""
        scene, self._scene = self._scene, None
        if scene is None:
            return
        verdicts, self._judged = self.verdicts[self._judged :], len(self.verdicts)
        if scene.mission and verdicts:
            verdict = verdicts[-1]
            self.inspector.mission(scene.mission, verdict)
            if scene.mission == "static-a" and any("AI_COMPUTER_REQUEST" in why for why in verdict.reasons):
                words = "static inspection A was on the AMI at Go, and the drive ended as that of the mission before it"
                self.inspector.wrong("ami", words)
            if self.scene == "demo":
                self.inspector.show("power-cycle", "AS_READY and AS_DRIVING again, without a restart of the program")
        elif self.scene == "demo" and self.scene in self.inspector.why_not and "static-b" in self.planned:
            self.inspector.wrong("power-cycle", self.inspector.why_not[self.scene])

    def _begin_scene(self, now: int) -> None:
        if not self._ahead:
            self._over = True
            return
        self.scene, self._scene = self._ahead.pop(0)
        self.inspector.begin(self.scene, now)
        self.operator = Operator(self._scene.script(self))

    def _give_up(self, why: str, *, but_the_end: bool = False) -> None:
        for name, _ in self._ahead:
            if not (but_the_end and name == "end"):
                self.inspector.why_not.setdefault(name, why)
        self._ahead = [each for each in self._ahead if but_the_end and each[0] == "end"]

    # ------------------------------------------------------------ the stage of the scripts

    def pattern(self, on: bool) -> None:
        self.vcu.outgoing.faults = []
        if not on:
            self.vcu.behave(self._normal)
            return
        # The VCU waits for nothing, and what it says is changed on its way out.
        self.vcu.behave(replace(self._normal, handshake_waits_for_echo=False, echo_timeout_ns=None))

        def changed(frame: Frame) -> Frame:
            bit = PATTERN[frame.t_ns // PERIOD_NS % len(PATTERN)]
            return replace(frame, data=bytes((frame.data[0] & 0xFE | bit, *frame.data[1:])))

        self.vcu.outgoing.faults = [Changed(frozenset({STATUS_ID}), changed)]

    def measure(self, *, loaded: bool) -> None:
        self.load_wanted = self.inspector.loaded = loaded
        self._mark = len(self.vcu.response_times_ns), self.vcu.comms_losses, loaded

    def measured(self) -> None:
        assert self._mark is not None
        echoes, losses, loaded = self._mark
        self.load_wanted = self.inspector.loaded = False
        if loaded and self.load_failed:
            self.inspector.why_not[self.scene] = self.load_failed
            return
        times_ns = self.vcu.response_times_ns[echoes:]
        self.inspector.responses(times_ns, self.vcu.comms_losses - losses, loaded=loaded)

    def silence(self, can_id: int | None) -> None:
        self.vcu.outgoing.faults = []
        if can_id is not None:
            self.vcu.outgoing.faults = [Drop(frozenset({can_id}))]
            self.inspector.silence(can_id, self.now_ns)

    def stuck(self, why: str, *, for_all: bool = False) -> None:
        self.inspector.stuck(why)
        self._stuck[why] = self._stuck.get(why, 0) + 1
        if for_all or self._stuck[why] >= STUCK_TWICE:
            self._give_up(why, but_the_end=True)

    def show(self, slug: str, fact: str = "") -> None:
        self.inspector.show(slug, fact)

    def wrong(self, slug: str, words: str) -> None:
        self.inspector.wrong(slug, words)

    def end_program(self) -> None:
        self.end_wanted_ns = self.now_ns

    @property
    def overdue(self) -> bool:
        """The program was asked to end and has had its time."""
        return self.end_wanted_ns is not None and self.now_ns - self.end_wanted_ns > END_S * S

    @property
    def heard(self) -> bool:
        return bool(self.inspector.frames)

    @property
    def asks_torque(self) -> bool:
        return self.inspector.asks_torque

    @property
    def steers(self) -> bool:
        return self.inspector.steers

    @property
    def program_is_gone(self) -> bool:
        return self.inspector.ended_ns is not None

    def why_not_ready(self) -> str:
        if self.vcu.comms_lost:
            return "AI_COMMS_LOST"
        said = self.inspector.status.mission_status
        if said is not MissionStatus.SELECTED:
            return f"MISSION_STATUS was {said.label}"
        return "the VCU was not ready itself"

    def why_not_driving(self) -> str:
        """Name what kept the car from AS_DRIVING after Go."""
        if self.vcu.comms_lost:
            return "AI_COMMS_LOST"
        ai = self.inspector.status
        wrong = [
            words
            for words, there in (
                ("axle torque was requested", self.asks_torque),
                ("steering was requested", self.steers_before_go),
                (f"DIRECTION_REQUEST was {ai.direction.label}", ai.direction is not Direction.NEUTRAL),
                (f"the car was in {self.vcu.state.label}", self.vcu.state.label != "AS_READY"),
            )
            if there
        ]
        return ", ".join(wrong) or "the VCU does not say why"

    @property
    def steers_before_go(self) -> bool:
        return self.inspector.steer_deg != 0.0
