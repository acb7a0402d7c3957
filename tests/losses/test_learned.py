"""The learned metric: what holds for it beside what every loss keeps to (test_losses.py)."""

import copy
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchbrdf import fit
from torchbrdf.errors import DataError
from torchbrdf.lobes import Lambert, Sum, Ward, make_model
from torchbrdf.losses import LOSSES, LearnedLoss
from torchbrdf.losses.learned import (
    BIN_COUNT,
    FLOOR,
    LARGEST_WEIGHT,
    encode,
    features,
    pack_weights,
    read_weights,
    soft_bins,
    unpack_weights,
)
from torchbrdf.measured import load, standins
from torchbrdf.measured.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.perception import uniform_pairs

PAIRS = uniform_pairs(2000)


def glossy(roughness: float, specular: float = 0.2, diffuse: float = 0.3) -> Tensor:
    with torch.no_grad():
        ward = Ward(specular=[specular] * 3, roughness=roughness, dtype=torch.float64)
        return Sum(Lambert(albedo=[diffuse, diffuse / 2, diffuse / 3], dtype=torch.float64), ward)(PAIRS)


def distance(one: Tensor, other: Tensor, pairs: Pairs = PAIRS, weight: Tensor | None = None) -> float:
    return float(LearnedLoss(reduction="none")(one, other, pairs, weight))


materials = st.builds(glossy, st.floats(0.02, 0.5), st.floats(0.01, 0.9), st.floats(0.001, 0.9))


@given(materials, materials, materials)
@settings(max_examples=30, deadline=None)
def test_it_is_a_metric(a: Tensor, b: Tensor, c: Tensor) -> None:
    assert distance(a, a) == 0
    assert distance(a, b) == distance(b, a)
    assert distance(a, c) <= distance(a, b) + distance(b, c) + 1e-12


def test_it_grows_along_paths() -> None:
    """Away from a material: rougher, brighter, more strongly coloured; and in proportion along a straight path of e."""
    base = glossy(0.1)
    rougher = [distance(base, glossy(x)) for x in (0.1, 0.12, 0.15, 0.2, 0.3)]
    brighter = [distance(base, base * x) for x in (1.0, 1.1, 1.3, 1.8, 3.0)]
    redder = [distance(base, base * torch.tensor([x, 1, 1 / x])) for x in (1.0, 1.1, 1.3, 1.8, 3.0)]
    for found in (rougher, brighter, redder):
        assert found[0] == 0 and np.diff(found).min() > 0
    cosines = (PAIRS.cos_i * PAIRS.cos_o)[..., None]
    near, far = encode(base, PAIRS), encode(glossy(0.3), PAIRS)
    along = [distance(base, (((1 - t) * near + t * far) ** 4 - FLOOR) / cosines) for t in (0.25, 0.5, 1.0)]
    assert along[0] / along[2] == pytest.approx(0.25, rel=1e-9) and along[1] / along[2] == pytest.approx(0.5, rel=1e-9)


def test_a_common_factor_is_a_fourth_root_of_it() -> None:
    """Exactly, if FLOOR is scaled as well; nearly, for values well above it."""
    one, other = glossy(0.1), glossy(0.2)
    assert distance(16 * one, 16 * other) == pytest.approx(2 * distance(one, other), rel=0.02)


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


def test_features_times_weights_are_the_square() -> None:
    one, other = glossy(0.1), glossy(0.3, 0.1, 0.2)
    data = read_weights(None)["weights"]
    flat = [*data["pointwise"]]
    for kind in ("luminance", "chroma"):
        flat += [*np.ravel(data["mean"][kind]), *np.ravel(data["contrast"][kind])]
    found = features(encode(one, PAIRS) - encode(other, PAIRS), soft_bins(PAIRS))
    weights = torch.tensor(flat, dtype=torch.float64)
    assert float(found @ weights) == pytest.approx(distance(one, other) ** 2, rel=1e-10)
    assert pack_weights(weights) == {key: data[key] for key in pack_weights(weights)}
    assert [part.shape for part in unpack_weights(data)] == [(15,), (2, 45)]


def test_it_comes_by_name_and_says_where_it_is_from() -> None:
    loss = LOSSES["learned"]()
    assert isinstance(loss, LearnedLoss) and loss.registered_name == "learned"
    assert {"learned_from", "materials", "held_out", "seen", "seed", "date"} <= set(loss.provenance)
    assert "10.1145/3306346.3323036" in json.dumps(loss.provenance)


def test_weights_of_ones_own(tmp_path: Path) -> None:
    data = dict(read_weights(None))
    four = {"weights": json.loads(json.dumps(data["weights"]), parse_float=lambda x: 4 * float(x))}
    path = tmp_path / "metric.json"
    path.write_text(json.dumps(four))
    one, other = glossy(0.1), glossy(0.2)
    for weights in (path, str(path), four):
        loss = LearnedLoss(reduction="none", weights=weights)
        assert float(loss(one, other, PAIRS)) == pytest.approx(2 * distance(one, other), rel=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.pop("weights"), "expected a learned metric, .* missing required field `weights`"),
        (lambda d: d.update(floor=1.0), "floor: expected 0.0001, found 1.0"),
        (lambda d: d.update(theta_h=[0, 90]), r"theta_h: expected .*, found \[0.0, 90.0\]"),
        (lambda d: d.update(provenance="mine"), "expected a learned metric, .* got `str` - at `\\$.provenance`"),
        (lambda d: d.update(provenance=["mine"]), "expected a learned metric, .* got `array` - at `\\$.provenance`"),
        (lambda d: d["weights"].pop("mean"), "expected a learned metric, .* missing required field `mean`"),
        (lambda d: d["weights"]["mean"].pop("chroma"), "expected a learned metric, .* missing required field `chroma`"),
        (lambda d: d["weights"]["contrast"].update(chroma=[[1.0]]), "contrast, chroma: expected 10 x 3 numbers"),
        (lambda d: d["weights"]["mean"].update(chroma=[[1.0]] * 4 + [[1.0] * 3]), "mean, chroma: expected 5 x 3 numb"),
        (lambda d: d["weights"].update(pointwise=[0, 0, 0, 0, -1]), "pointwise: expected 5 numbers from 0 to 1e.20"),
        (lambda d: d["weights"].update(pointwise=[0, 0, 0, 0, 1e300]), "pointwise: expected 5 numbers from 0 to 1e.20"),
        (lambda d: d["weights"].update(pointwise=[10**400]), "expected a learned metric, .*out of range"),
        (
            lambda d: d["weights"].update(pointwise=[0, 0, 0, 0, float("nan")]),
            "expected a learned metric, .*JSON is",
        ),
        (lambda d: d["weights"].update(pointwise="much"), "expected a learned metric, .*got `str`"),
    ],
)
def test_bad_weights_are_refused(change, said: str, tmp_path: Path) -> None:
    data = copy.deepcopy(dict(read_weights(None)))
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


def test_the_largest_weights_give_finite_distances() -> None:
    largest = {"weights": json.loads(json.dumps(read_weights(None)["weights"]), parse_float=lambda _: LARGEST_WEIGHT)}
    one, other = torch.zeros(1, len(PAIRS), 3), torch.full((1, len(PAIRS), 3), 1e10)
    pairs = PAIRS.to(dtype=torch.float32)
    assert LearnedLoss(reduction="none", weights=largest)(one, other, pairs).isfinite().all()


def test_a_metric_of_nothing_is_refused() -> None:
    zero = {"weights": json.loads(json.dumps(read_weights(None)["weights"]), parse_float=lambda _: 0.0)}
    with pytest.raises(DataError, match="expected a weight above 0"):
        LearnedLoss(weights=zero)


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
    assert loss._assignment is not None
    for same in (copy.deepcopy(loss), pickle.loads(pickle.dumps(loss))):
        assert same._assignment is None and same._encoded_target is None
        assert torch.equal(same(one, other, PAIRS), expected)


def test_what_is_kept_belongs_to_these_pairs() -> None:
    loss, others = LearnedLoss(reduction="none"), uniform_pairs(2000, seed=5)
    one, other = glossy(0.1), glossy(0.2)
    first = loss(one, other, PAIRS)
    assert loss(one, other, others) != first
    assert loss(one, other, PAIRS) == first
    weight = torch.rand(2000, 1, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    assert float(loss(one, other, PAIRS, weight)) == distance(one, other, PAIRS, weight)
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
    assert result.loss == "learned" and float(result.error.max()) < 1e-4
    for one, other in zip(result.model.parameters(), truth.parameters(), strict=True):
        torch.testing.assert_close(one, other.expand_as(one), rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_a_fit_is_better_under_it_than_another_losses_fit() -> None:
    measured = load(standins()).batch([0, 1]).within(80.0)
    loss = LearnedLoss()
    own, other = (fit(make_model("ward", lobes=2), measured, x, samples=4000) for x in (loss, LOSSES["cube_root"]()))
    score = LearnedLoss(reduction="none")
    with torch.no_grad():
        mine, theirs = (
            score(result.model(measured.pairs), measured.values, measured.pairs, measured.weight)
            for result in (own, other)
        )
    torch.testing.assert_close(mine.double(), own.error, rtol=1e-3, atol=0)
    assert bool((mine < theirs).all())
