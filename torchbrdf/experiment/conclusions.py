"""Conclusions from scales: the paper's claims about its observers, tested on answers, and who is confused with whom."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchbrdf.experiment.labels import loss_label, model_label
from torchbrdf.psychophysics import Scales
from torchbrdf.study import MEASURED, Plan

CLAIMED_LOSS = "cube_root"
OTHER_LOSSES = ("rms", "cosine_rms")


@dataclass(frozen=True)
class Benefit:
    """How much higher one stimulus stands on a material's scale than another, with its 95 % interval."""

    material: str
    model: str
    value: float
    low: float
    high: float


def benefits(scales: Scales, plan: Plan, loss: str, other: str) -> list[Benefit]:
    """Of the fits under one metric over those under another, for each material and model that has both."""
    found = []
    for m, (name, names) in enumerate(zip(scales.materials, scales.stimuli, strict=True)):
        places: dict[str, dict[str, int]] = {}
        for k, stimulus in enumerate(names):
            what = plan.material(name).stimuli[stimulus]
            if what.model is not None and what.loss is not None:
                places.setdefault(what.model, {})[what.loss] = k
        for model, by_loss in places.items():
            if loss in by_loss and other in by_loss:
                found.append(Benefit(name, model, *scales.difference(m, by_loss[loss], by_loss[other])))
    return sorted(found, key=lambda one: plan.material(one.material).order)


def check_claims(scales: Scales, plan: Plan) -> list[str]:
    """What the scales say of the paper's claim, in sentences; none where the answers are not about it.

    The claim: the cube root looks at least as close as the other metrics, and more so for sharp lobes.
    """
    lines = []
    for other in OTHER_LOSSES:
        found = benefits(scales, plan, CLAIMED_LOSS, other)
        if found:
            lines.append(_overall(found, other))
            lines.append(_by_gloss(found, plan, other))
    return [line for line in lines if line]


def _overall(found: Sequence[Benefit], other: str) -> str:
    better = sum(one.low > 0 for one in found)
    worse = sum(one.high < 0 for one in found)
    mean = np.mean([one.value for one in found])
    holds = "holds everywhere" if not worse else f"does not hold for {worse} of them"
    exceptions = ", ".join(f"{one.material} {model_label(one.model)}" for one in found if one.high < 0)
    return (
        f"Is the {loss_label(CLAIMED_LOSS)} at least as good as {loss_label(other)}? Of {len(found)} materials and "
        f"models it is better for {better}, worse for {worse}, and no different for {len(found) - better - worse}; on "
        f"average {mean:+.2f} on the scale. The paper's claim {holds}{f' ({exceptions})' if exceptions else ''}."
    )


def _by_gloss(found: Sequence[Benefit], plan: Plan, other: str) -> str:
    """Whether the benefit falls as lobes broaden."""
    materials = sorted({one.material for one in found}, key=lambda name: plan.material(name).order)
    if len(materials) < 4:
        return ""
    means = [np.mean([one.value for one in found if one.material == name]) for name in materials]
    angles = [plan.material(name).order for name in materials]
    if np.ptp(angles) == 0:
        return ""
    from scipy.stats import spearmanr  # which takes longer to import than a quick run to fit

    result = spearmanr(angles, means, alternative="less")
    supported = "supported" if result.pvalue < 0.05 else "not supported"
    half = (len(materials) + 1) // 2
    sharp, broad = np.mean(means[:half]), np.mean(means[half:])
    return (
        f"Is its benefit over {loss_label(other)} larger for sharp lobes? The mean benefit is {sharp:+.2f} for the "
        f"sharper half of the materials and {broad:+.2f} for the broader; its rank correlation with the DoI angle is "
        f"{result.statistic:.2f} (one-sided p = {result.pvalue:.2g}): {supported} by these answers."
    )


def confusions(scales: Scales, material: int) -> set[str]:
    """The stimuli that observers do not tell from the measured material.

    The 95 % interval of how much higher the measured one stands holds 0, or all of it is below.
    """
    names = scales.stimuli[material]
    if MEASURED not in names:
        return set()
    measured = names.index(MEASURED)
    return {name for k, name in enumerate(names) if k != measured and scales.difference(material, measured, k)[1] <= 0}


def confused(scales: Scales) -> dict[str, set[str]]:
    """`confusions` of every material."""
    return {name: confusions(scales, m) for m, name in enumerate(scales.materials)}


def mean_scales(scales: Scales) -> dict[str, float]:
    """The mean scale value of every stimulus over the materials that have it."""
    found: dict[str, list[float]] = {}
    for names, values in zip(scales.stimuli, scales.value, strict=True):
        for name, value in zip(names, values.tolist(), strict=False):
            found.setdefault(name, []).append(value)
    return {
        name: float(torch.tensor(values, dtype=torch.float64, device="cpu").mean()) for name, values in found.items()
    }
