"""Where to start: a dictionary of shapes, and for every combination of them the best albedos.

A lobe is linear in its albedo and, with Schlick's Fresnel, affine in F0. For each shape on a grid, the lobe at albedo 1
with its affine parameters at either end are the atoms; a lobe within its bounds is a sum of them with factors of at
least 0, and the best factors are a small least-squares problem with the bounds of the lobe's colour. Colours share one
F0, which is relaxed here and projected afterwards. All of it follows from what lobes declare.
"""

import itertools
import math

import torch
from torch import Tensor

from torchbrdf.fitting.objective import GaussNewtonObjective
from torchbrdf.fitting.parameters import diffuse_components, specular_components
from torchbrdf.lobes import BoundedParameter, Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names, take_materials
from torchbrdf.pairs import Pairs
from torchbrdf.solvers import solve_bounded_qp


def has_dictionary(model: Lobe) -> bool:
    """Whether all lobes beside the diffuse term are an albedo times a scalar function."""
    lobes = model.components()
    return all(lobes[k].albedo_spec() is not None for k in specular_components(model))


def most_shape_parameters(model: Lobe) -> int:
    """How many numbers the shape of one of its lobes has at most: with several, the grid of a dictionary is coarse."""
    lobes = model.components()
    return max((sum(not one.affine for one in lobes[k].scalars()) for k in specular_components(model)), default=0)


def starts_from_dictionary(
    model: Lobe,
    objective: GaussNewtonObjective,
    values: ParameterDict,
    fit_diffuse: bool,
    wanted: int,
    *,
    shapes: int = 16,
    beam: int = 8,
) -> ParameterDict:
    """The best starts for each of M materials, none near another: starts after starts, `(S * M, ...)`.

    They are `wanted`, and one more where two equal lobes of one shape can differ in F0 (see `_twins_apart`).

    values: the parameters that are held, and those of the diffuse component, `(M, ...)`; shapes: of a lobe; beam:
    combinations of lobes that are extended by one more, from the third on.
    """
    pairs = objective.problem.pairs
    if pairs.shape[0] > 1:  # no atoms to share
        options = {"shapes": shapes, "beam": beam}
        own = [
            starts_from_dictionary(
                model, objective.select(k), take_materials(values, slice(k, k + 1)), fit_diffuse, wanted, **options
            )
            for k in range(len(objective))
        ]
        return {key: torch.stack([found[key] for found in own], 1).flatten(0, 1) for key in values}
    diffuse, components, names = diffuse_components(model), model.components(), component_names(model)
    fit_diffuse = fit_diffuse and bool(diffuse)
    flat = torch.full((1, len(pairs)), 1 / math.pi, dtype=torch.float64, device=pairs.device)
    atoms = [flat] * fit_diffuse
    target = objective.target
    if not fit_diffuse:
        for k in diffuse:
            target = target - values[names[k]["albedo"]].double()[..., None] * objective.observe(flat)[..., 0, :]
    dictionaries: list[LobeDictionary] = []
    for k in specular_components(model):
        same = [one for one in dictionaries if type(one.lobe) is type(components[k])]
        dictionaries.append(same[0] if same else LobeDictionary(components[k], pairs, sum(map(len, atoms)), shapes))
        atoms += [] if same else [dictionaries[-1].atoms]
    columns = objective.observe(torch.cat(atoms))
    weight = _weight(objective)
    gram = (weight[..., None, :] * columns) @ columns.mT
    right = -((weight * target)[..., None, :] @ columns.mT)[..., 0, :]
    base = [_limits(components[diffuse[0]].parameter_specs["albedo"], 1)] if fit_diffuse else []
    unique = {id(one): one for one in dictionaries}.values()
    limits = torch.cat([*base, *(one.limits for one in unique)], 1).to(gram)
    picked, factor = _search(gram, right, limits, dictionaries, int(fit_diffuse), beam)
    chosen = _suppress_neighbours(picked, dictionaries, wanted)
    twins = _twins(picked, dictionaries)
    if bool(twins.any()):
        chosen = torch.cat([chosen, twins.to(torch.int8).argmax(1, keepdim=True)], 1)
    picked, factor = _take(picked, chosen), _take(factor, chosen)
    return _starts(model, values, dictionaries, picked, factor, fit_diffuse)


class LobeDictionary:
    """One kind of lobe: its shapes on a grid, and its atoms, shapes times ends of the affine parameters.

    grid: `(K, S)`, from 0 to 1 on the solver's scale; ends: E tuples; atoms: `(K E, N)`; first: the column of the
    first of them; limits: of each factor, `(2, K E)`.
    """

    def __init__(self, lobe: Lobe, pairs: Pairs, first: int, shapes: int) -> None:
        self.lobe, self.first = lobe, first
        self.shapes = [spec for spec in lobe.scalars() if not spec.affine]
        self.affine = [spec for spec in lobe.scalars() if spec.affine]
        size = max(2, round(shapes ** (1 / max(len(self.shapes), 1))))
        place = (torch.arange(size, dtype=torch.float64, device=pairs.device) + 0.5) / size
        self.grid = torch.cartesian_prod(*[place] * len(self.shapes)) if self.shapes else place.new_zeros(1, 0)
        self.grid = self.grid.reshape(-1, len(self.shapes))
        self.reach = 1.5 / size
        self.ends = list(itertools.product(*[(spec.lower, spec.upper) for spec in self.affine]))
        columns = []
        for end in self.ends:
            named = {one.name: from_unit(one, self.grid[:, i]) for i, one in enumerate(self.shapes)}
            named |= {one.name: place.new_full((len(self.grid),), v) for one, v in zip(self.affine, end, strict=True)}
            scalars = [named[spec.name][:, None].to(pairs.dtype) for spec in lobe.scalars()]
            columns.append(type(lobe).value_and_jacobian(pairs, *scalars)[0].expand(len(self.grid), -1).double())
        self.atoms = torch.stack(columns, 1).flatten(0, 1)
        color = lobe.albedo_spec()
        assert color is not None
        self.limits = _limits(color, len(self.ends)).repeat(1, len(self.grid))

    def columns(self, picked: Tensor) -> Tensor:
        """The atoms of the shapes `picked`, `(...)` to `(..., E)`."""
        ends = torch.arange(len(self.ends), dtype=torch.int64, device=picked.device)
        return self.first + picked[..., None] * len(self.ends) + ends


def _limits(color: BoundedParameter, ends: int) -> Tensor:
    """The least and the largest factor of each of a lobe's atoms with one shape, by its colour, `(2, ends)`.

    Where several atoms make up the colour together, one alone may be 0 although the colour may not.
    """
    lower = color.lower if ends == 1 else min(color.lower, 0.0)
    return torch.tensor([[lower], [color.upper]], dtype=torch.float64, device="cpu").expand(2, ends)


def from_unit(spec: BoundedParameter, place: Tensor) -> Tensor:
    """A value within the bounds from 0 to 1 on the scale that solvers use."""
    if spec.log:
        return spec.lower * (place * math.log(spec.upper / spec.lower)).exp()
    return spec.lower + place * (spec.upper - spec.lower)


def _weight(objective: GaussNewtonObjective) -> Tensor:
    """The weight of a squared difference of values (or observations) that stands in for the loss, `(M|1, C|1, P)`.

    It is the curvature of the loss for predictions that are off by a quarter and a little of the mean.
    """
    target = objective.target
    off = (1.25 * target + 0.05 * target.mean((1, 2), keepdim=True)).clamp_min(0)
    weight = objective.curvature_at(off)
    return weight.expand(*weight.shape[:2], target.shape[-1])


def _search(
    gram: Tensor, right: Tensor, limits: Tensor, dictionaries: list[LobeDictionary], base: int, beam: int
) -> tuple[Tensor, Tensor]:
    """Combinations of shapes, the best first, `(M, S, lobes)`, and their factors, `(M, S, C, q)`.

    gram: `(M|1, C|1, Q, Q)`; right: `(M, C, Q)`; limits: of the factors, `(2, Q)`; the first `base` columns
    are in every combination.
    """
    picked = torch.zeros(len(right), 1, 0, dtype=torch.long, device=right.device)
    for depth, kind in enumerate(dictionaries):
        more = torch.arange(len(kind.grid), dtype=torch.int64, device=right.device).expand(*picked.shape[:2], -1)
        picked = torch.cat([picked[:, :, None].expand(-1, -1, len(kind.grid), -1), more[..., None]], -1).flatten(1, 2)
        used = [torch.arange(base, dtype=torch.int64, device=right.device).expand(*picked.shape[:2], base)]
        used += [one.columns(picked[..., k]) for k, one in enumerate(dictionaries[: depth + 1])]
        factor, error = _factors(gram, right, limits, torch.cat(used, -1))
        if depth and dictionaries[depth - 1] is kind:  # equal lobes in no order: each combination once
            error = torch.where(picked[..., depth - 1] <= picked[..., depth], error, math.inf)
        finite = int(error.isfinite().sum(1).min())
        best = error.argsort(1)[:, : min(finite, beam) if 0 < depth < len(dictionaries) - 1 else max(finite, 1)]
        picked, factor = _take(picked, best), _take(factor.transpose(1, 2), best)
    return picked, factor


def _factors(gram: Tensor, right: Tensor, limits: Tensor, used: Tensor) -> tuple[Tensor, Tensor]:
    """The best factors of combinations of columns, within their limits, and their errors.

    used: `(M, S, q)`; the factors: for each channel, `(M, C, S, q)`; the errors, but for a constant: `(M, S)`.
    """
    materials, _, size = used.shape
    channels = right.shape[1]
    gram = gram.expand(materials, channels, -1, -1)
    m = torch.arange(materials, dtype=torch.int64, device=used.device)[:, None, None]
    c = torch.arange(channels, dtype=torch.int64, device=used.device)[:, None]
    index = used[:, None]
    matrix = gram[m[..., None, None], c[..., None, None], index[..., :, None], index[..., None, :]]
    slope = right[m[..., None], c[..., None], index]
    scale = torch.diagonal(matrix, dim1=-2, dim2=-1).clamp_min(1e-300).rsqrt()
    matrix = matrix * scale[..., :, None] * scale[..., None, :]
    matrix = matrix + 1e-9 * torch.eye(size, dtype=matrix.dtype, device=matrix.device)
    lower, upper = limits[:, used][:, :, None]
    small = (part.cpu().numpy() for part in (matrix, slope * scale, lower / scale, upper / scale))
    factor = torch.from_numpy(solve_bounded_qp(*small)).to(scale)
    error = (slope * scale * factor).sum(-1) + 0.5 * (factor * (matrix @ factor[..., None])[..., 0]).sum(-1)
    return factor * scale, error.sum(1).nan_to_num(0.0)


def _take(values: Tensor, index: Tensor) -> Tensor:
    """Entries of `(M, S, ...)` at an index `(M, s)`."""
    return values[torch.arange(len(index), dtype=torch.int64, device=index.device)[:, None], index]


def _suppress_neighbours(picked: Tensor, dictionaries: list[LobeDictionary], wanted: int) -> Tensor:
    """The first combinations of each material that are no neighbours of each other, `(M, wanted)`."""
    place = torch.cat([one.grid[picked[..., k]] for k, one in enumerate(dictionaries)], -1)
    reach = max(kind.reach for kind in dictionaries)
    taken = torch.zeros(picked.shape[:2], dtype=torch.bool, device=picked.device)
    chosen = []
    for _ in range(wanted):
        first = (~taken).to(torch.int8).argmax(1)  # when none is left, the best again
        chosen.append(first)
        taken |= ((place - _take(place, first[:, None])).abs() < reach).all(-1)
    return torch.stack(chosen, 1)


def _twins(picked: Tensor, dictionaries: list[LobeDictionary]) -> Tensor:
    """Which combinations are of two equal lobes of one shape with one affine parameter, `(M, S)`."""
    if len(dictionaries) != 2 or dictionaries[0] is not dictionaries[1] or len(dictionaries[0].ends) != 2:
        return torch.zeros(picked.shape[:2], dtype=torch.bool, device=picked.device)
    return picked[..., 0] == picked[..., 1]


def _twins_apart(parts: list[Tensor], twins: Tensor) -> list[Tensor]:
    """Factors of two lobes where twins take an end of F0 each, `(M, S, C, 2)`.

    Together they have then an F0 of its own in each channel, as the dictionary has, which one lobe has not.
    """
    if len(parts) != 2 or parts[0].shape[-1] != 2:
        return parts
    both, low = parts[0] + parts[1], parts[0].new_tensor([1.0, 0.0])
    ends = (both * low, both * (1 - low))
    return [torch.where(twins[..., None, None], end, own) for end, own in zip(ends, parts, strict=True)]


def _starts(
    model: Lobe,
    values: ParameterDict,
    dictionaries: list[LobeDictionary],
    picked: Tensor,
    factor: Tensor,
    fit_diffuse: bool,
) -> ParameterDict:
    """Parameters from shapes `(M, S, lobes)` and factors `(M, S, C, q)`, starts after starts."""
    starts, names = picked.shape[1], component_names(model)
    found = {key: value.repeat(starts, *[1] * (value.dim() - 1)) for key, value in values.items()}

    def put(k: int, name: str, value: Tensor) -> None:
        full = names[k][name]
        found[full] = value.transpose(0, 1).flatten(0, 1).to(values[full])

    if fit_diffuse:
        for k in diffuse_components(model):
            put(k, "albedo", factor[..., 0])
        factor = factor[..., 1:]
    parts = _twins_apart(list(factor.split([len(one.ends) for one in dictionaries], -1)), _twins(picked, dictionaries))
    for i, (k, one) in enumerate(zip(specular_components(model), dictionaries, strict=True)):
        color, own = one.lobe.albedo_spec(), parts[i]
        assert color is not None
        put(k, color.name, own.sum(-1).clamp(color.lower, color.upper))
        share = own.sum(-2) / own.sum((-2, -1)).clamp_min(1e-300)[..., None]
        for j, spec in enumerate(one.affine):
            high = share.new_tensor([float(end[j] == spec.upper) for end in one.ends])
            place = (share * high).sum(-1, keepdim=True)
            put(k, spec.name, (spec.lower + place * (spec.upper - spec.lower)).clamp(spec.lower, spec.upper))
        for j, spec in enumerate(one.shapes):
            put(k, spec.name, from_unit(spec, one.grid[:, j])[picked[..., i]][..., None])
    return found
