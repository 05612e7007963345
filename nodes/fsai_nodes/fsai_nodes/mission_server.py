"""The action /run_mission of the bridge: goals that follow a run, each with its feedback and its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fsai_msgs.action import RunMission
from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from fsai_nodes.clocks import Clocks
from fsai_nodes.conversions import UNKNOWN
from fsai_nodes.door import Door
from fsai_nodes.mission_goal import GoalResult, Waiting
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.interface.enums import Ami

_FEEDBACK_PERIOD_NS = 200_000_000


@dataclass(slots=True, eq=False)
class _Following:
    """A goal on its way."""

    handle: ServerGoalHandle
    waiting: Waiting
    feedback_due_ns: int = 0
    outcome: GoalResult | None = None
    report: BridgeReport | None = None
    ended_ns: int = 0


class MissionServer:
    """Follower of all goals of /run_mission: the bridge's publishing timer advances them, and each has one result."""

    def __init__(self, door: Door, clocks: Clocks, *, refuses: Callable[[], bool], stop: Callable[[], bool]) -> None:
        """Offer the action.

        refuses: True, and said, where no goal can be followed. stop: sets the mode to manual; False where that is not
        done.
        """
        self._clocks = clocks
        self._refuses, self._stop = refuses, stop
        self.goals: dict[bytes, _Following] = {}  # by goal id
        self.action = door.action(
            RunMission,
            "run_mission",
            goal=self._on_goal,
            accepted=self._follow,
            cancel=self._on_cancel,
            execute=self._result_of,
            under_way=lambda: len(self.goals),
        )

    def destroy(self) -> None:
        """Destroy the action server, which rclpy leaves in the ROS graph when it destroys the node."""
        self.action.destroy()

    def step(self, report: BridgeReport, now_ns: int, ending: GoalResult | None = None, *, gone: bool = False) -> None:
        """Advance all goals. gone: a drive that was cancelled is over, whatever the car said last."""
        for following in list(self.goals.values()):
            handle = following.handle
            if following.outcome is not None:
                continue  # its result is being handed over
            cancelled = handle.is_cancel_requested
            as_state = None if cancelled and gone else report.run.as_state
            outcome = ending or following.waiting.step(as_state, _mission_shown(report), now_ns, cancelled=cancelled)
            if outcome is not None:
                following.outcome, following.report, following.ended_ns = outcome, report, now_ns
                handle.execute()
            elif now_ns >= following.feedback_due_ns:
                following.feedback_due_ns = now_ns + _FEEDBACK_PERIOD_NS
                handle.publish_feedback(_feedback(report))

    def _on_goal(self, _request: RunMission.Goal) -> GoalResponse:
        """Follows a run: wait until ready, driving, finished, emergency, off or end; cancelling it is `manual` for the
        car, and its result comes when the car no longer drives.
        """
        return GoalResponse.REJECT if self._refuses() else GoalResponse.ACCEPT

    def _follow(self, handle: ServerGoalHandle) -> None:
        goal = handle.request
        waiting = Waiting(goal.mission, goal.until, goal.timeout_s, self._clocks.now_ns())
        self.goals[bytes(handle.goal_id.uuid)] = _Following(handle, waiting)

    def _on_cancel(self, _handle: ServerGoalHandle) -> CancelResponse:
        """Set the mode to manual: a client that cancels wants the car to stop, or not to start. Rejected where that is
        not done.
        """
        return CancelResponse.ACCEPT if self._stop() else CancelResponse.REJECT

    def _result_of(self, handle: ServerGoalHandle) -> RunMission.Result:
        """End a goal, and return its result."""
        following = self.goals.pop(bytes(handle.goal_id.uuid))
        outcome, report = following.outcome, following.report
        assert outcome is not None and report is not None, "executed only when there is an outcome"
        if outcome.success:
            handle.succeed()
        elif outcome.ended == "cancelled":
            handle.canceled()
        else:
            handle.abort()
        status = report.vehicle.status
        cause = None if status is None else status.shutdown_cause
        return RunMission.Result(
            success=outcome.success,
            ended=outcome.ended,
            message=outcome.message,
            as_state=_label(report),
            shutdown_cause="" if cause is None else cause.label,
            laps=report.command.lap_counter,
            distance_m=float(report.motion.distance_m),
            duration_s=following.waiting.duration_s(following.ended_ns),
        )


def _mission_shown(report: BridgeReport) -> Ami:
    """The mission on the car's display; what the run has latched while nothing is received."""
    status = report.vehicle.status
    return report.run.mission if status is None else status.ami


def _label(report: BridgeReport) -> str:
    return "UNKNOWN" if report.run.as_state is None else report.run.as_state.label


def _feedback(report: BridgeReport) -> RunMission.Feedback:
    as_state = report.run.as_state
    return RunMission.Feedback(
        as_state=UNKNOWN if as_state is None else int(as_state),
        as_state_label=_label(report),
        mission=_mission_shown(report).label,
        mode=report.mode,
        lap=report.command.lap_counter,
        speed_mps=float(report.motion.speed_mps),
        distance_m=float(report.motion.distance_m),
        why_not_driving=list(report.why_not_driving),
    )
