"""The policy that was trained by reinforcement, as a policy of the library.

    mjx-fit evaluate insertion --policy experiments/gentle/ppo/policy.py:ppo --config configs/gentle.yaml ...

It reads `policy.npz` beside this file, or the file that `PPO_WEIGHTS` names.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.worlds import preset
from mjx_fit.control.policies import Policy, PolicyInput
from mjx_fit.envs.observation import commanded, observed
from mjx_fit.types import Array
from mjx_fit.utils.errors import RequestError

ACTOR = ("lstm_actor.", "mlp_extractor.policy_net.", "action_net.")
"""Parts of the model that choose the action."""
Weights = Mapping[str, Float[np.ndarray, "..."]]
Cell = tuple[Float[Array, "h"], Float[Array, "h"]]


def begun(weights: Weights) -> Cell:
    """Return the state of the recurrent layer before the first action."""
    size = weights["lstm_actor.weight_hh_l0"].shape[1]
    return jnp.zeros(size), jnp.zeros(size)


def acted(weights: Weights, cell: Cell, observation: Float[Array, "k"]) -> tuple[Cell, Float[Array, "3"]]:
    """Return the state and the mean action in [-1, 1]: an LSTM, one hidden layer, and a linear one."""
    hidden, memory = cell
    gates = sum(
        weights[f"lstm_actor.weight_{kind}_l0"] @ x + weights[f"lstm_actor.bias_{kind}_l0"]
        for kind, x in (("ih", observation), ("hh", hidden))
    )
    let_in, forget, new, out = jnp.split(jnp.asarray(gates), 4)
    memory = jax.nn.sigmoid(forget) * memory + jax.nn.sigmoid(let_in) * jnp.tanh(new)
    hidden = jax.nn.sigmoid(out) * jnp.tanh(memory)
    net = "mlp_extractor.policy_net.0"
    inner = jnp.tanh(weights[f"{net}.weight"] @ hidden + weights[f"{net}.bias"])
    action = weights["action_net.weight"] @ inner + weights["action_net.bias"]
    return (hidden, memory), jnp.clip(action, -1, 1)


def policy(weights: Weights) -> Policy:
    """Return the policy of these weights."""
    config = preset("gentle")

    def act(state, seen: PolicyInput):
        cell, command = state
        cell, action = acted(weights, cell, observed(seen, command, config))
        command = commanded(action)
        return (cell, command), command

    return Policy(lambda start, key: (begun(weights), jnp.zeros(3)), act, "ppo")


def __getattr__(name: str) -> Policy:
    """Load the weights when ``ppo`` is asked for: they do not exist before the training."""
    if name != "ppo":
        raise AttributeError(name)
    file = Path(os.environ.get("PPO_WEIGHTS", Path(__file__).parent / "policy.npz"))
    if not file.exists():
        raise RequestError(f"PPO_WEIGHTS: {file} does not exist: expected a file of ppo/train.py")
    return policy(np.load(file))
