"""What a distance means: constants recovered, intervals that cover, reliability, words, and the bundled file."""

import json
import math
from itertools import pairwise
from pathlib import Path

import pytest
import torch

from torchbrdf.errors import DataError, UsageError
from torchbrdf.experiment.discrimination import METRIC, probe, shares_of_fits
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import read_fits
from torchbrdf.measured import load, standins
from torchbrdf.perception.agreement.table import Distances
from torchbrdf.perception.datasets.opinions import Opinions
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
from torchbrdf.perception.datasets.triplets import Triplets
from torchbrdf.perception.discrimination.calibration import (
    Choices,
    ReliabilityBin,
    calibrate,
    choices,
    flat,
    mean_error,
    reliability,
)
from torchbrdf.perception.discrimination.psychometric import (
    LADDER,
    LAPSE,
    Discrimination,
    JustObjectionable,
    Share,
    discrimination_of,
    read_discrimination,
    told_apart,
)
from torchbrdf.perception.discrimination.words import MARKS, brief, said, scale

MATERIALS = 40
NOTHING = [[0.0] * 3] * 3
TRUE = Discrimination(2.5, 1.5, 0.4, NOTHING, 0.05, 3.0)


def psi(distance: torch.Tensor, metric: Discrimination = TRUE) -> torch.Tensor:
    return metric.slope * metric.scale * torch.log1p(distance / metric.scale)


def simulated(
    pairs: int, votes: int, seed: int = 0, metric: Discrimination = TRUE
) -> tuple[torch.Tensor, dict[str, Choices]]:
    """Distances, and what observers choose who see them with the metric's error, drawn for each comparison."""
    generator = torch.Generator().manual_seed(seed)
    distances = torch.exp(torch.randn(2 * pairs, generator=generator, dtype=torch.float64) * 0.8 - 0.5)
    wrong = torch.exp(metric.spread * torch.randn(2 * pairs, generator=generator, dtype=torch.float64))
    one, other = psi(distances * wrong, metric).chunk(2)
    chance = LAPSE + (1 - 2 * LAPSE) * torch.special.ndtr(other - one)
    first = torch.binomial(torch.full_like(chance, votes), chance, generator=generator)
    about = torch.rand(pairs, MATERIALS, generator=generator).argsort(1)[:, :3]
    place = torch.arange(2 * pairs)
    return distances, {"triplets": Choices(*place.chunk(2), torch.stack([first, votes - first], 1), about)}


def test_a_calibration_recovers_the_constants() -> None:
    found = calibrate(*simulated(4000, 10), MATERIALS, 10)
    assert found.spread == pytest.approx(TRUE.spread, rel=0.15)
    for distance in (0.1, 0.3, 1.0, 2.0):
        assert found.share(distance).value == pytest.approx(TRUE.share(distance).value, abs=0.03)
        assert found.prefer(0.3, distance) == pytest.approx(TRUE.prefer(0.3, distance), abs=0.02)


def test_a_calibration_does_not_depend_on_the_unit() -> None:
    distances, parts = simulated(1000, 5)
    one, other = calibrate(distances, parts, MATERIALS, 20), calibrate(distances * 40, parts, MATERIALS, 20)
    for distance in (0.1, 1.0):
        assert other.share(40 * distance).value == pytest.approx(one.share(distance).value, abs=1e-3)


def test_intervals_cover_the_shares_of_single_pairs() -> None:
    """Each pair has its own error; the interval for one pair has to hold the share of 95 % of them."""
    covered = []
    generator = torch.Generator().manual_seed(5)
    for seed in range(6):
        found = calibrate(*simulated(400, 5, seed), MATERIALS, 100)
        for distance in (0.1, 0.4, 1.2):
            errors = torch.exp(TRUE.spread * torch.randn(300, generator=generator, dtype=torch.float64))
            own = 2 * torch.special.ndtr(psi(distance * errors)) - 1
            interval = found.share(distance)
            covered.append(((own >= interval.low) & (own <= interval.high)).double().mean())
    assert 0.9 < float(torch.stack(covered).mean()) < 0.99


def test_the_covariance_is_how_far_calibrations_scatter() -> None:
    found = [calibrate(*simulated(500, 5, seed), MATERIALS, 100) for seed in range(16)]
    scatter = torch.tensor([math.log(one.perceived(0.5)) for one in found]).std()
    no_spread = [Discrimination(one.slope, one.scale, 1e-9, one.covariance, 0.0, 9.0) for one in found]
    said_to_be = torch.tensor([math.log(one.share(0.5).high / one.share(0.5).low) for one in no_spread]).mean() / 3.92
    assert 0.5 < float(said_to_be / scatter) < 2.5


def test_reliability_is_near_the_diagonal_for_what_is_true_and_far_off_for_what_is_not() -> None:
    distances, parts = simulated(6000, 10)
    bins = reliability(distances, parts, MATERIALS, 200)
    assert [one.part for one in bins] == ["triplets"] * 8
    assert all(0.5 <= one.predicted <= 1 and one.low <= one.observed <= one.high for one in bins)
    assert [one.predicted for one in bins] == sorted(one.predicted for one in bins)
    assert mean_error(bins)["triplets"] < 0.04
    # The answers of half of the materials say nothing about those of the rest, if those are turned round.
    own = parts["triplets"]
    generator = torch.Generator().manual_seed(0)
    half = torch.zeros(MATERIALS, dtype=torch.bool)
    half[torch.randperm(MATERIALS, generator=generator)[: MATERIALS // 2]] = True
    turned = torch.where(half[own.materials].all(1)[:, None], own.votes, own.votes.flip(1))
    wrong = {"triplets": Choices(own.first, own.second, turned, own.materials)}
    assert mean_error(reliability(distances, wrong, MATERIALS, 50))["triplets"] > 0.15


def test_the_mean_error_counts_votes() -> None:
    bins = [ReliabilityBin("pairs", 0.6, 0.7, 0, 1, 30), ReliabilityBin("pairs", 0.8, 0.8, 0, 1, 10)]
    assert mean_error([*bins, ReliabilityBin("triplets", 0.5, 0.3, 0, 1, 1)]) == {"pairs": 0.075, "triplets": 0.2}


def test_opinions_become_choices_of_single_observers() -> None:
    opinions = Opinions(["WARD", "SGD", "ABC"], ["nickel"] * 3, torch.tensor([0.5, 0.25, 0.1], dtype=torch.float64))
    triplets = Triplets(["brass", "nickel", "nylon"], torch.tensor([[0, 1, 2]]), torch.tensor([[4, 1]]))
    parts = choices(triplets, opinions, ["brass", "nickel", "nylon"])
    assert (parts["triplets"].first.tolist(), parts["triplets"].second.tolist()) == ([1], [2])
    pairs = parts["pairs"]
    assert (pairs.first.tolist(), pairs.second.tolist(), pairs.materials.tolist()) == ([9 + 1], [9 + 0], [[1]])
    # MOS 3 and 4, with variances 0.2 (MOS - 1) (5 - MOS): 0.8 and 0.6.
    share = float(torch.special.ndtr(torch.tensor(1 / (0.8 + 0.6) ** 0.5, dtype=torch.float64)))
    torch.testing.assert_close(pairs.votes, torch.tensor([[30 * share, 30 * (1 - share)]], dtype=torch.float64))


def test_preference_is_the_model_by_sampling() -> None:
    generator = torch.Generator().manual_seed(1)
    one, other = (
        psi(distance * torch.exp(TRUE.spread * torch.randn(200_000, generator=generator, dtype=torch.float64)))
        for distance in (0.3, 0.6)
    )
    sampled = LAPSE + (1 - 2 * LAPSE) * float(torch.special.ndtr(other - one).mean())
    assert TRUE.prefer(0.3, 0.6) == pytest.approx(sampled, abs=2e-3)
    assert TRUE.prefer(0.3, 0.6) + TRUE.prefer(0.6, 0.3) == pytest.approx(1)
    assert TRUE.prefer(0.4, 0.4) == pytest.approx(0.5)


def test_shares_rise_with_distance_and_so_do_words() -> None:
    order = [words for _, words in LADDER]
    assert [bound for bound, _ in LADDER] == sorted(bound for bound, _ in LADDER) and len(set(order)) == len(order)
    shares = [TRUE.share(0.01 * 1.3**k) for k in range(30)]
    for one, other in pairwise(shares):
        assert one.value < other.value and one.low <= other.low and one.high <= other.high
        assert order.index(one.words) <= order.index(other.words)
    assert all(one.low <= one.value <= one.high for one in shares)
    assert [Share(x, x, x).words for x in MARKS] == [
        "one in ten",
        "one in four",
        "half",
        "three in four",
        "nine in ten",
    ]
    for share in MARKS:
        assert TRUE.share(TRUE.distance(share)).value == pytest.approx(share, abs=1e-6)


def test_what_was_not_asked_is_said() -> None:
    assert TRUE.share(0.01).text.endswith(", beyond what was asked") and TRUE.share(0.01).brief.endswith("*")
    assert TRUE.share(4.0).text.endswith(", beyond what was asked")
    assert "beyond" not in TRUE.share(0.5).text and TRUE.share(0.5).brief == TRUE.share(0.5).text
    assert (TRUE.share(0.0).text, TRUE.share(0.0).words) == ("0 %", "nobody")
    assert (TRUE.share(math.inf).value, TRUE.share(math.inf).asked) == (1, False)
    assert (TRUE.share(math.nan).text, TRUE.share(math.nan).words) == ("unknown", "unknown")
    with pytest.raises(UsageError, match="expected 0 or more"):
        TRUE.share(-1.0)


def test_just_objectionable_differences_are_what_they_are_by_definition() -> None:
    assert JustObjectionable().share(1.0).value == pytest.approx(0.5)
    assert JustObjectionable().share(0.0).value == JustObjectionable().share(-0.1).value == 0
    assert JustObjectionable().distance(0.5) == pytest.approx(1)
    assert isinstance(discrimination_of("jod"), JustObjectionable)
    assert said("jod", 1.0) == "half would tell them apart: 50 %"
    assert scale("jod", "10 - JOD").startswith("10 - JOD: told apart by one in ten at 0.19, ")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_distances_that_are_none_are_refused(bad: float) -> None:
    distances, parts = simulated(50, 5)
    distances[3] = bad
    with pytest.raises(DataError, match="expected finite distances of at least 0, found"):
        calibrate(distances, parts, MATERIALS, 10)


def test_nothing_to_calibrate_with_is_said() -> None:
    distances, parts = simulated(50, 5)
    with pytest.raises(DataError, match="found only 0"):
        calibrate(distances * 0, parts, MATERIALS, 10)
    with pytest.raises(DataError, match="expected choices, found none"):
        calibrate(distances, {"triplets": parts["triplets"].select(torch.zeros(50, dtype=torch.bool))}, MATERIALS, 10)
    assert flat(Distances(torch.zeros(2, 2), None)) is None


@pytest.mark.parametrize(
    "change",
    [{"slope": -1.0}, {"covariance": [[0.1]]}, {"lowest": 5.0}, {"spread": 0.0}, {"spread": 1e300}, {"scale": "a"}],
)
def test_a_file_of_something_else_is_refused_in_one_line(tmp_path: Path, change: dict[str, object]) -> None:
    path = tmp_path / "discrimination.json"
    path.write_text(json.dumps({"metrics": {"learned": vars(TRUE) | change}, "provenance": {}}))
    with pytest.raises(DataError) as caught:
        read_discrimination(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) <= 300


def test_the_bundled_file_is_of_the_bundled_metric() -> None:
    """After another training the file has to be made again: docs/how-to/what-a-number-means.md says how."""
    file = read_discrimination()
    assert file.provenance["probes"][METRIC] == pytest.approx(probe(METRIC), rel=0.01)
    for name in (METRIC, "rendered_delta_e76", "rendered_delta_e2000", "rendered_delta_e_itp"):
        assert file.metrics[name].check and max(file.metrics[name].check.values()) < 0.06
    assert file.metrics[METRIC].check and max(file.metrics[METRIC].check.values()) < 0.04


def test_words_are_found_by_the_name_of_a_difference() -> None:
    assert told_apart("delta_e", 3.0) == told_apart("delta_e76", 3.0) == told_apart("rendered_delta_e76", 3.0)
    assert brief("delta_e76", 3.0).endswith(" %") and "(" in brief("delta_e76", 3.0, interval=True)
    for name in DIFFERENCES:
        if DIFFERENCES[name].higher_is_better:
            assert (brief(name, 30.0), said(name, 30.0), scale(name, name)) == ("", "", "")
    assert brief("delta_e76", math.nan) == said("delta_e76", math.nan) == ""


def test_fits_are_told_apart_the_more_the_worse_they_are() -> None:
    records = read_fits(standins())[:3]
    group = load(standins()).batch([0, 1, 2])
    for record in records:
        record.error = 0.0
    exact, turned = shares_of_fits([group], records), shares_of_fits([group], [records[k] for k in (1, 2, 0)])
    assert all(one is not None and one.value < 0.03 for one in exact)
    assert all(one is not None and one.value > 0.3 for one in turned)
    records[1].error = math.nan
    assert shares_of_fits([group], records)[1] is None


def test_made_up_answers_calibrate() -> None:
    data = synthetic_benchmark(questions=60)
    parts = choices(data.triplets, data.opinions, data.names)
    generator = torch.Generator().manual_seed(0)
    count = len(data.triplets.materials)
    distances = torch.rand(count**2 + len(data.opinions), generator=generator, dtype=torch.float64)
    found = calibrate(distances, parts, len(data.names), 10)  # of distances that say nothing
    assert found.prefer(0.1, 0.9) < 0.6
