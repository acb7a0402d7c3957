"""Slices of BRDFs: values in the plane of incidence, and MERL's picture of half and difference angles."""

import math
from dataclasses import dataclass
from functools import cache

import torch
from matplotlib import colormaps
from torch import Tensor

from torchbrdf.color import luminance
from torchbrdf.experiment.extrapolation import hatched, is_extrapolated
from torchbrdf.experiment.matching.judge import Brdf, values_of
from torchbrdf.pairs import Pairs

INCIDENCES = tuple(range(0, 86, 5))
"""Angles of the light, degrees."""
# Of the viewer, degrees, those below 0 on the light's side; and more of them about the mirror direction.
_OUT, _STEP = 88, 2
_NEAR = (0.0, 0.15, 0.3, 0.6, 1.0, 1.5)
NODES = 72
"""Of a side of the picture of half and difference angles."""
# Factors of two at which the picture of ratios has its last colours.
_TWOS = 2.0


@dataclass(frozen=True)
class Slices:
    """Slices of one BRDF.

    Args:
        values: By incidence and angle of the viewer, linear RGB in 1/sr, `(I, n, 3)`; rows are as long as the longest.
        far: Which of them are extrapolated, `(I, n)`.
        image: theta_h to the right, MERL's spacing, and theta_d upwards, at phi_d = 90 degrees, `(NODES, NODES, 3)`.
        image_far: Which of it is extrapolated.
    """

    values: Tensor
    far: Tensor
    image: Tensor
    image_far: Tensor

    def picture(self) -> Tensor:
        """Display values of the picture: brighter values are compressed; hatched where it is extrapolated."""
        light = self.image.clamp_min(0) * math.pi
        return hatched((light / (1 + light)) ** (1 / 2.2), self.image_far)

    def ratio(self, reference: "Slices") -> Tensor:
        """Colours of how much brighter than a reference it is: blue darker, red brighter, white the same."""
        own, other = luminance(self.image), luminance(reference.image)
        floor = 1e-4 * other.abs().mean().clamp_min(1e-12)
        twos = (own.clamp_min(floor) / other.clamp_min(floor)).log2()
        colors = colormaps["RdBu_r"]((twos / (2 * _TWOS) + 0.5).clamp(0, 1).numpy())[..., :3]
        return hatched(torch.from_numpy(colors).to(self.image), self.image_far | reference.image_far)


def viewer_angles(incidence: float) -> list[float]:
    """Angles of the viewer in the plane of incidence, degrees, growing: on the mirror's side they are above 0.

    Example:
        >>> from torchbrdf.experiment.slices import viewer_angles
        >>> viewer_angles(30)[:2], 30.15 in viewer_angles(30)
        ([-88.0, -86.0], True)
    """
    even = [float(one) for one in range(-_OUT, _OUT + 1, _STEP)]
    near = [round(incidence + sign * one, 2) for one in _NEAR for sign in (-1, 1)]
    return sorted({*even, *(one for one in near if abs(one) <= _OUT)})


@cache
def plane_pairs() -> tuple[Pairs, list[int]]:
    """Pairs `(1, N)` of all incidences behind each other, and how many each has."""
    wi, wo, counts = [], [], []
    for incidence in INCIDENCES:
        seen = torch.tensor(viewer_angles(incidence), dtype=torch.float64, device="cpu").deg2rad()
        light = torch.full_like(seen, math.radians(incidence))
        wi.append(torch.stack([light.sin(), torch.zeros_like(light), light.cos()], -1))
        wo.append(torch.stack([-seen.sin(), torch.zeros_like(seen), seen.cos()], -1))
        counts.append(len(seen))
    return Pairs.from_directions(torch.cat(wi)[None], torch.cat(wo)[None]).to(dtype=torch.float32), counts


@cache
def image_pairs() -> Pairs:
    """Pairs `(1, NODES^2)` of the picture, row by row from the top."""
    place = (torch.arange(NODES, dtype=torch.float64, device="cpu") + 0.5) / NODES
    theta_d, theta_h = torch.meshgrid(place.flip(0) * (math.pi / 2), place.square() * (math.pi / 2), indexing="ij")
    flat = theta_h.flatten()
    return (
        Pairs.from_half_diff(flat, theta_d.flatten(), torch.full_like(flat, math.pi / 2))
        .unsqueeze()
        .to(dtype=torch.float32)
    )


@torch.no_grad()
def slices_of(brdf: Brdf) -> Slices:
    """The slices of one material or model."""
    pairs, counts = plane_pairs()
    square = image_pairs()
    values, far = values_of(brdf, pairs)[0], is_extrapolated(brdf, pairs)
    return Slices(
        torch.nn.utils.rnn.pad_sequence(list(values.split(counts)), batch_first=True),
        torch.nn.utils.rnn.pad_sequence(list(far.split(counts)), batch_first=True),
        values_of(brdf, square)[0].reshape(NODES, NODES, 3),
        is_extrapolated(brdf, square).reshape(NODES, NODES),
    )
