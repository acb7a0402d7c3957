"""What error the noise of a measurement alone makes: below it there is nothing to fit."""

import math
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchbrdf.fitting.sampling import stratified
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.measured.noise import Noise, noises_of

# Pairs on which the error of the noise is worked out.
_PAIRS = 20_000
# Pairs times materials of which it is worked out at once, and of how many such groups draws are kept for the next loss.
_TOGETHER, _KEPT = 1 << 18, 12


class NoiseRecords:
    """The noise of M materials, worked out once for all losses.

    Args:
        measured: the materials.

    Example:
        >>> from torchbrdf.losses import RMSLoss
        >>> from torchbrdf.measured import load, standins
        >>> NoiseRecords(load(standins()).batch([6])).of(RMSLoss())
        [{}]
    """

    def __init__(self, measured: Measured) -> None:
        self.measured = measured
        self._draws: dict[tuple[tuple[int, ...], int], tuple[Problem, Tensor]] = {}

    @torch.no_grad()
    def of(self, loss: Loss, seed: int = 0) -> list[dict[str, Any]]:
        """What samples tell of their noise, and the error that it alone makes, as records of fits say it.

        Args:
            loss: the error of what; losses of pictures have none.
            seed: of the noise that is drawn.

        Returns:
            For each material `share` (of the value, 1 sigma), what told it (`by`), how many samples, and `error`: that
            of the measurement beside itself with as much noise again; or nothing, where samples do not tell it.
        """
        found: list[dict[str, Any]] = [{} for _ in self.measured.names]
        if loss.needs_rgb:
            return found
        told = tuple((k, noise) for k, noise in enumerate(self._noises) if noise is not None)
        size = max(1, _TOGETHER // max(len(self.measured.pairs), 1))
        for some in (told[k : k + size] for k in range(0, len(told), size)):
            errors = self._errors(tuple(k for k, _ in some), loss, seed)
            for (k, noise), error in zip(some, errors, strict=True):
                if math.isfinite(error):
                    found[k] = {"share": noise.share, "by": noise.by, "samples": noise.samples, "error": error}
        return found

    @cached_property
    def _noises(self) -> list[Noise | None]:
        return noises_of(self.measured)

    def _errors(self, materials: tuple[int, ...], loss: Loss, seed: int) -> list[float]:
        """Of each material the error between its measurement and itself with more of its noise."""
        if type(loss).problem is Loss.problem and loss.supports_subsampling:
            problem, again = self._draw(materials, seed)
        else:
            own = self.measured.batch(list(materials))
            index = stratified(len(own.pairs), _PAIRS, seed) if loss.supports_subsampling else None
            problem = loss.problem(own, None if index is None else index.to(own.device))
            again = self._noisy(materials, problem.target, seed)
        found: list[float] = loss.error(again, problem.target, problem.pairs, problem.weight).tolist()
        return found

    def _draw(self, materials: tuple[int, ...], seed: int) -> tuple[Problem, Tensor]:
        """A subset of measurements, as most losses have it, and its values with more noise; kept for the next loss."""
        if (kept := self._draws.get((materials, seed))) is not None:
            return kept
        own = self.measured.batch(list(materials))
        index = stratified(len(own.pairs), _PAIRS, seed)
        part = own if index is None else own.batch(samples=index.to(own.device))
        made = Problem(part.pairs, part.values, part.weight), self._noisy(materials, part.values, seed)
        while len(self._draws) >= _KEPT:
            del self._draws[next(iter(self._draws))]
        self._draws[materials, seed] = made
        return made

    def _noisy(self, materials: tuple[int, ...], values: Tensor, seed: int) -> Tensor:
        noises = (noise for k in materials if (noise := self._noises[k]) is not None)
        return values + torch.stack([noise.like(own, seed) for noise, own in zip(noises, values, strict=True)])
