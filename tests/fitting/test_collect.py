"""Shares of a fit that are put together; what is refused, and what is said to be missing."""

import json
import shutil

import pytest
from helpers.tiny_materials import timeless, write_tiny

from torchbrdf import bounds
from torchbrdf.cli import main
from torchbrdf.errors import DataError, UsageError
from torchbrdf.fitting import Batches, collect
from torchbrdf.lobes import make_model, read_fits
from torchbrdf.losses import RMSLoss
from torchbrdf.measured import load_later


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("tiny"), 40, 60)


def share(files, folder, k, count, seed=0):
    batches = Batches(make_model("ward", 1), RMSLoss(), out=folder, samples=None, diffuse="fit", seed=seed)
    return [*batches.fits(load_later(files), shard=(k, count), bad=[])]


@pytest.fixture(scope="module")
def made(files, tmp_path_factory):
    """A whole folder, and three of a third each."""
    folder = tmp_path_factory.mktemp("made")
    Batches(make_model("ward", 1), RMSLoss(), out=folder / "whole", samples=None, diffuse="fit").run(load_later(files))
    for k in (1, 2, 3):
        share(files, folder / str(k), k, 3)
    return folder


@pytest.fixture
def shares(made, tmp_path):
    """Copies of the three."""
    return [shutil.copytree(made / str(k), tmp_path / str(k)) for k in (1, 2, 3)]


def test_shares_are_the_whole(made, shares, tmp_path):
    assert [len(list((one / "fits").iterdir())) for one in shares] == [5, 5, 4]
    assert not (shares[0] / "fits.json").exists()
    found = collect(shares, tmp_path / "all")
    assert (found.fits, found.missing, found.materials, found.parts) == (40, {}, 40, 14)
    assert timeless(tmp_path / "all") == timeless(made / "whole")
    again = {path: path.stat().st_mtime_ns for path in (tmp_path / "all").rglob("*")}
    collect(shares, tmp_path / "all")
    assert {path: path.stat().st_mtime_ns for path in again if path.is_file()} == {
        path: time for path, time in again.items() if path.is_file()
    }


def test_jobs_may_write_into_one_folder(files, made, tmp_path):
    for k in (3, 1, 2):
        share(files, tmp_path / "one", k, 3)
    assert collect([tmp_path / "one"]).missing == {}
    assert timeless(tmp_path / "one") == timeless(made / "whole")


def test_what_is_missing_is_said_and_made_by_a_fit(made, shares, files, tmp_path, capsys):
    (shares[2] / "fits" / "part-00002.jsonl").unlink()
    arguments = ["collect", str(shares[0]), str(shares[2]), "--out", str(tmp_path / "all")]
    assert main(arguments) == 1
    first, second, last = capsys.readouterr().out.splitlines()
    assert first == "24 of 40 fits, in 8 of 14 whole parts"
    assert second.startswith("missing: 16 fits of part-00001.jsonl, part-00002.jsonl, part-00004.jsonl, ...; torchbrdf")
    assert last == str(tmp_path / "all" / "fits.json")
    assert main([*arguments, str(shares[1])]) == 1  # what is there already is no double
    assert main(["collect", str(tmp_path / "all")]) == 1
    assert capsys.readouterr().out.splitlines()[0] == "37 of 40 fits, in 13 of 14 whole parts"
    Batches(make_model("ward", 1), RMSLoss(), out=tmp_path / "all", samples=None, diffuse="fit").run(load_later(files))
    assert timeless(tmp_path / "all") == timeless(made / "whole")


def cut(folder):
    path = folder / "fits" / "part-00001.jsonl"
    path.write_bytes(path.read_bytes()[:-40])


def other_inputs(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["inputs"][3][0] = "other"
    (folder / "manifest.json").write_text(json.dumps(manifest))


def fewer_inputs(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["inputs"][-1]
    (folder / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (cut, r"part-00001.jsonl: expected 3 fits as they were written, found 2: it was cut short"),
        (other_inputs, r"2/manifest.json: expected m000003 as in .*1/manifest.json, found other"),
        (fewer_inputs, r"2/manifest.json: expected the materials of .*, 40 in 14 parts, found 39 in 14 parts"),
        (lambda folder: (folder / "manifest.json").unlink(), r"2: expected a folder of torchbrdf fit with a manifest"),
    ],
)
def test_what_does_not_belong_together_is_refused_and_nothing_is_written(shares, tmp_path, spoil, said):
    spoil(shares[1])
    with pytest.raises(DataError, match=said):
        collect(shares, tmp_path / "all")
    assert not (tmp_path / "all").exists()


def test_shares_of_other_settings_are_refused(shares, files, tmp_path):
    share(files, tmp_path / "seed", 2, 3, seed=5)
    with pytest.raises(
        DataError, match=r"seed/manifest.json: its fits were made with seed 5, not 0 as those of .*1/man"
    ):
        collect([shares[0], tmp_path / "seed"], tmp_path / "all")


def test_a_share_that_comes_twice_is_refused(shares, made, tmp_path):
    for twice in (made / "2", shares[1]):
        with pytest.raises(DataError, match=r"2: part-00001.jsonl: comes twice: .*2 has it, too"):
            collect([*shares, twice], tmp_path / "all")


def test_a_folder_of_before_is_said(made, tmp_path, capsys):
    shutil.copy(made / "whole" / "fits.json", tmp_path)
    assert main(["collect", str(tmp_path)]) == 1
    assert "found fits.json alone: fit into it once more" in capsys.readouterr().err


def test_the_command_does_shares(files, made, tmp_path, capsys):
    for k in ("1/2", "2/2"):
        arguments = ["fit", str(files[0].parent), "--lobes", "1", "--loss", "rms", "--samples", "all", "--shard", k]
        assert main([*arguments, "--diffuse", "fit", "--out", str(tmp_path / k[0])]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(tmp_path / "2")
    assert main(["collect", str(tmp_path / "1"), str(tmp_path / "2"), "--out", str(tmp_path / "all")]) == 0
    assert len(read_fits(tmp_path / "all")) == 40
    assert json.loads((tmp_path / "all" / "fits.json").read_text())[7]["material"] == "m000007"


@pytest.mark.parametrize("text", ["0/3", "4/3", "1", "a/b", "1/", "-1/3", "1/0", "1/9999999"])
def test_a_share_that_is_none_is_refused(text):
    with pytest.raises(UsageError, match=f"--shard: expected I/N, such as 3/8, with I from 1 to N, found '{text}'"):
        bounds.share(text)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fit", "zoo:nickel", "--shard", "1/2"], "--shard: expected --out, too"),
        (["fit", "zoo:nickel", "--parquet"], "--parquet: expected --out, too"),
        (["fit", "zoo:nickel", "--device", "cuda:7"], "--device: expected one of cpu, found 'cuda:7'"),
        (["fit", "zoo:nickel", "--device", "potato"], "--device: expected one of cpu, found 'potato'"),
        (["fit", "zoo:nickel", "--device", "meta"], "--device: expected one of cpu, found 'meta'"),
        (["fit", "zoo:nickel", "--executor", "sparks"], "unknown --executor 'sparks'; expected one of dask"),
        (
            ["fit", "zoo:nickel", "--scheduler", "tcp://x:1"],
            "--scheduler: expected --executor dask with it, found none",
        ),
        (["fit", "zoo:nickel", "--shard", "3/2", "--out", "a"], "--shard: expected I/N, such as 3/8"),
        (["collect", "a", "b"], "collect: expected --out with 2 folders, found none"),
    ],
)
def test_options_that_do_not_go_together_are_refused(arguments, said, capsys):
    assert main(arguments) == 2
    assert said in capsys.readouterr().err
