"""What the paper states and what its released code does, as two switches, and a training without texts."""

from dataclasses import replace

import pytest
import torch
from omegaconf import OmegaConf

from anystyle.contracts import neutral_embedding
from anystyle.losses.content import Content
from anystyle.losses.style import StyleLoss
from anystyle.registry.compose import compose
from anystyle.testing.oracle import hashed
from anystyle.training.collate import blurred_views
from anystyle.training.run import objective
from anystyle.types import Style, Views
from tests.support.training_cases import parts

# Option: what the paper states (section 7 of its facts, equations 4 to 11), what the released code has.
DIFFERENCES = {
    "style_encoder.templates": ("none", "small"),
    "style_encoder.neutral": ("Photo", "a Photo"),
    "style_encoder.text_adapter": (False, True),
    "injector.special_tokens": (True, False),
    "placement.direct": (False, True),
    "branch.sh_degree": (4, 0),
    "styles.crop": ("centre", "random"),
    "styles.text_only": (0, 15000),
    "training.text_ratio": (0.5, 0.25),
    "training.alternation": ("strict", "coin"),
    "training.injector_rate": (1.0, 0.3),
    "training.flip": (0.0, 0.5),
    "training.min_scale": (1.0, 0.77),
    "training.decay_steps": (None, 300000),
    "loss.content.weight": (0.05, 0.075),
    "reduction": ("sum", "mean"),
    "loss.content.size": (None, 224),
    "loss.style.size": (None, 224),
    "loss.clip_directional.reference": ("render", "photograph"),
    "loss.clip_patch.reference": ("render", "photograph"),
    "loss.clip_patch.shared_crop": (False, True),
    "skip_outliers": (False, True),
    "trainer.max_steps": (90000, 300000),
}
STATED = {
    "training.learning_rate": 1e-4,
    "training.aggregator_rate": 0.3,
    "loss.style.weight": 1.0,
    "loss.clip_directional.weight": 2.0,
    "loss.clip_patch.weight": 4.0,
    "loss.clip_patch.crops": 16,
    "loss.clip_patch.crop_size": 64,
    "loss.depth_consistency.weight": 0.1,
    "loss.content.network": "vgg19",
    "loss.content.layers": ["relu3_1", "relu4_1"],
    "loss.style.layers": ["relu1_1", "relu2_1", "relu3_1", "relu4_1"],
}
"""Where both agree."""


def recipe(name, experiment="paper_full"):
    return compose("train", [f"experiment={experiment}", f"recipe={name}", "name=x", "out=x"])


@pytest.mark.parametrize("name", ["paper", "published"])
def test_the_papers_experiments_say_which_recipe_they_are(name):
    named, plain = recipe(name, "paper_head"), compose("train", ["experiment=paper_head", "name=x", "out=x"])
    assert (named == plain) is (name == "published")
    assert named.loss.content.weight == 0.05


def test_one_word_takes_means():
    config = compose("train", ["experiment=paper_head", "recipe=paper", "reduction=mean", "name=x", "out=x"])
    assert {value_of(config, f"loss.{term}.reduction") for term in ("content", "style")} == {"mean"}


@pytest.mark.parametrize("name", ["paper", "published"])
@pytest.mark.parametrize(
    "words", ["styles=folder", "style_encoder=clip", "model=tiny", "experiment=tiny_reconstruction"]
)
def test_a_recipe_composes_with_whatever_is_chosen(words, name):
    experiment = () if "experiment" in words else ("experiment=paper_head",)
    config = compose("train", [*experiment, words, f"recipe={name}", "name=x", "out=x"])
    assert objective(config).keys() == (set() if "reconstruction" in words else recipe(name).loss.keys())
    if words == "style_encoder=clip":
        assert value_of(config, "style_encoder.templates") == ("none", "small")[name == "published"]
    if words == "model=tiny":  # what the components do not have is left out
        assert "templates" not in config.style_encoder
        assert value_of(config, "injector.special_tokens") == (name == "paper")


def value_of(config, option):
    chosen = OmegaConf.select(config, option)
    return getattr(chosen, "value", chosen)


def leaves(node, prefix=""):
    if isinstance(node, dict):
        return {key: value for name, part in node.items() for key, value in leaves(part, f"{prefix}.{name}").items()}
    return {prefix.lstrip("."): node}


@pytest.mark.parametrize(("row", "name"), [(0, "paper"), (1, "published")])
def test_a_recipe_is_what_its_source_says(row, name):
    config = recipe(name)
    for option, values in DIFFERENCES.items():
        assert value_of(config, option) == values[row], option
    for option, value in STATED.items():
        chosen = OmegaConf.select(config, option)
        assert (list(chosen) if isinstance(value, list) else chosen) == value, option


def test_the_recipes_differ_in_nothing_else():
    paper, published = (
        leaves(OmegaConf.to_container(recipe(name), resolve=False, enum_to_str=True)) for name in ("paper", "published")
    )
    assert {key for key in {*paper, *published} if paper.get(key) != published.get(key)} == set(DIFFERENCES)


def test_the_unstyled_render_may_stand_for_the_photograph():
    training, source = parts("loss.clip_directional.reference=render")
    batch = source.batch(0)
    result = training.stylize(batch, training.embed(batch.style, 0))
    stylizer = training.stylizer
    expected = stylizer.render(stylizer.unstyled(result.scene), result.scene.cameras).color
    assert torch.equal(result.unstyled.color, expected) and not result.unstyled.color.requires_grad
    term = training.terms["clip_directional"]
    from_photographs = parts()[0].terms["clip_directional"]
    shown = replace(result, views=Views(images=result.unstyled.color))
    torch.testing.assert_close(term(result), from_photographs(shown))
    plain, _ = parts()
    assert plain.stylize(batch, plain.embed(batch.style, 0)).unstyled is None


def test_without_texts_no_text_reaches_the_encoder(monkeypatch):
    training, source = parts("training.text_ratio=0", "training.preview_texts=[]")
    encoder, read = training.stylizer.style_encoder, source.styles.read
    # Every other style of the source is a text alone.
    monkeypatch.setattr(source.styles, "read", lambda i: Style(text=("a text",)) if i % 2 else read(i))
    neutral_embedding(encoder)
    texts = []
    original = encoder.embed_texts
    monkeypatch.setattr(encoder, "embed_texts", lambda given: texts.extend(given) or original(given))
    for step in range(6):
        batch = source.batch(step)
        assert batch.style.image is not None and (batch.style.has_image is None or batch.style.has_image.all())
        training.embed(batch.style, step)
    assert set(texts) <= {encoder.neutral}
    assert not any(training.is_text_step(step) for step in range(100))


def test_images_may_be_kept_from_losses_on_text_steps():
    training, source = parts("training.text_ratio=1", "training.text_step_images=false")
    batch = source.batch(0)
    assert training.stylize(batch, training.embed(batch.style, 0)).style.image is None
    shown, _ = parts("training.text_ratio=1")
    assert shown.stylize(batch, shown.embed(batch.style, 0)).style.image is not None


def test_sums_are_means_times_the_number_of_terms(styled):
    options = {"network": "texture", "size": 48}
    layers = ("relu3_1",)
    mean, total = (Content(layers=layers, **options, reduction=how)(styled) for how in ("mean", "sum"))
    count = Content(layers=layers, **options).features(styled.renders.color.flatten(0, 1))[0][0].numel()
    torch.testing.assert_close(total, mean * count)
    mean, total = (StyleLoss(layers=layers, **options, reduction=how)(styled) for how in ("mean", "sum"))
    channels = Content(layers=layers, **options).features(styled.renders.color.flatten(0, 1))[0].shape[1]
    torch.testing.assert_close(total, mean * channels)


@pytest.fixture
def styled():
    training, source = parts()
    batch = source.batch(0)
    return training.stylize(batch, training.embed(batch.style, 0))


def test_shrinking_and_enlarging_blurs_and_keeps_the_size():
    # A flat picture stays, a random one loses contrast.
    flat, views = Views(images=torch.full((1, 1, 3, 28, 28), 0.25)), Views(images=hashed(1, (1, 2, 3, 28, 42)))
    torch.testing.assert_close(blurred_views(flat, 0.8).images, flat.images)
    blurred = blurred_views(views, 0.77)
    assert blurred.images.shape == views.images.shape and blurred.images.std() < 0.9 * views.images.std()
    fresh = ("training.pool=null", "training.cache_scenes=0")
    source, sharp = parts("training.min_scale=0.5", *fresh)[1], parts(*fresh)[1]
    images = source.batch(0).views.images
    assert torch.equal(images, source.batch(0).views.images) and images.std() < sharp.batch(0).views.images.std()
