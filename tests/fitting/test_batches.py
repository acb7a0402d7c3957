"""Folders of fits that several processes write, that were left half-written, or with fits whose process died."""

import csv
import os
import signal
import threading

import pytest
import torch
from helpers.known_models import measured_from, some_pairs, two_lobes

from torchbrdf.errors import DataError, UsageError
from torchbrdf.fitting import Batches, Status, cross_score, fit
from torchbrdf.lobes import make_model, read_fits
from torchbrdf.lobes.parts import FitFolder, part_bytes
from torchbrdf.losses import CompressedLoss, CubeRootLoss, LearnedLoss, RMSLoss
from torchbrdf.measured import Measured, load, standins


def materials(names):
    measured = measured_from(two_lobes("ward", len(names)), some_pairs(300), materials=len(names))
    measured.source.names = list(names)
    return measured


def batches(folder):
    return Batches(make_model("ward", 1), RMSLoss(), out=folder, samples=None)


def rows_of_table(folder):
    with (folder / "fits.csv").open(newline="") as file:
        return [row["material"] for row in csv.DictReader(file)]


def test_several_at_once_add_to_one_folder(tmp_path):
    every = [batches(tmp_path) for _ in range(4)]
    threads = [
        threading.Thread(target=one.run, args=([materials([f"m{k}", "shared"])],)) for k, one in enumerate(every)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = [record.material for record in read_fits(tmp_path / "fits.json")]
    assert sorted(found) == ["m0", "m1", "m2", "m3", "shared"]
    assert rows_of_table(tmp_path) == found
    assert {one.name for one in tmp_path.iterdir()} == {"fits.json", "fits.csv", "manifest.json", "fits"}


@pytest.mark.parametrize("spoil", [lambda path: path.unlink(), lambda path: path.write_text("material\nold\n")])
def test_a_table_that_is_missing_or_old_is_made_again(tmp_path, spoil):
    batches(tmp_path).run([materials(["a", "b"])])
    whole = (tmp_path / "fits.csv").read_bytes()
    before = (tmp_path / "fits.json").stat().st_mtime_ns
    spoil(tmp_path / "fits.csv")
    batches(tmp_path).run([materials(["a", "b"])])
    assert (tmp_path / "fits.csv").read_bytes() == whole
    assert (tmp_path / "fits.json").stat().st_mtime_ns == before


def test_a_fit_whose_process_died_is_made_again(tmp_path):
    batches(tmp_path).run([materials(["a", "b"])])
    folder = FitFolder(tmp_path)
    manifest = folder.manifest()
    (good,) = folder.lines(1, manifest)
    bad = good | {"status": "lost", "reason": "its worker process ended twice", "error": None}
    folder.part_path(1).write_bytes(part_bytes(1, manifest.hash, [bad]))
    a, b = batches(tmp_path).run([materials(["a", "b"])])
    assert b.status == "converged" and b.error == good["error"]
    assert [record.status for record in read_fits(tmp_path / "fits.json")] == [a.status, "converged"]


def test_fits_are_taken_up_with_the_diffuse_treatment_that_the_loss_has(tmp_path):
    class FreeLoss(RMSLoss):
        default_diffuse = "fit"

    (record,) = Batches(make_model("ward", 1), FreeLoss(), out=tmp_path, samples=None).run([materials(["a"])])
    assert record.diffuse == "fit"
    Batches(make_model("ward", 1), FreeLoss(), out=tmp_path, samples=None, diffuse="fit")
    with pytest.raises(DataError, match="its fits were made with diffuse 'fit', not '45:0'; give another folder"):
        Batches(make_model("ward", 1), FreeLoss(), out=tmp_path, samples=None, diffuse="45:0")


def deadly_loss(folder, times):
    """RMS that kills the process at work on nylon, so often; its class goes to workers by value, as a script's does."""

    class DeadlyLoss(RMSLoss):
        def problem(self, measured, subset=None):
            done = len(list(folder.iterdir()))
            if "nylon" in measured.names and done < times and os.getpid() != owner:
                (folder / str(done)).touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return super().problem(measured, subset)

    owner = os.getpid()
    return DeadlyLoss()


@pytest.fixture
def processes(two_threads, monkeypatch):
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "always")
    monkeypatch.setattr("torchbrdf.fitting.batching.PROCESS_THRESHOLD", 0)


def same(one, other, rows):
    """Whether two results are equal bit for bit in some materials."""
    values = [
        dict(zip(result.names, zip(result.status, result.error.tolist(), strict=True), strict=True))
        for result in (one, other)
    ]
    return all(values[0][name] == values[1][name] for name in rows)


def test_fits_whose_worker_is_killed_are_made_again_and_equal(processes, tmp_path, monkeypatch):
    measured = load(standins()).batch(range(4, 10), torch.arange(0, 900_000, 40))
    options = {"samples": 300, "max_theta": 30.0}
    killed = fit(make_model("ward", 1), measured, deadly_loss(tmp_path, 1), **options)
    assert len(list(tmp_path.iterdir())) == 1
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "never")
    calm = fit(make_model("ward", 1), measured, deadly_loss(tmp_path, 0), **options)
    assert same(killed, calm, measured.names)
    for part, expected in zip(killed.model.parameters(), calm.model.parameters(), strict=True):
        assert torch.equal(part, expected)


@pytest.mark.slow
def test_a_material_that_kills_its_worker_twice_says_so_and_leaves_the_others_be(processes, tmp_path, monkeypatch):
    measured = load(standins()).batch(range(4, 10), torch.arange(0, 900_000, 40))
    options = {"samples": 300, "max_theta": 30.0}
    loss = deadly_loss(tmp_path, 2)
    found = fit(make_model("ward", 1), measured, loss, **options)
    lost = [name for name, status in zip(found.names, found.status, strict=True) if status == Status.LOST]
    assert "nylon" in lost and len(lost) < len(measured)
    k = found.names.index("nylon")
    assert "ended twice without an answer" in found.reason[k] and found.error[k].isnan()
    assert found.records()[k].status == "lost"
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "never")
    calm = fit(make_model("ward", 1), measured, deadly_loss(tmp_path, 0), **options)
    assert same(found, calm, [name for name in measured.names if name not in lost])


@pytest.mark.slow
def test_scores_whose_worker_is_killed_twice_are_nan(processes, tmp_path):
    measured = load(standins()).batch(range(4, 10), torch.arange(0, 900_000, 3000))
    model = make_model("ward", 1).batched(6)
    found = cross_score([model], measured, [deadly_loss(tmp_path, 2)])
    assert 0 < found.isnan().sum() < 6 and found[0, 0, measured.names.index("nylon")].isnan()


def test_another_material_of_the_same_name_is_refused(tmp_path):
    batches(tmp_path).run([materials(["a", "b"])])
    before = (tmp_path / "fits.json").read_bytes()
    other = load(standins()).batch([6], torch.arange(0, 900_000, 3000))
    renamed = Measured.from_samples(other.pairs, other.values, other.weight, names=["a"])
    with pytest.raises(DataError, match=r"a: expected the material that .*manifest.json has, found another; give"):
        batches(tmp_path).run([renamed])
    assert (tmp_path / "fits.json").read_bytes() == before


def test_without_any_pair_a_fit_says_so():
    one = materials(["a"])
    empty = Measured.from_samples(one.pairs.select(samples=slice(0)), one.values[:, :0], names=["a"])
    for loss in (CompressedLoss(), LearnedLoss()):
        assert fit(make_model("ward", 1), empty, loss, diffuse="fit").status == ["no_data"]


def test_a_model_that_is_refused_leaves_no_manifest_behind(tmp_path):
    paints = load(standins()).batch([6], torch.arange(0, 900_000, 3000))
    brushed = Batches(make_model("ggx_anisotropic", 1), CubeRootLoss(), out=tmp_path / "fits", samples=None)
    with pytest.raises(UsageError, match="expected an anisotropic measurement"):
        brushed.run([paints])
    found = Batches(make_model("ward", 1), CubeRootLoss(), out=tmp_path / "fits", samples=None).run([paints])
    assert [record.material for record in found] == ["nickel"]
