"""What observers' answers say: sentences, tables, and a page of its own."""

import json
import math
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from torchbrdf.experiment.conclusions import check_claims, confused, mean_scales
from torchbrdf.experiment.scaling import ScaledExperiment, scale_experiments
from torchbrdf.files import write_csv, write_json, write_text
from torchbrdf.names import file_stem
from torchbrdf.progress import Progress, quiet
from torchbrdf.psychophysics import Method, ObserverReport, kendall_agreement
from torchbrdf.recipe import versions
from torchbrdf.report.embed import embed_png, template
from torchbrdf.report.scale_figures import MOST_LINES, scales_figure
from torchbrdf.report.tables import Column, Table, table
from torchbrdf.study import MEASURED, Answer, Plan, simulated

FILES = ("scales.csv", "scales.json", "observers.csv", "scales.html")  # beside figures/
SIMULATED_MARK = "simulated observers: not people"
POOR = 0.01


def observed(scaled: ScaledExperiment, folder: Path, mark: str) -> dict[str, Any]:
    """What `observers.html` shows of an experiment; the figure is drawn into a folder."""
    path = folder / f"{file_stem(f'scales-{scaled.name}' if scaled.name else 'scales')}.png"
    caption = scales_figure(path, scaled, mark)
    return {
        "title": scaled.title,
        "mark": mark,
        "figure": embed_png(path),
        "caption": caption,
        "findings": findings(scaled),
    }


def findings(scaled: ScaledExperiment) -> list[str]:
    """What the scales say, in sentences."""
    scales = scaled.scales
    means = mean_scales(scales)
    ranked = sorted(means, key=lambda name: -means[name])
    said = ", ".join(f"{scaled.label(name)} {means[name]:+.2f}" for name in ranked[:MOST_LINES])
    lines = [
        f"{len(scaled.comparisons.observers)} observers, {int(scaled.comparisons.wins.sum())} answers. "
        f"Mean scale values: {said}{'.' if len(ranked) <= MOST_LINES else ', ...'}"
    ]
    if scaled.plan is not None:
        lines += check_claims(scales, scaled.plan)
    if any(MEASURED in names for names in scales.stimuli):
        lines.append(_confusions(scaled))
    poor = [name for name, p in zip(scales.materials, scales.goodness.p.tolist(), strict=True) if p < POOR]
    if poor:
        lines.append(f"One scale does not describe the answers well (p < {POOR}) for {', '.join(poor)}.")
    lines += [
        f"{report.observer}: {'; '.join(report.flags)}. Kept in all figures."
        for report in scaled.reports
        if report.flags
    ]
    return lines


def _confusions(scaled: ScaledExperiment) -> str:
    lost = confused(scaled.scales)
    every = [name for names in lost.values() for name in names]
    counts = ", ".join(f"{scaled.label(name)} {every.count(name)}" for name in sorted(set(every)))
    some = sum(map(bool, lost.values()))
    return (
        f"For {some} of {len(lost)} materials an approximation is confused with the measured one"
        f"{f' ({counts})' if counts else ''}: the 95 % interval of their difference holds 0, or it is preferred."
    )


def observer_tables(scaled: ScaledExperiment) -> list[Table]:
    """Scales, how well they describe the answers, and the observers."""
    return [_scale_table(scaled), _observer_table(scaled)]


def _scale_table(scaled: ScaledExperiment) -> Table:
    scales, places = scaled.scales, scaled.scales.materials
    alike = kendall_agreement(scaled.comparisons)
    known = {(record["material"], record["stimulus"]): record for record in scales.records()}

    def stimulus(name: str) -> Column[str]:
        return Column(
            scaled.label(name),
            lambda material: known.get((material, name)),
            lambda record: f"{record['scale']:+.2f} ({record['low']:+.2f} to {record['high']:+.2f})",
            max,
            among="stimuli",
            key=lambda record: record["scale"],
        )

    def number(head: str, values: Any, show: str) -> Column[str]:
        return Column(head, lambda material: float(values[places.index(material)]), show)

    note = (
        "Thurstone's case V, in standard deviations of a difference; the mean of a material's stimuli is 0. In "
        "brackets the 95 % interval; beside it Montag's (2006) half width, from the numbers of stimuli and "
        "observations alone. Fit: how often answers that follow the scale are as far from it as these. u: Kendall's "
        "coefficient of agreement, 1 where all observers agree, and how often chance makes it so large. Bold: the "
        "highest."
    )
    columns: list[Column[str]] = [
        Column("material", str),
        *map(stimulus, scaled.stimuli),
        number("± Montag", scales.montag, ".2f"),
        number("fit, p", scales.goodness.p, ".2g"),
        number("u", alike.u, ".2f"),
        number("u, p", alike.p, ".2g"),
    ]
    return table(f"Scales, {scaled.title}", note, scaled.order, columns)


def _observer_table(scaled: ScaledExperiment) -> Table:
    rows = [observer_row(report) for report in scaled.reports]
    note = (
        "Agreement: how far the likelihood of an observer's answers, under the scales of all others, is from what it "
        "should be, in standard deviations. Consistence: Kendall's, 1 without a circular triad (A over B, B over C, C "
        "over A), mean over materials. Flagged observers are kept."
    )
    columns = [Column[dict[str, Any]](key, itemgetter(key), _text) for key in rows[0]]
    return table(f"Observers, {scaled.title}", note, rows, columns)


def observer_row(report: ObserverReport) -> dict[str, Any]:
    """What a table says of an observer."""
    known = [value for value in report.consistence.values() if not math.isnan(value)]
    return {
        "observer": report.observer,
        "trials": report.trials,
        "agreement": report.likelihood_z,
        "consistence": sum(known) / len(known) if known else math.nan,
        "chose left": report.left,
        "repeats": report.repeats,
        "repeats answered the same": report.repeats_same,
        "catch trials": report.catches,
        "catch trials missed": report.missed,
        "seconds": report.seconds,
        "flags": "; ".join(report.flags),
    }


def _text(value: object) -> str:
    return ("" if math.isnan(value) else f"{value:.2f}") if isinstance(value, float) else str(value)


# --- files ------------------------------------------------------------------------------------------------------------


def write_scales(
    folder: Path,
    answers: Sequence[Answer],
    plan: Plan | None,
    *,
    method: Method,
    seed: int,
    source: str,
    progress: Progress = quiet,
) -> list[str]:
    """Scale the answers of every experiment into a folder, and give what they say, in lines.

    Writes `scales.csv`, `scales.json`, `observers.csv`, figures and `scales.html`.
    """
    scaled = scale_experiments(answers, plan, method, seed, progress)
    mark = "; ".join(filter(None, [plan.mark if plan else "", SIMULATED_MARK if simulated(answers) else ""]))
    said = [observed(one, folder / "figures", mark) for one in scaled]
    records = [{"experiment": one.name, **record} for one in scaled for record in one.scales.records()]
    record = {"source": source, "method": method, "seed": seed, "simulated": simulated(answers), "versions": versions()}
    write_json(folder / "scales.json", {**record, "scales": records})
    write_csv(folder / "scales.csv", records)
    rows = [{"experiment": one.name, **observer_row(report)} for one in scaled for report in one.reports]
    write_csv(folder / "observers.csv", rows)
    page = template("scales.html").render(
        title=f"What observers say: {source}",
        observed=said,
        tables=[table for one in scaled for table in observer_tables(one)],
        made=(
            f"Method: {method}. Everything is in this folder: scales.csv, scales.json, observers.csv, figures/. "
            "Repeats and catch trials do not count for the scales."
        ),
        record=json.dumps(record, indent=1),
    )
    write_text(folder / "scales.html", page)
    return [line for one in said for line in (one["title"], *([mark] if mark else []), *one["findings"])]
