"""Any BRDF, fitted or measured, at the places that a table has."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.base import RGB
from torchbrdf.lobes.in_bands import channels_of
from torchbrdf.measured.grid import chunks
from torchbrdf.measured.measured import Measured
from torchbrdf.pairs import Pairs

Brdf = Lobe | Measured

RING = 5.0
"""Degrees over which it is asked whether most samples are valid."""
SEEN = 100_000
"""Samples of a material, about, that are looked at for how far it was measured."""


@torch.no_grad()
def values_at(brdf: Brdf, pairs: Pairs) -> Tensor:
    """Values of one material, in bounded memory.

    Args:
        brdf: A lobe or a sum of lobes, not batched; or one measured material.
        pairs: Where, `(1, N)`, in float64 on the CPU; of lobes with a grain they have to know the tangent.

    Returns:
        Values in 1/sr, `(N, 3)`, float64; 0 below the horizon and where they are not finite.

    Raises:
        UsageError: It is neither, or several materials.
        DataError: Its values are bands, and not linear RGB.
    """
    check_single(brdf)
    check_rgb(brdf, "a table")
    if isinstance(brdf, Lobe) and brdf.is_anisotropic and not pairs.is_oriented:
        raise UsageError("a table: expected an isotropic material, found a lobe with a grain, for which it has no room")
    found = torch.empty(len(pairs), 3, dtype=torch.float64, device="cpu")
    own = None if isinstance(brdf, Measured) else next(brdf.parameters(), None)
    device = None if own is None else own.device
    for part, chunk in chunks(pairs.to(device)):
        value = brdf.at(chunk)[0] if isinstance(brdf, Measured) else brdf(chunk)[0]
        found[part] = torch.where(chunk.above_horizon[0, :, None] & value.isfinite(), value, 0).to(found)
    return found


def check_rgb(brdf: Brdf, who: str) -> None:
    """Refuse bands where linear RGB is needed.

    Args:
        brdf: A lobe, or measured materials.
        who: Needs it, for the message.

    Raises:
        DataError: Values are bands.
    """
    if isinstance(brdf, Measured):
        brdf.check_rgb(who)
    elif channels_of(brdf) != RGB:
        found = f"a lobe of {channels_of(brdf)} channels"
        raise DataError(f"{who}: expected linear RGB, found {found}; give its FitRecord, or its fits.json")


def check_single(brdf: Brdf) -> None:
    """Refuse what is not one material."""
    if isinstance(brdf, Measured):
        count = len(brdf)
    elif isinstance(brdf, Lobe):
        up = torch.ones(1, 1, dtype=torch.float64, device="cpu")
        own = next(brdf.parameters(), up)
        count = len(brdf(Pairs.from_half_diff(0 * up, 0 * up, 0 * up, 0 * up).to(own.device)))
    else:
        raise UsageError(f"a table: expected a lobe or a Measured, found {shown(brdf)}")
    if count != 1:
        raise UsageError(f"a table: expected one material, found {count}")


class Reach(NamedTuple):
    """Up to which angles from the normal, in degrees, the light and the viewer of a BRDF were measured."""

    light: float
    viewer: float

    @property
    def both(self) -> float:
        """The angle up to which both were."""
        return min(self)

    def words(self, to: str) -> str:
        """Both angles, or the one that they have in common behind `to`.

        Example:
            >>> Reach(60.0, 61.0).words("up to"), Reach(60.0, 89.0).words("up to")
            ('up to 60 degrees from the normal', 'with the light up to 60 degrees from the normal, the viewer up to 89')
        """
        if abs(self.light - self.viewer) <= RING:
            return f"{to} {self.both:.0f} degrees from the normal"
        return f"with the light up to {self.light:.0f} degrees from the normal, the viewer up to {self.viewer:.0f}"


def measured_up_to(brdf: Brdf) -> Reach:
    """The angles from the normal, in degrees, up to which the directions of a BRDF were measured; 90 of a lobe.

    Up to it at least half as many samples are valid as where most are, so that a few beyond do not count, nor does what
    is missing at all angles; and beyond, there is none with such an incident, or such an outgoing, direction.

    Args:
        brdf: A lobe, or one measured material.

    Returns:
        The angles; 0 without any valid sample.

    Example:
        >>> from torchbrdf.measured import load, standins
        >>> round(measured_up_to(load(standins()).batch([6])).both)
        90
    """
    if not isinstance(brdf, Measured):
        return Reach(90.0, 90.0)
    count = len(brdf.pairs)
    some = brdf.batch(samples=torch.arange(0, count, max(count // SEEN, 1), dtype=torch.int64, device="cpu"))
    pairs, valid = some.pairs.select([0]), some.weight[0, :, 0] > 0
    above = pairs.above_horizon[0]
    valid = valid & above
    if not valid.any():
        return Reach(0.0, 0.0)
    theta_i, theta_o = (angle_from_normal(cosine[0]) for cosine in (pairs.cos_i, pairs.cos_o))
    farther = torch.maximum(theta_i, theta_o)
    ring = (farther / RING).long().clamp_max(int(90 / RING) - 1)
    known, every = (torch.bincount(ring[own], minlength=int(90 / RING)) for own in (valid, above))
    share = known / every.clamp_min(1)
    mostly = valid & (2 * share >= share.max())[ring]
    last = farther[mostly].max() if mostly.any() else torch.zeros_like(farther[0])
    return Reach(*(float(torch.minimum(last, own[valid].max())) for own in (theta_i, theta_o)))


def angle_from_normal(cosine: Tensor) -> Tensor:
    """Degrees of the angle with a cosine."""
    cosine = cosine.clamp(0, 1)
    return torch.rad2deg(torch.atan2((1 - cosine.square()).sqrt(), cosine))
