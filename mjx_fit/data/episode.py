"""An interaction with what was known before it: the row of a data set."""

from jaxtyping import Bool, Float, Int

from mjx_fit.types import Array, Rollout, pytree


@pytree
class Episode:
    """One rollout, and its place in a sequence of attempts of one peg at one hole.

    Attributes:
        episode: Its id: sequence times attempts in a sequence, plus number.
        sequence: Id of the sequence.
        number: Which attempt of the sequence it is, from 0.
        policy: Index into ``mjx_fit.control.policies.NAMES``.
        estimate_cov: Covariance that went with ``rollout.felt.estimate_world`` before it, m².
        rollout: What happened. Of length 0 where nothing did, since the sequence had ended before.
    """

    episode: Int[Array, "*batch"]
    sequence: Int[Array, "*batch"]
    number: Int[Array, "*batch"]
    policy: Int[Array, "*batch"]
    estimate_cov: Float[Array, "*batch 2 2"]
    rollout: Rollout


def happened(data: Episode) -> Bool[Array, "*batch"]:
    """Which episodes were performed, and without fault."""
    return data.rollout.truth.valid & (data.rollout.felt.length > 0)
