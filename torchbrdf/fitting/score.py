"""Errors of fitted models on every valid sample, and the paper's test for local minima."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from torchbrdf.fitting.data import chunked
from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.workers import each

# Pairs times materials that a thread holds at a time, at about 30 bytes each; the work on them is done in small parts.
BUDGET = 4_000_000


def groups(materials: int, pairs: int) -> Iterator[list[int]]:
    """Materials in batches: as many for each thread, and no more than the memory budget allows."""
    threads = torch.get_num_threads()
    most = max(1, BUDGET // max(pairs, 1))
    rounds = max(1, -(-materials // (most * threads)))
    size = max(1, -(-materials // (rounds * threads)))
    for first in range(0, materials, size):
        yield list(range(first, min(first + size, materials)))


def score(model: Lobe, measured: Measured, losses: Sequence[Loss]) -> Tensor:
    """The error of a batched model under each loss on every sample of `measured`, `(L, M)`, float64."""
    packed = model.pack()

    def score_some(rows: list[int]) -> Tensor:
        part = measured.batch(rows)
        fitted = model.unpack(packed[rows])
        analytic = [loss for loss in losses if _analytic(loss)]
        found = {}
        if analytic:
            found = dict(zip(map(id, analytic), errors(fitted, analytic[0].problem(part), analytic), strict=True))
        for loss in losses:
            if id(loss) not in found:
                found[id(loss)] = errors(fitted, loss.problem(part), [loss])[0]
        return torch.stack([found[id(loss)] for loss in losses])

    return torch.cat(list(each(score_some, groups(len(measured), len(measured.pairs)))), 1)


def errors(model: Lobe, problem: Problem, losses: Sequence[Loss]) -> Tensor:
    """The error of a batched model under each loss, `(L, M)`, float64, on the CPU."""
    if not all(_analytic(loss) for loss in losses):
        prediction = model(problem.pairs)
        return torch.stack(
            [loss.error(prediction, problem.target, problem.pairs, problem.weight).cpu() for loss in losses]
        )
    materials = len(problem.target)
    sums = torch.zeros(len(losses), materials, dtype=torch.float64, device=problem.target.device)
    totals = torch.zeros_like(sums)
    for part, pairs in chunked(problem.pairs, materials):
        target = problem.target[:, part].transpose(1, 2).contiguous().transpose(1, 2)
        prediction = _predict(model, pairs).expand_as(target)
        given = None if problem.weight is None else problem.weight[:, part]
        for k, loss in enumerate(losses):
            penalty, density, weight = loss.pointwise(prediction, target, pairs), loss.density(pairs), given
            if density is not None:
                weight = density[..., None] if weight is None else weight * density[..., None]
            if weight is None:
                totals[k] += target.shape[1] * 3
            else:
                penalty = penalty * weight
                totals[k] += weight.expand(-1, -1, 3).sum((1, 2)).double()
            sums[k] += penalty.sum((1, 2)).double()
    return (sums / totals).sqrt().cpu()


def _predict(model: Lobe, pairs: Pairs) -> Tensor:
    """`model(pairs)`, `(M, N, 3)`; where that is colours times scalars, as a product that lies channel by channel."""
    shapes: list[Tensor] = []
    colors: list[Tensor] = []
    for part in model.parts():
        color = part.color()
        if color is None:
            return model(pairs)
        albedo: Tensor = getattr(part, color.name)
        named = {bounded.name: getattr(part, bounded.name) for bounded in part.scalars()}
        shape = type(part).function(pairs, **{color.name: torch.ones_like(albedo[..., :1])}, **named)[..., 0]
        shapes.append(shape.expand(len(albedo), -1))
        colors.append(albedo)
    return torch.bmm(torch.stack(colors, 2), torch.stack(shapes, 1)).transpose(1, 2)


def _analytic(loss: Loss) -> bool:
    return type(loss).error is Loss.error


def local_minima(cross: Tensor, tolerance: float = 1e-4) -> Tensor:
    """The paper's test: which fits another loss's parameters beat.

    cross: `(L, L, M)`, the error under loss a of the parameters found under loss b, at [a, b]. A fit under a is an
    outlier, stuck in a local minimum, if some b has a lower error there by more than `tolerance`, relative: `(L, M)`.
    """
    own = torch.diagonal(cross, dim1=0, dim2=1).T
    return cross.amin(1) < own * (1 - tolerance)
