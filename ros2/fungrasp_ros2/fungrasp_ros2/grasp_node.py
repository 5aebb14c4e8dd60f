"""The node that grasps: an action ``grasp``, services ``stop`` and ``release``, joint states and diagnostics.

    ros2 run fungrasp_ros2 grasp_node --ros-args -p cell:=lab.toml

What the command ``fungrasp deploy`` does is done here, in the thread of the action. The node's services are
answered meanwhile.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.deployment.deploy import deploy_on_robot, deployment_task
from fungrasp.deployment.deployment_result import DeploymentResult
from fungrasp.deployment.hold_after_stop import ONE_PRESS, HoldWatch, endings_as_interrupts
from fungrasp.deployment.log import McapLog
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.spec import LAST_PHASES, DeploymentSpec, GraspChoice, Phase
from fungrasp.hands import load_hand
from fungrasp.hands.arm import arm_spec
from fungrasp.robots.assembly import is_twin
from fungrasp.robots.cell import RobotCell, check_calibrated, load_cell
from fungrasp.robots.device import JointState, RobotCommand, RobotState
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp_ros2.conversions import diagnostic_fields, fill, joint_state_fields
from fungrasp_ros2.ros_side import ros_module

PUBLISHING = 0.1
"""Between two messages of diagnostics [s]."""


@dataclass(frozen=True)
class GraspRequest:
    """The goal of the action."""

    choice: GraspChoice
    """Which grasp."""
    until: str = "home"
    """Where to end, as ``DeploymentSpec.until``."""
    speed: float = 1.0
    """Share of the cell's speed."""


class GraspJob(DeploymentObserver):
    """One grasp at a time, and what may stop or release it. Needs no ROS."""

    def __init__(
        self,
        cell: RobotCell,
        name: str,
        policy: str = "plan",
        logs: Path = Path(),
        deploy: Callable[..., DeploymentResult] = deploy_on_robot,
    ):
        """
        Args:
            cell: the robot; no twin.
            name: of the cell or its file.
            policy: what moves the hand.
            logs: folder of the logs.
            deploy: deploys one grasp.

        Raises:
            FungraspError: the cell is a twin, or not calibrated.
        """
        if is_twin(cell):
            raise FungraspError(f"cell '{cell.name}' is a twin: it has no devices to talk to")
        check_calibrated(cell)
        self.cell, self.hand = cell, load_hand(cell.hand)
        self._name, self._policy, self._logs, self._deploy = name, policy, logs, deploy
        self._busy, self._released, self._left = threading.Lock(), threading.Event(), threading.Event()
        self._switch: StopSwitch | None = None
        self._told: Callable[[str], None] = lambda phase: None
        self.now, self.wrong, self.holding = "", "", False
        """The phase, what was wrong, whether the hand holds after a run."""
        self.states: dict[str, JointState] = {}
        """Of arm and hand, the newest; empty before the first setpoint."""

    def stop(self) -> tuple[bool, str]:
        """Stop what moves. Returns: whether something was running, and words."""
        if self._switch is None:
            return False, "nothing is running"
        self._switch.press("the service 'stop' was called")
        return True, "stopping; what is held stays held until 'release'"

    def release(self) -> tuple[bool, str]:
        """Open a hand that holds after a stop or at the end. Returns: whether it did hold, and words."""
        if not self.holding:
            return False, "the hand does not hold after a run"
        self._released.set()
        return True, "opening"

    def leave(self) -> None:
        """Stop, and hold no longer: what the hand does then is the driver's ``lets_go``."""
        self._left.set()
        self.stop()

    @property
    def running(self) -> bool:
        """Whether a grasp or its hold goes on."""
        return self._busy.locked()

    def run(self, request: GraspRequest, on_phase: Callable[[str], None]) -> tuple[bool, str, str]:
        """Grasp.

        Args:
            request: what.
            on_phase: called as a phase begins.

        Returns:
            whether it was done, how it went in words, and the log.
        """
        if not self._busy.acquire(blocking=False):
            return False, "another grasp is running", ""
        path = self._logs / time.strftime("grasp-%Y%m%d-%H%M%S.mcap")
        self.now, self.wrong, self.holding, self.states = "", "", False, {}
        self._released.clear()
        self._told = on_phase
        try:
            result = self._deployed(request, path)
        except FungraspError as error:
            self.wrong = str(error)
            return False, str(error), ""
        finally:
            self._switch = None
            self._busy.release()
        self.wrong = result.fault
        return not result.fault, result.words(), str(path)

    def _deployed(self, request: GraspRequest, path: Path) -> DeploymentResult:
        if request.until not in LAST_PHASES:
            raise UnknownNameError("end of a grasp", request.until, LAST_PHASES)
        if not 0 < request.speed <= 1:
            raise FungraspError(f"the speed is a share above 0 and at most 1, not {request.speed:g}")
        grasp, objects = request.choice.robot(self.hand)
        spec = DeploymentSpec(
            self._name,
            self._policy,
            until=request.until,  # pyright: ignore[reportArgumentType]
            speed=request.speed,
            threads=request.choice.threads,
            real_time=True,
        )
        task = deployment_task(grasp, objects, spec)
        about = {"version": __version__, "robot": self._name, "policy": self._policy}
        about["grasp"] = request.choice.words
        with McapLog(path, about) as log, StopSwitch(self.cell.stop_file) as switch:
            self._switch = switch
            return self._deploy(task, (log, self), switch)

    def phase(self, time: float, phase: Phase) -> None:
        self.now = phase.value
        self._told(phase.value)

    def fault(self, time: float, reason: str) -> None:
        self.phase(time, Phase.FAULT)

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        self.states = {"arm": state.arm, "hand": state.hand}

    def hold(self, robot: Robot) -> bool:
        """Hold, watched, until ``release``, and until the hand has opened, or until ``leave``.

        Args:
            robot: connected and stopped.
        """
        watch = HoldWatch(robot, self._say)
        self.holding = True
        while not self._left.is_set():
            watch.look()
            if self._released.is_set():
                self._released.clear()
                if watch.open():
                    break
        self.holding = False
        return True

    def _say(self, words: str) -> None:
        """What arm and hand do while they hold, for feedback and diagnostics."""
        self.wrong = words
        self._told(words)


class GraspNode:
    """The node around a ``GraspJob``."""

    def __init__(self, node: Any, job: GraspJob, action: Any = None):
        """
        Args:
            node: of rclpy.
            job: what it does.
            action: class of an action server; that of rclpy if None.
        """
        self._node, self._job = node, job
        groups = ros_module("rclpy.callback_groups")
        sensor, diagnostic, services = (
            ros_module(f"{package}") for package in ("sensor_msgs.msg", "diagnostic_msgs.msg", "std_srvs.srv")
        )
        self._joint_state, self._diagnostics = sensor.JointState, diagnostic.DiagnosticArray
        self._kinds = {"status": diagnostic.DiagnosticStatus, "values": diagnostic.KeyValue}
        # A grasp takes a minute: the others are answered meanwhile.
        group = groups.ReentrantCallbackGroup()
        model = arm_spec(job.cell.arm.model).compile()
        self._names = {
            "arm": [model.joint(i).name for i in range(model.njnt)],
            "hand": list(job.hand.actuators),
        }
        self._joints = node.create_publisher(sensor.JointState, "~/joint_states", 10)
        self._diagnostic = node.create_publisher(diagnostic.DiagnosticArray, "/diagnostics", 10)
        trigger = services.Trigger
        node.create_service(trigger, "~/stop", self._answer(job.stop), callback_group=group)
        node.create_service(trigger, "~/release", self._answer(job.release), callback_group=group)
        node.create_timer(PUBLISHING, self.publish, callback_group=group)
        kind = ros_module("fungrasp_msgs.action").Grasp
        actions = ros_module("rclpy.action")
        server = action or actions.ActionServer
        self._accept = actions.CancelResponse.ACCEPT
        self._result, self._feedback = kind.Result, kind.Feedback
        self._server = server(
            node, kind, "~/grasp", self.execute, callback_group=group, cancel_callback=self.cancel
        )

    def cancel(self, goal: Any) -> Any:
        """Canceling stops the arm as the service does; the action ends when the hold does."""
        self._job.stop()
        return self._accept

    def execute(self, goal: Any) -> Any:
        """The action. goal: its handle."""
        asked = goal.request
        choice = GraspChoice(
            asked.grasp or "wine_glass",
            asked.grasps or "builtin",
            Path(asked.objects) if asked.objects else None,
        )
        request = GraspRequest(choice, asked.until or "home", asked.speed or 1.0)
        done, words, log = self._job.run(
            request, lambda phase: goal.publish_feedback(fill(self._feedback(), {"phase": phase}))
        )
        (goal.canceled if goal.is_cancel_requested else goal.succeed if done else goal.abort)()
        return fill(self._result(), {"done": done, "message": words, "log": log})

    def publish(self) -> None:
        """Joint states and diagnostics, as they are now."""
        now, job = self._node.get_clock().now().nanoseconds, self._job
        for device, state in job.states.items():
            message = joint_state_fields(self._names[device], state, now)
            self._joints.publish(fill(self._joint_state(), message))
        fields = diagnostic_fields(job.states, job.now, job.wrong, now)
        self._diagnostic.publish(fill(self._diagnostics(), fields, self._kinds))

    def _answer(self, act: Callable[[], tuple[bool, str]]) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            response.success, response.message = act()
            return response

        return answer


def main() -> None:
    """``grasp_node``; parameters: ``cell``, ``policy``, ``logs``."""
    rclpy, executors = ros_module("rclpy"), ros_module("rclpy.executors")
    # Ours: with rclpy's, Ctrl-C ends the services, ``release`` among them, while the hand still holds.
    rclpy.init(signal_handler_options=ros_module("rclpy.signals").SignalHandlerOptions.NO)
    node = rclpy.create_node("fungrasp")
    parameters = {"cell": "", "policy": "plan", "logs": "."}
    given = {name: node.declare_parameter(name, value).value for name, value in parameters.items()}
    try:
        if not given["cell"]:
            raise FungraspError("the parameter 'cell' is missing: -p cell:=FILE")
        job = GraspJob(load_cell(given["cell"]), given["cell"], given["policy"], Path(given["logs"]))
        GraspNode(node, job)
    except FungraspError as error:
        node.get_logger().fatal(str(error))
        raise SystemExit(2) from error
    executor = executors.MultiThreadedExecutor(4)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    try:
        serve_until_told(job, lambda words: node.get_logger().warning(words))
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


def serve_until_told(job: GraspJob, say: Callable[[str], object]) -> None:
    """Wait for Ctrl-C or SIGTERM; then stop what moves, and go on until its hold has ended. A second one, a
    while later, ends the hold as well.

    Args:
        say: told in words what is waited for.
    """
    with endings_as_interrupts():
        asked, since = 0, -ONE_PRESS
        while not asked or job.running:
            try:
                time.sleep(PUBLISHING)
            except KeyboardInterrupt:
                asked += time.monotonic() - since > ONE_PRESS
                since = time.monotonic()
                job.stop()
                if asked > 1:
                    job.leave()
                elif job.running:
                    say("stopped; the hand holds until 'release' or another Ctrl-C")
