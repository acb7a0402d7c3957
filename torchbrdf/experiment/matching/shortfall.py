"""Where a match is not like the measurement, and in what way: parts of pictures, and angles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from torchbrdf.color import luminance
from torchbrdf.experiment.extrapolation import is_extrapolated
from torchbrdf.experiment.matching.judge import Brdf, Judge, values_of
from torchbrdf.images.differences.delta_e76 import lab
from torchbrdf.perception import uniform_pairs

# Seen at more than so many degrees from the normal.
GRAZING = 65.0
# A highlight: brighter than the median by more than so much of what the brightest hundredth is; none where that is not
# so far above, in display values.
HIGHLIGHT, LEAST_CONTRAST = 0.5, 0.1
# Differences of lightness and of colour that are worth a word, and the share of a part that is.
WORTH_SAYING, LARGE_PART = 0.5, 0.25
# Bounds of half angles, in degrees, and how many directions are looked at.
HALF_ANGLES, DIRECTIONS = (0, 5, 15, 30, 60, 90), 6000
OFF = 0.1


@dataclass(frozen=True)
class Part:
    """A part of all pictures, and how the match differs there.

    Args:
        name: Of the part.
        pixels: Its share of all pixels.
        share: Its share of the whole colour difference.
        delta_e76: Mean colour difference.
        lightness: Mean of how much lighter the match is, in L*.
        color: The share of the squared difference that is not lightness.
    """

    name: str
    pixels: float
    share: float
    delta_e76: float
    lightness: float
    color: float


@dataclass(frozen=True)
class Angles:
    """Directions with about the same half angle, and how the match differs there.

    Args:
        low: Least half angle, in degrees.
        high: The largest.
        grazing: Of those directions that are more than 60 degrees from the normal, or of the others.
        ratio: What the match reflects of what the measurement does: red, green, blue.
    """

    low: float
    high: float
    grazing: bool
    ratio: tuple[float, float, float]


def parts(judge: Judge, brdf: Brdf) -> list[Part]:
    """How a BRDF differs from the measurement in highlights, at grazing view and elsewhere, over all scenes."""
    names = ("highlights", "grazing view", "elsewhere")
    pixels: list[list[Tensor]] = [[] for _ in names]
    for scene_name, scene in judge.scenes.items():
        mask = scene.mask
        reference = judge.reference(scene_name)[mask]
        away = lab(judge.picture(brdf, scene_name)[mask]) - lab(reference)
        light = luminance(reference)
        middle, top = light.median(), light.quantile(0.99)
        bright = (light > middle + HIGHLIGHT * (top - middle)) & (top - middle > LEAST_CONTRAST)
        grazing = (scene.view_cosine[mask] < math.cos(math.radians(GRAZING))) & ~bright
        for kept, own in zip(pixels, (bright, grazing, ~(bright | grazing)), strict=True):
            kept.append(away[own])
    together = [torch.cat(own) for own in pixels]
    count = sum(len(own) for own in together)
    total = max(float(sum(own.norm(dim=-1).sum() for own in together)), 1e-12)
    found = []
    for name, own in zip(names, together, strict=True):
        if not len(own):
            continue
        length, square = own.norm(dim=-1), own.square().sum(0)
        color = float(square[1:].sum() / square.sum().clamp_min(1e-12))
        found.append(
            Part(
                name,
                len(own) / count,
                float(length.sum()) / total,
                float(length.mean()),
                float(own[:, 0].mean()),
                color,
            )
        )
    return found


def angles(judge: Judge, brdf: Brdf) -> list[Angles]:
    """What a BRDF reflects of what the measurement does, by half angle and by how far from the normal that is.

    Extrapolated values of the measurement say nothing about the match.
    """
    pairs = uniform_pairs(DIRECTIONS).unsqueeze().to(dtype=torch.float32)
    pairs = pairs.select(samples=(~is_extrapolated(judge.measured, pairs)).nonzero()[:, 0])
    measured, fitted = values_of(judge.measured, pairs)[0], values_of(brdf, pairs)[0]
    cosine = (pairs.cos_i * pairs.cos_o)[0]
    low = (torch.minimum(pairs.cos_i, pairs.cos_o) < 0.5)[0]
    half = torch.rad2deg(pairs.theta_h)[0]
    found = []
    for first, last in pairwise(HALF_ANGLES):
        for grazing in (False, True):
            own = (half >= first) & (half < last) & (low == grazing)
            there = (measured[own] * cosine[own, None]).sum(0)
            if own.sum() < 10 or not bool((there > 0).all()):
                continue
            red, green, blue = ((fitted[own] * cosine[own, None]).sum(0) / there).tolist()
            found.append(Angles(first, last, grazing, (red, green, blue)))
    return found


def in_words(found: Sequence[Part], by_angle: Sequence[Angles]) -> list[str]:
    """Where most of what is left lies, and why, in sentences."""
    sentences = []
    for part in sorted(found, key=lambda one: -one.share):
        if part.share < LARGE_PART or part.delta_e76 < WORTH_SAYING:
            continue
        how = []
        if abs(part.lightness) >= WORTH_SAYING:
            how.append(f"the match is too {'light' if part.lightness > 0 else 'dark'} (L* {part.lightness:+.1f})")
        if part.color > 0.5:
            how.append("its colour is off more than its lightness")
        sentences.append(
            f"{part.name.capitalize()}: {100 * part.share:.0f} % of the difference on {100 * part.pixels:.0f} % of the "
            f"pixels, \u0394E {part.delta_e76:.1f}{'; ' if how else ''}{', '.join(how)}."
        )
    off = sorted(by_angle, key=lambda one: -abs(sum(one.ratio) / 3 - 1))
    for own in off[:2]:
        ratio = sum(own.ratio) / 3
        if abs(ratio - 1) >= OFF:
            sentences.append(
                f"Half angles of {own.low:g} to {own.high:g} degrees, directions "
                f"{'beyond' if own.grazing else 'within'} 60 degrees of the normal: the match reflects "
                f"{100 * abs(ratio - 1):.0f} % {'more' if ratio > 1 else 'less'} than was measured."
            )
    return sentences or ["Nothing stands out."]
