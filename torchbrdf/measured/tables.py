"""Any BRDF, fitted or measured, at the places that a table has."""

import math

import torch
from torch import Tensor

from torchbrdf.errors import UsageError, shown
from torchbrdf.lobes import Lobe
from torchbrdf.measured.grid import chunks
from torchbrdf.measured.measured import Measured
from torchbrdf.pairs import Pairs

Brdf = Lobe | Measured


@torch.no_grad()
def values_at(brdf: Brdf, pairs: Pairs) -> Tensor:
    """Values of one material, in bounded memory.

    Args:
        brdf: A lobe or a sum of lobes, not batched; or one measured material.
        pairs: Where, `(1, N)`, in float64 on the CPU.

    Returns:
        Values in 1/sr, `(N, 3)`, float64; 0 below the horizon and where they are not finite.

    Raises:
        UsageError: It is neither, or several materials.
    """
    check_single(brdf)
    found = torch.empty(len(pairs), 3, dtype=torch.float64, device="cpu")
    own = None if isinstance(brdf, Measured) else next(brdf.parameters(), None)
    device = None if own is None else own.device
    for part, chunk in chunks(pairs.to(device)):
        value = brdf.at(chunk)[0] if isinstance(brdf, Measured) else brdf(chunk)[0]
        found[part] = torch.where(chunk.above_horizon[0, :, None] & value.isfinite(), value, 0).to(found)
    return found


def check_single(brdf: Brdf) -> None:
    """Refuse what is not one material."""
    if isinstance(brdf, Measured):
        count = len(brdf)
    elif isinstance(brdf, Lobe):
        up = torch.ones(1, 1, dtype=torch.float64, device="cpu")
        own = next(brdf.parameters(), up)
        count = len(brdf(Pairs.from_half_diff(0 * up, 0 * up, 0 * up).to(own.device)))
    else:
        raise UsageError(f"a table: expected a lobe or a Measured, found {shown(brdf)}")
    if count != 1:
        raise UsageError(f"a table: expected one material, found {count}")


def measured_up_to(brdf: Brdf) -> float:
    """The angle from the normal, in degrees, up to which both directions of a BRDF were measured; 90 of a lobe.

    Args:
        brdf: A lobe, or one measured material.
    """
    if not isinstance(brdf, Measured) or brdf.stand_in:
        return 90.0
    valid = brdf.weight[0, :, 0] > 0
    pairs = brdf.pairs.select([0])
    lowest = [float(cosine[0][valid].min()) for cosine in (pairs.cos_i, pairs.cos_o)]
    return math.degrees(math.acos(min(max(lowest), 1.0)))
