"""report.html of analytic metrics beside rendered-image loss."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.files import write_text
from torchbrdf.images import DIFFERENCES
from torchbrdf.losses import ImageLoss
from torchbrdf.report import numbers
from torchbrdf.report.figures import bars_figure, grid_figure
from torchbrdf.report.gallery import BRIGHTEST, Gallery
from torchbrdf.report.inline import png, small, template
from torchbrdf.report.labels import Cell, difference_label, loss_label, model_label
from torchbrdf.report.study import Study, picture

TITLE = "Which metric stands in for looking at pictures?"
DELTA_E = "delta_e"


def write_images_report(gallery: Gallery, scenes: Mapping[str, str], used: str, problems: Sequence[str]) -> Path:
    """Write `report.html` for a study whose fits and pictures are done; gives its path.

    scenes: of each scene what it is, in words, the training scene first. used: what rendered losses saw, in words.
    """
    study, folder = gallery.study, gallery.study.folder.path
    training, unseen = scenes
    rendered = [name for name, loss in study.losses.items() if isinstance(loss, ImageLoss)]
    analytic = [name for name in study.losses if name not in rendered]
    figure = folder / "figures" / "losses.png"
    means = {scene: {x: _values(gallery.seen(scene), x) for x in study.losses} for scene in scenes}
    stand_in = study.stand_in
    bars_figure(figure, means, rendered, stand_in)
    for scene in scenes:
        for model in study.models:
            _grid(gallery, scene, model, stand_in)
    page = template("images.html").render(
        title=TITLE,
        study=study,
        stand_in=stand_in,
        problems=problems,
        findings=findings(gallery, training, unseen, analytic, rendered),
        brightest=f"{BRIGHTEST:g}",
        blocks=[_block(gallery, scene, model, scenes) for scene in (unseen, training) for model in study.models],
        figure=png(figure),
        tables=[
            *(_judged(gallery, scene, scenes[scene]) for scene in (unseen, training)),
            *(_stands_in(gallery, scene, analytic + rendered) for scene in (unseen, training)),
            _own_errors(study),
            _costs(study),
        ],
        scenes={"training": scenes[training], "unseen": scenes[unseen]},
        used=used,
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )
    path = folder / "report.html"
    write_text(path, page)
    return path


def findings(gallery: Gallery, training: str, unseen: str, analytic: list[str], rendered: list[str]) -> list[str]:
    """What the numbers say, in sentences."""
    study = gallery.study
    seen = gallery.seen(unseen)
    agree = {
        metric: np.mean([numbers.agreement(seen, metric, difference) for difference in gallery.differences])
        for metric in analytic
    }
    order = sorted(analytic, key=lambda metric: -agree[metric])
    lines = [
        "The analytic metric that stands in best for looking at pictures: "
        f"{loss_label(order[0])}. It ranks the fits of a material as the image differences of the unseen scene do with "
        f"a mean correlation of {agree[order[0]]:.2f}; "
        + ", ".join(f"{loss_label(metric)} {agree[metric]:.2f}" for metric in order[1:])
        + "."
    ]
    for scene in (unseen, training):
        mean = {x: float(np.mean(_values(gallery.seen(scene), x))) for x in study.losses}
        best, bought = (min(part, key=lambda x: mean[x]) for part in (analytic, rendered))
        lines.append(
            f"In the {scene} scene the fits under {loss_label(best)} look best of those under analytic metrics (mean "
            f"ΔE {mean[best]:.2f}), those under {loss_label(bought)} best of the rendered ones ({mean[bought]:.2f})."
        )
    for loss in rendered:
        ours = _by_fit(seen, loss)
        rivals = {key: min(_by_fit(seen, x)[key] for x in analytic) for key in ours}
        count = sum(ours[key] <= rivals[key] for key in ours)
        lines.append(
            f"{loss_label(loss)}: in the unseen scene no farther from the reference than the best of all "
            f"{len(analytic)} analytic metrics in {count} of {len(ours)} fits. A fit took "
            f"{_seconds(study, loss):.1f} s; analytic ones {min(_seconds(study, x) for x in analytic):.2f} to "
            f"{max(_seconds(study, x) for x in analytic):.2f} s."
        )
    return lines


def _values(records: numbers.Records, loss: str) -> list[float]:
    return [record["differences"][DELTA_E] for record in records if record["loss"] == loss]


def _by_fit(records: numbers.Records, loss: str) -> dict[tuple[str, str], float]:
    return {(r["material"], r["model"]): r["differences"][DELTA_E] for r in records if r["loss"] == loss}


def _seconds(study: Study, loss: str) -> float:
    return float(np.mean([record["seconds"] for record in study.shown if record["loss"] == loss]))


def _block(gallery: Gallery, scene: str, model: str, scenes: Mapping[str, str]) -> dict[str, Any]:
    """The pictures of one model's fits in one scene."""
    study = gallery.study
    rows = []
    for material in study.materials:
        fits = []
        for loss in study.losses:
            record = study.record(material, model, loss)
            name = study.picture(record)
            fits.append(
                {
                    "loss": loss_label(loss),
                    "image": small(gallery.path(scene, name)),
                    "map": small(gallery.path(scene, f"map-{name}")),
                    "delta_e": record["pictures"][scene][DELTA_E],
                }
            )
        rows.append({"material": material, "reference": small(gallery.path(scene, picture(material))), "fits": fits})
    label = f"{model_label(model)}, {scene} scene ({scenes[scene]})"
    return {"label": label, "losses": [loss_label(loss) for loss in study.losses], "rows": rows}


def _grid(gallery: Gallery, scene: str, model: str, stand_in: bool) -> None:
    """The pictures of one model's fits in one scene as a figure."""
    study = gallery.study
    lines = {"reference": [gallery.path(scene, picture(material)) for material in study.materials]}
    for loss in study.losses:
        records = [study.record(material, model, loss) for material in study.materials]
        lines[loss_label(loss)] = [gallery.path(scene, study.picture(record)) for record in records]
    path = study.folder.path / "figures" / f"{scene}-{model}.png"
    grid_figure(path, study.materials, lines, stand_in)


def _judged(gallery: Gallery, scene: str, words: str) -> dict[str, Any]:
    """Mean image differences of the fits under each loss."""
    study, seen = gallery.study, gallery.seen(scene)
    rows = []
    columns = {}
    for difference in gallery.differences:
        kind = DIFFERENCES[difference]
        mean = {x: numbers.mean_difference(seen, x, difference) for x in study.losses}
        columns[difference] = mean, (max if kind.higher_is_better else min)(mean.values())
    for loss in study.losses:
        cells = [Cell(loss_label(loss))]
        cells += [Cell(f"{mean[loss]:.3f}", mean[loss] == best) for mean, best in columns.values()]
        rows.append(cells)
    head = ["fits under", *(difference_label(difference) for difference in gallery.differences)]
    note = f"Means over all materials and models, in the {scene} scene ({words}). Bold: the best."
    return {"title": f"Fits judged by pictures: {scene} scene", "note": note, "head": head, "rows": rows}


def _stands_in(gallery: Gallery, scene: str, metrics: list[str]) -> dict[str, Any]:
    """How each metric ranks fits, beside how image differences do."""
    seen = gallery.seen(scene)
    rows = []
    for metric in metrics:
        values = [numbers.agreement(seen, metric, difference) for difference in gallery.differences]
        rows.append([Cell(loss_label(metric)), *(Cell(f"{value:.2f}") for value in [*values, float(np.mean(values))])])
    head = ["metric", *(difference_label(difference) for difference in gallery.differences), "mean"]
    note = (
        "Spearman's rank correlation between a metric's error and an image difference over all fits of a material "
        f"(every model and loss), averaged over materials, in the {scene} scene; 1: always in the same order."
    )
    return {"title": f"Which metric stands in for pictures: {scene} scene", "note": note, "head": head, "rows": rows}


def _own_errors(study: Study) -> dict[str, Any]:
    """Every error under every loss, relative to the least."""
    rows = []
    for loss in study.losses:
        ratios = []
        for metric in study.losses:
            own = {(r["material"], r["model"]): r["errors"][metric] for r in study.shown if r["loss"] == metric}
            theirs = [(r, own[r["material"], r["model"]]) for r in study.shown if r["loss"] == loss]
            ratios.append(float(np.median([r["errors"][metric] / least if least else 1.0 for r, least in theirs])))
        rows.append([Cell(loss_label(loss)), *(Cell(f"{ratio:.2f}") for ratio in ratios)])
    note = (
        "The error of the fits under the loss of a row, measured by the loss of a column, over that of the column's "
        "own fits; the median over materials and models."
    )
    head = ["fits under", *(loss_label(loss) for loss in study.losses)]
    return {"title": "Errors across losses", "note": note, "head": head, "rows": rows}


def _costs(study: Study) -> dict[str, Any]:
    """Seconds a fit."""
    rows = []
    for loss in study.losses:
        cells = [Cell(loss_label(loss))]
        for model in study.models:
            own = [r for r in study.shown if r["loss"] == loss and r["model"] == model]
            cells.append(Cell(f"{np.mean([r['seconds'] for r in own]):.2f}"))
        odd = sum(r["status"] != "converged" for r in study.shown if r["loss"] == loss)
        rows.append([*cells, Cell(str(odd))])
    head = ["loss", *(f"{model_label(model)}, s" for model in study.models), "not converged"]
    note = "Seconds a fit, on this machine, with all materials fitted side by side."
    return {"title": "Cost", "note": note, "head": head, "rows": rows}
