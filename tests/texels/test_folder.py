"""Folders of texels: taken up bit for bit, nothing mixed, and maps that other programs read."""

import numpy as np
import pytest
import torch
from PIL import Image

from torchbrdf.errors import DataError, UsageError
from torchbrdf.images import read_image
from torchbrdf.texels import TexelStatus, fit_texels, open_texels
from torchbrdf.texels.folder import RECORD
from torchbrdf.texels.writing import COLORS, write_maps


def fitted(scene, out, **options):
    own = {"normals": scene.surface.normals, "tile": 8, "formats": (), "max_iterations": 5, "held": ("f0",), "out": out}
    return fit_texels(options.pop("stack", scene.stack), scene.lights, **(own | options))


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("texels")
    fitted(scene, path, formats=("exr", "png"))
    return path


def files(path):
    return {one.relative_to(path): one.read_bytes() for one in path.rglob("*") if one.is_file()}


class _StopError(Exception):
    pass


def test_a_fit_that_was_stopped_is_taken_up_bit_for_bit(scene, folder, tmp_path):
    def stop(done, total):
        if done >= 128:
            raise _StopError

    with pytest.raises(_StopError):
        fitted(scene, tmp_path, progress=stop)
    before = files(tmp_path)
    assert 1 < len(before) < len(files(folder))
    begun = []
    fitted(scene, tmp_path, formats=("exr", "png"), progress=lambda done, total: begun.append(done))
    assert begun[0] >= 128 and files(tmp_path) == files(folder)


@pytest.mark.parametrize("harm", ["cut", "changed", "gone", "of another tile", "of other settings"])
def test_a_tile_that_is_not_what_was_written_is_made_again_or_refused(scene, folder, tmp_path, harm, caplog):
    fitted(scene, tmp_path, formats=("exr", "png"))
    path = tmp_path / "tiles" / "00000-00001.npz"
    data = path.read_bytes()
    if harm == "gone":
        path.unlink()
    elif harm.startswith("of"):
        other = tmp_path / "tiles" / "00000-00000.npz"
        if harm == "of other settings":
            other = tmp_path / "other" / "tiles" / path.name
            fitted(scene, tmp_path / "other", max_theta=70)
        path.write_bytes(other.read_bytes())
        with pytest.raises(DataError, match=f"{path.name}: expected this tile by the settings in {RECORD}"):
            fitted(scene, tmp_path)
        return
    else:
        path.write_bytes(data[:-50] if harm == "cut" else data[:400] + bytes([data[400] ^ 1]) + data[401:])
    fitted(scene, tmp_path, formats=("exr", "png"))
    assert files(tmp_path) == files(folder)
    assert ("it is fitted again" in caplog.text) == (harm != "gone")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"max_theta": 70.0}, "fitted with max_theta 80.0, not 70.0"),
        ({"tile": 16}, "fitted with tile 8, not 16"),
        ({"saturation": 0.5}, "fitted with saturation None, not 0.5"),
        ({"irradiance": 2.0}, "expected the irradiance that its tiles were fitted with, found another"),
        ({"normals": None}, "expected the stack that its tiles were fitted with, found another"),
    ],
)
def test_nothing_is_mixed(scene, folder, change, said):
    with pytest.raises(DataError, match=f"{RECORD}: {said}; give another folder"):
        fitted(scene, folder, **change)
    with pytest.raises(DataError, match="expected the stack that its tiles"):
        fitted(scene, folder, stack=scene.stack * 1.5)


def test_a_record_that_is_damaged_is_said(scene, folder, tmp_path):
    for text, said in (("{", "truncated"), ('{"settings": {"size": [1]}}', "found {'size'"), ("[]", "expected")):
        (tmp_path / RECORD).write_text(text)
        with pytest.raises(DataError, match=said):
            open_texels(tmp_path)
        with pytest.raises(DataError, match=said):
            fitted(scene, tmp_path)
    with pytest.raises(DataError, match="no such file"):
        open_texels(tmp_path / "nothing")


def test_maps_are_read_as_they_were_fitted(scene, folder):
    found, again = open_texels(folder), fitted(scene, None)
    for name in again.names:
        np.testing.assert_array_equal(found[name], again[name])
        np.testing.assert_array_equal(found.region(name, slice(5, 11), slice(6, 16)), again[name][5:11, 6:16])
    with pytest.raises(UsageError, match="map"):
        found["depth"]


def test_files_have_what_maps_have(folder):
    maps = open_texels(folder)
    for name in maps.names:
        if name != "status":
            picture = read_image(folder / f"{name}.exr").numpy()
            np.testing.assert_array_equal(picture, np.broadcast_to(maps[name], picture.shape))
    pixels = np.asarray(Image.open(folder / "status.png"))
    np.testing.assert_array_equal(pixels, COLORS[maps["status"][..., 0]])
    rough = np.asarray(Image.open(folder / "roughness.png"))[..., 0]
    np.testing.assert_allclose(rough / 255, maps["roughness"][..., 0].clip(0, 1), atol=0.003)


def test_zarr_has_every_map_and_is_the_same_each_time(folder, tmp_path):
    zarr = pytest.importorskip("zarr")
    maps = open_texels(folder)
    for out in ("one", "two"):
        write_maps(maps, tmp_path / out, ("zarr",))
    path = tmp_path / "one" / "maps.zarr.zip"
    assert path.read_bytes() == (tmp_path / "two" / "maps.zarr.zip").read_bytes()
    assert [one.name for one in path.parent.iterdir()] == [path.name]
    group = zarr.open_group(zarr.storage.ZipStore(path, mode="r"), mode="r")
    assert sorted(group.array_keys()) == sorted(maps.names)
    for name in maps.names:
        np.testing.assert_array_equal(group[name][:], maps[name])


def test_tiles_that_are_not_there_have_failed(scene, tmp_path):
    def damaged(rows, columns):
        if rows.start >= 8:
            raise ValueError("checksum")
        return scene.stack[:, rows, columns]

    fitted(scene, tmp_path, stack=damaged, size=(16, 16))
    assert (open_texels(tmp_path)["status"][8:] == TexelStatus.FAILED).all()
    assert not np.isfinite(open_texels(tmp_path)["error"][8:]).any()


def test_pictures_of_what_is_not_known_are_magenta(scene, tmp_path):
    stack = scene.stack.copy()
    stack[:, :2] = np.nan
    write_maps(fitted(scene, None, stack=stack), tmp_path, ("png",))
    assert torch.from_numpy(np.asarray(Image.open(tmp_path / "albedo.png")).copy())[0, 0].tolist() == [255, 0, 255]
