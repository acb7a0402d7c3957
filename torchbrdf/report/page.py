"""report.html: one self-contained page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchbrdf.files import write_text
from torchbrdf.report import numbers
from torchbrdf.report.asked import Asked
from torchbrdf.report.drawing import marked
from torchbrdf.report.figures import gloss_figure, grid_figure, profile_figure, quality_figure
from torchbrdf.report.inline import png, small, template
from torchbrdf.report.judged import judge
from torchbrdf.report.labels import Cell, difference_label, loss_label, model_label
from torchbrdf.report.observers import observed, tables
from torchbrdf.report.strategies import compared
from torchbrdf.report.study import DIFFERENCE, SHOWN_DIFFERENCES, Study, picture

# The paper's Figure 4 shows this material; its profile is unfolded.
UNFOLDED = "alum-bronze"


def write_report(study: Study, title: str, light: str, turn: float, problems: Sequence[str], asked: Asked) -> Path:
    """Draw the figures and write `report.html` for a study that is fitted, drawn and judged; gives its path."""
    folder = study.folder.path
    order = list(study.gloss)
    stand_in = study.stand_in

    figures = folder / "figures"
    beside = compared(study)
    doi, contrast = zip(*study.gloss.values(), strict=True)
    gloss_figure(figures / "gloss.png", order, doi, contrast, stand_in)
    quality_figure(figures / "delta_e.png", order, study.shown, study.models, study.losses, DIFFERENCE, stand_in)
    for model in study.models:
        lines = {"reference": [study.png(picture(name)) for name in order]}
        lines |= {loss_label(loss): [study.png(picture(name, model, loss)) for name in order] for loss in study.losses}
        grid_figure(figures / f"fits-{model}.png", order, lines, stand_in)
    advance = study.folder.progress("figures", len(order) * len(study.models))
    unfolded = UNFOLDED if UNFOLDED in order else order[0]
    rows: dict[str, list[dict[str, Any]]] = {model: [] for model in study.models}
    for name in order:
        group = next(group for group in study.groups if name in group.names)
        same = {
            "material": name,
            "reference": small(study.png(picture(name))),
            "turned": small(study.png(picture(name, "turned"))),
            "open": name == unfolded,
        }
        for model in study.models:
            path = figures / f"profile-{name}-{model}.png"
            profile_figure(path, group, [study.record(name, model, loss) for loss in study.losses])
            rows[model].append(same | {"fits": _fits(study, name, model), "profile": png(path)})
            advance(1)
    judged = judge(asked.answers, asked.plan, seed=study.seed)
    page = template("page.html").render(
        title=title,
        materials=order,
        models=[{"label": model_label(model), "rows": rows[model]} for model in study.models],
        losses=[{"label": loss_label(loss)} for loss in study.losses],
        columns=len(study.losses) + 2,
        lobes=study.lobes[0],
        strategy=study.strategy,
        diffuse=study.diffuse,
        max_theta=f"{study.max_theta:g}",
        samples=f"first a stratified subset of {study.samples}, then all" if study.samples else "all of them",
        stand_in=stand_in,
        problems=problems,
        findings=findings(study, order) + (beside["findings"] if beside else []),
        beside=beside
        and {
            "label": study.beside,
            "figure": png(beside["figure"]),
            "pictures": beside["pictures"] and png(beside["pictures"]),
        },
        observed=[observed(one, figures, marked(stand_in, asked.mark)) for one in judged],
        gloss=png(figures / "gloss.png"),
        quality=png(figures / "delta_e.png"),
        tables=[
            *([beside["table"]] if beside else []),
            *_error_tables(study, order),
            _difference_table(study, order),
            _agreement_table(study),
            *_lobes_table(study),
            *(table for one in judged for table in tables(one)),
        ],
        tone=study.tone,
        light=light,
        turn=f"{turn:g}",
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )
    path = folder / "report.html"
    write_text(path, page)
    return path


def findings(study: Study, order: Sequence[str]) -> list[str]:
    """What the numbers say, in sentences. Sharp are the half of the materials with the smaller DoI."""
    shown = study.shown
    sharp = set(order[: (len(order) + 1) // 2])
    lines = []
    for label, part in (
        ("sharper", [r for r in shown if r["material"] in sharp]),
        ("broader", [r for r in shown if r["material"] not in sharp]),
    ):
        if part:
            counts = numbers.best_counts(part, study.losses, DIFFERENCE)
            total = sum(counts.values())
            said = ", ".join(f"{loss_label(loss)} {counts[loss]}" for loss in study.losses)
            means = ", ".join(
                f"{loss_label(x)} {numbers.mean_difference(part, x, DIFFERENCE):.2f}" for x in study.losses
            )
            lines.append(
                f"Of the {total} fits of a material and a model among the {label} half, the picture with the smallest "
                f"ΔE came from: {said}. Mean ΔE: {means}."
            )
    stuck = sum(r["outlier"] for r in shown)
    by_model = ", ".join(
        f"{model_label(model)} {sum(numbers.outlier_count(shown, model, loss) for loss in study.losses)}"
        for model in study.models
    )
    lines.append(f"{stuck} of {len(shown)} fits are stuck in a local minimum by the paper's test ({by_model}).")
    odd = [r for r in shown if r["status"] != "converged"]
    if odd:
        lines.append(
            f"{len(odd)} fits did not converge: "
            + ", ".join(
                f"{r['material']} {model_label(r['model'])} {loss_label(r['loss'])} ({r['status']})" for r in odd[:8]
            )
            + (", ..." if len(odd) > 8 else ".")
        )
    return lines


def _fits(study: Study, material: str, model: str) -> list[dict[str, Any]]:
    """The pictures of a material's fits with one model."""
    return [
        {
            "loss": loss,
            "image": small(study.png(picture(material, model, loss))),
            "outlier": record["outlier"],
            "delta_e": record["differences"][DIFFERENCE],
        }
        for loss in study.losses
        for record in [study.record(material, model, loss)]
    ]


def _error_tables(study: Study, order: Sequence[str]) -> list[dict[str, Any]]:
    """Every error under every metric."""
    tables = []
    for model in study.models:
        head = ["material", *(f"{loss_label(m)}: {loss_label(f)}" for m in study.losses for f in study.losses)]
        rows = []
        for name in order:
            cells = [Cell(name)]
            for metric in study.losses:
                own = {loss: study.record(name, model, loss) for loss in study.losses}
                least = min(own.values(), key=lambda record: record["errors"][metric])
                cells += [
                    Cell(f"{own[f]['errors'][metric]:.4g}", own[f] is least, f == metric and own[f]["outlier"])
                    for f in study.losses
                ]
            rows.append(cells)
        note = (
            "metric: fit. Three columns for each metric, its error for the fits under each. Bold: the least. It should "
            "be that of the metric's own fit; where it is not, that fit is an outlier and framed."
        )
        tables.append({"title": f"Errors, {model_label(model)}", "note": note, "head": head, "rows": rows})
    return tables


def _difference_table(study: Study, order: Sequence[str]) -> dict[str, Any]:
    """Image differences of each fit."""
    head = [
        "material",
        "model",
        *(f"{difference_label(d)}, {loss_label(x)}" for d in SHOWN_DIFFERENCES for x in study.losses),
    ]
    rows = []
    for name in order:
        for model in study.models:
            cells = [Cell(name), Cell(model_label(model))]
            for difference in SHOWN_DIFFERENCES:
                own = [study.record(name, model, loss) for loss in study.losses]
                best = min(numbers.badness(record, difference) for record in own)
                cells += [
                    Cell(f"{record['differences'][difference]:.3f}", numbers.badness(record, difference) == best)
                    for record in own
                ]
            rows.append(cells)
    note = "Between the picture of each fit and the reference in the same view, over the object. Bold: the best."
    return {"title": "Image differences", "note": note, "head": head, "rows": rows}


def _agreement_table(study: Study) -> dict[str, Any]:
    """Do the metrics order fits as the image differences do?"""
    shown = study.shown
    rows = []
    for metric in study.losses:
        values = [numbers.agreement(shown, metric, difference) for difference in SHOWN_DIFFERENCES]
        counts = [numbers.best_counts(shown, study.losses, difference)[metric] for difference in SHOWN_DIFFERENCES]
        rows.append([Cell(loss_label(metric)), *(Cell(f"{v:.2f}") for v in values), *(Cell(str(c)) for c in counts)])
    head = ["metric", *(f"agreement with {difference_label(d)}" for d in SHOWN_DIFFERENCES)]
    head += [f"best by {difference_label(d)}" for d in SHOWN_DIFFERENCES]
    note = (
        "Agreement: Spearman's rank correlation between the metric's error and the image difference over all fits of a "
        "material, averaged over materials; 1 means always the same order. Best: for how many materials and models the "
        "fit under this metric has the best picture."
    )
    return {"title": "Which metric agrees with the pictures", "note": note, "head": head, "rows": rows}


def _lobes_table(study: Study) -> list[dict[str, Any]]:
    """One lobe beside two, where both were fitted."""
    if len(study.lobes) < 2:
        return []
    few, many = study.lobes[:2]
    rows = []
    for model in study.models:
        cells = [Cell(model_label(model))]
        for loss in study.losses:
            ratios = [
                study.record(name, model, loss, few)["error"] / study.record(name, model, loss, many)["error"]
                for name in study.materials
            ]
            cells.append(Cell(f"{sum(ratios) / len(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"))
        rows.append(cells)
    note = f"Error with {few} lobe divided by the error with {many}, mean and range over the materials."
    return [
        {
            "title": f"{few} lobe or {many}",
            "note": note,
            "head": ["model", *map(loss_label, study.losses)],
            "rows": rows,
        }
    ]
