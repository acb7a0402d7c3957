"""The report's figures, drawn with matplotlib."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from torchbrdf.experiment.grid import FitGrid
from torchbrdf.experiment.labels import caveat, difference_label, loss_label, model_label
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import FitRecord, model_of
from torchbrdf.measured import Measured, Plausibility
from torchbrdf.pairs import Pairs
from torchbrdf.report.meaning import mark_shares
from torchbrdf.report.style import COLORS, DPI, new_figure, plain_ticks

INCIDENT = (15.0, 30.0, 45.0, 60.0)
# More names in a legend than these nobody reads.
MOST_LABELS = 24


def gloss_figure(
    path: Path, names: Sequence[str], doi: Sequence[float], contrast: Sequence[float], stand_in: bool
) -> None:
    """Figure 1: distinctness of image and contrast gloss, materials sorted by the first."""
    order = np.argsort(doi)
    with new_figure(path, 9, 0.28 * len(names) + 1.6, caveat(stand_in)) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        rows = np.arange(len(names))
        left.barh(rows, np.asarray(doi)[order], color="#4c72b0")
        left.set(
            xscale="log", xlabel="distinctness of image: degrees off the mirror direction\nat 0.3 of its luminance"
        )
        plain_ticks(left.xaxis)
        left.set_yticks(rows, [names[k] for k in order])
        left.invert_yaxis()
        right.barh(rows, np.asarray(contrast)[order], color="#dd8452")
        right.set_xlabel("contrast gloss: log10 of luminance\nat 30:30 over 45:0")


def grid_figure(path: Path, materials: Sequence[str], rows: Mapping[str, Sequence[Path]], stand_in: bool) -> None:
    """Figure 3: a row of pictures for the reference and for each metric, a column for each material."""
    # Pictures go where they are to be, pixel by pixel: as many panels would take seconds to be laid out.
    side, cell, left = round(1.5 * DPI), 1.55, 0.4
    head = 0.15 + 0.15 * max(1 + name.count("\n") for name in materials) + (0.2 if stand_in else 0)
    width, height = left + cell * len(materials), head + cell * len(rows)
    with new_figure(path, width, height, caveat(stand_in), layout=None) as figure:
        for r, (label, pictures) in enumerate(rows.items()):
            bottom = cell * (len(rows) - 1 - r)
            figure.text(
                left / 2 / width, (bottom + cell / 2) / height, label, rotation=90, ha="center", va="center"
            )  # fmt: skip
            for c, picture in enumerate(pictures):
                with Image.open(picture) as image:
                    small = np.asarray(image.convert("RGB").resize((side, side), Image.Resampling.LANCZOS))
                corner = round(DPI * (left + cell * c)), round(DPI * bottom)
                figure.figimage(small, *corner, origin="upper")
        for c, name in enumerate(materials):
            place = ((left + cell * c + cell / 2) / width, (cell * len(rows) + 0.03) / height)
            figure.text(*place, name, fontsize=8, ha="center", va="bottom")


def profile_figure(path: Path, group: Measured, records: Sequence[FitRecord]) -> None:
    """Figure 4's plots for one material and model: cube roots of the BRDF in the plane of incidence, green channel.

    One panel for each incident angle against the outgoing angle, and one that magnifies the lobe at 30 degrees: the
    angle off the mirror direction on a logarithmic scale.
    """
    material = group.batch([group.names.index(records[0].material)])
    model = model_of(list(records), torch.float32)
    with new_figure(path, 11, 2.6, caveat(group.stand_in), layout=None) as figure:
        # Laid out by hand: a layout that is constrained draws everything twice, and there are many of these.
        margins = {"left": 0.05, "right": 0.985, "bottom": 0.19, "top": 0.82 if group.stand_in else 0.89}
        panels = figure.subplots(1, len(INCIDENT) + 1, gridspec_kw={**margins, "wspace": 0.22})
        for panel, incident in zip(panels, INCIDENT, strict=False):
            off = np.concatenate([-np.geomspace(150, 0.02, 150), np.geomspace(0.02, 80, 100)])
            outgoing = incident + off
            outgoing = outgoing[np.abs(outgoing) < 85]
            _curves(panel, material, model, records, incident, outgoing, outgoing)
            panel.set(title=f"light at {incident:.0f}°", xlabel="viewer, degrees")
            panel.axvline(incident, color="grey", lw=0.5, ls=":")
        off = np.geomspace(0.05, 90, 200)
        _curves(panels[-1], material, model, records, 30.0, 30.0 - off, off)
        panels[-1].set(title="light at 30°, magnified", xlabel="degrees off the mirror", xscale="log")
        plain_ticks(panels[-1].xaxis)
        panels[0].set_ylabel("cube root of f (green)")
        panels[-1].legend(fontsize=7, frameon=False)


def albedo_figure(path: Path, found: Sequence[Plausibility]) -> None:
    """Albedo of each material over the angle of the light, the channel that reflects most; above 1 is no surface."""
    labelled = len(found) <= MOST_LABELS
    columns = 1 + (len(found) - 1) // 12 if labelled else 0
    widest = max(len(one.name) for one in found) if labelled else 0
    with new_figure(path, 7 + columns * (0.5 + 0.055 * widest), 4) as figure:
        panel = figure.subplots()
        for one in found:
            panel.plot(one.angles, [max(row) for row in one.albedo], "o-", ms=3, lw=1, label=one.name)
        panel.axhspan(1, 1e9, color="#c44e52", alpha=0.12, lw=0)
        highest = max(one.largest_albedo[0] for one in found)
        panel.set(xlabel="light, degrees from the normal", ylabel="albedo, brightest channel", xlim=(0, 90))
        panel.set_ylim(0, max(1.05, 1.05 * highest))
        panel.axhline(1, color="grey", lw=0.8)
        if labelled:
            panel.legend(frameon=False, fontsize=7, ncols=columns, loc="upper left", bbox_to_anchor=(1, 1))


def quality_figure(
    path: Path, order: Sequence[str], records: Sequence[FitRecord], models: Sequence[str], losses: Iterable[str],
    difference: str, stand_in: bool,
) -> None:  # fmt: skip
    """An image difference of every fit, one panel a model, materials by rising DoI; outliers in a black rectangle."""
    kind = DIFFERENCES[difference]
    with new_figure(path, 4.2 * len(models), 3.6, caveat(stand_in)) as figure:
        panels = np.atleast_1d(figure.subplots(1, len(models), sharey=True))
        for panel, model in zip(panels, models, strict=True):
            for loss in losses:
                own = {r.material: r for r in records if r.model == model and r.loss == loss}
                values = [own[name].differences[difference] for name in order]
                panel.plot(range(len(order)), values, "o-", ms=4, lw=1, color=COLORS.get(loss), label=loss_label(loss))
                for k, name in enumerate(order):
                    if own[name].outlier:
                        panel.plot(k, values[k], "s", ms=10, mfc="none", mec="black")
            panel.set_title(model_label(model))
            panel.set_xticks(range(len(order)), order, rotation=60, ha="right")
        better = "higher" if kind.higher_is_better else "lower"
        panels[0].set_ylabel(
            f"{difference_label(difference)}{' in ' + kind.unit if kind.unit else ''} ({better} is better)"
        )
        panels[-1].legend(frameon=False)
        mark_shares(panels[-1], difference, "y")


def strategies_figure(path: Path, grid: FitGrid, ratio: np.ndarray, gain: np.ndarray) -> None:
    """How many fits of each model either strategy leaves stuck, and what lower errors do for the pictures."""
    ours = grid.by_strategy(grid.strategy)
    with new_figure(path, 10, 3.6, caveat(grid.stand_in)) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.5))
        height = 0.38
        for k, strategy in enumerate(reversed(grid.strategies)):
            records = grid.by_strategy(strategy)
            counts = [sum(bool(r.outlier) for r in records if r.model == model) for model in grid.models]
            place = np.arange(len(counts)) + (k - 0.5) * height
            bars = left.barh(place, counts, height, label=strategy, color=("#c44e52", "#4c72b0")[k])
            left.bar_label(bars, padding=3)
        left.set_yticks(range(len(grid.models)), [model_label(model) for model in grid.models])
        left.invert_yaxis()
        left.margins(x=0.12)
        left.xaxis.get_major_locator().set_params(integer=True)
        left.set_xlabel(f"fits stuck in a local minimum, of {len(ours) // len(grid.models)} a model")
        left.legend(frameon=False)
        for loss in grid.losses:
            chosen = np.array([record.loss == loss for record in ours])
            right.plot(
                ratio[chosen], gain[chosen], "o", ms=5, alpha=0.8, color=COLORS.get(loss), label=loss_label(loss)
            )
        right.axhline(0, color="grey", lw=0.8)
        right.axvline(1, color="grey", lw=0.8)
        right.set(
            xscale="log", xlabel=f"error, {grid.compare_strategy} over {grid.strategy}",
            ylabel=f"Delta E, {grid.compare_strategy} less {grid.strategy}\n(above 0: {grid.strategy} looks closer)",
        )  # fmt: skip
        right.xaxis.set_minor_formatter("{x:g}")
        right.xaxis.set_major_formatter("{x:g}")
        right.tick_params(axis="x", which="minor", labelsize=7)
        right.legend(frameon=False)


def bars_figure(
    path: Path, means: Mapping[str, Mapping[str, Sequence[float]]], rendered: Sequence[str], stand_in: bool
) -> None:
    """Colour differences of the fits under each loss, a panel a scene; `means[scene][loss]`, one number a fit."""
    with new_figure(path, 5.2 * len(means), 0.32 * len(next(iter(means.values()))) + 1.2, caveat(stand_in)) as figure:
        panels = np.atleast_1d(figure.subplots(1, len(means), sharey=True))
        for panel, (scene, losses) in zip(panels, means.items(), strict=True):
            for row, (loss, values) in enumerate(losses.items()):
                low, high = np.quantile(values, [0.25, 0.75])
                panel.barh(row, np.mean(values), color="#dd8452" if loss in rendered else "#4c72b0")
                panel.plot([low, high], [row, row], color="black", lw=1)
                panel.text(np.mean(values), row - 0.28, f" {np.mean(values):.2f}", va="center", fontsize=7)
            panel.set_yticks(range(len(losses)), [loss_label(loss) for loss in losses])
            panel.set(xlabel="mean Delta E of the fits to their references", title=f"{scene} scene")
        panels[0].invert_yaxis()
        for panel in panels:
            mark_shares(panel, "delta_e76", "x")


def _curves(
    panel: Any, material: Measured, model: Any, records: Sequence[FitRecord], incident: float,
    outgoing: np.ndarray, x: np.ndarray,
) -> None:  # fmt: skip
    """Cube roots of the green channel, measured and fitted, with the mirror direction at +incident."""
    pairs = in_plane(incident, outgoing)
    with torch.no_grad():
        fitted = model(pairs.to(dtype=torch.float32))
    panel.plot(x, np.cbrt(material.at(pairs)[0, :, 1].clamp_min(0).numpy()), color="black", lw=1.6, label="measured")
    for record, values in zip(records, fitted, strict=True):
        loss = record.loss
        panel.plot(x, np.cbrt(values[:, 1].numpy()), lw=1, color=COLORS.get(loss), label=loss_label(loss))


def in_plane(incident: float, outgoing: np.ndarray) -> Pairs:
    """Pairs in the plane of incidence, angles in degrees; the mirror direction is outgoing = incident. `(1, N)`."""
    light, viewer = math.radians(incident), torch.from_numpy(np.radians(outgoing))
    wi = torch.tensor([-math.sin(light), 0.0, math.cos(light)], dtype=torch.float64, device="cpu").expand(
        1, len(outgoing), 3
    )
    wo = torch.stack([viewer.sin(), torch.zeros_like(viewer), viewer.cos()], -1)[None]
    return Pairs.from_directions(wi, wo)
