"""The example workflows in a ComfyUI that runs: set ``ANYSTYLE_COMFYUI`` to its address, such as http://127.0.0.1:8188.

The nodes are in its folder ``custom_nodes``; a cancelled prompt is expected to end within seconds.
"""

import json
import os
import time
import urllib.request

import pytest

from tests.support.comfy_interface import ROOT, prompt_of

ADDRESS = os.environ.get("ANYSTYLE_COMFYUI", "")
DRAFT = {
    "AnyStyleLoadModel": {"options": "reconstruction=fit reconstruction.quality=draft"},
    "AnyStyleRender": {"frames": 6},
}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not ADDRESS, reason="ANYSTYLE_COMFYUI names no server")]


def call(path, body=None):
    content = None if body is None else json.dumps(body).encode()
    with urllib.request.urlopen(urllib.request.Request(ADDRESS + path, content)) as answer:
        return json.loads(answer.read() or "null")


def queue(name, changes):
    graph = json.loads((ROOT / "example_workflows" / f"{name}.json").read_text())
    answer = call("/prompt", {"prompt": prompt_of(graph, changes)})
    assert not answer["node_errors"]
    return answer["prompt_id"]


def finished(prompt, seconds=600):
    for _ in range(2 * seconds):
        if history := call(f"/history/{prompt}"):
            return history[prompt]
        time.sleep(0.5)
    raise TimeoutError(prompt)


@pytest.mark.parametrize("name", ["photographs_in_a_style", "text_and_picture_as_a_film"])
def test_workflows(name):
    history = finished(queue(name, DRAFT))
    assert history["status"]["status_str"] == "success", history["status"]
    assert history["outputs"]


def test_cancel():
    seed = f"reconstruction=fit reconstruction.quality=draft reconstruction.seed={time.time_ns() % 2**31}"
    prompt = queue("photographs_in_a_style", {"AnyStyleLoadModel": {"options": seed}})
    time.sleep(20)
    call("/interrupt", {})
    assert finished(prompt, 15)["status"]["messages"][-1][0] == "execution_interrupted"
