"""JOD scores and ratings: what files hold, and what metrics and gloss are worth beside them."""

import csv
import itertools
import math

import numpy as np
import pytest
import torch
from scipy.stats import rankdata, spearmanr

from torchbrdf.errors import DataError, UsageError
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, parameters, write_fits
from torchbrdf.losses.metric_file import CONSTANTS
from torchbrdf.measured import MERL_NAMES, load
from torchbrdf.measured.gloss import contrast_gloss
from torchbrdf.perception import (
    compare_appearance,
    find_metric,
    gloss_term,
    read_jod,
    read_opinions,
    read_ratings,
    score_jod,
    uniform_pairs,
)
from torchbrdf.perception.agreement.jod import PICTURES
from torchbrdf.perception.datasets.jod import JodScores

JOD = """material,model,level,DeltaE,JOD,class
nickel_1,ward,0,12.5,7.5,3
nickel_2,hbrdf,0,3,9.5,6
nickel_10,hbrdf,2,4,10.1,6
gold-paint_1,ward,0,20,4,1
"""
RATINGS = """image,n,glossy_mean,soft_mean,glossy_sd,soft_sd
001.png,5,1,2,0.5,0
nickel_5PCs.png,10,4.5,1.5,0.6,1.2
gold-paint_5PCs.png,1,3,2,0,0
"""


def test_jod_scores_are_read(tmp_path):
    path = tmp_path / "jod.csv"
    path.write_text(JOD)
    found = read_jod(path)
    assert found.names == ["nickel_1", "nickel_2", "nickel_10", "gold-paint_1"]
    assert found.materials == ["nickel", "nickel", "nickel", "gold-paint"]
    assert found.methods == ["ward", "hbrdf-0", "hbrdf-2", "ward"]  # a level where a model has several
    assert found.distance.tolist() == pytest.approx([2.5, 0.5, -0.1, 6]) and found.delta_e.tolist() == [12.5, 3, 4, 20]
    assert found.select([3, 0]).names == ["gold-paint_1", "nickel_1"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("DeltaE", "Delta", "line 1: expected material,model,level,DeltaE,JOD,class, found 'material"),
        ("nickel_1,", "nickel,", "line 2: expected a material, _ and a number, found 'nickel'"),
        ("nickel_1,", "_1,", "line 2: expected a material, _ and a number"),
        ("nickel_1,", "../x_1,", "line 2: expected a name"),
        ("nickel_2", "nickel_1", "line 3: 'nickel_1', or hbrdf 0 of nickel, is already in line 2"),
        ("nickel_10,hbrdf,2", "nickel_10,hbrdf,0", "line 4: 'nickel_10', or hbrdf 0 of nickel, is already in line 3"),
        ("7.5", "much", "line 2: expected a JOD from -100 to 12, found 'much'"),
        ("7.5", "nan", "line 2: expected a JOD"),
        ("7.5", "99", "line 2: expected a JOD"),
        ("12.5", "-1", "line 2: expected a colour difference from 0 to 10000, found '-1'"),
        ("ward,0,20", "ward,-1,20", "line 5: expected a level from 0 to 99, found '-1'"),
        ("4,1\n", "4\n", "line 5: expected 6 cells, found 5"),
        (JOD.partition("\n")[2], "", "expected JOD scores, found no row"),
        (JOD, "", "line 1: expected material,model,level,DeltaE,JOD,class, found nothing"),
        ("3,9.5", '"3,9.5', "expected CSV"),
    ],
)
def test_bad_jod_scores_are_refused(tmp_path, old, new, said):
    path = tmp_path / "jod.csv"
    path.write_text(JOD.replace(old, new))
    with pytest.raises(DataError, match=rf"jod\.csv: {said}") as caught:
        read_jod(path)
    assert len(str(caught.value)) <= 300


def test_ratings_are_read(tmp_path):
    path = tmp_path / "ratings.csv"
    path.write_text(RATINGS)
    found = read_ratings(path, MERL_NAMES)
    assert found.materials == ["001", "nickel", "gold-paint"] and found.measured == [False, True, True]
    assert found.attributes == ["glossy", "soft"] and found.mean[1].tolist() == [4.5, 1.5]
    assert found.standard_error.tolist() == [[0.25, 0], [pytest.approx(0.2), pytest.approx(0.4)], [1, 1]]
    assert found.select(["gold-paint"]).mean.tolist() == [[3, 2]]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("soft_sd", "soft_s", "line 1: expected image, n, and NAME_mean and NAME_sd of each attribute, found"),
        ("soft_mean", "glossy_mean", "line 1: expected image, n"),
        ("image,n,", "image,", "line 1: expected image, n"),
        ("nickel_5PCs", "nickle_5PCs", r"line 3: expected one of 100 materials, found 'nickle_5PCs'; did you mean 'n"),
        ("nickel_5PCs", "001", "line 3: '001' is already in line 2"),
        ("001.png", "a/b.png", "line 2: expected a name"),
        (
            ",10,4.5",
            ",10,5.5",
            "line 3: glossy: a mean: expected|line 3: expected glossy: a mean from 1 to 5, found '5.5'",
        ),
        (",10,4.5", ",10,inf", "line 3: expected glossy: a mean from 1 to 5, found 'inf'"),
        ("0.6", "-0.6", "line 3: expected glossy: a deviation from 0 to 4, found '-0.6'"),
        (",10,", ",0,", "line 3: n: expected a whole number of at least 1, found '0'"),
        (",10,", ",ten,", "line 3: n: expected a whole number"),
        ("0.6,1.2", "0.6", "line 3: expected 6 cells, found 5"),
        (RATINGS.partition("\n")[2], "", "expected mean ratings, found no row"),
        (RATINGS, "", "line 1: expected image, n"),
    ],
)
def test_bad_ratings_are_refused(tmp_path, old, new, said):
    path = tmp_path / "ratings.csv"
    path.write_text(RATINGS.replace(old, new))
    with pytest.raises(DataError, match=rf"ratings\.csv: ({said})") as caught:
        read_ratings(path, MERL_NAMES)
    assert len(str(caught.value)) <= 300


def test_missing_files_say_where_they_come_from(tmp_path):
    with pytest.raises(DataError, match=r"no such file.*10\.1111/cgf\.70162"):
        read_jod(tmp_path / "jod.csv")
    with pytest.raises(DataError, match=r"no such file.*10\.1145/2980179\.2980242"):
        read_ratings(tmp_path / "ratings.csv")


def tables(folder, roughness, specular=0.1):
    """Materials of Lambert and one lobe of Ward's, by name."""
    records = [
        FitRecord(name, "ward", 1, parameters(Sum(Lambert(albedo=0.2), Ward(specular=specular, roughness=own))))
        for name, own in roughness.items()
    ]
    write_fits(folder / "fits.json", records)
    return load(folder / "fits.json", dtype=torch.float64)


@pytest.fixture
def rough(tmp_path):
    """Three materials, approximations of them whose lobes are ever wider, and scores that fall with that."""
    materials = {"nickel": 0.1, "brass": 0.2, "nylon": 0.25}
    wider = {f"{name}_{k}": own * (1 + k / 4) for name, own in materials.items() for k in (1, 2, 3)}
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    names = list(wider)
    jod = torch.tensor([10 - int(name[-1]) * 1.5 for name in names], dtype=torch.float64)
    scores = JodScores(
        names, [name[:-2] for name in names], [f"model-{name[-1]}" for name in names], jod, torch.arange(9.0).double()
    )
    return scores, tables(tmp_path / "a", wider), tables(tmp_path / "b", materials)


def test_metrics_are_scored_by_jod_where_there_are_tables(rough):
    scores, approximations, references = rough
    found = score_jod(scores, {"cr": "cube_root"}, approximations, references, pairs=uniform_pairs(300), replicates=20)
    keys = [one.key for one in found.table.statistics]
    assert keys == ["pairs", "apart", "any"] and found.table.losses == [
        PICTURES,
        "cr",
    ]  # no two scores of a model differ
    assert found.table.value[1, :2].tolist() == [1, 1] and found.table.value[0, 0] == 1  # names are in order, too
    fewer = approximations.batch([0, 1, 2, 4])
    part = score_jod(scores, "cube_root", fewer, references, pairs=uniform_pairs(50), replicates=2)
    assert part.scores.names == [scores.names[k] for k in (0, 1, 2, 4)] and part.table.losses == [PICTURES, "cube_root"]
    assert bool(part.table.ceiling.isnan().all())


def test_jod_without_tables_is_refused_in_a_line(rough):
    scores, approximations, references = rough
    with pytest.raises(DataError, match="expected the tables of approximations and materials, found none"):
        score_jod(scores, "rms")
    with pytest.raises(DataError, match=r"expected tables of approximations, such as aluminium_1, found 1 of them"):
        score_jod(scores, "rms", approximations.batch([0]), references)
    with pytest.raises(DataError, match=r"expected tables of the materials, found none of nickel$"):
        score_jod(scores, "rms", approximations, references.batch([1, 2]))
    with pytest.raises(UsageError, match="expected distances"):
        score_jod(scores, lambda p, t, q: p, approximations, references)


def rated(folder, names, glossy):
    rows = [f"{name}_5PCs.png,10,{own},{6 - own},0.5,0.5" for name, own in zip(names, glossy, strict=True)]
    (folder / "ratings.csv").write_text(
        "\n".join(["image,n,glossy_mean,matte_mean,glossy_sd,matte_sd", "001.png,5,3,3,1,1", *rows]) + "\n"
    )
    return read_ratings(folder / "ratings.csv", MERL_NAMES)


def test_gloss_predicts_ratings_that_follow_it(tmp_path):
    names = list(MERL_NAMES[:24])
    source = np.random.default_rng(0)
    rough = {name: float(own) for name, own in zip(names, source.uniform(0.05, 0.2, 24), strict=True)}
    measured = tables(tmp_path, rough)
    glossy = 1 + 4 * (rankdata([-own for own in rough.values()]) - 1) / 23  # the smoother the glossier
    found = compare_appearance(measured, rated(tmp_path, names[:22], glossy[:22]), replicates=50)
    assert found.materials == names[:22] and list(found.measured)[:2] == ["sharpness", "contrast_gloss"]
    place = {name: s for s, name in enumerate([*found.measured, "together"])}
    for name in ("sharpness", "contrast_gloss", "gloss"):
        assert float(found.correlation[place[name], 0]) == pytest.approx(1) and float(found.low[place[name], 0]) > 0.99
        assert float(found.correlation[place[name], 1]) == pytest.approx(-1)
    assert float(found.correlation[place["together"], 0]) > 0.99 and 0.8 < float(found.ceiling[0]) < 1
    records = found.records()
    assert len(records) == 10 and math.isclose(records[0]["spearman"], 1)


def test_rank_correlations_are_those_of_scipy(tmp_path):
    names = list(MERL_NAMES[:15])
    source = np.random.default_rng(1)
    measured = tables(
        tmp_path, {name: float(own) for name, own in zip(names, source.uniform(0.05, 0.4, 15), strict=True)}
    )
    ratings = rated(tmp_path, names, source.integers(1, 6, 15))  # with ties
    found = compare_appearance(measured, ratings, replicates=10, pairs=uniform_pairs(400))
    for s, values in enumerate(found.measured.values()):
        if s != 2:  # albedo is the same of all
            expected = spearmanr(values.numpy(), ratings.mean[1:, 0].numpy()).statistic
            assert float(found.correlation[s, 0]) == pytest.approx(expected, rel=1e-9)
    assert torch.equal(found.measured["contrast_gloss"], contrast_gloss(measured))


def test_the_gloss_term_is_the_one_that_the_learned_metric_compares(tmp_path):
    measured, pairs = tables(tmp_path, {"nickel": 0.1, "brass": 0.3}), uniform_pairs(2000)
    values = measured.at(pairs)
    terms = dict(zip(CONSTANTS, find_metric("learned").terms(values[:1], values[1:], pairs)[0].tolist(), strict=True))
    one, other = gloss_term(measured, pairs).tolist()
    assert one > other and terms["gloss"] == pytest.approx(one - other, rel=1e-9)


def test_too_few_rated_materials_are_refused(tmp_path):
    names = list(MERL_NAMES[:9])
    measured = tables(tmp_path, dict.fromkeys(names, 0.2))
    with pytest.raises(DataError, match="expected at least 8 of the measured materials, found 3"):
        compare_appearance(measured, rated(tmp_path, names[:3], [1, 2, 3]))


def _alike(one, model, other, method):
    """How often what people think of a model's fits and of a method's orders two materials alike."""
    first, second = (
        {name: float(own) for name, of, own in zip(rows.materials, rows.methods, rows.distance, strict=True) if of == k}
        for rows, k in ((one, model), (other, method))
    )
    signs = [
        (first[a] - first[b]) * (second[a] - second[b]) > 0
        for a, b in itertools.combinations(sorted(first.keys() & second.keys()), 2)
        if first[a] != first[b] and second[a] != second[b]
    ]
    return sum(signs) / len(signs)


def test_a_fit_by_other_hands_is_no_stand_in_for_one(data):
    scores = read_jod(data / "human" / "kavoosighafi2025_jod_train.csv")
    opinions = read_opinions(data / "human" / "lavoue2021_distances_train.csv")
    of_studies = [_alike(scores, *pair) for pair in (
        ("ward", opinions, "WARD"), ("ward", opinions, "WARD-OURS"), ("ggx", opinions, "GGX"),
    )]  # fmt: skip
    assert of_studies == pytest.approx([0.46, 0.44, 0.42], abs=0.005)
    of_hands = [_alike(opinions, name, opinions, f"{name}-OURS") for name in ("WARD", "ABC", "BLINN-PHONG")]
    assert of_hands == pytest.approx([0.80, 0.84, 0.69], abs=0.005)


def test_the_published_files_hold_what_they_say(data):
    scores = read_jod(data / "human" / "kavoosighafi2025_jod_train.csv")
    assert len(scores) == 99 and len(set(scores.materials)) == 11 and len(set(scores.methods)) == 9
    table = score_jod(scores, replicates=50).table
    assert table.value[0].tolist() == pytest.approx([0.843, 0.930, 0.806, 0.822], abs=5e-4)
    ratings = read_ratings(data / "human" / "serrano2016_mean_ratings.csv", MERL_NAMES)
    assert len(ratings) == 400 and sum(ratings.measured) == 94 and len(ratings.attributes) == 14
    with (data / "human" / "serrano2016_mean_ratings.csv").open(newline="") as file:
        last = list(csv.DictReader(file))[-1]
    assert float(last["refsharp_mean"]) == float(ratings.mean[-1, ratings.attributes.index("refsharp")])
