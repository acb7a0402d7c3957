"""What all figures share: their style, what is written on them, and how they are saved."""

import io
import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from torchbrdf.files import write_bytes

COLORS = {
    "rms": "#c44e52", "cosine_rms": "#dd8452", "solid_angle_cosine_rms": "#ccb974", "cube_root": "#4c72b0",
    "compressed": "#55a868", "log": "#8172b3",
}  # fmt: skip
# Of a mark, to an inch.
LETTERS = 16
# Pixels of a figure to an inch.
DPI = 110
_STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    # Names may have a dollar sign: nothing in a figure is a formula.
    "text.parse_math": False,
    "text.usetex": False,
}


@contextmanager
def new_figure(
    path: Path, width: float, height: float, mark: str = "", layout: Any = "constrained"
) -> Iterator[Figure]:
    """A figure of so many inches to draw on; saved when the block ends, with `mark` written on it.

    Text is drawn as it is; a character that the font lacks is a box, without a warning for each.
    """
    with matplotlib.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        figure = Figure(figsize=(width, height), dpi=DPI, layout=layout)
        yield figure
        if mark:
            lines = textwrap.fill(mark, int(width * LETTERS))
            figure.suptitle(lines, fontsize=8, color="#9c3d00", x=0.99, ha="right")
        data = io.BytesIO()  # the errors of a full disk are those of a file, not of a library
        figure.savefig(data, dpi=DPI, format="png")
        write_bytes(path, data.getvalue())


def plain_ticks(axis: Axis) -> None:
    """Numbers of a logarithmic axis as plain text; matplotlib writes them as formulas, which figures do not have."""
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.4)))
