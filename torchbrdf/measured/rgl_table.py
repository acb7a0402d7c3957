"""Any BRDF as a file of RGL's format, which Mitsuba 3 and pbrt-v4 read as their material `measured`."""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.color import luminance
from torchbrdf.errors import UsageError, shown
from torchbrdf.measured.azimuths import without_grain
from torchbrdf.measured.rgl import LARGEST_DENSITY, LARGEST_STORED, LEAST_VISIBLE, LOWEST, bilinear, theta_to_unit
from torchbrdf.measured.tables import Brdf, values_at
from torchbrdf.measured.tensor_file import write_tensor_file
from torchbrdf.measured.warp import Warp
from torchbrdf.pairs import Pairs
from torchbrdf.precision import undisturbed

ANGLES, SIZE = 32, 96
"""Directions of wi, and nodes along either axis of the half vector's grid: 4.9 MB, in 1 to 3 seconds."""
LARGEST = 1 << 24
"""Nodes of a table: 268 MB."""
NORMALS, ROWS = 512, 2
"""Nodes of D, of sigma and of the warp's density: along theta_h, and along the azimuth, which they do not depend on."""
HIGHEST = math.radians(89.5)
"""The largest theta_i; nothing is asked at 90 degrees, where some BRDFs are infinite."""
TOWARDS_GRAZING = 1.5
"""How much closer the last theta_i are than the first ones: near grazing, Fresnel's factor rises."""
FLOOR = 1e-3
"""Of its mean, what D, and the density of samples, is at least: no place is never sampled or badly determined."""
SHARES = (0.4, 0.3, 0.3)
"""Nodes along theta_h that go to where log D changes, to where light goes, and to everywhere."""
AROUND = (2.0, 15.0, 30.0, 45.0, 60.0)
"""theta_d in degrees at which the shape of the lobe is looked at."""


@torch.no_grad()
@undisturbed()
def write_rgl(path: str | Path, brdf: Brdf, *, description: str = "", angles: int = ANGLES, size: int = SIZE) -> None:
    """Write a BRDF as RGL's tensor file: isotropic, RGB, for Mitsuba 3 (RGB variants) and for `load`.

    The format says `f cos_o = s D(h) / (4 sigma(wi))`, with a table of s in coordinates of h that a warp evens. Any
    positive D and any warp give the same f at the table's nodes, and what lies between them is the better
    interpolated the less s varies there. Other than the paper, which needs a D before anything is measured and takes
    it from retro-reflection, D here is the mean of f over theta_d at phi_d = 90 degrees, where both directions are as
    high as can be; sigma is D's projected area; and the warp, the same for all wi, spends its nodes on where log D
    changes, on where light goes and on the rest. Below the horizon, s continues linearly in cos_o, so that f vanishes
    where it should. `luminance` is the density of the reflected light in these coordinates: renderers sample by it.

    theta_i is the light's, as in the database. Mitsuba, which traces from the camera, takes it for the viewer's, in
    RGL's own files, too: what is not reciprocal, as measurements are not quite, is seen there with the two exchanged.

    With a grain it has the mean over all azimuths of the surface.

    What a measured BRDF does not know is what its `at` says there: the nearest valid value, and beyond the largest
    theta_i that was measured, say 60 degrees, that of this angle.

    Args:
        path: The file, which appears when it is complete. Mitsuba wants no suffix in particular; RGL's is `.bsdf`.
        brdf: A lobe or a sum of lobes, not batched; or one measured material.
        description: Shown by renderers that load it.
        angles: Directions of wi, theta_i from 0 to 89.5 degrees, closer together towards grazing.
        size: Nodes of the half vector's grid, along the elevation as along the azimuth. The file has about
            `16 angles size^2` bytes.

    Raises:
        UsageError: The BRDF is none, or several materials; there are fewer than 4 angles or nodes, or more than 2^24
            `angles size^2`.
        DataError: It was measured, and no sample is valid; or the file cannot be written.

    Source: J. Dupuy, W. Jakob, An Adaptive Parameterization for Efficient Material Acquisition and Rendering, 2018,
    doi:10.1145/3272127.3275059.

    Example:
        >>> from torchbrdf.lobes import GGX
        >>> from torchbrdf.measured import load, write_rgl
        >>> write_rgl("ggx.bsdf", GGX(roughness=0.2), angles=8, size=16)
        >>> load("ggx.bsdf").names
        ['ggx']
    """
    for name, value in (("angles", angles), ("size", size)):
        if not isinstance(value, int) or value < 4:
            raise UsageError(f"write_rgl: {name}: expected a whole number of at least 4, found {shown(value)}")
    if angles * size**2 > LARGEST:
        raise UsageError(f"write_rgl: expected at most {LARGEST} nodes, found {angles} x {size} x {size}")
    fields = {
        "version": np.array([1, 0], "u4"),
        "description": np.frombuffer(description.encode("utf-8", "replace") or b"BRDF", "u1"),
        **_Table(without_grain(brdf), angles, size).fields(),
        "jacobian": np.ones(1, "u1"),
    }
    write_tensor_file(path, fields)


class _Table:
    """The table of a BRDF: D, sigma and the warp's density by u = sqrt(2 theta / pi), and s at the warp's nodes."""

    def __init__(self, brdf: Brdf, angles: int, size: int) -> None:
        unit = _nodes(NORMALS)
        shape = _shape(brdf, unit)
        self.theta_i = HIGHEST * (1 - (1 - _nodes(angles)) ** TOWARDS_GRAZING)
        self.normals = _normals(shape, unit)
        self.visible = _visible(self.normals, unit)
        self.density = _density(shape, self.normals, unit)
        self.stored = torch.empty(angles, size, size, 3, dtype=torch.float64, device="cpu")
        self.light = torch.empty(angles, size, size, dtype=torch.float64, device="cpu")
        even = _nodes(size)
        self.x, self.y = Warp(self.density.expand(1, ROWS, -1)).sample(even, even)[0].flatten(0, 1).unbind(-1)
        for row, theta in enumerate(self.theta_i):
            self._fill(row, theta, brdf)

    def _fill(self, row: int, theta_i: Tensor, brdf: Brdf) -> None:
        """The values of one wi."""
        size = len(self.stored[row])
        theta_h, phi_h = self.x.square() * (math.pi / 2), (2 * self.y - 1) * math.pi
        half = torch.stack([theta_h.sin() * phi_h.cos(), theta_h.sin() * phi_h.sin(), theta_h.cos()], -1)
        wi = torch.stack([theta_i.sin(), torch.zeros_like(theta_i), theta_i.cos()]).expand_as(half)
        toward = (wi * half).sum(-1)
        wo = 2 * toward[:, None] * half - wi
        f = values_at(brdf, Pairs.from_directions(wi[None], _lifted(wo)[None]))
        place = theta_to_unit(theta_i).expand_as(self.x)
        factor = _along(self.normals, self.x) / (4 * _along(self.visible, place))
        # Not below 0 beneath the horizon: near it Mitsuba would show what is interpolated to there as negative light.
        stored = f * (wo[:, 2].clamp_min(0) / factor)[:, None]
        # A density over the half vector's coordinates, by that of the warp: what `luminance` adds to the warp.
        turned = toward.clamp_min(0) * self.x * theta_h.sin() / _along(self.density, self.x)
        light = (luminance(stored) * factor).clamp_min(0) * turned
        mean = light.mean()
        self.stored[row] = stored.clamp(-LARGEST_STORED, LARGEST_STORED).reshape(size, size, 3)
        self.light[row] = (light / mean + FLOOR if mean > 0 else torch.ones_like(light)).reshape(size, size)

    def fields(self) -> dict[str, np.ndarray]:
        """The fields of the file."""
        rows = {"sigma": self.visible, "ndf": self.normals}
        found = {
            "phi_i": torch.zeros(1, dtype=torch.float32, device="cpu"),
            "theta_i": self.theta_i,
            **{name: value.expand(ROWS, -1) for name, value in rows.items()},
            "vndf": self.density.expand(1, len(self.theta_i), ROWS, -1),
            "luminance": self.light[None],
            "rgb": self.stored.movedim(-1, 1)[None],
        }
        return {name: value.numpy().astype("f4") for name, value in found.items()}


def _nodes(count: int) -> Tensor:
    return torch.linspace(0, 1, count, dtype=torch.float64, device="cpu")


def _along(table: Tensor, x: Tensor) -> Tensor:
    """What depends on x alone, as readers interpolate it."""
    return bilinear(table.expand(ROWS, -1), x, torch.zeros_like(x))


def _lifted(direction: Tensor) -> Tensor:
    """Directions, those under the least elevation at which values are asked lifted to it."""
    height = direction[:, 2].clamp_min(LOWEST)
    flat = direction[:, :2]
    length = flat.square().sum(-1, keepdim=True).sqrt().clamp_min(1e-12)
    return torch.cat([flat / length * (1 - height.square()).clamp_min(0).sqrt()[:, None], height[:, None]], -1)


def _shape(brdf: Brdf, unit: Tensor) -> Tensor:
    """The mean luminance of f by theta_h, at most 1; 1 for a black material."""
    theta_h = (unit.square() * (math.pi / 2)).clamp_max(HIGHEST)
    theta_h, theta_d = (
        part.flatten()
        for part in torch.meshgrid(
            theta_h, torch.tensor(AROUND, dtype=unit.dtype, device=unit.device).deg2rad(), indexing="ij"
        )
    )
    pairs = Pairs.from_half_diff(theta_h[None], theta_d[None], torch.full_like(theta_h, math.pi / 2)[None])
    mean = luminance(values_at(brdf, pairs)).clamp_min(0).reshape(len(unit), -1).mean(1)
    return mean / mean.max() if mean.max() > 0 else torch.ones_like(mean)


def _normals(shape: Tensor, unit: Tensor) -> Tensor:
    """D: the shape, whose integral times the cosine over the hemisphere is 1."""
    theta = unit.square() * (math.pi / 2)
    normals = shape / (2 * math.pi * torch.trapezoid(shape * theta.sin() * theta.cos(), theta))
    return normals.clamp(FLOOR / math.pi, LARGEST_DENSITY / 2)


def _visible(normals: Tensor, unit: Tensor) -> Tensor:
    """sigma: the area of the normals that is seen from an elevation."""
    theta = unit.square() * (math.pi / 2)
    phi = (_nodes(181)[:-1] + 1 / 360) * math.pi
    across = theta.sin()[:, None] * phi.cos()
    weight = 2 * math.pi * normals * theta.sin()
    seen = [(own.cos() * theta.cos()[:, None] + own.sin() * across).clamp_min(0).mean(1) for own in theta]
    area = torch.trapezoid(weight * torch.stack(seen), theta)
    return area.clamp_min(10 * LEAST_VISIBLE)


def _density(shape: Tensor, normals: Tensor, unit: Tensor) -> Tensor:
    """The density of the warp's nodes along u, whose integral is 1."""
    theta = unit.square() * (math.pi / 2)
    change = torch.gradient((shape + FLOOR * shape.mean()).log(), spacing=(unit,))[0].abs()
    parts = (change, normals * theta.sin() * theta.cos() * unit, torch.ones_like(unit))
    weighed = [
        share * part / total
        for share, part in zip(SHARES, parts, strict=True)
        if (total := torch.trapezoid(part, unit)) > 0
    ]
    density = torch.stack(weighed).sum(0)
    return density / torch.trapezoid(density, unit)
