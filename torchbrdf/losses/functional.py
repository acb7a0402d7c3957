"""Losses as functions: what each module of `torchbrdf.losses` computes, without making one.

Each takes a prediction and a target, BRDF values in 1/sr without the cosine, `(..., N, C)`; Pairs of shape `(..., N)`
where the loss needs some; a weight that broadcasts to the values, or None; and the reduction over materials.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from torch import Tensor

from torchbrdf.losses.compressed import CompressedLoss
from torchbrdf.losses.cosine import CosineRMSLoss
from torchbrdf.losses.cube_root import CubeRootLoss
from torchbrdf.losses.learned import LearnedLoss
from torchbrdf.losses.log import LogLoss
from torchbrdf.losses.metric_file import read_metric
from torchbrdf.losses.rms import RMSLoss
from torchbrdf.losses.solid_angle import SolidAngleCosineRMSLoss
from torchbrdf.pairs import Pairs
from torchbrdf.reduction import Reduction

__all__ = ["compressed", "cosine_rms", "cube_root", "learned", "log", "rms", "solid_angle_cosine_rms"]


def rms(prediction: Tensor, target: Tensor, weight: Tensor | None = None, *, reduction: Reduction = "mean") -> Tensor:
    """Root mean square error, `RMSLoss`.

    Example:
        >>> import torch
        >>> rms(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3))
        tensor(2.)
    """
    return RMSLoss(reduction)(prediction, target, None, weight)


def cosine_rms(
    prediction: Tensor,
    target: Tensor,
    pairs: Pairs,
    weight: Tensor | None = None,
    *,
    reduction: Reduction = "mean",
) -> Tensor:
    """Root mean square error of values times cos_i, `CosineRMSLoss`.

    Example:
        >>> import torch
        >>> pairs = Pairs.from_cosines(cos_i=torch.full((5,), 0.5))
        >>> cosine_rms(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3), pairs, reduction="none")
        tensor([1., 1.])
    """
    return CosineRMSLoss(reduction)(prediction, target, pairs, weight)


def cube_root(
    prediction: Tensor,
    target: Tensor,
    pairs: Pairs,
    weight: Tensor | None = None,
    *,
    eps: float = 1e-24,
    reduction: Reduction = "mean",
) -> Tensor:
    """Root of the mean cube root of squared differences of values times cos_i, `CubeRootLoss`.

    Example:
        >>> import torch
        >>> pairs = Pairs.from_cosines(cos_i=torch.ones(5))
        >>> cube_root(torch.full((2, 5, 3), 9.0), torch.ones(2, 5, 3), pairs)
        tensor(2.)
    """
    return CubeRootLoss(reduction, eps)(prediction, target, pairs, weight)


def compressed(
    prediction: Tensor,
    target: Tensor,
    pairs: Pairs,
    weight: Tensor | None = None,
    *,
    exponent: float = 1 / 3,
    eps: float = 1e-9,
    reduction: Reduction = "mean",
) -> Tensor:
    """Root mean square difference of powers of values times cos_i, `CompressedLoss`.

    Example:
        >>> import torch
        >>> pairs = Pairs.from_cosines(cos_i=torch.ones(5))
        >>> compressed(torch.full((2, 5, 3), 9.0), torch.ones(2, 5, 3), pairs, exponent=0.5, eps=0.0)
        tensor(2.)
    """
    return CompressedLoss(exponent, reduction, eps)(prediction, target, pairs, weight)


def log(
    prediction: Tensor,
    target: Tensor,
    pairs: Pairs,
    weight: Tensor | None = None,
    *,
    reduction: Reduction = "mean",
) -> Tensor:
    """Root mean square difference of logarithms of 1 + value times cos_i, `LogLoss`.

    Example:
        >>> import torch
        >>> pairs = Pairs.from_cosines(cos_i=torch.ones(5))
        >>> f"{log(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3), pairs):.4f}"
        '0.6931'
    """
    return LogLoss(reduction)(prediction, target, pairs, weight)


def solid_angle_cosine_rms(
    prediction: Tensor,
    target: Tensor,
    pairs: Pairs,
    weight: Tensor | None = None,
    *,
    reduction: Reduction = "mean",
) -> Tensor:
    """Root mean square error of values times cos_i, weighed by solid angle, `SolidAngleCosineRMSLoss`.

    Example:
        >>> import torch
        >>> pairs = Pairs.from_half_diff(*torch.full((3, 5), 0.5))
        >>> values = torch.ones(2, 5, 3) / pairs.cos_i[:, None]
        >>> f"{solid_angle_cosine_rms(3 * values, values, pairs):.4f}"
        '2.0000'
    """
    return SolidAngleCosineRMSLoss(reduction)(prediction, target, pairs, weight)


def learned(
    prediction: Tensor,
    target: Tensor,
    pairs: Pairs,
    weight: Tensor | None = None,
    *,
    weights: str | Path | Mapping[str, Any] | None = None,
    reduction: Reduction = "mean",
) -> Tensor:
    """The learned distance, `LearnedLoss`.

    Example:
        >>> import torch
        >>> pairs = Pairs.from_half_diff(*torch.full((3, 5), 0.5))
        >>> bool(learned(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3), pairs) > 0)
        True
    """
    loss = LearnedLoss(reduction, _bundled() if weights is None else weights)
    return loss.to(prediction.device)(prediction, target, pairs, weight)


@cache
def _bundled() -> Mapping[str, Any]:
    """The constants that come with torchbrdf, read once."""
    return read_metric(None)
