"""One strategy beside another: who gets stuck, what that costs in error, and whether it can be seen."""

from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.report.figures import beside_figure, grid_figure
from torchbrdf.report.labels import Cell, loss_label, model_label
from torchbrdf.report.numbers import Records, badness, mean_difference, outlier_count
from torchbrdf.report.study import DIFFERENCE, Study, picture

# An error that is lower, or higher, by less than this share is the same.
SAME = 0.01
# A difference in mean Delta E that an eye has a chance to see.
VISIBLE = 0.1
# Pictures in the figure of the largest gains.
SHOWN = 8


def ratios(ours: Records, theirs: Records) -> np.ndarray:
    """Errors of the other strategy over the strategy's, of the same fits."""
    pairs = zip(ours, theirs, strict=True)
    return np.array([other["error"] / one["error"] if one["error"] else 1.0 for one, other in pairs])


def gains(ours: Records, theirs: Records) -> np.ndarray:
    """By how much the strategy's pictures are better, in units of the image difference."""
    return np.array(
        [badness(other, DIFFERENCE) - badness(one, DIFFERENCE) for one, other in zip(ours, theirs, strict=True)]
    )


def compared(study: Study) -> dict[str, Any] | None:
    """Figures (drawn into the run's folder), sentences and a table; None if the study has but one strategy."""
    if not study.beside:
        return None
    ours, theirs = study.drawn(study.strategy), study.drawn(study.beside)
    folder = study.folder.path / "figures"
    ratio, gain = ratios(ours, theirs), gains(ours, theirs)
    beside_figure(folder / "strategies.png", study, ratio, gain)
    return {
        "figure": folder / "strategies.png",
        "pictures": _pictures(study, ours, theirs, ratio, folder / "strategies-pictures.png"),
        "findings": _findings(study, ours, theirs, ratio, gain),
        "table": _table(study, ours, theirs, ratio, gain),
    }


def _findings(study: Study, ours: Records, theirs: Records, ratio: np.ndarray, gain: np.ndarray) -> list[str]:
    name, other = study.strategy, study.beside
    lower = ratio > 1 + SAME
    seen, worse = int((lower & (gain > VISIBLE)).sum()), int((lower & (gain < -VISIBLE)).sum())
    lines = [
        f"The {other} strategy leaves {sum(r['outlier'] for r in theirs)} of {len(theirs)} fits in a local minimum by "
        f"the paper's test, the {name} one {sum(r['outlier'] for r in ours)}. The {name} error is lower by more than "
        f"{SAME:.0%} in {int(lower.sum())} fits, by up to {100 * (1 - 1 / ratio.max()):.0f} %, and higher by more than "
        f"that in {int((ratio < 1 / (1 + SAME)).sum())}."
    ]
    if lower.any():
        lines.append(
            f"Does lower error look better? Of these {int(lower.sum())} fits the picture came closer to the reference "
            f"in {seen} and farther in {worse} (by more than {VISIBLE} ΔE); in the mean ΔE "
            f"{'fell' if gain[lower].mean() > 0 else 'rose'} by {abs(gain[lower].mean()):.2f}."
        )
    means = [np.mean([badness(record, DIFFERENCE) for record in part]) for part in (theirs, ours)]
    lines.append(f"Mean ΔE over all {len(ours)} fits: {other} {means[0]:.2f}, {name} {means[1]:.2f}.")
    return lines


def _table(study: Study, ours: Records, theirs: Records, ratio: np.ndarray, gain: np.ndarray) -> dict[str, Any]:
    rows = []
    for model in study.models:
        for loss in study.losses:
            chosen = [k for k, r in enumerate(ours) if (r["model"], r["loss"]) == (model, loss)]
            one, other = [ours[k] for k in chosen], [theirs[k] for k in chosen]
            own, better = ratio[chosen], gain[chosen]
            cells = [Cell(model_label(model)), Cell(loss_label(loss))]
            cells += [Cell(str(outlier_count(part, model, loss))) for part in (other, one)]
            cells += [Cell(str(int((own > 1 + SAME).sum()))), Cell(f"{np.median(own):.3f}")]
            cells += [Cell(f"{own.min():.3f} to {own.max():.3f}")]
            cells += [Cell(f"{mean_difference(part, loss, DIFFERENCE):.2f}") for part in (other, one)]
            cells += [Cell(f"{int((better > VISIBLE).sum())} / {int((better < -VISIBLE).sum())}")]
            rows.append(cells)
    name, other_name = study.strategy, study.beside
    head = ["model", "metric", f"stuck, {other_name}", f"stuck, {name}", f"{name} lower by 1 %"]
    head += ["error ratio, median", "range", f"mean ΔE, {other_name}", f"mean ΔE, {name}", "closer / farther"]
    note = (
        f"Stuck: local minima by the paper's test, among the fits of one strategy. Error ratio: {other_name} over "
        f"{name}. Closer / farther: pictures that the {name} fit brings closer to the reference, or farther from it, "
        f"by more than {VISIBLE} ΔE."
    )
    return {"title": f"{other_name.capitalize() if other_name else ''} beside {name}", "note": note, "head": head,
            "rows": rows}  # fmt: skip


def _pictures(study: Study, ours: Records, theirs: Records, ratio: np.ndarray, path: Path) -> Path | None:
    """The fits whose error differs most, as pictures."""
    order = [k for k in np.argsort(-ratio)[:SHOWN] if ratio[k] > 1 + SAME]
    if not order:
        return None
    titles = [f"{ours[k]['material']}\n{model_label(ours[k]['model'])}, {loss_label(ours[k]['loss'])}" for k in order]
    rows = {
        "reference": [study.png(picture(ours[k]["material"])) for k in order],
        str(study.beside): [study.png(study.picture(theirs[k])) for k in order],
        study.strategy: [study.png(study.picture(ours[k])) for k in order],
    }
    grid_figure(path, titles, rows, study.stand_in)
    return path
