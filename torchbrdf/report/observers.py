"""What observers' answers say: sentences, tables, and a page of its own."""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchbrdf.files import write_text
from torchbrdf.psychophysics import Method, ObserverReport, kendall_agreement
from torchbrdf.recipe import versions
from torchbrdf.report.claims import claim, confused, mean_scales
from torchbrdf.report.inline import png, template
from torchbrdf.report.judged import MOST_LINES, Judged, draw, judge
from torchbrdf.report.labels import Cell
from torchbrdf.study import MEASURED, Answer, Plan, simulated

SIMULATED_MARK = "simulated observers: not people"
POOR = 0.01


def observed(judged: Judged, folder: Path, mark: str) -> dict[str, Any]:
    """What `observers.html` shows of an experiment; the figure is drawn into a folder."""
    path = folder / (f"scales-{judged.name}.png" if judged.name else "scales.png")
    caption = draw(judged, path, mark)
    return {
        "title": judged.title,
        "mark": mark,
        "figure": png(path),
        "caption": caption,
        "findings": findings(judged),
    }


def findings(judged: Judged) -> list[str]:
    """What the scales say, in sentences."""
    scales = judged.scales
    means = mean_scales(scales)
    ranked = sorted(means, key=lambda name: -means[name])
    said = ", ".join(f"{judged.label(name)} {means[name]:+.2f}" for name in ranked[:MOST_LINES])
    lines = [
        f"{len(judged.comparisons.observers)} observers, {int(judged.comparisons.wins.sum())} answers. "
        f"Mean scale values: {said}{'.' if len(ranked) <= MOST_LINES else ', ...'}"
    ]
    if judged.plan is not None:
        lines += claim(scales, judged.plan)
    if any(MEASURED in names for names in scales.stimuli):
        lines.append(_confusions(judged))
    poor = [name for name, p in zip(scales.materials, scales.goodness.p.tolist(), strict=True) if p < POOR]
    if poor:
        lines.append(f"One scale does not describe the answers well (p < {POOR}) for {', '.join(poor)}.")
    lines += [
        f"{report.observer}: {'; '.join(report.flags)}. Kept in all figures."
        for report in judged.reports
        if report.flags
    ]
    return lines


def _confusions(judged: Judged) -> str:
    lost = confused(judged.scales)
    every = [name for names in lost.values() for name in names]
    counts = ", ".join(f"{judged.label(name)} {every.count(name)}" for name in sorted(set(every)))
    some = sum(map(bool, lost.values()))
    return (
        f"For {some} of {len(lost)} materials an approximation is confused with the measured one"
        f"{f' ({counts})' if counts else ''}: the 95 % interval of their difference holds 0, or it is preferred."
    )


def tables(judged: Judged) -> list[dict[str, Any]]:
    """Scales, how well they describe the answers, and the observers."""
    return [_scale_table(judged), _observer_table(judged)]


def _scale_table(judged: Judged) -> dict[str, Any]:
    scales = judged.scales
    names = judged.stimuli
    alike = kendall_agreement(judged.comparisons)
    known = {(record["material"], record["stimulus"]): record for record in scales.records()}
    rows = []
    for name in judged.order:
        m = scales.materials.index(name)
        best = max(known[name, stimulus]["scale"] for stimulus in scales.stimuli[m])
        cells = [Cell(name)]
        for stimulus in names:
            record = known.get((name, stimulus))
            text = f"{record['scale']:+.2f} ({record['low']:+.2f} to {record['high']:+.2f})" if record else ""
            cells.append(Cell(text, record is not None and record["scale"] == best))
        figures = (f"{scales.montag[m]:.2f}", f"{scales.goodness.p[m]:.2g}", f"{alike.u[m]:.2f}", f"{alike.p[m]:.2g}")
        rows.append([*cells, *map(Cell, figures)])
    note = (
        "Thurstone's case V, in standard deviations of a difference; the mean of a material's stimuli is 0. In "
        "brackets the 95 % interval; beside it Montag's (2006) half width, from the numbers of stimuli and "
        "observations alone. Fit: how often answers that follow the scale are as far from it as these. u: Kendall's "
        "coefficient of agreement, 1 where all observers agree, and how often chance makes it so large. Bold: the "
        "highest."
    )
    head = ["material", *map(judged.label, names), "± Montag", "fit, p", "u", "u, p"]
    return {"title": f"Scales, {judged.title}", "note": note, "head": head, "rows": rows}


def _observer_table(judged: Judged) -> dict[str, Any]:
    columns = [observer_row(report) for report in judged.reports]
    note = (
        "Agreement: how far the likelihood of an observer's answers, under the scales of all others, is from what it "
        "should be, in standard deviations. Consistence: Kendall's, 1 without a circular triad (A over B, B over C, C "
        "over A), mean over materials. Flagged observers are kept."
    )
    rows = [[Cell(_text(value)) for value in row.values()] for row in columns]
    return {"title": f"Observers, {judged.title}", "note": note, "head": list(columns[0]), "rows": rows}


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
    folder: Path, answers: Sequence[Answer], plan: Plan | None, *, method: Method, seed: int, source: str
) -> list[str]:
    """Scale the answers of every experiment; write `scales.csv`, `scales.json`, `observers.csv`, figures and
    `scales.html` into a folder. Gives what they say, in lines.
    """
    judged = judge(answers, plan, method, seed)
    mark = "; ".join(filter(None, [plan.mark if plan else "", SIMULATED_MARK if simulated(answers) else ""]))
    said = [observed(one, folder / "figures", mark) for one in judged]
    records = [{"experiment": one.name, **record} for one in judged for record in one.scales.records()]
    record = {"source": source, "method": method, "seed": seed, "simulated": simulated(answers), "versions": versions()}
    write_text(folder / "scales.json", json.dumps({**record, "scales": records}, indent=1) + "\n")
    write_text(folder / "scales.csv", _csv(records))
    rows = [{"experiment": one.name, **observer_row(report)} for one in judged for report in one.reports]
    write_text(folder / "observers.csv", _csv(rows))
    page = template("scales.html").render(
        title=f"What observers say: {source}",
        observed=said,
        tables=[table for one in judged for table in tables(one)],
        made=(
            f"Method: {method}. Everything is in this folder: scales.csv, scales.json, observers.csv, figures/. "
            "Repeats and catch trials do not count for the scales."
        ),
        record=json.dumps(record, indent=1),
    )
    write_text(folder / "scales.html", page)
    return [line for one in said for line in (one["title"], *([mark] if mark else []), *one["findings"])]


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
