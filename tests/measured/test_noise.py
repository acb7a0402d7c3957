"""The noise of measurements, told from samples with noise of a known size."""

import json

import numpy as np
import pytest
import torch
from helpers.listed_files import angles, astm
from helpers.measured_files import synthetic_bsdf, tensor_file

from torchbrdf import fit
from torchbrdf.cli import main
from torchbrdf.fitting.noise import NoiseRecords
from torchbrdf.fitting.result import fits_csv
from torchbrdf.lobes import FitRecord, from_parameters, make_model, read_fits
from torchbrdf.losses import RMSLoss, make_loss
from torchbrdf.measured import Measured, describe, load, standins
from torchbrdf.measured import noise as noise_module
from torchbrdf.measured.angles import direction
from torchbrdf.measured.noise import noise_of
from torchbrdf.pairs import Pairs

GENERATOR = torch.Generator().manual_seed(3)


def goniometer():
    """Each place of an isotropic material two times: on either side of the plane of incidence."""
    rows = np.radians(angles())
    return Pairs.from_directions(*(torch.from_numpy(direction(rows[:, k], rows[:, k + 1]))[None] for k in (0, 2)))


def anywhere(count=2000):
    """No place twice."""
    place = torch.rand(3, 1, count, dtype=torch.float64, generator=GENERATOR)
    return Pairs.from_half_diff(place[0] ** 2 * 1.4, place[1] * 1.3, place[2] * 1.5)


def noisy(pairs, share, model="ggx", channels=3):
    parameters = {"diffuse": [0.3] * channels, "specular": [[0.2] * channels], "roughness": [0.2], "f0": [0.1]}
    values = from_parameters(model, parameters, torch.float64, channels)(pairs).detach()
    values = values * (1 + share * torch.randn(values.shape, dtype=torch.float64, generator=GENERATOR))
    return Measured.from_samples(pairs, values, names=["paint"])


@pytest.mark.parametrize("share", [0.003, 0.03, 0.2])
@pytest.mark.parametrize(("where", "by"), [(goniometer, "ought to be equal"), (anywhere, "neighbours, at most")])
@pytest.mark.parametrize("channels", [1, 3, 5])
def test_noise_of_a_known_size_is_found(share, where, by, channels):
    found = noise_of(noisy(where(), share, channels=channels))
    assert found.share == pytest.approx(share, rel=0.25) and by in found.by
    values = torch.full((20_000,), float(found.level[len(found.level) // 2]))
    assert found.like(values).std().item() == pytest.approx(share * values[0].item(), rel=0.35)
    assert torch.equal(found.like(values, 1), found.like(values, 1))


@pytest.mark.parametrize("where", [goniometer, anywhere])
def test_without_noise_there_is_hardly_any(where):
    assert noise_of(noisy(where(), 0.0)).share < 0.02


def test_samples_that_repeat(tmp_path):
    """Rows that come again with other values."""
    pairs = anywhere(300)
    twice = Pairs.from_directions(pairs.wi.repeat(1, 3, 1), pairs.wo.repeat(1, 3, 1))
    found = noise_of(noisy(twice, 0.1))
    assert found.share == pytest.approx(0.1, rel=0.2) and "ought to be equal" in found.by


def test_where_noise_cannot_be_told(tmp_path):
    assert noise_of(noisy(anywhere(20), 0.1)) is None
    assert noise_of(load(standins()).batch([0])) is None
    dark = Measured.from_samples(anywhere(200), torch.zeros(1, 200, 3))
    assert noise_of(dark).share == 0 and not noise_of(dark).like(torch.ones(3)).any()


def test_a_file_that_was_made_symmetric(tmp_path):
    """Its mirrored samples say nothing."""
    (tmp_path / "felt.bsdf").write_bytes(tensor_file(synthetic_bsdf()))
    assert "noise" in describe(tmp_path / "felt.bsdf")


@pytest.mark.parametrize("loss", ["rms", "compressed", "log", "learned"])
def test_a_fit_that_has_reached_the_noise_says_so(loss):
    measured = noisy(goniometer(), 0.05)
    (right,) = fit(make_model("ggx", 1), measured, make_loss(loss), diffuse="fit").records()
    assert right.noise["share"] == pytest.approx(0.05, rel=0.25)
    assert right.has_reached_noise and right.error > 0.5 * right.noise["error"]
    (wrong,) = fit(make_model("charlie", 1), measured, make_loss(loss), diffuse="fit").records()
    assert wrong.noise == right.noise and not wrong.has_reached_noise
    (clean,) = fit(make_model("charlie", 1), noisy(goniometer(), 0.001), make_loss(loss), diffuse="fit").records()
    assert not clean.has_reached_noise
    assert FitRecord.from_json(json.loads(json.dumps(right.to_json()))) == right


def test_reports_say_it(tmp_path, capsys):
    table = astm().splitlines()
    rng = np.random.default_rng(0)
    rows = [row.split(",") for row in table[6:]]
    rows = [[*row[:4], *(f"{float(one) * (1 + 0.3 * rng.normal()):.9g}" for one in row[4:])] for row in rows]
    path = tmp_path / "paint.astm"
    path.write_text("\n".join([*table[:6], *(",".join(row) for row in rows)]))
    assert describe(path)["noise"].endswith("samples)") and 25 < float(describe(path)["noise"].split()[0]) < 35
    assert main(["fit", str(path), "--loss", "compressed", "--diffuse", "fit", "--out", str(tmp_path / "out")]) == 0
    assert "an error as of the noise alone" in capsys.readouterr().out
    (record,) = read_fits(tmp_path / "out" / "fits.json")
    assert record.has_reached_noise and "noise_error" in fits_csv([record]).splitlines()[0]
    assert main(["info", str(path)]) == 0
    assert "% of the value (samples that ought to be equal" in capsys.readouterr().out


def test_pictures_have_no_noise_of_samples():
    from torchbrdf.render import RenderedLoss, Scene, sphere

    picture = RenderedLoss(Scene(sphere(2), size=8, nodes=8, light_samples=4))
    assert NoiseRecords(noisy(goniometer(), 0.05)).of(picture) == [{}]
    assert NoiseRecords(noisy(goniometer(), 0.05)).of(RMSLoss())[0]["error"] > 0


def test_noise_of_many_is_that_of_each_alone(monkeypatch):
    made, where = [], noise_module._Where
    monkeypatch.setattr(noise_module, "_Where", lambda *of: made.append(of) or where(*of))
    shared = noisy(anywhere(300), 0.05)
    values = torch.cat([shared.values, shared.values * 1.7, noisy(anywhere(300), 0.2).values, shared.values.square()])
    weight = torch.ones(4, 300, 1)
    weight[2, ::3] = 0
    own = Pairs.from_directions(*(part.expand(4, -1, -1).flip(1) for part in (shared.pairs.wi, shared.pairs.wo)))
    for pairs, count in ((shared.pairs, 3), (own, 4)):  # where all share pairs, the third has other samples
        many = Measured.from_samples(pairs, values, weight, anisotropic=False)
        made.clear()
        found = noise_module.noises_of(many)
        assert len(made) == count
        for k, one in enumerate(found):
            alone = noise_of(many.batch([k]))
            assert (one.share, one.by, one.samples) == (alone.share, alone.by, alone.samples)
        records = NoiseRecords(many).of(RMSLoss())
        for k, record in enumerate(records):
            (alone,) = NoiseRecords(many.batch([k])).of(RMSLoss())
            assert record == {**alone, "error": pytest.approx(alone["error"], rel=1e-9)}
            assert record["share"] == found[k].share
