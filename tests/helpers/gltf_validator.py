"""Khronos' glTF validator, of npm: `npm install gltf-validator`, and NODE_PATH where its folder `node_modules` is."""

import json
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path
from typing import Any

VALIDATE = """
const validator = require("gltf-validator")
const bytes = new Uint8Array(require("fs").readFileSync(process.argv[1]))
validator.validateBytes(bytes, {maxIssues: 100}).then(report => console.log(JSON.stringify(report)))
"""


@lru_cache(1)
def obstacle() -> str:
    """Why the validator cannot run; empty if it can."""
    if shutil.which("node") is None:
        return "needs node"
    found = subprocess.run(["node", "-e", 'require("gltf-validator")'], capture_output=True, timeout=60, check=False)
    return "needs npm's gltf-validator on NODE_PATH" if found.returncode else ""


def report(path: Path) -> dict[str, Any]:
    """What the validator says of a file."""
    done = subprocess.run(["node", "-e", VALIDATE, str(path)], capture_output=True, timeout=120, check=True)
    said: dict[str, Any] = json.loads(done.stdout)
    return said


def said_of(report: dict[str, Any]) -> list[dict[str, Any]]:
    """What a report complains of.

    That tangents are not used without a normal texture is an information, and not so with KHR_materials_anisotropy,
    whose direction is told from them; this version of the validator does not know that.
    """
    has_grain = "KHR_materials_anisotropy" in report["info"].get("extensionsUsed", [])
    known = {"UNUSED_MESH_TANGENT"} if has_grain else set()
    return [one for one in report["issues"]["messages"] if one["code"] not in known]
