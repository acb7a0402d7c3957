"""How consistent observers are, and how far they agree, without a scale: Kendall's coefficients.

Source: M. G. Kendall, B. Babington Smith, On the method of paired comparisons, Biometrika 31(3/4), 1940,
doi:10.1093/biomet/31.3-4.324.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.psychophysics.comparisons import Comparisons


@dataclass(frozen=True)
class KendallAgreement:
    """Kendall's coefficient of agreement u of each material, and its test against chance: all `(M,)`.

    u is 1 where all observers agree, 0 on average where they choose by chance, and least at -1/(m - 1) or -1/m. The
    test's dof are no whole numbers. nan where not every observer judged every pair once; chi_square and p also with
    fewer than 3 observers.
    """

    u: Tensor
    chi_square: Tensor
    dof: Tensor
    p: Tensor


def kendall_agreement(comparisons: Comparisons) -> KendallAgreement:
    """Kendall's coefficient of agreement of observers about each material.

    Observers without an answer to a material are left out there.
    u = 2 S / (C(m, 2) C(n, 2)) - 1 with m observers, n stimuli and S the sum of C(w_ij, 2) over ordered pairs.
    chi^2 = 4 / (m - 2) (S - 1 - C(n, 2) C(m, 2) (m - 3) / (2 (m - 2))), with 1 subtracted for continuity, has about
    a chi-square distribution with C(n, 2) m (m - 1) / (m - 2)^2 degrees of freedom.
    """
    wins, total = comparisons.wins, comparisons.total
    took_part = (wins + wins.mT > 0).any(-1).any(-1)
    whole = (complete(wins) | ~took_part).all(0) & comparisons.present.any(-1)
    # All were asked about the same stimuli, if each was asked about as many as all.
    compared = (wins + wins.mT > 0).any(-1).sum(-1)
    whole &= ((compared == comparisons.present.sum(-1)) | ~took_part).all(0)
    m = took_part.sum(0).to(torch.float64)
    n = comparisons.present.sum(-1).to(torch.float64)
    pairs, judges = n * (n - 1) / 2, m * (m - 1) / 2
    agreeing = (total * (total - 1) / 2).sum((-2, -1))
    u = 2 * agreeing / (pairs * judges) - 1
    chance = pairs * judges * (m - 3) / (2 * (m - 2))
    tested = whole & (m > 2)
    chi_square = (4 / (m - 2) * (agreeing - 1 - chance)).clamp(min=0).masked_fill(~tested, torch.nan)
    dof = (pairs * m * (m - 1) / (m - 2).square()).masked_fill(~tested, torch.nan)
    p = torch.special.gammaincc(dof / 2, chi_square / 2)  # of chi square
    return KendallAgreement(u.masked_fill(~whole | (m < 2), torch.nan), chi_square, dof, p)


def complete(wins: Tensor) -> Tensor:
    """Complete designs, bool `(...)`: whether each pair of two or more stimuli was judged once; wins `(..., n, n)`."""
    compared = wins + wins.mT
    present = (compared > 0).any(-1)
    due = (present.unsqueeze(-1) & present.unsqueeze(-2)).to(wins) - torch.diag_embed(present.to(wins))
    return (compared == due).all(-1).all(-1) & present.any(-1)


def circular_triads(wins: Tensor) -> Tensor:
    """Circular triads, A over B over C over A, of one observer: wins `(..., n, n)` to counts `(...)`.

    d = n (n - 1) (2n - 1) / 12 - sum_i a_i^2 / 2, a_i the wins of stimulus i; nan where not each pair was judged once.
    """
    n = _count(wins)
    triads = n * (n - 1) * (2 * n - 1) / 12 - wins.sum(-1).square().sum(-1) / 2
    return triads.masked_fill(~complete(wins), torch.nan)


def triads_by_chance(wins: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and variance `(...)` of the circular triads of somebody who chooses by chance.

    C(n, 3) / 4 and 3 C(n, 3) / 16; nan where not each pair was judged once.

    Source: P. A. P. Moran, On the method of paired comparisons, Biometrika 34(3/4), 1947,
    doi:10.1093/biomet/34.3-4.363.
    """
    n = _count(wins)
    triples = (n * (n - 1) * (n - 2) / 6).masked_fill(~complete(wins), torch.nan)
    return triples / 4, 3 * triples / 16


def consistence(wins: Tensor) -> Tensor:
    """Kendall's coefficient of consistence zeta `(...)`: 1 without circular triads, 0 with as many as there can be.

    zeta = 1 - 24 d / (n^3 - n) for odd n, 1 - 24 d / (n^3 - 4n) for even n; nan with fewer than three stimuli, or
    where not each pair was judged once.
    """
    n = _count(wins)
    most = torch.where(n % 2 == 1, n**3 - n, n**3 - 4 * n) / 24
    return (1 - circular_triads(wins) / most.clamp(min=1)).masked_fill(n < 3, torch.nan)


def _count(wins: Tensor) -> Tensor:
    return (wins + wins.mT > 0).any(-1).sum(-1).to(wins)
