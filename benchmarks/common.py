"""What the benchmarks share: the nine kinds of fit, and scipy in the place of a user who writes the loop."""

import statistics
import time

import numpy as np
import torch
from scipy.optimize import minimize

from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.lobes import make_model
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.losses import LOSSES

MODELS = ("ward", "cook_torrance", "ashikhmin_shirley")
METRICS = ("rms", "cosine_rms", "cube_root")


def lobes_of(name, measured, count=2):
    """A model, its parameters with the measured diffuse albedo, and what a fit moves."""
    model = make_model(name, count).batched(len(measured))
    values = get_parameters(model) | {"lobes.0.albedo": measured.diffuse_45_0()}
    return model, values, Parametrization(model, free_parameters(model, range(1, count + 1)))


def by_graph(values, free, part, loss):
    """The squared error of one material and its exact gradient, as a user gets them from torch's autograd."""
    zero_prediction_error = loss.error(torch.zeros_like(part.values), part.values, part.pairs).item() ** 2

    def objective(x):
        with torch.enable_grad():
            point = torch.tensor(x[None], requires_grad=True)
            here = values | free.decode(point, part.values.dtype)
            error = loss.error(free.predict(here, part.pairs), part.values, part.pairs).square() / zero_prediction_error
            (gradient,) = torch.autograd.grad(error.sum(), point)
        return error.item(), gradient[0].numpy()

    return objective


def scipy_fit(objective, x, free, **options):
    """scipy's L-BFGS-B from x, within the bounds: the point and the evaluations."""
    low, high = (bound.numpy() for bound in free.limits())
    options = {"maxiter": 1000, "maxfun": 2000, **options}
    found = minimize(
        objective, x, jac=True, bounds=list(zip(low, high, strict=True)), method="L-BFGS-B", options=options
    )
    return found.x, found.nfev


def scipy_staged(model, values, part, loss):
    """The paper's stages by scipy on the pairs of one material: values, and how many evaluations they took."""
    scalars = [free_parameters(model, range(1, count + 1), scalar_albedo=True) for count in (1, 2)]
    albedos = [one for one in free_parameters(model, (1, 2)) if one.spec.linear]
    evaluations = 0
    for step, components in ((scalars[0], (0, 1)), (scalars[1], None), (albedos, None)):
        free = Parametrization(model, step, components)
        x, calls = scipy_fit(by_graph(values, free, part, loss), free.encode(values)[0].numpy(), free)
        values = values | free.decode(torch.from_numpy(np.ascontiguousarray(x))[None], part.values.dtype)
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
