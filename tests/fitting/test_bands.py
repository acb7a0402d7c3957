"""Fits on bands of wavelengths: any number of channels, under any loss of values, and back from a file."""

import json
import pickle

import pytest
import torch
from helpers.directions import hemisphere

from torchbrdf import fit
from torchbrdf.cli import main
from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.export.bands import in_rgb
from torchbrdf.fitting.batches import Batches
from torchbrdf.lobes import LOBES, FitRecord, Sum, Ward, make_model, model_of, parameters, read_fits
from torchbrdf.lobes.in_bands import channels_of, in_bands, with_channels
from torchbrdf.losses import LearnedLoss, RMSLoss, make_loss
from torchbrdf.measured import Measured, load
from torchbrdf.measured.colors import weights_of
from torchbrdf.pairs import Pairs

PARTS = [name for name in LOBES if not LOBES[name].is_material]


def pairs_of(count, seed=0):
    return Pairs.from_directions(hemisphere(1, count, seed=seed), hemisphere(1, count, seed=seed + 1))


def lengths_of(channels):
    return tuple(400.0 + 10 * k for k in range(channels))


def made_up(channels, count=600):
    """A Ward material whose colours change from band to band."""
    model = make_model("ward", 1, torch.float64, channels=channels)
    first, second = model.components()
    first.albedo = torch.linspace(0.1, 0.5, channels, dtype=torch.float64)
    second.specular, second.roughness = torch.linspace(0.4, 0.2, channels, dtype=torch.float64), 0.2
    pairs = pairs_of(count)
    lengths = lengths_of(channels) if channels != 3 else None
    return model, Measured.from_samples(pairs, model(pairs).detach(), names=["paint"], wavelengths=lengths)


@pytest.mark.parametrize("channels", [1, 2, 5])
@pytest.mark.parametrize("name", PARTS)
def test_every_lobe_has_any_number_of_channels(name, channels):
    """Each channel is what one of three is."""
    kind = in_bands(LOBES[name], channels)
    pairs = pairs_of(20)
    found = kind(dtype=torch.float64)(pairs)
    assert found.shape == (1, 20, channels)
    torch.testing.assert_close(found, LOBES[name](dtype=torch.float64)(pairs)[..., :1].expand_as(found))
    assert kind.in_rgb is LOBES[name] and in_bands(kind, 3) is LOBES[name] and in_bands(kind, channels) is kind
    assert pickle.loads(pickle.dumps(kind)) is kind


@pytest.mark.parametrize("channels", [1, 2, 31])
@pytest.mark.parametrize("loss", ["rms", "cosine_rms", "cube_root", "compressed", "log", "learned"])
def test_fits_in_bands_find_what_was_there(loss, channels):
    model, measured = made_up(channels)
    result = fit(make_model("ward", 1), measured, make_loss(loss), diffuse="fit")
    (record,) = result.records()
    assert record.status == "converged" and record.channels == channels
    assert tuple(record.wavelengths) == lengths_of(channels)
    found, wanted = record.parameters, parameters(model)
    assert found["roughness"] == pytest.approx(wanted["roughness"], rel=0.02)
    for key in ("diffuse", "specular"):
        torch.testing.assert_close(torch.tensor(found[key]), torch.tensor(wanted[key]), rtol=0.05, atol=0.01)
    again = FitRecord.from_json(json.loads(json.dumps(record.to_json())))
    assert again == record and channels_of(model_of([again])) == channels


@pytest.mark.parametrize("name", ["ggx", "eon+beckmann", "ggx_f82", "shifted_gamma", "lambert+charlie"])
def test_three_channels_are_as_ever(name):
    """As many channels as of RGB, each fitted as bands are."""
    _, measured = made_up(3)
    values = measured.values.expand(-1, -1, 3)
    five = Measured.from_samples(measured.pairs, values[..., [0, 1, 2, 0, 1]], names=["paint"])
    three = fit(make_model(name, 1 if "+" not in name else None), measured, RMSLoss(), max_iterations=30)
    more = fit(make_model(name, 1 if "+" not in name else None), five, RMSLoss(), max_iterations=30)
    assert more.error[0] < 1.1 * three.error[0] + 1e-3
    assert channels_of(more.model) == 5


def test_bands_of_tables_are_fitted_from_sums():
    """Where pairs share half angles, and losses of squares go by sufficient statistics."""
    grid = torch.linspace(0.05, 1.2, 12, dtype=torch.float64)
    pairs = Pairs.from_half_diff(*(part.reshape(1, -1) for part in torch.meshgrid(grid, grid, grid, indexing="ij")))
    model, _ = made_up(7)
    measured = Measured.from_samples(pairs, model(pairs).detach(), names=["paint"], wavelengths=lengths_of(7))
    for loss in ("cosine_rms", "compressed", "learned"):
        result = fit(make_model("ward", 1), measured, make_loss(loss), diffuse="fit")
        assert result.records()[0].parameters["roughness"][0] == pytest.approx(0.2, rel=0.02)


def test_what_is_refused():
    _, measured = made_up(5)
    three = Measured.from_samples(measured.pairs, measured.values[..., :3], wavelengths=[465, 525, 630])
    for bands, found in ((measured, "5 bands from 400 to 440 nm"), (three, "3 bands of 465, 525, 630 nm")):
        with pytest.raises(UsageError, match=f"principled: expected linear RGB, .* found {found}; read bands as RGB"):
            fit(make_model("principled"), bands, RMSLoss())
    with pytest.raises(UsageError, match=r"principled: expected linear RGB, .* found 5 channels"):
        make_model("principled", channels=5)
    with pytest.raises(ShapeError, match=r"Ward\.specular: expected the same start for all 3 channels"):
        fit(Sum(make_model("ward", 1).components()[0], Ward(specular=[0.1, 0.2, 0.3])), measured, RMSLoss())
    with pytest.raises(UsageError, match="Sum: expected lobes with as many channels each, found"):
        Sum(make_model("ward", 1).components()[0], in_bands(Ward, 5)())
    with pytest.raises(UsageError, match="luminance: expected a share from 0 on"):
        LearnedLoss(luminance=[-1, 2, 3])
    with pytest.raises(ShapeError, match="luminance: expected values of 2 channels, found 5"):
        LearnedLoss(luminance=[0.5, 0.5])(measured.values, measured.values, measured.pairs)
    record = fit(make_model("ward", 1), measured, RMSLoss()).records()[0].to_json()
    for change, found in (
        ({"wavelengths": [400.0]}, "wavelengths: expected 5 growing numbers, in nm, found"),
        ({"wavelengths": [500.0, 400, 600, 700, 800]}, "wavelengths: expected 5 growing numbers"),
        ({"channels": 4, "wavelengths": None}, "expected 4 numbers"),
        ({"channels": 0, "wavelengths": None}, "expected 1 to 10000 channels, found 0"),
    ):
        with pytest.raises(DataError, match=found):
            FitRecord.from_json(record | change)


def test_luminance_of_the_learned_metric_is_by_wavelengths():
    """A band that nobody sees counts nothing in gloss."""
    _, measured = made_up(2)
    changed = measured.values.clone()
    changed[..., 1] *= 1 + 5 * (measured.pairs.theta_h < 0.2)
    plain, seen = LearnedLoss("none"), LearnedLoss("none").with_luminance([1.0, 0.0])
    terms = [loss.terms(changed, measured.values, measured.pairs)[0, 0].item() for loss in (plain, seen)]
    assert terms[0] > 0.1 and terms[1] == pytest.approx(0, abs=1e-9)
    assert seen.luminance == (1.0, 0.0) and plain.luminance is None
    assert LearnedLoss(luminance=[1, 1]).with_luminance([1.0, 0.0]).luminance == (1.0, 1.0)


def test_a_fit_in_bands_is_a_material_in_rgb(tmp_path, caplog):
    _, measured = made_up(31)
    result = fit(make_model("ward", 1), measured, RMSLoss())
    result.save(tmp_path / "fits.json")
    kept, rgb = (load(tmp_path / "fits.json", bands=bands) for bands in ("keep", "rgb"))
    assert kept.wavelengths == lengths_of(31) and rgb.is_rgb
    words = "31 bands from 400 to 700 nm become linear RGB (BT.709) by the CIE 1931 observer under illuminant D65"
    assert [record.getMessage() for record in caplog.records] == [f"torchbrdf: {tmp_path}/fits.json: {words}"]
    pairs = pairs_of(50, seed=5).to(dtype=torch.float32)
    torch.testing.assert_close(rgb.at(pairs), kept.to_rgb().at(pairs))
    (record,) = read_fits(tmp_path / "fits.json")
    model, notes = in_rgb(record)
    torch.testing.assert_close(model(pairs), rgb.at(pairs), rtol=1e-4, atol=1e-5)
    assert notes == [
        "colours: linear RGB (BT.709) by the CIE 1931 observer under illuminant D65, of 31 bands from 400 to 700 nm"
    ]
    equal, _ = in_rgb(record, "E")
    weights = weights_of(31, lengths_of(31), "E", "here").float()
    torch.testing.assert_close(equal.components()[0].albedo, torch.tensor(record.parameters["diffuse"]) @ weights)


def test_models_whose_colours_are_no_factors_become_tables():
    _, measured = made_up(5)
    (record,) = fit(make_model("oren_nayar+ggx_f82"), measured, RMSLoss(), max_iterations=20).records()
    table, notes = in_rgb(record)
    assert isinstance(table, Measured) and table.is_rgb and notes[0].endswith("of this model: a table")


def test_a_folder_has_fits_of_the_same_bands(tmp_path):
    _, five = made_up(5)
    settings = {"samples": 200, "max_theta": 80.0}
    Batches(make_model("ward", 1), RMSLoss(), out=tmp_path, **settings).run([five])
    with pytest.raises(DataError, match="paint was fitted in 5 bands from 400 to 440 nm, not linear RGB; give another"):
        Batches(make_model("ward", 1), RMSLoss(), out=tmp_path, **settings).run([five.to_rgb()])


def test_a_model_is_widened_once():
    model = make_model("ggx:f0", 2)
    wide = with_channels(model, 31)
    assert wide.shared == ("f0",) and channels_of(wide) == 31 and with_channels(wide, 31) is wide
    assert parameters(wide)["specular"][0] == [parameters(model)["specular"][0][0]] * 31


def test_the_command_keeps_bands(tmp_path, capsys):
    from helpers.listed_files import astm

    (tmp_path / "paint.astm").write_text(astm())
    arguments = ["fit", str(tmp_path / "paint.astm"), "--lobes", "1", "--bands", "keep", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    (record,) = read_fits(tmp_path / "out" / "fits.json")
    assert record.wavelengths == [465.0, 525.0, 630.0]
    assert main(["info", str(tmp_path / "out" / "fits.json")]) == 0
    said = capsys.readouterr().out
    assert "3 bands of 465, 525, 630 nm" in said and "CIE 1931" in said and "told apart by" in said
    rendered = [*arguments[:-2], "--loss", "rendered", "--size", "8", "--lights", "4"]
    assert main(rendered) == 1
    assert "expected linear RGB, found 3 bands of 465, 525, 630 nm" in capsys.readouterr().err
    assert main([*arguments[:5], "all"]) == 2
    assert main(["check", str(tmp_path / "paint.astm"), "--read", "bands=keep"]) == 2
    assert "--bands" in capsys.readouterr().err


@pytest.mark.parametrize("loss", ["rms", "compressed"])
def test_tables_in_bands_are_those_of_their_channels(loss):
    """Of as many channels as RGB, and of others."""
    _, measured = made_up(3, 2000)
    five = Measured.from_samples(measured.pairs, measured.values[..., [0, 1, 2, 1, 0]], names=["paint"])
    settings = {"diffuse": "fit", "max_iterations": 20}
    three = fit(make_model("distribution_based", 1), measured, make_loss(loss), **settings)
    more = fit(make_model("distribution_based", 1), five, make_loss(loss), **settings)
    assert channels_of(more.model) == 5 and more.status == three.status
    table, wanted = (found.model.components()[1].distribution[0] for found in (more, three))
    torch.testing.assert_close(table, wanted[:, [0, 1, 2, 1, 0]], rtol=0.02, atol=1e-3)
    assert FitRecord.from_json(more.records()[0].to_json()).channels == 5


def test_files_of_fits_without_wavelengths_or_of_several_are_named(tmp_path):
    _, measured = made_up(5)
    (record,) = fit(make_model("ward", 1), measured, RMSLoss(), max_iterations=2).records()
    fits = tmp_path / "fits.json"
    fits.write_text(json.dumps([record.to_json() | {"wavelengths": None}]))
    with pytest.raises(DataError, match=r"fits\.json: paint: expected wavelengths, .* found 5 bands whose wavelengths"):
        load(fits)
    assert load(fits, bands="keep").channels == 5
    fits.write_text(json.dumps([record.to_json(), record.to_json() | {"wavelengths": None}]))
    with pytest.raises(
        DataError, match=r"fits\.json: paint: expected 5 bands from 400 to 440 nm, as .*, found 5 bands"
    ):
        load(fits, bands="keep")
