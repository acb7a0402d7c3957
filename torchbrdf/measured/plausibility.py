"""Whether a BRDF could be a surface's: how much of the light it reflects, reciprocity, and values below 0."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.in_bands import channels_of
from torchbrdf.measured.measured import Measured
from torchbrdf.measured.tables import Reach, measured_up_to
from torchbrdf.pairs import Pairs

ANGLES = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 65.0, 70.0, 75.0, 80.0, 83.0, 86.0, 88.0)
"""Of the light, degrees from the normal."""
RELIABLE = 80.0
"""Farther from the normal than so many degrees, measurements are seldom trusted (MERL's, by its authors)."""
FAR_ENOUGH = 75.0
"""What is measured less far from the normal than this is said to be, in degrees: pictures show what stands in."""
# Half vectors: rings about the normal, denser towards it by the third power, times directions around.
RINGS, AROUND = 192, 96
POWER = 3
# What quadrature and float32 leave; what interpolation in a table does to reciprocity.
ENERGY_TOLERANCE = 0.005
RECIPROCITY_TOLERANCE = 0.02
RANDOM_PAIRS = 20_000


@dataclass(frozen=True)
class Plausibility:
    """What `check` finds of one material.

    Attributes:
        name: of the material.
        angles: of the light, degrees from the normal, A.
        albedo: directional-hemispherical reflectance at each, per channel, A x C, without a unit.
        reciprocity: root mean square of f(wi, wo) - f(wo, wi) over that of f, both times the cosines; None of
            scattered samples, between which values are reciprocal by how they are interpolated.
        lowest: the lowest value at random directions, 1/sr.
        below_zero: the share of random directions with a value below 0.
        invalid: the share of samples within 80 degrees that are not valid in the file; 0 of a model.
        reach: the angle from the normal, in degrees, up to which both directions were measured; 90 of a model.
        reach_light: that of the light alone.
        reach_viewer: that of the viewer alone.
    """

    name: str
    angles: list[float] = field(repr=False)
    albedo: list[list[float]] = field(repr=False)
    reciprocity: float | None
    lowest: float
    below_zero: float
    invalid: float
    reach: float
    reach_light: float
    reach_viewer: float

    @property
    def largest_albedo(self) -> tuple[float, float]:
        """The largest albedo of any channel, and the angle of the light at which it is, in degrees."""
        each = [max(row) for row in self.albedo]
        k = int(np.argmax(each))
        return each[k], self.angles[k]

    def to_dict(self) -> dict[str, object]:
        """All of it as plain values, with the warnings."""
        return {**asdict(self), "largest_albedo": self.largest_albedo[0], "warnings": self.warnings()}

    def warnings(self) -> list[str]:
        """What no surface does, or what was not measured, a line each; none for a plausible BRDF.

        Example:
            >>> from torchbrdf.lobes import Lambert, Sum, Ward
            >>> check(Sum(Lambert(albedo=0.9), Ward(specular=0.5, roughness=0.1)))[0].warnings()
            ['reflects 139 % of the light from 0 degrees']
        """
        found = []
        trusted = [(max(row), angle) for row, angle in zip(self.albedo, self.angles, strict=True) if angle <= RELIABLE]
        largest, angle = max(trusted, key=lambda one: one[0])
        if largest > 1 + ENERGY_TOLERANCE:
            found.append(f"reflects {100 * largest:.3g} % of the light from {angle:g} degrees")
        elif self.largest_albedo[0] > 1 + ENERGY_TOLERANCE:
            largest, angle = self.largest_albedo
            found.append(f"reflects {100 * largest:.3g} % of the light from {angle:g} degrees, near the horizon")
        if self.reciprocity is not None and self.reciprocity > RECIPROCITY_TOLERANCE:
            found.append(f"is not reciprocal: exchanged directions differ by {100 * self.reciprocity:.2g} %")
        if self.below_zero:
            found.append(
                f"has a channel below 0 at {100 * self.below_zero:.3g} % of directions, down to {self.lowest:.2g} / sr"
            )
        if self.reach < FAR_ENOUGH:
            reach = Reach(self.reach_light, self.reach_viewer).words("to")
            found.append(f"was measured only {reach}; beyond, values are extrapolated")
        if self.invalid > 0.01:
            found.append(f"has no valid value in {100 * self.invalid:.3g} % of samples within {RELIABLE:g} degrees")
        return found


def directional_albedo(brdf: Lobe | Measured, angles: Sequence[float] = ANGLES) -> Tensor:
    """How much of the light from one direction is reflected into all: the integral of f cos_o over the hemisphere.

    E(wi) = int f(wi, wo) cos_o dwo = int f cos_o 4 cos_d dwh, by Gauss-Legendre rings of half vectors that are dense
    where sharp lobes are; right to about 0.1 % from a roughness of 0.001 on.

    Args:
        brdf: M materials, or a lobe, batched or not (M = 1).
        angles: of the light, degrees from the normal, each from 0 to below 90, A.

    Returns:
        Albedo, `(M, A, C)`, without a unit, float64.

    Raises:
        UsageError: an angle is out of range, or there is none.

    Source: the change of variables is eq. 14 of B. Walter et al., Microfacet Models for Refraction through Rough
    Surfaces, 2007, doi:10.2312/EGWR/EGSR07/195-206.

    Example:
        >>> from torchbrdf.lobes import Lambert
        >>> from torchbrdf.measured import directional_albedo
        >>> directional_albedo(Lambert(albedo=0.5), [0.0, 60.0])[0, :, 0].round(decimals=3)
        tensor([0.5000, 0.5000], dtype=torch.float64)
    """
    if not angles or not all(0 <= angle < 90 for angle in angles):
        raise UsageError(f"angles: expected degrees from 0 to below 90, found {list(angles)}")
    half, solid = _half_vectors()
    found = []
    for angle in angles:
        radians = math.radians(angle)
        wi = torch.tensor([math.sin(radians), 0.0, math.cos(radians)], dtype=torch.float64, device="cpu")
        cos_d = half @ wi
        wo = 2 * cos_d[:, None] * half - wi
        seen = (wo[:, 2] > 0) & (cos_d > 0)
        values = _values(brdf, wi.expand(int(seen.sum()), 3), wo[seen])
        found.append(torch.einsum("mnc,n->mc", values, (4 * solid * cos_d * wo[:, 2])[seen]))
    return torch.stack(found, 1)


def check(brdf: Lobe | Measured, *, seed: int = 0) -> list[Plausibility]:
    """Whether BRDFs could be surfaces': albedo by direction, energy, reciprocity, negative values, what is missing.

    Args:
        brdf: M materials, or a lobe, batched or not.
        seed: of the random directions.

    Returns:
        One finding a material; `warnings()` says what is wrong with it.

    Raises:
        ShapeError: a lobe is batched over more than one dimension.

    Example:
        >>> from torchbrdf.lobes import GGX
        >>> found = check(GGX())[0]
        >>> found.name, found.warnings()
        ('model', [])
    """
    albedo = directional_albedo(brdf)
    there, apart = _there_and_back(brdf, seed)
    names = brdf.names if isinstance(brdf, Measured) else ["model"] if len(albedo) == 1 else _numbered(len(albedo))
    each = [brdf.batch([m]) if isinstance(brdf, Measured) else brdf for m in range(len(albedo))]
    return [
        Plausibility(
            name,
            list(ANGLES),
            albedo[m].tolist(),
            None if isinstance(own, Measured) and own.is_scattered else apart[m].item(),
            there[m].amin().item(),
            (there[m] < 0).any(-1).double().mean().item(),
            invalid_share(own) if isinstance(own, Measured) else 0.0,
            min(reach),
            *reach,
        )
        for m, (name, own) in enumerate(zip(names, each, strict=True))
        for reach in [measured_up_to(own)]
    ]


def nonreciprocity(brdf: Lobe | Measured, *, seed: int = 0) -> Tensor:
    """Root mean square of f(wi, wo) - f(wo, wi) over that of f, both times the cosines, `(M,)`.

    Args:
        brdf: M materials, or a lobe, batched or not.
        seed: of the random directions, within 80 degrees of the normal.

    Example:
        >>> from torchbrdf.lobes import GGX
        >>> nonreciprocity(GGX()).item() < 1e-6
        True
    """
    return _there_and_back(brdf, seed)[1]


def _there_and_back(brdf: Lobe | Measured, seed: int) -> tuple[Tensor, Tensor]:
    """Values `(M, N, 3)` at random directions, and how far those of exchanged ones are off, `(M,)`."""
    wi, wo = _random_directions(seed)
    there, back = _values(brdf, wi, wo), _values(brdf, wo, wi)
    weight = (wi[:, 2] * wo[:, 2])[:, None]
    apart = ((there - back) * weight).square().mean((1, 2)) / (there * weight).square().mean((1, 2)).clamp_min(1e-300)
    return there, apart.sqrt()


def _values(brdf: Lobe | Measured, wi: Tensor, wo: Tensor) -> Tensor:
    """Values `(M, N, C)`, float64."""
    if isinstance(brdf, Measured):
        return brdf.at(Pairs.from_directions(wi, wo)).double()
    parameter = next(brdf.parameters(), wi)
    pairs = Pairs.from_directions(wi, wo).to(parameter.device, parameter.dtype)
    with torch.no_grad():
        found = brdf(pairs).double().cpu()
    if found.dim() > 3:
        raise ShapeError(f"check: expected a lobe with at most one leading dimension, found values {(*found.shape,)}")
    found = found if found.dim() == 3 else found[None]
    return found.expand(*found.shape[:2], channels_of(brdf))


def _half_vectors() -> tuple[Tensor, Tensor]:
    """Half vectors `(N, 3)` over the hemisphere, and the solid angle of each."""
    place, share = (torch.from_numpy(one) for one in np.polynomial.legendre.leggauss(RINGS))
    place, share = (place + 1) / 2, share / 2
    theta = math.pi / 2 * place**POWER
    solid = theta.sin() * share * (math.pi / 2 * POWER) * place ** (POWER - 1) * (2 * math.pi / AROUND)
    phi = (torch.arange(AROUND, dtype=torch.float64, device="cpu") + 0.5) * (2 * math.pi / AROUND)
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    half = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
    return half.flatten(0, 1), solid.repeat_interleave(AROUND)


def _random_directions(seed: int) -> tuple[Tensor, Tensor]:
    """Two sets of directions, uniform over the hemisphere within 80 degrees."""
    generator = torch.Generator("cpu").manual_seed(seed)
    place = torch.rand(2, RANDOM_PAIRS, 2, dtype=torch.float64, generator=generator, device="cpu")
    lowest = math.cos(math.radians(RELIABLE))
    cosine, phi = lowest + (1 - lowest) * place[..., 0], 2 * math.pi * place[..., 1]
    sine = (1 - cosine.square()).sqrt()
    wi, wo = torch.stack([sine * phi.cos(), sine * phi.sin(), cosine], -1)
    return wi, wo


def invalid_share(material: Measured) -> float:
    """The share of samples within 80 degrees that are not valid; 1 where there is none at all.

    Args:
        material: One.
    """
    slant = torch.minimum(material.pairs.cos_i, material.pairs.cos_o)[0]
    within = slant >= math.cos(math.radians(RELIABLE))
    valid = material.weight[0, :, 0] > 0
    return 1 - valid[within].double().mean().item() if within.any() else 1.0


def _numbered(count: int) -> list[str]:
    return [f"material{k}" for k in range(count)]
