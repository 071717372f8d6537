"""Collecting interactions: which peg meets which hole, where, and under which policy."""

import time
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit import config as config_
from mjx_fit import policies
from mjx_fit.config import Config
from mjx_fit.dataset import shard as shard_
from mjx_fit.dataset.draws import POLICIES, draw_attempts, draw_later_attempts
from mjx_fit.dataset.episode import Episode
from mjx_fit.dataset.manifest import Manifest
from mjx_fit.dataset.writer import Writer, is_finished, new_manifest, new_shard
from mjx_fit.errors import RequestError
from mjx_fit.progress import Progress
from mjx_fit.randomness import require_seed, root_key
from mjx_fit.simulate.broken import report
from mjx_fit.simulate.engine import Engine, create, even_batch, resolve
from mjx_fit.types import SUBSTEPS, Array, Attempt, Interaction

MAX_EPISODES, MAX_ACTIONS, MAX_BATCH, MAX_SEQUENCE = 10**7, 1000, 65536, 30


@dataclass(frozen=True)
class Plan:
    """What is to be collected.

    Attributes:
        episodes: Number of interactions, a multiple of ``sequence``.
        steps: Most actions in one. A spiral is as long as it will be in use, ``task.attempt_actions``, or is
            cut off.
        policy: ``random``, ``spiral``, or ``mixed``: both in turn.
        engine: ``auto``, ``mjx`` or ``native``.
        seed: Root seed.
        batch: Most interactions in one shard. Their sequences are simulated at once.
        sequence: Attempts in a row of one peg at one hole. The first starts from the detector's estimate,
            later ones from estimates as a filter may have them by then; what follows an insertion is left
            out.
        shard_index: Which part of the whole to collect, from 0.
        num_shards: Of how many parts.
    """

    episodes: int = 3000
    steps: int = 200
    policy: str = "random"
    engine: str = "auto"
    seed: int = 0
    batch: int = 250
    sequence: int = 1
    shard_index: int = 0
    num_shards: int = 1

    @property
    def sequences(self) -> int:
        return self.episodes // self.sequence

    @property
    def worlds(self) -> int:
        """Worlds in each batch, one for each sequence; the last batch may have idle ones."""
        return even_batch(self.sequences, max(1, self.batch // self.sequence))

    def shards(self) -> dict[str, int]:
        """The shards of this part: the first sequence of each, by file name."""
        starts = range(0, self.sequences, self.worlds)[self.shard_index :: self.num_shards]
        return {f"shard-{start * self.sequence:08d}.h5": start for start in starts}

    def command(self, out: Path) -> str:
        """The command that collects this, but for the configuration."""
        options = ((field.name.replace("_", "-"), getattr(self, field.name)) for field in fields(self))
        return f"mjx-fit collect --out {out} " + " ".join(f"--{name} {value}" for name, value in options)

    def request(self, config: Config) -> dict[str, Any]:
        """What makes the whole what it is, JSON-ready: the same in all its parts."""
        whole = ("episodes", "steps", "policy", "seed", "batch", "sequence")
        return {
            **{name: getattr(self, name) for name in whole},
            "engine": resolve(self.engine),
            "config": config_.to_tree(config),
        }


def plan_of(manifest: Manifest) -> Plan:
    """What a data set was asked to be."""
    index, of = manifest.part
    asked = {name: value for name, value in manifest.request.items() if name != "config"}
    return Plan(**asked, shard_index=index, num_shards=of)


def collect(config: Config, out: Path, plan: Plan) -> None:
    """Simulates interactions and stores them; goes on where a killed collection of the same kind stopped.

    The draws of an episode depend on the seed and its id alone. All batches have one shape, the last one
    padded: arithmetic may differ in the last bit from one shape to another.

    Args:
        config: The configuration.
        out: Folder of the data set.
        plan: What is to be collected.

    Raises:
        RequestError: A value is not allowed, or the folder holds something else, or is in use.
    """
    _check(plan)
    request, shards = plan.request(config), plan.shards()
    wanted = new_manifest(request, (plan.shard_index, plan.num_shards))
    if is_finished(out, wanted, shards):
        return
    with Writer(out, wanted) as writer:
        missing = writer.missing(shards)
        if missing:
            simulate = _Sequences(create(plan.engine, config), config, plan, out / "broken")
            _fill(writer, {name: shards[name] for name in missing}, len(shards), simulate, request)
        writer.finish()


def _fill(
    writer: Writer, missing: dict[str, int], n_shards: int, simulate: "_Sequences", request: dict[str, Any]
) -> None:
    began, actions, inserted = time.monotonic(), 0, 0
    done = n_shards - len(missing)
    with Progress("collect: shard", n_shards, done) as progress:
        for name, start in missing.items():
            episodes = simulate(start)
            content = shard_.encode(episodes, request)
            writer.write(new_shard(name, np.asarray(episodes.episode), content), content)
            done += 1
            actions += int(episodes.interaction.length.sum())
            inserted += int(episodes.interaction.inserted.sum())
            speed = actions * SUBSTEPS / (time.monotonic() - began)
            words = [f"{inserted} inserted", f"{speed:,.0f} steps/s"]
            if simulate.broken:
                words.append(f"{simulate.broken} broken")
            progress(done, ", ".join(words))


class _Sequences:
    """Simulates batches of sequences.

    Attributes:
        broken: Worlds so far whose simulation turned non-finite.
    """

    def __init__(self, engine: Engine, config: Config, plan: Plan, dumps: Path):
        self._engine, self._config, self._plan, self._dumps = engine, config, plan, dumps
        self._root = root_key(plan.seed, "collect")
        self.broken = 0

    def __call__(self, start: int) -> Episode:
        """The episodes of one batch of sequences, in the order of their ids."""
        plan = self._plan
        sequences = np.arange(start, start + plan.worlds)
        wanted = sequences < plan.sequences
        going, whole = wanted, None
        for number in range(plan.sequence):
            attempts, cov = self._attempts(sequences, number)
            ids = sequences * plan.sequence + number
            done = self._run(attempts, ids, going)
            going = going & done.valid & ~done.inserted
            policy = np.asarray(attempts.policy)
            one = Episode(ids, sequences, np.full_like(ids, number), policy, np.asarray(cov), done)
            one = jax.tree.map(lambda leaf: leaf[: wanted.sum()], one)
            if plan.sequence == 1:
                return one
            if whole is None:  # in place at once: kept and joined at the end, all would be there twice
                whole = jax.tree.map(partial(_with_axis, plan.sequence), one)
            jax.tree.map(lambda to, leaf, n=number: to.__setitem__((slice(None), n), leaf), whole, one)
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), whole)

    def _attempts(
        self, sequences: Int[np.ndarray, "n"], number: int
    ) -> tuple[Attempt, Float[Array, "n 2 2"]]:
        ids, policy = jnp.asarray(sequences), self._plan.policy
        if number:
            return draw_later_attempts(self._root, ids, policy, number, self._config)
        cov = self._config.detector.prior_std_m**2 * np.eye(2, dtype=np.float32)
        attempts = draw_attempts(self._root, ids, policy, self._config.detector)
        return attempts, np.broadcast_to(cov, (len(sequences), 2, 2))

    def _run(self, attempts: Attempt, ids: Int[np.ndarray, "n"], going: Bool[np.ndarray, "n"]) -> Interaction:
        """Runs the attempts of each policy with as many actions as it has."""
        kind, steps = np.asarray(attempts.policy), self._plan.steps
        done = None
        for policy in np.unique(kind):
            mine = kind == policy
            horizon = self._config.task.attempt_actions if policy == policies.SPIRAL else steps
            part = self._engine.run(attempts, min(steps, horizon), going & mine, horizon)
            self.broken += report(part, attempts, ids, horizon, self._config, self._dumps)
            part = _padded(part, steps)
            done = part if done is None else jax.tree.map(partial(_chosen, mine), part, done)
        assert done is not None
        return done


def _with_axis(n: int, leaf: np.ndarray) -> np.ndarray:
    return np.zeros((len(leaf), n, *leaf.shape[1:]), leaf.dtype)


def _padded(interactions: Interaction, steps: int) -> Interaction:
    def pad(leaf):
        return np.pad(leaf, [(0, 0), (0, steps - leaf.shape[1]), *[(0, 0)] * (leaf.ndim - 2)])

    return Interaction(**vars(interactions) | {"trace": jax.tree.map(pad, interactions.trace)})


def _chosen(chosen: Bool[np.ndarray, "n"], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), a, b)


def _check(plan: Plan) -> None:
    require_seed(plan.seed)
    for field, value, allowed, expected in (
        ("--episodes", plan.episodes, 1 <= plan.episodes <= MAX_EPISODES, f"between 1 and {MAX_EPISODES}"),
        ("--steps", plan.steps, 1 <= plan.steps <= MAX_ACTIONS, f"between 1 and {MAX_ACTIONS}"),
        ("--policy", plan.policy, plan.policy in POLICIES, f"one of {', '.join(POLICIES)}"),
        ("--batch", plan.batch, 1 <= plan.batch <= MAX_BATCH, f"between 1 and {MAX_BATCH}"),
        ("--sequence", plan.sequence, 1 <= plan.sequence <= MAX_SEQUENCE, f"between 1 and {MAX_SEQUENCE}"),
        ("--num-shards", plan.num_shards, plan.num_shards >= 1, "at least 1"),
        (
            "--shard-index",
            plan.shard_index,
            0 <= plan.shard_index < plan.num_shards,
            f"between 0 and {plan.num_shards - 1}, one less than --num-shards",
        ),
    ):
        if not allowed:
            raise RequestError(f"{field}: {value!r} is not allowed: it must be {expected}")
    if plan.episodes % plan.sequence:
        raise RequestError(
            f"--episodes: {plan.episodes} is not allowed: it must be a multiple of --sequence, "
            f"{plan.sequence}"
        )
    batches = -(-plan.sequences // plan.worlds)
    if plan.num_shards > batches:
        raise RequestError(
            f"--num-shards: {plan.num_shards} is not allowed: it must be at most {batches}, the number of "
            "batches; a smaller --batch makes more"
        )
