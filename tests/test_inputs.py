"""What a stylizer and its values are given is checked: one line that says what to do."""

import subprocess
import sys

DOORS = """
import torch, anystyle
from PIL import Image
from anystyle.types import Cameras, Gaussians, StyleEmbedding, Views

stylizer = anystyle.load("tiny")
side = 2 * stylizer.backbone.patch_size
images = torch.rand(1, 2, 3, side, side)
scene = stylizer.encode(Views(images))
same = stylizer.encode(Views(images.movedim(2, -1).contiguous().movedim(-1, 2)))
torch.testing.assert_close(same.attributes.opacity, scene.attributes.opacity, rtol=1e-4, atol=1e-4)
picture = Image.linear_gradient("L").resize((40, 30))
picture.save("a.png")
read = anystyle.read_image("a.png")
vectors = [stylizer.embed(image=given).vector for given in ("a.png", picture, read[None])]
assert torch.equal(vectors[0], vectors[1]) and torch.equal(vectors[0], vectors[2])
embedding = stylizer.embed(text="ink")
gaussians, cameras = stylizer.restyle(scene, embedding), scene.cameras
numbers = torch.rand(1, embedding.vector.shape[1] + 1)
not_a_number = cameras.world_from_camera * float("nan")
cases = {
    "missing: [None]": lambda: Views(images[0]),
    "movedim(-1, -3)": lambda: Views(images.movedim(2, -1)),
    ".float() / 255": lambda: Views((images * 255).byte()),
    "divide by 255": lambda: stylizer.encode(Views(images * 255)),
    "from nan to nan": lambda: stylizer.encode(Views(images * float("nan"))),
    "from -1": lambda: stylizer.encode(Views(images.round() * 2 - 1)),
    "use .to(torch.float32)": lambda: stylizer.encode(Views(images.double())),
    "torch.float16": lambda: stylizer.encode(Views(images.half())),
    "no pixels": lambda: stylizer.encode(Views(images[:, :0])),
    "multiples of": lambda: stylizer.encode(Views(images[..., 1:])),
    "types.Views is expected": lambda: stylizer.encode(images),
    "V=2": lambda: Views(images, Cameras(torch.eye(4).expand(1, 3, 4, 4), torch.eye(3).expand(1, 3, 3, 3), (4, 4))),
    "[B, 3, h, w]": lambda: stylizer.embed(image=images[0, 0]),
    "list of texts": lambda: stylizer.embed(text=[]),
    "dimensions": lambda: stylizer.restyle(scene, StyleEmbedding(numbers, numbers)),
    "cannot be mixed": lambda: embedding.toward(StyleEmbedding(numbers, numbers), 0.5),
    "StyleEmbedding is expected": lambda: stylizer.restyle(scene, embedding.vector),
    "of 3 scenes": lambda: stylizer.render(gaussians, cameras.expand(3)),
    "focal length": lambda: stylizer.render(gaussians, Cameras(not_a_number, cameras.intrinsics, cameras.size)),
    "Gaussians.means": lambda: Gaussians(*(each[0] for each in vars(gaussians).values())),
}
for expected, case in cases.items():
    try:
        case()
    except anystyle.errors.UserError as error:
        assert expected in str(error) and "\\n" not in str(error), (expected, str(error))
    else:
        raise AssertionError(expected)
"""


def test_each_door_says_what_is_wrong_in_one_line(tmp_path):
    # In a process of its own, where no hook checks shapes before the values do.
    done = subprocess.run([sys.executable, "-c", DOORS], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
