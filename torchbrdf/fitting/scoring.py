"""Errors of fitted models on every valid sample, and the paper's test for local minima."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

import torch
from torch import Tensor

from torchbrdf.fitting.basis import predictor
from torchbrdf.fitting.objective import channels
from torchbrdf.fitting.sampling import chunked
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import get_parameters, take_materials, with_parameters
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.parallel import Lost, process_map, thread_map
from torchbrdf.precision import undisturbed

# Pairs times materials that a thread holds at a time, at about 30 bytes each; the work on them is done in small parts.
MEMORY = 4_000_000
# The same on a GPU, where one batch at a time is best.
GPU_MEMORY = 400_000_000
# Pairs times materials above which processes are worth their start.
PROCESS_THRESHOLD = 500_000

Result = TypeVar("Result")


def material_batches(measured: Measured) -> Iterator[list[int]]:
    """Materials in batches: as many for each thread, and no more than the memory budget allows."""
    materials, pairs = len(measured), max(len(measured.pairs), 1)
    if measured.device.type == "cuda":
        size = max(1, GPU_MEMORY // pairs)
    else:
        threads = torch.get_num_threads()
        rounds = max(1, -(-materials // (max(1, MEMORY // pairs) * threads)))
        size = max(1, -(-materials // (rounds * threads * 2)))
    for first in range(0, materials, size):
        yield list(range(first, min(first + size, materials)))


def parallel_map(
    function: Callable[[list[int], Measured], Result], measured: Measured
) -> Iterator[tuple[list[int], Result | Lost]]:
    """`function` of batches of materials, their indices and what was measured of them, on all cores."""
    batches = list(material_batches(measured))
    large = len(measured) * len(measured.pairs) > PROCESS_THRESHOLD and measured.device.type == "cpu"
    run = process_map if large else thread_map
    parts = [(rows, measured.batch(rows)) for rows in batches]
    yield from zip(batches, run(partial(_apply, function), parts), strict=True)


def _apply(function: Callable[[list[int], Measured], Result], batch: tuple[list[int], Measured]) -> Result:
    rows, part = batch
    return function(rows, part.batch())  # a view of its own: what it has read goes when the function ends


def score(model: Lobe, measured: Measured, losses: Sequence[Loss]) -> Tensor:
    """The errors of fitted models on every sample.

    Args:
        model: batched, one for each of M materials.
        measured: the materials.
        losses: L of them.

    Returns:
        The error of each model under each loss, `(L, M)`, float64.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import RMSLoss
        >>> from torchbrdf.measured import load, standins
        >>> measured = load(standins()).batch([0, 1], torch.arange(0, 900_000, 1000))
        >>> score(make_model("ward").batched(2), measured, [RMSLoss()]).shape
        torch.Size([1, 2])
    """
    return cross_score([model], measured, losses)[:, 0]


@undisturbed()
def cross_score(models: Sequence[Lobe], measured: Measured, losses: Sequence[Loss]) -> Tensor:
    """The errors of several models of the same materials; every sample is read once.

    Args:
        models: K of them, batched, each with one model for each of M materials.
        measured: the materials.
        losses: L of them.

    Returns:
        The error of each model under each loss, `(L, K, M)`, float64; NaN where the process at work on it died twice.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import RMSLoss
        >>> from torchbrdf.measured import load, standins
        >>> measured = load(standins()).batch([0], torch.arange(0, 900_000, 1000))
        >>> models = [make_model("ward", lobes).batched(1) for lobes in (1, 2, 3)]
        >>> cross_score(models, measured, [RMSLoss()]).shape
        torch.Size([1, 3, 1])
    """
    own = [get_parameters(model) for model in models]

    def score_some(rows: list[int], part: Measured) -> Tensor:
        fitted = [
            with_parameters(model, take_materials(values, rows)) for model, values in zip(models, own, strict=True)
        ]
        separable = [loss for loss in losses if loss.is_separable()]
        found = {}
        if separable:
            problem = separable[0].problem(part)
            found = dict(zip(map(id, separable), errors(fitted, problem, separable), strict=True))
        for loss in losses:
            if id(loss) not in found:
                found[id(loss)] = errors(fitted, loss.problem(part), [loss])[0]
        return torch.stack([found[id(loss)] for loss in losses])

    def lost(count: int) -> Tensor:
        return torch.full((len(losses), len(models), count), torch.nan, dtype=torch.float64, device="cpu")

    parts = parallel_map(score_some, measured)
    return torch.cat([lost(len(rows)) if isinstance(found, Lost) else found for rows, found in parts], -1)


def errors(models: Sequence[Lobe], problem: Problem, losses: Sequence[Loss]) -> Tensor:
    """The errors of batched models under some losses, `(L, K, M)`, float64, on the CPU."""
    pairs, target, weight = problem.pairs, problem.target, problem.weight
    if not all(loss.is_separable() for loss in losses):
        found = [[loss.error(model(pairs), target, pairs, weight).double() for model in models] for loss in losses]
        return torch.stack([torch.stack(row) for row in found]).cpu()
    sums = torch.zeros(len(losses), len(models), len(target), dtype=torch.float64, device=target.device)
    totals = torch.zeros_like(sums[:, 0])
    predictors = [predictor(model) for model in models]
    for part, own in chunked(pairs, len(target)):
        wanted = target[:, part].mT.contiguous()
        predictions = [predict(own).expand_as(wanted) for predict in predictors]
        for k, loss in enumerate(losses):
            counted = channels.effective_weight(loss, own, None if weight is None else weight[:, part])
            full = torch.ones_like(wanted[:1, :1]) if counted is None else counted
            totals[k] += full.expand(-1, 3, -1).sum((1, 2), dtype=torch.float64)
            encoded = channels.encode(loss, wanted, own)
            for b, prediction in enumerate(predictions):
                penalty = loss.penalty(channels.encode(loss, prediction, own) - encoded)
                sums[k, b] += (penalty if counted is None else penalty * counted).sum((1, 2)).double()
    means = sums / totals[:, None]
    return torch.stack([loss.finalize(mean) for loss, mean in zip(losses, means, strict=True)]).cpu()


def local_minima(cross: Tensor, tolerance: float = 1e-4) -> Tensor:
    """The paper's test for local minima: which fits another loss's parameters beat.

    Args:
        cross: the error under loss a of the parameters found under loss b, at [a, b], `(L, L, M)`.
        tolerance: how much lower, relative, an error must be.

    Returns:
        Whether the fit under a is an outlier, as some b has a lower error there, `(L, M)`.

    Example:
        >>> local_minima(torch.tensor([[[1.0], [0.5]], [[3.0], [2.0]]])).tolist()
        [[True], [False]]
    """
    own = torch.diagonal(cross, dim1=0, dim2=1).T
    return cross.amin(1) < own * (1 - tolerance)
