"""Speed of the environments beside that of the engines that simulate them.

    python experiments/envs/speed.py OUT.json [--engines native,mjx] [--worlds N] [--repeats K]

Every world presses straight down for 5 s, so that all do the same work: by `engine.run`, by
`make_vec` stepped from Python, and for MJX by the functional form in one compiled scan. Each runs once to
compile, and then they take turns. Steps are actions of one world.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode

import mjx_fit as mf
import mjx_fit.envs
from mjx_fit.envs.functional import FunctionalInsertion
from mjx_fit.envs.observation import commanded
from mjx_fit.report import script

ACTIONS, MOST_ROWS = 50, 128
STILL = np.zeros(3, np.float32)
"""Action that presses with half of the deepest push."""


def of_engine(name: str, worlds: int) -> Callable[[], float]:
    """Return a function that runs attempts in an engine, and gives the steps."""
    config = mf.Config()
    policy = mf.stateless_policy(lambda seen: commanded(jnp.asarray(STILL)), name="still")
    engine = mf.make_engine(name, config, policy=policy)
    drawn = mf.draw_attempts(jax.random.key(0), 2 * worlds, config=config)
    attempts = jax.tree.map(lambda leaf: leaf[::2], drawn)
    return lambda: float(np.sum(engine.run(attempts, ACTIONS).felt.length))


def of_batch(name: str, worlds: int) -> Callable[[], float]:
    """Return a function that steps an environment, and gives the steps."""
    env = gymnasium.make_vec(
        "mjx_fit/Insertion-v0", num_envs=worlds, engine=name, autoreset_mode=AutoresetMode.SAME_STEP
    )
    actions = np.tile(STILL, (worlds, 1))
    env.reset(seed=0)

    def run() -> float:
        for _ in range(ACTIONS):
            env.step(actions)
        return float(ACTIONS * worlds)

    return run


def of_functions(worlds: int) -> Callable[[], float]:
    """Return a function that runs the functional form in one compiled scan, and gives the steps."""
    env = FunctionalInsertion()

    @partial(jax.jit, compiler_options=env.compiler_options)
    def play(keys):
        def step(state, _):
            state, done = jax.vmap(env.step)(state, jnp.tile(STILL, (len(keys), 1)))
            return state, done.reward

        return jax.lax.scan(step, jax.vmap(env.reset)(keys), length=ACTIONS)[1]

    # As many rows at once as in the engine on a CPU: more leave its cache.
    keys = jax.random.split(jax.random.key(0), worlds)
    parts = [keys[start : start + MOST_ROWS] for start in range(0, worlds, MOST_ROWS)]

    def run() -> float:
        for part in parts:
            play(part).block_until_ready()
        return float(ACTIONS * worlds)

    return run


def rate(run: Callable[[], float]) -> float:
    """Return the steps per second."""
    began = time.perf_counter()
    return run() / (time.perf_counter() - began)


def main(out: Path, engines: list[str], worlds: int, repeats: int) -> None:
    """Measure these engines."""
    told = {}
    for name in engines:
        runs = {"engine.run": of_engine(name, worlds), "make_vec": of_batch(name, worlds)}
        if name == "mjx":
            runs["functional"] = of_functions(worlds)
        for run in runs.values():
            run()
        rates: dict[str, list[float]] = {case: [] for case in runs}
        for _ in range(repeats):
            for case, run in runs.items():
                rates[case].append(rate(run))
                print(name, case, round(rates[case][-1], 1), flush=True)
        ratios = {case: float(np.median(np.divide(own, rates["engine.run"]))) for case, own in rates.items()}
        told[name] = {"worlds": worlds, "steps_per_s": rates, "median_ratio_to_engine": ratios}
    script.save(out, told)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--engines", default="native,mjx", metavar="A,B")
    parser.add_argument("--worlds", type=int, default=256, metavar="N")
    parser.add_argument("--repeats", type=int, default=3, metavar="K")
    asked = parser.parse_args()
    main(asked.out, asked.engines.split(","), asked.worlds, asked.repeats)
