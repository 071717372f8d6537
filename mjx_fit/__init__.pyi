# Public names for type checkers. No docstring: it would replace that of __init__.py in the API pages.

from mjx_fit.api import collect_dataset as collect_dataset
from mjx_fit.api import draw_attempts as draw_attempts
from mjx_fit.api import draw_holes as draw_holes
from mjx_fit.api import load_config as load_config
from mjx_fit.api import load_dataset as load_dataset
from mjx_fit.api import load_sensor as load_sensor
from mjx_fit.api import mean_interval as mean_interval
from mjx_fit.api import try_holes as try_holes
from mjx_fit.config.schema import Config as Config
from mjx_fit.config.sections.shape import Shape as Shape
from mjx_fit.control.policies import Policy as Policy
from mjx_fit.control.policies import PolicyInput as PolicyInput
from mjx_fit.control.policies import stateless as _stateless_policy
from mjx_fit.data.plan import Plan as _CollectionPlan
from mjx_fit.engines.select import make_engine as make_engine
from mjx_fit.filters.kalman import update as _kalman_update
from mjx_fit.sensors.resampling import felt_from_log as felt_from_log
from mjx_fit.sensors.resampling import log_from_felt as log_from_felt
from mjx_fit.sensors.sensor_log import SensorLog as SensorLog
from mjx_fit.sensors.trained_sensor import TrainedSensor as TrainedSensor
from mjx_fit.task.estimator import filter_update as filter_update
from mjx_fit.task.estimator import readings as readings
from mjx_fit.task.online import OnlineTracker as OnlineTracker
from mjx_fit.task.tracker import BeliefTracker as BeliefTracker
from mjx_fit.types import Attempt as Attempt
from mjx_fit.types import Belief as Belief
from mjx_fit.types import Felt as Felt
from mjx_fit.types import Rollout as Rollout
from mjx_fit.utils.errors import RequestError as RequestError
from mjx_fit.utils.process_setup import configure as configure

CollectionPlan = _CollectionPlan
kalman_update = _kalman_update
stateless_policy = _stateless_policy

__version__: str
