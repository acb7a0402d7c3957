"""Answers that observers would give if a scale were true."""

import torch
from torch import Tensor


def simulated_wins(scale: Tensor, compared: Tensor, generator: torch.Generator) -> Tensor:
    """Random wins `(..., n, n)` under case V: of compared[i, j] comparisons, i wins each with Phi(s_i - s_j).

    scale `(..., n)`, nan where a stimulus is not compared; compared `(..., n, n)`, symmetric counts. Their leading
    shapes are broadcast.
    """
    difference = (scale.unsqueeze(-1) - scale.unsqueeze(-2)).nan_to_num()
    # Above the diagonal only: each pair is drawn once.
    chance, count = torch.broadcast_tensors(torch.special.ndtr(difference), compared.triu(1))
    won = torch.binomial(count.contiguous(), chance.contiguous(), generator=generator)
    return won + (count - won).mT
