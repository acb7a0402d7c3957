"""The leaderboard: any metric has a row, and one that is none gets one clear line."""

import sys

import numpy as np
import pytest
import torch

from torchbrdf.cli import main
from torchbrdf.errors import DataError, ShapeError, TorchbrdfError, UsageError
from torchbrdf.losses import LOSSES, CubeRootLoss, RMSLoss
from torchbrdf.perception import FORMULAS, as_metric, find_metric, score, uniform_pairs
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, sphere

PAIRS = uniform_pairs(60)


@pytest.fixture(scope="module")
def data():
    return synthetic_benchmark(questions=40)


def rms(prediction, target, pairs):
    return (prediction - target).square().mean((-2, -1)).sqrt()


class Weighed(torch.nn.Module):
    """A module with a parameter of its own, float32."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(3))

    def forward(self, prediction, target, pairs):
        assert prediction.dtype == pairs.cos_i.dtype == torch.float32
        return ((prediction - target) * self.weight).square().mean((-2, -1)).sqrt()


SAME = {
    "name": "rms",
    "loss": RMSLoss(),
    "function": rms,
    "one that averages all it is given": lambda prediction, target, pairs: (prediction - target).square().mean().sqrt(),
    "pairs by default": lambda prediction, target, pairs=None: rms(prediction, target, pairs),
    "any arguments": lambda *values: rms(*values),
    "two arguments": torch.nn.MSELoss(),
    "another function of two": torch.nn.functional.mse_loss,
    "module": Weighed(),
    "numpy": lambda prediction, target, pairs: np.sqrt(np.square(prediction.numpy() - target.numpy()).mean((-2, -1))),
}


def test_one_metric_in_any_form_has_the_same_scores(data):
    table = score(SAME, data, pairs=PAIRS, replicates=20)
    assert table.losses == list(SAME)
    rows = dict(zip(table.losses, table.value, strict=True))
    for name, row in rows.items():
        assert torch.allclose(row, rows["name"], atol=0.03 if name == "module" else 1e-12), name
    assert (table.low <= table.value).all() and (table.value <= table.high).all()
    assert [one.key for one in table.statistics][:5] == ["majority", "votes", "pairs", "apart", "across"]


def test_the_default_pairs_are_six_thousand_with_the_seed(data):
    seen = []

    def looks(prediction, target, pairs):
        seen.append((len(pairs), pairs.theta_h[:3].tolist(), (*prediction.shape[1:],)))
        return rms(prediction, target, pairs)

    score(looks, data, replicates=2, seed=3)
    assert set(map(str, seen)) == {str((6000, uniform_pairs(6000, 80, seed=3).theta_h[:3].tolist(), (6000, 3)))}


def test_pictures_of_a_scene_are_a_metric(data):
    scene = Scene(sphere(2), Camera(20.0), Environment.default(), size=16, nodes=16, light_samples=16)
    loss = RenderedLoss(scene, "log_hdr", reduction="none")
    table = score({"pictures": loss, "cube root": CubeRootLoss()}, data, pairs=PAIRS, replicates=5)
    assert table.losses == ["pictures", "cube root"] and bool(table.value.isfinite().all())


def test_what_is_done_in_place_changes_nobody_elses_values(data):
    def careless(prediction, target, pairs):
        prediction -= target
        target.zero_()
        return prediction.square_().mean((-2, -1))

    table = score({"before": "rms", "careless": careless, "after": "rms"}, data, pairs=PAIRS, replicates=2)
    assert torch.equal(table.value[0], table.value[1]) and torch.equal(table.value[0], table.value[2])


def raises(prediction, target, pairs):
    raise ValueError("two\nlines")


def wrong_for_some(prediction, target, pairs):
    return rms(prediction, target, pairs).masked_fill_(torch.arange(len(prediction)) == 1, float("nan"))


@pytest.mark.parametrize(
    ("metric", "kind", "said"),
    [
        (lambda p, t, q: p, UsageError, r"<lambda>: expected distances \(\d+,\) of values \(\d+, 60, 3\), found \(\d+"),
        (lambda p, t, q: rms(p, t, q)[:, None], UsageError, r"found \(\d+, 1\)$"),
        (lambda p, t, q: rms(p, t, q)[:1], UsageError, r"found \(1,\)$"),
        (lambda p, t, q: None, UsageError, "expected a tensor of distances, found NoneType"),
        (lambda p, t, q: "far", UsageError, "expected a tensor of distances, found str"),
        (lambda p, t, q: rms(p, t, q) * 1j, UsageError, r"expected a tensor of distances, found torch\.complex128"),
        (lambda p, t: p.mean((-2, -1), keepdim=True)[:, 0].repeat(1, 7), ShapeError, r"found \(1, 7\)"),
        (wrong_for_some, DataError, r"wrong_for_some: expected finite distances, found \d+ of \d+ .* first nan"),
        (lambda p, t, q: rms(p, t, q) / 0, DataError, "expected finite distances, found .* first (inf|nan)"),
        (raises, UsageError, "raises: expected distances, but it raised ValueError: two lines"),
        (lambda p, t, q: sys.exit(0), UsageError, "it raised SystemExit: 0"),
        (lambda p: p, UsageError, r"expected a function of \(prediction, target\)"),
        (RMSLoss, UsageError, "expected an instance or a function, found the class 'RMSLoss'"),
        (3, UsageError, r"expected a name, a Loss or a function of \(prediction, target, pairs\), found 3"),
        ("cube_rot", UsageError, "unknown loss 'cube_rot'.* did you mean 'cube_root'"),
        ({}, UsageError, "metrics: expected at least one, found none"),
        ({"a/b": "rms"}, DataError, "metrics: expected a name"),
    ],
)
def test_what_is_no_metric_gets_one_line(data, metric, kind, said):
    with pytest.raises(kind, match=said) as caught:
        score(metric, data, pairs=PAIRS, replicates=2)
    assert len(str(caught.value)) <= 300 and str(caught.value).isprintable()


MODULE = """
import torch
from torchbrdf.losses import Loss


def distance(prediction, target, pairs):
    return (prediction - target).square().mean((-2, -1))


class Squares(torch.nn.Module):
    def forward(self, prediction, target, pairs):
        return distance(prediction, target, pairs)


class Own(Loss):
    def encode(self, values, pairs):
        return values


class inner:
    deep = staticmethod(distance)


number = 3
def fails(prediction, target, pairs):
    return prediction
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "some_metrics.py").write_text(MODULE)
    (tmp_path / "broken_metrics.py").write_text("import nothing_like_it\n")
    monkeypatch.chdir(tmp_path)
    yield "some_metrics"
    sys.modules.pop("some_metrics", None)


def test_metrics_are_found_by_module_file_and_name(module, data):
    names = ("distance", "Squares", "Own", "inner.deep")
    texts = ["rms", *(f"{where}:{name}" for where in (module, f"{module}.py") for name in names)]
    table = score({f"metric-{k}": text for k, text in enumerate(texts)}, data, pairs=PAIRS, replicates=2)
    assert torch.equal(table.value, table.value[:1].expand_as(table.value))
    assert sys.path[0] != str(module) and as_metric("rms").reduction == "none"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("some_metrics:none", "'some_metrics:none': cannot be loaded: AttributeError: module 'some_metrics' has no"),
        ("no_metrics:distance", "cannot be loaded: ModuleNotFoundError"),
        ("broken_metrics:distance", "cannot be loaded: ModuleNotFoundError: No module named 'nothing_like_it'"),
        ("no_metrics.py:distance", "no such file"),
        ("some_metrics:number", r"expected a name, a Loss or a function of \(prediction, target, pairs\), found 3"),
        ("some_metrics:", "expected module:name or file.py:name, found 'some_metrics:'"),
        (":distance", "expected module:name"),
        ("some metrics:distance", "expected module:name"),
        ("some_metrics:a-b", "expected module:name"),
        ("some_metrics.distance", "unknown loss"),
    ],
)
def test_metrics_that_are_not_there_are_said_in_a_line(module, text, said):
    with pytest.raises(TorchbrdfError, match=said):
        find_metric(text)


def test_the_command_prints_a_table_and_writes_all_or_nothing(module, tmp_path, capsys):
    few = ["score", "--quick", "--samples", "40", "--replicates", "5"]
    out = tmp_path / "out"
    assert main([*few, "--metric", "rms", "--metric", f"{module}:distance", "--out", str(out)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "made-up answers: nobody was asked" and said[1].split()[0] == "triplets"
    assert said[2].split()[1:] == said[3].split()[1:] and said[3].startswith(f"{module}:distance ")
    assert said[4].startswith("ceiling: people ") and said[4].count(" to ") == 5
    assert sorted(path.name for path in out.iterdir()) == ["scores.csv", "scores.json"]
    bad = tmp_path / "bad"
    assert main([*few, "--metric", "rms", "--metric", f"{module}:fails", "--out", str(bad)]) == 2
    caught = capsys.readouterr()
    assert caught.out == "" and caught.err.startswith(f"torchbrdf: {module}:fails: expected distances")
    assert caught.err.count("\n") == 1 and not bad.exists()


def test_a_loss_that_fails_is_left_out_unless_it_was_asked_for(monkeypatch, capsys):
    few = ["score", "--quick", "--samples", "40", "--replicates", "5"]

    def fails(self, prediction, target, pairs=None, weight=None):
        raise ValueError("not today")

    monkeypatch.setattr(LOSSES["log"], "forward", fails)
    assert main(few) == 0
    caught = capsys.readouterr()
    assert caught.err == "torchbrdf: log is left out: log: expected distances, but it raised ValueError: not today\n"
    rows = {line.split()[0] for line in caught.out.splitlines()[2:]}
    assert rows == {*LOSSES, *FORMULAS, "ceiling:"} - {"log"}
    assert main([*few, "--metric", "log", "--metric", "rms"]) == 2
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--metric", "rms"], "score: --materials: expected a folder; --quick runs on made-up answers"),
        (["--materials", "x"], "score: --human: expected a folder"),
        (["--quick", "--metric", "rms", "--metric", "rms"], "--metric: expected rms once, found twice"),
        (["--quick", "--metric", "rmss"], "unknown loss 'rmss'"),
        (["--quick", "--difference", "nothing"], "unknown"),
        (["--quick", "--samples", "1"], "--samples: expected a whole number from 2"),
    ],
)
def test_options_that_cannot_be_are_said_in_a_line(options, said, capsys):
    try:
        status = main(["score", *options])
    except SystemExit as error:
        status = error.code
    assert status == 2 and said in capsys.readouterr().err
