"""Configuration sections of the learned sensor and its training."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import ACTIONS_UNIT, ATTEMPTS_UNIT, EPOCHS_UNIT, STRICT

Window = Annotated[int, Field(ge=1, le=1000, json_schema_extra=ACTIONS_UNIT)]
MAX_EPOCHS = 1_000_000
Channels = Annotated[int, Field(ge=1, le=512)]


@dataclass(frozen=True, config=STRICT)
class SensorConfig:
    """Learned sensors: encoders e1 and e2, heads h_pos and h_match.

    Attributes:
        width: Size of codes and tokens.
        conv_channels: Channels of the wrench encoder. One number for each of its five layers.
        layers: Number of transformer layers.
        heads: Number of attention heads.
        feedforward: Width of the feed-forward part.
        dropout: Dropout rate of the transformer.
        positional: Add positional encodings.
        causal: Attend to the past only.
        noise: Input of the noise model R. The ``peg`` alone, as in the paper, or also the ``trace``.
        reference: Origin of measured positions. Either the ``estimate``, or the ``final`` position of the end
            effector, which gives the frame-by-frame baseline. ``mjx-fit train`` trains both.
        contact_features: Add contact features to tokens. These are mean and standard deviation of the wrench,
            and the centre of pressure; the paper's tokens contain the wrench alone.
        pose: Origin of heights and turns. Either the ``world``: the socket's top, and a
            quaternion; or the ``start`` of the attempt in free space, as a robot can measure them: a rotation
            vector, the same for a quaternion and its negative, and no input is scaled up beyond what a robot
            can tell apart.
        places: Weighted mean positions; 0: none. Each is an attention-weighted mean, over the attempt, of the
            TCP position and the centre of pressure; they are appended to the maximum over time. The paper has
            none.
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
    pose: Literal["world", "start"] = "start"
    places: Annotated[int, Field(ge=0, le=64)] = 8


@dataclass(frozen=True, config=STRICT)
class TrainConfig:
    """Training of the differentiable filters.

    Attributes:
        epochs: Passes over the training data. Each pass takes one window from every episode.
        batch_size: Windows per optimisation step.
        learning_rate: Adam's maximum learning rate. No weight changes by more than this in one step.
        schedule: Schedule of the learning rate. Either ``constant``, or ``cosine``: half a wave from 1 to 0
            over all epochs.
        adam_b2: Adam's β2.
        weight_decay: AdamW's weight decay.
        mirror: Mirror every second window. The mirror plane is the robot's plane of symmetry; it applies only
            to shapes that are their own mirror image.
        min_window: Shortest window.
        max_window: Longest window. Shorter ones are padded to this length.
        sequence: Attempts chained in one example. Consecutive attempts at one hole, each starting from the
            posterior of the previous ones; 1: independent windows, each with its stored prior. Values above 1
            require data collected with as many (``--sequence``) and with a sensor's own beliefs (``--run``);
            windows should then be whole attempts, since the start of the second reveals the posterior after
            the whole first one.
        every_action: Train after every action. The loss is the mean over the actions of a window of the loss
            of an update from the actions up to there, for sensors that read an attempt in progress
            (``sensor.causal``); otherwise that of the whole window.
        validation_fraction: Share of validation episodes.
        patience: Epochs without gain; 0: no limit. Training stops early after this many epochs without a
            better validation NLL.
        baseline_share: Baseline's share of the epochs. The frame-by-frame baseline is trained after the
            sensor; 0: skip it.
    """

    epochs: Annotated[int, Field(ge=1, le=MAX_EPOCHS, json_schema_extra=EPOCHS_UNIT)] = 50
    batch_size: Annotated[int, Field(ge=1, le=16_384, json_schema_extra={"unit": "windows"})] = 32
    learning_rate: Annotated[float, Field(ge=1e-12, le=1)] = 1e-3
    schedule: Literal["constant", "cosine"] = "cosine"
    adam_b2: Annotated[float, Field(ge=0.1, le=0.99999)] = 0.99
    weight_decay: Annotated[float, Field(ge=0, le=10)] = 0.01
    mirror: bool = True
    min_window: Window = 20
    max_window: Window = 100
    sequence: Annotated[int, Field(ge=1, le=30, json_schema_extra=ATTEMPTS_UNIT)] = 1
    every_action: bool = False
    validation_fraction: Annotated[float, Field(ge=0.001, le=0.9)] = 0.1
    patience: Annotated[int, Field(ge=0, le=1_000_000, json_schema_extra=EPOCHS_UNIT)] = 0
    baseline_share: Annotated[float, Field(ge=0, le=1)] = 0.2
