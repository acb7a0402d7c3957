"""What reports and commands print beside a distance: one place makes the words."""

import math

from torchbrdf.perception.discrimination.psychometric import Share, discrimination_of, told_apart

MARKS = (0.1, 0.25, 0.5, 0.75, 0.9)
"""Shares that a scale shows."""

MEANING = (
    "Told apart by: the share of observers who would be expected to know which of two is the fit, with the material "
    "itself beside them; the others guess."
)

BEYOND = "A share with * is extrapolated: people were not asked about such small, or such large, differences."

INTERVAL = "In brackets: 95 % interval for one fit."


def brief(metric: str, distance: float, *, interval: bool = False) -> str:
    """The share, such as `40 %`, or with its interval `40 % (20 to 65)`; empty where it is not known."""
    found = told_apart(metric, distance)
    if found is None or math.isnan(found.value):
        return ""
    return found.brief if interval else found.percent


def said(metric: str, distance: float) -> str:
    """What a distance means, in words with the share and its interval; empty where it is not known.

    Example:
        >>> said("psnr", 30.0)
        ''
    """
    found = told_apart(metric, distance)
    if found is None or math.isnan(found.value):
        return ""
    return f"{found.words} would tell them apart: {found.text}"


def scale(metric: str, label: str) -> str:
    """The scale of a metric: the distances at which one in ten, half, ... would tell two things apart.

    Args:
        metric: The name of a loss, or of an image difference.
        label: What it is called.

    Returns:
        A line; empty where it is not known.
    """
    known = discrimination_of(metric)
    if known is None:
        return ""
    marks = [(share, known.distance(share)) for share in MARKS]
    steps = [
        f"{Share(share, share, share).words} at {digits(at)}"
        for share, at in marks
        if known.lowest <= at <= known.highest
    ]
    return f"{label}: told apart by {', '.join(steps)}"


def digits(value: float) -> str:
    """Two digits, as 0.041, 4.1 or 41."""
    if value >= 10:
        return f"{value:.0f}"
    return f"{float(f'{value:.2g}'):g}"
