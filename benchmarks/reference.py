"""The best errors that many random starts find: what `database.py` holds the global strategy against.

    python benchmarks/reference.py MERL/ [benchmarks/reference.json]

For every material of a folder, three models and three metrics: 64 starts at random within the bounds (on the solver's
scale), scipy's L-BFGS-B from each on 20,000 pairs with exact gradients (400 evaluations at most), and from the best
three on every pair within 80 degrees (300 at most); and the staged strategy. Both errors are kept, with five digits.
It takes about an hour for ten materials; what the file holds already is not made again.
"""

import json
import sys
from pathlib import Path

import numpy as np
import torch
from common import MODELS, lobes_of, losses, scipy_fit

from torchbrdf.files import write_json
from torchbrdf.fitting import fit, stratified
from torchbrdf.fitting.objective import make_objective
from torchbrdf.lobes import make_model
from torchbrdf.losses import Problem
from torchbrdf.measured import load
from torchbrdf.parallel import process_map

STARTS, FINISHED, SAMPLES, SEED = 64, 3, 20_000, 0


def best_of(measured, name, loss, k):
    """The least error of one material."""
    part = measured.batch([k])
    model, values, free = lobes_of(name, part)
    low, high = (bound.numpy() for bound in free.limits())

    def value_and_gradient(problem):
        objective = make_objective(model, problem, loss)
        bound = objective.bind(free, values)

        def call(x):
            value, gradient = bound.value_and_gradient(torch.from_numpy(x)[None], torch.tensor([0]))
            return value.item(), gradient[0].numpy()

        return call, objective.zero_prediction_error.sqrt().item()

    subset = part.batch(samples=stratified(len(part.pairs), SAMPLES, SEED))
    call, _ = value_and_gradient(Problem(subset.pairs, subset.values))
    points = low + (high - low) * np.random.default_rng(SEED).random((STARTS, len(low)))
    ends = [scipy_fit(call, x, free, maxfun=400)[0] for x in points]
    ends.sort(key=lambda x: call(x)[0])
    call, zero_prediction_error = value_and_gradient(Problem(part.pairs, part.values))
    return min(call(scipy_fit(call, x, free, maxfun=300)[0])[0] for x in ends[:FINISHED]) ** 0.5 * zero_prediction_error


def main(folder, path="reference.json"):
    """Make what is missing, and write the file after each kind of fit."""
    measured = load(folder)
    low = measured.within(80.0)
    path = Path(path)
    errors = json.loads(path.read_text())["errors"] if path.exists() else {}
    for name in MODELS:
        for metric, loss in losses().items():
            keys = [f"{material}/{name}/{metric}" for material in measured.names]
            if all(key in errors for key in keys):
                continue
            staged = fit(make_model(name, 2), measured, loss, strategy="staged").error.tolist()
            random = list(process_map(lambda k, n=name, ls=loss: best_of(low, n, ls, k), range(len(low))))
            for key, one, other in zip(keys, staged, random, strict=True):
                errors[key] = {"staged": float(f"{one:.5g}"), "random": float(f"{other:.5g}")}
            about = f"{STARTS} starts, best {FINISHED} finished, {SAMPLES} pairs, seed {SEED}"
            record = {"command": "python benchmarks/reference.py MERL/", "about": about, "errors": errors}
            write_json(path, record)
            print(name, metric, flush=True)


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main(*sys.argv[1:])
