"""Learning a metric from answers: the training set, the likelihood, cross-validation, and the recipe."""

from dataclasses import replace

import pytest
import torch
from scipy.stats import norm

from torchbrdf.errors import DataError
from torchbrdf.losses import LearnedLoss, RMSLoss
from torchbrdf.perception import evaluate_brdfs, uniform_pairs
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
from torchbrdf.perception.learning.training import (
    LAPSE,
    LOG_SLOPES,
    PART_WEIGHT,
    Split,
    baseline_distances,
    constant_intervals,
    constants_by_name,
    held_out,
    negative_log_likelihood,
    select_judgments,
    splits,
    train,
)
from torchbrdf.perception.learning.training_set import make_training_set, merge_training_sets, training_set_from_choices

DATA = synthetic_benchmark(questions=200)
BRDFS = evaluate_brdfs(DATA, uniform_pairs(300))
TRAINING_SET = make_training_set(DATA, BRDFS)
GIVEN = (0.15, 0.2)
ALL = Split("all", torch.ones(len(TRAINING_SET.names), dtype=torch.bool))


def test_distances_of_a_training_set_are_those_of_the_loss() -> None:
    constants = train(TRAINING_SET, ALL, GIVEN).constants
    loss = LearnedLoss(reduction="none", weights={"constants": constants_by_name(constants)})
    found = baseline_distances(TRAINING_SET, BRDFS, {"learned": loss})["learned"]
    torch.testing.assert_close(found, TRAINING_SET.terms @ constants, rtol=1e-3, atol=1e-6)  # four digits
    assert float(found[TRAINING_SET.method < 0].mean()) == pytest.approx(1, rel=1e-3)


def test_comparisons_are_those_of_the_statistics() -> None:
    """A question of the triplets, a pair of opinions, found again among the training set's places."""
    triplets, opinions = DATA.triplets, DATA.opinions
    judgments = TRAINING_SET.judgments["triplets"]
    for k in (0, 17, 199):
        reference, a, b = triplets.questions[k].tolist()
        for place, candidate in ((judgments.first[k], a), (judgments.second[k], b)):
            assert {int(TRAINING_SET.first[place]), int(TRAINING_SET.second[place])} == {reference, candidate}
        assert float(judgments.share[k]) == triplets.votes[k, 0] / triplets.votes[k].sum()
    pairs = TRAINING_SET.judgments["pairs"]
    for k in range(len(pairs)):
        one, other = (int(TRAINING_SET.first[place]) for place in (pairs.first[k], pairs.second[k]))
        assert opinions.materials[one] == opinions.materials[other] and opinions.methods[one] != opinions.methods[other]
        assert opinions.distance[one] < opinions.distance[other] and 0.5 < float(pairs.share[k]) <= 1
    assert {TRAINING_SET.methods[int(k)] for k in TRAINING_SET.method[TRAINING_SET.method >= 0]} == set(
        opinions.methods
    )


def test_the_mismatch_is_thurstones() -> None:
    generator = torch.Generator().manual_seed(1)
    constants = torch.rand(TRAINING_SET.terms.shape[1], generator=generator, dtype=torch.float64)
    slopes = torch.tensor([1.3, 7.2], dtype=torch.float64)
    distance, expected = TRAINING_SET.terms @ constants, 0.0
    for part, own in TRAINING_SET.judgments.items():
        slope = float(slopes[0 if part == "triplets" else 1])
        total = 0.0
        for k in range(len(own)):
            z = max(-6.0, min(6.0, slope * float(distance[own.second[k]] - distance[own.first[k]])))
            p = LAPSE + (1 - 2 * LAPSE) * norm.cdf(z)
            share = float(own.share[k])
            total -= float(own.count[k]) * (share * _log(p) + (1 - share) * _log(1 - p))
        expected += PART_WEIGHT[part] * total / float(own.count.sum())
    found = negative_log_likelihood(TRAINING_SET, TRAINING_SET.judgments, constants, slopes)
    assert float(found) == pytest.approx(expected, rel=1e-10)


def _log(p: float) -> float:
    return float(torch.tensor(p, dtype=torch.float64).log())


def test_its_gradient_is_right_and_finite_where_two_are_equal() -> None:
    slopes = torch.tensor([1.0, 2.0], dtype=torch.float64)
    equal = replace(TRAINING_SET, terms=TRAINING_SET.terms * 0)
    constants = torch.ones(TRAINING_SET.terms.shape[1], dtype=torch.float64, requires_grad=True)
    mismatch = negative_log_likelihood(equal, equal.judgments, constants, slopes)
    (slope,) = torch.autograd.grad(mismatch, constants)
    assert bool(slope.isfinite().all())
    assert torch.autograd.gradcheck(
        lambda x: negative_log_likelihood(TRAINING_SET, TRAINING_SET.judgments, x, slopes), constants
    )


def test_training_finds_the_likeliest_constants_with_the_share_that_is_set() -> None:
    """Nothing near them is likelier, and one of other votes is other."""
    for given in ((0.1, 0.1), GIVEN, (0.3, 0.4)):
        found = train(TRAINING_SET, ALL, given)
        parts = (TRAINING_SET.terms * found.constants)[TRAINING_SET.method < 0].mean(0)
        assert float(found.constants.min()) >= 0 and float(parts.sum()) == pytest.approx(1)
        assert parts[-2:].tolist() == pytest.approx(given)

        def mismatch(x: torch.Tensor, given=given) -> float:
            """Of shares of all but the last term and logarithms of slopes."""
            *free, one, other = x
            whole = torch.tensor([*free, *given], dtype=torch.float64)
            scale = TRAINING_SET.terms[TRAINING_SET.method < 0].mean(0)
            slopes = torch.stack([one, other]).exp()
            return float(negative_log_likelihood(TRAINING_SET, TRAINING_SET.judgments, whole / scale, slopes))

        best = torch.cat([parts[:-2], found.slopes.log()])
        least = mismatch(best)
        assert least == pytest.approx(float(found.mismatch[0]), rel=1e-6)
        generator = torch.Generator().manual_seed(0)
        for _ in range(50):
            step = 0.1 * torch.randn(len(best), generator=generator, dtype=torch.float64)
            free = (best + step)[:-2].clamp_min(1e-9)
            near = torch.cat([free * (1 - sum(given)) / free.sum(), (best + step)[-2:].clamp(*LOG_SLOPES)])
            assert mismatch(near) > least - 1e-7
    again = train(TRAINING_SET, ALL, GIVEN)
    assert torch.equal(again.constants, train(TRAINING_SET, ALL, GIVEN).constants)


def test_known_constants_are_found_again() -> None:
    """From votes drawn with them."""
    scale = TRAINING_SET.terms[TRAINING_SET.method < 0].mean(0)
    truth = torch.tensor([0.5, 0.15, *GIVEN], dtype=torch.float64) / scale
    distance, own = TRAINING_SET.terms @ truth, TRAINING_SET.judgments["triplets"]
    chance = LAPSE + (1 - 2 * LAPSE) * torch.special.ndtr(2 * (distance[own.second] - distance[own.first]))
    asked = replace(TRAINING_SET, judgments={"triplets": replace(own, share=chance)})
    found = train(asked, ALL, GIVEN)
    torch.testing.assert_close(found.constants * scale, truth * scale, rtol=0.02, atol=0.01)
    assert float(found.slopes[0]) == pytest.approx(2, rel=0.02)


def test_answers_that_go_against_all_differences_still_give_a_metric() -> None:
    own = TRAINING_SET.judgments["triplets"]
    farther = (TRAINING_SET.terms.sum(1)[own.first] > TRAINING_SET.terms.sum(1)[own.second]).double()
    asked = replace(TRAINING_SET, judgments={"triplets": replace(own, share=farther)})
    found = train(asked, ALL, GIVEN)
    assert bool(found.constants.isfinite().all()) and bool((found.constants >= 0).all()) and found.constants.any()


def test_intervals_of_constants_hold_them() -> None:
    found = constants_by_name(train(TRAINING_SET, ALL, GIVEN).constants)
    ends = constant_intervals(TRAINING_SET, GIVEN, 20, seed=0)
    assert ends == constant_intervals(TRAINING_SET, GIVEN, 20, seed=0) != constant_intervals(TRAINING_SET, GIVEN, 20, 1)
    for name in found:
        low, high = ends[name]
        assert low <= high and low * 0.5 <= found[name] <= high * 2


def test_a_material_that_is_drawn_twice_counts_twice() -> None:
    times = torch.ones(len(TRAINING_SET.names))
    times[2], times[3] = 2, 0
    for own in TRAINING_SET.judgments.values():
        chosen = select_judgments(TRAINING_SET, own, Split("drawn", times), seen=True)
        assert not bool((chosen.materials == 3).any())
        twice = (chosen.materials == 2).any(1)
        before = own.select(~(own.materials == 3).any(1))
        torch.testing.assert_close(chosen.count, before.count * torch.where(twice, 2.0, 1.0).double())


def test_a_split_does_not_look_at_what_it_is_judged_on() -> None:
    every = list(splits(TRAINING_SET, 2, seed=3))
    methods = len(TRAINING_SET.methods)
    assert len(every) == 4 + 2 * (methods + methods * (methods - 1) // 2)
    assert torch.equal(every[0].materials, ~next(s for s in every if s.name == "half-0-1").materials)
    ends = torch.tensor([True])
    for split in every:
        without = torch.tensor(split.without, dtype=torch.long)
        for own in TRAINING_SET.judgments.values():
            seen, unseen = (select_judgments(TRAINING_SET, own, split, seen=x) for x in (True, False))
            assert bool(torch.cat([split.materials, ends])[seen.materials].all())
            assert not bool(torch.cat([split.materials, ~ends])[unseen.materials].any())
            absent = [
                torch.isin(TRAINING_SET.method[torch.stack([part.first, part.second])], without).sum(0)
                for part in (seen, unseen)
            ]
            assert not absent[0].any() and bool((absent[1] >= len(without)).all())
    # Answers about what is held out do not change what is learned.
    split = every[0]
    other = dict(TRAINING_SET.judgments)
    judgments = other["triplets"]
    mixed = ~split.materials[judgments.materials].all(1)
    other["triplets"] = type(judgments)(
        judgments.first,
        judgments.second,
        torch.where(mixed, 1 - judgments.share, judgments.share),
        judgments.count,
        judgments.materials,
    )
    turned = replace(TRAINING_SET, judgments=other)
    assert torch.equal(train(turned, split, GIVEN).constants, train(TRAINING_SET, split, GIVEN).constants)


def test_what_is_held_out_is_counted_right() -> None:
    """By hand: the mean over splits of whether a comparison of unseen materials is ordered right."""
    every = [split for split in splits(TRAINING_SET, 2, seed=3) if not split.without]
    judged = [(split, train(TRAINING_SET, split, GIVEN).constants) for split in every]
    others = baseline_distances(TRAINING_SET, BRDFS, {"rms": RMSLoss(reduction="none")})
    found = held_out(TRAINING_SET, judged, others, replicates=50)
    own = TRAINING_SET.statistics["majority"]
    shares, theirs = [], []
    for k in range(len(own)):
        right = [
            float(TRAINING_SET.terms[own.nearer[k]] @ constants < TRAINING_SET.terms[own.farther[k]] @ constants)
            for split, constants in judged
            if not bool(split.materials[own.materials[k]].any())
        ]
        if right:
            shares.append(sum(right) / len(right))
            theirs.append(float(others["rms"][own.nearer[k]] < others["rms"][own.farther[k]]))
    mine, rms = found["majority"]["learned"], found["majority"]["rms"]
    assert mine["share"][0] == pytest.approx(sum(shares) / len(shares))
    assert rms["share"][0] == pytest.approx(sum(theirs) / len(theirs))
    assert rms["gain"][0] == pytest.approx(mine["share"][0] - rms["share"][0])
    assert mine["share"][1] <= mine["share"][0] <= mine["share"][2] and mine["gain"] == [0, 0, 0]


def test_training_sets_are_merged() -> None:
    reverse = replace(TRAINING_SET, names=TRAINING_SET.names[::-1])  # the same answers about others
    both = merge_training_sets([TRAINING_SET, reverse])
    assert both.names == TRAINING_SET.names and both.methods == TRAINING_SET.methods
    assert len(both.terms) == 2 * len(TRAINING_SET.terms)
    for name, own in TRAINING_SET.judgments.items():
        part, count = both.judgments[name], len(own)
        assert torch.equal(part.first[count:], own.first + len(TRAINING_SET.terms))
        turned = torch.where(own.materials < 0, -1, len(TRAINING_SET.names) - 1 - own.materials)
        assert torch.equal(part.materials[count:], turned)
    for name, own in TRAINING_SET.statistics.items():
        there = both.statistics[name].materials[len(own) :]
        assert torch.equal(there < 0, own.materials < 0)


def test_choices_become_a_training_set() -> None:
    votes = torch.tensor([[3, 1], [2, 2], [0, 4]])
    pairs = torch.tensor([[0, 1], [0, 2], [1, 2]])
    stimuli = list(DATA.opinions.methods)
    own = training_set_from_choices(TRAINING_SET.names, stimuli, BRDFS, pairs, votes)
    judgments, counted = own.judgments["choices"], own.statistics["choices"]
    assert judgments.share.tolist() == [0.75, 0.5, 0] and judgments.count.tolist() == [4, 4, 4]
    assert counted.nearer.tolist() == [0, 2] and counted.farther.tolist() == [1, 1]
    with pytest.raises(DataError, match="expected choices, found none"):
        training_set_from_choices(TRAINING_SET.names, stimuli, BRDFS, pairs[:0], votes[:0])
