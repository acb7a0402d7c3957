"""Materials as scripts for Blender."""

import ast
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.fake_blender import Blender

from torchbrdf.export import export
from torchbrdf.export.blender import SAME, SOCKETS, inputs_for_blender, script, sockets
from torchbrdf.export.mtlx import INPUTS, inputs_of
from torchbrdf.lobes import GGX, Lambert, OpenPBR

EVERYTHING = {
    name: [0.25, 0.5, 0.75] if limits.size == 3 else max(0.5, limits.lower) for name, limits in SOCKETS.items()
}
COLOURS = {name for name, limits in SOCKETS.items() if limits.size == 3}


def run(text: str, version: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> Blender:
    """What a script does in a Blender."""
    blender = Blender(version)
    monkeypatch.setitem(sys.modules, "bpy", blender.module)
    exec(compile(text, "script.py", "exec"), {})
    return blender


def test_every_socket_is_set(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    blender = run(script(EVERYTHING, "paint"), (5, 0), monkeypatch)
    found = {name: socket.default_value for name, socket in blender.inputs.items() if name in SOCKETS}
    assert found == {name: [*value, 1.0] if name in COLOURS else value for name, value in EVERYTHING.items()}
    assert blender.principled.distribution == "GGX" and blender.links == [("the BSDF", "the surface")]
    assert capsys.readouterr().out == ""


def test_a_sphere_wears_it(monkeypatch: pytest.MonkeyPatch) -> None:
    blender = run(script(EVERYTHING, "paint"), (5, 0), monkeypatch)
    (material,) = blender.materials
    assert material.name == blender.preview.name == "paint" and blender.worn == [material]
    assert all(face.use_smooth for face in blender.preview.data.polygons)


def test_older_names_are_used_and_what_is_missing_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blender = run(script({**EVERYTHING, "IOR": 2.0, "Specular IOR Level": 0.25}, "paint"), (3, 6), monkeypatch)
    found = {name: socket.default_value for name, socket in blender.inputs.items()}
    assert blender.materials[0].use_nodes
    assert found["Specular"] == pytest.approx(0.5 / 9 / 0.08)  # half of F0 = 1/9
    assert (found["Clearcoat"], found["Clearcoat Roughness"], found["Sheen"]) == (0.5, 0.5, 0.5)
    assert found["Base Color"] == [0.25, 0.5, 0.75, 1.0]
    left = ["Diffuse Roughness", "Specular Tint", "Coat IOR", "Coat Tint", "Sheen Roughness", "Sheen Tint"]
    assert capsys.readouterr().out.splitlines() == [f"paint: this Blender has no {name}; left out" for name in left]


@pytest.mark.parametrize("name", ["it's", '"""', "{x}", "a\\b", "\u00e4 \u2603", "x" * 200])
def test_a_name_is_only_text(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    text = script({"Metallic": 1.0}, name)
    assert text.isascii() and run(text, (5, 0), monkeypatch).materials[0].name == name


@pytest.mark.parametrize(
    ("brdf", "expected"),
    [
        (Lambert(albedo=[0.5, 0.25, 0.125]), {"Base Color": (0.5, 0.25, 0.125, 1.0), "Specular IOR Level": 0.0}),
        (
            GGX(specular=1.0, roughness=0.25, f0=0.75),
            {"Base Color": (0.75, 0.75, 0.75, 1.0), "Metallic": 1.0, "Roughness": 0.5, "Specular Tint": (1.0,) * 4},
        ),
    ],
)
def test_what_is_exact(brdf: Any, expected: dict[str, Any], tmp_path: Path) -> None:
    done = export(brdf, "blender", tmp_path)
    assert done.exact and done.notes == ["exact: Blender's Principled BSDF"]
    tree = ast.parse(done.files[0].read_text())
    written = next(
        ast.literal_eval(one.value)
        for one in tree.body
        if getattr(one, "targets", [None])[0] and one.targets[0].id == "SOCKETS"
    )  # type: ignore[attr-defined]
    assert expected.items() <= written.items()


def test_inputs_of_openpbr_have_sockets() -> None:
    assert set(SAME) < set(INPUTS) and set(SAME.values()) | {
        "Specular IOR Level",
        "Anisotropic",
        "Anisotropic Rotation",
    } == set(SOCKETS)
    assert sockets({"specular_weight": 1.0, "coat_color": [1.0, 0.5, 0.25]}) == {
        "Coat Tint": [1.0, 0.5, 0.25],
        "Specular IOR Level": 0.5,
    }


def test_what_blender_does_not_do_is_done_to_the_inputs(tmp_path: Path) -> None:
    plain = OpenPBR(base_color=0.5, base_metalness=0.0, coat_weight=0.0, dtype=torch.float64)
    assert inputs_for_blender(plain) == inputs_of(plain)
    metal = OpenPBR(base_color=0.5, base_metalness=1.0, specular_weight=0.5, coat_weight=0.0, dtype=torch.float64)
    found = inputs_for_blender(metal)
    assert found["base_color"] == [0.25] * 3
    half = 0.5 * (0.5 + 0.5 * (6 / 7) ** 5)  # of OpenPBR's F where the cosine is 1/7
    assert found["specular_color"] == pytest.approx([half / (0.25 + 0.75 * (6 / 7) ** 5)] * 3)
    coated = OpenPBR(
        base_color=0.5, base_metalness=0.0, specular_ior=1.5, specular_roughness=0.5,
        coat_weight=1.0, coat_ior=1.5, coat_roughness=0.5, coat_darkening=1.0, dtype=torch.float64,
    )  # fmt: skip
    found = inputs_for_blender(coated)
    assert found["specular_ior"] == pytest.approx(1.0)  # a base of the coat's own index reflects nothing below it
    assert found["specular_roughness"] == pytest.approx((3 * 0.5**4) ** 0.25)
    thrown_back = 1 - (1 - 0.04) / 1.5**2  # of what leaves the base, with the reflection of white light from inside
    assert found["coat_color"] == pytest.approx([(1 - thrown_back) / (1 - 0.5 * thrown_back)] * 3)
    done = export(coated, "blender", tmp_path)
    assert not done.exact and done.notes == [
        "Blender's Principled BSDF: as OpenPBR, whose picture is compared, but its layers are mixed in a way of its own"
    ]
