"""`export`: what is taken, what is refused, and what is written where."""

from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch

from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.export import EXPORTERS, Exported, Exporter, Material, export, picture_differences
from torchbrdf.export.base import needed, numbers
from torchbrdf.files import write_text
from torchbrdf.lobes import GGX, FitRecord, Lambert, Lobe, Sum, Ward, make_model, parameters, write_fits
from torchbrdf.measured import Measured, load, standins
from torchbrdf.names import file_stem
from torchbrdf.render import Scene, sphere


class Text(Exporter):
    """Writes what it was given as text."""

    suffix: ClassVar[str] = ".binary"

    def write(self, material: Material, folder: Path) -> Exported:
        path = material.path(folder, self.suffix)
        write_text(path, repr(material.brdf))
        return Exported([path], True, ["exact: as text"], material.brdf)


@pytest.fixture(autouse=True)
def text(monkeypatch: pytest.MonkeyPatch) -> None:
    """An exporter named text."""
    len(EXPORTERS)
    monkeypatch.setitem(EXPORTERS._things, "text", Text)


PAINT = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.1, roughness=0.2))


def record(name: str = "paint", model: Sum = PAINT, kind: str = "ward", **more: object) -> FitRecord:
    return FitRecord(name, kind, len(model.components()) - 1, parameters(model), **more)


def test_whatever_holds_one_material_is_exported(tmp_path: Path, merl_file: Path) -> None:
    write_fits(tmp_path / "fits.json", [record()])
    stands_in = load(standins()).batch([7])
    given = {
        "material": PAINT,
        "paint": record(),
        "made-up": load(merl_file),
        "nylon": stands_in,
    }
    for name, brdf in given.items():
        done = export(brdf, "text", tmp_path / "out")
        assert done.files == [tmp_path / "out" / f"{name}.binary"] and done.files[0].exists()
    assert export(tmp_path / "fits.json", "text", tmp_path / "out").files[0].name == "paint.binary"
    assert export(str(merl_file), "text", tmp_path / "out", name="other").files[0].name == "other.binary"
    assert isinstance(export(stands_in, "text", tmp_path / "out").shown, Lobe)  # a model in a measurement's place


def test_a_name_is_a_file_everywhere(tmp_path: Path) -> None:
    done = export(PAINT, "text", tmp_path, name="a:b")
    assert done.files[0].name == f"{file_stem('a:b')}.binary"


@pytest.mark.parametrize("name", ["", "a/b", "..", "a\nb", " a", 3])
def test_a_name_that_is_none_writes_nothing(name: object, tmp_path: Path) -> None:
    for brdf in (PAINT, record(), load(standins()).batch([7])):
        with pytest.raises(DataError, match=r"^export: name: expected a name"):
            export(brdf, "text", tmp_path, name=name)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("brdf", "message"),
    [
        (PAINT.batched(3), "^material: expected one material, found a model of 3"),
        (load(standins()), r"^export: expected one material, found 10; export each of them: measured.batch\(\[k\]\)$"),
        (standins(), "standins.json: expected one material, found 10 fits; "),
        (
            GGX(roughness=1.5),
            r"^material: expected parameters within their bounds, found roughness 1.5, not 0.001 to 1$",
        ),
        (
            Lambert(albedo=[0.5, -0.1, 0.5]),
            r"^material: expected parameters within their bounds, found albedo -0.1, not 0 to 1$",
        ),
        (
            record(model=Sum(Lambert(), Ward(roughness=0.7))),
            r"^paint: expected parameters within their bounds, found roughness 0.7, not 0.001 to 0.5$",
        ),
        ("nowhere.binary", r"^nowhere.binary: no such file or folder$"),
        ("", "^expected a path of measured BRDFs"),
        (torch.ones(3), r"^export: expected a lobe, a Measured, a FitRecord or a path, found tensor"),
        (None, "^export: expected a lobe, a Measured, a FitRecord or a path, found None$"),
    ],
)
def test_what_is_no_single_material_is_said_in_one_line(brdf: object, message: str, tmp_path: Path) -> None:
    with pytest.raises(TorchbrdfError, match=message):
        export(brdf, "text", tmp_path)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_bounds_leave_room_for_rounding(tmp_path: Path) -> None:
    assert export(Ward(specular=1 + 1e-6, roughness=0.5 + 1e-7), "text", tmp_path).files[0].exists()


def test_an_unknown_exporter_is_said(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=r"^unknown exporter 'mitsubishi'; expected one of .*did you mean 'mitsuba'\?$"
    ):
        export(PAINT, "mitsubishi", tmp_path)
    with pytest.raises(UsageError, match=r"^to: expected one of"):
        export(PAINT, None, tmp_path)  # type: ignore[arg-type]


def test_a_mesh_is_for_those_that_write_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"^mesh: expected none, since text writes materials only, found "):
        export(PAINT, "text", tmp_path, mesh="sphere")


def test_a_file_is_not_written_over_itself(tmp_path: Path, merl_file: Path) -> None:
    path = tmp_path / "nickel.binary"
    path.symlink_to(merl_file)
    before = merl_file.stat()
    with pytest.raises(DataError, match=r"nickel.binary: expected another folder or name, found the file that is exp"):
        export(path, "text", tmp_path)
    assert merl_file.stat() == before and path.is_symlink()


def test_another_packages_exporter_may_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Text, "write", lambda *_: 1 / 0)
    with pytest.raises(
        DataError, match=r"^material: Text of .*test_export failed: ZeroDivisionError: division by zero$"
    ):
        export(PAINT, "text", tmp_path)
    monkeypatch.setattr(Text, "write", lambda *_: None)
    with pytest.raises(UsageError, match=r"^Text of .*test_export: expected to get an Exported, found None$"):
        export(PAINT, "text", tmp_path)


def test_a_measurement_that_ends_before_the_horizon_is_said(tmp_path: Path, merl_file: Path) -> None:
    measured = load(merl_file)
    assert len(export(measured, "pbrt", tmp_path, name="whole").notes) == 1
    (_, said) = export(measured.within(60), "pbrt", tmp_path, name="part").notes
    assert said == "measured up to 60 degrees from the normal; beyond, values are extrapolated"
    assert export(measured.within(60), "text", tmp_path).notes == ["exact: as text"]


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match=r"file: expected a folder or a new name, found a file$"):
        export(PAINT, "text", tmp_path / "file")


def test_what_is_given_is_left_as_it_is(tmp_path: Path) -> None:
    model = make_model("ggx", 1)
    before = parameters(model)
    done = export(model, "text", tmp_path)
    assert parameters(model) == before and done.shown is not model


def test_a_package_that_is_not_there_is_named() -> None:
    with pytest.raises(UsageError, match=r"^to write: expected the package nowhere, found none \(.*\[there\]'$"):
        needed("nowhere", "there", "to write")


def test_pictures_of_the_same_are_the_same() -> None:
    scene = Scene(sphere(2), size=16, nodes=8, light_samples=16)
    assert picture_differences(PAINT, PAINT, scene) == {"delta_e76": 0, "delta_e_itp": 0}
    measured = load(standins()).batch([7])
    found = picture_differences(measured, PAINT, scene, ["delta_e76", "psnr", "log_hdr"])
    assert found["delta_e76"] > 1 and found["psnr"] > 0 and found["log_hdr"] > 0


def test_samples_without_a_valid_one_have_no_picture() -> None:
    """What an exporter that needs values elsewhere says."""
    from torchbrdf.pairs import Pairs

    angle = torch.tensor([[0.1, 0.2]])
    pairs = Pairs.from_half_diff(angle, angle, angle)
    measured = Measured.from_samples(pairs, torch.ones(1, 2, 3), torch.zeros(1, 2, 1), names=["made up"])
    with pytest.raises(DataError, match="made up: expected valid samples, found none"):
        picture_differences(measured, measured, Scene(sphere(2), size=16, nodes=8, light_samples=16))


def test_numbers_do_not_depend_on_how_numpy_prints() -> None:
    """Some libraries have it print six digits, which is a shift of sharp lobes."""
    with np.printoptions(legacy="1.13"):
        assert numbers(torch.tensor([1 / 3, 0.3], dtype=torch.float64)) == [0.33333334, 0.3]
