"""A distance between BRDFs whose weights were learned from what people answered."""

from collections.abc import Callable, Mapping
from importlib.resources import files
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NotRequired, Self, TypedDict

import torch
from torch import Tensor

from torchbrdf.color import LUMINANCE
from torchbrdf.errors import DataError, ShapeError, shown
from torchbrdf.losses.base import LOSSES, version
from torchbrdf.losses.binned import BinnedLoss, bin_mass
from torchbrdf.pairs import Pairs
from torchbrdf.reading import read_json
from torchbrdf.reduction import Reduction

FLOOR = 1e-4
"""Added to values times cosines before the fourth root: how dark a difference can be before it no longer counts."""
THETA_H = (0.0, 5.0, 15.0, 35.0, 70.0)
THETA_D = (15.0, 45.0, 75.0)
"""Centres of the soft bins, in degrees."""

THETA_H_BINS, THETA_D_BINS = len(THETA_H), len(THETA_D)
BIN_COUNT = THETA_H_BINS * THETA_D_BINS
BIN_PAIRS = tuple(combinations(range(THETA_H_BINS), 2))
COLOR_FEATURES = ("luminance", "chroma")
SHAPES = {"mean": (THETA_H_BINS, THETA_D_BINS), "contrast": (len(BIN_PAIRS), THETA_D_BINS)}
POINTWISE = "pointwise"
BUNDLED = "learned_metric.json"
LARGEST_WEIGHT = 1e20
"""Trained weights are below 1e3, or 4e10 for a bin that few pairs see; far larger ones overflow in float32."""


class MetricWeights(TypedDict):
    """The weights of a `metric.json`, whose shapes `SHAPES` has."""

    pointwise: list[float]
    mean: "FeatureWeights"
    contrast: "FeatureWeights"


class FeatureWeights(TypedDict):
    """Weights for each of `COLOR_FEATURES`."""

    luminance: list[list[float]]
    chroma: list[list[float]]


class MetricFile(TypedDict):
    """What a `metric.json` holds."""

    weights: MetricWeights
    provenance: NotRequired[dict[str, Any]]
    floor: NotRequired[float]
    theta_h: NotRequired[list[float]]
    theta_d: NotRequired[list[float]]


@LOSSES.register("learned")
class LearnedLoss(BinnedLoss):
    """sqrt(P + M + K), a norm of differences d_c = e(M_c) - e(A_c), e(x) = (max(x, 0) cos_i cos_o + FLOOR)^(1/4).

    Shapes as `Loss`. Each pair has a luminance difference y = sum_c l_c d_c (l: `LUMINANCE`; 1/C each if there are not
    three channels) and C chroma differences d_c - y. < >_hk is the weighted average over the pairs in the soft bin h of
    theta_h and k of theta_d (hat functions between the centres `THETA_H` and `THETA_D`), and every w is a learned
    weight of at least 0, those of M and K one for luminance and one for chroma:

    - pointwise: P = sum_hk w_h <mean_c d_c^2>_hk, what differs anywhere;
    - mean: M = sum_hk w_hk <y>_hk^2 + w'_hk sum_c <d_c - y>_hk^2, what differs on average in a bin: the brightness and
      the colour of lobe and body;
    - contrast: K = sum_hgk w_hgk (<y>_hk - <y>_gk)^2 + the same of chroma, for every two bins h < g of theta_h: how the
      lobe falls off, and how it stands out from the body.

    Symmetric; 0 for equal values only, as far as e and the pairs see them; it obeys the triangle inequality, and grows
    in proportion along a straight path of e. A common factor s on all values multiplies it by s^(1/4) while values are
    well above FLOOR: the factor that MERL tables carry matters. Bins are averages, so the choice of pairs matters
    little where their weights are passed; a bin without pairs adds nothing. Weights that differ by channel weigh
    luminance, and scale the chroma of a channel by w_c / max_c w_c.

    Unit: the mean distance between two of the materials that the weights were learned from; `provenance` says which.

    Args:
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.
        weights: the path of a `metric.json`, or what such a file holds; None: those that come with torchbrdf.

    Raises:
        DataError: for weights that are none.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_half_diff(*torch.full((3, 5), 0.5))
        >>> LearnedLoss("none")(torch.ones(2, 5, 3), torch.ones(2, 5, 3), pairs)
        tensor([0., 0.])

    Source: this project; trained (recipe train_metric) on the answers of M. Lagunas et al. 2019,
    doi:10.1145/3306346.3323036, and G. Lavoue et al. 2021, doi:10.1111/cgf.142636. The probit likelihood of
    comparisons is L. L. Thurstone's, A law of comparative judgment, 1927.
    """

    needs = ("cos_i", "cos_o", "theta_h", "theta_d")

    def __init__(self, reduction: Reduction = "mean", weights: str | Path | Mapping[str, Any] | None = None) -> None:
        super().__init__(reduction)
        data = read_weights(weights)
        self.provenance: dict[str, Any] = dict(data.get("provenance", {}))
        pointwise, averages = unpack_weights(data["weights"])
        self.weights = weights if isinstance(weights, str | Path) else None
        self.average_weight: Tensor
        self.register_buffer("square_weight", pointwise)
        self.register_buffer("average_weight", averages)
        self._factor: tuple[Tensor, int, int, Tensor] | None = None

    def encode(self, values: Tensor, pairs: Pairs | None) -> Tensor:
        """(max(M, 0) cos_i cos_o + FLOOR)^(1/4)."""
        return encode(values, pairs)

    def encode_with_derivative(self, values: Tensor, pairs: Pairs | None) -> tuple[Tensor, Tensor]:
        """cos_i cos_o / 4 (M cos_i cos_o + FLOOR)^(-3/4), 0 for values of 0 or less."""
        encoded = encode(values, pairs)
        return encoded, torch.where(values > 0, 0.25 * cosines(pairs) / encoded.pow(3), 0)

    def membership(self, pairs: Pairs) -> Tensor:
        """`soft_bins`."""
        return soft_bins(pairs)

    def mean_factor(self, channels: int) -> Tensor:
        """`factor` of the weights, kept as long as they stay what they are."""
        weight, kept = self.average_weight, self._factor
        if torch.compiler.is_compiling() or weight.requires_grad:
            return factor(weight, channels)
        if kept is None or kept[0] is not weight or kept[1:3] != (version(weight), channels):
            kept = self._factor = weight, version(weight), channels, factor(weight, channels)
        return kept[3]

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Weights follow to another device, but stay float64, as sums are; half precision would round them."""
        before = dict(self.named_buffers(recurse=False))
        super()._apply(fn, recurse)
        for name, buffer in before.items():
            setattr(self, name, buffer.to(getattr(self, name).device))
        return self

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_factor": None}

    def collapse_channel_weights(self, difference: Tensor, weight: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """The luminance becomes that of the channels by their weights, each chroma that by its share of the largest."""
        if weight is None or weight.dim() == 0 or weight.shape[-1] == 1:
            return difference, weight
        largest = weight.amax(-1, keepdim=True)
        share = torch.where(largest > 0, weight / torch.where(largest > 0, largest, 1), 1)
        lightness = luminance_weights(difference) * share
        y = (lightness * difference).sum(-1, keepdim=True) / lightness.sum(-1, keepdim=True)
        return y + share * (difference - y), largest


def cosines(pairs: Pairs | None) -> Tensor:
    """cos_i cos_o as a column `(..., N, 1)`, 0 below the horizon."""
    if pairs is None:
        raise ShapeError("pairs are needed for cos_i and cos_o")
    return pairs.cached(cosines, lambda: pairs.cos_i.clamp_min(0) * pairs.cos_o.clamp_min(0))[..., None]


def encode(values: Tensor, pairs: Pairs | None) -> Tensor:
    """(max(x, 0) cos_i cos_o + FLOOR)^(1/4), whose slope is finite everywhere."""
    raised, cosine = values.clamp_min(0), cosines(pairs)
    fits = cosine.dtype == raised.dtype and cosine.dim() <= raised.dim() and cosine.numel() == raised.shape[-2]
    # In place where possible: memory that is new costs more than the arithmetic.
    raised = (raised.mul_(cosine) if fits else raised * cosine).add_(FLOOR)
    return raised.sqrt().sqrt() if raised.requires_grad else raised.sqrt_().sqrt_()


def soft_bins(pairs: Pairs) -> Tensor:
    """How much of each pair lies in each bin, `(..., N, BIN_COUNT)`, theta_h slowest; its shares add up to 1."""
    high, wide = (_hats(angle, centres) for angle, centres in ((pairs.theta_h, THETA_H), (pairs.theta_d, THETA_D)))
    return (high[..., :, None] * wide[..., None, :]).flatten(-2)


def _hats(angle: Tensor, centres: tuple[float, ...]) -> Tensor:
    """Piecewise linear functions that are 1 at one centre and 0 at the others, constant outside, `(..., N, K)`."""
    degrees = angle.rad2deg()
    rises = [((degrees - low) / (high - low)).clamp(0, 1) for low, high in pairwise(centres)]
    one, none = torch.ones_like(degrees), torch.zeros_like(degrees)
    return torch.stack([a - b for a, b in zip([one, *rises], [*rises, none], strict=True)], -1)


def luminance_weights(values: Tensor) -> Tensor:
    """The share of each channel of values in luminance, `(C,)`."""
    channels = values.shape[-1]
    return values.new_tensor(LUMINANCE if channels == 3 else [1 / channels] * channels)


def contrasts(means: Tensor) -> Tensor:
    """Averages in bins as luminance and chroma, with their differences between two bins of theta_h.

    From `(..., C, BIN_COUNT)` to `(..., 1 + C, BIN_COUNT + differences)`: luminance first, then each channel's chroma.
    """
    lightness = (luminance_weights(means.mT) @ means)[..., None, :]
    means = torch.cat([lightness, means - lightness], -2)
    one, other = torch.tensor(BIN_PAIRS, device=means.device).unbind(1)
    rows = means.unflatten(-1, (THETA_H_BINS, THETA_D_BINS))
    return torch.cat([means, (rows[..., one, :] - rows[..., other, :]).flatten(-2)], -1)


def factor(weight: Tensor, channels: int) -> Tensor:
    """The matrix whose product with averages, flat, has the square that is M + K.

    weight: `(2, K)`, of luminance and chroma.
    """
    unit = torch.eye(channels * BIN_COUNT, dtype=weight.dtype, device=weight.device).unflatten(
        -1, (channels, BIN_COUNT)
    )
    root = torch.cat([weight[:1], weight[1:].expand(channels, -1)]).sqrt()
    return (contrasts(unit) * root).flatten(-2)


def features(difference: Tensor, bins: Tensor) -> Tensor:
    """What the learned weights multiply, `(..., T)`, at least 0, in the order of `pack_weights`.

    difference: `(..., N, C)`; bins: `soft_bins`, in its dtype.
    """
    mass = bin_mass(bins)
    squares = difference.square().mean(-1)[..., None, :] @ bins / mass
    parts = contrasts((difference.mT @ bins).double() / mass).square()
    pointwise = squares[..., 0, :].unflatten(-1, (THETA_H_BINS, THETA_D_BINS)).sum(-1)
    return torch.cat([pointwise, parts[..., 0, :], parts[..., 1:, :].sum(-2)], -1)


def unpack_weights(weights: Mapping[str, Any]) -> tuple[Tensor, Tensor]:
    """Weights by name as those of mean squares `(BIN_COUNT,)` and of averages `(2, K)`, float64."""
    pointwise = torch.tensor(weights[POINTWISE], dtype=torch.float64).repeat_interleave(THETA_D_BINS)
    rows = [[torch.tensor(weights[name][kind], dtype=torch.float64) for name in SHAPES] for kind in COLOR_FEATURES]
    return pointwise, torch.stack([torch.cat([part.flatten() for part in row]) for row in rows])


def pack_weights(weights: Tensor) -> dict[str, Any]:
    """Weights `(T,)` in the order of `features`, by name, to four digits."""
    rounded = torch.tensor([float(f"{value:.4g}") for value in weights.tolist()], dtype=torch.float64)
    found: dict[str, Any] = {POINTWISE: rounded[:THETA_H_BINS].tolist()} | {name: {} for name in SHAPES}
    for kind, row in zip(COLOR_FEATURES, rounded[THETA_H_BINS:].chunk(2), strict=True):
        start = 0
        for name, (rows, columns) in SHAPES.items():
            found[name][kind] = row[start : start + rows * columns].reshape(rows, columns).tolist()
            start += rows * columns
    return found


def read_weights(weights: str | Path | Mapping[str, Any] | None) -> MetricFile:
    """The content of a `metric.json`, checked; None: that which comes with torchbrdf."""
    where = "weights"
    if isinstance(weights, Mapping):
        data = _convert(weights, where)
    else:
        source = files("torchbrdf.assets") / BUNDLED if weights is None else weights
        where = str(source)
        data = read_json(where, MetricFile, "a learned metric, as the recipe train_metric writes it")
    for key, expected in schema().items():
        if data.get(key, expected) != expected:
            raise DataError(f"{where}: {key}: expected {expected}, found {shown(data.get(key))}")
    _check_part(data["weights"], (POINTWISE,), (THETA_H_BINS,), where)
    for name, shape in SHAPES.items():
        for kind in COLOR_FEATURES:
            _check_part(data["weights"], (name, kind), shape, where)
    if not any(weight.any() for weight in unpack_weights(data["weights"])):
        raise DataError(f"{where}: expected a weight above 0, found none")
    return data


def _convert(weights: Mapping[str, Any], where: str) -> "MetricFile":
    import msgspec  # late: not every loss has weights from outside

    try:
        return msgspec.convert(dict(weights), MetricFile)
    except (msgspec.ValidationError, RecursionError) as error:
        raise DataError(f"{where}: expected a learned metric, found {error}") from None


def schema() -> dict[str, Any]:
    """What the weights of a `metric.json` are the weights of."""
    return {"floor": FLOOR, "theta_h": list(THETA_H), "theta_d": list(THETA_D)}


def _check_part(weights: Any, names: tuple[str, ...], shape: tuple[int, ...], where: str) -> None:
    expected = " x ".join(map(str, shape))
    for name in names:
        weights = weights[name]
    try:
        part = torch.tensor(weights, dtype=torch.float64, device="cpu")
        fits = part.shape == shape and bool(((part >= 0) & (part <= LARGEST_WEIGHT)).all())
    except (TypeError, ValueError, OverflowError):  # lists of different lengths; whole numbers of many digits
        fits = False
    if not fits:
        wanted = f"{expected} numbers from 0 to {LARGEST_WEIGHT:g}"
        raise DataError(f"{where}: {', '.join(names)}: expected {wanted}, found {shown(weights)}")
