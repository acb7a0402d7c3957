"""Files of BRDF Explorer as that reads them, and their GLSL run by OpenGL."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.render.raster import opengl

# A triangle over the whole picture.
_VERTEX = "#version 150\nin vec2 at;\nvoid main() { gl_Position = vec4(at, 0.0, 1.0); }\n"
# As BRDF Explorer's templates: uniforms above, the file's shader below them.
_FRAGMENT = """#version 150
uniform sampler2D lights;
uniform sampler2D views;
{uniforms}
out vec4 value;
{shader}
void main()
{{
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 L = texelFetch(lights, at, 0).xyz, V = texelFetch(views, at, 0).xyz;
    value = vec4(BRDF(L, V, vec3(0, 0, 1), vec3(1, 0, 0), vec3(0, 1, 0)), 1.0);
}}
"""
_COUNTS = {"float": 3, "color": 3, "bool": 1}


@dataclass
class BrdfFile:
    """What BRDF Explorer finds in a file: parameters as (kind, name, numbers), and the shader."""

    parameters: list[tuple[str, str, list[float]]]
    shader: str

    @classmethod
    def read(cls, path: Path) -> "BrdfFile":
        """By its rules: the kind first; empty lines and those that begin with # are none; sections do not nest."""
        first, *lines = path.read_text(encoding="ascii").splitlines()
        assert first.split()[0] == "analytic"
        section, parameters, shader = "", [], []
        for line in lines:
            words = line.split()
            if not words or words[0].startswith("#"):
                continue
            if words[0] == "::begin":
                assert not section
                section = words[1]
            elif words[0] == "::end":
                assert words[1] == section
                section = ""
            elif section == "parameters":
                kind, name, *numbers = words
                assert len(numbers) == _COUNTS[kind]
                parameters.append((kind, name, [float(number) for number in numbers]))
            else:
                assert section == "shader"
                shader.append(line)
        assert not section
        return cls(parameters, "\n".join(shader))

    def evaluate(self, wi: Tensor, wo: Tensor) -> Tensor:
        """Values of the shader for light from `wi`, seen from `wo`, `(N, 3)` each."""
        return evaluate_all([self], wi, wo)[0]

    @property
    def fragment(self) -> str:
        """The whole fragment shader."""
        uniforms = [f"uniform {'vec3' if kind == 'color' else kind} {name};" for kind, name, _ in self.parameters]
        return _FRAGMENT.format(uniforms="\n".join(uniforms), shader=self.shader)

    @property
    def values(self) -> dict[str, list[float]]:
        """Of the parameters."""
        return {name: numbers if kind == "color" else numbers[-1:] for kind, name, numbers in self.parameters}


def evaluate_all(files: Sequence[BrdfFile], wi: Tensor, wo: Tensor) -> list[Tensor]:
    """Values of each file's shader; one that several have is compiled once, which is what takes time."""
    programs: dict[str, Any] = {}
    directions = [one.float().numpy() for one in (wi, wo)]
    with opengl._ALONE, opengl._renderer(8):
        found = [_run(programs, file.fragment, file.values, *directions) for file in files]
    return [torch.from_numpy(one).double() for one in found]


def _run(
    programs: dict[str, Any], fragment: str, uniforms: dict[str, list[float]], *directions: np.ndarray
) -> np.ndarray:
    from OpenGL import GL
    from OpenGL.GL import shaders

    count = len(directions[0])
    array = GL.glGenVertexArrays(1)
    GL.glBindVertexArray(array)
    corners = np.array([[-1, -1], [3, -1], [-1, 3]], np.float32)
    GL.glBindBuffer(GL.GL_ARRAY_BUFFER, GL.glGenBuffers(1))
    GL.glBufferData(GL.GL_ARRAY_BUFFER, corners.nbytes, corners, GL.GL_STATIC_DRAW)
    kinds = (_VERTEX, GL.GL_VERTEX_SHADER), (fragment, GL.GL_FRAGMENT_SHADER)
    if fragment not in programs:
        programs[fragment] = shaders.compileProgram(*(shaders.compileShader(text, kind) for text, kind in kinds))
    program = programs[fragment]
    GL.glUseProgram(program)
    place = GL.glGetAttribLocation(program, "at")
    GL.glEnableVertexAttribArray(place)
    GL.glVertexAttribPointer(place, 2, GL.GL_FLOAT, False, 0, None)
    for name, numbers in uniforms.items():
        at = GL.glGetUniformLocation(program, name)
        (GL.glUniform3f if len(numbers) == 3 else GL.glUniform1f)(at, *numbers)
    for unit, (name, rows) in enumerate(zip(("lights", "views"), directions, strict=True)):
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
        _texture(np.pad(rows, ((0, 0), (0, 1)))[None])
        GL.glUniform1i(GL.glGetUniformLocation(program, name), unit)
    GL.glActiveTexture(GL.GL_TEXTURE2)
    target = _texture(np.zeros((1, count, 4), np.float32))
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, GL.glGenFramebuffers(1))
    GL.glFramebufferTexture2D(GL.GL_FRAMEBUFFER, GL.GL_COLOR_ATTACHMENT0, GL.GL_TEXTURE_2D, target, 0)
    assert GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER) == GL.GL_FRAMEBUFFER_COMPLETE
    GL.glViewport(0, 0, count, 1)
    for state in (GL.GL_BLEND, GL.GL_DEPTH_TEST, GL.GL_CULL_FACE, GL.GL_MULTISAMPLE, GL.GL_SCISSOR_TEST):
        GL.glDisable(state)
    GL.glDrawArrays(GL.GL_TRIANGLES, 0, 3)
    found = np.frombuffer(GL.glReadPixels(0, 0, count, 1, GL.GL_RGBA, GL.GL_FLOAT), np.float32)
    return found.reshape(count, 4)[:, :3].copy()


def _texture(rows: np.ndarray) -> int:
    from OpenGL import GL

    made = GL.glGenTextures(1)
    GL.glBindTexture(GL.GL_TEXTURE_2D, made)
    for key in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, key, GL.GL_NEAREST)
    height, width, _ = rows.shape
    data = np.ascontiguousarray(rows, np.float32)
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGBA32F, width, height, 0, GL.GL_RGBA, GL.GL_FLOAT, data)
    return int(made)
