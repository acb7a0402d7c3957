"""What the benchmarks share: the nine kinds of fit, and scipy in the place of a user who writes the loop."""

import statistics
import time

import numpy as np
import torch
from scipy.optimize import minimize

from torchbrdf.fitting.variables import Variable, decode, encode, evaluate, limits, values_of
from torchbrdf.lobes import make_model
from torchbrdf.losses import LOSSES

MODELS = ("ward", "cook_torrance", "ashikhmin_shirley")
METRICS = ("rms", "cosine", "cuberoot")


def lobes_of(name, measured, count=2):
    """A model, its parameters with the measured diffuse albedo, and what a fit moves."""
    model = make_model(name, count).batched(len(measured))
    values = values_of(model)
    values[0, "albedo"] = measured.diffuse_45_0()
    variables = [
        Variable(k, b, b.size) for k in range(1, count + 1) for b in model.components()[k].parameter_specs.values()
    ]
    return model, values, variables


def by_graph(model, values, variables, parts, part, loss):
    """The squared error of one material and its exact gradient, as a user gets them from torch's autograd."""
    black = loss.error(torch.zeros_like(part.values), part.values, part.pairs).item() ** 2

    def objective(x):
        with torch.enable_grad():
            point = torch.tensor(x[None], requires_grad=True)
            here = values | decode(variables, point, part.values.dtype)
            error = loss.error(evaluate(model, here, part.pairs, parts), part.values, part.pairs).square() / black
            (gradient,) = torch.autograd.grad(error.sum(), point)
        return error.item(), gradient[0].numpy()

    return objective


def scipy_fit(objective, x, variables, **options):
    """scipy's L-BFGS-B from x, within the bounds: the point and the evaluations."""
    low, high = (bound.numpy() for bound in limits(variables))
    options = {"maxiter": 1000, "maxfun": 2000, **options}
    found = minimize(
        objective, x, jac=True, bounds=list(zip(low, high, strict=True)), method="L-BFGS-B", options=options
    )
    return found.x, found.nfev


def scipy_staged(model, values, variables, part, loss):
    """The paper's stages by scipy on the pairs of one material: values, and how many evaluations they took."""
    steps = []
    for count in (1, 2):
        scalars = [v if not v.bounded.linear else Variable(v.part, v.bounded, 1) for v in variables if v.part <= count]
        steps.append((scalars, list(range(count + 1))))
    steps.append(([v for v in variables if v.bounded.linear], [0, 1, 2]))
    evaluations = 0
    for moved, parts in steps:
        objective = by_graph(model, values, moved, parts, part, loss)
        x, calls = scipy_fit(objective, encode(moved, values)[0].numpy(), moved)
        values = values | decode(moved, torch.from_numpy(np.ascontiguousarray(x))[None], part.values.dtype)
        evaluations += calls
    return values, evaluations


def losses():
    """The three metrics of the paper."""
    return {name: LOSSES[name]() for name in METRICS}


def seconds(work, times=7, warm=1):
    """The median time of some runs, after some that warm up."""
    for _ in range(warm):
        work()
    found = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return statistics.median(found)


class Timer:
    """Seconds on the clock and of the processors, its children's included."""

    def __enter__(self):
        self._clock, self._cpu = time.perf_counter(), _cpu()
        return self

    def __exit__(self, *_):
        self.clock, self.cpu = time.perf_counter() - self._clock, _cpu() - self._cpu


def _cpu():
    import resource

    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(use.ru_utime + use.ru_stime for use in both)
