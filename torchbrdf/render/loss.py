"""Pictures as a loss: how far a BRDF's picture of a scene is from the measured one's."""

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torchbrdf.color import luminance
from torchbrdf.errors import UsageError
from torchbrdf.images import DIFFERENCES, Difference, PixelDifference, ToneMap, log_average_and_white, tonemap
from torchbrdf.losses import ImageLoss, Problem
from torchbrdf.losses.image import QuadraticModel
from torchbrdf.pairs import Pairs
from torchbrdf.precision import undisturbed
from torchbrdf.reduction import Reduction
from torchbrdf.render.scene import Scene
from torchbrdf.render.side_by_side import SideBySide
from torchbrdf.render.transport.transport import Transport

if TYPE_CHECKING:
    from scipy import sparse

# Pixels that starts are compared by.
_SUBSAMPLE = 1200
# In the place of differences that are no mean over pixels, while starts are tried.
_SURROGATE = "delta_e76"


class RenderedLoss(ImageLoss):
    """The difference of two pictures of one scene: `loss(prediction, target, scene.pairs)`.

    Values are those on the scene's pairs, `(M, N, 3)`; its transport makes pictures of them, in which only the object
    counts. Differences of display values see both pictures through one tone map, which never depends on the prediction
    or on the other materials of a batch. `fit(model, measured, RenderedLoss(scene))` fits to the scene's pairs, with
    the measured values there as target; `max_theta` and `samples` do not matter to it.

    Args:
        scene: what is drawn; or several scenes side by side, for differences that are means over pixels. For lobes with
            a grain it has to be oriented.
        difference: a registered image difference, or its name; the error is what it says (of psnr the root of the mean
            square).
        tone: the tone map; None: for each material one that is measured on its own reference.
        reduction: as of `Loss`.

    Raises:
        UsageError: for an unknown difference, or one that needs larger pictures or a single one.

    Example:
        >>> from torchbrdf.lobes import Lambert
        >>> from torchbrdf.render import Environment, Scene, Camera, blob
        >>> scene = Scene(blob(), Camera(), Environment.default(), size=16, light_samples=64)
        >>> loss, values = RenderedLoss(scene, "log_hdr"), Lambert()(scene.pairs).detach()
        >>> loss(values, values, scene.pairs)
        tensor(0.)
    """

    @undisturbed()
    def __init__(
        self,
        scene: Scene | SideBySide,
        difference: Difference | str = "delta_e76",
        *,
        tone: ToneMap | None = None,
        reduction: Reduction = "mean",
    ) -> None:
        own = DIFFERENCES[difference]() if isinstance(difference, str) else difference
        if own.reduction != "none":
            found = own.reduction
            raise UsageError(f"RenderedLoss: expected a difference without a reduction, found {found!r}; give it here")
        if isinstance(scene, SideBySide) and not isinstance(own, PixelDifference):
            name = own.registered_name
            raise UsageError(f"RenderedLoss: expected one scene, since {name} is no mean over pixels, found several")
        if scene.size < own.least_side:
            name = own.registered_name
            raise UsageError(
                f"RenderedLoss: {name} needs pictures of {own.least_side} pixels a side, found {scene.size}"
            )
        self._set(own, tone, reduction, scene.summary, scene.mask, scene.transport, scene.pairs)

    def _set(
        self,
        difference: Difference,
        tone: ToneMap | None,
        reduction: Reduction,
        scene_summary: str,
        mask: Tensor,
        transport: Transport,
        pairs: Pairs,
    ) -> None:
        super().__init__(reduction)
        self.difference, self.tone, self.scene_summary = difference, tone, scene_summary
        self.mask, self.transport, self.pairs = mask, transport, pairs
        power = difference.power if isinstance(difference, PixelDifference) else None
        self.is_root = power == 2
        # Mean lengths have a cusp, rounded over widths in units of the difference from black.
        self.smoothing_widths = (0.1, 0.01, 0.001) if power == 1 else (None,)

    def _replaced(
        self, difference: Difference, transport: Transport | None = None, pairs: Pairs | None = None
    ) -> "RenderedLoss":
        """A loss with another difference, or of a part of the picture."""
        made = RenderedLoss.__new__(RenderedLoss)
        transport, pairs = transport or self.transport, pairs or self.pairs
        made._set(difference, self.tone, self.reduction, self.scene_summary, self.mask, transport, pairs)
        return made

    def extra_repr(self) -> str:
        """The difference, the scene and the reduction."""
        tone = "" if self.tone is None else ", tone=..."
        rest = super().extra_repr().split("reduction=")
        reduction = f", reduction={rest[1]}" if len(rest) > 1 else ""
        return f"{self.scene_summary!r}, {self.difference.registered_name!r}{tone}{reduction}"

    @property
    def registered_name(self) -> str:
        """`rendered_` and the name of the difference."""
        return f"rendered_{self.difference.registered_name}"

    @property
    def _pixelwise(self) -> PixelDifference:
        if not isinstance(self.difference, PixelDifference):
            raise UsageError(f"{self.registered_name}: is no mean over pixels")
        return self.difference

    @property
    def has_majorizer(self) -> bool:
        """Whether the difference is a mean over pixels."""
        return isinstance(self.difference, PixelDifference)

    def problem(self, measured: Any, subset: Tensor | None = None) -> Problem:
        """The scene's pairs, and the measured values there."""
        if subset is not None:
            raise UsageError(f"{self.registered_name}: a picture has no subsets of pairs")
        measured.check_rgb(self.registered_name)
        pairs = self.pairs.to(measured.device, measured.dtype)
        values = measured.at(pairs) if pairs.is_oriented else measured.reciprocal_at(pairs)
        return Problem(pairs, values.to(measured.device, measured.dtype))

    def _on(self, like: Tensor) -> Transport:
        if self.transport.index.device != like.device:
            self.transport = self.transport.to(like.device)
        return self.transport

    def observe(self, values: Tensor) -> Tensor:
        """The pixels that show something, `(M, P, 3)`, linear."""
        if values.dim() == 2:
            values = values[None]
        return self._on(values).pixels(values)

    def observe_basis(self, responses: Tensor) -> Tensor:
        """Pictures of scalar functions as each channel of the light shows them."""
        return self._on(responses).columns(responses)

    def observation_matrices(self) -> "list[sparse.csr_matrix] | None":
        """The transport's, if it is kept in memory."""
        return self.transport.matrices() if self.transport.in_memory else None

    def compare(self, observed: Tensor, target: Tensor) -> Tensor:
        """The difference's loss."""
        first, second = self._shown(observed, target), self._shown(target, target)
        if self.has_majorizer:
            return self.difference.loss(first[:, None], second[:, None]).double()
        picture = self.transport.picture
        return self.difference.loss(picture(first), picture(second), self.mask.to(observed.device)).double()

    def quadratic_majorizer(self, observed: Tensor, target: Tensor, width: Tensor | None = None) -> QuadraticModel:
        """Gauss and Newton's; of a mean length the parabola that touches it on both sides and is nowhere below it."""
        difference = self._pixelwise

        with torch.enable_grad():
            # Backward, a feature at a time: torch's forward differentiation is not for several threads.
            point = observed.detach().requires_grad_()
            encoded = difference.encode(self._shown(point, target))
            features = encoded.flatten(0, -2).sum(0)
            rates = [torch.autograd.grad(one, point, retain_graph=True)[0] for one in features]
        with torch.no_grad():
            encoded, jacobian = encoded.detach(), torch.stack(rates, -2)  # (m, P, F), (m, P, F, 3)
            away = encoded - difference.encode(self._shown(target, target))
            square = away.square().sum(-1)
            if difference.power == 2:
                share = 1 / away.shape[-1]
                penalty, factor = square * share, torch.full_like(square, 2 * share)
            else:
                rounded = (
                    square + torch.finfo(square.dtype).tiny
                    if width is None
                    else square + width[:, None].to(square).square()
                )
                penalty = rounded.sqrt()
                factor = 1 / penalty
            factor = factor / square.shape[1]
            slope = torch.einsum("mpfc,mpf->mpc", jacobian, factor[..., None] * away)
            curve = torch.einsum("mpfc,mpfd->mpcd", jacobian, jacobian * factor[..., None, None])
            return penalty.double().mean(1), slope, curve

    def surrogate(self) -> "RenderedLoss":
        """Itself, or the colour difference."""
        return self if self.has_majorizer else self._replaced(DIFFERENCES[_SURROGATE]())

    def subsample(self, problem: Problem) -> tuple["RenderedLoss", Problem]:
        """Some of the pixels, evenly spread over the directions that the surface faces."""
        step = max(len(self.transport.index) // _SUBSAMPLE, 1)
        index = self.transport.index
        rows = torch.arange(step // 2, len(index), step, dtype=torch.int64, device=index.device)
        transport, kept = self.transport.select_rows(rows)
        loss = self.surrogate()._replaced(self.surrogate().difference, transport, self.pairs.select(samples=kept))
        return loss, problem.select(samples=kept)

    def _shown(self, pixels: Tensor, reference: Tensor) -> Tensor:
        """What is compared: linear radiance, or display values."""
        if self.difference.linear:
            return pixels
        if self.tone is not None:
            return self.tone(pixels)
        log_average, white = (
            part[:, None, None].to(pixels.dtype) for part in log_average_and_white(luminance(reference.detach()))
        )
        return tonemap(pixels, log_average, white)
