"""Input and output of the learned sensor."""

from jaxtyping import Bool, Float, Int

from mjx_fit.utils.arrays import Array
from mjx_fit.utils.pytrees import pytree


@pytree
class Reading:
    """Network input of one attempt: the trace tared, with noise, relative to the estimate, padded to L rows.

    It depends on the true position and type of the hole only through the measurements.

    Attributes:
        wrench_sensor: Tared wrench with sensor noise, N and N·m.
        pressure_tip: Centre of pressure on the peg's lower face over the action, relative to the face's
            centre, world x and y, m; computed from the wrench.
        tip_pos_estimate: TCP position relative to the estimate (x, y), and to the top of the socket or to the
            start of the attempt (z), m (``SensorConfig.pose``).
        tip_quat_world: Orientation of the TCP; relative to the start, that is straight down.
        tip_linvel_world: Linear velocity of the TCP, m/s.
        tip_angvel_world: Angular velocity of the TCP, rad/s.
        contact: Contact flag, 0 or 1, from the measured force (``sensors.force_torque.in_contact``).
        action_world: Commanded displacement of the TCP, m.
        mask: True for real rows, False for padding.
        peg_type: Index of the peg's shape, known to the robot.
    """

    wrench_sensor: Float[Array, "*batch L 50 6"]
    pressure_tip: Float[Array, "*batch L 2"]
    tip_pos_estimate: Float[Array, "*batch L 3"]
    tip_quat_world: Float[Array, "*batch L 4"]
    tip_linvel_world: Float[Array, "*batch L 3"]
    tip_angvel_world: Float[Array, "*batch L 3"]
    contact: Float[Array, "*batch L"]
    action_world: Float[Array, "*batch L 3"]
    mask: Bool[Array, "*batch L"]
    peg_type: Int[Array, "*batch"]


@pytree
class Observation:
    """Output of the virtual sensors for one reading; input of the filters.

    Attributes:
        innovation: Output of h_pos: the step from the estimate used for the attempt to the place that was
            felt, in the frame of the estimate, for D coordinates, m and rad.
        pos_noise_cov: Covariance R of the error of the innovation, m² and rad².
        match_logits: Output of h_match: logits of (mismatch, match).
        match_model_logp: Log of the observation model H(o_match | c, c_peg) for the peg in hand; rows: hole
            types, columns: o_match.
    """

    innovation: Float[Array, "*batch D"]
    pos_noise_cov: Float[Array, "*batch D D"]
    match_logits: Float[Array, "*batch 2"]
    match_model_logp: Float[Array, "*batch C 2"]
