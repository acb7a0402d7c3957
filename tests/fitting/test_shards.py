"""Folders of fits in parts: written once, taken up, spoilt, of other settings, by two at once, with a bad file."""

import json
import shutil
import threading

import pytest
from helpers.tiny_materials import timeless, write_tiny

from torchbrdf.errors import DataError
from torchbrdf.fitting import Batches, tables
from torchbrdf.fitting.blocks import FitBlock, Fitted
from torchbrdf.lobes import make_model, read_fits
from torchbrdf.lobes.parts import FitFolder, settings_hash
from torchbrdf.losses import RMSLoss
from torchbrdf.measured import load, load_all, load_later


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("tiny"), 40, 60)


@pytest.fixture(scope="module")
def whole(files, tmp_path_factory):
    """A folder of all of them."""
    out = tmp_path_factory.mktemp("whole")
    batches(out).run(load_later(files))
    return out


@pytest.fixture
def out(whole, tmp_path):
    """A copy of it."""
    return shutil.copytree(whole, tmp_path / "out")


def batches(folder, **settings):
    return Batches(make_model("ward", 1), RMSLoss(), out=folder, samples=None, diffuse="fit", **settings)


def test_each_block_is_a_part_with_a_head_and_a_record_a_line(whole, files):
    manifest = FitFolder(whole).manifest()
    assert [one.path for one in manifest.inputs] == [str(path) for path in files]
    assert len(manifest.parts) == 14 and manifest.hash == settings_hash(manifest.settings)
    parts = sorted((whole / "fits").iterdir())
    assert [path.name for path in parts[:2]] == ["part-00000.jsonl", "part-00001.jsonl"] and len(parts) == 14
    head, *lines = [json.loads(line) for line in parts[0].read_text().splitlines()]
    assert head["fits"] == len(lines) == 3 and head["settings"] == manifest.hash
    assert [line["material"] for line in lines] == ["m000000", "m000001", "m000002"]
    assert json.loads((whole / "fits.json").read_text())[:3] == lines


def test_what_is_missing_is_made_and_nothing_else(out, whole, files):
    gone = [out / "fits" / name for name in ("part-00003.jsonl", "part-00013.jsonl")]
    for path in gone:
        path.unlink()
    before = {path: path.stat().st_mtime_ns for path in (out / "fits").iterdir()}
    seen = []
    made = list(batches(out).fits(load_later(files), lambda *now: seen.append(now), bad=[]))
    assert [len(own) for own in made] == [3, 1] and seen == [(36, 40), (39, 40), (40, 40)]
    assert before == {path: path.stat().st_mtime_ns for path in before}
    assert timeless(out) == timeless(whole)


def test_readers_take_the_folder(whole, out):
    names = [f"m{k:06d}" for k in range(40)]
    for path in (whole, whole / "manifest.json", whole / "fits.json"):
        assert [record.material for record in read_fits(path)] == names
        assert load(path).names == names
    (out / "fits.json").unlink()
    assert read_fits(out) == read_fits(whole)
    assert [group.names for group in load_all([out])] == [names]


def test_more_fits_than_a_table_holds_are_read_by_their_parts(out, files, monkeypatch):
    monkeypatch.setattr(tables, "MOST", 39)
    batches(out).run(load_later(files))
    assert {path.name for path in out.iterdir()} == {"manifest.json", "fits"}
    assert len(read_fits(out)) == 40


def cut(path):
    path.write_bytes(path.read_bytes()[:-100])


def without_a_line(path):
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))


def doubled(path):
    path.write_text(2 * path.read_text())


def of_other_settings(path):
    path.write_text(path.read_text().replace('"settings": "', '"settings": "0', 1))


def changed(path):
    path.write_text(path.read_text().replace("converged", "konverged"))


SPOILT = [
    (cut, "expected 3 fits as they were written, found 2: it was cut short"),
    (without_a_line, "expected 3 fits as they were written, found 2: lines are missing"),
    (doubled, "expected 3 fits as they were written, found 7: there are more"),
    (of_other_settings, "expected fits with the settings .* of manifest.json, found some with '0"),
    (lambda path: path.write_text(""), "expected the head of a part of fits, found b''"),
    (lambda path: shutil.copy(path.with_name("part-00001.jsonl"), path), "expected part 2, found part 1"),
    (
        lambda path: path.write_text(path.read_text().replace("converged", "konverged")),
        "expected 3 fits as they were written, found 3: it was changed",
    ),
]


@pytest.mark.parametrize(("spoil", "said"), SPOILT)
def test_a_spoilt_part_is_said_and_made_again(out, whole, files, caplog, spoil, said):
    spoil(out / "fits" / "part-00002.jsonl")
    with pytest.raises(DataError, match=f"part-00002.jsonl: {said}"):
        read_fits(out)
    bad = []
    assert len(read_fits(out, bad)) == 37 and len(bad) == 1
    batches(out).run(load_later(files))
    assert "its fits are made again" in caplog.text
    assert timeless(out) == timeless(whole)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda m: m["settings"].update(seed=3), "expected the hash of its settings"),
        (lambda m: m.update(version=7), "expected version 1, found 7"),
        (lambda m: m.update(parts=[0, 99]), "parts: expected rising numbers from 0 to 40"),
        (lambda m: m["inputs"].append(["m000000", "", ""]), "inputs: expected names that differ, found 40 of them"),
        (lambda m: m.pop("inputs") and m.update(inputs=3), "inputs"),
    ],
)
def test_a_manifest_that_cannot_be_is_refused(out, files, change, said):
    manifest = json.loads((out / "manifest.json").read_text())
    change(manifest)
    (out / "manifest.json").write_text(json.dumps(manifest))
    for use in (lambda: read_fits(out), lambda: batches(out)):
        with pytest.raises(DataError, match=f"manifest.json: .*{said}"):
            use()


def test_other_settings_are_refused(whole):
    for settings, said in ({"seed": 1}, "seed 0, not 1"), ({"reading": {"angles": "degrees"}}, "reading {}, not {'a"):
        with pytest.raises(DataError, match=f"manifest.json: its fits were made with {said}.*; give another folder"):
            batches(whole, **settings)


def test_another_file_of_a_name_is_refused(out, files, tmp_path):
    other = shutil.copy(files[1], tmp_path / "m000000.npz")
    with pytest.raises(DataError, match=r"m000000: expected the material that .*manifest.json has, found another"):
        batches(out).run(load_later([other]))


def test_a_folder_of_before_is_taken_up(out, whole, files):
    shutil.rmtree(out / "fits")
    (out / "manifest.json").unlink()
    kept = json.loads((out / "fits.json").read_text())[:25]
    (out / "fits.json").write_text(json.dumps(kept))
    measured = load(files)
    from torchbrdf.fitting.known import KnownMaterials

    known = KnownMaterials(out)
    for k, name in enumerate(measured.names[:25]):
        known.check(name, measured.batch([k]))
    known.save()
    seen = []
    records = batches(out).run(load_later(files), lambda *now: seen.append(now))
    assert seen[0] == (25, 40) and [record.material for record in records] == measured.names
    assert {path.name for path in out.iterdir()} == {"manifest.json", "fits", "fits.json", "fits.csv"}
    assert json.loads((out / "fits.json").read_text())[:25] == kept
    assert not [one for one in FitFolder(out).manifest().inputs if not one.digest.startswith("file:")]


def test_one_bad_file_among_many_is_said_and_the_rest_is_done(out, files, tmp_path):
    folder = tmp_path / "some"
    folder.mkdir()
    mixed = [shutil.copy(path, folder / path.name) for path in files[:20]]
    (folder / "m000007.npz").write_bytes(files[7].read_bytes()[:400])
    values = folder / "m000009.csv"
    values.write_text("theta_i,theta_o,phi,r,g,b\n0.1,0.2,0.3,nan,1,1\n")
    bad = []
    records = batches(tmp_path / "new").run(load_later([*mixed[:9], *mixed[10:], values], bad=bad), bad=bad)
    assert len(records) == 18 and len(bad) == 2
    assert any("m000007.npz" in str(error) for error in bad) and any("m000009.csv" in str(error) for error in bad)
    shutil.copy(files[7], folder / "m000007.npz")  # mended
    values.write_text("theta_i,theta_o,phi,r,g,b\n" + "".join(f"0.{k},0.2,0.3,1,1,1\n" for k in range(1, 9)))
    again = []
    records = batches(tmp_path / "new").run(load_later([*mixed[:9], values], bad=again), bad=again)
    assert len(records) == 10 and not again


def test_a_material_that_cannot_be_fitted_leaves_the_others_of_its_block_be(files):
    class FailingLoss(RMSLoss):
        def problem(self, measured, subset=None):
            if "m000004" in measured.names:
                raise RuntimeError("not today")
            return super().problem(measured, subset)

    bad = []
    made = Batches(make_model("ward", 1), FailingLoss(), samples=None, diffuse="fit")
    assert len(made.run(load_later(files[:10]), bad=bad)) == 9
    assert [str(error) for error in bad] == ["m000004: the fit failed: RuntimeError: not today"]
    with pytest.raises(DataError, match="m000004: the fit failed: RuntimeError: not today"):
        made.run(load_later(files[:10]))


def test_two_runs_of_the_same_shard_at_once_end_as_one(whole, files, tmp_path):
    runs = [threading.Thread(target=batches(tmp_path).run, args=(load_later(files),)) for _ in range(2)]
    for one in runs:
        one.start()
    for one in runs:
        one.join()
    assert timeless(tmp_path) == timeless(whole)


def test_a_full_disk_is_one_line_and_what_is_written_is_taken_up(whole, files, tmp_path, monkeypatch):
    import torchbrdf.lobes.parts as parts

    def fails(path, data):
        if path.name == "part-00005.jsonl":
            raise DataError(f"{path}: cannot be written (No space left on device)")
        write(path, data)

    write = parts.write_bytes
    monkeypatch.setattr(parts, "write_bytes", fails)
    with pytest.raises(DataError, match=r"part-00005.jsonl: cannot be written"):
        batches(tmp_path).run(load_later(files))
    monkeypatch.undo()
    assert len(read_fits(tmp_path)) == 15
    batches(tmp_path).run(load_later(files))
    assert timeless(tmp_path) == timeless(whole)


def test_parquet_has_the_columns_of_the_table(out, files):
    parquet = pytest.importorskip("pyarrow.parquet")
    made = batches(out)
    made.run(load_later(files))
    made.write_tables(parquet=True)
    table = parquet.read_table(out / "fits.parquet")
    header = (out / "fits.csv").read_text().splitlines()[0].split(",")
    assert table.num_rows == 40 and table.column_names == header
    records = json.loads((out / "fits.json").read_text())
    assert table["error"].to_pylist() == [record["error"] for record in records]
    assert table["roughness_0"].to_pylist() == [record["parameters"]["roughness"][0] for record in records]


def test_what_is_fitted_on_a_device_is_opened_there_and_one_block_after_the_other(files, monkeypatch):
    seen = []

    def fitted(work, block):
        (measured,) = block.group.opened([])
        seen.append((measured.device.type, measured.values.device.type, measured.pairs.cos_i.device.type))
        return Fitted([], [])

    monkeypatch.setattr(FitBlock, "__call__", fitted)
    monkeypatch.setattr("torchbrdf.fitting.batches.side_by_side", None)  # would be called for what is on the CPU
    groups = load_later(files, device="meta")  # what torch has in the place of a GPU: shapes, and no values
    assert list(batches(None).fits(groups, bad=[])) == [[]] * 14
    assert seen == [("meta", "meta", "meta")] * 14
