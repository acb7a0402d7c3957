"""How far pictures of fits are from those of the measurement, in scenes that no fit saw."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.lobes import FitRecord, Lobe, model_of
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.perception.discrimination.psychometric import Share, told_apart
from torchbrdf.render import Scene
from torchbrdf.render.draw import render_directly

Brdf = FitRecord | Lobe | Measured
DECIDES = "delta_e76"
ALSO = "delta_e_itp"


@dataclass(frozen=True)
class Figures:
    """How far a picture is from the measurement's, in one scene.

    Args:
        differences: By the name of an image difference.

    Example:
        >>> Figures({"delta_e76": 1.4}).told.percent
        '18 %'
    """

    differences: Mapping[str, float]

    @property
    def delta_e76(self) -> float:
        """The colour difference that decides."""
        return self.differences[DECIDES]

    @property
    def told(self) -> Share:
        """The share of observers who would know which is the fit; the others guess."""
        return told(self.delta_e76)

    def to_json(self) -> dict[str, float]:
        """Differences, and the share by the one that decides."""
        return {**self.differences, "told_apart": self.told.value}


def told(delta_e76: float) -> Share:
    """The share of observers who would know the fit by a Delta E 76."""
    found = told_apart(DECIDES, delta_e76)
    return Share(math.nan, math.nan, math.nan, asked=False) if found is None else found


class Judge:
    """Pictures of a material in some scenes, each under a tone map of its own.

    Args:
        measured: One material; or a fit or a lobe in its place.
        scenes: By name.

    Raises:
        DataError: The material has no values where scenes ask for them.

    Example:
        >>> from torchbrdf import load
        >>> from torchbrdf.lobes import read_fits
        >>> from torchbrdf.measured import standins
        >>> from torchbrdf.render import unseen_scenes
        >>> judge = Judge(load(standins()).batch([6]), unseen_scenes(size=12))
        >>> [figures.delta_e76 for figures in judge.figures(read_fits(standins())[6]).values()]
        [0.0, 0.0, 0.0]
    """

    def __init__(self, measured: Brdf, scenes: Mapping[str, Scene]) -> None:
        self.measured, self.scenes = measured, dict(scenes)
        self.linear = {name: self._draw(measured, name) for name in self.scenes}
        self.tones = {name: ToneMap.from_images(linear, self.scenes[name].mask) for name, linear in self.linear.items()}

    def reference(self, scene: str) -> Tensor:
        """Display values of the material, `(size, size, 3)`."""
        return self.tones[scene](self.linear[scene])

    def picture(self, brdf: Brdf, scene: str) -> Tensor:
        """Display values of a BRDF in the material's place, `(size, size, 3)`."""
        return self.tones[scene](self._draw(brdf, scene))

    def figures(self, brdf: Brdf, differences: Sequence[str] = (DECIDES, ALSO)) -> dict[str, Figures]:
        """How far the pictures of a BRDF are from those of the material.

        Args:
            brdf: In its place.
            differences: Registered names of image differences.

        Returns:
            Figures by scene.
        """
        measures = {name: DIFFERENCES[name]() for name in differences}
        found = {}
        for name, scene in self.scenes.items():
            linear = torch.stack([self._draw(brdf, name), self.linear[name]])
            shown = self.tones[name](linear)
            own = {}
            for key, measure in measures.items():
                pair = linear if measure.linear else shown
                own[key] = float(measure(pair[:1], pair[1:], scene.mask))
            found[name] = Figures(own)
        return found

    @torch.no_grad()
    def _draw(self, brdf: Brdf, name: str) -> Tensor:
        scene, own = self.scenes[name], _material(brdf)
        if own.is_anisotropic:  # of which a scene's compact pairs do not know how the surface is turned
            return render_directly([own], scene)[0]
        return (scene.transport @ values_of(own, scene.pairs))[0]


def values_of(brdf: Brdf, pairs: Pairs) -> Tensor:
    """Values of one material, a fit or a measurement, `(1, N, 3)`, float32.

    Where it has a grain and the pairs do not say how they lie to it, half vectors are along the tangent.
    """
    own = _material(brdf)
    if own.is_anisotropic and not pairs.is_oriented:
        pairs = Pairs.from_directions(pairs.wi, pairs.wo)
    values = own.reciprocal_at(pairs) if isinstance(own, Measured) else own(pairs)
    return values.detach().float().reshape(1, len(pairs), 3)


def _material(brdf: Brdf) -> Lobe | Measured:
    """A measurement in linear RGB, or a model in float32."""
    if isinstance(brdf, Measured):
        brdf.check_rgb("pictures and comparisons")
        return brdf
    return model_of([brdf], torch.float32) if isinstance(brdf, FitRecord) else brdf.to(dtype=torch.float32)


@dataclass(frozen=True)
class Means:
    """Figures of all scenes as one: mean, least and largest Delta E 76."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.1f} ({self.low:.1f} to {self.high:.1f})"

    @classmethod
    def of(cls, figures: Mapping[str, Figures]) -> "Means":
        """Those of some scenes."""
        values = [one.delta_e76 for one in figures.values()]
        return cls(sum(values) / len(values), min(values), max(values))

    @cached_property
    def told(self) -> Share:
        """The share of observers who would know the fit, by the mean."""
        return told(self.mean)
