"""Files of MERL's kind that hold more, or less exactly: phi_d over 360 degrees, and single precision.

Such files come with G. Lavoue, N. Bonneel et al., Perceptual Quality of BRDF Approximations, 2021,
doi:10.1111/cgf.142636: approximations that are not reciprocal.
"""

import math
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.merl import HEADER, SINGLE, WHOLE, WHOLE_SINGLE, Merl
from torchbrdf.pairs import Pairs


class _Variant(Merl):
    """A table of another layout than MERL's own."""

    suffixes = ()

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it has the layout's dimensions in front, and its size."""
        return len(head) >= HEADER.size and cls.layout.is_one(HEADER.unpack_from(head), path.stat().st_size)


class _AllAround(_Variant):
    """phi_d over 360 degrees: light and viewer cannot be exchanged.

    phi_d is the light's azimuth about the half vector, 0 on the side away from the normal. Between the last bin and
    the first one values are those of either: what is mirrored at the plane of incidence is alike.
    """

    on_merl_bins = False  # which are of 180 degrees
    is_reciprocal = False

    def _phi_d(self, pairs: Pairs) -> Tensor:
        wi, wo = pairs.wi[0], pairs.wo[0]
        across = 2 * (wo[:, 0] * wi[:, 1] - wo[:, 1] * wi[:, 0])
        along = (wo[:, 2] - wi[:, 2]) * (wi + wo).square().sum(-1).sqrt()
        return torch.atan2(across, along).remainder(2 * math.pi)


@FORMATS.register("merl360")
class Merl360(_AllAround):
    """The format of tables with 90 x 90 x 360 bins of doubles, 70 MB."""

    format = "merl360"
    layout = WHOLE


@FORMATS.register("merl_single")
class MerlSingle(_Variant):
    """The format of MERL's tables in single precision, 17.5 MB."""

    format = "merl_single"
    is_reciprocal = True
    layout = SINGLE


@FORMATS.register("merl360_single")
class Merl360Single(_AllAround):
    """The format of tables with 90 x 90 x 360 bins in single precision, 35 MB."""

    format = "merl360_single"
    layout = WHOLE_SINGLE
