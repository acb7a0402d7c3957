"""Slices as the pages show them: their numbers, and pictures as text."""

from collections.abc import Sequence
from typing import Any

from torchbrdf.experiment.slices import INCIDENCES, Slices, viewer_angles
from torchbrdf.report.embed import embed_display

# Incidences that have a small polar plot of their own, degrees.
SMALL = (0, 30, 60, 75)
_DIGITS = 4


def slices_data(labels: Sequence[str], slices: Sequence[Slices], references: Sequence[int | None]) -> dict[str, Any]:
    """What `slices.html` draws, as JSON has it.

    Args:
        labels: Of the items.
        slices: Of each.
        references: The place of what each is compared with; None of those that are compared with nothing.
    """
    angles = [viewer_angles(one) for one in INCIDENCES]
    counts = [len(one) for one in angles]
    return {
        "incidences": list(INCIDENCES),
        "small": list(SMALL),
        "angles": angles,
        "items": [
            {
                "label": label,
                "values": [
                    [[_short(value) for value in channel] for channel in rows[:count].T.tolist()]
                    for rows, count in zip(own.values, counts, strict=True)
                ],
                "far": [
                    "".join("01"[value] for value in row[:count].tolist())
                    for row, count in zip(own.far, counts, strict=True)
                ],
                "image": embed_display(own.picture(), "png"),
                "ratio": "" if of is None else embed_display(own.ratio(slices[of]), "png"),
            }
            for label, own, of in zip(labels, slices, references, strict=True)
        ],
    }


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
