"""compare.html: numbers, slices that can be moved, pictures, and where materials differ most."""

import math
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.experiment.comparison import Compared, Subject
from torchbrdf.experiment.extrapolation import MOST, NOTE, extrapolated_share, hatched
from torchbrdf.experiment.labels import difference_label, loss_label
from torchbrdf.experiment.matching.judge import Brdf, Judge
from torchbrdf.experiment.pictures import BRIGHTEST, COLOR_MAP, color_difference
from torchbrdf.experiment.slices import slices_of
from torchbrdf.files import destination, write_text
from torchbrdf.images import composite
from torchbrdf.perception.discrimination.words import BEYOND, MEANING, scale
from torchbrdf.report.embed import embed_display, template
from torchbrdf.report.slices import slices_data

MAP_TOP = BRIGHTEST / 2
QUALITY = 90


def write_compare_page(
    path: Path, reference: Judge, subject: Subject, others: Sequence[Compared], problems: Sequence[str]
) -> Path:
    """Write the page, whole or not at all.

    Args:
        path: Where.
        reference: The reference in its scenes.
        subject: The reference.
        others: Each beside it.
        problems: What could not be compared.

    Returns:
        The path.
    """
    destination(path)
    labels = [subject.label, *(one.subject.label for one in others)]
    own = [slices_of(brdf) for brdf in (subject.brdf, *(one.subject.brdf for one in others))]
    page = template("compare.html").render(
        title=f"{labels[0]} beside {', '.join(labels[1:3])}" + (f" and {len(labels) - 3} more" * (len(labels) > 3)),
        reference=subject.label,
        others=[{"label": one.subject.label, "words": one.where} for one in others],
        rows=_rows(others),
        notes=_notes(others),
        scenes=list(reference.scenes),
        problems=list(problems),
        top=f"{MAP_TOP:g}",
        meaning=[scale("delta_e76", difference_label("delta_e76")), MEANING],
        extrapolated=NOTE,
        slices=slices_data(labels, own, [None, *[0] * len(others)]),
        data={
            "reference": [
                _shown(reference, subject.brdf, scene, reference.reference(scene)) for scene in reference.scenes
            ],
            "others": [[_pictures(reference, one.subject.brdf, scene) for scene in reference.scenes] for one in others],
        },
    )
    write_text(path, page)
    return path


def _rows(others: Sequence[Compared]) -> list[tuple[str, list[str]]]:
    """The table: metrics, then differences of pictures."""
    found = []
    for name in others[0].metrics:
        cells = []
        for one in others:
            share, value = one.told(name), one.metrics[name]
            told = "" if share is None else f", told apart by {share.brief}"
            cells.append("too little was measured" if math.isnan(value) else f"{value:.4g}{told}")
        found.append((loss_label(name), cells))
    for scene, first in others[0].figures.items():
        for key in first.differences:
            cells = [f"{one.figures[scene].differences[key]:.2f}" for one in others]
            found.append((f"{difference_label(key)}, {scene}", cells))
        found.append((f"told apart by, {scene}", [one.figures[scene].told.brief for one in others]))
    return found


def _notes(others: Sequence[Compared]) -> list[str]:
    known, every = min(one.pairs for one in others), others[0].pairs[1]
    where = (
        f"Metrics are over {every} pairs of directions, uniform in the angles of light and viewer up to 80\u00b0 "
        "and in the azimuth between."
    )
    if known[0] < every:
        where += f" Left out are those that are extrapolated; {known[0]} at least are left."
    return [where, BEYOND]


def _shown(judge: Judge, brdf: Brdf, scene: str, picture: Tensor) -> str:
    """A picture as a data URI, hatched where most of a pixel's light was never measured."""
    own = judge.scenes[scene]
    far = (extrapolated_share(brdf, own) > MOST) & own.mask
    return _webp(hatched(composite(picture, own.coverage), far))


def _pictures(judge: Judge, brdf: Brdf, scene: str) -> dict[str, str]:
    """A picture and where it differs from the reference's, as data URIs."""
    picture, coverage = judge.picture(brdf, scene), judge.scenes[scene].coverage
    off = (color_difference(picture, judge.reference(scene)) / MAP_TOP).clamp(0, 1)
    colors = torch.from_numpy(COLOR_MAP(off.numpy())[..., :3]).to(coverage)
    return {"picture": _shown(judge, brdf, scene, picture), "map": _webp(composite(colors, coverage))}


def _webp(display: Tensor) -> str:
    return embed_display(display, "webp", quality=QUALITY)
