"""Public functions that combine several parts of the library; see ``mjx_fit``."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.data import reader, schedule
from mjx_fit.data.collect import collect
from mjx_fit.data.episode import Episode
from mjx_fit.data.plan import Plan
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.requests import require_count
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation import insertion
from mjx_fit.evaluation.statistics import Interval, bootstrap_mean
from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.task import single_hole
from mjx_fit.task.estimator import Update
from mjx_fit.task.holes import Holes, Outcome
from mjx_fit.task.methods import HoleMethod
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.types import Attempt
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError, shown

MOST_ATTEMPTS = 100_000


def load_config(path: Path | str | None = None, *overrides: str) -> Config:
    """Load a configuration: the defaults, updated by a YAML file and by ``section.key=value`` strings.

    Args:
        path: YAML file; None: no file.
        overrides: Strings ``section.key=value``, applied after the file.

    Raises:
        RequestError: The file cannot be read, or a key or value is invalid; the message names it.

    Example:
        >>> import mjx_fit as mf
        >>> mf.load_config(None, "scene.friction=0.4").scene.friction
        0.4
    """
    return read_config(None if path is None else Path(path), overrides)


def load_sensor(run: Path | str | None = None) -> TrainedSensor:
    """Load the trained sensor of a training run.

    Args:
        run: Folder of the run, or ``as-2026-11`` for the weights until November 2026; None: the weights
            shipped with the package.

    Raises:
        RequestError: The folder contains no training run, or a damaged one.

    Example:
        >>> import mjx_fit as mf
        >>> mf.load_sensor().config.scene.names
        ('cross', 'rectangle', 'square')
    """
    return load_trained_sensor(resources.run_folder(run))


def draw_attempts(
    key: Key[Array, ""], n: int, policy: str = "spiral", config: Config | None = None
) -> Attempt:
    """Draw attempts at random holes, started from the detector's estimates.

    Attempts alternate between matching and mismatching pegs and cycle through the shape pairs. The draws of
    attempt i depend on the key and on i alone.

    Args:
        key: Random key.
        n: Number of attempts.
        policy: ``spiral``, ``random``, or ``mixed`` (alternates between both).
        config: Configuration of scene and detector; None: the defaults.

    Returns:
        Attempts (n,).

    Raises:
        RequestError: The policy is unknown, or n is out of range.

    Example:
        >>> import jax, mjx_fit as mf
        >>> attempts = mf.draw_attempts(jax.random.key(0), 6)
        >>> attempts.peg_type.tolist(), attempts.hole_type.tolist()
        ([0, 0, 1, 0, 2, 1], [0, 1, 1, 2, 2, 0])
    """
    n = require_count("n", n, 1, MOST_ATTEMPTS)
    if policy not in schedule.POLICIES:
        raise RequestError(
            f"policy: {shown(policy)} is invalid: expected one of {', '.join(schedule.POLICIES)}"
        )
    return schedule.draw_attempts(key, jnp.arange(n), policy, config or Config())


def collect_dataset(
    out: Path | str, plan: Plan, config: Config | None = None, engine: Engine | None = None
) -> Path:
    """Simulate rollouts and store them as a data set, as ``mjx-fit collect`` does.

    Call it again with the same arguments to resume an interrupted collection.

    Args:
        out: Folder of the data set.
        plan: Number and kind of the episodes.
        config: Configuration; None: the defaults.
        engine: Simulation engine; None: the engine named in the plan.

    Returns:
        Folder of the data set.

    Raises:
        RequestError: A value is invalid, or the folder contains other files or is in use.

    Example:
        >>> import tempfile, mjx_fit as mf
        >>> folder = mf.collect_dataset(tempfile.mkdtemp(), mf.CollectionPlan(episodes=4, actions=3))
        >>> mf.load_dataset(folder).rollout.felt.length.tolist()
        [3, 3, 3, 3]
    """
    config = config or Config()
    collect(config, Path(out), plan, engine or make_engine(plan.engine, config))
    return Path(out)


def load_dataset(folder: Path | str) -> Episode:
    """Load all episodes of a data set as stacked NumPy arrays.

    Episodes that were not executed have length 0; diverged ones have ``rollout.truth.valid`` set to False.

    Args:
        folder: Folder of the data set.

    Raises:
        RequestError: The folder contains no data set, an unfinished one or a damaged file.

    Example:
        >>> import tempfile, mjx_fit as mf
        >>> folder = mf.collect_dataset(tempfile.mkdtemp(), mf.CollectionPlan(episodes=4, actions=3))
        >>> mf.load_dataset(folder).rollout.felt.trace.wrench_sensor.shape
        (4, 3, 50, 6)
    """
    return reader.load(Path(folder))


def draw_holes(seed: int, n: int, config: Config | None = None) -> Holes:
    """Draw single holes that match the peg in hand, with the detector's estimates.

    They are identical to those of ``mjx-fit evaluate insertion --seeds 1`` and cycle through the shapes.

    Args:
        seed: Root seed.
        n: Number of holes.
        config: Configuration of shapes and detector; None: the defaults.

    Example:
        >>> import mjx_fit as mf
        >>> mf.draw_holes(0, 4).peg_type.tolist()
        [0, 1, 2, 0]
    """
    n = require_count("n", n, 1, MOST_ATTEMPTS)
    return insertion.draw_holes(config or Config(), np.arange(n), 1, seed)


def try_holes(
    holes: Holes,
    updates: Mapping[str, Update],
    config: Config | None = None,
    engine: Engine | None = None,
    max_attempts: int = insertion.ATTEMPTS,
) -> dict[str, Outcome]:
    """Attempt every hole with the spiral search until the peg is inserted, once per belief update.

    Args:
        holes: Holes from ``draw_holes``.
        updates: Belief updates by name; each returns the posterior of the holes given the measurements of a
            failed attempt.
        config: Configuration, the same as the engine's; None: the defaults.
        engine: Simulation engine; None: ``make_engine("auto", config)``.
        max_attempts: Maximum number of attempts per hole.

    Returns:
        Outcome for each update, by name.

    Raises:
        RequestError: ``max_attempts`` is out of range, or the engine rejects the attempts.

    Example:
        >>> import mjx_fit as mf
        >>> updates = {"keep": lambda belief, felt, keys: belief}  # learns nothing
        >>> kept = mf.try_holes(mf.draw_holes(0, 2), updates, max_attempts=1)
        >>> kept["keep"].attempts.tolist()
        [1, 1]
    """
    max_attempts = require_count("max_attempts", max_attempts, 1, 1000)
    config = config or Config()
    methods = tuple(HoleMethod(name) for name in updates)
    table = single_hole.HoleTable(config, methods, holes, max_attempts)
    engine = engine or make_engine("auto", config)
    for _ in single_hole.rounds(table, engine, single_hole.update_of_rows(methods, updates)):
        pass
    return table.outcomes()


def mean_interval(values: Sequence[float] | Float[np.ndarray, "n"]) -> Interval:
    """Compute the mean of independent trials and its 95 % bootstrap confidence interval.

    Example:
        >>> import mjx_fit as mf
        >>> mf.mean_interval([3.0, 3.0, 3.0]).value
        3.0
    """
    array = np.asarray(values, float)
    return bootstrap_mean(array, range(len(array)))
