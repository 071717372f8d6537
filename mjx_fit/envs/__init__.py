"""Environments for reinforcement learning; importing this package registers them with Gymnasium.

>>> import gymnasium, mjx_fit.envs
>>> env = gymnasium.make("mjx_fit/Insertion-v0")
>>> batch = gymnasium.make_vec("mjx_fit/Insertion-v0", num_envs=16)
"""

try:
    import gymnasium
except ImportError:
    raise ImportError(
        "mjx_fit.envs needs gymnasium, which is not installed: pip install 'mjx-fit[gym]'"
    ) from None

from mjx_fit.envs.insertion import InsertionEnv
from mjx_fit.envs.insertion_batch import InsertionVectorEnv

__all__ = ["InsertionEnv", "InsertionVectorEnv"]

gymnasium.register(
    "mjx_fit/Insertion-v0",
    entry_point="mjx_fit.envs.insertion:InsertionEnv",
    vector_entry_point="mjx_fit.envs.insertion_batch:InsertionVectorEnv",
    disable_env_checker=True,
)
