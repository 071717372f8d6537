"""Contact sensor and loss in idiomatic PyTorch: the baseline for ``train_step``.

Layers, sizes and loss are the same; the tests copy the weights and compare the results.
"""

# Only the extra `bench` installs PyTorch.
# pyright: reportMissingImports=false

from itertools import pairwise

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from mjx_fit.config.sections.learning import SensorConfig
from mjx_fit.data.windows import Sample
from mjx_fit.sensors import contact_sensor
from mjx_fit.sensors.contact_sensor import METRES_PER_CM
from mjx_fit.sensors.features import ROW_FEATURES
from mjx_fit.sensors.heads import H_INIT_LOGIT, MIN_STD_CM
from mjx_fit.utils.rates import SUBSTEPS

EPSILON = 1e-6
"""Epsilon of the layer norms: the default of Flax; PyTorch's is 1e-5."""


class WrenchEncoder(nn.Module):
    """Five convolutions with kernel 2 and stride 2; an odd number of steps gets a leading zero."""

    def __init__(self, channels: tuple[int, ...]):
        super().__init__()
        sizes = (6, *channels)
        self.layers = nn.ModuleList(nn.Conv1d(a, b, 2, stride=2) for a, b in pairwise(sizes))
        steps = SUBSTEPS
        for _ in channels:
            steps = (steps + 1) // 2
        self.out_features = steps * channels[-1]

    def forward(self, wrench: Tensor) -> Tensor:
        batch, length = wrench.shape[:2]
        x = wrench.flatten(0, 1).transpose(1, 2)
        for layer in self.layers:
            x = F.leaky_relu(layer(F.pad(x, (x.shape[-1] % 2, 0))))
        return x.transpose(1, 2).reshape(batch, length, -1)


class Block(nn.Module):
    """Pre-norm self-attention and feed-forward."""

    def __init__(self, config: SensorConfig):
        super().__init__()
        width = config.width
        self.heads = config.heads
        self.attention_norm = nn.LayerNorm(width, eps=EPSILON)
        self.query_key_value = nn.Linear(width, 3 * width, bias=False)
        self.attention_out = nn.Linear(width, width)
        self.feedforward_norm = nn.LayerNorm(width, eps=EPSILON)
        self.up, self.down = nn.Linear(width, config.feedforward), nn.Linear(config.feedforward, width)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        batch, length, width = x.shape
        qkv = self.query_key_value(self.attention_norm(x)).reshape(batch, length, 3, self.heads, -1)
        query, key, value = qkv.permute(2, 0, 3, 1, 4)
        attended = F.scaled_dot_product_attention(query, key, value, attn_mask=mask[:, None, None, :])
        x = x + self.attention_out(attended.transpose(1, 2).reshape(batch, length, width))
        return x + self.down(F.relu(self.up(self.feedforward_norm(x))))


class SkipMLP(nn.Module):
    """Three linear layers with skip connections over the first two."""

    def __init__(self, width: int):
        super().__init__()
        self.first, self.second, self.last = (
            nn.Linear(width, width),
            nn.Linear(width, width),
            nn.Linear(width, 2),
        )

    def forward(self, x: Tensor) -> Tensor:
        x = x + F.leaky_relu(self.first(x))
        x = x + F.leaky_relu(self.second(x))
        return self.last(x)


def _row_features(config: SensorConfig) -> int:
    return ROW_FEATURES - (config.pose == "start")


class ContactSensor(nn.Module):
    """Encoders, heads and noise models, for standardised inputs."""

    def __init__(self, config: SensorConfig, n_types: int = 3):
        super().__init__()
        self.n_types = n_types
        self.wrench_encoder = WrenchEncoder(config.conv_channels)
        self.token = nn.Linear(self.wrench_encoder.out_features + _row_features(config), config.width)
        self.blocks = nn.ModuleList(Block(config) for _ in range(config.layers))
        self.norm = nn.LayerNorm(config.width, eps=EPSILON)
        self.peg_encoder = nn.Embedding(n_types, config.width)
        self.position, self.match = SkipMLP(2 * config.width), SkipMLP(2 * config.width)
        self.position_noise = nn.Embedding(n_types, 3)
        self.match_model = nn.Embedding(n_types, n_types * 2)
        nn.init.zeros_(self.position_noise.weight)
        diagonal = torch.eye(n_types)
        self.match_model.weight.data = H_INIT_LOGIT * torch.stack([1 - diagonal, diagonal], -1).flatten(1)

    def forward(
        self, wrench: Tensor, rows: Tensor, mask: Tensor, peg_type: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return the innovation (cm), R (cm²), match logits and log H."""
        x = self.token(torch.cat([self.wrench_encoder(wrench), rows], -1))
        for block in self.blocks:
            x = block(x, mask)
        trace_code = self.norm(x).masked_fill(~mask[..., None], -torch.inf).amax(1)
        code = torch.cat([trace_code, self.peg_encoder(peg_type)], -1)
        raw = self.position_noise(peg_type)
        diagonal = F.softplus(raw[:, :2]) + MIN_STD_CM
        tril = torch.diag_embed(diagonal)
        tril = tril + F.pad(raw[:, 2:, None], (0, 1, 1, 0))
        logits = self.match_model(peg_type).reshape(-1, self.n_types, 2)
        return self.position(code), tril @ tril.mT, self.match(code), logits.log_softmax(-1)


def filter_loss(observed: tuple[Tensor, ...], sample: dict[str, Tensor]) -> Tensor:
    """Compute the loss of each window, with lengths in cm."""
    innovation, noise, match_logits, match_model_logp = observed
    cov = sample["prior_cov"]
    gain = torch.cholesky_solve(cov, torch.linalg.cholesky(cov + noise)).mT
    residual = torch.eye(2) - gain
    new_cov = residual @ cov @ residual.mT + gain @ noise @ gain.mT
    error = sample["offset"] - (gain @ innovation[..., None])[..., 0]
    chol = torch.linalg.cholesky((new_cov + new_cov.mT) / 2)
    whitened = torch.linalg.solve_triangular(chol, error[..., None], upper=False)[..., 0]
    position = chol.diagonal(dim1=-2, dim2=-1).log().sum(-1) + 0.5 * whitened.square().sum(-1)
    o_logp = match_logits.log_softmax(-1)
    likelihood = torch.logsumexp(o_logp[:, None] + match_model_logp, -1)
    type_logp = (sample["type_logp"] + likelihood).log_softmax(-1)
    type_nll = -type_logp.gather(1, sample["hole_type"][:, None])[:, 0]
    match_nll = -o_logp.gather(1, (sample["hole_type"] == sample["peg_type"]).long()[:, None])[:, 0]
    return position + torch.where(sample["judged"], type_nll + match_nll, 0.0)


def copy_weights(sensor: contact_sensor.ContactSensor, twin: ContactSensor) -> None:
    """Copy the weights of a sensor to the twin."""
    encoder = sensor.trace_encoder
    for ours, theirs in zip(encoder.wrench_encoder.layers, twin.wrench_encoder.layers, strict=True):
        kernel = _tensor(ours.kernel).T  # (out, 2 in), the two steps side by side
        theirs.weight.data = kernel.reshape(len(kernel), 2, -1).transpose(1, 2).contiguous()
        theirs.bias.data = _tensor(ours.bias)
    linear = [(encoder.token, twin.token)]
    norms = [(encoder.norm, twin.norm)]
    for ours, theirs in zip(encoder.blocks, twin.blocks, strict=True):
        norms += [(getattr(ours, n), getattr(theirs, n)) for n in ("attention_norm", "feedforward_norm")]
        names = ("query_key_value", "attention_out", "up", "down")
        linear += [(getattr(ours, name), getattr(theirs, name)) for name in names]
    for head in ("position", "match"):
        ours, theirs = getattr(sensor, head), getattr(twin, head)
        linear += [(getattr(ours, name), getattr(theirs, name)) for name in ("first", "second", "last")]
    for ours, theirs in linear:
        theirs.weight.data = _tensor(ours.kernel).T.contiguous()
        if theirs.bias is not None:
            theirs.bias.data = _tensor(ours.bias)
    for ours, theirs in norms:
        theirs.weight.data, theirs.bias.data = _tensor(ours.scale), _tensor(ours.bias)
    for ours, theirs in (
        (sensor.peg_encoder, twin.peg_encoder),
        (sensor.position_noise.raw, twin.position_noise),
        (sensor.match_model.logits, twin.match_model),
    ):
        theirs.weight.data = _tensor(ours.embedding)


def inputs_of(
    sensor: contact_sensor.ContactSensor, sample: Sample
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Convert a batch of windows to the inputs of the twin and of its loss."""
    reading = sample.reading
    mask = _tensor(reading.mask)
    wrench = _standard(_tensor(reading.wrench_sensor), _tensor(sensor.wrench_scale))
    rows = _standard(
        _tensor(contact_sensor.row_features(reading, as_vector=sensor.from_start)),
        _tensor(sensor.row_scale),
    )
    peg_type = _tensor(reading.peg_type).long()
    inputs = {
        "wrench": torch.where(mask[..., None, None], wrench, 0.0),
        "rows": torch.where(mask[..., None], rows, 0.0),
        "mask": mask,
        "peg_type": peg_type,
    }
    truth = {
        "prior_cov": _tensor(sample.prior.pos_cov) / METRES_PER_CM**2,
        "offset": _tensor(sample.place_world - sample.prior.mean_world) / METRES_PER_CM,
        "type_logp": _tensor(sample.prior.type_logp),
        "hole_type": _tensor(sample.hole_type).long(),
        "judged": _tensor(sample.judged),
        "peg_type": peg_type,
    }
    return inputs, truth


def _standard(x: Tensor, scale: Tensor) -> Tensor:
    return (x - scale[0]) / scale[1]


def _tensor(x) -> Tensor:
    return torch.from_numpy(np.array(x))
