"""Errors of fitted models on every valid sample, and the paper's test for local minima."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import torch
from torch import Tensor

from torchbrdf.fitting.data import chunked
from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import process_map, thread_map

# Pairs times materials that a thread holds at a time, at about 30 bytes each; the work on them is done in small parts.
BUDGET = 4_000_000
# The same on a GPU, where one batch at a time is best.
GPU_BUDGET = 400_000_000
# Pairs times materials above which processes are worth their start.
HEAVY = 500_000

Result = TypeVar("Result")


def groups(measured: Measured) -> Iterator[list[int]]:
    """Materials in batches: as many for each thread, and no more than the memory budget allows."""
    materials, pairs = len(measured), max(len(measured.pairs), 1)
    if measured.device.type == "cuda":
        size = max(1, GPU_BUDGET // pairs)
    else:
        threads = torch.get_num_threads()
        rounds = max(1, -(-materials // (max(1, BUDGET // pairs) * threads)))
        size = max(1, -(-materials // (rounds * threads * 2)))
    for first in range(0, materials, size):
        yield list(range(first, min(first + size, materials)))


def share_out(function: Callable[[list[int]], Result], measured: Measured) -> Iterator[Result]:
    """`function` of batches of materials, on all cores."""
    run = process_map if len(measured) * len(measured.pairs) > HEAVY and measured.device.type == "cpu" else thread_map
    yield from run(function, list(groups(measured)))


def score(model: Lobe, measured: Measured, losses: Sequence[Loss]) -> Tensor:
    """The error of a batched model under each loss on every sample of `measured`, `(L, M)`, float64."""
    return cross_score([model], measured, losses)[:, 0]


def cross_score(models: Sequence[Lobe], measured: Measured, losses: Sequence[Loss]) -> Tensor:
    """The errors of several batched models of the same materials, `(L, K, M)`; every sample is read once."""
    packed = [model.pack() for model in models]

    def score_some(rows: list[int]) -> Tensor:
        part = measured.batch(rows)
        fitted = [model.unpack(values[rows]) for model, values in zip(models, packed, strict=True)]
        analytic = [loss for loss in losses if loss.analytic]
        found = {}
        if analytic:
            found = dict(zip(map(id, analytic), errors(fitted, analytic[0].problem(part), analytic), strict=True))
        for loss in losses:
            if id(loss) not in found:
                found[id(loss)] = errors(fitted, loss.problem(part), [loss])[0]
        return torch.stack([found[id(loss)] for loss in losses])

    return torch.cat(list(share_out(score_some, measured)), -1)


def errors(models: Sequence[Lobe], problem: Problem, losses: Sequence[Loss]) -> Tensor:
    """The errors of batched models under some losses, `(L, K, M)`, float64, on the CPU."""
    pairs, target, weight = problem.pairs, problem.target, problem.weight
    if not all(loss.analytic for loss in losses):
        found = [[loss.error(model(pairs), target, pairs, weight) for model in models] for loss in losses]
        return torch.stack([torch.stack(row) for row in found]).cpu()
    sums = torch.zeros(len(losses), len(models), len(target), dtype=torch.float64, device=target.device)
    totals = torch.zeros_like(sums[:, 0])
    for part, own in chunked(pairs, len(target)):
        wanted = target[:, part].transpose(1, 2).contiguous().transpose(1, 2)
        predictions = [_predict(model, own).expand_as(wanted) for model in models]
        for k, loss in enumerate(losses):
            counted = loss.counted(own, None if weight is None else weight[:, part])
            full = torch.ones_like(wanted[:1, :, :1]) if counted is None else counted
            totals[k] += full.expand(-1, -1, 3).sum((1, 2)).double()
            encoded = loss.encode(wanted, own)
            for b, prediction in enumerate(predictions):
                penalty = loss.penalty(loss.encode(prediction, own) - encoded)
                sums[k, b] += (penalty if counted is None else penalty * counted).sum((1, 2)).double()
    return (sums / totals[:, None]).sqrt().cpu()


def _predict(model: Lobe, pairs: Pairs) -> Tensor:
    """`model(pairs)`, `(M, N, 3)`; where that is colours times scalars, as a product that lies channel by channel."""
    shapes: list[Tensor] = []
    colors: list[Tensor] = []
    for part in model.components():
        color = part.albedo_spec()
        if color is None:
            return model(pairs)
        albedo: Tensor = getattr(part, color.name)
        shape = type(part).unit_response(pairs, *(getattr(part, bounded.name) for bounded in part.scalars()))
        shapes.append(shape.expand(len(albedo), -1))
        colors.append(albedo)
    return torch.bmm(torch.stack(colors, 2), torch.stack(shapes, 1)).transpose(1, 2)


def local_minima(cross: Tensor, tolerance: float = 1e-4) -> Tensor:
    """The paper's test: which fits another loss's parameters beat.

    cross: `(L, L, M)`, the error under loss a of the parameters found under loss b, at [a, b]. A fit under a is an
    outlier, stuck in a local minimum, if some b has a lower error there by more than `tolerance`, relative: `(L, M)`.
    """
    own = torch.diagonal(cross, dim1=0, dim2=1).T
    return cross.amin(1) < own * (1 - tolerance)
