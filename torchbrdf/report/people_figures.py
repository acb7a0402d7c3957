"""Figures of what people say beside what is measured: gloss, and JOD scores."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchbrdf.measured import PAPER_TEN
from torchbrdf.perception import Appearance, JodScores
from torchbrdf.perception.agreement.appearance import LABELS
from torchbrdf.perception.datasets.ratings import LABELS as ATTRIBUTES
from torchbrdf.report.style import new_figure, plain_ticks

SHOWN = ("glossy", "refsharp", "metallic")
_LOGARITHMIC = ("sharpness", "albedo")
_MODELS = ("#c44e52", "#dd8452", "#4c72b0", "#55a868", "#8172b3", "#937860", "#da8bc3", "#8c8c8c", "#ccb974")


def attribute_label(name: str) -> str:
    """An attribute's name for people."""
    return ATTRIBUTES.get(name, name)


def appearance_figure(path: Path, found: Appearance, mark: str, attributes: Sequence[str] = SHOWN) -> None:
    """A panel for each attribute and quantity: every material, those of the study of 2012 in red."""
    rows = [name for name in attributes if name in found.ratings.attributes] or found.ratings.attributes[:3]
    columns = list(found.measured)
    ten = np.array([name in PAPER_TEN for name in found.materials])
    with new_figure(path, 2.3 * len(columns) + 0.6, 2.1 * len(rows) + 0.5, mark) as figure:
        panels = figure.subplots(len(rows), len(columns), sharex="col", sharey="row", squeeze=False)
        for r, attribute in enumerate(rows):
            a = found.ratings.attributes.index(attribute)
            rating = found.ratings.mean[:, a].numpy()
            for s, name in enumerate(columns):
                panel, values = panels[r, s], found.measured[name].numpy()
                for own, color, size in ((~ten, "#4c72b0", 9), (ten, "#c44e52", 20)):
                    panel.scatter(values[own], rating[own], s=size, color=color, alpha=0.75, linewidths=0)
                ends = f"{float(found.low[s, a]):.2f} to {float(found.high[s, a]):.2f}"
                panel.set_title(f"rank correlation {float(found.correlation[s, a]):.2f} ({ends})", fontsize=7)
                if name in _LOGARITHMIC:
                    panel.set_xscale("log")
                    plain_ticks(panel.xaxis)
                    panel.tick_params(axis="x", which="both", labelsize=6)
                if r == len(rows) - 1:
                    panel.set_xlabel(LABELS[name], fontsize=8)
            panels[r, 0].set_ylabel(f"people: {attribute_label(attribute)}")


def jod_figure(path: Path, scores: JodScores) -> None:
    """The study's colour difference of pictures and its JOD, a point for each approximation."""
    methods = sorted(set(scores.methods))
    with new_figure(path, 6.2, 3.6) as figure:
        panel = figure.subplots()
        for k, method in enumerate(methods):
            own = [row for row, name in enumerate(scores.methods) if name == method]
            color, marker = _MODELS[k % len(_MODELS)], "o^sDv"[k // len(_MODELS) % 5]
            panel.scatter(
                scores.delta_e[own].numpy(), scores.jod[own].numpy(), s=22, color=color, marker=marker,
                alpha=0.85, linewidths=0, label=method,
            )  # fmt: skip
        panel.axhline(10, color="grey", lw=0.8, ls=":")
        panel.set_xlabel("mean colour difference of the study's pictures")
        panel.set_ylabel("JOD; 10: looks the same")
        panel.legend(fontsize=7, ncols=1 + len(methods) // 10)
