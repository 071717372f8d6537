"""Collecting interactions: which peg meets which hole, where, and under which policy."""

from functools import partial
from itertools import permutations
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit import policies
from mjx_fit.config import Config, DetectorConfig
from mjx_fit.dataset.store import Writer
from mjx_fit.detector import detect
from mjx_fit.errors import RequestError
from mjx_fit.progress import Progress
from mjx_fit.randomness import require_seed, root_key
from mjx_fit.scene import HOLE_WORKSPACE_M
from mjx_fit.shapes import SHAPES
from mjx_fit.simulate.broken import report
from mjx_fit.simulate.engine import create, even_batch, resolve
from mjx_fit.types import Array, Attempt, Interaction

POLICIES = (*policies.POLICIES, "mixed")
MISMATCHED = np.array(list(permutations(range(len(SHAPES)), 2)))
MAX_ACTIONS, MAX_BATCH = 1000, 65536


def collect(
    config: Config, out: Path, episodes: int, steps: int, policy: str, engine: str, seed: int, batch: int
) -> None:
    """Simulates interactions and stores them; goes on where a killed collection of the same kind stopped.

    The draws of an episode depend on the seed and its id alone. All batches have one shape, the last one
    padded: arithmetic may differ in the last bit from one shape to another.

    Args:
        config: The configuration.
        out: Folder of the data set.
        episodes: Number of interactions: even ids are matched pairs, odd ids mismatched ones.
        steps: Most actions in one interaction.
        policy: ``random``, ``spiral``, or ``mixed`` for each in half of the episodes, at random.
        engine: ``auto``, ``mjx`` or ``native``.
        seed: Root seed.
        batch: Worlds that are simulated at once: one shard.

    Raises:
        RequestError: A value is not allowed, or the folder holds something else.
    """
    _check(episodes, steps, policy, seed, batch)
    batch = even_batch(episodes, batch)
    request = {"episodes": episodes, "steps": steps, "policy": policy, "seed": seed, "batch": batch}
    writer = Writer(out, request | {"engine": resolve(engine)}, config)
    missing = [start for start in range(0, episodes, batch) if not writer.has(_shard_name(start))]
    if not missing:
        writer.finish()
        return
    simulator = create(engine, config)
    root = root_key(seed, "collect")
    done = episodes - sum(min(batch, episodes - start) for start in missing)
    inserted = broken = 0
    with Progress("collect", episodes, done) as progress:
        for start in missing:
            ids = np.arange(start, start + batch)
            attempts = draw_attempts(root, jnp.asarray(ids), policy, config.detector)
            wanted = ids[ids < episodes]
            interactions = _first(len(wanted), simulator.run(attempts, steps, ids < episodes))
            broken += report(interactions, attempts, wanted, steps, config, out / "broken")
            writer.write(_shard_name(start), wanted, interactions)
            done, inserted = done + len(wanted), inserted + int(interactions.inserted.sum())
            progress(done, f"{inserted} inserted" + (f", {broken} broken" if broken else ""))
    writer.finish()


def draw_attempts(
    root: Key[Array, ""], episodes: Int[Array, "n"], policy: str, detector: DetectorConfig
) -> Attempt:
    """What the episodes of a data set are to do; a pure function of the root key and the ids."""
    peg_type, hole_type = pair_of(np.asarray(episodes))
    hole_pos, estimate, wiggle, coin = draw_places(root, episodes, detector)
    chosen = coin.astype(int) if policy == "mixed" else policies.POLICIES.index(policy)
    kind = jnp.broadcast_to(chosen, coin.shape)
    return Attempt(jnp.asarray(peg_type), jnp.asarray(hole_type), hole_pos, estimate, kind, wiggle)


@partial(jax.jit, static_argnames="detector")
def draw_places(
    root: Key[Array, ""], episodes: Int[Array, "n"], detector: DetectorConfig
) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"], Key[Array, "n"], Bool[Array, "n"]]:
    """Where the holes are, what the detector says, the keys of the policies, and a coin to choose a policy.

    Args:
        root: Root key.
        episodes: Ids; each draw depends on the root key and its episode's id alone.
        detector: The detector.

    Returns:
        True places, uniform in the workspace, m; estimates, m; keys; coins.
    """

    def draw(episode):
        place, error, wiggle, coin = jax.random.split(jax.random.fold_in(root, episode), 4)
        low, high = jnp.asarray(HOLE_WORKSPACE_M).T
        hole_pos = jax.random.uniform(place, (2,), minval=low, maxval=high)
        return hole_pos, detect(error, hole_pos, detector), wiggle, jax.random.bernoulli(coin)

    return jax.vmap(draw)(episodes)


def pair_of(episodes: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Peg and hole type of each episode: even ids take the matched pairs in turn, odd ids the others."""
    turn = episodes // 2
    matched = (episodes % 2 == 0)[:, None]
    same = np.stack([turn % len(SHAPES)] * 2, 1)
    pair = np.where(matched, same, MISMATCHED[turn % len(MISMATCHED)])
    return pair[:, 0], pair[:, 1]


def _first(n: int, interactions: Interaction) -> Interaction:
    return jax.tree.map(lambda leaf: leaf[:n], interactions)


def _shard_name(start: int) -> str:
    return f"shard-{start:08d}.h5"


def _check(episodes: int, steps: int, policy: str, seed: int, batch: int) -> None:
    for field, value, allowed, expected in (
        ("--episodes", episodes, episodes >= 1, "at least 1"),
        ("--steps", steps, 1 <= steps <= MAX_ACTIONS, f"between 1 and {MAX_ACTIONS}"),
        ("--policy", policy, policy in POLICIES, f"one of {', '.join(POLICIES)}"),
        ("--batch", batch, 1 <= batch <= MAX_BATCH, f"between 1 and {MAX_BATCH}"),
    ):
        if not allowed:
            raise RequestError(f"{field}: {value!r} is not allowed: it must be {expected}")
    require_seed(seed)
