"""Help, and everything that is spelt wrong, is answered at once: without torch, and what else takes seconds."""

import dataclasses
import json
import subprocess
import sys
from typing import Any

import pytest

from torchbrdf import kinds
from torchbrdf.cli import main
from torchbrdf.errors import LONGEST_MESSAGE
from torchbrdf.experiment.matching import BUDGETS
from torchbrdf.lobes import LOBES, Ward
from torchbrdf.recipe import RECIPES
from torchbrdf.registry import Registry

HEAVY = ("torch", "numpy", "scipy", "matplotlib", "kornia", "PIL", "trimesh", "pyrender", "OpenEXR", "jinja2", "flask")
COMMANDS = ("run", "match", "fit", "render", "view", "export", "info", "check", "score", "study")
PARTS = ("serve", "add", "simulate", "export", "scale", "power")
CODE = f"""
import contextlib, io, json, sys
from torchbrdf.cli import main
for arguments in json.load(sys.stdin):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main(arguments)
        except SystemExit as ended:
            status = ended.code
    print(json.dumps([status, out.getvalue(), err.getvalue(), [name for name in {HEAVY} if name in sys.modules]]))
"""


def misspelt(name: str) -> str:
    """A name with its first two letters in the other order, or one letter more."""
    wrong = name[1] + name[0] + name[2:]
    return wrong if wrong != name else name + name[-1]


def wrong_names() -> list[list[str]]:
    """Commands with a name that is none, of every kind of name, in every place where one is given."""
    places: list[tuple[Registry[Any], list[list[str]]]] = [
        (
            kinds.LOBES,
            [
                ["fit", "x", "--model"],
                ["run", "fores2012", "models="],
                ["export", "x", "--to", "rgl", "--out", "o", "--model"],
            ],
        ),
        (kinds.LOSSES, [["fit", "x", "--loss"], ["run", "fores2012", "losses="], ["score", "--quick", "--metric"]]),
        (
            kinds.DIFFERENCES,
            [
                ["fit", "x", "--loss", "rendered", "--difference"],
                ["score", "--quick", "--difference"],
                ["run", "image_vs_analytic", "differences=delta_e76,"],
            ],
        ),
        (kinds.STRATEGIES, [["fit", "x", "--strategy"], ["run", "fores2012", "compare_strategy="]]),
        (
            kinds.EXPORTERS,
            [["export", "x", "--out", "o", "--to"], ["match", "x", "--for"], ["convert", "x", "o", "--to"]],
        ),
        (RECIPES, [["run"]]),
    ]
    found = []
    for registry, commands in places:
        for command in commands:
            for name in registry:
                *before, last = command
                wrong = misspelt(name)
                found.append([*before, last + wrong] if last.endswith(("=", ",")) else [*command, wrong])
    for name in RECIPES:
        found += [["run", name, f"{misspelt(field.name)}=1"] for field in dataclasses.fields(RECIPES[name])]
    for command, words in (
        (["render", "x", "--backend"], kinds.BACKENDS),
        (["view", "x", "--backend"], kinds.BACKENDS),
        (["fit", "x", "--diffuse"], kinds.DIFFUSE_MODES),
        (["fit", "x", "--intervals"], kinds.INTERVALS),
        (["study", "scale", "x", "--method"], kinds.SCALINGS),
        (["match", "x", "--budget"], tuple(BUDGETS)),
    ):
        found += [[*command, misspelt(word)] for word in words]
    found += [["fit", "x", "--model", "ward+ggxx"], ["fit", "x", "--model", "wradd+ggx:f0"], ["run", "fores2102"]]
    found += [[misspelt(command)] for command in COMMANDS] + [["study", misspelt(part)] for part in PARTS]
    found += [[command, "x", "--moddel", "ward"] for command in COMMANDS]
    found += [
        ["run", "fores2012", wrong] for wrong in ("modles=ward", "quick=perhaps", "size=huge", "quick", "seed=-1")
    ]
    found += [["render", "x", "--memory", wrong] for wrong in ("2GB", "0", "nan", "-1", "")]
    return found


def asked(commands: list[list[str]]) -> list[tuple[int, str, str, list[str]]]:
    """Status, stdout, stderr and heavy modules after each of some commands in one new process."""
    done = subprocess.run(
        [sys.executable, "-c", CODE], input=json.dumps(commands), capture_output=True, text=True, check=True
    )
    return [tuple(json.loads(line)) for line in done.stdout.splitlines()]  # type: ignore[misc]


def test_every_help_comes_without_torch() -> None:
    commands = [[], *([command] for command in COMMANDS), *(["study", part] for part in PARTS)]
    asking = [[*command, "--help"] for command in commands] + [["--version"], ["run", "list"]]
    asking += [["run", name, "help="] for name in RECIPES]
    for command, (status, out, err, heavy) in zip(asking, asked(asking), strict=True):
        assert (status, err, heavy) == (0, "", []), command
        assert len(out) > 10, command


def test_every_wrong_name_is_said_in_a_line_without_torch() -> None:
    commands = wrong_names()
    assert len(commands) > 200
    for command, (status, out, err, heavy) in zip(commands, asked(commands), strict=True):
        assert (status, out, heavy) == (2, "", []), (command, err)
        assert err.startswith("torchbrdf") and err.count("\n") == 1 and len(err) <= LONGEST_MESSAGE + 40, (command, err)


def test_a_wrong_name_has_the_same_answer_where_torch_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    commands = [command for command in wrong_names() if command[0] in ("fit", "run", "match", "export")][::7]
    for command, (_, _, err, _) in zip(commands, asked(commands), strict=True):
        try:
            status = main(command)
        except SystemExit as end:  # argparse's own
            status = end.code
        assert status == 2 and capsys.readouterr().err == err


REGISTRIES = (
    kinds.LOBES, kinds.LOSSES, kinds.DIFFERENCES, kinds.FORMATS, kinds.EXPORTERS, kinds.STRATEGIES, RECIPES,
)  # fmt: skip


def test_sources_tell_all_names() -> None:
    """In a process that has imported nothing of them."""
    names = ["LOBES", "LOSSES", "DIFFERENCES", "FORMATS", "EXPORTERS", "STRATEGIES"]
    code = (
        "import json, sys; from torchbrdf import kinds; from torchbrdf.recipe import RECIPES;"
        f"print(json.dumps([one.names() for one in (*(getattr(kinds, name) for name in {names}), RECIPES)]));"
        "assert 'torch' not in sys.modules and 'numpy' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [list(registry) for registry in REGISTRIES]


def test_what_a_script_registers_is_no_wrong_name(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(LOBES._things, "ward_of_mine", Ward)
        assert main(["fit", "nowhere.binary", "--model", "ward_of_mine"]) == 1
    assert "nowhere.binary" in capsys.readouterr().err


def test_a_recipe_of_a_file_may_register_what_its_settings_name(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.py").write_text(
        "from dataclasses import dataclass\n"
        "from torchbrdf.experiment import FitGridRecipe\n"
        "from torchbrdf.lobes import LOBES, Ward\n"
        "LOBES.register('ward_of_mine')(type('WardOfMine', (Ward,), {}))\n"
        "@dataclass(frozen=True)\n"
        "class Mine(FitGridRecipe):\n"
        "    name = 'mine'\n"
        "    def steps(self, folder):\n"
        "        (folder.path / 'done').touch()\n"
        "        return folder.path / 'done'\n"
    )
    command = ["run", str(tmp_path / "mine.py"), "--out", str(tmp_path / "out"), "models=ward_of_mine"]
    (((status, out, err, _),), ((wrong, _, said, _),)) = (
        asked([one]) for one in (command, [*command[:-1], "models=ward_of_yours"])
    )
    assert (status, err) == (0, "") and out.strip() == str(tmp_path / "out" / "done")
    assert wrong == 2 and "did you mean 'ward_of_mine'" in said
    assert capsys.readouterr().err == ""


def test_words_are_those_of_their_homes() -> None:
    from typing import get_args

    from torchbrdf.fitting.api import DIFFUSE_MODES
    from torchbrdf.fitting.intervals import METHODS
    from torchbrdf.perception import FORMULAS
    from torchbrdf.perception.datasets.factors import FACTORS
    from torchbrdf.psychophysics import Method
    from torchbrdf.render.raster.backends import BACKENDS

    assert (kinds.DIFFUSE_MODES, kinds.INTERVALS, kinds.BACKENDS) == (DIFFUSE_MODES, METHODS, BACKENDS)
    assert get_args(Method) == kinds.SCALINGS and tuple(FORMULAS) == kinds.FORMULAS
    help_of = {
        field.name: field.metadata["help"]
        for field in dataclasses.fields(RECIPES["human_benchmark"])
        if "help" in field.metadata
    }
    assert FACTORS in help_of["factors"]
