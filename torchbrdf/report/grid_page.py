"""report.html of a grid of fits: pictures, profiles, what observers say, and tables, in one self-contained page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchbrdf.experiment import statistics
from torchbrdf.experiment.grid import FitGrid, picture_name
from torchbrdf.experiment.labels import caveat, difference_label, diffuse_label, loss_label, model_label
from torchbrdf.experiment.pictures import DIFFERENCE, ONLY, SHOWN_DIFFERENCES, Pictures
from torchbrdf.experiment.plan import Responses
from torchbrdf.experiment.scaling import scale_experiments
from torchbrdf.files import write_text
from torchbrdf.lobes import FitRecord
from torchbrdf.names import file_stem
from torchbrdf.perception.discrimination.words import MEANING, brief
from torchbrdf.report.embed import embed_png, embed_webp, template
from torchbrdf.report.figures import gloss_figure, grid_figure, profile_figure, quality_figure
from torchbrdf.report.meaning import scales
from torchbrdf.report.observers import observed, observer_tables
from torchbrdf.report.strategies import compare_strategies
from torchbrdf.report.tables import Column, Table, table

# The paper's Figure 4 shows this material; its profile is unfolded.
UNFOLDED = "alum-bronze"


def write_grid_report(
    pictures: Pictures, title: str, light: str, turn: float, problems: Sequence[str], responses: Responses
) -> Path:
    """Draw the figures and write `report.html` of a grid that is fitted and drawn.

    Args:
        pictures: Of the grid, in one scene.
        title: Of the page.
        light: What lights the scene, a sentence.
        turn: Degrees between the reference's view and the fits' for observers.
        problems: What was left out.
        responses: Of simulated observers.

    Returns:
        The path of the page.
    """
    grid, folder = pictures.grid, pictures.grid.folder.path
    order, stand_in, figures = list(grid.gloss), grid.stand_in, folder / "figures"
    compared = compare_strategies(pictures)
    doi, contrast = zip(*grid.gloss.values(), strict=True)
    gloss_figure(figures / "gloss.png", order, doi, contrast, stand_in)
    quality_figure(figures / "delta_e76.png", order, grid.shown, grid.models, grid.losses, DIFFERENCE, stand_in)
    for model in grid.models:
        lines = {"reference": [pictures.path(picture_name(name)) for name in order]}
        for loss in grid.losses:
            lines[loss_label(loss)] = [pictures.path(picture_name(name, model, loss)) for name in order]
        grid_figure(figures / f"fits-{model}.png", order, lines, stand_in)
    rows = _rows(pictures, order, figures)
    scaled = scale_experiments(responses.answers, responses.plan, seed=grid.seed)
    page = template("grid.html").render(
        title=title,
        materials=order,
        models=[{"label": model_label(model), "rows": rows[model]} for model in grid.models],
        losses=[{"label": loss_label(loss)} for loss in grid.losses],
        columns=len(grid.losses) + 2,
        lobes=grid.lobes[0],
        strategy=grid.strategy,
        diffuse=diffuse_label(grid.diffuse),
        max_theta=f"{grid.max_theta:g}",
        samples=_seen(grid.samples),
        stand_in=stand_in,
        problems=problems,
        findings=findings(grid, order) + (compared.findings if compared else []),
        compared=compared
        and {
            "label": grid.compare_strategy,
            "figure": embed_png(compared.figure),
            "pictures": compared.pictures and embed_png(compared.pictures),
        },
        observed=[observed(one, figures, caveat(stand_in, responses.caveat)) for one in scaled],
        gloss=embed_png(figures / "gloss.png"),
        scales=scales(SHOWN_DIFFERENCES),
        meaning=MEANING,
        quality=embed_png(figures / "delta_e76.png"),
        tables=[
            *([compared.table] if compared else []),
            *(_error_table(grid, model, order) for model in grid.models),
            _difference_table(grid, order),
            _agreement_table(grid),
            *([_lobes_table(grid)] if len(grid.lobes) > 1 else []),
            *(table for one in scaled for table in observer_tables(one)),
        ],
        tone=pictures.tones[ONLY],
        light=light,
        turn=f"{turn:g}",
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )
    path = folder / "report.html"
    write_text(path, page)
    return path


def _seen(samples: int | None) -> str:
    """What solvers saw of the pairs."""
    if samples is None:
        return "all of them"
    return f"first a stratified subset of {samples}, then all; all at once where sums of them are enough"


def _rows(pictures: Pictures, order: Sequence[str], figures: Path) -> dict[str, list[dict[str, Any]]]:
    """For each model a row of pictures for each material, with the figure of its profiles."""
    grid = pictures.grid
    progress, total = grid.folder.progress("figures"), len(order) * len(grid.models)
    unfolded = UNFOLDED if UNFOLDED in order else order[0]
    rows: dict[str, list[dict[str, Any]]] = {model: [] for model in grid.models}
    for m, name in enumerate(order):
        group = next(group for group in grid.groups if name in group.names)
        same = {
            "material": name,
            "reference": embed_webp(pictures.path(picture_name(name))),
            "turned": embed_webp(pictures.path(picture_name(name, "turned"))),
            "open": name == unfolded,
        }
        for k, model in enumerate(grid.models, 1):
            path = figures / f"{file_stem(f'profile-{name}-{model}')}.png"
            records = [grid.record(name, model, loss) for loss in grid.losses]
            profile_figure(path, group, records)
            rows[model].append(same | {"fits": [_fit(pictures, one) for one in records], "profile": embed_png(path)})
            progress(m * len(grid.models) + k, total)
    return rows


def _fit(pictures: Pictures, record: FitRecord) -> dict[str, Any]:
    """The picture of a fit, and what is said of it."""
    return {
        "loss": loss_label(record.loss),
        "image": embed_webp(pictures.path(pictures.grid.picture(record))),
        "outlier": record.outlier,
        "delta_e76": record.differences[DIFFERENCE],
        "told": brief(DIFFERENCE, record.differences[DIFFERENCE]),
    }


def findings(grid: FitGrid, order: Sequence[str]) -> list[str]:
    """What the numbers say, in sentences. Sharp are the half of the materials with the smaller DoI."""
    shown = grid.shown
    sharp = set(order[: (len(order) + 1) // 2])
    lines = []
    for label, part in (
        ("sharper", [r for r in shown if r.material in sharp]),
        ("broader", [r for r in shown if r.material not in sharp]),
    ):
        if part:
            counts = statistics.best_counts(part, grid.losses, DIFFERENCE)
            said = ", ".join(f"{loss_label(loss)} {counts[loss]}" for loss in grid.losses)
            means = ", ".join(
                f"{loss_label(x)} {statistics.mean_difference(part, x, DIFFERENCE):.2f}" for x in grid.losses
            )
            lines.append(
                f"Of the {sum(counts.values())} fits of a material and a model among the {label} half, the picture "
                f"with the smallest ΔE came from: {said}. Mean ΔE: {means}."
            )
    stuck = sum(bool(r.outlier) for r in shown)
    by_model = ", ".join(
        f"{model_label(model)} {sum(statistics.outlier_count(shown, model, loss) for loss in grid.losses)}"
        for model in grid.models
    )
    lines.append(f"{stuck} of {len(shown)} fits are stuck in a local minimum by the paper's test ({by_model}).")
    odd = [r for r in shown if r.status != "converged"]
    if odd:
        named = ", ".join(f"{r.material} {model_label(r.model)} {loss_label(r.loss)} ({r.status})" for r in odd[:8])
        lines.append(f"{len(odd)} fits did not converge: {named}{', ...' if len(odd) > 8 else '.'}")
    return lines


def _error_table(grid: FitGrid, model: str, order: Sequence[str]) -> Table:
    """Every error of a model's fits under every metric."""

    def error(metric: str, loss: str) -> Column[str]:
        return Column(
            f"{loss_label(metric)}: {loss_label(loss)}",
            lambda name: grid.record(name, model, loss).errors[metric],
            ".4g",
            min,
            among=metric,
            outlier=lambda name: metric == loss and bool(grid.record(name, model, loss).outlier),
        )

    note = (
        "metric: fit. Three columns for each metric, its error for the fits under each. Bold: the least. It should "
        "be that of the metric's own fit; where it is not, that fit is an outlier and framed."
    )
    columns = [error(metric, loss) for metric in grid.losses for loss in grid.losses]
    return table(f"Errors, {model_label(model)}", note, order, [Column("material", str), *columns])


def _difference_table(grid: FitGrid, order: Sequence[str]) -> Table:
    """Image differences of each fit."""

    def difference(name: str, loss: str) -> Column[tuple[str, str]]:
        return Column(
            f"{difference_label(name)}, {loss_label(loss)}",
            lambda row: grid.record(*row, loss).differences[name],
            ".3f",
            min,
            among=name,
            key=lambda value: statistics.penalty(value, name),
        )

    note = (
        "Between the picture of each fit and the reference in the same view, over the object; "
        f"{diffuse_label(grid.diffuse)}. Bold: the best."
    )
    rows = [(name, model) for name in order for model in grid.models]
    columns = [difference(name, loss) for name in SHOWN_DIFFERENCES for loss in grid.losses]
    head: list[Column[tuple[str, str]]] = [
        Column("material", lambda row: row[0]), Column("model", lambda row: row[1], model_label)
    ]  # fmt: skip
    return table("Image differences", note, rows, head + columns)


def _agreement_table(grid: FitGrid) -> Table:
    """Do the metrics order fits as the image differences do?"""
    shown = grid.shown

    def agreement(name: str) -> Column[str]:
        head = f"agreement with {difference_label(name)}"
        return Column(head, lambda metric: statistics.rank_agreement(shown, metric, name), ".2f")

    def best(name: str) -> Column[str]:
        counts = statistics.best_counts(shown, grid.losses, name)
        return Column(f"best by {difference_label(name)}", counts.__getitem__)

    note = (
        "Agreement: Spearman's rank correlation between the metric's error and the image difference over all fits of a "
        "material, averaged over materials; 1 means always the same order. Best: for how many materials and models the "
        "fit under this metric has the best picture."
    )
    columns = [*map(agreement, SHOWN_DIFFERENCES), *map(best, SHOWN_DIFFERENCES)]
    return table("Which metric agrees with the pictures", note, grid.losses, [Column("metric", loss_label), *columns])


def _lobes_table(grid: FitGrid) -> Table:
    """One lobe beside two, where both were fitted."""
    few, many = grid.lobes[:2]

    def ratio(loss: str) -> Column[str]:
        def value(model: str) -> list[float]:
            pairs = [[grid.record(name, model, loss, n).error for n in (few, many)] for name in grid.materials]
            return [one / other for one, other in pairs]

        return Column(loss_label(loss), value, lambda x: f"{sum(x) / len(x):.2f} ({min(x):.2f} to {max(x):.2f})")

    note = f"Error with {few} lobe divided by the error with {many}, mean and range over the materials."
    return table(f"{few} lobe or {many}", note, grid.models, [Column("model", model_label), *map(ratio, grid.losses)])
