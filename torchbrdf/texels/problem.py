"""The problem of a tile: each texel is a material, whose pairs are the lights."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchbrdf.losses import Problem
from torchbrdf.pairs import Pairs
from torchbrdf.texels.stack import TileData, local_directions

# Below this length a normal is none, as those of a background are.
SHORTEST_NORMAL = 1e-3


@dataclass(frozen=True)
class Reading:
    """How observations become BRDF values.

    Args:
        irradiance: of each light on a surface that faces it, `(n, 3)`.
        saturation: a value of at least so much does not count; None: all do.
        shadow: of a light under which no channel has more than this nothing counts; None: all do.
        max_theta: directions further from the normal do not count, degrees.
        pairs: `(n,)`, where these are given instead of directions.
    """

    irradiance: np.ndarray
    saturation: float | None
    shadow: float | None
    max_theta: float
    pairs: Pairs | None = None


@dataclass(frozen=True)
class TexelProblem:
    """What the fits of M texels solve.

    counts: valid values of each, `(M,)`; saturated: values that were too large, `(M,)`.
    """

    problem: Problem
    counts: Tensor
    saturated: Tensor


def texel_problem(data: TileData, how: Reading) -> TexelProblem:
    """BRDF values and weights of the texels of a tile, row after row.

    A value is the observation over irradiance and cos_i. What is not finite has the weight 0, and so have negative
    weights, weights that are no numbers, and everything at a texel whose normal is none.
    """
    observations = _texels(data.observations)
    count, lights = observations.shape[:2]
    valid = observations.isfinite()
    saturated = torch.zeros(count, dtype=torch.int64, device="cpu")
    if how.saturation is not None:
        above = observations >= how.saturation
        saturated, valid = above.sum((1, 2)), valid & ~above
    if how.shadow is not None:
        valid &= torch.where(valid, observations, 0).amax(-1, keepdim=True) > how.shadow
    pairs, faces = pairs_of(data, how.pairs)
    least = math.cos(math.radians(how.max_theta))
    near = (pairs.cos_i > least) & (pairs.cos_o > least)
    valid = valid & near[..., None] & faces[:, None, None]
    weight = valid.to(torch.float32)
    if data.weights is not None:
        given = _texels(data.weights) if data.weights.ndim == 4 else _texels(data.weights[..., None])
        weight = torch.where(valid & (given > 0) & given.isfinite(), given, 0).to(torch.float32)
    received = torch.from_numpy(how.irradiance) * pairs.cos_i[..., None]
    target = torch.where(weight > 0, observations, 0) / torch.where(near[..., None], received, 1)
    counts = (weight > 0).expand(count, lights, 3).sum((1, 2))
    return TexelProblem(Problem(pairs, target, weight), counts, saturated)


def pairs_of(data: TileData, given: Pairs | None = None) -> tuple[Pairs, Tensor]:
    """The pairs of each texel, `(M, n)`, or of all, `(1, n)`, float32; and which texels have a normal, `(M,)`."""
    h, w = data.shape
    faces = torch.ones(h * w, dtype=torch.bool, device="cpu")
    if given is not None:
        return given.to("cpu", torch.float32).unsqueeze(), faces
    lights, views = (one if one.ndim == 2 else one.reshape(len(one), -1, 3) for one in (data.lights, data.views))
    if data.normals is None and lights.ndim == 2 and views.ndim == 2:
        return Pairs.from_directions(torch.from_numpy(lights)[None], torch.from_numpy(views)[None]), faces
    normals = np.zeros((h * w, 3), np.float32)
    normals[:, 2] = 1
    if data.normals is not None:
        own = data.normals.reshape(-1, 3)
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.linalg.norm(own, axis=-1)
        there = np.isfinite(length) & (length > SHORTEST_NORMAL)
        normals[there] = own[there] / length[there, None]
        faces = torch.from_numpy(there)
    if lights.ndim == 3 or views.ndim == 3:
        lights, views = (_unit(one) for one in (lights, views))
    return Pairs.from_directions(local_directions(lights, normals), local_directions(views, normals)), faces


def _texels(values: np.ndarray) -> Tensor:
    """Values `(n, h, w, c)` texel by texel, `(M, n, c)`."""
    return torch.from_numpy(
        np.ascontiguousarray(values.transpose(1, 2, 0, 3).reshape(-1, len(values), values.shape[3]))
    )


def _unit(directions: np.ndarray) -> np.ndarray:
    """Directions of length 1; those that are none point below the horizon of all, and do not count."""
    if directions.ndim == 2:
        return directions
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        length = np.linalg.norm(directions, axis=-1, keepdims=True)
        found = directions / length
    return np.where(np.isfinite(found), found, 0).astype(np.float32)
