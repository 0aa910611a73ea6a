"""The evaluation's networks against the published implementations, filled by the same hash."""

import torch

from anystyle.testing.oracle import assert_matches, fill_named, hashed
from anystyle.vision import inception, networks
from tests.support.oracle import fill_sorted, golden


def with_classifiers(state: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The published Inception's state dict: two classifiers beside the features."""
    shapes = dict(state)
    for number in (1, 2):
        for name, out, kernel in (("conv0", 128, (128, 768, 1, 1)), ("conv1", 768, (768, 128, 5, 5))):
            stem = f"AuxLogits{number}.{name}"
            shapes[f"{stem}.conv.weight"] = torch.empty(kernel, device="meta")
            for leaf in ("weight", "bias", "running_mean", "running_var"):
                shapes[f"{stem}.bn.{leaf}"] = torch.empty(out, device="meta")
            shapes[f"{stem}.bn.num_batches_tracked"] = torch.zeros((), dtype=torch.long)
        for stem, width in ((f"AuxLogits{number}.fc", 768), (f"fc{number}", 2048)):
            shapes[f"{stem}.weight"] = torch.empty(1000, width, device="meta")
            shapes[f"{stem}.bias"] = torch.empty(1000, device="meta")
    return shapes


def test_inception_matches_the_reference() -> None:
    record = golden("anystyle_golden")["art_inception"]
    net = inception.ArtInception().eval()
    published = with_classifiers(net.state_dict())
    assert len(published) == record["n_keys"]
    net.load_state_dict(networks.part_of(net, fill_sorted(published)))
    with torch.no_grad():
        assert_matches(net(hashed(1120, (1, 3, 128, 160))), record["features"])


def test_alexnet_and_vgg16_have_the_published_shapes() -> None:
    alex = {key: list(value.shape) for key, value in networks.AlexNet().state_dict().items() if "weight" in key}
    assert alex == {
        "features.0.weight": [64, 3, 11, 11],
        "features.3.weight": [192, 64, 5, 5],
        "features.6.weight": [384, 192, 3, 3],
        "features.8.weight": [256, 384, 3, 3],
        "features.10.weight": [256, 256, 3, 3],
    }
    assert [key for key in networks.VGG16().state_dict() if "weight" in key] == [
        f"features.{place}.weight" for place in (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
    ]
    assert fill_named(networks.VGG16().state_dict()).keys() == networks.VGG16().state_dict().keys()
