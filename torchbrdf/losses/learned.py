"""A distance between BRDFs whose four constants were learned from what people answered."""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor

from torchbrdf.color import LUMINANCE
from torchbrdf.errors import ShapeError, UsageError, shown
from torchbrdf.losses.base import LOSSES, Loss
from torchbrdf.losses.bins import THETA_D_BINS, THETA_H_BINS, Bins, sort_into_bins
from torchbrdf.losses.elementary import NEW, Out, log, where_positive
from torchbrdf.losses.kept import Kept
from torchbrdf.losses.metric_file import CONSTANTS, EPSILON, read_metric
from torchbrdf.losses.problem import MeasuredValues, Problem
from torchbrdf.losses.solid_angle import solid_angle
from torchbrdf.pairs import Pairs
from torchbrdf.precision import without_autocast
from torchbrdf.reduction import Reduction
from torchbrdf.roots import safe_norm

LOBE, BODY, COLOR = slice(0, 2), slice(3, 5), slice(2, 5)
"""Bins of theta_h: those of the lobe and of the body, whose contrast is gloss, and those whose colours count."""
GLOSS_THETA_D_BINS = 2
"""In how many bins of theta_d, from the first on: highlights at grazing angles say little about gloss."""
# Degrees from the normal within which a direction is as likely as there: half the width of one of MERL's bins.
HALF_BIN = 0.5
# Numbers of shares that are kept for the next call with the same pairs.
CACHED = 1 << 24


class Encoded(NamedTuple):
    """What is compared of one BRDF, each by its differences.

    Args:
        values: log(x + EPSILON) of each value, `(..., N, C)`.
        luminance: log(l.<x> + EPSILON) of each bin, `(..., B)`, float64.
        logs: log(<x> + EPSILON) of each bin, `(..., C, B)`, float64.
        color: (<x> + EPSILON)^(1/3) of each bin, `(..., C, B)`, float64.
    """

    values: Tensor
    luminance: Tensor
    logs: Tensor
    color: Tensor


class Comparison(NamedTuple):
    """How encodings are compared, float64: what each bin and each channel counts.

    All bins count alike, but for empty ones, and all channels, but for those with less weight.

    Args:
        bins: the pairs in their bins.
        gloss: of luminance, the lobe's mean less the body's, `(..., B)`; 0 where either has no bin with pairs.
        chroma: of color, its mean, `(..., B)`; its sum is 1, or 0 where no bin has pairs.
        even: the share of bins in the mean of all that have pairs, `(..., B)`; its sum is 1.
        channel: the root of the share of channels in the length of a bin's difference, `(..., C, 1)`.
        channel_luminance: the share of channels in luminance, `(..., 1, C)`.
        channel_chroma: the matrix that takes the luminance from a colour, so that the length of what is left is its
            chroma, `(..., C, C)`.
    """

    bins: Bins
    gloss: Tensor
    chroma: Tensor
    even: Tensor
    channel: Tensor
    channel_luminance: Tensor
    channel_chroma: Tensor

    def terms(self, one: Encoded, other: Encoded) -> Tensor:
        """What the constants multiply, `(..., 4)`."""
        chroma = (self.channel_chroma @ ((one.color - other.color) @ self.chroma[..., None]))[..., 0]
        parts = [
            ((one.luminance - other.luminance) * self.gloss).sum(-1).abs(),
            safe_norm(chroma, -1),
            (safe_norm((one.logs - other.logs) * self.channel, -2) * self.even).sum(-1),
            self.bins.mean_size(one.values - other.values),
        ]
        return torch.stack(parts, -1)


@LOSSES.register("learned")
class LearnedLoss(Loss):
    """How different two materials look to people: in gloss, in colour, and anywhere.

    With x = scale max(M, 0) cos_i cos_o and y the same of A; < >_hk the weighted average over the pairs in the soft bin
    h of theta_h and k of theta_d (hat functions between the centres `THETA_H`, 0, 5, 15, 35, 70 degrees, and `THETA_D`,
    25, 50, 75 degrees); l luminance by ITU-R BT.709; c(v) = sqrt(mean_c (v_c - l.v)^2) chroma; and E = `EPSILON`, 1e-3:

        G(x) = mean_(h = 0, 5; k = 25, 50) log(l.<x>_hk + E) - mean_(h = 35, 70; k = 25, 50) log(l.<x>_hk + E)
        C(x) = mean_(h = 15, 35, 70; k) (<x>_hk + E)^(1/3)
        D = w1 |G(x) - G(y)| + w2 c(C(x) - C(y)) + w3 mean_hk sqrt(mean_c b_hkc^2)
            + w4 mean_nc |log(x_nc + E) - log(y_nc + E)|,    b_hkc = log(<x>_hkc + E) - log(<y>_hkc + E)

    G is gloss, how far the lobe stands out from the body; C the colour beside the highlight. The constants that come
    with torchbrdf, by their names in `metric.json`:

        w1  gloss      0.2906
        w2  chroma     5.431
        w3  bins       0.1197
        w4  pointwise  0.1575

    An area light and the eye's blur average radiance before the eye compresses it: so do the bins. The first two terms
    order what people see; errors would cancel within them, and the last two hold fits together: each bin, by the length
    of its difference over channels (absolute ones of each channel gave fits whose highlights were tinted), and within
    it each value. D is a sum of absolute differences of encodings: symmetric, 0 for equal values only, and
    obeys the triangle inequality; at equal values, where it has a cusp, its gradient is 0. Averages make it depend
    little on the choice of pairs, where their weights are passed. A bin without pairs adds nothing, and means over bins
    are those of the others.

    With one channel, luminance is its value and there is no chroma; with any other number but three, all channels count
    alike in luminance unless `luminance` says otherwise, as a fit does where it knows the wavelengths. Weights that
    differ by channel weigh each channel's averages, and its share in luminance and chroma by the sum of its weights.

    Unit: the mean distance between two materials of MERL; `provenance` says where the constants are from.

    Args:
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.
        weights: the path of a `metric.json`, or what such a file holds; None: the constants above.
        scale: what values are multiplied by, above 0. Dark differences count by E, which is meant for MERL's
            scale: 1/sr, with white at 1/pi. Give the factor that brings other data there.
        luminance: what each channel counts in luminance; None: BT.709's shares of three channels, others alike.

    Raises:
        DataError: for constants that are none.
        UsageError: for any other reduction or scale, or shares of luminance that are none.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_half_diff(*torch.full((3, 5), 0.5))
        >>> LearnedLoss("none")(torch.ones(2, 5, 3), torch.ones(2, 5, 3), pairs)
        tensor([0., 0.])

    Source: this project; trained (recipe train_metric) on the answers of M. Lagunas et al. 2019,
    doi:10.1145/3306346.3323036, and G. Lavoue et al. 2021, doi:10.1111/cgf.142636.
    """

    needs = ("cos_i", "cos_o", "theta_h", "theta_d")
    objective = "binned"
    is_root = False
    default_diffuse = "fit"
    # Differences of logarithms, and a tenth of that of cube roots.
    smoothing_widths = (0.2, 0.05, 0.01)

    def __init__(
        self,
        reduction: Reduction = "mean",
        weights: str | Path | Mapping[str, Any] | None = None,
        scale: float = 1.0,
        luminance: Sequence[float] | None = None,
    ) -> None:
        super().__init__(reduction)
        if not 0 < scale < math.inf:
            raise UsageError(f"LearnedLoss: scale: expected a factor above 0, found {shown(scale)}")
        data = read_metric(weights)
        self.provenance: dict[str, Any] = dict(data.get("provenance", {}))
        self.weights = weights if isinstance(weights, str | Path) else None
        self.scale = scale
        self.luminance = None if luminance is None else _shares(luminance)
        self.constants: Tensor
        own = [data["constants"][name] for name in CONSTANTS]
        self.register_buffer("constants", torch.tensor(own, dtype=torch.float64, device="cpu"))
        self._kept_comparison: Kept[Comparison] = Kept()

    def with_luminance(self, shares: Sequence[float]) -> "LearnedLoss":
        """The same metric of other channels; its own shares, where it was given some, stay."""
        if self.luminance is not None:
            return self
        made = copy.deepcopy(self)
        made.luminance = _shares(shares)
        return made

    def exposure(self, pairs: Pairs | None) -> Tensor:
        """scale cos_i cos_o."""
        found = cosines(pairs)[..., 0]
        return found if self.scale == 1 else found * self.scale

    def compress(self, x: Tensor) -> Tensor:
        """log(x + EPSILON), what is compared of single values."""
        return x.clamp_min(0).add(EPSILON).log()

    def compress_with_derivative(self, x: Tensor, out: Out = NEW) -> tuple[Tensor, Tensor]:
        """1 / (x + EPSILON), 0 for values of 0 or less."""
        base = torch.clamp_min(x, 0, out=out[1]).add_(EPSILON)
        return log(base, out[0]), where_positive(base.reciprocal_(), x)

    def penalty(self, difference: Tensor) -> Tensor:
        """|d|."""
        return difference.abs()

    def penalty_with_derivatives(
        self, difference: Tensor, width: Tensor | None = None, out: Out = NEW
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Of sqrt(d^2 + width^2), with the parabola that touches it on both sides and is nowhere below it."""
        return rounded_absolute(difference, width, out)

    def exposed(self, values: Tensor, pairs: Pairs | None) -> Tensor:
        """x = scale max(M, 0) cos_i cos_o."""
        x, cosine = values.clamp_min(0), cosines(pairs)
        cosine = cosine if self.scale == 1 else cosine * self.scale
        # In place where possible: memory that is new costs more than the arithmetic.
        fits = cosine.dtype == x.dtype and cosine.dim() <= x.dim() and cosine.numel() == x.shape[-2]
        return x.mul_(cosine) if fits else x * cosine

    def terms(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """What the constants multiply, in the order of `CONSTANTS`, `(..., 4)`, float64; arguments as `error`."""
        self._check(prediction, target, pairs, weight)
        prediction, target, pairs = self._widened(prediction, target, pairs)
        if pairs is None:
            raise ShapeError(f"{type(self).__name__}: needs pairs, to sort them into bins")
        with without_autocast(prediction.device.type):
            like = torch.promote_types(prediction.dtype, target.dtype)
            prediction, target = prediction.to(like), target.to(like)
            comparison = self.comparison(pairs, weight, target)
            one = self.encoded(prediction, pairs, comparison)
            key = (target, pairs, weight, self.scale, self.luminance)
            other: Encoded | None = self._kept_target.find(*key)
            if other is None:
                other = self.encoded(target, pairs, comparison)
                self._kept_target.keep(other, *key, own=other.color)
            return comparison.terms(one, other)

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The distance of each material, `(...)`, float64."""
        return self.terms(prediction, target, pairs, weight) @ self.constants

    def comparison(self, pairs: Pairs, weight: Tensor | None, like: Tensor) -> Comparison:
        """How values `like` `(..., N, C)` are compared under weights; kept, as the same come again in a fit."""
        key = (pairs, weight, like.dtype, like.shape[-2:], self.luminance)
        found = self._kept_comparison.find(*key)
        if found is None:
            bins = sort_into_bins(pairs, weight, like)
            channels = channel_shares(bins.total, like.shape[-1], self.luminance)
            found = Comparison(bins, *bin_shares(bins.present), *channels)
            if bins.shares.numel() <= CACHED:
                self._kept_comparison.keep(found, *key, own=bins.mass)
        return found

    def problem(self, measured: MeasuredValues, subset: Tensor | None = None) -> Problem:
        """As `Loss.problem`; MERL's bins with the weights that make of them pairs uniform in (theta_i, theta_o, phi).

        Such pairs the constants were trained on. The bins are the denser the nearer theta_h is to 0, so that no lobe is
        so sharp that it slips between them.
        """
        found = super().problem(measured, subset)
        if not measured.on_merl_bins:
            return found
        density = uniform_density(found.pairs)
        given = found.weight
        own = density if given is None or bool((given == 1).all()) else density * given
        return Problem(found.pairs, found.target, own)

    def encoded(self, values: Tensor, pairs: Pairs, comparison: Comparison) -> Encoded:
        """What is compared of values `(..., N, C)`."""
        x = self.exposed(values, pairs)
        averages = comparison.bins.averages(x)
        logs = (x + EPSILON).log() if averages.requires_grad else x.add_(EPSILON).log_()
        averages = averages + EPSILON
        luminance = (comparison.channel_luminance @ averages)[..., 0, :].log()  # shares of luminance add up to 1
        return Encoded(logs, luminance, averages.log(), averages.pow(1 / 3))

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Constants follow to another device, but stay float64, as terms are; half precision would round them."""
        before = self.constants
        super()._apply(fn, recurse)
        self.constants = before.to(self.constants.device)
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Copies and other processes have other pairs."""
        return {**super().__getstate__(), "_kept_comparison": Kept()}


def cosines(pairs: Pairs | None) -> Tensor:
    """cos_i cos_o as a column `(..., N, 1)`, 0 below the horizon."""
    if pairs is None:
        raise ShapeError("pairs are needed for cos_i and cos_o")
    return pairs.cached(cosines, lambda: pairs.cos_i.clamp_min(0) * pairs.cos_o.clamp_min(0))[..., None]


def uniform_density(pairs: Pairs) -> Tensor:
    """How much of (theta_i, theta_o, phi) each of MERL's bins covers, as a column `(..., N, 1)`, 1 on average.

    d(omega_i) d(omega_o) is sin(theta_i) sin(theta_o) d(theta_i) d(theta_o) d(phi), but for a constant.
    """
    least = math.sin(math.radians(HALF_BIN))
    sines = [(1 - cosine.square()).clamp_min(least**2).sqrt() for cosine in (pairs.cos_i, pairs.cos_o)]
    found = solid_angle(pairs) / (sines[0] * sines[1])
    return (found / found.mean(-1, keepdim=True))[..., None]


def rounded_absolute(difference: Tensor, width: Tensor | float | None, out: Out = NEW) -> tuple[Tensor, Tensor, Tensor]:
    """sqrt(d^2 + width^2), its derivative, and the curvature of the parabola that touches it at d and -d."""
    if width is None:
        tiny = torch.finfo(difference.dtype).tiny ** 0.5
        size = torch.abs(difference, out=out[0])
        curvature = torch.reciprocal(torch.clamp_min(size, tiny, out=out[2]), out=out[2])
        return size, torch.sign(difference, out=out[1]), curvature
    rounding = width.square() if isinstance(width, Tensor) else difference.new_tensor(width**2)
    square = torch.addcmul(rounding, difference, difference, out=out[0])
    root = torch.sqrt(square, out=out[0])
    curvature = torch.reciprocal(root, out=out[2])
    return root, torch.mul(difference, curvature, out=out[1]), curvature


def bin_shares(present: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`gloss`, `chroma` and `even` of a `Comparison`, from which bins are there, `(..., B)`."""
    rows = present.unflatten(-1, (THETA_H_BINS, THETA_D_BINS))
    lobe, body, color = torch.zeros_like(rows), torch.zeros_like(rows), torch.zeros_like(rows)
    near = slice(GLOSS_THETA_D_BINS)
    both = rows[..., LOBE, near].amax(-2, keepdim=True) * rows[..., BODY, near].amax(-2, keepdim=True)
    for own, place in ((lobe, LOBE), (body, BODY)):
        own[..., place, near] = _even(rows[..., place, near], -2) * both
    color[..., COLOR, :] = _even(rows[..., COLOR, :], -1)
    columns = both.sum((-2, -1), keepdim=True).clamp_min(1)
    return ((lobe - body) / columns).flatten(-2), _even(color, (-2, -1)).flatten(-2), _even(present, -1)


def _even(shares: Tensor, dim: int | tuple[int, ...]) -> Tensor:
    """Shares whose sum is 1, or 0 where there are none."""
    total = shares.sum(dim, keepdim=True)
    return shares / torch.where(total > 0, total, 1)


def _shares(luminance: Sequence[float]) -> tuple[float, ...]:
    """What channels count in luminance, checked."""
    try:
        found = tuple(map(float, luminance))
    except (TypeError, ValueError):
        found = ()
    if not found or not all(0 <= one < math.inf for one in found) or not sum(found):
        raise UsageError(
            f"LearnedLoss: luminance: expected a share from 0 on for each channel, found {shown(luminance)}"
        )
    return found


def channel_shares(
    total: Tensor, channels: int, luminance: Sequence[float] | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """`channel`, `channel_luminance`, `channel_chroma` of a `Comparison`, from each channel's weight, `(..., 1|C)`.

    luminance: what each channel counts in it; None: as linear RGB has it, other channels alike.
    """
    known = luminance if luminance is not None else LUMINANCE if channels == len(LUMINANCE) else [1.0] * channels
    if len(known) != channels:
        raise ShapeError(f"LearnedLoss: luminance: expected values of {len(known)} channels, found {channels}")
    share = (total / total.amax(-1, keepdim=True)).nan_to_num(1).expand(*total.shape[:-1], channels)
    light = share * share.new_tensor(known)
    light = (light / light.sum(-1, keepdim=True))[..., None, :]
    root = (share / share.sum(-1, keepdim=True)).sqrt()[..., None]
    one = torch.eye(channels, dtype=share.dtype, device=share.device)
    return root, light, root * (one - light)
