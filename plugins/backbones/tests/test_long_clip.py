"""The published text path against the published implementation: tokeniser, Long-CLIP, templates, text adapter."""

import gzip
import hashlib
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from anystyle.contracts import neutral_embedding
from anystyle.testing.oracle import assert_matches, hashed, smooth_image
from anystyle.vision import weights
from anystyle.vision.feature_cache import identity
from anystyle_backbones import bpe
from anystyle_backbones.clip import STRETCHED, Clip, load_clip
from anystyle_backbones.long_clip import LongClip, TextAdapter, small_templates
from tests.support.oracle import fill_sorted, golden

GOLDEN = golden("anystyle_golden")
RECORD = GOLDEN["longclip_b32"]


@pytest.fixture(scope="module")
def long_clip() -> LongClip:
    """Filled from a file that has Long-CLIP's keys."""
    with torch.device("meta"):
        encoder = LongClip()
    positions = torch.empty(encoder.network.positional_embedding.shape)
    state = fill_sorted(encoder.network.state_dict() | {STRETCHED: positions, "logit_scale": torch.empty(())})
    assert len(state) == RECORD["n_keys"] and sum(map(Tensor.numel, state.values())) == RECORD["n_params"]
    encoder.load_published(state)
    return encoder.eval().requires_grad_(False)


@pytest.fixture(scope="session")
def vocabulary() -> Path:
    try:
        return weights.find("clip_vocabulary")
    except FileNotFoundError as error:
        pytest.skip(str(error))


def example(tmp_path: Path, **options: object) -> LongClip:
    torch.manual_seed(0)
    return LongClip(**{**LongClip.example(tmp_path), **options}).eval()


def test_tokens_are_the_published_ones(vocabulary: Path) -> None:
    assert hashlib.sha256(vocabulary.read_bytes()).hexdigest() == GOLDEN["tokenizer"]["bpe_vocab_sha256"]
    tokenizer = bpe.load(vocabulary, 49408)
    assert (tokenizer.start, tokenizer.end) == (GOLDEN["tokenizer"]["sot"], GOLDEN["tokenizer"]["eot"])
    for case in GOLDEN["tokenizer"]["cases"]:
        assert tokenizer.encode(case["text"]) == case["ids"], case["text"]


def test_templates_are_the_published_ones() -> None:
    assert list(small_templates()) == GOLDEN["tokenizer"]["templates_small"]


def test_words_are_split_as_clip_does() -> None:
    text = "Van Gogh’s 12% caf\u00e9 &amp;  don't!"
    assert list(bpe.words(bpe.clean(text))) == ["van", "gogh", "'s", "1", "2", "%", "café", "&", "don", "'t", "!"]


def test_the_merges_of_lowest_rank_come_first(tmp_path: Path) -> None:
    (tmp_path / "merges.txt").write_text("#version\nb c\na b\nbc d</w>\n")
    tokenizer = bpe.load(tmp_path / "merges.txt", 512 + 3 + 2)
    ids = [tokenizer.ids[symbol] for symbol in ("a", "bcd</w>", "ab", "c</w>")]
    assert tokenizer.encode("abcd abc") == [tokenizer.start, *ids, tokenizer.end]


def test_a_vocabulary_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "short.txt").write_text("#version\na b\n")
    with pytest.raises(ValueError, match=r"short\.txt holds no 48894 pairs"):
        bpe.load(tmp_path / "short.txt", 49408)
    (tmp_path / "cut.txt.gz").write_bytes(gzip.compress(b"#version\na b\n")[:10])
    with pytest.raises(ValueError, match=r"cut\.txt\.gz is not a valid vocabulary"):
        bpe.load(tmp_path / "cut.txt.gz", 49408)


def test_texts_are_embedded_as_published(long_clip: LongClip, vocabulary: Path) -> None:
    tokens = long_clip.tokens(RECORD["texts"])
    assert [int(row.argmax()) + 1 for row in tokens] == RECORD["n_tokens"]
    assert_matches(long_clip.network.embed_tokens(tokens), RECORD["text"], atol=2e-4)


def test_images_are_embedded_as_published(long_clip: LongClip) -> None:
    assert_matches(long_clip.network.visual(hashed(1060, (1, 3, 224, 224), -2, 2)), RECORD["image"], atol=2e-4)


def test_the_text_adapter_is_the_published_one() -> None:
    record = GOLDEN["text_adapter"]
    adapter = TextAdapter(512)
    adapter.load_state_dict(fill_sorted(adapter.state_dict()))
    features = 0.5 * hashed(1050, (2, 512), -1, 1)
    assert_matches(adapter(features), record["text"])
    assert_matches(F.normalize(features, dim=-1), record["image"])


def test_texts_are_put_into_every_template(tmp_path: Path) -> None:
    encoder = example(tmp_path, text_adapter=True)
    features = encoder.features([template.format("red") for template in small_templates()])
    assert encoder.adapter is not None
    features = F.normalize(features + encoder.adapter.mlp(features), dim=-1)
    expected = F.normalize(features.mean(0, keepdim=True), dim=-1)
    torch.testing.assert_close(encoder.embed_texts(["red"]), expected)


def test_images_go_through_a_square_of_256_pixels(tmp_path: Path) -> None:
    encoder = example(tmp_path)
    picture = smooth_image(3, (1, 3, 140, 280))
    large = F.interpolate(picture, size=(256, 512), mode="bilinear", antialias=True)[..., 128:384]
    small = F.interpolate(large, size=(32, 32), mode="bicubic", antialias=True)
    expected = F.normalize(encoder.network.embed_pixels(small), dim=-1)
    torch.testing.assert_close(encoder.embed_images(picture), expected)
    assert torch.equal(encoder.embed_images(small), F.normalize(encoder.network.embed_pixels(small), dim=-1))


def small_clip(context: int) -> Clip:
    torch.manual_seed(1)
    return Clip(context=context, vocabulary=40, text_width=64, text_layers=1, image_width=64, image_layers=1, dim=8)


def test_weights_of_clip_load_without_what_no_embedding_needs() -> None:
    source, target = small_clip(77), small_clip(77)
    extras = {"input_resolution": torch.tensor(224), "context_length": torch.tensor(77), "logit_scale": torch.ones(())}
    load_clip(target, {f"module.{key}": tensor.half() for key, tensor in (source.state_dict() | extras).items()})
    assert torch.equal(target.positional_embedding, source.positional_embedding.half().float())
    assert target.text_projection.dtype == torch.float32


def test_long_clip_uses_its_second_table_from_position_20_on() -> None:
    source, target = small_clip(248), small_clip(248)
    load_clip(target, source.state_dict() | {STRETCHED: torch.full_like(source.positional_embedding, 7.0)})
    assert torch.equal(target.positional_embedding[:20], source.positional_embedding[:20])
    assert (target.positional_embedding[20:] == 7).all()


def test_what_does_not_fit_is_named() -> None:
    state = small_clip(77).state_dict()
    del state["ln_final.bias"]
    state["visual.proj"] = torch.zeros(3, 3)
    state["extra"] = torch.zeros(1)
    told = (
        r"1 missing \(ln_final.bias\); 1 unexpected \(extra\); 1 misshapen \(visual.proj is \[3, 3\], not \[64, 8\]\)"
    )
    with pytest.raises(ValueError, match=f"the checkpoint of CLIP or Long-CLIP does not fit this Clip: {told}"):
        load_clip(small_clip(77), state)


def test_a_text_too_long_is_refused_not_cut(tmp_path: Path) -> None:
    encoder = example(tmp_path, context=12)
    with pytest.raises(ValueError, match=r"has \d+ tokens, template included, and at most 12 are read; shorten it"):
        encoder.embed_texts(["rerererere rerererere"])


def test_the_neutral_prompt_is_embedded_once(tmp_path: Path) -> None:
    encoder = example(tmp_path).requires_grad_(False)
    calls: list[int] = []
    encoder.network.token_embedding.register_forward_hook(lambda *_: calls.append(1))
    first = neutral_embedding(encoder)
    count = len(calls)
    assert count > 0
    first.zero_()  # what a caller does to its copy is its own affair
    second = neutral_embedding(encoder)
    assert len(calls) == count and second.norm() == pytest.approx(1, abs=1e-5)
    with torch.no_grad():
        encoder.network.text_projection.mul_(torch.linspace(-1, 1, encoder.dim))
    assert not torch.allclose(neutral_embedding(encoder), second) and len(calls) > count


@pytest.mark.parametrize("fused", [False, True])
def test_what_is_kept_for_weights_is_not_for_those_that_learn(tmp_path: Path, fused: bool) -> None:
    encoder = example(tmp_path).requires_grad_()
    before, known = neutral_embedding(encoder), identity(encoder)
    encoder.embed_texts(["red"]).square().sum().backward()
    torch.optim.AdamW([p for p in encoder.parameters() if p.grad is not None], lr=0.1, fused=fused).step()
    after = neutral_embedding(encoder)
    with torch.no_grad():
        assert torch.equal(after, encoder.embed_texts([encoder.neutral])) and not torch.equal(after, before)
    assert identity(encoder) != known


def test_an_encoder_made_in_inference_mode_has_a_neutral_embedding(tmp_path: Path) -> None:
    with torch.inference_mode():
        encoder = example(tmp_path)
        assert torch.equal(neutral_embedding(encoder), neutral_embedding(encoder))
