"""The sheet of pictures: what stands where, and that it is written whole or not at all."""

import math

import matplotlib.figure
import pytest
import torch
from PIL import Image

from torchbrdf.experiment.items import Item
from torchbrdf.report.sheet import ACROSS, SheetCell, sheet_cells, write_sheet


def material(name):
    return Item(f"{name} (measured)", name, "measured")


def fit(name, reference):
    return Item(f"{name}: Ward, 1 lobe, RMS, global", name, "fit", reference)


def test_fits_stand_beside_their_material_and_above_their_maps():
    items = [fit("a", 1), material("a"), material("lonely"), fit("b", None), fit("a", 1)]
    assert sheet_cells(items) == [
        SheetCell(0, 0, 1),
        SheetCell(0, 1, 0),
        SheetCell(1, 1, 0, is_map=True),
        SheetCell(0, 2, 4),
        SheetCell(1, 2, 4, is_map=True),
        SheetCell(2, 0, 2),
        SheetCell(2, 1, 3),
    ]


def test_no_two_cells_are_in_one_place():
    items = [material(str(k)) for k in range(7)] + [fit(str(k % 3), k % 3) for k in range(20)] + [fit("6", 6)]
    cells = sheet_cells(items)
    assert len({(cell.row, cell.column) for cell in cells}) == len(cells) == 28 + 21
    assert {cell.item for cell in cells} == set(range(28))
    assert max(cell.column for cell in sheet_cells([material(str(k)) for k in range(30)])) == ACROSS - 1


def write(path, names=2):
    items = [material("a"), fit("a", 0)][:names]
    display = torch.full((names, 8, 8, 3), 0.25)
    maps = torch.zeros(names, 8, 8)
    maps[-1, :, 4:] = 20.0
    write_sheet(path, items, display, maps, [0.0] * names, torch.ones(8, 8))


def test_pictures_and_maps_have_their_colours(tmp_path):
    write(tmp_path / "sheet.png")
    picture = Image.open(tmp_path / "sheet.png").convert("RGB")
    colors = {color: count for count, color in picture.getcolors(picture.width * picture.height)}

    def count(color):
        return sum(
            own for other, own in colors.items() if max(abs(a - b) for a, b in zip(color, other, strict=True)) < 3
        )

    pictures = count((64, 64, 64))
    assert pictures > 2 * 150**2
    for end in ((0, 0, 3), (251, 252, 191)):  # of magma
        assert count(end) > 0.9 * pictures / 4  # half of one map


def test_what_is_no_number_has_a_colour_of_its_own(tmp_path):
    items = [material("a"), fit("a", 0)]
    display, maps = torch.full((2, 8, 8, 3), 0.25), torch.zeros(2, 8, 8)
    display[1, :, :4], maps[1, :, :4] = math.nan, math.nan
    write_sheet(tmp_path / "sheet.png", items, display, maps, [math.nan] * 2, torch.ones(8, 8))
    picture = Image.open(tmp_path / "sheet.png").convert("RGB")
    colors = {color: count for count, color in picture.getcolors(picture.width * picture.height)}
    half = 0.4 * 150**2
    assert colors[255, 0, 255] > half  # of the picture
    assert colors[0, 255, 0] > half  # of the map
    assert colors[64, 64, 64] > 3 * half


def test_a_sheet_without_fits_has_no_colour_scale(tmp_path):
    write(tmp_path / "with.png")
    write(tmp_path / "without.png", names=1)
    picture = Image.open(tmp_path / "without.png").convert("RGB")
    assert picture.width < Image.open(tmp_path / "with.png").width / 2


def test_it_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    (tmp_path / "sheet.png").write_text("before")

    def fails(self, path, **options):
        path.write(b"half")
        raise RuntimeError("no memory")

    monkeypatch.setattr(matplotlib.figure.Figure, "savefig", fails)
    with pytest.raises(RuntimeError):
        write(tmp_path / "sheet.png")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"sheet.png": "before"}
