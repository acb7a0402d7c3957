"""Scales and marks of what distances mean, in figures and pages."""

import math
from itertools import pairwise

import matplotlib.image
import pytest
from matplotlib.figure import Figure

from torchbrdf.experiment.discrimination import Calibrated
from torchbrdf.perception import discrimination_of, told_apart
from torchbrdf.perception.discrimination.calibration import ReliabilityBin
from torchbrdf.perception.discrimination.psychometric import Discrimination
from torchbrdf.report.meaning import mark_shares, meaning, scales
from torchbrdf.report.sheet import _mean

METRIC = Discrimination(2.5, 1.5, 0.4, [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]], 0.05, 3.0, {"triplets": 0.02})


@pytest.mark.parametrize("along", ["x", "y"])
def test_marks_stand_at_the_distances_of_their_shares(along):
    panel = Figure().add_subplot(xlim=(0, 20), ylim=(0, 20))
    mark_shares(panel, "delta_e76", along)
    (axis,) = panel.child_axes
    ticks = getattr(axis, f"get_{along}ticks")()
    labels = [label.get_text() for label in getattr(axis, f"get_{along}ticklabels")()]
    assert labels[0] == "10 %" and "50 %" in labels and "90 %" not in labels  # nine in ten is farther than 20
    assert min(b - a for a, b in pairwise(ticks)) > 1  # none over another
    for at, label in zip(ticks, labels, strict=True):
        assert told_apart("delta_e76", at).percent == label


def test_nothing_is_marked_where_it_is_not_known():
    panel = Figure().add_subplot()
    mark_shares(panel, "psnr", "x")
    assert not panel.child_axes
    (line,) = scales(["psnr", "ssim", "delta_e76"])
    assert line.startswith("ΔE 76: told apart by ") and "half at" in line


def test_a_page_has_the_figure_and_a_row_a_metric(tmp_path):
    bins = [ReliabilityBin(part, x, x, x - 0.1, x + 0.1, 10) for part in ("triplets", "pairs") for x in (0.6, 0.8)]
    figure = tmp_path / "reliability.png"
    found = meaning(figure, Calibrated({"rms": METRIC, "learned": METRIC}, {"rms": bins, "learned": bins}), "", str)
    assert matplotlib.image.imread(figure).ndim == 3
    rows = [[cell.text for cell in row] for row in found["table"].rows]
    assert [row[0] for row in rows] == ["learned", "rms"]
    assert rows[0][1].strip("()") == f"{METRIC.distance(0.1):.2g}" and rows[0][1].startswith("(") == (
        METRIC.distance(0.1) < METRIC.lowest
    )
    assert rows[0][-2:] == ["0.020", ""]
    assert meaning(figure, Calibrated({}, {}), "", str) is None


def test_a_sheet_says_what_a_mean_difference_means():
    share = discrimination_of("delta_e76").share(3.0)
    assert _mean(3.0) == f"mean ΔE 3.00\ntold apart by {share.brief}"
    assert _mean(math.nan) == "mean ΔE nan"
