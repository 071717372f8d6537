"""Contact of attempts, as the filter that knows the parts' geometry reads and remembers it."""

from jaxtyping import Float, Int

from mjx_fit.utils.arrays import Array
from mjx_fit.utils.pytrees import pytree


@pytree
class Rows:
    """What attempts tell about contact, action by action, in the frame of an estimate.

    Attributes:
        tip: Position of the TCP relative to the estimate, on the plate's upper face, m.
        turn: Rotation of the TCP from straight down.
        press: Force on the peg upwards, N.
        pressure: Centre of pressure on the peg's lower face relative to the TCP, x and y, m.
        weight: Exponent of the row's likelihood; 0: it is not read.
        noise: Factor of the spread of gaps in its attempt; 0: the one that particles have for this attempt.
        attempt: Attempt whose height error it shares: 0 is this one, k the k-th that is remembered.
    """

    tip: Float[Array, "*L 3"]
    turn: Float[Array, "*L 3 3"]
    press: Float[Array, "*L"]
    pressure: Float[Array, "*L 2"]
    weight: Float[Array, "*L"]
    noise: Float[Array, "*L"]
    attempt: Int[Array, "*L"]


@pytree
class Particles:
    """Particles, all of equal weight.

    Attributes:
        values: Numbers in units of the prior.
        types: Type of the hole.
    """

    values: Float[Array, "*batch N d"]
    types: Int[Array, "*batch N"]
