"""Errors of fitted models on every valid sample, and the paper's test for local minima."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from torchbrdf.fitting import channels
from torchbrdf.fitting.basis import Basis, predictor
from torchbrdf.fitting.batching import parallel_map
from torchbrdf.fitting.gathered import Gathered
from torchbrdf.fitting.objective import FitObjective, QuadraticObjective
from torchbrdf.fitting.objective.factored import LEAST_PAIRS
from torchbrdf.fitting.objective.pointwise import PointwiseObjective
from torchbrdf.fitting.pair_factors import Probes, coefficients, factor_kinds, factors_of, groups_of, probes_of
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.fitting.sampling import chunked
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import get_parameters, take_materials, with_parameters
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import Lost
from torchbrdf.precision import undisturbed


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
def cross_score(
    models: Sequence[Lobe], measured: Measured, losses: Sequence[Loss], gathered: Gathered | None = None
) -> Tensor:
    """The errors of several models of the same materials; every sample is read once.

    Args:
        models: K of them, batched, each with one model for each of M materials.
        measured: the materials.
        losses: L of them.
        gathered: sums of these materials, which losses of squares need no other pass for.

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
    for loss in losses:
        if loss.needs_rgb:
            measured.check_rgb(loss.registered_name)
    if not measured.is_rgb:
        losses = [loss.with_luminance(measured.luminance_shares) for loss in losses]
    from_sums = {} if gathered is None else _from_sums(models, losses, gathered)
    if from_sums:
        found = torch.empty(len(losses), len(models), len(measured), dtype=torch.float64, device="cpu")
        others = [k for k in range(len(losses)) if k not in from_sums]
        if others:
            found[others] = cross_score(models, measured, [losses[k] for k in others])
        for k, errors_there in from_sums.items():
            found[k] = errors_there
        return found
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


def _from_sums(models: Sequence[Lobe], losses: Sequence[Loss], gathered: Gathered) -> dict[int, Tensor]:
    """Errors `(K, M)` under those losses, by their places, for which there are sums of every model."""
    found = {}
    for k, loss in enumerate(losses):
        sums = [gathered.find(model, loss) for model in models]
        known = [(model, one) for model, one in zip(models, sums, strict=True) if one is not None]
        if len(known) == len(models):
            found[k] = torch.stack([QuadraticObjective(one, loss).errors(model) for model, one in known])
    return found


def errors(models: Sequence[Lobe], problem: Problem, losses: Sequence[Loss]) -> Tensor:
    """The errors of batched models under some losses, `(L, K, M)`, float64, on the CPU."""
    pairs, target, weight = problem.pairs, problem.target, problem.weight
    if not all(loss.is_separable() for loss in losses):
        found = [[loss.error(model(pairs), target, pairs, weight).double() for model in models] for loss in losses]
        return torch.stack([torch.stack(row) for row in found]).cpu()
    sums = torch.zeros(len(losses), len(models), len(target), dtype=torch.float64, device=target.device)
    totals = torch.zeros_like(sums[:, 0])
    for part, own, predictions in _predictions(models, pairs, len(target)):
        wanted = target[:, part].mT.contiguous()
        for k, loss in enumerate(losses):
            counted = channels.effective_weight(loss, own, None if weight is None else weight[:, part])
            full = torch.ones_like(wanted[:1, :1]) if counted is None else counted
            totals[k] += full.expand(-1, wanted.shape[1], -1).sum((1, 2), dtype=torch.float64)
            encoded = channels.encode(loss, wanted, own)
            for b, prediction in enumerate(predictions):
                code = channels.encode(loss, prediction.expand_as(wanted), own)
                penalty = loss.penalty(code - encoded)
                sums[k, b] += (penalty if counted is None else penalty * counted).sum((1, 2)).double()
    means = sums / totals[:, None]
    return torch.stack([loss.finalize(mean) for loss, mean in zip(losses, means, strict=True)]).cpu()


def errors_seen(
    model: Lobe, problem: Problem, loss: Loss, objective: FitObjective | None, free: Parametrization
) -> Tensor:
    """The errors of a batched model on the problem that an objective was made of, `(M,)`, float64, on the CPU.

    Where it is laid out by half angles, with all that belongs to targets worked out, that is one of its passes.
    """
    if type(objective) is not PointwiseObjective or not factor_kinds(model) or objective.factored is None:
        return errors([model], problem, [loss])[0, 0]
    every = objective.material_indices
    scale = torch.ones_like(every, dtype=torch.float64)
    value, *_ = objective.evaluate(Basis(free), get_parameters(model), every, scale)
    return loss.finalize(value).cpu()


def _predictions(
    models: Sequence[Lobe], pairs: Pairs, materials: int
) -> Iterator[tuple[slice | Tensor, Pairs, list[Tensor]]]:
    """Which pairs, these pairs, and each model's values there, `(M, C, n)`; part after part."""
    kinds = list(dict.fromkeys(kind for model in models for kind in factor_kinds(model)))
    groups = groups_of(pairs, LEAST_PAIRS) if kinds and all(factor_kinds(model) for model in models) else None
    if groups is None:
        predictors = [predictor(model) for model in models]
        for part, own in chunked(pairs, materials):
            yield part, own, [predict(own) for predict in predictors]
        return
    probes = {kind: probes_of(kind, pairs, groups) for kind in kinds}
    colors = [_colors(model, probes, pairs.dtype) for model in models]
    for k, index in enumerate(groups):
        own = pairs.select(samples=index)
        factors = torch.cat([factors_of(kind, own) for kind in kinds])
        yield index, own, [color[k] @ factors for color in colors]


def _colors(model: Lobe, probes: dict[type[Lobe], Probes], dtype: torch.dtype) -> Tensor:
    """What factors are multiplied by to make a model's values, `(G, M, C, J)`."""
    basis, values = Basis(Parametrization(model, [])), get_parameters(model)
    materials = len(next(iter(values.values())))
    responses = coefficients(basis, probes, values, materials)
    color = basis.albedos(values, torch.float64) @ responses.flatten(2)
    return color.unflatten(2, responses.shape[2:]).permute(2, 0, 1, 3).to(dtype)


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
