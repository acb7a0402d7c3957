"""The features of the former form of the learned metric, until what trains it has moved to `LearnedLoss.terms`."""

from itertools import combinations
from typing import Any

import torch
from torch import Tensor

from torchbrdf.color import LUMINANCE
from torchbrdf.losses.bins import THETA_D, THETA_D_BINS, THETA_H, THETA_H_BINS, soft_bins
from torchbrdf.losses.learned import cosines
from torchbrdf.pairs import Pairs

__all__ = ["THETA_H_BINS", "encode", "features", "pack_weights", "schema", "soft_bins"]

FLOOR = 1e-4
SHRINKAGE = 1e-3
BIN_PAIRS = tuple(combinations(range(THETA_H_BINS), 2))
COLOR_FEATURES = ("luminance", "chroma")
SHAPES = {"mean": (THETA_H_BINS, THETA_D_BINS), "contrast": (len(BIN_PAIRS), THETA_D_BINS)}
POINTWISE = "pointwise"


def encode(values: Tensor, pairs: Pairs | None) -> Tensor:
    """(max(x, 0) cos_i cos_o + FLOOR)^(1/4), whose slope is finite everywhere."""
    raised, cosine = values.clamp_min(0), cosines(pairs)
    fits = cosine.dtype == raised.dtype and cosine.dim() <= raised.dim() and cosine.numel() == raised.shape[-2]
    # In place where possible: memory that is new costs more than the arithmetic.
    raised = (raised.mul_(cosine) if fits else raised * cosine).add_(FLOOR)
    return raised.sqrt().sqrt() if raised.requires_grad else raised.sqrt_().sqrt_()


def luminance_weights(values: Tensor) -> Tensor:
    """The share of each channel of values in luminance, `(C,)`."""
    channels = values.shape[-1]
    return values.new_tensor(LUMINANCE if channels == 3 else [1 / channels] * channels)


def contrasts(means: Tensor) -> Tensor:
    """Averages in bins as luminance and chroma, with their differences between two bins of theta_h.

    From `(..., C, BIN_COUNT)` to `(..., 1 + C, BIN_COUNT + differences)`: luminance first, then each channel's chroma.
    """
    lightness = (luminance_weights(means.mT) @ means)[..., None, :]
    means = torch.cat([lightness, means - lightness], -2)
    one, other = torch.tensor(BIN_PAIRS, dtype=torch.int64, device=means.device).unbind(1)
    rows = means.unflatten(-1, (THETA_H_BINS, THETA_D_BINS))
    return torch.cat([means, (rows[..., one, :] - rows[..., other, :]).flatten(-2)], -1)


def features(difference: Tensor, bins: Tensor) -> Tensor:
    """What the learned weights multiply, `(..., T)`, at least 0, in the order of `pack_weights`.

    difference: `(..., N, C)`; bins: `soft_bins`, in its dtype.
    """
    mass = bins.sum(-2, keepdim=True, dtype=torch.float64)
    mass = mass + SHRINKAGE * mass.sum(-1, keepdim=True)
    squares = difference.square().mean(-1)[..., None, :] @ bins / mass
    parts = contrasts((difference.mT @ bins).double() / mass).square()
    pointwise = squares[..., 0, :].unflatten(-1, (THETA_H_BINS, THETA_D_BINS)).sum(-1)
    return torch.cat([pointwise, parts[..., 0, :], parts[..., 1:, :].sum(-2)], -1)


def pack_weights(weights: Tensor) -> dict[str, Any]:
    """Weights `(T,)` in the order of `features`, by name, to four digits."""
    digits = [float(f"{value:.4g}") for value in weights.tolist()]
    rounded = torch.tensor(digits, dtype=torch.float64, device="cpu")
    found: dict[str, Any] = {POINTWISE: rounded[:THETA_H_BINS].tolist()} | {name: {} for name in SHAPES}
    for kind, row in zip(COLOR_FEATURES, rounded[THETA_H_BINS:].chunk(2), strict=True):
        start = 0
        for name, (rows, columns) in SHAPES.items():
            found[name][kind] = row[start : start + rows * columns].reshape(rows, columns).tolist()
            start += rows * columns
    return found


def schema() -> dict[str, Any]:
    """What the weights of a `metric.json` are the weights of."""
    return {"floor": FLOOR, "theta_h": list(THETA_H), "theta_d": list(THETA_D)}
