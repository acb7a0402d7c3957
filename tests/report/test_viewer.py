"""The page to look at: one file, every frame, honest labels and numbers, and it runs in a browser."""

import base64
import html
import io
import json
import re
import shutil
import subprocess
import webbrowser
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from torchbrdf.cli import main
from torchbrdf.experiment.items import Item
from torchbrdf.images import DIFFERENCES, ToneMap, write_exr
from torchbrdf.lobes import CookTorrance, FitRecord, Lambert, Sum, Ward, parameters, write_fits
from torchbrdf.measured import load_all
from torchbrdf.perception.discrimination.words import said
from torchbrdf.render import Camera, Environment, Scene, find_mesh, render
from torchbrdf.report.viewer import LIGHTS, NODES, first_pair

SIZE, STEPS = 64, 2
WICKED = "<script>document.title = 'taken'<!--"
PAINT = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), CookTorrance(specular=0.5, roughness=0.2, f0=0.2))
DULL = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.1, roughness=0.4))


def record(material, model, name, **more):
    return FitRecord(material, name, 1, parameters(model), **more)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two materials that are models, three fits of which one is its material exactly, and a light."""
    folder = tmp_path_factory.mktemp("view")
    write_fits(folder / "materials.json", [record("paint", PAINT, "cook_torrance"), record(WICKED, DULL, "ward")])
    write_fits(
        folder / "fits.json",
        [
            record("paint", DULL, "ward", loss="cube_root", strategy="global"),
            record("paint", PAINT, "cook_torrance", loss="rms", strategy="staged"),
            record("stone", DULL, "ward", loss="cube_root", strategy="global"),
        ],
    )
    write_exr(
        folder / "sky.exr", torch.tensor([0.2, 0.5, 1.0]).expand(8, 16, 3) * torch.ones(8, 1, 1).cumsum(0).flip(0)
    )
    return folder


@pytest.fixture(scope="module")
def page(folder):
    """The page of all of those."""
    path = folder / "out" / "view.html"
    files = [str(folder / "materials.json"), str(folder / "fits.json")]
    lights = ["--environment", "grove", str(folder / "sky.exr")]
    assert main(["view", *files, *lights, "--size", str(SIZE), "--steps", str(STEPS), "--out", str(path)]) == 0
    return path


def data_of(path):
    text = path.read_text(encoding="utf-8")
    return json.loads(re.search('<script type="application/json" id="data">(.*?)</script>', text)[1])


def decoded(uri):
    head, _, data = uri.partition(",")
    assert head == "data:image/jpeg;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_one_file_holds_every_frame(page):
    assert [path.name for path in page.parent.iterdir()] == ["view.html"]
    frames = data_of(page)["frames"]
    assert np.shape(frames) == (2, STEPS, 5)  # lights, sides, items
    pictures = np.array([[[decoded(uri) for uri in step] for step in light] for light in frames])
    assert pictures.shape == (2, STEPS, 5, SIZE, SIZE, 3)
    corner = pictures[..., :8, :8, :].astype(int)  # a block of the JPEG's, where nothing of the object is
    assert (abs(corner - 128) <= 1).all()  # the page's own grey
    assert (pictures[0, 0] != pictures[0, 1]).any() and (pictures[0] != pictures[1]).any()
    assert (pictures[:, :, 0] == pictures[:, :, 3]).all()  # a fit that is its material


def test_the_page_asks_for_nothing(page):
    text = page.read_text(encoding="utf-8")
    assert "http:" not in text and "https:" not in text
    assert not re.search(r"\s(src|href)=|@import|url\(", text)
    assert "default-src 'none'" in text
    assert str(page.parent.parent) not in text  # lights by name, not by path
    assert ">sky<" in text and ">grove<" in text


def test_names_are_harmless(page):
    text = page.read_text(encoding="utf-8")
    assert WICKED not in text and text.count("</script>") == 4
    assert data_of(page)["items"][1]["material"] == WICKED


def test_items_say_what_they_are(page):
    items = data_of(page)["items"]
    assert [item["label"] for item in items] == [
        "paint (stand-in)",
        f"{WICKED} (stand-in)",
        "paint: Ward, 1 lobe, cube root, global",
        "paint: Cook-Torrance, 1 lobe, RMS, staged",
        "stone: Ward, 1 lobe, cube root, global",
    ]
    assert [item["reference"] for item in items] == [None, None, 0, 0, None]
    assert (data_of(page)["left"], data_of(page)["right"]) == (0, 2)
    assert "stand-in, not a measurement" in page.read_text(encoding="utf-8")


def test_numbers_are_those_of_the_pictures(page, folder):
    numbers = data_of(page)["numbers"]
    assert all(step[k] is None for light in numbers for step in light for k in (0, 1, 4))
    equal = ["0.00", "infinite", "nobody would tell them apart: 0 %"]
    assert all(step[3] == equal for light in numbers for step in light)
    light = Environment.from_file(folder / "sky.exr")
    (group,) = load_all([folder / "materials.json", folder / "fits.json"])
    first, second = (Scene(find_mesh("blob"), Camera(turn), light, SIZE, NODES, LIGHTS) for turn in (0, 180))
    pictures = render(group, first)
    tone = ToneMap.from_images(pictures, first.mask.expand(pictures.shape[:-1]))
    shown = tone(render(group, second))
    measures = [DIFFERENCES[name]()(shown[2:3], shown[:1], second.mask).item() for name in ("delta_e76", "psnr")]
    expected = [f"{measures[0]:.2f}", f"{measures[1]:.1f} dB", said("delta_e76", measures[0])]
    assert numbers[1][1][2] == expected and measures[0] > 0.5


def test_what_is_shown_first():
    a, b = Item("a", "a", "measured"), Item("b", "b", "measured")
    one, other = Item("b: one", "b", "fit"), Item("b: other", "b", "fit")
    assert first_pair([a, b]) == (0, 0)
    assert first_pair([one]) == (0, 0)
    assert first_pair([one, other]) == (0, 1)
    assert first_pair([a, Item("b: one", "b", "fit", 2), b]) == (2, 1)


def test_one_bad_file_leaves_the_others(folder, tmp_path, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    out = tmp_path / "page.html"
    arguments = ["view", str(folder / "fits.json"), "nowhere.binary", "--environment", str(folder / "sky.exr")]
    assert main([*arguments, "--size", "12", "--steps", "1", "--out", str(out), "--open"]) == 1
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and "nowhere.binary" in printed.err
    assert printed.out.splitlines()[-1] == str(out) and printed.out.startswith("3 pictures, 0.2 MB")
    assert opened == [out.as_uri()]
    assert len(data_of(out)["items"]) == 3


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["nowhere.binary"], 1, "nowhere.binary: no such file"),
        (["FITS", "--environment", "none"], 2, "expected light probes, found none"),
        (["FITS", "--environment", "grove", "none"], 2, "expected light probes, found none"),
        (["FITS", "--size", "1024", "--steps", "360", "--environment", *["grove"] * 3], 2, "pixels on a page"),
        ([""], 1, "an empty path: no such file"),
        (["FITS", "--shape", "cube"], 1, "cube"),
        (["FITS", "--environment", "nowhere.hdr"], 1, "nowhere.hdr"),
        (["FITS", "--out", "FITS/view.html"], 1, "expected a folder or a new name, found a file"),
        (["FITS", "--out", "FOLDER"], 1, "expected a file or a new name, found a folder"),
    ],
)
def test_bad_usage_gets_one_line(folder, tmp_path, capsys, monkeypatch, arguments, status, said):
    monkeypatch.chdir(tmp_path)
    filled = [a.replace("FITS", str(folder / "fits.json")).replace("FOLDER", str(tmp_path)) for a in arguments]
    assert main(["view", *filled]) == status
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and printed.err.startswith("torchbrdf: ") and said in printed.err
    assert not list(tmp_path.iterdir())


@pytest.fixture
def browser(tmp_path):
    """Chromium without a window and without a network."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs Chromium: no program chromium or chromium-browser")
    quiet = ["background-networking", "component-update", "sync", "default-apps", "extensions"]
    flags = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--no-first-run",
        "--hide-scrollbars",
        "--disable-dev-shm-usage",
    ]
    flags += [f"--disable-{what}" for what in quiet]
    flags += [f"--user-data-dir={tmp_path / 'profile'}", "--window-size=900,700", "--virtual-time-budget=2000"]

    def run(path: Path, *more: str) -> str:
        command = [program, *flags, *more, path.as_uri()]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60, cwd=tmp_path).stdout

    return run


def test_it_runs_in_a_browser(page, browser, tmp_path):
    shot = tmp_path / "shot.png"
    browser(page, f"--screenshot={shot}")
    picture = np.asarray(Image.open(shot).convert("RGB")).astype(int)[16:-16, 16:400]  # the part with the object
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50
    # The same page with a person's hands at its end.
    driven = tmp_path / "driven.html"
    hands = """
        const most = () => Math.max(...paint.getImageData(0, 0, 24, 24).data.filter((_, k) => k % 4 < 3));
        const box = stage.getBoundingClientRect();
        const hand = (kind, share, shiftKey) => stage.dispatchEvent(
          new PointerEvent(kind, { clientX: box.left + share * box.width, shiftKey }));
        stage.setPointerCapture = () => {};  // which made-up pointers do not have
        const said = [];
        at("difference").click();
        at("turn").value = 1; at("turn").dispatchEvent(new Event("input"));
        setTimeout(() => {
          said.push(most());
          at("right").value = 3; at("right").dispatchEvent(new Event("change"));
          document.body.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
          said.push(at("wipe").value);
          hand("pointerdown", 0.1); hand("pointermove", 0.25); hand("pointerup", 0.25); hand("pointermove", 0.9);
          said.push(at("wipe").value, at("turned").value);
          hand("pointerdown", 0.1, true); hand("pointermove", 0.6, true); hand("pointerup", 0.6, true);
          said.push(at("wipe").value, at("turned").value);
        }, 300);
        setTimeout(() => {
          said.push(most(), document.title);
          document.body.append(Object.assign(document.createElement("pre"), { textContent: JSON.stringify(said) }));
        }, 600);"""
    driven.write_text(page.read_text(encoding="utf-8").replace("</body>", f"<script>{hands}</script></body>"))
    found = browser(driven, "--dump-dom")
    said = json.loads(html.unescape(re.search("<pre>(.*)</pre>", found)[1]))
    assert said[0] > 20 and said[-2] == 0  # the difference of a fit, and of item 3, which is its material exactly
    assert said[1:-2] == ["52", "25", "180°", "25", "0°"]  # a key, a drag, and one with Shift
    assert said[-1] == f"paint, {WICKED}, stone"  # the wicked name did nothing
    assert "<b>0.00</b> · PSNR <b>infinite</b>" in found
