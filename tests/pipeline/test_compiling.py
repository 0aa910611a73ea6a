"""What ``compile=true`` compiles, and that results stay."""

import subprocess
import sys

import pytest
import torch

import anystyle
from anystyle.errors import UserError
from anystyle.pipeline.compiling import compile_blocks
from tests.support.refusals import raises_line

PROGRAM = """
import sys, torch, anystyle
from anystyle.pipeline import compiling, load
from anystyle.testing.oracle import smooth_image
from anystyle.types import Views
graphs, views, tolerance = [], Views(smooth_image(3, (1, 2, 3, 56, 84))), float(sys.argv[1])
def backend(graph, inputs):
    graphs.append(graph)
    return graph.forward
def results(stylizer):
    scene = stylizer.encode(views)
    styled = stylizer.restyle(scene, stylizer.embed(text="thick swirling strokes in deep blue"))
    given = {"depth": scene.geometry.depth, "colors": styled.harmonics, **vars(scene.attributes)}
    return {name: value for name, value in given.items() if value is not None}
expected = results(anystyle.load("tiny"))
if not tolerance:
    load.compile_blocks = lambda stylizer: compiling.compile_blocks(stylizer, backend=backend)
compiled = anystyle.load("tiny", ["compile=true"])
first, once = results(compiled), len(graphs)
second, blocks = results(compiled), [each for each in compiled.modules() if each._compiled_call_impl is not None]
assert len(graphs) == once < len(blocks) and (once > 10 or tolerance), (len(graphs), once, len(blocks))
for name, value in expected.items():
    for result in (first, second):
        least = tolerance * float(value.abs().max())
        torch.testing.assert_close(result[name], value, rtol=0, atol=least, msg=lambda it: f"{name}: {it}")
"""


@pytest.mark.parametrize("tolerance", [0.0, pytest.param(1e-4, marks=[pytest.mark.slow, pytest.mark.timeout(900)])])
def test_blocks_of_a_kind_are_compiled_once_and_give_the_same(tolerance: float) -> None:
    """As they are, bit for bit; and, slowly, by PyTorch's usual compiler.

    In a process of its own, for what tests check of annotations cannot be compiled.
    """
    command = [sys.executable, "-c", PROGRAM, str(tolerance)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stderr.count("compile=true: compiling and the first pass took") == 1


def test_without_a_compiler_one_line_says_so() -> None:
    def backend(graph, inputs):
        raise RuntimeError("No working C++ compiler found\n\nSet TORCHDYNAMO_VERBOSE=1")

    limit = torch._dynamo.config.cache_size_limit
    try:
        with raises_line(UserError, match=r"No working C\+\+ compiler found; install a C\+\+ compiler, or"):
            compile_blocks(anystyle.load("tiny"), backend=backend)
    finally:
        torch._dynamo.config.cache_size_limit = limit
