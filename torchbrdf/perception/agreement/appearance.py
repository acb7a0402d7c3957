"""What is measured of a material beside what people call it: do gloss dimensions predict "glossy"?"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.stats import rankdata
from torch import Tensor

from torchbrdf.bootstrap import percentile_interval
from torchbrdf.color import luminance
from torchbrdf.errors import DataError
from torchbrdf.losses import LearnedLoss
from torchbrdf.measured import Measured
from torchbrdf.measured.gloss import contrast_gloss, distinctness_of_image
from torchbrdf.pairs import Pairs
from torchbrdf.perception.datasets.ratings import Ratings
from torchbrdf.perception.directions import uniform_pairs

LABELS = {
    "sharpness": "sharpness: 1 / distinctness-of-image angle",
    "contrast_gloss": "contrast gloss",
    "albedo": "diffuse albedo, luminance",
    "gloss": "lobe over body, log (learned metric)",
}
"""What is measured of a material, in words."""
TOGETHER = "together"
_LEAST = 8


@dataclass(frozen=True)
class Appearance:
    """What is measured of K materials, what people say of them, and how the ranks of both go together.

    Args:
        materials: Names.
        measured: S quantities by name, `(K,)` each.
        ratings: Of these materials.
        correlation: Spearman's, `(S + 1, A)`; the last row is of a linear prediction of ranks from all S, each material
            predicted from the others.
        low: Of the 95 % interval over materials, `(S, A)`.
        high: Likewise.
        ceiling: The largest correlation that the noise of mean ratings lets anything have, `(A,)`.
    """

    materials: list[str]
    measured: dict[str, Tensor]
    ratings: Ratings
    correlation: Tensor
    low: Tensor
    high: Tensor
    ceiling: Tensor

    def records(self) -> list[dict[str, object]]:
        """One record for each quantity and attribute."""
        return [
            {
                "measured": name,
                "attribute": attribute,
                "materials": len(self.materials),
                "spearman": float(self.correlation[s, a]),
                "low": float(self.low[s, a]) if s < len(self.measured) else None,
                "high": float(self.high[s, a]) if s < len(self.measured) else None,
                "ceiling": float(self.ceiling[a]),
            }
            for s, name in enumerate([*self.measured, TOGETHER])
            for a, attribute in enumerate(self.ratings.attributes)
        ]


def gloss_term(measured: Measured, pairs: Pairs | None = None) -> Tensor:
    """The gloss that `LearnedLoss` compares, its G: log luminance of the lobe over that of the body.

    Args:
        measured: K materials.
        pairs: Where; None: `uniform_pairs()`.

    Returns:
        `(K,)`, float64.
    """
    pairs = uniform_pairs() if pairs is None else pairs
    loss, values = LearnedLoss("none"), measured.at(pairs)
    comparison = loss.comparison(pairs, None, values)
    return (loss.encoded(values, pairs, comparison).luminance * comparison.gloss).sum(-1)


def compare_appearance(
    measured: Measured, ratings: Ratings, replicates: int = 1000, seed: int = 0, pairs: Pairs | None = None
) -> Appearance:
    """Compare what is measured of materials with what people call them.

    Args:
        measured: Tables; those that were rated count.
        ratings: Of measured materials among others.
        replicates: Of the bootstrap over materials.
        seed: Of the bootstrap.
        pairs: Where `gloss_term` compares; None: `uniform_pairs()`.

    Raises:
        DataError: Fewer than eight of the materials were rated.
    """
    rated = {name for name, known in zip(ratings.materials, ratings.measured, strict=True) if known}
    tables = measured.batch([k for k, name in enumerate(measured.names) if name in rated])
    found = {
        "sharpness": 1 / distinctness_of_image(tables).clamp_min(1e-6),
        "contrast_gloss": contrast_gloss(tables),
        "albedo": luminance(tables.diffuse_45_0()).double(),
        "gloss": gloss_term(tables, pairs),
    }
    known = torch.stack([own.isfinite() for own in found.values()]).all(0).nonzero()[:, 0].tolist()
    if len(known) < _LEAST:
        raise DataError(f"ratings: expected at least {_LEAST} of the measured materials, found {len(known)}")
    names = [tables.names[k] for k in known]
    found = {name: own[known].double() for name, own in found.items()}
    own = ratings.select(names)
    x, y = torch.stack(list(found.values()), 1).numpy(), own.mean.numpy()
    drawn = np.random.default_rng(seed).integers(0, len(names), (replicates, len(names)))
    ends = percentile_interval(_correlations(x[drawn], y[drawn]).flatten(1)).reshape(x.shape[1], y.shape[1], 2)
    plain = _correlations(x[None], y[None])[0]
    spread = own.mean.var(0, correction=1)
    reliability = (1 - own.standard_error.square().mean(0) / spread).nan_to_num(0).clamp(0, 1)
    return Appearance(
        names, found, own, torch.cat([plain, _predicted(x, y)]), ends[..., 0], ends[..., 1], reliability.sqrt()
    )


def _correlations(x: np.ndarray, y: np.ndarray) -> Tensor:
    """Spearman's rank correlations of each column of `(B, K, S)` with each of `(B, K, A)`, `(B, S, A)`.

    One of a column whose entries are all the same is nan.
    """
    one, other = (rankdata(values, axis=1) for values in (x, y))
    one, other = (ranks - ranks.mean(1, keepdims=True) for ranks in (one, other))
    lengths = np.sqrt((one**2).sum(1)[:, :, None] * (other**2).sum(1)[:, None])
    products = np.einsum("bks,bka->bsa", one, other)
    return torch.from_numpy(np.divide(products, lengths, out=np.full_like(lengths, np.nan), where=lengths > 0))


def _predicted(x: np.ndarray, y: np.ndarray) -> Tensor:
    """Correlation of ranks with their prediction from all columns of x and a constant, material by material, `(1, A)`.

    Each is predicted from the others: the residual of the fit to all, over 1 minus its leverage.
    """
    one, ranks = (rankdata(values, axis=0) for values in (x, y))
    columns = np.concatenate([np.ones((len(one), 1)), one], 1)
    hat = columns @ np.linalg.pinv(columns)
    left_out = ranks - (ranks - hat @ ranks) / (1 - np.diag(hat))[:, None]
    return torch.diagonal(_correlations(left_out[None], ranks[None])[0])[None]
