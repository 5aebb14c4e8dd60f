"""``fungrasp evaluate``: how many grasps lift the object, in simulation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fungrasp.cli.console import Answer, option, progress_bar, suggestion
from fungrasp.cli.options import JsonOut, device_and_buffers, json_path, on_cluster, print_use

if TYPE_CHECKING:
    from fungrasp.evaluation import LiftTestSpec
    from fungrasp.sim2real import Randomization


@dataclass(frozen=True)
class Evaluate:
    """Try grasps in simulation: reach, grasp, lift, hold; measure how many succeed."""

    grasps: str = "builtin"
    """A file of human grasps (they are retargeted first) or of robot grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str | None = None
    """Name of a hand, or the path of a hand's TOML file: that of robot grasps, and allegro for human ones, by
    default."""
    mirror: bool = False
    """Mirror human grasps and their objects first: those of right hands for a left hand, or the other way
    round."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`); the model's if not given."""
    policy: str = "reference"
    """What moves the hand: "reference" (one planned motion, open loop), "student", "teacher", "plan" (the
    student's plan, open loop), one of `fungrasp policies list`, or a policy file (.onnx)."""
    method: str = "contact"
    """How human grasps are retargeted: contact, angle-copy, dexgraspnet."""
    adapt: bool = True
    """Fit the grasps to the object as it has settled: a little optimization by the planner, which also
    repairs grasps that were retargeted badly."""
    seed: tuple[int, ...] = (0,)
    """Seed of all random numbers; with several, each grasp is tried with each."""
    json: JsonOut = None
    """Write every number here (.json); without a file, print them. Given again with its file after an
    interruption, the command goes on."""
    out: Path | None = None
    """Write a compact result: this JSON file with settings and summary, and beside it a CSV file with one row
    per episode."""
    record: Path | None = None
    """Folder to which each episode is recorded (.npz)."""
    picture: Path | None = None
    """Draw some of the grasps, and whether they held, to this PNG file."""
    static: bool = False
    """Measure the static quality of the retargeted human grasps too."""
    use: bool = False
    """After the hold, play the motion that the grasp's task needs (tilt, strike, stroke, press, hand over),
    and say how many objects stay in the hand and how many fingers lie where the person's did."""
    protocol: Literal["nominal", "reality", "robustness"] = "nominal"
    """How the world differs from what planner and policy believe: not at all; in everything at once, as a
    robot's does, drawn anew for each episode; or in one thing at a time."""
    mass_scale: float = 1.0
    """The object weighs this many times its nominal mass, which the policy assumes."""
    friction: float | None = None
    """Sliding friction of hand, object and table; 0.9 by default."""
    pose_noise: tuple[float, float] = (0.0, 0.0)
    """Difference of the object's true pose from the estimated one: shift [m] and turn [degrees]."""
    table_height: float = 0.0
    """Height of the table top above the nominal one, which the policy assumes [m]."""
    latency: float = 0.0
    """Actions take effect this late [s], up to 0.1."""
    push: tuple[float, float] = (0.0, 0.2)
    """During the hold, three pushes in random directions: force [times the object's weight], duration [s]."""
    object_shift: float = 0.0
    """The object is moved this far on the table [m] after the policy has planned."""
    rollouts: bool = True
    """Policies that choose among candidate plans try the most promising in simulated rollouts first, in
    worlds that differ from the nominal one, and search further where none holds: 33 to 189 episodes for each
    grasp."""
    attempts: int = 1
    """Most attempts of an episode. A policy that watches (a student) sees that the object is not held, lets
    go, withdraws, looks where the object lies, plans anew and tries again. The published protocol is one
    attempt; with more, the result says how many objects the first one held."""
    noslip: int = 0
    """Iterations that take the creep out of the solver's friction; 5 make physics 1.6 times as slow."""
    threads: int = 0
    """0 means all processors; the result does not depend on it."""
    device: Literal["cuda", "cpu-warp", "cpu"] | None = None
    """Where worlds and rollouts are simulated: a GPU of NVIDIA's, the GPU's code on the processor (slow), or
    the processor. By default a GPU if there is one with the extra "gpu"."""
    buffers: tuple[int, int] | None = None
    """Room on a GPU for contacts of a world (on average) and rows of constraints (at most); found by a probe
    by default."""
    ray: tuple[str, ...] | None = None
    """Plan and play on a Ray cluster: on that of this address ("auto": the one that this machine is part of),
    or on all processors of this machine where none is given. Same results. Every machine must see the files
    under the same names."""

    def run(self) -> Answer:
        from contextlib import nullcontext

        from fungrasp.core.errors import FungraspError
        from fungrasp.core.jobs import PartStore
        from fungrasp.evaluation import evaluate
        from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects, mirrored_grasps
        from fungrasp.media.pictures import draw_grasps
        from fungrasp.retargeting import RetargetSpec, method_name, retarget
        from fungrasp.sim2real.joint_dynamics import identified_hand

        spec, cluster, path = self._spec(), on_cluster(self.ray), json_path(self.json)
        file = path or self.out
        if cluster is not None and file is None:
            raise FungraspError("--ray keeps finished parts beside the result: give --json or --out too")
        grasps = load_grasps(self.grasps)
        given = grasps if isinstance(grasps, RobotGraspSet) else None
        name = self.hand or (RetargetSpec.hand if given is None else given.hand_file or given.hand)
        hand = identified_hand(name, self.hand_dynamics)
        method = method_name(self.method)
        if given is not None and method != RetargetSpec.method:
            raise FungraspError(f"--method {self.method}: {self.grasps} holds robot grasps already")
        if self.mirror:
            if isinstance(grasps, RobotGraspSet):
                raise FungraspError(f"--mirror: {self.grasps} holds robot grasps; give it to 'retarget'")
            grasps = mirrored_grasps(grasps)
        objects = load_objects(grasps, self.objects)
        robot, human = given, None if isinstance(grasps, RobotGraspSet) else grasps
        if robot is None:
            assert human is not None
            with progress_bar(f"retargeting to {hand.name} ({method})", 1.0) as show:
                robot = retarget(human, objects, hand, method, threads=self.threads, progress=show)
        with nullcontext() if file is None else PartStore.beside(file) as store:
            options: Any = {"spec": spec, "record": self.record, "threads": self.threads}
            options |= {"store": store, "ray": cluster}
            with progress_bar(f"lifting with {hand.name}", 1.0) as show:
                result = evaluate(robot, objects, hand=hand, human=human, progress=show, **options)
            if path is not None:
                result.save(path)
            if self.out is not None:
                result.save(self.out, compact=True)
        print_use(cluster)
        if self.picture is not None:
            captions = [reason or "success" for reason in result.outcomes.reason.tolist()]
            with progress_bar("drawing", 1.0) as show:
                draw_grasps(self.picture, robot, objects, captions=captions, progress=show)
        lines = [result.table(), f"{result.episodes} episodes in {result.seconds:.1f} s"]
        if path is not None:
            given_as = None if human is not None else self.grasps
            lines.append(suggestion("view", path, option("--grasps", given_as)))
        return Answer(result.json(), "\n".join(lines))

    def _spec(self) -> LiftTestSpec:
        from fungrasp.evaluation import LiftTestSpec
        from fungrasp.simulation import SceneSettings

        device, buffers = device_and_buffers(self.device, self.buffers)
        if self.noslip and self.device is None:
            device = "cpu"
        return LiftTestSpec(
            policy=self.policy,
            protocol=self.protocol,
            seeds=self.seed,
            randomization=self._randomization(),
            physics=SceneSettings(noslip_iterations=self.noslip, device=device, buffers=buffers),
            adapt=self.adapt,
            rollouts=self.rollouts,
            attempts=self.attempts,
            use=self.use,
            static=self.static,
        )

    def _randomization(self) -> Randomization:
        from math import radians

        from fungrasp.sim2real import THREE_PUSHES, MeasurementError, Randomization

        distance, angle = self.pose_noise
        weights, duration = self.push
        return Randomization(
            mass=(self.mass_scale, self.mass_scale),
            friction=None if self.friction is None else (self.friction, self.friction),
            object_position_error=MeasurementError(offset=distance),
            object_rotation_error=MeasurementError(offset=radians(angle)),
            table_height=(self.table_height, self.table_height),
            action_delay=(self.latency, self.latency),
            push_times=THREE_PUSHES if weights else (),
            push_weights=(weights, weights),
            push_duration=duration,
            object_shift=(self.object_shift, self.object_shift),
        )


COMMAND = Evaluate
