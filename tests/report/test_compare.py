"""`compare`: numbers, words and the page."""

import base64
import html
import io
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.listed_files import angles, columns
from PIL import Image

import torchbrdf
from torchbrdf.cli import main
from torchbrdf.errors import DataError, UsageError
from torchbrdf.experiment.comparison import find_subjects, scenes_of
from torchbrdf.experiment.extrapolation import extrapolated_share, hatched, is_extrapolated
from torchbrdf.experiment.slices import INCIDENCES, image_pairs, plane_pairs, slices_of, viewer_angles
from torchbrdf.lobes import GGX, FitRecord, GGXAnisotropic, Lambert, Sum, parameters, write_fits
from torchbrdf.losses import LOSSES
from torchbrdf.measured import Measured, load
from torchbrdf.measured.standin import all_round
from torchbrdf.pairs import Pairs
from torchbrdf.perception import told_apart, uniform_pairs
from torchbrdf.render import Scene, sphere

WICKED = "<script>document.title = 'taken'<!--"
PAINT = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=0.4, roughness=0.2))
DULL = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=0.2, roughness=0.35))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A measurement whose light goes up to 20 degrees only, two fits of it, and a bad file."""
    folder = tmp_path_factory.mktemp("compare")
    rows = angles(lights=(0, 20))
    (folder / "few.csv").write_text(columns(rows[rows[:, 2] <= 50]))
    write_fits(
        folder / "fits.json",
        [
            FitRecord("few", "ggx", 1, parameters(PAINT), loss="rms", strategy="global"),
            FitRecord(WICKED, "ggx", 1, parameters(DULL), loss="rms", strategy="global"),
        ],
    )
    (folder / "bad.csv").write_text("theta_i,theta_o\n1,2\n")
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    """The page of all of those."""
    files = [str(folder / "few.csv"), str(folder / "fits.json")]
    assert main(["compare", *files, "--size", "32", "--out", str(folder / "out")]) == 0
    return folder / "out" / "compare.html"


@pytest.fixture(scope="module")
def small() -> dict[str, Scene]:
    return {"ball": Scene(sphere(3), size=24, nodes=16, light_samples=64)}


def test_a_material_is_itself(small: dict[str, Scene]) -> None:
    (same,) = torchbrdf.compare(PAINT, PAINT, scenes=small).others
    assert set(same.metrics) == {*LOSSES, "mean_log_difference"}
    assert all(abs(value) < 1e-6 for value in same.metrics.values())
    assert all(figures.delta_e76 == 0 for figures in same.figures.values())
    assert same.pairs == (6000, 6000)


def test_numbers_and_words(small: dict[str, Scene]) -> None:
    found = torchbrdf.compare(PAINT, DULL, PAINT, scenes=small)
    dull, same = found.others
    assert dull.metrics["cube_root"] > 0.01 and same.metrics["cube_root"] < 1e-6
    assert dull.told("cube_root") == told_apart("cube_root", dull.metrics["cube_root"]) and dull.told("rms") is None
    assert len(dull.places) == 3 and len({place.part for place in dull.places}) == 3
    near = next(place for place in dull.places if place.part.startswith("Near the highlight"))
    pairs = torchbrdf.Pairs.from_directions(
        *(
            torch.tensor([[np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]], dtype=torch.float32)
            for t, p in ((np.radians(near.light), 0.0), (np.radians(near.viewer), np.radians(near.around)))
        )
    )
    with torch.no_grad():
        expected = [model(pairs)[0].tolist() for model in (PAINT, DULL)]
    assert near.reference == pytest.approx(expected[0], rel=1e-2) and near.other == pytest.approx(expected[1], rel=1e-2)
    assert re.search(
        r"light at \d+°, viewer at \d+°, \d+° around: [\d.e-]+ of the reference, [\d.e-]+ here", near.words
    )
    lines = found.lines()
    assert (
        lines[0] == "reference: a model" and lines[2].startswith("a model") and "where they differ most:" in lines[-2]
    )
    assert same.is_same and not same.places and not dull.is_same
    assert lines[-1].strip() == "Nowhere: the same values at all of these directions."
    assert sum("of the reference" in line for line in lines) == 3
    plain = json.loads(json.dumps(found.to_dict()))
    assert plain["others"][0]["scenes"]["ball"]["delta_e76"] == pytest.approx(dull.figures["ball"].delta_e76)


def test_what_was_never_measured_counts_in_no_metric(folder: Path, small: dict[str, Scene]) -> None:
    (other, _) = torchbrdf.compare(folder / "few.csv", folder / "fits.json", scenes=small).others
    known, every = other.pairs
    assert 100 < known < 0.7 * every == 4200
    assert any(f"over the {known} of 6000 pairs of directions that were measured" in line
               for line in torchbrdf.compare(folder / "few.csv", PAINT, scenes=small).lines())  # fmt: skip
    assert all(max(place.light, place.viewer) < 75 for place in other.places)


def test_too_little_is_said(tmp_path: Path, small: dict[str, Scene]) -> None:
    (tmp_path / "one.csv").write_text("theta_i,theta_o,phi,f\n30,30,180,2\n")
    found = torchbrdf.compare(tmp_path / "one.csv", PAINT, scenes=small, out=tmp_path)
    (known, _) = found.others[0].pairs
    assert 0 < known < 100
    assert f"  metrics: none, since only {known} of 6000 pairs of directions were measured of both" in found.lines()
    assert not re.search(r"\bnan\b", " ".join(found.lines()))
    text = (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert "<td>too little was measured</td>" in text and "<td>nan" not in text


def test_slices_are_values_at_their_angles() -> None:
    pairs, counts = plane_pairs()
    found = slices_of(PAINT)
    assert counts == [len(viewer_angles(one)) for one in INCIDENCES] and found.values.shape[:2] == (18, max(counts))
    place = INCIDENCES.index(30)
    at = viewer_angles(30).index(30.15)
    single = pairs.select(samples=slice(sum(counts[:place]) + at, sum(counts[:place]) + at + 1))
    assert torch.rad2deg(single.theta_h).item() == pytest.approx(0.075, abs=1e-3)  # the mirror direction is above 0
    with torch.no_grad():
        assert torch.allclose(found.values[place, at], PAINT(single)[0, 0])
    square = image_pairs()
    assert square.above_horizon.all() and square.theta_h[0, 0] < 1e-3 < square.theta_h[0, -1]
    assert square.theta_d[0, 0] > 1.5 > 0.1 > square.theta_d[0, -1]
    assert not found.far.any() and not found.image_far.any()


def test_extrapolated_values_are_hatched(folder: Path) -> None:
    few = load(folder / "few.csv")
    found = slices_of(few)
    assert found.far[-1, : len(viewer_angles(85))].all() and not found.far[0, len(viewer_angles(0)) // 2]
    assert 0.2 < found.image_far.float().mean() < 0.95
    scene = Scene(sphere(3), size=32, nodes=16, light_samples=64)
    share = extrapolated_share(few, scene)
    assert share[scene.mask].max() > 0.9 > share[scene.mask].min()
    assert not extrapolated_share(PAINT, scene).any() and not is_extrapolated(PAINT, scene.pairs).any()
    plain = torch.full((32, 32, 3), 0.5)
    where = torch.zeros(32, 32, dtype=torch.bool)
    where[:16] = True
    striped = hatched(plain, where)
    assert (striped[16:] == plain[16:]).all() and 0.1 < (striped[:16] != plain[:16]).float().mean() < 0.5
    assert (found.picture() != torch.where(found.image_far[..., None], found.picture(), 0)).any()


def test_one_file_holds_all(page: Path) -> None:
    assert [path.name for path in page.parent.iterdir()] == ["compare.html"]
    text = page.read_text(encoding="utf-8")
    assert "http:" not in text and "https:" not in text and not re.search(r"\s(src|href)=|@import|url\(", text)
    assert "default-src 'none'" in text and WICKED not in text and str(page.parent.parent) not in text
    data = json.loads(re.search('<script type="application/json" id="slices-data">(.*?)</script>', text)[1])  # type: ignore[index]
    assert [len(one["values"]) for one in data["items"]] == [18] * 3
    assert "1" in data["items"][0]["far"][-1] and "1" not in "".join(data["items"][1]["far"])
    assert data["items"][0]["ratio"] == "" != data["items"][1]["ratio"]
    pictures = json.loads(re.search('<script type="application/json" id="data">(.*?)</script>', text)[1])  # type: ignore[index]
    sizes = {
        Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))).size
        for uri in (
            *pictures["reference"],
            *(one for own in pictures["others"] for scene in own for one in scene.values()),
        )
    }
    assert sizes == {(32, 32)}
    assert "A share with * is extrapolated" in text and "Hatched, or dashed: extrapolated" in text


def test_json_and_bad_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(folder / "few.csv"), str(folder / "bad.csv"), str(folder / "fits.json")]
    assert main(["compare", *files, "--size", "16", "--json"]) == 1
    said = capsys.readouterr()
    assert said.err.count("\n") == 1 and "left out: " in said.err and "bad.csv" in said.err
    plain = json.loads(said.out)
    assert len(plain["others"]) == 2 and len(plain["problems"]) == 1
    assert plain["reference"] == "few (measured)"


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["few.csv"], 2, "expected 2 to 128 materials or fits, found 1"),
        (["few.csv", "few.csv", "--out", "few.csv"], 1, "expected a folder or a new name, found a file"),
        (["few.csv", "few.csv", "--read", "angles=grad"], 2, "unknown angles 'grad'"),
        ([""], 1, "found an empty one"),
    ],
)
def test_bad_usage_is_said(
    arguments: list[str], status: int, said: str, folder: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(folder)
    assert main(["compare", *arguments]) == status
    lines = capsys.readouterr().err.splitlines()
    assert 1 <= len(lines) <= 2 and all(line.startswith("torchbrdf: ") for line in lines)
    assert any(said in line for line in lines)


def test_what_is_none_is_refused(folder: Path) -> None:
    with pytest.raises(UsageError, match="expected files, materials, fits or lobes, found 3"):
        find_subjects([3], [])  # type: ignore[list-item]
    with pytest.raises(DataError, match=r"bad\.csv"):
        torchbrdf.compare(folder / "few.csv", folder / "bad.csv")
    record = FitRecord("x", "ggx", 1, parameters(PAINT))
    labels = [one.label for one in find_subjects([PAINT, folder / "few.csv", record], [])]
    assert labels == ["a model", "few (measured)", "x: GGX"]
    assert list(scenes_of(16)) == ["blob, grove", "sphere, studio"]


def test_it_runs_in_a_browser(page: Path, tmp_path: Path) -> None:
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs Chromium: no program chromium or chromium-browser")
    driven = tmp_path / "driven.html"
    hands = """
        const byId = id => document.getElementById(id), count = query => document.querySelectorAll(query).length;
        const state = () => ["in-plane", "polar"].map(id => byId(id).innerHTML.length);
        const states = [byId("incident").textContent, state()];
        byId("incidence").value = 17;
        byId("incidence").oninput();
        states.push(byId("incident").textContent, state(), count("#in-plane .extrapolated"));
        document.querySelector("#slices .legend input").click();
        states.push(count("#slices .images img"), document.documentElement.scrollWidth <= innerWidth, document.title);
        document.body.append(Object.assign(document.createElement("pre"), { textContent: JSON.stringify(states) }));"""
    driven.write_text(page.read_text(encoding="utf-8").replace("</body>", f"<script>{hands}</script></body>"))
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-dev-shm-usage"]
    flags += [f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=2000"]
    for width in (1200, 500):
        done = subprocess.run(
            [program, *flags, f"--window-size={width},900", "--dump-dom", driven.as_uri()],
            capture_output=True, text=True, check=True, timeout=120, cwd=tmp_path,
        )  # fmt: skip
        said = json.loads(html.unescape(re.search("<pre>(.*)</pre>", done.stdout)[1]))  # type: ignore[index]
        assert said[0] == "45\u00b0" and said[2] == "85\u00b0" and said[1] != said[3]
        assert said[4] == 1  # of the measurement, all of which is extrapolated there
        assert said[5] == 4 and said[6] is True and WICKED in said[7]


def test_matches_and_views_say_what_was_never_measured(folder: Path) -> None:
    """Pictures of the measurement, and maps, are hatched; the fit's are not; and angles leave such directions out."""
    from types import SimpleNamespace

    from torchbrdf.experiment.matching.judge import Judge
    from torchbrdf.experiment.matching.shortfall import angles as by_angle
    from torchbrdf.report.match_page import _pictures
    from torchbrdf.report.viewer import _extrapolated

    few = load(folder / "few.csv")
    scene = Scene(sphere(3), size=32, nodes=16, light_samples=64)
    judge = Judge(few, {"ball": scene})
    drawn = _pictures(SimpleNamespace(match=SimpleNamespace(judge=judge)), [PAINT], "ball")  # type: ignore[arg-type]
    plain = _pictures(
        SimpleNamespace(match=SimpleNamespace(judge=Judge(PAINT, {"ball": scene}))),  # type: ignore[arg-type]
        [PAINT],
        "ball",
    )
    far = _extrapolated([few], scene)[0]
    assert 10 < far.sum() < scene.mask.sum()

    def stripes(uri: str) -> float:
        """How much neighbouring pixels differ where values are extrapolated."""
        picture = Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))).convert("L")
        inside = torch.from_numpy(np.asarray(picture).astype(float))
        return float((inside.diff(dim=0)[:, 1:].abs() * far[1:, 1:]).sum() / far.sum())

    assert stripes(drawn.reference) > 1.5 * stripes(plain.reference)
    assert stripes(drawn.maps[0]) > 5 and stripes(drawn.fits[0]) < 1.5 * stripes(plain.fits[0])
    assert 0 < len(by_angle(judge, PAINT)) < len(by_angle(Judge(PAINT, {"ball": scene}), PAINT))


def test_a_fit_with_a_grain_is_made_and_compared_by_the_commands(tmp_path, capsys):
    pairs = all_round(uniform_pairs(3000, max_theta=70))
    brushed = Sum(Lambert(albedo=0.2), GGXAnisotropic(specular=0.5, roughness_x=0.2, roughness_y=0.6, rotation=0.4))
    values = brushed.double()(pairs.unsqueeze()).detach()[0]
    places = [
        part for one in (pairs.wi, pairs.wo) for part in (torch.acos(one[:, 2]), torch.atan2(one[:, 1], one[:, 0]))
    ]
    rows = torch.stack([*map(torch.rad2deg, places), *values.T], -1).tolist()
    lines = [",".join(f"{number:.7g}" for number in row) for row in rows]
    (tmp_path / "brushed.csv").write_text("\n".join(["theta_i,phi_i,theta_o,phi_o,r,g,b", *lines, ""]))
    told = ["--read", "angles=degrees", "--read", "grain=anisotropic"]
    file, out = str(tmp_path / "brushed.csv"), str(tmp_path / "out")
    model = ["--model", "ggx_anisotropic", "--lobes", "1", "--samples", "1000", "--out", out]
    assert main(["fit", file, *model, *told]) == 0
    capsys.readouterr()
    assert main(["compare", file, str(tmp_path / "out" / "fits.json"), *told]) == 0
    assert "picture, " in capsys.readouterr().out


def test_bands_are_not_taken_for_rgb():
    angle = torch.full((1, 40), 0.3)
    pairs = Pairs.from_half_diff(angle, angle, angle)
    three = Measured.from_samples(pairs, torch.ones(1, 40, 3), wavelengths=[465, 525, 630])
    with pytest.raises(DataError, match="expected linear RGB, found 3 bands of 465, 525, 630 nm: material0"):
        torchbrdf.compare(three, three.to_rgb())
