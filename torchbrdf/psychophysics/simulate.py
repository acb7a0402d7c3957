"""Answers that observers would give if a scale were true."""

import torch
from torch import Tensor


def simulated_wins(scale: Tensor, compared: Tensor, generator: torch.Generator) -> Tensor:
    """Simulate paired comparisons under Thurstone's case V: stimulus i wins over j with Phi(s_i - s_j).

    Args:
        scale: `(..., n)`, nan where a stimulus is not compared.
        compared: How often each pair is compared, symmetric, `(..., n, n)`; leading shapes are broadcast.
        generator: Of the random numbers.

    Returns:
        Wins `(..., n, n)`.

    Example:
        >>> compared = torch.tensor([[0.0, 9.0], [9.0, 0.0]], dtype=torch.float64)
        >>> wins = simulated_wins(torch.zeros(2).double(), compared, torch.Generator().manual_seed(0))
        >>> (wins + wins.mT).tolist()
        [[0.0, 9.0], [9.0, 0.0]]
    """
    difference = (scale.unsqueeze(-1) - scale.unsqueeze(-2)).nan_to_num()
    # Above the diagonal only: each pair is drawn once.
    chance, count = torch.broadcast_tensors(torch.special.ndtr(difference), compared.triu(1))
    won = torch.binomial(count.contiguous(), chance.contiguous(), generator=generator)
    return won + (count - won).mT
