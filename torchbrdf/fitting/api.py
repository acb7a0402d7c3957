"""Fit a model to measured materials."""

import logging
import time
import warnings
from collections.abc import Callable
from concurrent.futures import Executor

import torch
from torch import Tensor

from torchbrdf import kinds
from torchbrdf.errors import ShapeError, UsageError, shown
from torchbrdf.fitting.batching import parallel_map
from torchbrdf.fitting.determined import joined_truths, working_dtype
from torchbrdf.fitting.gathered import Gathered
from torchbrdf.fitting.grain import check_grain, without_grain
from torchbrdf.fitting.intervals import (
    BOOTSTRAP,
    GAUSS_NEWTON,
    check_method,
    joined_intervals,
)
from torchbrdf.fitting.parameters import diffuse_components
from torchbrdf.fitting.result import FitResult
from torchbrdf.fitting.shared import Shared
from torchbrdf.fitting.strategy import STRATEGIES, Outcome, Stage, Strategy, joined, strategy_name
from torchbrdf.fitting.work import FitSome, Fitted, Subset
from torchbrdf.lobes import Lambert, Lobe
from torchbrdf.lobes.in_bands import check_bands, with_channels
from torchbrdf.lobes.parameter_dict import (
    ParameterDict,
    get_parameters,
    named_specs,
    take_materials,
    with_parameters,
)
from torchbrdf.losses import Loss, as_loss
from torchbrdf.measured import Measured
from torchbrdf.measured.bands import bands_in_words
from torchbrdf.parallel import Lost
from torchbrdf.precision import HALVES, undisturbed
from torchbrdf.progress import Progress, quiet
from torchbrdf.solvers import Status

log = logging.getLogger("torchbrdf")

DIFFUSE_MODES = kinds.DIFFUSE_MODES


class SlowFitWarning(UserWarning):
    """A fit differentiates a loss by autograd, as it gives no derivatives itself: right, but slower.

    Example:
        >>> import warnings
        >>> warnings.simplefilter("ignore", SlowFitWarning)
    """


@undisturbed()
def fit(
    model: Lobe,
    measured: Measured,
    loss: Loss | Callable[..., Tensor],
    *,
    strategy: str | Strategy = "global",
    diffuse: str | None = None,
    max_theta: float = 80.0,
    samples: int | None = 20_000,
    seed: int = 0,
    max_iterations: int = 300,
    intervals: str = GAUSS_NEWTON,
    progress: Progress = quiet,
    gathered: Gathered | None = None,
    executor: Executor | None = None,
) -> FitResult:
    """Fit a model to every material of `measured` under a loss.

    A material that cannot be fitted (no valid samples, fewer than parameters, a start outside its bounds, an error
    that is not finite, a process that died twice over it) says so in `status`, with the reason in `reason`, and leaves
    the others be.

    It works in threads, or in processes where that is quicker, see [Method](method.md); Ctrl-C ends all of them.

    Args:
        model: a sum of lobes with or without a diffuse one; the parameters that it holds, `(k,)` for all materials or
            `(M, k)` for each, are where the fit starts. It is not changed.
        measured: M materials, in linear RGB or in bands; of bands the model gets as many channels, and luminance is by
            their wavelengths.
        loss: a `Loss`; or any module or function of (prediction, target), as `FunctionLoss` takes it. One without
            derivatives of its own is differentiated by autograd, with a `SlowFitWarning`.
        strategy: a registered one, or one with other options, `GlobalSearch(starts=12)`; "global" finds the best fit,
            "staged" is the paper's procedure.
        diffuse: "45:0" takes the diffuse albedo from the measurement with the light at 45 degrees and the viewer at the
            normal, and holds it, or does as "fit" where nothing was measured thereabouts; "fit" moves the model's own
            with the rest; None is the loss's `default_diffuse`, by what was seen to look right: "fit" for the learned
            metric and for pictures, "45:0" for all else.
        max_theta: only pairs with both directions at most so many degrees from the normal count.
        samples: the solver works on a stratified random subset of so many pairs (None: every pair), and finishes on
            every valid pair; both errors are reported. Of a table it sees every pair where a loss of squares and lobes
            that know their shape by the half angle alone need only sums, see [Method](method.md).
        seed: of that subset.
        max_iterations: of the solver in each stage.
        intervals: of the parameters, 95 %: "gauss_newton", for losses of squares, which costs nothing; "bootstrap" adds
            those of 100 refits, for losses of BRDF values; "none". See [Fit](how-to/fit.md).
        progress: called with the number of materials done, as they are done.
        gathered: a `torchbrdf.fitting.Gathered` of these materials within `max_theta`, for several fits that share one
            pass over them; it serves the loss objects that it was made with.
        executor: what works on the materials in the place of this machine's threads and processes: any
            `concurrent.futures.Executor`, such as Dask's `client.get_executor()`.

    Returns:
        The fitted models, their errors, and how each fit ended.

    Raises:
        UsageError: for an option that does not exist, or without any material; or if a lobe has a grain, and the
            measurement, or what the loss compares, has none.
        DataError: for bands under a loss of pictures.
        ShapeError: if all starts are outside their bounds, or the loss and the values do not fit together.

    Example:
        >>> from torchbrdf import fit, load
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import CosineRMSLoss
        >>> from torchbrdf.measured import standins
        >>> nickel = load(standins()).batch([6], torch.arange(0, 900_000, 300))
        >>> fit(make_model("ward", lobes=1), nickel, CosineRMSLoss(), samples=None).names
        ['nickel']
    """
    if not -(2**63) <= seed < 2**63:
        raise UsageError(f"seed: expected an integer of 64 bits, found {seed}")
    if samples is not None and (not isinstance(samples, int) or samples < 1):
        raise UsageError(f"samples: expected an integer of at least 1, or None, found {shown(samples)}")
    if not len(measured):
        raise UsageError("fit: expected at least one material, found none")
    began = time.perf_counter()
    if isinstance(strategy, str):
        STRATEGIES[strategy]
    check_method(intervals)
    loss = as_loss(loss)
    check_grain(model, measured, loss)
    diffuse = diffuse_mode(diffuse, loss, model)
    if loss.objective == "autograd" or not loss.has_closed_derivatives:
        warnings.warn(
            f"{loss.registered_name}: no derivatives of its own: fits differentiate it by autograd, which is slower",
            SlowFitWarning,
            stacklevel=3,  # past the decorator
        )
    if loss.needs_rgb:
        measured.check_rgb(loss.registered_name)
    if not measured.is_rgb:
        check_bands(map(type, model.components()), bands_in_words(measured.channels, measured.wavelengths))
    model = with_channels(model, measured.channels)
    loss = loss if measured.is_rgb else loss.with_luminance(measured.luminance_shares)
    measured = measured.within(max_theta)
    dtype = torch.float32 if measured.dtype in HALVES else measured.dtype  # of what is given back
    measured = measured.to(dtype=working_dtype(measured, loss))
    model = model.batched(len(measured)).to(measured.device, measured.dtype)
    reasons = _check_start(model)
    model(measured.pairs.select(samples=slice(4)))  # says what is wrong with a lobe of one's own
    if diffuse == "45:0" and not (near := measured.has_45_0).all():
        name = measured.names[int(near.logical_not().nonzero()[0])]
        log.warning("torchbrdf: %s: no sample is near the 45:0 reading; the diffuse albedo is fitted, too", name)
        diffuse = "fit"
    if diffuse == "45:0":
        _set_diffuse(model, measured)
    subset = Subset(len(measured.pairs), samples, seed)
    specs = named_specs(model)
    start = {name: value.clamp(specs[name].lower, specs[name].upper) for name, value in get_parameters(model).items()}
    held = [] if diffuse == "fit" else diffuse_components(model)
    free_components = [part for k, part in enumerate(model.components()) if k not in held]
    free = sum(spec.size for part in free_components for spec in part.parameter_specs.values())

    if gathered is None:
        gathered = Gathered(measured, [model], [loss], executor, Shared(0))
    elif not isinstance(gathered, Gathered) or not gathered.is_of(measured):
        raise UsageError(f"fit: gathered: expected a Gathered of these materials within {max_theta:g} degrees")
    sums = None if intervals == BOOTSTRAP else gathered.find(model, loss)
    work = FitSome(
        model, start, loss, subset, strategy, diffuse == "fit", max_iterations, intervals, sums, gathered.shared
    )
    found: list[tuple[list[int], Fitted | Lost]] = []
    for rows, one in parallel_map(work, measured, None if sums is None else len(sums.probes), executor):
        found.append((rows, one))
        progress(sum(len(rows) for rows, _ in found), len(measured))
    done = _with_lost(found, start, reasons)
    status = _statuses(done, reasons, free, max_theta)
    found_values = {name: torch.cat([one.values[name] for one in done]).to(dtype) for name in start}
    intervals_found = joined_intervals([(one.values, one.intervals) for one in done])
    for row in without_grain(model, found_values, intervals_found):
        log.warning("torchbrdf: %s: the direction of the grain is not determined", measured.names[row])
    return FitResult(
        names=measured.names,
        model=with_parameters(model.to(dtype=dtype), found_values),
        loss=loss.registered_name,
        strategy=strategy_name(strategy),
        diffuse=diffuse,
        error=torch.cat([found.error for found in done]),
        subset_error=torch.cat([found.subset_error for found in done]),
        status=status,
        reason=[reasons.get(k, "") for k in range(len(status))],
        starts=done[0].outcome.starts,
        ties=[tie for found in done for tie in found.outcome.near_optimal or [0] * len(found.error)],
        seconds=time.perf_counter() - began,
        max_theta=max_theta,
        samples=subset.size(loss) if sums is None else None,
        seed=seed,
        scene=loss.scene_summary,
        chosen=[name for found in done for name in found.outcome.chosen or [""] * len(found.error)],
        intervals=intervals_found,
        wavelengths=measured.wavelengths,
        reading=[measured.source.reading(material) for material in measured.materials],
        noise=gathered.noise.of(loss, seed),
        undetermined=joined_truths([(one.values, one.open) for one in done]),
        history=[joined(list(stages)) for stages in zip(*(found.outcome.stages for found in done), strict=True)],
    )


def diffuse_mode(diffuse: str | None, loss: Loss, model: Lobe | None = None) -> str:
    """How a fit under a loss treats the diffuse albedo, one of DIFFUSE_MODES.

    Args:
        diffuse: what is asked for; None: as the loss has it, or a lobe of the model; "fit" for a model whose
            diffuse reflection is not Lambert's, or is a part of a whole material.
        loss: of the fit.
        model: of the fit.

    Raises:
        UsageError: there is no such mode, or the model has no albedo to measure.
    """
    parts = model.components() if model is not None else []
    mode = next((part.default_diffuse for part in parts if part.default_diffuse), loss.default_diffuse)
    mode = mode if diffuse is None else diffuse
    if mode not in DIFFUSE_MODES:
        raise UsageError(f"diffuse: expected one of {', '.join(DIFFUSE_MODES)}, found {mode!r}")
    without = [type(part) for part in parts if part.is_material or (part.is_diffuse and not isinstance(part, Lambert))]
    if mode == "fit" or not without:
        return mode
    if diffuse is None:
        return "fit"
    raise UsageError(f"diffuse: expected fit for {without[0].__name__}, found {mode}, which is of Lambert alone")


REASONS = {
    Status.MAX_ITERATIONS: "the solver's iterations were used up",
    Status.STALLED: "no better point was found, but the slope is not 0",
    Status.NOT_FINITE: "the error at the start is not finite",
}


def _with_lost(
    found: list[tuple[list[int], Fitted | Lost]], start: ParameterDict, reasons: dict[int, str]
) -> list[Fitted]:
    """Batches with, in the place of those whose processes died, where they began, without an error; says so."""
    kept = next((one for _, one in found if isinstance(one, Fitted)), None)
    stages = kept.outcome.stages if kept else [Stage("lost", [], [], [])]
    done = []
    for rows, one in found:
        if isinstance(one, Lost):
            reasons |= dict.fromkeys(rows, one.reason)
            count = len(rows)
            nothing = torch.full((count,), torch.nan, dtype=torch.float64, device="cpu")
            none = torch.zeros(count, dtype=torch.int64, device="cpu")
            lost = [Stage(stage.name, nothing.tolist(), [Status.LOST] * count, none.tolist()) for stage in stages]
            values = take_materials(start, rows)
            starts = kept.outcome.starts if kept else 0
            one = Fitted(values, Outcome(values, lost, starts), nothing, nothing, none, {}, {})
        done.append(one)
    return done


def _statuses(done: list[Fitted], reasons: dict[int, str], free: int, max_theta: float) -> list[Status]:
    """How each material's fit ended, with the reason, where it is none, added to `reasons`; free: parameters fitted."""
    status = [found.outcome.status(k) for found in done for k in range(len(found.error))]
    error = torch.cat([found.error for found in done])
    for k, count in enumerate(torch.cat([found.counts for found in done]).tolist()):
        if status[k] == Status.LOST:
            continue
        if k in reasons:
            status[k] = Status.BAD_START
        elif count == 0:
            status[k], reasons[k] = Status.NO_DATA, f"no valid sample within {max_theta:g} degrees"
        elif not error[k].isfinite():
            status[k], reasons[k] = Status.NOT_FINITE, f"the error is {error[k].item():g}"
        elif count < free:
            status[k], reasons[k] = Status.TOO_FEW_SAMPLES, f"{count} valid values for {free} parameters"
        elif status[k] != Status.CONVERGED:
            reasons[k] = REASONS[status[k]]
    return status


def _check_start(model: Lobe) -> dict[int, str]:
    """Which materials start outside the bounds, and how; a ShapeError if all do."""
    found: dict[int, str] = {}
    materials = 0
    for part in model.components():
        for name, spec in part.parameter_specs.items():
            value = getattr(part, name).detach().flatten(1)
            materials = len(value)
            outside = (value < spec.lower) | (value > spec.upper) | ~value.isfinite()
            for material, k in outside.nonzero().tolist():
                expected = f"expected {spec.lower:g} to {spec.upper:g}, found {value[material, k].item():g}"
                found.setdefault(material, f"start of {type(part).__name__}.{name}: {expected}")
    if found and len(found) == materials:
        raise ShapeError(found[0])
    return found


def _set_diffuse(model: Lobe, measured: Measured) -> None:
    diffuse = [part for part in model.components() if part.is_diffuse]
    if len(diffuse) > 1:
        raise ShapeError(f"fit: expected at most one diffuse term, found {len(diffuse)}")
    for part in diffuse:
        assert isinstance(part, Lambert)  # as diffuse_mode saw to it
        part.albedo.data = measured.diffuse_45_0().to(part.albedo)
