"""A lobe whose microfacet distribution is a table: the paper's "hybrid" form."""

import math

import numpy as np
import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import v_groove
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_sqrt

NODES = 90
FRESNEL_NODES = 16


@half_in_float32
def distribution_based(pairs: Pairs, distribution: Tensor, f0: Tensor, fresnel_table: Tensor | None = None) -> Tensor:
    """A microfacet lobe with tables for each channel: D(theta_h) G F(theta_d) / (4 cos_i cos_o).

    Tables are linear in between, and D is constant outside; D holds the specular albedo. G is the shadowing of
    Cook-Torrance (eq. 6), F Schlick's Fresnel times a table, which is 1 where Schlick's alone is meant. Two such lobes
    also follow a highlight whose width changes with theta_d, as under a coat: D F is a product, their sum is not.

    Args:
        pairs: where values are wanted, `(..., N)`.
        distribution: `(..., K, 3)`, D at theta_h = ((k + 0.5) / K)^2 pi/2 (MERL's spacing, dense at the highlight).
        f0: reflectance at normal incidence `(..., 1)`.
        fresnel_table: `(..., J, 3)`, what F is multiplied by at theta_d = j / (J - 1) pi/2; None: 1.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: the paper's references [1], M. Ashikhmin and S. Premoze, Distribution-based BRDFs, 2007, and [8],
    W. Matusik et al., Printing Spatially-varying Reflectance, 2009, doi:10.1145/1618452.1618474; their form of the
    shadowing, 1 / (cos_i + cos_o - cos_i cos_o), fits MERL-like tables worse (recipes/make_standins.py).

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import distribution_based
        >>> angle = torch.full((1,), 0.2)
        >>> distribution_based(Pairs.from_half_diff(angle, angle, angle), torch.ones(90, 3), torch.tensor([0.3]))
        tensor([[0.0814, 0.0814, 0.0814]])
    """
    geometry = v_groove(pairs) / 4 * fresnel(f0, pairs)
    found = _at(distribution, *distribution_place(pairs, distribution.shape[-2]))
    if fresnel_table is not None:
        found = found * _at(fresnel_table, *fresnel_place(pairs, fresnel_table.shape[-2]))
    return found * torch.where(pairs.above_horizon, geometry, 0)[..., None]


def distribution_place(pairs: Pairs, nodes: int) -> tuple[Tensor, Tensor]:
    """Which of the nodes of D is the last below each pair, `(..., N)`, and the share of the next one."""
    return _between(safe_sqrt((pairs.theta_h / (math.pi / 2)).clamp(0, 1)) * nodes - 0.5, nodes)


def fresnel_place(pairs: Pairs, nodes: int) -> tuple[Tensor, Tensor]:
    """The same of the table of F."""
    return _between(pairs.theta_d / (math.pi / 2) * (nodes - 1), nodes)


def _between(position: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    position = position.clamp(0, nodes - 1)
    low = position.floor().clamp_max(nodes - 2).to(torch.long)
    return low, position - low


def _at(table: Tensor, low: Tensor, share: Tensor) -> Tensor:
    """A table `(..., K, 3)` between its nodes, `(..., N, 3)`."""
    share = share[..., None]
    return _rows(table, low) * (1 - share) + _rows(table, low + 1) * share


def _rows(table: Tensor, index: Tensor) -> Tensor:
    """Rows of the table at `index`: one index for all materials, or one a material."""
    if index.dim() == 1 or (index.dim() == 2 and index.shape[0] == 1):
        return table.index_select(-2, index.reshape(-1))
    lead = np.broadcast_shapes(table.shape[:-2], index.shape[:-1])
    index = index.expand(*lead, -1)[..., None].expand(*lead, index.shape[-1], table.shape[-1])
    return table.expand(*lead, *table.shape[-2:]).gather(-2, index)


@LOBES.register("distribution_based")
class DistributionBased(Lobe):
    """A microfacet lobe with a tabulated distribution and Fresnel for each channel, and shadowing.

    `torchbrdf.fit` finds all tables at once, see `torchbrdf.fitting.TabulatedFit`; there F0 stays what it is, as the
    table takes its place.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import DistributionBased
        >>> DistributionBased(f0=0.04)
        DistributionBased(distribution=<90 x 3>, f0=0.04, fresnel_table=<16 x 3>)
    """

    # Tables tell a broad highlight from diffuse light; an albedo that is held takes light from one they cannot make up.
    default_diffuse = "fit"
    distribution: BoundedParameter = BoundedParameter(
        start=0.01,
        lower=1e-6,
        upper=1e6,
        shape=(NODES, 3),
        linear=True,
        log=True,
        doc="D at MERL's theta_h, per channel",
    )
    f0: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.02, upper=1.0, affine=True, doc="reflectance at normal incidence"
    )
    fresnel_table: BoundedParameter = BoundedParameter(
        start=1.0,
        lower=1e-4,
        upper=1e4,
        shape=(FRESNEL_NODES, 3),
        linear=True,
        log=True,
        optional=True,
        doc="what Schlick's Fresnel is multiplied by, per channel",
    )
    function = staticmethod(distribution_based)
