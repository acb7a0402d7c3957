"""Fit a model to measured materials."""

import time
from typing import NamedTuple

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.fitting.data import stratified
from torchbrdf.fitting.lbfgs import Status
from torchbrdf.fitting.result import FitResult
from torchbrdf.fitting.score import errors, share_out
from torchbrdf.fitting.solve import Task
from torchbrdf.fitting.strategy import STRATEGIES, Outcome, joined
from torchbrdf.fitting.variables import put_values, values_of
from torchbrdf.lobes import Lambert, Lobe
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.progress import Progress, quiet

DIFFUSE = ("45:0", "fit")


def fit(
    model: Lobe,
    measured: Measured,
    loss: Loss,
    *,
    strategy: str = "global",
    diffuse: str = "45:0",
    max_theta: float = 80.0,
    samples: int | None = 20_000,
    seed: int = 0,
    max_iterations: int = 300,
    progress: Progress = quiet,
) -> FitResult:
    """Fit `model`, a sum of lobes with or without a diffuse one, to every material of `measured` under `loss`.

    strategy: a registered one; "global" finds the best fit, "staged" is the paper's procedure. diffuse: "45:0" takes
    the diffuse albedo from the measurement with the light at 45 degrees and the viewer at the normal, and holds it;
    "fit" moves the model's own. max_theta: only pairs with both directions at most so many degrees from the normal
    count. samples: the solver works on a stratified random subset of so many pairs, from `seed` (None: every pair),
    and finishes on every valid pair; both errors are reported. The parameters that the model holds are where the fit
    starts; (P,) for all materials or (M, P) for each. max_iterations: of the solver in each stage. progress: called
    with the numbers of materials done and of all, as they are done.

    A material that cannot be fitted (no valid samples, fewer than parameters, a start outside its bounds, an error
    that is not finite) says so in `status`, with the reason in `reason`, and leaves the others be.
    """
    if diffuse not in DIFFUSE:
        raise UsageError(f"diffuse: expected one of {', '.join(DIFFUSE)}, found {diffuse!r}")
    if samples is not None and samples < 1:
        raise UsageError(f"samples: expected at least 1, found {samples}")
    if not len(measured):
        raise UsageError("fit: expected at least one material, found none")
    began = time.perf_counter()
    run = STRATEGIES[strategy]
    measured = measured.within(max_theta)
    model = model.batched(len(measured)).to(measured.device, measured.dtype)
    reasons = _check_start(model)
    if diffuse == "45:0":
        _set_diffuse(model, measured)
    subset = stratified(len(measured.pairs), samples, seed) if loss.subsets else None
    packed = model.pack().clamp(*model.bounds)
    moved = sum(one.size for part, one in model.named_specs() if diffuse == "fit" or not isinstance(part, Lambert))

    def fit_some(rows: list[int]) -> _Fitted:
        part = model.unpack(packed[rows])
        whole = _without_idle_weight(loss.problem(measured.batch(rows)))
        if subset is None:
            task = Task(part, whole, loss, max_iterations)
        else:
            task = Task(part, whole.select(samples=subset.to(measured.device)), loss, max_iterations, whole)
        outcome = run(task, values_of(part), diffuse == "fit")
        put_values(part, outcome.values)
        seen = errors([part], task.problem, [loss])[0, 0]
        error = seen if subset is None else errors([part], whole, [loss])[0, 0]
        return _Fitted(part.pack(), outcome, error, seen, _counts(whole))

    done: list[_Fitted] = []
    for found in share_out(fit_some, measured):
        done.append(found)
        progress(sum(len(one.error) for one in done), len(measured))
    status = [found.outcome.status(k) for found in done for k in range(len(found.error))]
    error = torch.cat([found.error for found in done])
    for k, count in enumerate(torch.cat([found.counts for found in done]).tolist()):
        if k in reasons:
            status[k] = Status.BAD_START
        elif count == 0:
            status[k], reasons[k] = Status.NO_DATA, f"no valid sample within {max_theta:g} degrees"
        elif not error[k].isfinite():
            status[k], reasons[k] = Status.NOT_FINITE, f"the error is {error[k].item():g}"
        elif count < moved:
            status[k], reasons[k] = Status.TOO_FEW_SAMPLES, f"{count} valid values for {moved} parameters"
        elif status[k] != Status.CONVERGED:
            reasons[k] = REASONS[status[k]]
    return FitResult(
        names=measured.names,
        model=model.unpack(torch.cat([found.packed for found in done])),
        loss=loss.registered_name,
        strategy=strategy,
        diffuse=diffuse,
        error=error,
        subset_error=torch.cat([found.seen for found in done]),
        status=status,
        reason=[reasons.get(k, "") for k in range(len(status))],
        starts=done[0].outcome.starts,
        ties=[tie for found in done for tie in found.outcome.ties or [0] * len(found.error)],
        seconds=time.perf_counter() - began,
        max_theta=max_theta,
        samples=None if subset is None else len(subset),
        seed=seed,
        scene=loss.scene,
        history=[joined(list(stages)) for stages in zip(*(found.outcome.stages for found in done), strict=True)],
    )


REASONS = {
    Status.MAX_ITERATIONS: "the solver's iterations were used up",
    Status.STALLED: "no better point was found, but the slope is not 0",
    Status.NOT_FINITE: "the error at the start is not finite",
}


class _Fitted(NamedTuple):
    packed: Tensor
    outcome: Outcome
    error: Tensor
    seen: Tensor
    counts: Tensor


def _counts(problem: Problem) -> Tensor:
    """Valid values of each material, `(M,)`."""
    if problem.weight is None:
        return torch.full((len(problem.target),), problem.target.shape[1:].numel())
    return (problem.weight > 0).expand(len(problem.target), -1, problem.target.shape[-1]).sum((1, 2)).cpu()


def _check_start(model: Lobe) -> dict[int, str]:
    """Which materials start outside the bounds, and how; a ShapeError if all do."""
    lower, upper = model.bounds
    packed = model.pack()
    outside = (packed < lower) | (packed > upper) | ~packed.isfinite()
    names = [
        f"{type(part).__name__}.{bounded.name}" for part, bounded in model.named_specs() for _ in range(bounded.size)
    ]
    found: dict[int, str] = {}
    for material, k in outside.nonzero().tolist():
        expected = f"{lower[k].item():g} to {upper[k].item():g}"
        text = f"start of {names[k]}: expected {expected}, found {packed[material, k].item():g}"
        found.setdefault(material, text)
    if found and len(found) == len(packed):
        raise ShapeError(found[0])
    return found


def _set_diffuse(model: Lobe, measured: Measured) -> None:
    diffuse = [part for part in model.components() if isinstance(part, Lambert)]
    if len(diffuse) > 1:
        raise ShapeError(f"fit: expected at most one Lambert lobe, found {len(diffuse)}")
    for part in diffuse:
        part.albedo.data = measured.diffuse_45_0().to(part.albedo)


def _without_idle_weight(problem: Problem) -> Problem:
    """Weights that are all 1 say nothing: leave them out of every step."""
    if problem.weight is not None and bool((problem.weight == 1).all()):
        return Problem(problem.pairs, problem.target)
    return problem
