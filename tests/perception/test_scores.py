"""Human answers: what files hold, the directions, and the distances of losses where people answered."""

import json
import math

import numpy as np
import pytest
import torch
from scipy.io import savemat
from scipy.stats import kstest

from torchbrdf.errors import DataError, UsageError
from torchbrdf.losses import LOSSES
from torchbrdf.measured.catalogue import MERL_SHA256
from torchbrdf.perception import (
    BenchmarkData,
    Opinions,
    distances,
    evaluate_brdfs,
    read_lagunas,
    read_opinions,
    read_triplets,
    score_opinions,
    score_triplets,
    uniform_pairs,
)
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark

NAMES = ["a", "b", "c", "d"]


def triplets_file(tmp_path, **changes):
    content = {"answers": [[0, 1, 2], [3, 2, 0], [1, 0, 3]], "agreement": [[3, 1], [2, 2], [0, 4]], **changes}
    path = tmp_path / "triplets.json"
    path.write_text(json.dumps(content))
    return path


def test_triplets_are_read(tmp_path):
    triplets = read_triplets(triplets_file(tmp_path), NAMES)
    assert triplets.materials == NAMES and len(triplets) == 3
    assert triplets.questions.tolist() == [[0, 1, 2], [3, 2, 0], [1, 0, 3]]
    assert triplets.votes.tolist() == [[3, 1], [2, 2], [0, 4]]
    assert triplets.decided.tolist() == [True, False, True]
    assert triplets.select(triplets.decided).votes.tolist() == [[3, 1], [0, 4]]


def test_indices_follow_file_names(tmp_path):
    names = read_triplets(triplets_file(tmp_path)).materials
    assert sorted(f"{name}.binary" for name in MERL_SHA256) == [f"{name}.binary" for name in names]
    assert names.index("chrome-steel") + 1 == names.index("chrome")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"answers": [[0, 1, 2]]}, "1 answers but 3 agreements"),
        ({"answers": [[0, 1, 2], [3, 2, 0], [1, 0, 4]]}, r"question 2: expected indices 0 to 3, found \[1, 0, 4\]"),
        ({"answers": [[0, 1, 2], [-1, 2, 0], [1, 0, 3]]}, r"expected `int` >= 0 - at `\$\.answers\[1\]\[0\]`"),
        ({"answers": [[0, 1, 2], [3, 3, 0], [1, 0, 3]]}, "question 1: expected three different materials"),
        ({"answers": [[0, 1], [3, 2, 0], [1, 0, 3]]}, r"expected `array` of length 3 - at `\$\.answers\[0\]`"),
        ({"answers": [[0, 1, 2.5], [3, 2, 0], [1, 0, 3]]}, r"expected `int`, got `float` - at `\$\.answers\[0\]\[2\]`"),
        ({"answers": []}, r"expected `array` of length >= 1 - at `\$\.answers`"),
        ({"answers": [[0, 1, 2], [3, 2, 10**30], [1, 0, 3]]}, r"at `\$\.answers\[1\]\[2\]`"),
        ({"agreement": [[3, 1], [2, -2], [0, 4]]}, r"expected `int` >= 0 - at `\$\.agreement\[1\]\[1\]`"),
        ({"agreement": [[3, 1], [2, 10**9], [0, 4]]}, r"expected `int` <= 1000000 - at `\$\.agreement\[1\]\[1\]`"),
        ({"agreement": [[3, 1], [0, 0], [0, 4]]}, "question 1: expected one vote at least"),
        ({"agreement": None}, r"expected `array`, got `null` - at `\$\.agreement`"),
    ],
)
def test_bad_triplets_are_refused(tmp_path, changes, said):
    with pytest.raises(DataError, match=said):
        read_triplets(triplets_file(tmp_path, **changes), NAMES)


@pytest.mark.parametrize(
    "text", ["[1, 2", "[]", "[" * 100_000, '{"answers": [[0, 1, "' + "a" * 9000 + '"]]}', "\udcff"]
)
def test_what_is_no_file_of_triplets_gets_one_short_line(tmp_path, text):
    path = tmp_path / "bad.json"
    path.write_text(text, errors="surrogateescape")
    with pytest.raises(
        DataError, match=r"bad\.json: expected answers to triplets and their agreement, found"
    ) as caught:
        read_triplets(path)
    assert len(str(caught.value)) <= 300 and str(caught.value).isprintable()


def test_missing_files_say_where_they_come_from(tmp_path):
    with pytest.raises(DataError, match=r"no such file.*Lagunas et al\. 2019.*10\.1145/3306346\.3323036"):
        read_triplets(tmp_path / "triplets.json")
    with pytest.raises(DataError, match=r"no such file.*10\.1111/cgf\.142636.*nbonneel/PerceptualBRDF"):
        read_opinions(tmp_path / "opinions.csv")
    with pytest.raises(DataError, match=r"no such file.*Lagunas"):
        read_lagunas(tmp_path / "distances.mat")


def test_opinions_are_read(tmp_path):
    path = tmp_path / "opinions.csv"
    path.write_text("method,material,distance\nWARD,nickel,0.25\nSGD,nickel,0\nWARD,brass,1\n")
    opinions = read_opinions(path)
    assert opinions.methods == ["WARD", "SGD", "WARD"] and opinions.materials == ["nickel", "nickel", "brass"]
    assert opinions.distance.tolist() == [0.25, 0, 1]
    # MOS 4: variance 0.2 (-16 + 24 - 5) = 0.6; at the ends of the scale 0.15.
    expected = [math.sqrt(0.6 / 30) / 4, math.sqrt(0.15 / 30) / 4, math.sqrt(0.15 / 30) / 4]
    assert opinions.standard_error.tolist() == pytest.approx(expected, rel=1e-12)
    part = opinions.select([0, 2])
    assert part.materials == ["nickel", "brass"] and part.distance.tolist() == [0.25, 1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1: expected method,material,distance, found nothing"),
        ("method,distance\n", "line 1: expected method,material,distance, found 'method,distance'"),
        ("method,material,distance\n", "found no row"),
        ("method,material,distance\nWARD,nickel,1.5\n", "line 2: expected a distance from 0 to 1, found '1.5'"),
        ("method,material,distance\nWARD,nickel,much\n", "line 2: expected a distance"),
        ("method,material,distance\nWARD,nickel,nan\n", "line 2: expected a distance"),
        (
            f"method,material,distance\nWARD,nickel,{'x' * 9000}\n",
            "line 2: expected a distance from 0 to 1, found 'xxx",
        ),
        ("method,material,distance\nWARD,../nickel,1\n", "line 2: expected a name"),
        ("method,material,distance\nWARD,nickel\n", "line 2: expected a method, a material and a distance"),
        ("method,material,distance\nW,n,0\nW,m,0\nW,n,1\n", "line 4: W of n is already in line 2"),
    ],
)
def test_bad_opinions_are_refused(tmp_path, text, said):
    path = tmp_path / "opinions.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=said):
        read_opinions(path)


def test_directions_are_uniform_in_three_angles():
    pairs = uniform_pairs(20_000, 80.0, seed=3)
    assert pairs.dtype == torch.float64 and pairs.shape == (20_000,)
    limit = math.radians(80)
    wi, wo = pairs.wi, pairs.wo
    for own in (wi, wo):
        theta = torch.atan2(own[:, :2].norm(dim=-1), own[:, 2])
        assert float(theta.max()) <= limit + 1e-9
        assert kstest(theta / limit, "uniform").pvalue > 1e-3
    sine = wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]
    azimuth = torch.atan2(sine.abs(), (wi[:, :2] * wo[:, :2]).sum(-1))  # its sign means nothing: phi_d is folded
    assert kstest(azimuth / math.pi, "uniform").pvalue > 1e-3
    again, other = uniform_pairs(20_000, 80.0, seed=3), uniform_pairs(20_000, 80.0, seed=4)
    assert torch.equal(again.theta_h, pairs.theta_h) and not torch.equal(other.theta_h, pairs.theta_h)


@pytest.mark.parametrize(
    ("count", "limit", "where"), [(0, 80.0, "uniform_pairs"), (10, 0.0, "max_theta"), (10, 91.0, "max_theta")]
)
def test_directions_that_cannot_be_are_refused(count, limit, where):
    with pytest.raises(UsageError, match=where):
        uniform_pairs(count, limit)


@pytest.fixture(scope="module")
def benchmark():
    return synthetic_benchmark(questions=40)


@pytest.mark.parametrize("name", list(LOSSES))
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_distances_are_those_of_one_pair_after_another(benchmark, name, dtype, monkeypatch):
    pairs = uniform_pairs(50).to(dtype=dtype)
    brdfs = evaluate_brdfs(benchmark, pairs)
    assert brdfs.materials.dtype == brdfs.approximations.dtype == dtype
    loss = LOSSES[name](reduction="none")
    whole = score_triplets(loss, brdfs, benchmark.triplets)
    rows = score_opinions(loss, brdfs)
    monkeypatch.setattr("torchbrdf.perception.agreement.scores._BATCH_BYTES", 1)  # one at a time
    rtol = 1e-5 if dtype == torch.float32 else 1e-12
    assert torch.allclose(score_triplets(loss, brdfs, benchmark.triplets), whole, rtol=rtol, atol=0, equal_nan=True)
    for reference, *candidates in benchmark.triplets.questions[:5].tolist():
        for candidate in candidates:
            own = loss(brdfs.materials[candidate][None], brdfs.materials[reference][None], pairs)
            assert float(whole[reference, candidate]) == pytest.approx(float(own), rel=rtol)
    opinions = benchmark.opinions
    for row in (0, 7, len(opinions) - 1):
        target = benchmark.references(pairs, [opinions.materials[row]])
        model = benchmark.approximations[opinions.methods[row]].of([opinions.materials[row]]).to(dtype=dtype)
        with torch.no_grad():
            assert float(rows[row]) == pytest.approx(float(loss(model(pairs), target, pairs)), rel=10 * rtol)


def test_only_what_is_asked_for_is_worked_out(benchmark):
    brdfs = evaluate_brdfs(benchmark, uniform_pairs(20))
    matrix = score_triplets(LOSSES["rms"](reduction="none"), brdfs, benchmark.triplets)
    asked = torch.zeros_like(matrix, dtype=torch.bool)
    for k in (1, 2):
        asked[benchmark.triplets.questions[:, 0], benchmark.triplets.questions[:, k]] = True
    assert torch.equal(asked, matrix.isfinite())
    with pytest.raises(UsageError, match="expected reduction none"):
        score_opinions(LOSSES["rms"](), brdfs)
    with pytest.raises(UsageError, match="no pairs were given"):
        place = torch.zeros(1, dtype=torch.long)
        distances(LOSSES["rms"](reduction="none"), brdfs.materials, brdfs.materials, None, place, place)


def test_methods_without_a_model_are_left_out(benchmark):
    given = benchmark.all_opinions
    more = Opinions(["NEURAL", *given.methods], [given.materials[0], *given.materials], torch.ones(len(given) + 1))
    asked = BenchmarkData(benchmark.measured, benchmark.triplets, more, benchmark.approximations)
    assert asked.left_out == ["NEURAL"]
    assert asked.opinions.methods == given.methods


def test_a_missing_material_is_named(benchmark):
    less = benchmark.measured.batch(list(range(1, len(benchmark.measured))))
    with pytest.raises(DataError, match=f"found 9 without 1 of them: {benchmark.measured.names[0]}"):
        BenchmarkData(less, benchmark.triplets, benchmark.all_opinions, benchmark.approximations)


def test_matrices_of_distances_are_checked(tmp_path):
    names = ("rms", "rms_cos", "rms_cos_cube", "dist_L2_lab", "dist_L4_lab")
    path = tmp_path / "distances.mat"
    savemat(path, {name: np.full((4, 4), k, float) for k, name in enumerate(names)})
    found = read_lagunas(path, 4)
    assert list(found) == list(names) and float(found["dist_L4_lab"][1, 2]) == 4
    with pytest.raises(DataError, match=r"rms: expected 5 x 5 distances, found \(4, 4\)"):
        read_lagunas(path, 5)
    path.write_bytes(b"no matrices")
    with pytest.raises(DataError, match="expected a MAT file"):
        read_lagunas(path)


def test_the_published_files_hold_what_they_say(data):
    triplets = read_triplets(data / "human" / "lagunas2019_triplets_train.json")
    assert len(triplets) == 22_801 and int((~triplets.decided).sum()) == 1395
    opinions = read_opinions(data / "human" / "lavoue2021_distances_train.csv")
    assert len(opinions) == 1166 and len(set(opinions.materials)) == 67
    assert set(opinions.materials) <= set(triplets.materials)
