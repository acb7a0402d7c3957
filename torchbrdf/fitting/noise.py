"""What error the noise of a measurement alone makes: below it there is nothing to fit."""

import math
from functools import cached_property, lru_cache
from typing import Any

import torch
from torch import Tensor

from torchbrdf.fitting.sampling import stratified
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.measured.noise import Noise, noise_of

# Pairs on which the error of the noise is worked out.
_PAIRS = 20_000
# Materials whose draws are kept for the next loss.
_KEPT = 100


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
    return NoiseRecords(measured).of(loss, seed)


class NoiseRecords:
    """The noise of M materials, worked out once for all losses.

    Args:
        measured: the materials.
    """

    def __init__(self, measured: Measured) -> None:
        self.measured = measured
        self._kept_draw = lru_cache(_KEPT)(self._draw)

    @torch.no_grad()
    def of(self, loss: Loss, seed: int = 0) -> list[dict[str, Any]]:
        """`noise_records` of a loss."""
        if loss.needs_rgb:
            return [{} for _ in self.measured.names]
        return [{} if noise is None else self._record(k, noise, loss, seed) for k, noise in enumerate(self._noises)]

    @cached_property
    def _noises(self) -> list[Noise | None]:
        return [noise_of(self.measured.batch([k])) for k in range(len(self.measured))]

    def _record(self, material: int, noise: Noise, loss: Loss, seed: int) -> dict[str, Any]:
        """With the error between a measurement and itself with more of its noise."""
        if type(loss).problem is Loss.problem and loss.supports_subsampling:
            problem, again = self._kept_draw(material, seed)
        else:
            own = self.measured.batch([material])
            index = stratified(len(own.pairs), _PAIRS, seed) if loss.supports_subsampling else None
            problem = loss.problem(own, None if index is None else index.to(own.device))
            again = problem.target + noise.like(problem.target, seed)
        error = loss.error(again, problem.target, problem.pairs, problem.weight)[0].item()
        if not math.isfinite(error):
            return {}
        return {"share": noise.share, "by": noise.by, "samples": noise.samples, "error": error}

    def _draw(self, material: int, seed: int) -> tuple[Problem, Tensor]:
        """A subset of a measurement, as most losses have it, and its values with more noise."""
        own, noise = self.measured.batch([material]), self._noises[material]
        assert noise is not None
        index = stratified(len(own.pairs), _PAIRS, seed)
        part = own if index is None else own.batch(samples=index.to(own.device))
        return Problem(part.pairs, part.values, part.weight), part.values + noise.like(part.values, seed)
