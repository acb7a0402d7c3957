"""What error the noise of a measurement alone makes: below it there is nothing to fit."""

import math
from collections.abc import Sequence
from typing import Any

import torch

from torchbrdf.fitting.sampling import stratified
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured
from torchbrdf.measured.noise import Noise, noises_of

# Pairs on which the error of the noise is worked out.
_PAIRS = 20_000
# Pairs times materials of which it is worked out at once.
_TOGETHER = 1 << 18


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
    noises = [None] * len(measured) if loss.needs_rgb else noises_of(measured)
    size = max(1, _TOGETHER // max(len(measured.pairs), 1))
    found: list[dict[str, Any]] = [{} for _ in noises]
    told = [(k, noise) for k, noise in enumerate(noises) if noise is not None]
    for some in (told[k : k + size] for k in range(0, len(told), size)):
        errors = _errors(measured.batch([k for k, _ in some]), loss, [noise for _, noise in some], seed)
        for (k, noise), error in zip(some, errors, strict=True):
            if math.isfinite(error):
                found[k] = {"share": noise.share, "by": noise.by, "samples": noise.samples, "error": error}
    return found


def _errors(measured: Measured, loss: Loss, noises: Sequence[Noise], seed: int) -> list[float]:
    """Of each material the error between its measurement and itself with more of its noise."""
    index = stratified(len(measured.pairs), _PAIRS, seed) if loss.supports_subsampling else None
    problem = loss.problem(measured, None if index is None else index.to(measured.device))
    noise = [one.like(target, seed) for one, target in zip(noises, problem.target, strict=True)]
    again = problem.target + torch.stack(noise)
    found: list[float] = loss.error(again, problem.target, problem.pairs, problem.weight).tolist()
    return found
