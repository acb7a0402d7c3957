"""The learned metric: what holds for it beside what every loss keeps to (test_losses.py)."""

import copy
import json
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.known_models import Made
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchbrdf import fit
from torchbrdf.errors import DataError, UsageError
from torchbrdf.lobes import Lambert, Sum, Ward, make_model
from torchbrdf.losses import LOSSES, LearnedLoss
from torchbrdf.losses.bins import BIN_COUNT, soft_bins
from torchbrdf.losses.metric_file import CONSTANTS, LARGEST_CONSTANT, read_metric
from torchbrdf.measured import load, standins
from torchbrdf.measured.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.perception import uniform_pairs

PAIRS = uniform_pairs(2000)


def glossy(roughness: float, specular: float = 0.2, diffuse: float = 0.3, pairs: Pairs = PAIRS) -> Tensor:
    with torch.no_grad():
        ward = Ward(specular=[specular] * 3, roughness=roughness, dtype=torch.float64)
        return Sum(Lambert(albedo=[diffuse, diffuse / 2, diffuse / 3], dtype=torch.float64), ward)(pairs)


def distance(one: Tensor, other: Tensor, pairs: Pairs = PAIRS, weight: Tensor | None = None, **options: Any) -> float:
    return float(LearnedLoss(reduction="none", **options)(one, other, pairs, weight))


def changed(**constants: float) -> dict[str, Any]:
    """A metric with these constants, and 0 in the place of the others."""
    return {"constants": dict.fromkeys(CONSTANTS, 0.0) | constants}


materials = st.builds(glossy, st.floats(0.02, 0.5), st.floats(0.01, 0.9), st.floats(0.001, 0.9))


@given(materials, materials, materials)
@settings(max_examples=30, deadline=None)
def test_it_is_a_metric(a: Tensor, b: Tensor, c: Tensor) -> None:
    assert distance(a, a) == 0
    assert distance(a, b) == distance(b, a)
    assert distance(a, c) <= distance(a, b) + distance(b, c) + 1e-12


def test_it_grows_along_paths() -> None:
    """Away from a material: rougher, brighter, more strongly coloured."""
    base = glossy(0.1)
    rougher = [distance(base, glossy(x)) for x in (0.1, 0.12, 0.15, 0.2, 0.3)]
    brighter = [distance(base, base * x) for x in (1.0, 1.1, 1.3, 1.8, 3.0)]
    redder = [distance(base, base * torch.tensor([x, 1, 1 / x])) for x in (1.0, 1.1, 1.3, 1.8, 3.0)]
    for found in (rougher, brighter, redder):
        assert found[0] == 0 and np.diff(found).min() > 0


def test_terms_times_constants_are_the_distance() -> None:
    """And so, what one of them is alone."""
    one, other = glossy(0.1), glossy(0.3, 0.1, 0.2)
    terms = LearnedLoss().terms(one, other, PAIRS)
    assert terms.shape == (len(CONSTANTS),) and terms.dtype == torch.float64
    constants = read_metric(None)["constants"]
    own = torch.tensor([constants[name] for name in CONSTANTS], dtype=torch.float64)
    assert float(terms @ own) == pytest.approx(distance(one, other), rel=1e-12)
    for k, name in enumerate(CONSTANTS):
        assert distance(one, other, weights=changed(**{name: 2.0})) == pytest.approx(2 * float(terms[k]), rel=1e-12)


def test_what_each_term_sees() -> None:
    """Brightness is no gloss, gloss no colour, a coloured lobe is in its bins; single errors cancel in a bin."""
    base = glossy(0.1)
    gloss, chroma, bins, single = LearnedLoss().terms(2 * base, base, PAIRS).tolist()
    assert single == pytest.approx(np.log(2), rel=0.1) and bins == pytest.approx(np.log(2), rel=0.1)
    assert gloss < 0.05 and chroma > 0  # a colour twice as bright is more of it
    light = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    grey = (base @ light)[:, None].expand(-1, 3)
    gloss, chroma, bins, _ = LearnedLoss().terms(grey, base, PAIRS).tolist()
    assert gloss < 1e-12 and chroma > 0.03 and bins > 0.1
    gloss, chroma, _, _ = LearnedLoss().terms(glossy(0.1, specular=0.4), base, PAIRS).tolist()
    assert gloss > 0.4 and chroma < 0.02
    lobe = glossy(0.05, diffuse=0.0)
    green = lobe * torch.tensor([0.5, (1 - 0.5 * (1 - 0.7152)) / 0.7152, 0.5])  # of the same luminance
    gloss, _, bins, _ = LearnedLoss().terms(base + green, base + lobe, PAIRS).tolist()
    assert gloss < 1e-3 and bins > 0.05
    sign = torch.where(torch.arange(2000) % 2 == 0, 1.2, 0.8).double()[:, None]
    gloss, _, bins, single = LearnedLoss().terms(base * sign, base, PAIRS).tolist()
    assert single > 0.15 and max(gloss, bins) < 0.1


def test_a_bin_is_compared_by_the_length_over_channels() -> None:
    """Not channel by channel, which let fits end at another median in each, with a tinted highlight."""
    grey = glossy(0.1)[:, 1:2].expand(-1, 3)

    def bins(*factors: float) -> float:
        return float(LearnedLoss().terms(grey * torch.tensor(factors), grey, PAIRS)[2])

    assert bins(1.3, 1.0, 1.0) == pytest.approx(bins(1.3, 1.3, 1.3) / 3**0.5, rel=1e-9)
    assert bins(1.3, 1.3, 1.0) == pytest.approx(bins(1.3, 1.3, 1.3) * (2 / 3) ** 0.5, rel=1e-9)


def test_the_docstring_has_the_constants_that_come_with_it() -> None:
    said = dict(re.findall(r"w\d  (\w+) +([\d.]+)", LearnedLoss.__doc__ or ""))
    assert {name: float(value) for name, value in said.items()} == read_metric(None)["constants"]
    assert list(read_metric(None)["constants"]) == list(CONSTANTS)


def test_a_scale_is_a_factor_of_both() -> None:
    one, other = glossy(0.1), glossy(0.2)
    assert distance(one / 50, other / 50, scale=50.0) == pytest.approx(distance(one, other), rel=1e-12)
    assert distance(one / 50, other / 50) < 0.95 * distance(one, other)
    assert repr(LearnedLoss(scale=50.0)) == "LearnedLoss(scale=50.0)"
    for scale in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match=r"^LearnedLoss: scale: expected a factor above 0, found "):
            LearnedLoss(scale=scale)


def test_other_pairs_give_nearly_the_same() -> None:
    """Another draw; and another density with the weights that make up for it, but not without them."""
    lobe, other = (Ward(specular=[0.2] * 3, roughness=x, dtype=torch.float64) for x in (0.1, 0.2))

    def between(pairs: Pairs, weight: Tensor | None = None) -> float:
        with torch.no_grad():
            return distance(lobe(pairs), other(pairs), pairs, weight)

    expected = between(uniform_pairs(200_000, seed=1))
    assert between(uniform_pairs(6000, seed=2)) == pytest.approx(expected, rel=0.03)
    many = uniform_pairs(200_000, seed=3)
    often = torch.rand(200_000, generator=torch.Generator().manual_seed(4), dtype=torch.float64) < many.cos_i
    chosen = many.select(samples=often.nonzero()[:, 0])
    assert between(chosen, (1 / chosen.cos_i)[:, None]) == pytest.approx(expected, rel=0.02)


def test_bins_share_every_pair() -> None:
    bins = soft_bins(PAIRS)
    assert bins.shape == (2000, BIN_COUNT) and float(bins.min()) >= 0
    torch.testing.assert_close(bins.sum(-1), torch.ones(2000, dtype=torch.float64))


def test_bins_without_pairs_add_nothing() -> None:
    """No gloss without a body, no colour beside the highlight where there is only that; means are of what is there."""
    angles = torch.full((40,), 1.0, dtype=torch.float64)

    def between(*theta_h: float) -> list[float]:
        high = torch.tensor(theta_h, dtype=torch.float64).repeat(40 // len(theta_h))
        around = torch.arange(40.0).double()
        pairs = Pairs.from_half_diff(*(x.deg2rad() for x in (high, 25 * angles, around)))
        return LearnedLoss().terms(glossy(0.1, pairs=pairs), glossy(0.2, pairs=pairs), pairs).tolist()

    gloss, chroma, bins, single = between(0.0)
    assert gloss == chroma == 0 and single > 0.5 and bins == pytest.approx(single, rel=0.2)
    gloss, chroma, *_ = between(0.0, 35.0)
    assert gloss > 0.5 and chroma > 0
    gloss, chroma, *_ = between(15.0, 35.0)
    assert gloss == 0 and chroma > 0


@pytest.mark.parametrize("channels", [1, 2, 3, 5])
def test_any_number_of_channels(channels: int) -> None:
    """Gray is gray in any; one channel has no chroma; a channel without weight is as if it were not there."""
    one, other = (glossy(x)[:, 1:2].expand(-1, channels) for x in (0.1, 0.2))
    terms = LearnedLoss().terms(one, other, PAIRS)
    torch.testing.assert_close(terms, LearnedLoss().terms(one[:, :1], other[:, :1], PAIRS), atol=1e-12, rtol=1e-12)
    assert float(terms[1]) < 1e-12
    if channels != 3:  # of three, each has its own share in luminance
        weight = torch.tensor([[1.0] * channels + [0.0]], dtype=torch.float64)
        more = [torch.cat([x, 5 * x[:, :1].square()], 1) for x in (one, other)]
        if channels + 1 != 3:
            torch.testing.assert_close(LearnedLoss().terms(*more, PAIRS, weight), terms, atol=1e-12, rtol=1e-12)


def test_black_is_far_from_white_and_equal_to_black() -> None:
    black, white = torch.zeros(2000, 3).double(), torch.full((2000, 3), 1 / np.pi).double()
    assert distance(black, black) == 0 == distance(-white, black)
    assert 0.5 < distance(white, black) < 10


def test_gradients_are_finite_at_equal_values_and_twice() -> None:
    target = glossy(0.1)
    point = target.clone().requires_grad_()
    loss = LearnedLoss()
    (gradient,) = torch.autograd.grad(loss(point, target, PAIRS), point, create_graph=True)
    assert not gradient.any()
    point = (1.3 * target[:50]).requires_grad_()
    pairs = PAIRS.select(samples=slice(50))
    weight = torch.rand(50, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert torch.autograd.gradgradcheck(lambda x: loss(x, target[:50], pairs, weight), point)


def test_it_comes_by_name_and_says_where_it_is_from() -> None:
    loss = LOSSES["learned"]()
    assert isinstance(loss, LearnedLoss) and loss.registered_name == "learned"
    assert {"learned_from", "held_out"} <= set(loss.provenance)
    assert "10.1145/3306346.3323036" in json.dumps(loss.provenance)


def test_constants_of_ones_own(tmp_path: Path) -> None:
    four = {"constants": {name: 4 * value for name, value in read_metric(None)["constants"].items()}}
    path = tmp_path / "metric.json"
    path.write_text(json.dumps(four))
    one, other = glossy(0.1), glossy(0.2)
    for weights in (path, str(path), four):
        loss = LearnedLoss(reduction="none", weights=weights)
        assert float(loss(one, other, PAIRS)) == pytest.approx(4 * distance(one, other), rel=1e-9)


NAMES = ", ".join(CONSTANTS)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.pop("constants"), f"expected constants {NAMES}; found none"),
        (
            lambda d: d.update(weights={"pointwise": [1.0] * 5}) or d.pop("constants"),
            f"expected constants {NAMES}; found the weights of an older form: train it again",
        ),
        (lambda d: d.update(epsilon=1.0), "epsilon: expected 0.001, found 1.0"),
        (lambda d: d.update(theta_h=[0, 90]), r"theta_h: expected .*, found \[0.0, 90.0\]"),
        (lambda d: d.update(provenance="mine"), "expected a learned metric, .* got `str` - at `\\$.provenance`"),
        (lambda d: d.update(provenance=["mine"]), "expected a learned metric, .* got `array` - at `\\$.provenance`"),
        (lambda d: d["constants"].pop("gloss"), f"constants: expected {NAMES}; found 'chroma, bins, pointwise'"),
        (
            lambda d: d["constants"].update(more=1.0),
            f"constants: expected {NAMES}; found 'gloss, chroma, bins, pointwise, m",
        ),
        (lambda d: d["constants"].update(gloss=-1.0), r"constants: gloss: expected 0 to 1e\+20, found -1.0"),
        (lambda d: d["constants"].update(gloss=1e300), r"constants: gloss: expected 0 to 1e\+20, found 1e\+300"),
        (lambda d: d["constants"].update(gloss=10**400), "expected a learned metric, .*where a finite number"),
        (lambda d: d["constants"].update(gloss=float("nan")), r"expected a learned .*nan at `\$.constants.gloss`"),
        (lambda d: d.update(constants="much"), "expected a learned metric, .*got `str`"),
        (lambda d: d.update(constants=dict.fromkeys(CONSTANTS, 0.0)), "expected a constant above 0, found none"),
    ],
)
def test_bad_constants_are_refused(change, said: str, tmp_path: Path) -> None:
    data = copy.deepcopy(dict(read_metric(None)))
    change(data)
    path = tmp_path / "metric.json"
    path.write_text(json.dumps(data))
    with pytest.raises(DataError, match=f"^{path}: {said}") as caught:
        LearnedLoss(weights=path)
    assert len(str(caught.value)) <= 300 and "\n" not in str(caught.value)
    if "JSON" not in said and "range" not in said:
        with pytest.raises(DataError, match=r"^weights: "):
            LearnedLoss(weights=data)


def test_deep_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "metric.json").write_text('{"provenance": {"a": ' + "[" * 100_000)
    with pytest.raises(DataError, match=r"metric.json: expected a learned metric, .*, found JSON that is nested too"):
        LearnedLoss(weights=tmp_path / "metric.json")


def test_the_largest_constants_give_finite_distances() -> None:
    largest = {"constants": dict.fromkeys(CONSTANTS, LARGEST_CONSTANT)}
    one, other = torch.zeros(1, len(PAIRS), 3), torch.full((1, len(PAIRS), 3), 1e10)
    pairs = PAIRS.to(dtype=torch.float32)
    assert LearnedLoss(reduction="none", weights=largest)(one, other, pairs).isfinite().all()


@given(st.text(max_size=60) | st.recursive(st.none() | st.floats() | st.text(), st.lists).map(json.dumps))
@settings(max_examples=60, deadline=None)
def test_whatever_a_file_holds_is_a_metric_or_an_error(tmp_path_factory, text: str) -> None:
    path = tmp_path_factory.mktemp("metric") / "metric.json"
    path.write_text(text, encoding="utf-8", errors="replace")
    with pytest.raises(DataError, match=r"metric\.json: expected"):
        LearnedLoss(weights=path)


def test_copies_do_not_carry_pairs() -> None:
    loss = LearnedLoss(reduction="none")
    one, other = glossy(0.1), glossy(0.2)
    expected = loss(one, other, PAIRS)
    empty = len(pickle.dumps(LearnedLoss()))
    assert loss.comparison(PAIRS, None, one) is loss.comparison(PAIRS, None, one)
    for same in (copy.deepcopy(loss), pickle.loads(pickle.dumps(loss))):
        assert len(pickle.dumps(same)) <= empty + 8
        assert torch.equal(same(one, other, PAIRS), expected)


def test_what_is_kept_belongs_to_these_pairs() -> None:
    loss, others = LearnedLoss(reduction="none"), uniform_pairs(2000, seed=5)
    one, other = glossy(0.1), glossy(0.2)
    first = loss(one, other, PAIRS)
    assert loss(one, other, others) != first
    assert loss(one, other, PAIRS) == first
    weight = torch.rand(2000, 1, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    assert float(loss(one, other, PAIRS, weight)) == distance(one, other, PAIRS, weight)
    before = loss(one, other, PAIRS, weight)
    weight *= torch.rand(2000, 1, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    assert loss(one, other, PAIRS, weight) == distance(one, other, PAIRS, weight) != before
    changed = other.clone()
    before = loss(one, changed, PAIRS)
    changed *= 1.5
    assert loss(one, changed, PAIRS) == distance(one, changed) != before
    single = loss(one.float(), other.float(), PAIRS.to(dtype=torch.float32))
    assert single.dtype == torch.float32 and float(single) == pytest.approx(float(first), rel=1e-4)


def test_a_fit_finds_what_values_were_made_with() -> None:
    """Global, by Gauss-Newton, in one batch with a material that has holes."""
    model = make_model("ward", lobes=1)
    pairs = uniform_pairs(3000, seed=7)
    truth = Sum(
        Lambert(albedo=torch.tensor([[0.2, 0.3, 0.4], [0.5, 0.1, 0.1]]), dtype=torch.float64),
        Ward(
            specular=torch.tensor([[0.1, 0.2, 0.3], [0.3, 0.3, 0.3]]),
            roughness=torch.tensor([[0.08], [0.3]]),
            dtype=torch.float64,
        ),
    )
    with torch.no_grad():
        values = truth(Pairs.from_half_diff(pairs.theta_h[None], pairs.theta_d[None], pairs.phi_d[None])).clone()
    values[1, ::7] = torch.nan
    lead = Pairs.from_half_diff(pairs.theta_h[None], pairs.theta_d[None], pairs.phi_d[None])
    result = fit(model, Measured.from_samples(lead, values), LearnedLoss(), diffuse="fit", samples=None)
    assert [str(status) for status in result.status] == ["converged", "converged"]
    assert result.loss == "learned" and float(result.error.max()) < 1e-3
    for one, other in zip(result.model.parameters(), truth.parameters(), strict=True):
        torch.testing.assert_close(one, other.expand_as(one), rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_a_fit_is_better_under_it_than_another_losses_fit() -> None:
    measured = load(standins()).batch([0, 1]).within(80.0)
    loss = LearnedLoss()
    own, other = (fit(make_model("ward", lobes=2), measured, x, samples=4000) for x in (loss, LOSSES["cube_root"]()))
    score, whole = LearnedLoss(reduction="none"), loss.problem(measured)
    with torch.no_grad():
        mine, theirs = (
            score(result.model(whole.pairs), whole.target, whole.pairs, whole.weight) for result in (own, other)
        )
    torch.testing.assert_close(mine.double(), own.error, rtol=1e-3, atol=0)
    assert bool((mine < theirs).all())


def test_merls_bins_count_as_the_pairs_it_was_trained_on() -> None:
    """Averages on a table's bins are those of pairs uniform in (theta_i, theta_o, phi); other samples count alike."""
    measured = load(standins()).batch([6, 7]).within(80.0)
    some = measured.batch(samples=torch.arange(0, len(measured.pairs), 7))
    loss, pairs = LearnedLoss("none"), uniform_pairs(200_000, seed=3)
    given = loss.problem(some)
    assert given.weight is not None and given.weight.shape == (1, len(some.pairs), 1)
    found = loss.error(given.target, given.target.flip(0), given.pairs, given.weight)
    values = some.at(pairs)
    expected = loss.error(values, values.flip(0), pairs.to(dtype=values.dtype))
    torch.testing.assert_close(found, expected.double(), rtol=0.02, atol=0)
    alike = loss.error(given.target, given.target.flip(0), given.pairs)
    assert ((alike - expected).abs() > 0.03 * expected).all()
    samples = Measured.from_samples(PAIRS, glossy(0.1)[None])
    assert torch.equal(loss.problem(samples).weight, samples.weight)


class OnBins(Made):
    """A model in the place of a table."""

    on_merl_bins = True


def test_a_fit_finds_a_lobe_that_few_pairs_see() -> None:
    """Of a roughness of .003, on a table's bins: they are dense where theta_h is small."""
    table = load(standins()).batch([6]).pairs
    truth = Sum(Lambert(albedo=[0.02, 0.02, 0.02]), Ward(specular=[0.3, 0.25, 0.2], roughness=0.003)).double()
    measured = Measured(OnBins(truth, table.select(samples=torch.arange(0, len(table), 5)).to(dtype=torch.float64)))
    result = fit(make_model("ward", lobes=1), measured, LearnedLoss(), diffuse="fit", samples=4000)
    assert result.model.components()[1].roughness.item() == pytest.approx(0.003, rel=0.02)
    assert float(result.error) < 0.01


@pytest.mark.parametrize("write", ["numpy", "data", "replaced data", "torch"])
@pytest.mark.parametrize("what", ["target", "weight"])
def test_what_is_kept_follows_what_is_written_past_torch(write: str, what: str) -> None:
    """As a buffer that is filled again for every batch is."""
    generator = torch.Generator().manual_seed(0)
    pairs = Pairs.from_half_diff(*torch.rand(3, 200, generator=generator))
    values = {name: torch.rand(200, size, generator=generator) for name, size in (("target", 3), ("weight", 1))}
    prediction, loss = torch.rand(200, 3, generator=generator), LearnedLoss()
    before = loss(prediction, values["target"], pairs, values["weight"])
    changed = values[what].square()
    if write == "numpy":
        values[what].numpy()[...] = changed.numpy()
    elif write == "data":
        values[what].data.copy_(changed)
    elif write == "replaced data":
        values[what].data = changed
    else:
        values[what].copy_(changed)
    after = loss(prediction, values["target"], pairs, values["weight"])
    assert after == LearnedLoss()(prediction, values["target"], pairs, values["weight"]) != before


def test_weights_have_gradients() -> None:
    generator = torch.Generator().manual_seed(0)
    pairs = Pairs.from_half_diff(*torch.rand(3, 60, generator=generator, dtype=torch.float64))
    one, other = torch.rand(2, 60, 3, generator=generator, dtype=torch.float64)
    weight = torch.rand(60, 1, generator=generator, dtype=torch.float64).add_(0.1).requires_grad_()
    assert torch.autograd.gradcheck(lambda given: LearnedLoss()(one, other, pairs, given), weight)


def test_what_is_kept_is_of_the_scale() -> None:
    pairs = Pairs.from_half_diff(*torch.rand(3, 50, generator=torch.Generator().manual_seed(0)))
    one, other = torch.rand(2, 50, 3, generator=torch.Generator().manual_seed(1))
    loss = LearnedLoss()
    loss(one, other, pairs)
    loss.scale = 3.0
    assert loss(one, other, pairs) == LearnedLoss(scale=3.0)(one, other, pairs)
