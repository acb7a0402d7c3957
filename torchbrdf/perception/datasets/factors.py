"""Non-parametric factors that others published: a diffuse albedo, and tables of D, G1 and F, for the MERL materials."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from torchbrdf.errors import DataError, UsageError
from torchbrdf.measured.catalogue import MERL_NAMES
from torchbrdf.pairs import Pairs
from torchbrdf.reading import exists, read_bytes

SOURCE = (
    "the factors of M. Bagher, J. Snyder and D. Nowrouzezahrai, A Non-Parametric Factor Microfacet Model for Isotropic "
    "BRDFs, 2016, doi:10.1145/2907941, given as demo-merl/npf.bin at github.com/jdupuy/opengl-framework"
)
FACTORS = "BAGHER"
"""The method of the opinions that these are."""
SHAPE = (256, 512, 3)
FACTOR_BINS = 90


class FactorModel(nn.Module):
    """Non-parametric factor model of Bagher et al. 2016, in 1/sr.

    f = (rho_d + rho_s D(theta_h) F(theta_d) G1(theta_i) G1(theta_o) / (cos_i cos_o)) / pi.
    rows: `(M, 272, 3)`: rho_d, rho_s, and D, G1 and F in 90 bins each. D's bins are equal in sqrt(theta_h), F's in
    theta_d; G1 is linear between the middles of bins of theta, the first of which is not used. The values on N pairs
    are `(M, N, 3)`, 0 below the horizon.

    Source: see `SOURCE`; the bins are those of its demonstration's shader, which leaves the 1/pi out. That it belongs
    there is seen from the tables: with it 79 of 100 rows are nearest to their own material's, with 1/4 or 1 at most 74.
    """

    def __init__(self, rows: Tensor) -> None:
        super().__init__()
        self.rows: Tensor
        self.register_buffer("rows", rows)

    def forward(self, pairs: Pairs) -> Tensor:
        """BRDF values in 1/sr, `(M, N, 3)`."""
        diffuse, specular = self.rows[:, :1], self.rows[:, 1:2]
        d, g, f = self.rows[:, 2:].split(FACTOR_BINS, 1)
        quarter = math.pi / 2
        lobe = _pick(d, (pairs.theta_h / quarter).sqrt() * FACTOR_BINS) * _pick(
            f, pairs.theta_d / quarter * FACTOR_BINS
        )
        masked = _shadow(g, pairs.cos_i) * _shadow(g, pairs.cos_o)
        above = pairs.above_horizon[..., None]
        cosines = torch.where(above, (pairs.cos_i * pairs.cos_o)[..., None], 1)
        return torch.where(above, (diffuse + specular * lobe * masked / cosines) / math.pi, 0)


def _pick(table: Tensor, place: Tensor) -> Tensor:
    """Entries of `(M, 90, 3)` at `(M, N)`, or at `(1, N)` or `(N,)` for all."""
    index = place.clamp(0, FACTOR_BINS - 1).long().expand(len(table), -1)
    return table.gather(1, index[..., None].expand(-1, -1, 3))


def _shadow(g: Tensor, cosine: Tensor) -> Tensor:
    """G1 `(M, N, 3)`; past the middle of the last bin it falls to 0."""
    place = cosine.clamp(-1, 1).acos() / (math.pi / 2) * FACTOR_BINS - 0.5
    low = place.floor()
    share = (place - low)[..., None]
    ahead = torch.where(low[..., None] + 1 > FACTOR_BINS - 1, 0, _pick(g, (low + 1).clamp_min(2)))
    return _pick(g, low.clamp_min(1)) * (1 - share) + ahead * share


@dataclass(frozen=True)
class FactorFits:
    """Non-parametric factors of all MERL materials; rows: `(100, 272, 3)`."""

    materials: list[str]
    rows: Tensor

    def __len__(self) -> int:
        return len(self.materials)

    def of(self, materials: Sequence[str]) -> FactorModel:
        """Batched model of some materials, in this order; a UsageError for one that is not there."""
        missing = [name for name in materials if name not in self.materials]
        if missing:
            raise UsageError(f"factors: expected one of {len(self)} materials, found {missing[0]!r}")
        return FactorModel(self.rows[[self.materials.index(name) for name in materials]])


def read_factors(path: Path | str) -> FactorFits:
    """Read non-parametric factors: float32, 256 rows of 512 colours, of which the first 100 are materials.

    The file does not say which row is whose. They lie as a listing in English sorts the tables' file names, without
    regard to hyphens: compared with the tables so, all are near their own, with a median of 0.14 of the RMS difference
    of log(x + 0.001).

    Raises:
        DataError: The file is missing, has another size, or holds impossible factors.
    """
    path = Path(path)
    if not exists(path):
        raise DataError(f"{path}: no such file; expected {SOURCE}")
    size, data = 4 * math.prod(SHAPE), read_bytes(path, "non-parametric factors")
    if len(data) != size:
        raise DataError(f"{path}: expected {size} bytes, found {len(data)}")
    names = sorted(MERL_NAMES, key=lambda name: name.replace("-", "") + "binary")
    rows = torch.from_numpy(np.frombuffer(data, "<f4").reshape(SHAPE)[: len(names), : 2 + 3 * FACTOR_BINS].copy())
    bad = (~rows.isfinite().all(2).all(1) | (rows < 0).flatten(1).any(1) | ~rows.flatten(1).any(1)).nonzero()
    if len(bad):
        row = int(bad[0, 0])
        raise DataError(f"{path}: row {row} ({names[row]}): expected finite factors of at least 0, not all 0")
    return FactorFits(names, rows)
