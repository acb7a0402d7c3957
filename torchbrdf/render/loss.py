"""Pictures as a loss: how far a BRDF's picture of a scene is from the measured one's."""

import copy
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.images import DIFFERENCES, Difference, PixelDifference, ToneMap, displayed, luminance, measured
from torchbrdf.losses import ObservedLoss, Problem
from torchbrdf.losses.base import Reduction, safe_sqrt
from torchbrdf.losses.observed import Parabola
from torchbrdf.render.scene import Scene
from torchbrdf.render.transport.transport import Transport

# Pixels that starts are compared by.
_FEW = 1200
# Stands in for differences that are no mean over pixels, while starts are tried.
_STAND_IN = "delta_e"


class RenderedLoss(ObservedLoss):
    """The difference of two pictures of one scene: `loss(prediction, target, scene.pairs)`.

    Values are those on the scene's pairs, `(M, N, 3)`; its transport makes pictures of them, in which only the object
    counts. difference: a registered image difference, or its name; the error is its figure (of psnr the root of the
    mean square). Differences of display values see both pictures through one tone map, which never depends on the
    prediction or on the other materials of a batch: `tone`, or for each material one measured on its own reference.

    `fit(model, measured, RenderedLoss(scene))` fits to the scene's pairs, with the measured values there as target;
    `max_theta` and `samples` do not matter to it.
    """

    def __init__(
        self,
        scene: Scene,
        difference: Difference | str = "delta_e",
        *,
        tone: ToneMap | None = None,
        reduction: Reduction = "mean",
    ) -> None:
        super().__init__(reduction)
        self.difference = DIFFERENCES[difference]() if isinstance(difference, str) else difference
        self.tone = tone
        least = self.difference.least_side
        if scene.size < least:
            name = self.difference.registered_name
            raise UsageError(f"RenderedLoss: {name} needs pictures of {least} pixels a side, found {scene.size}")
        self.pairs, self.transport, self.mask = scene.pairs, scene.transport, scene.mask
        self.scene = scene.summary
        self._round()

    def extra_repr(self) -> str:
        """The difference, the scene and the reduction."""
        tone = "" if self.tone is None else ", tone=..."
        rest = super().extra_repr().split("reduction=")
        reduction = f", reduction={rest[1]}" if len(rest) > 1 else ""
        return f"{self.scene!r}, {self.difference.registered_name!r}{tone}{reduction}"

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
    def curved(self) -> bool:
        """Whether the difference is a mean over pixels."""
        return isinstance(self.difference, PixelDifference)

    def problem(self, measured: Any, subset: Tensor | None = None) -> Problem:
        """The scene's pairs, and the measured values there."""
        if subset is not None:
            raise UsageError(f"{self.registered_name}: a picture has no subsets of pairs")
        pairs = self.pairs.to(measured.device, measured.dtype)
        return Problem(pairs, measured.at(pairs).to(measured.device, measured.dtype))

    def _on(self, like: Tensor) -> Transport:
        if self.transport.index.device != like.device:
            self.transport = self.transport.to(like.device)
        return self.transport

    def observe(self, values: Tensor) -> Tensor:
        """The pixels that show something, `(M, P, 3)`, linear."""
        if values.dim() == 2:
            values = values[None]
        return self._on(values).pixels(values)

    def columns(self, shapes: Tensor) -> Tensor:
        """Pictures of scalar functions as each channel of the light shows them."""
        return self._on(shapes).columns(shapes)

    def value(self, observed: Tensor, target: Tensor) -> Tensor:
        """The difference's loss."""
        first, second = self._shown(observed, target), self._shown(target, target)
        if self.curved:
            return self.difference.loss(first[:, None], second[:, None]).double()
        picture = self.transport.picture
        return self.difference.loss(picture(first), picture(second), self.mask.to(observed.device)).double()

    def figure(self, value: Tensor) -> Tensor:
        """The root of a mean square; any other difference itself."""
        return safe_sqrt(value) if self.curved and self._pixelwise.power == 2 else value

    def parabola(self, observed: Tensor, target: Tensor, width: Tensor | None = None) -> Parabola:
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

    def stand_in(self) -> "RenderedLoss":
        """Itself, or the colour difference."""
        return self if self.curved else self._with(difference=DIFFERENCES[_STAND_IN]())

    def thinned(self, problem: Problem) -> tuple["RenderedLoss", Problem]:
        """Some of the pixels, evenly spread over the directions that the surface faces."""
        step = max(len(self.transport.index) // _FEW, 1)
        transport, kept = self.transport.thinned(torch.arange(step // 2, len(self.transport.index), step))
        loss = self.stand_in()._with(transport=transport, pairs=self.pairs.select(samples=kept))
        return loss, problem.select(samples=kept)

    def _with(self, **changes: Any) -> "RenderedLoss":
        made = copy.copy(self)
        for name, value in changes.items():
            object.__setattr__(made, name, value)
        made._round()
        return made

    def _round(self) -> None:
        """Mean lengths have a cusp, rounded over widths in units of the difference from black."""
        self.rounding = (0.1, 0.01, 0.001) if self.curved and self._pixelwise.power == 1 else (None,)  # type: ignore[misc]

    def _shown(self, pixels: Tensor, reference: Tensor) -> Tensor:
        """What is compared: linear radiance, or display values."""
        if self.difference.linear:
            return pixels
        if self.tone is not None:
            return self.tone(pixels)
        log_average, white = (part[:, None, None].to(pixels.dtype) for part in measured(luminance(reference.detach())))
        return displayed(pixels, log_average, white)
