"""The global strategy beside random starts, for every registered lobe: is the best fit found?

    python benchmarks/starts.py [--lobes ggx he] [--materials nickel pvc] [--samples 3000] [--starts 32] [--loss log]

Two lobes of each kind beside Lambert, with every parameter free, the diffuse albedo too; whole materials alone, and
diffuse terms as `TERM+ggx`. Random starts lie anywhere within the bounds on the solver's scale and go through the same
solver to convergence; those of tabulated lobes are D of GGX, of any width and height and with noise at each node,
beside any F. A row is a model: the worst and the mean ratio of the global strategy's error to the least of the random
ones', over the materials (at most 1.005 is wanted); how many of the random starts come within 1.005 of the best known;
and CPU seconds a material of either. The ten stand-ins, or --files, on one thread.
"""

import argparse
import math
import statistics

import torch
from common import Timer

from torchbrdf.fitting import TabulatedFit, fit, stratified
from torchbrdf.fitting.objective import GaussNewtonObjective, make_objective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.fitting.tabulated_problem import is_tabulated
from torchbrdf.fitting.task import lbfgs_fit, levenberg_marquardt_fit
from torchbrdf.lobes import LOBES, make_model
from torchbrdf.lobes.ggx import ggx_distribution
from torchbrdf.lobes.parameter_dict import get_parameters, with_parameters
from torchbrdf.losses import LOSSES
from torchbrdf.measured import load, standins

WANTED = 1.005


def model_of(name):
    """Two lobes, a whole material, or a diffuse term with a lobe of another kind."""
    kind = LOBES[name]
    if kind.is_material:
        return make_model(name, dtype=torch.float64)
    return make_model(f"{name}+ggx", dtype=torch.float64) if kind.is_diffuse else make_model(name, 2, torch.float64)


def from_random_starts(model, measured, loss, count, seed):
    """The errors that the solver ends at, `(starts, materials)`."""
    batched = model.batched(len(measured))
    free = Parametrization(batched, free_parameters(batched, range(len(batched.components()))))
    objective = make_objective(batched, loss.problem(measured), loss)
    low, high = free.limits()
    generator = torch.Generator().manual_seed(seed)
    x = low + (high - low) * torch.rand(count, len(measured), len(low), generator=generator, dtype=torch.float64)
    held = get_parameters(batched)
    if not isinstance(objective, GaussNewtonObjective):
        starts = [held | free.decode(one, torch.float64) for one in x]
        found = [lbfgs_fit(objective, start, free, max_iterations=1000)[1].value for start in starts]
        return torch.stack(found).nan_to_num(torch.inf)
    together = {name: value.repeat(count, *[1] * (value.dim() - 1)) for name, value in held.items()}
    start, rows = together | free.decode(x.flatten(0, 1), torch.float64), objective.material_indices.repeat(count)
    found = levenberg_marquardt_fit(objective, start, free, materials=rows, max_iterations=1000)[1].value
    return found.reshape(count, -1).nan_to_num(torch.inf)


def from_random_tables(model, measured, loss, count, seed):
    """The same of tabulated lobes, by their own solver."""
    generator = torch.Generator().manual_seed(seed)
    held, found = get_parameters(model.batched(len(measured))), []
    for _ in range(count):
        start = {key: _random_table(key, value, generator) for key, value in held.items()}
        options = {"diffuse": "fit", "samples": None, "intervals": "none"}
        found.append(fit(with_parameters(model, start), measured, loss, strategy=TabulatedFit(), **options).error)
    return torch.stack(found).double().nan_to_num(torch.inf)


def _random_table(key, value, generator):
    def noise(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    many, nodes = len(value), value.shape[-2] if value.dim() == 3 else 1
    if key.endswith("albedo"):
        return torch.rand(value.shape, generator=generator, dtype=torch.float64)
    if key.endswith("fresnel_table"):
        return noise(many, nodes, 3).exp()
    if not key.endswith("distribution"):
        return value
    alpha = (math.log(0.005) * torch.rand(many, 1, generator=generator, dtype=torch.float64)).exp()
    theta = ((torch.arange(nodes, dtype=torch.float64) + 0.5) / nodes).square() * (math.pi / 2)
    shape = ggx_distribution(alpha, theta.tan().square())
    return (shape[..., None] * (2 * noise(many, 1, 1) - 2 + 0.5 * noise(many, nodes, 3)).exp()).clamp(1e-6, 1e6)


def compare(name, measured, loss, starts, seed):
    """One row."""
    model = model_of(name)
    with Timer() as ours:
        found = fit(model, measured, loss, diffuse="fit", samples=None).error.double()
    with Timer() as theirs:
        search = from_random_tables if is_tabulated(model) else from_random_starts
        errors = search(model, measured, loss, starts, seed)
    best = errors.amin(0)
    ratios = (found / best).tolist()
    reached = (errors <= WANTED * torch.minimum(best, found)).double().mean().item()
    worst = max(range(len(ratios)), key=ratios.__getitem__)
    above = sum(one > WANTED for one in ratios)
    print(
        f"{name:18s} worst {ratios[worst]:7.4f} ({measured.names[worst]}), mean {statistics.mean(ratios):7.4f}, "
        f"{above} of {len(ratios)} above {WANTED}; {reached:4.0%} of random starts arrive; "
        f"CPU s a material {ours.cpu / len(ratios):6.2f}, of {starts} starts {theirs.cpu / len(ratios):7.2f}",
        flush=True,
    )
    return max(ratios)


def main(options):
    """Print a row for each lobe, and those that miss."""
    measured = load(options.files or standins(), dtype=torch.float64).within(80.0)
    if options.materials:
        measured = measured.batch([measured.names.index(name) for name in options.materials])
    measured = measured.batch(samples=stratified(len(measured.pairs), options.samples, 0))
    measured.values  # noqa: B018 (read before the clock starts)
    loss = LOSSES[options.loss]()
    worst = {
        name: compare(name, measured, loss, options.starts, options.seed)
        for name in options.lobes or LOBES
        if name != "lambert"
    }
    missing = [name for name, ratio in worst.items() if ratio > WANTED]
    print(f"{len(worst) - len(missing)} of {len(worst)} models within {WANTED}; not: {', '.join(missing) or 'none'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", nargs="+", help="MERL tables in the place of the ten stand-ins")
    parser.add_argument("--lobes", nargs="+", choices=list(LOBES))
    parser.add_argument("--materials", nargs="+", help="names of some of them")
    parser.add_argument("--samples", type=int, default=3000)
    parser.add_argument("--starts", type=int, default=32)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--loss", default="compressed", choices=list(LOSSES))
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    main(parser.parse_args())
