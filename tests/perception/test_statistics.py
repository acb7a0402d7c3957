"""Agreement with people: against brute force, scipy, simulation, and figures that others reported."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau

from torchbrdf.bootstrap import percentile_interval, resample_counts
from torchbrdf.errors import UsageError
from torchbrdf.perception import (
    Distances,
    Opinions,
    Triplets,
    read_lagunas,
    read_opinions,
    read_triplets,
    statistics_of,
    tabulate,
)
from torchbrdf.perception.agreement.statistics import (
    across_materials,
    expected_order,
    majorities,
    majority_of_people,
    majority_of_votes,
    same_material,
    single_votes,
)

NAMES = list("abcde")


def some_triplets(seed: int, count: int = 60) -> Triplets:
    generator = torch.Generator().manual_seed(seed)
    questions = torch.rand(count, 5, generator=generator).argsort(1)[:, :3]
    first = torch.randint(0, 5, (count,), generator=generator)
    return Triplets(NAMES, questions, torch.stack([first, 4 - first], 1))


def some_opinions(seed: int, methods: str = "UVWX") -> Opinions:
    generator = torch.Generator().manual_seed(seed)
    rows = list(itertools.product(methods, NAMES))
    distance = torch.rand(len(rows), generator=generator, dtype=torch.float64)
    return Opinions([m for m, _ in rows], [n for _, n in rows], distance)


def matrix(seed: int) -> torch.Tensor:
    return torch.rand(5, 5, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@given(st.integers(0, 1000))
def test_triplets_agree_as_counted_by_hand(seed):
    triplets, away = some_triplets(seed), matrix(seed + 1)
    right = asked = votes = total = 0.0
    for (r, a, b), (for_a, for_b) in zip(triplets.questions.tolist(), triplets.votes.tolist(), strict=True):
        a_is_nearer = bool(away[r, a] < away[r, b])
        if for_a != for_b:
            asked += 1
            right += a_is_nearer == (for_a > for_b)
        votes += for_a if a_is_nearer else for_b
        total += for_a + for_b
    flat = away.flatten()[None]
    for comparisons, expected in ((majorities(triplets), right / asked), (single_votes(triplets), votes / total)):
        assert float(comparisons.agreement_rate(comparisons.concordant(flat))) == pytest.approx(expected, rel=1e-12)


def test_equal_distances_count_half_and_nan_is_wrong():
    comparisons = majorities(some_triplets(0))
    flat = torch.stack([torch.ones(25), torch.full((25,), torch.nan)]).double()
    assert comparisons.agreement_rate(comparisons.concordant(flat)).tolist() == [0.5, 0]


@given(st.integers(0, 1000))
def test_pairs_of_methods_are_kendalls_tau(seed):
    opinions = some_opinions(seed)
    predicted = some_opinions(seed + 1).distance
    comparisons = same_material(opinions)
    found = float(comparisons.agreement_rate(comparisons.concordant(predicted[None])))
    taus = []
    for name in NAMES:
        rows = [k for k, own in enumerate(opinions.materials) if own == name]
        taus.append(kendalltau(opinions.distance[rows], predicted[rows]).statistic)
    assert 2 * found - 1 == pytest.approx(np.mean(taus), abs=1e-12)


@given(st.integers(0, 1000))
def test_materials_under_one_method_are_kendalls_tau(seed):
    opinions = some_opinions(seed)
    predicted = some_opinions(seed + 1).distance
    comparisons = across_materials(opinions)
    found = float(comparisons.agreement_rate(comparisons.concordant(predicted[None])))
    taus = []
    for name in "UVWX":
        rows = [k for k, own in enumerate(opinions.methods) if own == name]
        taus.append(kendalltau(opinions.distance[rows], predicted[rows]).statistic)
    assert 2 * found - 1 == pytest.approx(np.mean(taus), abs=1e-12)


def test_a_method_with_few_materials_counts_as_much_as_others():
    opinions = Opinions(list("UUUVV"), list("abcab"), torch.tensor([0.1, 0.2, 0.3, 0.1, 0.2]).double())
    comparisons = across_materials(opinions)
    wrong_for_v = torch.tensor([[1.0, 2, 3, 2, 1]])
    assert len(comparisons) == 4
    assert float(comparisons.agreement_rate(comparisons.concordant(wrong_for_v))) == 0.5


def test_apart_are_pairs_beyond_two_standard_errors():
    opinions = some_opinions(3)
    error = opinions.standard_error
    expected = {
        frozenset((i, j))
        for i, j in itertools.combinations(range(len(opinions)), 2)
        if opinions.materials[i] == opinions.materials[j]
        and (opinions.distance[i] - opinions.distance[j]).abs() > 2 * (error[i] ** 2 + error[j] ** 2).sqrt()
    }
    found = same_material(opinions, well_separated=True)
    pairs = zip(found.nearer.tolist(), found.farther.tolist(), strict=True)
    assert {frozenset(pair) for pair in pairs} == expected
    assert 0 < len(expected) < len(same_material(opinions))


def test_equal_opinions_are_no_comparison():
    opinions = Opinions(list("UV"), list("aa"), torch.tensor([0.5, 0.5]).double())
    comparisons = same_material(opinions)
    assert len(comparisons) == 0
    with pytest.raises(UsageError, match="no comparisons"):
        comparisons.agreement_rate(comparisons.concordant(torch.zeros(1, 2)))


def test_a_resample_is_what_one_gets_from_copies_of_materials():
    triplets, away = some_triplets(5), matrix(6)
    comparisons = majorities(triplets)
    right = comparisons.concordant(away.flatten()[None])
    resamples = resample_counts(5, 20, seed=1)
    assert resamples.sum(1).tolist() == [5] * 20
    chosen = triplets.select(triplets.decided)
    for times, found in zip(
        resamples.tolist(), comparisons.agreement_rate(right, resamples)[:, 0].tolist(), strict=True
    ):
        copies = [name for name, count in enumerate(times) for _ in range(count)]
        outcomes = [
            float(outcome)
            for question, outcome in zip(chosen.questions.tolist(), right[0], strict=True)
            for own in itertools.product(range(5), repeat=3)
            if [copies[k] for k in own] == question
        ]
        if outcomes:
            assert found == pytest.approx(np.mean(outcomes), rel=1e-12)
        else:
            assert np.isnan(found)


def test_pairs_of_one_material_weigh_by_its_multiplicity_only():
    opinions, predicted = some_opinions(7), some_opinions(8).distance
    comparisons = same_material(opinions)
    right = comparisons.concordant(predicted[None])
    times = torch.tensor([[2, 0, 1, 2, 0]])
    rows = [k for name, count in zip(NAMES, times[0], strict=True) for k in _rows(opinions, name) * int(count)]
    weights = torch.bincount(torch.tensor(rows), minlength=len(opinions)).double()
    own = weights[comparisons.nearer]
    assert float(comparisons.agreement_rate(right, times)) == pytest.approx(float((own * right[0]).sum() / own.sum()))


def _rows(opinions: Opinions, name: str) -> list[int]:
    return [k for k, own in enumerate(opinions.materials) if own == name]


def test_parts_of_a_bootstrap_are_the_whole(monkeypatch):
    comparisons = majorities(some_triplets(1))
    right = comparisons.concordant(torch.stack([matrix(2).flatten(), matrix(3).flatten()]))
    whole = comparisons.agreement_rate(right, resample_counts(5, 50))
    monkeypatch.setattr("torchbrdf.perception.agreement.statistics._HELD", 1)
    assert torch.allclose(
        comparisons.agreement_rate(right, resample_counts(5, 50)), whole, equal_nan=True, rtol=1e-12, atol=0
    )


def test_intervals_are_numpys_percentiles():
    replicates = torch.rand(101, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    expected = np.percentile(replicates.numpy(), [2.5, 97.5], axis=0).T
    assert np.allclose(percentile_interval(replicates).numpy(), expected, rtol=1e-12)


def test_the_interval_covers_what_materials_vary():
    """Outcomes that belong to materials: a share of one kind has the spread of the binomial law."""
    generator = torch.Generator().manual_seed(0)
    hits = 0
    for _ in range(200):
        good = torch.rand(60, generator=generator) < 0.7
        names = [str(k) for k in range(60)]
        opinions = Opinions(["U"] * 60 + ["V"] * 60, names * 2, torch.cat([torch.zeros(60), torch.ones(60)]).double())
        comparisons = same_material(opinions)
        predicted = torch.cat([torch.where(good, 0, 2), torch.ones(60)]).double()
        right = comparisons.concordant(predicted[None])
        low, high = percentile_interval(comparisons.agreement_rate(right, resample_counts(60, 300)))[0].tolist()
        hits += low <= 0.7 <= high
    assert 178 <= hits <= 199  # 95 % of 200; binomial, and percentile intervals of 60 are a little short


def test_ceilings_are_those_of_simulated_people():
    triplets, opinions = some_triplets(2), some_opinions(4)
    votes = single_votes(triplets)
    best = triplets.votes.max(1).values.sum() / triplets.votes.sum()
    assert float(votes.agreement_rate(majority_of_votes(triplets))) == pytest.approx(float(best), rel=1e-6)
    comparisons = same_material(opinions)
    noise = torch.randn(20_000, len(opinions), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    asked = opinions.distance + noise * opinions.standard_error
    simulated = float(comparisons.agreement_rate(comparisons.concordant(asked)).mean())
    assert float(comparisons.agreement_rate(expected_order(comparisons, opinions))) == pytest.approx(
        simulated, abs=0.003
    )


def test_the_ceiling_of_majorities_is_that_of_people_with_beta_distributed_shares():
    source = np.random.default_rng(5)
    for spread in (0.5, 3.0):
        share = source.beta(spread, spread, 6000)
        first = source.binomial(5, share)
        questions = torch.tensor([[0, 1, 2]]).repeat(len(share), 1)
        asked = Triplets(NAMES, questions, torch.from_numpy(np.stack([first, 5 - first], 1)))
        known = (share > 0.5) == (first > 2.5)  # what one who knows the shares says, and what the votes say
        comparisons = majorities(asked)
        ceiling = float(comparisons.agreement_rate(majority_of_people(asked)))
        assert ceiling == pytest.approx(known.mean(), abs=0.012)
        assert majority_of_people(asked).shape == (1, len(comparisons))
    certain = Triplets(NAMES, questions[:50], torch.tensor([[5, 0]]).repeat(50, 1))
    assert float(majority_of_people(certain).min()) > 0.99


def test_a_table_has_values_intervals_and_paired_differences():
    triplets = some_triplets(9, 400)
    opinions = some_opinions(10, "UVW")
    columns = statistics_of(triplets, opinions, odd=("W",), close=())
    every = ("pairs", "apart", "across")
    assert [one.key for one in columns if not one.key.startswith("across_without")] == [
        *("majority", "votes", *every),  # without one of the two there are no pairs
        *(f"{key}_with_w" for key in every),
    ]
    good, bad = opinions.distance, -opinions.distance
    scored = {"good": Distances(matrix(1), good), "bad": Distances(-matrix(1), bad), "half": Distances(matrix(1), None)}
    table = tabulate(columns, scored, 300)
    count = len(columns) - 2
    assert table.value[0, 2:].tolist() == [1] * count and table.value[1, 2:].tolist() == [0] * count
    assert table.value[0, :2].tolist() == pytest.approx((1 - table.value[1, :2]).tolist())
    assert bool(table.value[2, 2:].isnan().all()) and torch.equal(table.value[2, :2], table.value[0, :2])
    assert bool((table.low <= table.value)[:2].all()) and bool((table.value <= table.high)[:2].all())
    assert bool((table.ceiling > 0.5).all())
    value, low, high = table.difference("good", "half")
    assert value[:2].tolist() == low[:2].tolist() == high[:2].tolist() == [0, 0]  # paired: the same is never different
    value, low, high = table.difference("good", "bad")
    assert value[2:].tolist() == low[2:].tolist() == high[2:].tolist() == [1] * count
    records = table.records()
    assert len(records) == 2 * len(columns) + 2 and {record["loss"] for record in records} == set(scored)
    again = tabulate(columns, scored, 300)
    for name in ("value", "low", "high", "ceiling_low", "replicates"):
        torch.testing.assert_close(getattr(again, name), getattr(table, name), rtol=0, atol=0, equal_nan=True)
    other = tabulate(columns, scored, 300, seed=1)
    assert not torch.equal(other.replicates.nan_to_num(), table.replicates.nan_to_num())
    lines = table.text().splitlines()
    assert len(lines) == 5 and lines[0].split()[::2] == ["triplets", "votes", *every]
    best = ["good", "half", "bad"] if float(table.value[0, 0]) > 0.5 else ["bad", "good", "half"]
    assert [line.split()[0] for line in lines[1:4]] == best and [table.losses[k] for k in table.ranked] == best
    by = {line.split()[0]: line for line in lines}
    assert by["good"].count("1.000 (1.000 to 1.000)") == 3 and by["half"].split()[-3:] == ["none"] * 3


def test_each_method_is_left_out_once_and_those_that_are_apart_are_added_alone():
    triplets, opinions = some_triplets(9, 400), some_opinions(10, "UVWX")
    columns = {one.key: one for one in statistics_of(triplets, opinions, odd=("X", "Y"), close=("U",))}
    every = ("pairs", "apart", "across")
    varied = [
        *("pairs_without_u", "apart_without_u"),
        *(f"{key}_without_{out}" for out in "vw" for key in every),
        *("across_with_u", "pairs_with_x", "apart_with_x", "across_with_x"),
    ]
    assert list(columns) == ["majority", "votes", *every, *varied]
    methods = {
        "pairs": "UVW", "across": "VW", "pairs_without_u": "VW", "pairs_without_w": "UV", "across_without_w": "V",
        "across_with_u": "UVW", "pairs_with_x": "UVWX", "across_with_x": "VWX",
    }  # fmt: skip
    predicted = some_opinions(11, "UVWX").distance
    table = tabulate(list(columns.values()), {"some": Distances(None, predicted)}, 50)
    for key, chosen in methods.items():
        rows = [row for row, method in enumerate(opinions.methods) if method in chosen]
        of = across_materials if key.startswith("across") else same_material
        own = of(opinions.select(rows))
        share = own.agreement_rate(own.concordant(predicted[rows][None]))
        assert float(table.value[0, list(columns).index(key)]) == pytest.approx(float(share), rel=1e-12)
        assert columns[key].main == key.split("_")[0] and columns[key].variant.replace(" ", "_").lower() == "_".join(
            key.split("_")[1:]
        )


def test_what_others_computed_on_measured_tables(data):
    """Majority agreement of the distances by Lagunas et al., and the ceiling of single votes."""
    triplets = read_triplets(data / "human" / "lagunas2019_triplets_train.json")
    found = read_lagunas(data / "human" / "lagunas2019_merl_distances.mat")
    comparisons = majorities(triplets)
    assert len(comparisons) == 22_801 - 1395
    share = comparisons.agreement_rate(comparisons.concordant(torch.stack([own.flatten() for own in found.values()])))
    agreement = dict(zip(found, share.tolist(), strict=True))
    assert agreement["rms"] == pytest.approx(0.645, abs=5e-4)
    assert agreement["rms_cos"] == pytest.approx(0.645, abs=5e-4)
    assert agreement["rms_cos_cube"] == pytest.approx(0.665, abs=5e-4)
    votes = single_votes(triplets)
    assert float(votes.agreement_rate(majority_of_votes(triplets))) == pytest.approx(0.838, abs=5e-4)


def test_how_much_people_disagree_about_approximations(data):
    """Over all methods of the file."""
    opinions = read_opinions(data / "human" / "lavoue2021_distances_train.csv")
    asked = (same_material(opinions), same_material(opinions, well_separated=True), across_materials(opinions))
    found = [float(comparisons.agreement_rate(expected_order(comparisons, opinions))) for comparisons in asked]
    assert found == pytest.approx([0.937, 0.998, 0.92], abs=0.01)
