"""The zoo: models that come with the package, by names in a file's place."""

import statistics
import warnings
from pathlib import Path

import pytest
import torch
from helpers.measured_files import synthetic_raw, write_raw_merl

from torchbrdf.errors import DataError
from torchbrdf.experiment.matching.judge import Judge
from torchbrdf.export import export
from torchbrdf.lobes import GGX, FitRecord, Lambert, Sum, model_of, parameters, read_fits, write_fits, zoo_names
from torchbrdf.lobes.zoo import is_zoo, zoo_file, zoo_record, zoo_records
from torchbrdf.measured import MERL_NAMES, PAPER_TEN, describe, load, load_all, standins
from torchbrdf.pairs import Pairs
from torchbrdf.render import unseen_scenes

MODELS = ["ggx", "gltf", "openpbr"]
RGL = {
    "acrylic_felt_pink", "acrylic_felt_white", "aurora_white", "cc_ibiza_sunset",
    "cc_nothern_aurora", "cg_sunflower", "chm_light_blue", "cm_toxic_green", "colodur_azure_4e",
    "colodur_connemara_4c", "ilm_l3_37_matte", "irid_flake_paint2", "paper_white", "satin_purple",
    "vch_dragon_eye_red", "vch_ultra_pink",
}  # fmt: skip
ORIGINS = {
    "`zoo:NAME`, MERL's materials as neural stand-ins": set(MERL_NAMES),
    "`zoo:NAME`, RGL's measurements": RGL,
    "`zoo:standin-NAME`, the bundled stand-ins": {f"standin-{name}" for name in PAPER_TEN},
}
OTHER = FitRecord("other", "ggx", 1, parameters(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=0.5, roughness=0.2))))


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """An empty folder to be in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_name_gives_a_material():
    (record,) = read_fits("zoo:nickel:gltf")
    assert (record.material, record.model) == ("nickel", "gltf")
    pairs = Pairs.from_half_diff(*(torch.tensor([[angle]]) for angle in (0.1, 0.4, 1.0)))
    for path in ("zoo:nickel:gltf", Path("zoo:nickel:gltf"), ["zoo:nickel:gltf", "zoo:nickel:gltf"]):
        measured = load(path)
        assert measured.names == ["nickel"] and measured.stand_in
        torch.testing.assert_close(measured.at(pairs), model_of([record])(pairs))


def test_the_first_model_needs_no_name():
    assert read_fits("zoo:nickel") == read_fits("zoo:nickel:ggx") != read_fits("zoo:nickel:openpbr")


def test_names_and_files_go_together(place):
    write_raw_merl(place / "nickel.binary", synthetic_raw())
    groups = load_all(["zoo:nickel", "nickel.binary", "zoo:brass:openpbr"])
    assert [group.names for group in groups] == [["nickel", "brass"], ["nickel"]]
    assert load(["zoo:nickel", "zoo:nickel:gltf"]).names == [
        "nickel-ggx-2-rendered_delta_e76",
        "nickel-gltf-1-rendered_delta_e76",
    ]


def test_it_is_exported_and_described():
    assert export("zoo:nickel:gltf", "gltf", "out").exact
    facts = describe("zoo:nickel:gltf")
    assert facts["model"] == "gltf" and "Sztrajman" in facts["model of"] and "bytes" not in facts
    pictures = zoo_record("zoo:nickel:gltf")["pictures"]
    assert facts["delta_e76 of torus, evening"] == pictures["torus, evening"]["delta_e76"]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("zoo:", "^zoo:: expected a name behind zoo: such as zoo:nickel, found none; torchbrdf info --zoo lists them$"),
        ("zoo::gltf", "^zoo::gltf: expected a name behind zoo: such as zoo:nickel, found none"),
        ("zoo:nickle", r"^zoo:nickle: expected a material of the zoo, found none; did you mean nickel\b.*lists them$"),
        ("zoo:Nickel", "did you mean nickel or standin-nickel"),
        ("zoo:felt", "did you mean pink-felt or acrylic_felt_pink or acrylic_felt_white"),
        ("zoo:7f%*", "^[^?]*found none; torchbrdf info --zoo lists them$"),
        ("zoo:nickel:ward", "^zoo:nickel: expected one of the models ggx, gltf, openpbr behind it, found 'ward'$"),
        ("zoo:nickel:", "^zoo:nickel: expected one of the models ggx, gltf, openpbr behind it, found none$"),
        ("zoo:nickel:gltf:1", "behind it, found 'gltf:1'$"),
        ("zoo:\x1b[31m\n" + 9999 * "x", "^zoo:.*lists them$"),
        ("zoo:a\0b", "expected a material of the zoo, found none"),
    ],
)
def test_what_is_not_there_is_said_in_a_line(name, said):
    for read in (load, read_fits, load_all):
        with pytest.raises(DataError, match=said) as caught:
            read(name)
        assert len(str(caught.value)) <= 300 and str(caught.value).isprintable()


def test_one_wrong_name_leaves_the_others_be():
    bad: list[DataError] = []
    (group,) = load_all(["zoo:nickel", "zoo:nickle"], bad=bad)
    assert group.names == ["nickel"] and ["zoo:nickle" in str(one) for one in bad] == [True]


def test_a_file_that_is_called_so_is_another_path(place):
    for name in ("zoo:nickel", "zoo:mine"):
        write_fits(place / name, [OTHER])
    assert load("zoo:nickel").names == ["nickel"]
    for path in ("./zoo:nickel", place / "zoo:nickel"):
        assert load(path).names == read_fits(path)[0].material.split() == ["other"]
    assert load("./zoo:mine").names == ["other"]
    with pytest.raises(DataError, match=r"the file of that name is \./zoo:mine$"):
        load("zoo:mine")
    assert len(load(".")) == 2 and {record.material for record in load(".").source.records} == {"other"}


def test_a_folder_may_be_called_so(place):
    (place / "zoo:mine").mkdir()
    write_fits("zoo:mine/fits.json", [OTHER])
    assert load("zoo:mine/fits.json").names == load("./zoo:mine").names == ["other"]
    assert read_fits(Path("zoo:mine") / "fits.json")[0].material == "other"
    assert not is_zoo("zoo:mine/fits.json")


def test_it_has_every_material_by_every_model():
    by_name: dict[str, list[str]] = {}
    for record in zoo_records():
        by_name.setdefault(record["material"], []).append(record["model"])
    assert zoo_names() == sorted(by_name)
    assert set(by_name) == {*MERL_NAMES, *RGL, *(f"standin-{name}" for name in PAPER_TEN)}
    assert all(models == MODELS for models in by_name.values())


def test_it_is_small_and_what_a_fit_could_end_at():
    assert zoo_file().stat().st_size < 300_000
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        records = read_fits(zoo_file())
    for record in records:
        assert list(record.pictures) == ["sphere, studio", "torus, evening", "knot, room"]
        assert all(0 < own["delta_e76"] < 25 and own["delta_e_itp"] > 0 for own in record.pictures.values())
        said = record.extra["source"]
        assert ("RGL" in said) == (record.material in RGL)
        assert ("stand-in" in said) == (record.material not in RGL)


@pytest.mark.slow  # three scenes at full size
@pytest.mark.parametrize("model", MODELS)
def test_its_figures_are_those_of_its_pictures(model):
    names = ["alum-bronze", "nickel", "pearl-paint"]
    measured, scenes = load(standins()), unseen_scenes()
    for name in names:
        (record,) = read_fits(f"zoo:standin-{name}:{model}")
        judge = Judge(measured.batch([measured.names.index(name)]), scenes)
        for scene, found in judge.figures(record).items():
            assert found.differences == pytest.approx(record.pictures[scene], rel=0.02)


def test_the_page_says_how_near_they_are():
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "zoo.md").read_text(encoding="utf-8")
    for begins, names in ORIGINS.items():
        cells = []
        for model in MODELS:
            own = [read["pictures"] for read in zoo_records() if read["model"] == model and read["material"] in names]
            means = [statistics.fmean(scene["delta_e76"] for scene in pictures.values()) for pictures in own]
            cells.append(f"{statistics.fmean(means):.1f} / {max(means):.1f}")
        assert f"| {begins} | {len(names)} | {' | '.join(cells)} |" in page
