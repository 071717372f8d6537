"""The sections of a configuration: every number that a run depends on, with its unit and its range.

Ranges end where a number stops to mean something: an attempt at the ends of all of them keeps its peg
upright and over its plate. Where numbers bound each other, ``mjx_fit.limits`` says how.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.errors import shown
from mjx_fit.robot import ROBOTS

LEAST_PROBABILITY = 1e-6
Probability = Annotated[float, Field(ge=LEAST_PROBABILITY, le=0.999999)]
"""As near to 0 and 1 as single precision can tell well."""

Rates = tuple[Annotated[float, Field(ge=0, le=0.999999)], ...]

MOST_TYPES = 12
"""Shapes of one scene: as many as colours tell apart."""


def _number_or_row(value: Any) -> str:
    return "row" if isinstance(value, list | tuple) else "number"


Alphas = tuple[
    Annotated[
        Annotated[Probability, Tag("number")] | Annotated[Rates, Tag("row")],
        Discriminator(_number_or_row),
    ],
    ...,
]
"""A number for each shape, the diagonal of a matrix, or a row of it for each."""

Push = Annotated[float, Field(ge=0.0005, le=0.02)]
Wiggle = Annotated[float, Field(ge=0, le=0.01)]
Spread = Annotated[float, Field(ge=0.0001, le=0.02)]
_PER_S2: dict[str, Any] = {"unit": "1/s²"}
_ACTIONS: dict[str, Any] = {"unit": "actions"}
_ATTEMPTS: dict[str, Any] = {"unit": "attempts"}
_EPOCHS: dict[str, Any] = {"unit": "epochs"}
"""Units of keys whose names do not end in one."""
Window = Annotated[int, Field(ge=1, le=1000, json_schema_extra=_ACTIONS)]
MAX_EPOCHS = 1_000_000
Channels = Annotated[int, Field(ge=1, le=512)]

_ERROR_KNOTS_M = (0.0, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.0175)
_SUCCESS_BY_ERROR = (
    (0.987, 0.973, 0.840, 0.620, 0.153, 0.347, 0.307, 0.093, 0.060, 0.0),
    (0.993, 0.993, 0.927, 0.780, 0.567, 0.620, 0.407, 0.100, 0.067, 0.0),
    (0.987, 0.980, 0.873, 0.653, 0.313, 0.400, 0.327, 0.093, 0.060, 0.0),
)

STRICT = ConfigDict(extra="forbid", strict=True)

Metres = Annotated[float, Field(ge=-0.03, le=0.03, json_schema_extra={"unit": "m"})]
Corners = tuple[Metres, Metres, Metres, Metres]
LEAST_SIDE_M = 0.001
"""Of a rectangle: what is thinner bends, and a rigid body does not."""


@dataclass(frozen=True, config=STRICT)
class Shape:
    """The cross-section of a peg: a union of rectangles, which is extruded. Its hole is wider on every side.

    Example:
        >>> import mjx_fit as mf
        >>> mf.Shape("slot", ((-0.02, -0.005, 0.02, 0.005),)).half_width_m
        0.02

    Attributes:
        name: What it is called in files and figures.
        rectangles: Of each the lower and the upper corner, x, y, x, y in m from the axis of the tool, along
            the world's axes: as the peg stands in its hole, seen from above. They may stand apart, like the
            prongs of a plug: the tool holds each.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
    rectangles: Annotated[tuple[Corners, ...], Field(min_length=1, max_length=4)]

    @model_validator(mode="after")
    def _corners_in_order(self) -> "Shape":
        for x0, y0, x1, y1 in self.rectangles:
            if min(x1 - x0, y1 - y0) < LEAST_SIDE_M:
                raise ValueError(
                    f"rectangles: {[x0, y0, x1, y1]} is not allowed in {self.name!r}: it must be a lower "
                    f"and an upper corner, and no side shorter than {LEAST_SIDE_M}"
                )
        return self

    @property
    def half_width_m(self) -> float:
        """Half the side of the square around the axis that holds it: pegs and plates are never turned."""
        return max(abs(edge) for rectangle in self.rectangles for edge in rectangle)

    def covers(self, x: float, y: float) -> bool:
        """Whether a point lies in it, in m from the axis."""
        return any(x0 <= x <= x1 and y0 <= y <= y1 for x0, y0, x1, y1 in self.rectangles)

    @property
    def is_its_own_mirror_image(self) -> bool:
        """In the plane y = 0."""
        xs = sorted({edge for x0, _, x1, _ in self.rectangles for edge in (x0, x1)})
        ys = sorted({edge for _, y0, _, y1 in self.rectangles for edge in (y0, y1, -y0, -y1)})
        middles = [((a + b) / 2, (c + d) / 2) for a, b in pairwise(xs) for c, d in pairwise(ys)]
        return all(self.covers(x, y) == self.covers(x, -y) for x, y in middles)


SHAPES = (
    Shape("cross", ((-0.020, -0.010, 0.020, 0.010), (-0.010, -0.020, 0.010, 0.020))),
    Shape("rectangle", ((-0.020, -0.0125, 0.020, 0.0125),)),
    Shape("square", ((-0.015, -0.015, 0.015, 0.015),)),
)


@dataclass(frozen=True, config=STRICT)
class SceneConfig:
    """Robot, geometry and contact.

    Attributes:
        robot: Name of the arm (``mjx_fit.robot``).
        shapes: Cross-sections of pegs and holes. One for each type, 1 to 12; their names differ.
        clearance_m: Gap between peg and hole per side.
        plate_half_width_m: Half the side of the square socket. A detector error of 2.83 cm, a spiral of
            1.5 cm and half a peg (2 cm for ours) must stay inside it.
        hole_depth_m: Depth of the hole to its floor.
        peg_length_m: Length of the peg below the sensor.
        friction: Coulomb friction, peg and socket. As of two dry, smooth plastics or metals.
        contact_time_s: MuJoCo's solref time constant. At ten simulation steps the force of a sliding peg is
            mostly smooth; at three it is a train of single-step spikes.
        contact_width_m: MuJoCo's solimp width. Keep it below a quarter of the clearance.
        max_contacts: Contact slots of one world in MJX.
    """

    robot: Literal[tuple(ROBOTS)] = "panda"  # pyright: ignore[reportInvalidTypeForm]
    shapes: Annotated[tuple[Shape, ...], Field(min_length=1, max_length=MOST_TYPES)] = SHAPES
    clearance_m: Annotated[float, Field(ge=0.0001, le=0.005)] = 0.001
    plate_half_width_m: Annotated[float, Field(ge=0.08, le=0.2)] = 0.08
    hole_depth_m: Annotated[float, Field(ge=0.03, le=0.08)] = 0.035
    peg_length_m: Annotated[float, Field(ge=0.05, le=0.15)] = 0.07
    friction: Annotated[float, Field(ge=0, le=2)] = 0.3
    contact_time_s: Annotated[float, Field(ge=0.004, le=0.05)] = 0.01
    contact_width_m: Annotated[float, Field(ge=0.00001, le=0.001)] = 0.00025
    max_contacts: Annotated[int, Field(ge=4, le=64, json_schema_extra={"unit": "contacts"})] = 8

    @model_validator(mode="after")
    def _names_differ(self) -> "SceneConfig":
        if len(set(self.names)) < self.n_types:
            raise ValueError(f"shapes: {', '.join(self.names)} are not allowed: the names must differ")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Of the shapes."""
        return tuple(shape.name for shape in self.shapes)

    @property
    def n_types(self) -> int:
        """Number of shapes, C."""
        return len(self.shapes)


@dataclass(frozen=True, config=STRICT)
class ControlConfig:
    """Operational-space control, 500 Hz torque.

    Attributes:
        kp_position: Position stiffness over inertia. At 2000 a peg that was caught on an edge met the joints'
            torque limits, and tilted by 36°; at 1400 none did by more than 3°.
        kp_orientation: Rotation stiffness over inertia.
        damping_ratio: Damping ratio ζ of both. 1 would be critical if position and rotation did not move each
            other; they do, and 1.2 keeps the overshoot of a 2 cm step below 5 % wherever a hole may be.
        kp_posture: Posture stiffness over inertia. It acts in the null space of the task, critically damped.
    """

    kp_position: Annotated[float, Field(ge=50, le=1400, json_schema_extra=_PER_S2)] = 600.0
    kp_orientation: Annotated[float, Field(ge=100, le=4000, json_schema_extra=_PER_S2)] = 600.0
    damping_ratio: Annotated[float, Field(ge=0.5, le=5)] = 1.2
    kp_posture: Annotated[float, Field(ge=0, le=400, json_schema_extra=_PER_S2)] = 10.0


@dataclass(frozen=True, config=STRICT)
class SpiralConfig:
    """Algorithm 4 of the paper.

    Attributes:
        radius_m: Radius r_max at the end.
        turns: Revolutions n_rot in one attempt. 40 are already more than the end effector follows.
        push_m: Depth δz of the goal below the TCP.
        wiggle_m: Exploration noise σ per axis. At most ``push_m``, since 0.8 σ of it points up.
    """

    radius_m: Annotated[float, Field(ge=0.0001, le=0.18)] = 0.015
    turns: Annotated[float, Field(ge=0.01, le=40, json_schema_extra={"unit": "turns"})] = 2.0
    push_m: Push = 0.004
    wiggle_m: Wiggle = 0.00125


@dataclass(frozen=True, config=STRICT)
class RandomConfig:
    """The random policy of data collection: sweeps between random way-points, pressed on the plate.

    Attributes:
        reach_m: Half width of the way-point square. Way-points are uniform in it, around the estimate.
        actions_per_sweep: Actions between two way-points.
        push_m: Depth of the goal below the TCP.
        wiggle_m: Exploration noise σ per axis.
    """

    reach_m: Annotated[float, Field(ge=0.0001, le=0.18)] = 0.025
    actions_per_sweep: Annotated[int, Field(ge=1, le=1000, json_schema_extra=_ACTIONS)] = 12
    push_m: Push = 0.004
    wiggle_m: Wiggle = 0.00125


@dataclass(frozen=True, config=STRICT)
class DetectorConfig:
    """The simulated hole detector.

    Attributes:
        kind: Distribution of the error. ``square``: uniform per axis; ``disc``: direction and radius uniform.
        half_width_m: Largest error per axis or radius. Per axis for ``square``, radius for ``disc``.
        prior_std_m: Initial σ of the belief per axis. Σ0 = σ_init I with σ_init = 1 cm².
    """

    kind: Literal["square", "disc"] = "square"
    half_width_m: Annotated[float, Field(ge=0, le=0.03)] = 0.02
    prior_std_m: Annotated[float, Field(ge=0.0001, le=0.1)] = 0.01


@dataclass(frozen=True, config=STRICT)
class SequenceConfig:
    """Estimates from which later attempts of a collected sequence start, spread as a filter's may be.

    Attributes:
        min_std_m: Smallest σ of a drawn estimate. It is the one along an axis of the covariance.
        max_std_m: Largest σ of a drawn estimate. Both are drawn between these, log-uniform, their direction
            uniform.
    """

    min_std_m: Spread = 0.001
    max_std_m: Spread = 0.008

    @model_validator(mode="after")
    def _ordered(self) -> "SequenceConfig":
        if self.min_std_m > self.max_std_m:
            raise ValueError(f"min_std_m: {self.min_std_m} is not allowed: it must be at most max_std_m")
        return self


@dataclass(frozen=True, config=STRICT)
class WristConfig:
    """The force/torque sensor. Noise: Robotiq FT 300-S, 1 σ per sample.

    Attributes:
        force_noise_n: Noise σ of Fx, Fy and Fz.
        torque_xy_noise_nm: Noise σ of Tx and Ty.
        torque_z_noise_nm: Noise σ of Tz.
        tare_samples: Samples averaged for the tare. 100,000 take 200 s.
        contact_force_n: RMS force that counts as contact. Over one action, tared; noise alone is √3 σ.
    """

    force_noise_n: Annotated[float, Field(ge=0, le=30)] = 0.1
    torque_xy_noise_nm: Annotated[float, Field(ge=0, le=3)] = 0.005
    torque_z_noise_nm: Annotated[float, Field(ge=0, le=3)] = 0.003
    tare_samples: Annotated[int, Field(ge=1, le=100_000, json_schema_extra={"unit": "samples"})] = 50
    contact_force_n: Annotated[float, Field(ge=0.01, le=50)] = 1.0


_SUCCESS_PROBABILITY = (0.118, 0.162, 0.117)
LEAST_STEP_M = 0.00001
"""Between distances, for single precision to tell them apart."""


@dataclass(frozen=True, config=STRICT)
class TaskConfig:
    """The high-level task.

    Attributes:
        n_holes: Holes, and pegs, in one assembly.
        max_attempts: Attempts before a human helps. At one peg.
        attempt_actions: Length J of one attempt.
        insertion_depth_m: Depth that counts as inserted. The end effector is at least this far below the
            plate's top, in the hole.
        success_probability: Success rates α by shape. Those of the outcome model: a number for
            each shape, the success rate of a matched attempt; or a matrix, a row for each peg with a number
            for each hole, where a peg goes into holes of other types, too. The default (null) is what
            ``evaluate attempt --trials 1000`` measured for cross, rectangle and square with everything else
            at its default, and their mean for each shape of other ``scene.shapes``: a guess. Measure it again
            when you change the detector, the scene or the control.
        outcome_model: How success is predicted. α is ``constant`` per shape, as in the paper, or follows
            from the ``covariance`` of the belief: the mean of ``success_by_error`` over the belief where the
            types match (``mjx_fit.filters.success``).
        error_knots_m: Errors at which α is known. Distances of the estimate from the hole.
        success_by_error: Success rates at these errors. A list for each shape, of matched attempts. The
            default (null) is what ``experiments/physics/alpha.py error`` measured for cross, rectangle and
            square with everything else at its default, and their mean for each shape of other
            ``scene.shapes``.
        hard_match: Update the type by the arg max. h_match's, as in Algorithm 3; otherwise by the mean over
            its probabilities, as in training. H is learned with the latter, and is too sure for the former.
    """

    n_holes: Annotated[int, Field(ge=1, le=8, json_schema_extra={"unit": "holes"})] = 5
    max_attempts: Annotated[int, Field(ge=1, le=1000, json_schema_extra=_ATTEMPTS)] = 30
    attempt_actions: Annotated[int, Field(ge=1, le=400, json_schema_extra=_ACTIONS)] = 100
    insertion_depth_m: Annotated[float, Field(ge=0.001, le=0.025)] = 0.01
    success_probability: Alphas | None = None
    outcome_model: Literal["constant", "covariance"] = "constant"
    error_knots_m: Annotated[
        tuple[Annotated[float, Field(ge=0, le=0.1)], ...], Field(min_length=1, max_length=100)
    ] = _ERROR_KNOTS_M
    success_by_error: tuple[Rates, ...] | None = None
    hard_match: bool = False

    @model_validator(mode="after")
    def _one_rate_for_each_knot(self) -> "TaskConfig":
        knots = self.error_knots_m
        if any(after - before < LEAST_STEP_M for before, after in pairwise(knots)):
            raise ValueError(
                f"error_knots_m: {shown(list(knots))} is not allowed: they must ascend, by {LEAST_STEP_M} "
                "at least"
            )
        for rates in self.success_by_error or _SUCCESS_BY_ERROR:
            if len(rates) != len(knots):
                raise ValueError(
                    f"success_by_error: {shown(list(rates))} is not allowed: there must be a rate for "
                    f"each of error_knots_m, {len(knots)}"
                )
        return self

    @model_validator(mode="after")
    def _rows_of_one_matrix(self) -> "TaskConfig":
        alphas = self.success_probability or ()
        rows = [row for row in alphas if isinstance(row, tuple)]
        if rows and [len(row) for row in rows] != [len(alphas)] * len(alphas):
            raise ValueError(
                f"success_probability: {shown(list(alphas))} is not allowed: it must hold a number for each "
                "shape, or a row for each with a number for each"
            )
        for i, row in enumerate(rows):
            if row[i] < LEAST_PROBABILITY:
                raise ValueError(
                    f"success_probability.{i}.{i}: {row[i]} is not allowed: a peg that matches its hole "
                    f"must have {LEAST_PROBABILITY} at least"
                )
        return self

    def for_shapes(self, shapes: tuple[Shape, ...]) -> "TaskConfig":
        """The same with rates where there were none (null): the default ones for these shapes."""
        alphas, by_error = self.success_probability, self.success_by_error
        if alphas is None:
            mean = round(float(np.mean(_SUCCESS_PROBABILITY)), 6)
            alphas = _SUCCESS_PROBABILITY if shapes == SHAPES else (mean,) * len(shapes)
        if by_error is None:
            means = tuple(np.mean(_SUCCESS_BY_ERROR, axis=0).round(6).tolist())
            by_error = _SUCCESS_BY_ERROR if shapes == SHAPES else (means,) * len(shapes)
        return replace(self, success_probability=alphas, success_by_error=by_error)


@dataclass(frozen=True, config=STRICT)
class SensorConfig:
    """The learned sensors: encoders e1 and e2, heads h_pos and h_match.

    Attributes:
        width: Size of encoder outputs and tokens.
        conv_channels: Channels of the wrench encoder. One for each of its five layers.
        layers: Transformer layers.
        heads: Attention heads.
        feedforward: Width of the feed-forward part.
        dropout: Dropout rate of the transformer.
        positional: Encode the place in time.
        causal: Attend to the past only.
        noise: What the noise model R depends on. The ``peg`` alone, as in the paper, or the ``trace``, too.
        reference: Origin of measured positions. The ``estimate``, or the ``final`` position of the end
            effector, which makes it the frame-by-frame baseline. ``mjx-fit train`` trains both.
        contact_features: Add contact features to tokens. Mean and spread of the wrench, and the centre of
            pressure; the paper's tokens hold the wrench alone.
        places: Weighted mean positions; 0: none. Means, over the attempt, of where the end effector was and
            where it was pressed, that join what the maximum over time gives. The paper has none.
    """

    width: Annotated[int, Field(ge=4, le=512, multiple_of=4)] = 64
    conv_channels: tuple[Channels, Channels, Channels, Channels, Channels] = (16, 32, 64, 64, 64)
    layers: Annotated[int, Field(ge=1, le=32)] = 4
    heads: Annotated[int, Field(ge=1, le=64)] = 4
    feedforward: Annotated[int, Field(ge=1, le=4096)] = 128
    dropout: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    positional: bool = False
    causal: bool = False
    noise: Literal["peg", "trace"] = "trace"
    reference: Literal["estimate", "final"] = "estimate"
    contact_features: bool = True
    places: Annotated[int, Field(ge=0, le=64)] = 8


@dataclass(frozen=True, config=STRICT)
class TrainConfig:
    """Training of the differentiable filters.

    Attributes:
        epochs: Passes over the training data. One window from each episode per pass.
        batch_size: Windows in one step.
        learning_rate: Adam's largest learning rate. No weight moves farther than that in a step.
        schedule: Schedule of the learning rate. ``constant``, or ``cosine``: a half wave from 1 to 0 over all
            epochs.
        adam_b2: Adam's β2.
        weight_decay: AdamW's weight decay.
        mirror: Mirror every second window. In the robot's plane of symmetry; for shapes that are their own
            mirror image alone.
        min_window: Shortest window.
        max_window: Longest window. Shorter ones are padded to this.
        sequence: Attempts chained in one example. In a row at one hole, each with the belief that the ones
            before have left; 1: every window alone, from the prior that was stored with it. For more the
            data must be collected with as many (``--sequence``) and with a sensor's own beliefs (``--run``),
            and windows should be whole attempts: where the second began says what the first had said.
        validation_fraction: Share of validation episodes.
        patience: Epochs without gain; 0: no limit. Training stops early after this many without a better
            validation NLL.
        baseline_share: Baseline's share of the epochs. The frame-by-frame baseline is trained after the
            sensor; 0: leave it out.
    """

    epochs: Annotated[int, Field(ge=1, le=MAX_EPOCHS, json_schema_extra=_EPOCHS)] = 30
    batch_size: Annotated[int, Field(ge=1, le=16_384, json_schema_extra={"unit": "windows"})] = 32
    learning_rate: Annotated[float, Field(ge=1e-12, le=1)] = 1e-3
    schedule: Literal["constant", "cosine"] = "cosine"
    adam_b2: Annotated[float, Field(ge=0.1, le=0.99999)] = 0.99
    weight_decay: Annotated[float, Field(ge=0, le=10)] = 0.01
    mirror: bool = True
    min_window: Window = 20
    max_window: Window = 100
    sequence: Annotated[int, Field(ge=1, le=30, json_schema_extra=_ATTEMPTS)] = 1
    validation_fraction: Annotated[float, Field(ge=0.001, le=0.9)] = 0.1
    patience: Annotated[int, Field(ge=0, le=1_000_000, json_schema_extra=_EPOCHS)] = 0
    baseline_share: Annotated[float, Field(ge=0, le=1)] = 0.5


FIRST_SENSOR = SensorConfig(noise="peg", contact_features=False, places=0)
FIRST_TRAIN = TrainConfig(
    epochs=5000,
    batch_size=128,
    learning_rate=1e-4,
    schedule="constant",
    weight_decay=0.0,
    mirror=False,
    baseline_share=1.0,
)
"""The paper's, which were the first defaults: what a key means where a stored file is older than the key."""
