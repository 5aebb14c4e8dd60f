"""The names that ``__init__.py`` loads on use, for type checkers."""

from fungrasp.core.jobs import PartStore as PartStore
from fungrasp.core.jobs import RayCluster as RayCluster
from fungrasp.deployment.deploy import deploy as deploy
from fungrasp.deployment.observer import DeploymentObserver as DeploymentObserver
from fungrasp.deployment.spec import DeploymentSpec as DeploymentSpec
from fungrasp.evaluation import LiftTestSpec as LiftTestSpec
from fungrasp.evaluation import evaluate as evaluate
from fungrasp.evaluation import static_quality as static_quality
from fungrasp.grasps import HumanGrasp as HumanGrasp
from fungrasp.grasps import HumanGraspSet as HumanGraspSet
from fungrasp.grasps import RobotGrasp as RobotGrasp
from fungrasp.grasps import RobotGraspSet as RobotGraspSet
from fungrasp.grasps import builtin_grasps as builtin_grasps
from fungrasp.grasps import load_grasps as load_grasps
from fungrasp.grasps import load_human_grasps as load_human_grasps
from fungrasp.grasps import load_objects as load_objects
from fungrasp.grasps import load_robot_grasps as load_robot_grasps
from fungrasp.grasps import save_human_grasps as save_human_grasps
from fungrasp.grasps import save_robot_grasps as save_robot_grasps
from fungrasp.hands import Hand as Hand
from fungrasp.hands import load_hand as load_hand
from fungrasp.objects import ObjectModel as ObjectModel
from fungrasp.objects import load_object as load_object
from fungrasp.perception.pipeline import perceive as perceive
from fungrasp.planning import MotionPlanner as MotionPlanner
from fungrasp.planning import Planner as Planner
from fungrasp.planning import make_planner as make_planner
from fungrasp.planning import plan as plan
from fungrasp.policies import make_policy as make_policy
from fungrasp.retargeting.retarget import retarget as retarget
from fungrasp.sim2real import Randomization as Randomization
from fungrasp.simulation import Engine as Engine
from fungrasp.simulation import build_scene as build_scene
from fungrasp.task import Action as Action
from fungrasp.task import Belief as Belief
from fungrasp.task import GraspPlan as GraspPlan
from fungrasp.task import LiftEnvironment as LiftEnvironment
from fungrasp.task import Observation as Observation
from fungrasp.task import Policy as Policy
from fungrasp.task import play as play
from fungrasp.training.settings import TrainSpec as TrainSpec
from fungrasp.training.train import train as train
from fungrasp.training.training_sets import TrainingSet as TrainingSet
from fungrasp.viewer.view import view as view

__version__: str
