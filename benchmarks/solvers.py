"""The solver beside what a user would write: scipy's L-BFGS-B in a loop, with exact gradients from autograd.

    python benchmarks/solvers.py NICKEL.binary [MORE.binary ...] [--full 1]

1. The same 20,000 pairs and random starts, all parameters of two lobes at once: CPU seconds and errors, for losses that
   are sums of squares. Both stop when less than 1e-9 of black's squared error is to be gained.
2. Lambert + Cook-Torrance on 24,300 pairs under the log loss: CPU seconds a material.
3. Full tables: scipy in the paper's stages beside the whole global strategy, for the first materials (--full).

Everything on one thread.
"""

import argparse

import torch
from common import MODELS, Timer, by_graph, lobes_of, losses, scipy_fit, scipy_staged

from torchbrdf.fitting import Gathered, fit, stratified
from torchbrdf.fitting.objective import make_objective
from torchbrdf.lobes import make_model
from torchbrdf.losses import CompressedLoss, CosineRMSLoss, LogLoss, Problem, RMSLoss
from torchbrdf.measured import load
from torchbrdf.solvers import minimize_levenberg_marquardt


def same_pairs(measured, name, loss, samples, count=2):
    """CPU seconds and errors of scipy and of ours, from the same random starts."""
    subset = measured.batch(samples=stratified(len(measured.pairs), samples, 0))
    subset.values  # noqa: B018 (read before the clock starts)
    model, values, free = lobes_of(name, measured, count)
    low, high = free.limits()
    generator = torch.Generator().manual_seed(0)
    start = low + (high - low) * torch.rand(len(measured), len(low), generator=generator, dtype=torch.float64)
    theirs, ours = [], []
    with Timer() as scipy_timer:
        for k in range(len(measured)):
            own = {key: value[k : k + 1] for key, value in values.items()}
            objective = by_graph(own, free, subset.batch([k]), loss)
            x, _ = scipy_fit(objective, start[k].numpy(), free, ftol=1e-9, gtol=1e-9)
            theirs.append(objective(x)[0])
    with Timer() as timer:
        bound = make_objective(model, Problem(subset.pairs, subset.values), loss).bind(free, values)
        found = minimize_levenberg_marquardt(bound, start, low, high, ftol=1e-9, fmin=1.0, max_iterations=300)
        ours = found.value.tolist()
    ratios = sorted((a / b) ** 0.5 for a, b in zip(ours, theirs, strict=True))
    print(
        f"{name:18s} {type(loss).__name__:15s} scipy {scipy_timer.cpu:7.2f} CPU s, ours {timer.cpu:6.2f}: "
        f"{scipy_timer.cpu / timer.cpu:6.1f} times; {timer.cpu / len(ours):.4f} a material; errors {ratios[0]:.4f} to "
        f"{ratios[-1]:.4f} of scipy's, median {ratios[len(ratios) // 2]:.4f}",
        flush=True,
    )
    return scipy_timer.cpu, timer.cpu


def full_tables(measured, gathered, name, metric, loss):
    """CPU seconds and errors on every pair."""
    model, values, free = lobes_of(name, measured)
    evaluations, errors = 0, []
    with Timer() as scipy_timer:
        for k in range(len(measured)):
            part = measured.batch([k])
            own = {key: value[k : k + 1] for key, value in values.items()}
            found, calls = scipy_staged(model, own, part, loss)
            evaluations += calls
            errors.append(loss.error(free.predict(found, part.pairs), part.values, part.pairs).item())
    with Timer() as timer:
        result = fit(make_model(name, 2), measured, loss, gathered=gathered)
    ratio = [a / b for a, b in zip(result.error.tolist(), errors, strict=True)]
    print(
        f"{name:18s} {metric:9s} scipy {scipy_timer.cpu:7.1f} CPU s ({evaluations} evaluations), global "
        f"{timer.cpu:5.2f}: {scipy_timer.cpu / timer.cpu:6.1f} times; errors {min(ratio):.4f} to {max(ratio):.4f} of "
        "scipy's",
        flush=True,
    )
    return scipy_timer.cpu, timer.cpu


def main(files, full):
    """Print the three tables."""
    measured = load(files).within(80.0)
    print("1. same pairs, starts and stopping rule")
    times = [
        same_pairs(measured, name, loss, 20_000)
        for name in MODELS
        for loss in (RMSLoss(), CosineRMSLoss(), CompressedLoss(), LogLoss())
    ]
    print(
        f"all: {sum(a for a, _ in times) / sum(b for _, b in times):.1f} times\n"
        "2. Lambert + Cook-Torrance, 24,300 pairs"
    )
    same_pairs(measured, "cook_torrance", LogLoss(), 24_300, count=1)
    if not full:
        return
    print("3. full tables")
    some, metrics = measured.batch(list(range(full))), losses()
    with Timer() as shared:
        some.values  # noqa: B018 (read once for all, theirs and ours)
        models = [make_model(name, 2) for name in MODELS]
        gathered = Gathered(some, models, list(metrics.values()))
        gathered.find(models[0], metrics["rms"])
    print(f"reading, and one pass that the fits share: {shared.cpu:.2f} CPU s, counted as ours")
    times = [full_tables(some, gathered, name, metric, loss) for name in MODELS for metric, loss in metrics.items()]
    ours = shared.cpu + sum(b for _, b in times)
    print(
        f"all: scipy {sum(a for a, _ in times):.1f} CPU s, ours {ours:.2f}: {sum(a for a, _ in times) / ours:.1f} times"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="+")
    parser.add_argument("--full", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    main(options.files, options.full)
