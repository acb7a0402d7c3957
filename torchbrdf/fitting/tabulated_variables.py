"""The variables of a tabulated fit: from parameters and back, their bounds, where they start, and falling ones."""

import math

import torch
from torch import Tensor

from torchbrdf.fitting.tabulated_problem import TABLES, TabulatedProblem
from torchbrdf.lobes import DistributionBased, Lambert
from torchbrdf.lobes.distribution_based import FRESNEL_NODES, NODES
from torchbrdf.lobes.fresnel import fresnel
from torchbrdf.lobes.parameter_dict import ParameterDict

# The tables of a lobe, in the order of the variables.
NAMES = ("distribution", "fresnel_table")
# Cosines above which a pair says what D is, without shadowing.
CLEAR = 0.35
# The share of the darkest values, and how much of the brightest of these is taken to be diffuse.
DARKEST, DIFFUSE = 0.1, 0.8
# Values that are asked for the darkest.
ASKED = 20_000
# The least D that is read off.
LEAST = 1e-4


def encoded(problem: TabulatedProblem, values: ParameterDict) -> Tensor:
    """The variables of each problem where a fit starts, `(C M, P)`, float64.

    From the parameters; where all tables still have their declared starts, read off the data.
    """
    specs = DistributionBased.parameter_specs
    tables = [(values[own[name]], specs[name].start) for own in problem.lobes for name in NAMES]
    if all(bool((value == start).all()) for value, start in tables):
        return read_off(problem, values)
    parts = [value.double().log().mT.flatten(0, 1) for value, _ in tables]
    base = [_albedo(problem, values)[:, None]] * problem.base
    return torch.cat([*base, *parts], 1)


def decoded(problem: TabulatedProblem, x: Tensor, values: ParameterDict) -> ParameterDict:
    """The parameters that variables `(C M, P)` stand for, and the held ones among `values`."""
    found = dict(values)
    if problem.base and problem.albedo is not None:
        found[problem.albedo] = x[:, 0].unflatten(0, (-1, problem.channels)).to(values[problem.albedo])
    for own, tables in zip(problem.lobes, x[:, problem.base :].exp().split(TABLES, 1), strict=True):
        for name, table in zip(NAMES, tables.split([NODES, FRESNEL_NODES], 1), strict=True):
            spec = DistributionBased.parameter_specs[name]
            table = table.unflatten(0, (-1, problem.channels)).mT.to(values[own[name]])
            found[own[name]] = table.clamp(spec.lower, spec.upper)
    return found


def limits(problem: TabulatedProblem) -> tuple[Tensor, Tensor]:
    """Lower and upper bounds of the variables, `(P,)`, float64."""
    found = [(Lambert.albedo.lower, Lambert.albedo.upper)] * problem.base
    for _ in problem.lobes:
        for name, nodes in zip(NAMES, (NODES, FRESNEL_NODES), strict=True):
            spec = DistributionBased.parameter_specs[name]
            found += [(math.log(spec.lower), math.log(spec.upper))] * nodes
    lower, upper = torch.tensor(found, dtype=torch.float64, device=problem.target.device).mT
    return lower, upper


def read_off(problem: TabulatedProblem, values: ParameterDict) -> Tensor:
    """A diffuse albedo by the darkest values; D by the mean of the rest, divided among lobes from peak to flank."""
    weight, target, pairs = problem.weight.double(), problem.target.double(), problem.blocks.pairs
    weight = weight.repeat(len(target) // len(weight), 1)
    albedo = _darkest(target, weight) if problem.base else _albedo(problem, values)
    row = torch.arange(len(target), dtype=torch.int64, device=target.device) // problem.channels
    geometry = problem.geometry * fresnel(values[problem.lobes[0]["f0"]], pairs)
    clear = torch.minimum(pairs.cos_i, pairs.cos_o) > CLEAR
    own = (x.expand(len(target), -1) if len(x) == 1 else x[row] for x in (geometry, clear, problem.blocks.nearest_h))
    geometry, clear, node = own
    weight = weight * clear
    seen = torch.zeros(2, len(target), NODES, dtype=torch.float64, device=target.device)
    seen[0].scatter_add_(1, node, weight * (target - albedo[:, None] / math.pi).clamp_min(0))
    seen[1].scatter_add_(1, node, weight * geometry)
    distribution = (seen[0] / seen[1].clamp_min(LEAST) + LEAST).log()
    flank = torch.linspace(0.05, 0.95, NODES, dtype=torch.float64, device=target.device)
    flat, last = distribution.new_zeros(len(target), FRESNEL_NODES), len(problem.lobes) - 1
    parts = [albedo[:, None]] * problem.base
    for k in range(last + 1):
        share = math.comb(last, k) * flank**k * (1 - flank) ** (last - k)
        parts += [distribution + share.log(), flat]
    return torch.cat(parts, 1)


def _albedo(problem: TabulatedProblem, values: ParameterDict) -> Tensor:
    """The diffuse albedo of each problem, `(C M,)`."""
    if problem.albedo is None:
        return torch.zeros(len(problem), dtype=torch.float64, device=problem.target.device)
    return values[problem.albedo].double().flatten()


def _darkest(target: Tensor, weight: Tensor) -> Tensor:
    """An albedo by the darkest valid values of each problem, `(C M,)`."""
    every = max(1, target.shape[1] // ASKED)
    valid = torch.where(weight > 0, target, torch.inf)[:, ::every].sort(1).values
    count = valid.isfinite().sum(1, keepdim=True)
    dark = valid.gather(1, (DARKEST * count).long())[:, 0]
    return (dark.nan_to_num(posinf=0.0) * math.pi * DIFFUSE).clamp(Lambert.albedo.lower, Lambert.albedo.upper)


class Falling:
    """A problem whose variables are, in the place of each log D, by how much it is above the next one, at least 0."""

    def __init__(self, problem: TabulatedProblem) -> None:
        self.problem = problem
        self.tables = range(problem.base, problem.size, TABLES)
        self.change = torch.eye(problem.size, dtype=torch.float64, device="cpu")
        for first in self.tables:
            own = slice(first, first + NODES)
            self.change[own, own] = torch.ones(NODES, NODES, dtype=torch.float64, device="cpu").triu()
        self.change = self.change.to(problem.target.device)

    def encode(self, x: Tensor) -> Tensor:
        """The nearest variables from below."""
        x = x.clone()
        for first in self.tables:
            own = x[:, first : first + NODES].cummin(1).values
            x[:, first : first + NODES - 1] = -own.diff(dim=1)
            x[:, first + NODES - 1] = own[:, -1]
        return x

    def decode(self, y: Tensor) -> Tensor:
        """The variables of the problem itself."""
        return y @ self.change.mT

    def limits(self, lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor]:
        """Bounds from those of the problem itself."""
        lower, upper = lower.clone(), upper.clone()
        for first in self.tables:
            upper[first : first + NODES - 1] -= lower[first : first + NODES - 1]
            lower[first : first + NODES - 1] = 0
        return lower, upper

    def quadratic_model(self, y: Tensor, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, gradients and matrices by these variables."""
        value, gradient, matrix = self.problem.quadratic_model(self.decode(y), rows)
        return value, gradient @ self.change, self.change.mT @ matrix @ self.change
