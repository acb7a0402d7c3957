"""What a fit solves, and what it is made from."""

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from torchbrdf.pairs import Pairs


@dataclass(frozen=True)
class Problem:
    """What a fit solves: find values on `pairs` that come close to `target` under `weight`.

    Args:
        pairs: of shape `(M|1, N)`.
        target: BRDF values in 1/sr, `(M, N, C)`.
        weight: how much each pair counts, `(M|1, N, 1|C)`; None: all the same.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_cosines(cos_i=torch.tensor([[0.5, 0.9]]))
        >>> problem = Problem(pairs, torch.ones(4, 2, 3))
        >>> problem.select(materials=torch.tensor([0, 2])).target.shape
        torch.Size([2, 2, 3])
    """

    pairs: Pairs
    target: Tensor
    weight: Tensor | None = None

    def select(self, materials: Tensor | None = None, samples: Tensor | None = None) -> "Problem":
        """Some materials and some of the pairs, by index, as `Pairs.select`."""
        target, weight = self.target, self.weight
        if materials is not None:
            target = target[materials]
            weight = weight[materials] if weight is not None and len(weight) > 1 else weight
        if samples is not None:
            target = target[:, samples]
            weight = weight[:, samples] if weight is not None and weight.shape[1] > 1 else weight
        return Problem(self.pairs.select(materials, samples), target, weight)


class MeasuredValues(Protocol):
    """What a loss asks of a measured BRDF."""

    @property
    def pairs(self) -> Pairs:
        """Directions, `(M|1, N)`."""
        ...

    @property
    def values(self) -> Tensor:
        """Values in 1/sr, `(M, N, C)`."""
        ...

    @property
    def weight(self) -> Tensor:
        """Weights, `(M|1, N, C|1)`."""
        ...

    @property
    def on_merl_bins(self) -> bool:
        """Whether the pairs are the centres of MERL's bins, all or a fair share of them."""
        ...

    def batch(self, materials: list[int] | None = None, samples: Tensor | None = None) -> "MeasuredValues":
        """Some materials and some of the samples, by index."""
        ...
