"""Which angles were measured: ranges, and a picture of a few characters."""

from collections.abc import Sequence

import numpy as np

from torchbrdf.measured.measured import Measured
from torchbrdf.measured.tables import angle_from_normal

# Degrees of a bin: a character is one wide and two high.
STEP = 5
BINS = 90 // STEP
# Degrees: of cosines in single precision.
ROUNDING = 0.05
FULL, UPPER, LOWER, NONE = "\u2588\u2580\u2584\u00b7"
"""Characters: both halves have samples, the upper one, the lower one, none."""
ASCII = str.maketrans({FULL: "#", UPPER: "'", LOWER: ",", NONE: ".", "\u03b8": "theta"})
"""For terminals that have no others."""


def coverage(measured: Measured) -> dict[str, object]:
    """Which angles of light and viewer one material was measured at.

    Args:
        measured: One material.

    Returns:
        Ranges in degrees, each a list of two: of the light, of the viewer, and of the azimuth between them, where 180
        is the mirror's side; the share of all pairs of angles, in steps of 5 degrees, that has a sample; and `plot`,
        lines of text. Without any valid sample the ranges are None.

    Example:
        >>> from torchbrdf.measured import load, standins
        >>> from torchbrdf.measured.coverage import coverage
        >>> coverage(load(standins()).batch([6]))["light"]
        [0.0, 90.0]
    """
    pairs = measured.pairs.select([0])
    valid = (measured.weight[0, :, 0] > 0) & pairs.above_horizon[0]
    cosines = [one[0][valid].double().cpu() for one in (pairs.cos_i, pairs.cos_o, pairs.cos_d)]
    if not len(cosines[0]):
        return {
            "light": None,
            "viewer": None,
            "azimuth between": None,
            "share": 0.0,
            "plot": _plot(np.zeros((BINS, BINS))),
        }
    light, viewer = (angle_from_normal(one).numpy() for one in cosines[:2])
    sines = np.sin(np.radians(light)) * np.sin(np.radians(viewer))
    between = 2 * cosines[2].numpy() ** 2 - 1 - cosines[0].numpy() * cosines[1].numpy()
    tilted = sines > 1e-4  # elsewhere there is no azimuth
    turn = np.degrees(np.arccos(np.clip(between[tilted] / sines[tilted], -1, 1)))
    places = [np.minimum((one + ROUNDING) // STEP, BINS - 1).astype(int) for one in (light, viewer)]
    filled = np.zeros((BINS, BINS))
    filled[places[1], places[0]] = 1
    return {
        "light": _range(light),
        "viewer": _range(viewer),
        "azimuth between": _range(turn) if len(turn) else None,
        "share": round(float(filled.mean()), 3),
        "plot": _plot(filled),
    }


def _range(angles: np.ndarray) -> list[float]:
    return [round(float(angles.min()), 1), round(float(angles.max()), 1)]


def _plot(filled: np.ndarray) -> list[str]:
    """The bins as text: the viewer's angle upwards, the light's to the right."""
    lines = []
    for low in range(BINS - 2, -1, -2):
        upper, lower = filled[low + 1] > 0, filled[low] > 0
        cells = np.select([upper & lower, upper, lower], [FULL, UPPER, LOWER], NONE)
        lines.append(f"{low * STEP:3d} {''.join(np.repeat(cells, 2))}")
    axis = "".join(f"{angle:<12d}" for angle in range(0, 90, 30))
    return ["viewer, degrees", *lines, f"    {axis}light, degrees"]


def lines_of(plot: Sequence[str], encoding: str | None) -> list[str]:
    """The lines of a plot as a terminal of an encoding can show them."""
    try:
        "".join(plot).encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return [line.translate(ASCII) for line in plot]
    return list(plot)
