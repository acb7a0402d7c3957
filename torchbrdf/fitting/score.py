"""Errors of fitted models on every valid sample, and the paper's test for local minima."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured
from torchbrdf.workers import each

# Pairs of a batch times its materials: about 20 arrays of three float32 channels of this size are alive at a time.
BUDGET = 1_500_000


def groups(materials: int, pairs: int) -> Iterator[list[int]]:
    """Materials in batches: one for each thread, or more where their pairs would not fit into the memory budget."""
    threads = torch.get_num_threads()
    size = max(1, min(-(-materials // threads), BUDGET // threads // max(pairs, 1)))
    for first in range(0, materials, size):
        yield list(range(first, min(first + size, materials)))


def score(model: Lobe, measured: Measured, losses: Sequence[Loss]) -> Tensor:
    """The error of a batched model under each loss on every sample of `measured`, `(L, M)`, float64."""
    packed = model.pack()

    def score_some(rows: list[int]) -> Tensor:
        part = measured.batch(rows)
        fitted = model.unpack(packed[rows])
        predictions: dict[int, Tensor] = {}  # analytic losses share their pairs
        errors = []
        for loss in losses:
            problem = loss.problem(part)
            if id(problem.pairs) not in predictions:
                predictions[id(problem.pairs)] = fitted(problem.pairs)
            prediction = predictions[id(problem.pairs)]
            errors.append(loss.error(prediction, problem.target, problem.pairs, problem.weight).cpu())
        return torch.stack(errors)

    return torch.cat(list(each(score_some, groups(len(measured), len(measured.pairs)))), 1)


def local_minima(cross: Tensor, tolerance: float = 1e-4) -> Tensor:
    """The paper's test: which fits another loss's parameters beat.

    cross: `(L, L, M)`, the error under loss a of the parameters found under loss b, at [a, b]. A fit under a is an
    outlier, stuck in a local minimum, if some b has a lower error there by more than `tolerance`, relative: `(L, M)`.
    """
    own = torch.diagonal(cross, dim1=0, dim2=1).T
    return cross.amin(1) < own * (1 - tolerance)
