"""Fit a model to measured materials."""

import time
from collections.abc import Callable

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.fitting.lbfgs import Status
from torchbrdf.fitting.result import FitResult
from torchbrdf.fitting.score import groups, score
from torchbrdf.fitting.solve import Task
from torchbrdf.fitting.strategy import STRATEGIES, Outcome, joined
from torchbrdf.fitting.variables import put_values, values_of
from torchbrdf.lobes import Lambert, Lobe
from torchbrdf.losses import LOSSES, Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.workers import each

DIFFUSE = ("45:0", "fit")


def fit(
    model: Lobe,
    measured: Measured,
    loss: Loss,
    *,
    strategy: str = "staged",
    diffuse: str = "45:0",
    max_theta: float = 80.0,
    samples: int | None = 20_000,
    seed: int = 0,
    max_iterations: int = 300,
    progress: Callable[[int], None] | None = None,
) -> FitResult:
    """Fit `model`, a sum of lobes with or without a diffuse one, to every material of `measured` under `loss`.

    strategy: a registered one. diffuse: "45:0" takes the diffuse albedo from the measurement with the light at 45
    degrees and the viewer at the normal, and holds it; "fit" moves the model's own. max_theta: only pairs with
    both directions at most so many degrees from the normal count. samples: the solver sees a stratified random subset
    of so many pairs, from `seed` (None: every pair); the errors reported are always those of every valid pair.
    The parameters that the model holds are where the fit starts; (P,) for all materials or (M, P) for each.
    max_iterations: of the solver in each stage. progress: called with the number of materials done, as they are done.

    A material without valid samples, or whose error is not finite, is reported in `status` and leaves the others be.
    """
    if diffuse not in DIFFUSE:
        raise UsageError(f"diffuse: expected one of {', '.join(DIFFUSE)}, found {diffuse!r}")
    if samples is not None and samples < 1:
        raise UsageError(f"samples: expected at least 1, found {samples}")
    began = time.perf_counter()
    run = STRATEGIES[strategy]
    measured = measured.within(max_theta)
    model = model.batched(len(measured)).to(measured.device, measured.dtype)
    _check_start(model)
    if diffuse == "45:0":
        _set_diffuse(model, measured)
    subset = stratified(len(measured.pairs), samples, seed) if loss.subsets else None
    packed = model.pack()

    def fit_some(rows: list[int]) -> tuple[Tensor, Outcome]:
        part = model.unpack(packed[rows])
        problem = _without_idle_weight(loss.problem(measured.batch(rows), subset))
        outcome = run(Task(part, problem, loss, max_iterations), values_of(part), diffuse == "fit")
        put_values(part, outcome.values)
        return part.pack(), outcome

    outcomes: list[Outcome] = []
    fitted: list[Tensor] = []
    for found, outcome in each(fit_some, groups(len(measured), len(measured.pairs) if subset is None else len(subset))):
        fitted.append(found)
        outcomes.append(outcome)
        if progress is not None:
            progress(len(found))
    packed = torch.cat(fitted)
    subset_error = [torch.tensor(outcome.stages[-1].error, dtype=torch.float64) for outcome in outcomes]
    model = model.unpack(packed)
    history = [joined([outcome.stages[k] for outcome in outcomes]) for k in range(len(outcomes[0].stages))]
    status = [outcome.status(k) for outcome in outcomes for k in range(len(outcome.stages[0].error))]
    error = score(model, measured, [loss])[0]
    for k in (~error.isfinite()).nonzero().flatten().tolist():
        status[k] = Status.NO_DATA if not bool((measured.batch([k]).weight > 0).any()) else Status.NOT_FINITE
    return FitResult(
        names=measured.names,
        model=model,
        loss=next((name for name, kind in LOSSES.items() if type(loss) is kind), type(loss).__name__),
        strategy=strategy,
        diffuse=diffuse,
        error=error,
        subset_error=torch.cat(subset_error),
        status=status,
        seconds=time.perf_counter() - began,
        max_theta=max_theta,
        samples=None if subset is None else len(subset),
        seed=seed,
        history=history,
    )


def stratified(total: int, samples: int | None, seed: int) -> Tensor | None:
    """One index, drawn at random, from each of `samples` equal stretches of range(total); None if that is all of it.

    Every index is as likely as any other, so that a mean over the subset estimates the whole mean without bias.
    """
    if samples is None or samples >= total:
        return None
    generator = torch.Generator().manual_seed(seed)
    within = torch.rand(samples, generator=generator, dtype=torch.float64)
    return ((torch.arange(samples, dtype=torch.float64) + within) * (total / samples)).long().clamp_max(total - 1)


def _check_start(model: Lobe) -> None:
    lower, upper = model.bounds
    packed = model.pack()
    outside = (packed < lower) | (packed > upper) | ~packed.isfinite()
    names = [f"{type(part).__name__}.{bounded.name}" for part, bounded in model.slots() for _ in range(bounded.size)]
    for material, k in outside.nonzero()[:1].tolist():
        expected = f"{lower[k].item():g} to {upper[k].item():g}"
        raise ShapeError(f"start of {names[k]}: expected {expected}, found {packed[material, k].item():g}")


def _set_diffuse(model: Lobe, measured: Measured) -> None:
    diffuse = [part for part in model.parts() if isinstance(part, Lambert)]
    if len(diffuse) > 1:
        raise ShapeError(f"fit: expected at most one Lambert lobe, found {len(diffuse)}")
    for part in diffuse:
        part.albedo.data = measured.diffuse_45_0().to(part.albedo)


def _without_idle_weight(problem: Problem) -> Problem:
    """Weights that are all 1 say nothing: leave them out of every step."""
    if problem.weight is not None and bool((problem.weight == 1).all()):
        return Problem(problem.pairs, problem.target)
    return problem
