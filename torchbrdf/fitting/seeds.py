"""Where to start: a dictionary of shapes, and for every combination of them the best albedos.

A lobe is linear in its albedo and, with Schlick's Fresnel, affine in F0. For each shape on a grid, the lobe at albedo 1
with its affine parameters at either end are the atoms; a lobe within its bounds is a sum of them with factors of at
least 0, and the best factors are a small least-squares problem with bounds. Colours share one F0, which is relaxed here
and projected afterwards. All of it follows from what lobes declare.
"""

import itertools
import math

import torch
from torch import Tensor

from torchbrdf.fitting.quadratic import minimize_quadratic
from torchbrdf.fitting.solve import Task
from torchbrdf.fitting.variables import Values
from torchbrdf.lobes import Bounded, Lobe
from torchbrdf.pairs import Pairs

# Shapes a lobe.
GRID = 16
# Combinations that are extended when another lobe is added, beyond the second.
BEAM = 8


def seeds(task: Task, values: Values, fit_diffuse: bool, wanted: int) -> Values:
    """The best `wanted` starts for each of M materials, none near another: starts after starts, `(wanted * M, ...)`."""
    problem = task.problem
    materials = len(task)
    if problem.pairs.shape[0] > 1:  # no atoms to share
        own = [
            seeds(task.of(k), {key: value[k : k + 1] for key, value in values.items()}, fit_diffuse, wanted)
            for k in range(materials)
        ]
        return {key: torch.stack([found[key] for found in own], 1).flatten(0, 1) for key in values}
    lobes = [task.model.parts()[k] for k in task.specular]
    kinds = [_Dictionary(lobe, problem.pairs) for lobe in lobes]
    target = problem.target.transpose(1, 2).double()
    diffuse = [values[k, "albedo"].double() / math.pi for k in task.diffuse]
    base = [torch.full((1, target.shape[-1]), 1 / math.pi, dtype=torch.float64, device=target.device)] * fit_diffuse
    if not fit_diffuse:
        target = target - sum(diffuse, torch.zeros(()))[..., None]
    unique: list[_Dictionary] = []
    offset: list[int] = []
    total = len(base)
    for index, lobe in enumerate(lobes):
        same = next((i for i in range(index) if type(lobes[i]) is type(lobe)), None)
        if same is None:
            unique.append(kinds[index])
            offset.append(total)
            total += kinds[index].atoms.shape[0] * kinds[index].atoms.shape[1]
        else:
            kinds[index] = kinds[same]
            offset.append(offset[same])
    atoms = torch.cat([*base, *(kind.atoms.flatten(0, 1) for kind in unique)])
    weight = _weight(task)
    gram = (weight[..., None, :] * atoms) @ atoms.T
    right = -((weight * target) @ atoms.T)
    picked = torch.zeros(materials, 1, 0, dtype=torch.long, device=target.device)
    for depth, kind in enumerate(kinds):
        count = len(kind.grid)
        more = torch.arange(count, device=target.device).expand(materials, picked.shape[1], count)
        picked = torch.cat([picked[:, :, None].expand(-1, -1, count, -1), more[..., None]], -1).flatten(1, 2)
        if depth and kinds[depth - 1] is kind:  # equal lobes in no order: each combination once
            ordered = picked[..., depth - 1] <= picked[..., depth]
            picked = torch.stack([one[keep] for one, keep in zip(picked, ordered, strict=True)])
        used = _columns(picked, kinds[: depth + 1], offset, len(base))
        factor, score = _solve(gram, right, used)
        keep = BEAM if 0 < depth < len(kinds) - 1 else score.shape[1]
        best = score.argsort(1)[:, :keep]
        picked, factor = _take(picked, best), _take(factor.transpose(1, 2), best)
    chosen = _apart(picked, kinds, wanted)
    return _values(task, values, kinds, _take(picked, chosen), _take(factor, chosen), fit_diffuse)


class _Dictionary:
    """The shapes of one kind of lobe, and its atoms: shapes times ends of the affine parameters, `(K, E, N)`."""

    def __init__(self, lobe: Lobe, pairs: Pairs) -> None:
        self.scalars = lobe.scalars()
        self.shapes = [bounded for bounded in self.scalars if not bounded.affine]
        self.affine = [bounded for bounded in self.scalars if bounded.affine]
        each = max(2, round(GRID ** (1 / max(len(self.shapes), 1))))
        place = (torch.arange(each, dtype=torch.float64) + 0.5) / each
        grid = torch.cartesian_prod(*[place] * len(self.shapes)) if self.shapes else torch.zeros(1, 0)
        self.grid = grid.reshape(-1, len(self.shapes)).to(torch.float64)
        self.reach = 1.5 / each
        self.ends = list(itertools.product(*[(bounded.lower, bounded.upper) for bounded in self.affine]))
        device, dtype = pairs.device, pairs.dtype
        columns = []
        for end in self.ends:
            given = dict(zip((bounded.name for bounded in self.affine), end, strict=True))
            named = {bounded.name: _from_unit(bounded, self.grid[:, i]) for i, bounded in enumerate(self.shapes)} | {
                name: torch.full((len(self.grid),), value, dtype=torch.float64) for name, value in given.items()
            }
            scalars = [named[bounded.name][:, None].to(device, dtype) for bounded in self.scalars]
            own = Pairs(**{name: value for name, value in pairs._known.items() if name not in ("wi", "wo")})
            shape = type(lobe).linearized(own, *scalars)[0]
            columns.append(shape.double())
        self.atoms = torch.stack(columns, 1)


def _from_unit(bounded: Bounded, place: Tensor) -> Tensor:
    """A value within the bounds from 0 to 1, on the scale that solvers use."""
    if bounded.log:
        return (math.log(bounded.lower) + place * math.log(bounded.upper / bounded.lower)).exp()
    return bounded.lower + place * (bounded.upper - bounded.lower)


def _weight(task: Task) -> Tensor:
    """The weight of a squared difference of values that stands in for the loss, `(M|1, 3|1, N)`.

    It is the curvature of the loss for predictions that are off by a quarter and a little of the mean.
    """
    data, loss, problem = task.data, task.loss, task.problem
    target = problem.target.transpose(1, 2)
    mean = target.mean((1, 2), keepdim=True)
    off = (1.25 * target + 0.05 * mean).clamp_min(0)
    encoded, rate = loss.encode_slope(off.transpose(1, 2), problem.pairs)
    width = None if loss.rounding[0] is None else (loss.rounding[0] * data.spread)[:, None, None].to(target)
    _, _, curve = loss.penalty_slope(encoded.transpose(1, 2) - data.target, width)
    weight = (curve * rate.transpose(-1, -2).square()).double()
    weight = weight if data.weight is None else weight * data.weight
    return weight.expand(*weight.shape[:2], target.shape[-1])


def _columns(picked: Tensor, kinds: list[_Dictionary], offset: list[int], base: int) -> Tensor:
    """The atoms of each combination `(M, C, d)`, `(M, C, base + d E)`."""
    found = [torch.arange(base, device=picked.device).expand(*picked.shape[:2], base)]
    for k, kind in enumerate(kinds):
        ends = torch.arange(len(kind.ends), device=picked.device)
        found.append(offset[k] + picked[..., k, None] * len(kind.ends) + ends)
    return torch.cat(found, -1)


def _solve(gram: Tensor, right: Tensor, used: Tensor) -> tuple[Tensor, Tensor]:
    """The factors of the atoms for each channel, `(M, 3, C, q)`, between 0 and 1, and what they gain, `(M, C)`."""
    materials, _, size = used.shape
    gram = gram.expand(materials, 3, -1, -1)
    m = torch.arange(materials, device=used.device)[:, None, None]
    c = torch.arange(3, device=used.device)[:, None]
    index = used[:, None]
    matrix = gram[m[..., None, None], c[..., None, None], index[..., :, None], index[..., None, :]]
    slope = right[m[..., None], c[..., None], index]
    scale = torch.diagonal(matrix, dim1=-2, dim2=-1).clamp_min(1e-300).rsqrt()
    matrix = matrix * scale[..., :, None] * scale[..., None, :]
    matrix = matrix + 1e-9 * torch.eye(size, dtype=matrix.dtype, device=matrix.device)
    upper = 1 / scale
    factor = minimize_quadratic(matrix, slope * scale, torch.zeros_like(upper), upper)
    gain = (slope * scale * factor).sum(-1) + 0.5 * (factor * (matrix @ factor[..., None])[..., 0]).sum(-1)
    return factor * scale, gain.sum(1).nan_to_num(math.inf)


def _take(values: Tensor, index: Tensor) -> Tensor:
    """Entries `(M, C, ...)` at an index `(M, c)`."""
    return values[torch.arange(len(index), device=index.device)[:, None], index]


def _apart(picked: Tensor, kinds: list[_Dictionary], wanted: int) -> Tensor:
    """The first combinations of each material that are no neighbours of each other, `(M, wanted)`."""
    place = torch.cat([kind.grid.to(picked.device)[picked[..., k]] for k, kind in enumerate(kinds)], -1)
    reach = max(kind.reach for kind in kinds)
    taken = torch.zeros(picked.shape[:2], dtype=torch.bool, device=picked.device)
    chosen = []
    for _ in range(wanted):
        # When nothing is left the best is taken again.
        first = (~taken).to(torch.int8).argmax(1)
        chosen.append(first)
        taken |= ((place - _take(place, first[:, None])).abs() < reach).all(-1)
    return torch.stack(chosen, 1)


def _values(
    task: Task, values: Values, kinds: list[_Dictionary], picked: Tensor, factor: Tensor, fit_diffuse: bool
) -> Values:
    """Parameters from shapes `(M, S, d)` and factors `(M, S, 3, q)`, as starts after starts."""
    starts = picked.shape[1]

    def rows(value: Tensor, like: Tensor) -> Tensor:
        return value.transpose(0, 1).flatten(0, 1).to(like)

    found = {key: value.repeat(starts, *[1] * (value.dim() - 1)) for key, value in values.items()}
    first = 0
    if fit_diffuse:
        for k in task.diffuse:
            found[k, "albedo"] = rows(factor[..., 0], values[k, "albedo"])
        first = 1
    for i, (k, kind) in enumerate(zip(task.specular, kinds, strict=True)):
        lobe = task.model.parts()[k]
        color = lobe.color()
        assert color is not None
        own = factor[..., first : first + len(kind.ends)]
        first += len(kind.ends)
        like = values[k, color.name]
        found[k, color.name] = rows(own.sum(-1).clamp(color.lower, color.upper), like)
        share = own.sum(-2) / own.sum((-2, -1)).clamp_min(1e-300)[..., None]
        for j, bounded in enumerate(kind.affine):
            high = torch.tensor([end[j] == bounded.upper for end in kind.ends], dtype=share.dtype, device=share.device)
            place = (share * high).sum(-1, keepdim=True)
            found[k, bounded.name] = rows(bounded.lower + place * (bounded.upper - bounded.lower), like)
        for j, bounded in enumerate(kind.shapes):
            grid = _from_unit(bounded, kind.grid[:, j]).to(picked.device)
            found[k, bounded.name] = rows(grid[picked[..., i]][..., None], like)
    return found
