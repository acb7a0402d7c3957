"""What error the noise of a measurement alone makes: below it there is nothing to fit."""

import math
from typing import Any

import torch

from torchbrdf.fitting.sampling import stratified
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured
from torchbrdf.measured.noise import Noise, noise_of

# Pairs on which the error of the noise is worked out.
_PAIRS = 20_000


@torch.no_grad()
def noise_records(measured: Measured, loss: Loss, seed: int = 0) -> list[dict[str, Any]]:
    """The noise of each material, and the error of a fit that is off by nothing else.

    Args:
        measured: M materials.
        loss: By which the error is.
        seed: Of the draw.

    Returns:
        Of each material `share` of the value, `by` what it was told, by how many `samples`, and the `error`; nothing
        where noise is not to be told, or the loss is one of pictures.

    Example:
        >>> from torchbrdf.losses import RMSLoss
        >>> from torchbrdf.measured import load, standins
        >>> noise_records(load(standins()).batch([6]), RMSLoss())
        [{}]
    """
    return [_record(measured.batch([k]), loss, seed) for k in range(len(measured))]


def _record(material: Measured, loss: Loss, seed: int) -> dict[str, Any]:
    noise = None if loss.needs_rgb else noise_of(material)
    if noise is None:
        return {}
    error = _error(material, loss, noise, seed)
    if not math.isfinite(error):
        return {}
    return {"share": noise.share, "by": noise.by, "samples": noise.samples, "error": error}


def _error(material: Measured, loss: Loss, noise: Noise, seed: int) -> float:
    """The error between a measurement and itself with more of its noise."""
    index = stratified(len(material.pairs), _PAIRS, seed) if loss.supports_subsampling else None
    problem = loss.problem(material, None if index is None else index.to(material.device))
    again = problem.target + noise.like(problem.target, seed)
    return loss.error(again, problem.target, problem.pairs, problem.weight)[0].item()
