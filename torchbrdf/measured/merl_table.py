"""Any BRDF as the values of a MERL table."""

import numpy as np
import torch
from torch import Tensor

from torchbrdf.measured.azimuths import without_grain
from torchbrdf.measured.grid import nearest_valid
from torchbrdf.measured.measured import Measured
from torchbrdf.measured.merl import BINS, CHANNEL_SCALES, LARGEST_ENTRY, above_horizon, bin_centers
from torchbrdf.measured.tables import Brdf, values_at
from torchbrdf.pairs import Pairs
from torchbrdf.precision import undisturbed


@undisturbed()
def merl_values(brdf: Brdf) -> Tensor:
    """Values of a BRDF at the centres of MERL's bins, for `write_merl`.

    Centres and not averages over bins, which give pictures that are farther off, in readers that interpolate and in
    those that take the nearest bin. The format is reciprocal: of what is not, it has the mean of f(wi, wo) and
    f(wo, wi). Bins across the horizon, whose centre is below it, have the value of the nearest bin above, since readers
    look there, too; all further below are nan, which is written as invalid. Values may be negative, in measured colours
    out of gamut; the format has none, so `clamp` them, or their bins are invalid.

    With a grain it has the mean over all azimuths of the surface.

    What a measured BRDF does not know is what its `at` says there: the nearest valid value, and beyond the largest
    angle that was measured, say 60 degrees, that of this angle.

    Args:
        brdf: A lobe or a sum of lobes, not batched; or one measured material.

    Returns:
        In 1/sr, `(90, 90, 180, 3)`, float64: 35 MB.

    Raises:
        UsageError: The BRDF is none, or several materials.
        DataError: It was measured, and no sample is valid.

    Example:
        >>> from torchbrdf.lobes import Ward
        >>> from torchbrdf.measured import load, merl_values, write_merl
        >>> write_merl("ward.binary", merl_values(Ward(roughness=0.2)).clamp(0))
        >>> load("ward.binary").names
        ['ward']
    """
    brdf = without_grain(brdf)
    pairs, above = bin_centers(), above_horizon()
    found = values_at(brdf, pairs)
    if not (isinstance(brdf, Measured) and (brdf.on_merl_bins or brdf.source.is_reciprocal)):
        found = (found + values_at(brdf, Pairs.from_directions(pairs.wo, pairs.wi))) / 2
    values = torch.full((above.size, 3), torch.nan, dtype=torch.float64, device="cpu")
    values[torch.from_numpy(above)] = found.clamp_max(LARGEST_ENTRY * min(CHANNEL_SCALES))
    from scipy import ndimage  # late, as it takes long to import

    inside = above.reshape(BINS)
    across = np.flatnonzero(ndimage.binary_dilation(inside, np.ones((3, 3, 3))) & ~inside)
    values[torch.from_numpy(across)] = values[torch.from_numpy(nearest_valid(inside)[across]).long()]
    return values.reshape(*BINS, 3)
