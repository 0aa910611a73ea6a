"""Trainings of the texture network and of the style space: what their parts compute, and that a few steps learn."""

import warnings

import lightning.pytorch as pl
import pytest
import torch
import torch.nn.functional as F

from anystyle.errors import UserError
from anystyle.testing.oracle import hashed
from anystyle.testing.toy.styles import ToyStyles
from anystyle.training.data import StepData
from anystyle_tiny.procedural.scenes import ProceduralScenes
from anystyle_tiny.procedural.styles import ProceduralStyles
from anystyle_tiny.style_encoder import Tiny
from anystyle_tiny.training.embedding import EmbeddingTraining
from anystyle_tiny.training.perceptual import TAPS, NormedTexture, PerceptualTraining, palette_loss
from anystyle_tiny.training.styles import UNKNOWN, StyleBatches, TraitHeads

SIZE = 64


@pytest.fixture(scope="module")
def scenes() -> ProceduralScenes:
    return ProceduralScenes(size=SIZE, num_scenes=2, views=2, samples=1)


@pytest.fixture(scope="module")
def styles() -> ProceduralStyles:
    return ProceduralStyles(size=SIZE, num_styles=24)


def fit(training: pl.LightningModule, source: StyleBatches, steps: int) -> list[float]:
    """Train for some steps; the losses."""
    losses: list[float] = []

    class Record(pl.Callback):
        def on_train_batch_end(self, trainer, pl_module, outputs, *rest) -> None:
            losses.append(outputs["loss"].item())

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"lightning\..*")
        warnings.filterwarnings("ignore", message=".*LeafSpec.*")
        quiet = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
        options = {"max_epochs": -1, "accelerator": "cpu", "devices": 1, "callbacks": [Record()]}
        trainer = pl.Trainer(max_steps=steps, **options, **dict.fromkeys(quiet, False))
        trainer.fit(training, datamodule=StepData(source))
    return losses


class TestBatches:
    def test_rows_are_what_the_source_makes(self, styles: ProceduralStyles, scenes: ProceduralScenes) -> None:
        batch = StyleBatches(styles, scenes, batch_size=6, photos=2).batch(0)
        for place, key in enumerate(batch.keys[:6]):
            style = styles.read(key)
            assert batch.texts[place] == style.text[0]
            assert torch.equal(batch.images[place], style.image[0])
            traits = styles.traits(key)
            assert batch.traits[place].tolist() == [traits.pattern, traits.scale, traits.brushwork]
        assert all(key < 0 for key in batch.keys[6:])
        assert batch.photos.shape == (2, 3, SIZE, SIZE)

    def test_what_cannot_serve_is_refused(self, styles: ProceduralStyles, scenes: ProceduralScenes) -> None:
        with pytest.raises(UserError, match=r"the traits of ToyStyles are not known; use styles=procedural"):
            StyleBatches(ToyStyles(), scenes)
        with pytest.raises(ValueError, match="this training needs scenes"):
            StyleBatches(styles, None)
        with pytest.raises(ValueError, match="a batch of 64 needs as many styles, and there are 24"):
            StyleBatches(styles, scenes)
        small = ProceduralScenes(size=16, num_scenes=1, views=1)
        with pytest.raises(ValueError, match="styles are 64x64 and scenes 16x16"):
            StyleBatches(styles, small, batch_size=4).batch(0)


class TestPalette:
    def test_a_shift_of_all_colours_costs_a_third_of_its_square(self) -> None:
        """Over random directions the mean of the squared projection of a vector is a third of its square."""
        torch.manual_seed(0)
        flat = torch.full((1, 3, 8, 8), 0.3)
        shift = torch.tensor([0.1, -0.2, 0.3])
        loss = palette_loss((0.3 + shift).expand(1, 4, 3), flat, directions=20000)
        torch.testing.assert_close(loss, shift.square().sum()[None] / 3, rtol=0.03, atol=0)


class TestPerceptual:
    def test_folding_keeps_the_function(self) -> None:
        torch.manual_seed(0)
        network = NormedTexture()
        images = hashed(1, [4, 3, 32, 32])
        for _ in range(3):
            network(images, TAPS)  # running statistics unlike those at initialisation
        network.eval()
        with torch.no_grad():
            for found, wanted in zip(network.folded()(images, TAPS), network(images, TAPS), strict=True):
                torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-4)

    def test_a_few_steps_on_one_batch_learn_it(self, styles: ProceduralStyles, scenes: ProceduralScenes) -> None:
        torch.manual_seed(0)
        training = PerceptualTraining(batch_size=8, photos=2, crop=32, pool=8, warmup=1, bf16=False, learning_rate=1e-3)
        losses = fit(training, training.batches(scenes, styles, seed=0), 14)
        assert sum(losses[-3:]) / 3 < 0.8 * losses[0]
        exported = training.exports()["texture"]
        assert set(exported.state_dict()) == set(training.network.folded().state_dict())


class TestEmbedding:
    def make(self, **options: object) -> EmbeddingTraining:
        torch.manual_seed(0)
        encoder = Tiny(dim=32, text_width=32)
        return EmbeddingTraining(
            style_encoder=encoder, texture=None, batch_size=8, photos=2, pool=8, whiten_on=8, warmup=1, **options
        )

    def test_contrast_is_its_equation(self) -> None:
        training = self.make()
        pictures, captions = (F.normalize(hashed(seed, [5, 32], -1, 1), dim=-1) for seed in (1, 2))
        scale = training.log_temperature.exp()
        expected = torch.zeros(())
        for a, b in ((pictures, captions), (captions, pictures)):
            logs = (a @ b.T / scale).log_softmax(1)
            # Three styles of their own, two photographs in common.
            expected = expected - (logs.diagonal()[:3].sum() + logs[3:, 3:].sum() / 2) / 5 / 2
        torch.testing.assert_close(training.contrast(pictures, captions, 2), expected)

    def test_remembered_textures_give_what_the_tower_gives(
        self, styles: ProceduralStyles, scenes: ProceduralScenes
    ) -> None:
        training = self.make(feature_noise=0.0)
        batch = training.batches(scenes, styles, seed=0).batch(0)
        images = torch.cat([batch.images, batch.photos])
        tower = training.style_encoder.image_tower
        for _ in range(2):
            torch.testing.assert_close(training.known_pictures(images, batch.keys)[0], tower(images))

    def test_a_few_steps_learn_and_whiten_on_the_way(self, styles: ProceduralStyles, scenes: ProceduralScenes) -> None:
        training = self.make(whiten_at=0.5)
        encoder = training.style_encoder
        texture = [parameter.clone() for parameter in encoder.image_tower.texture.parameters()]
        losses = fit(training, training.batches(scenes, styles, seed=0), 12)
        assert sum(losses[-3:]) < 0.9 * sum(losses[:3])
        assert all(map(torch.equal, encoder.image_tower.texture.parameters(), texture))
        assert encoder.image_mean.norm() > 0
        assert not torch.equal(encoder.whitening, torch.eye(32))
        assert set(training.exports()) == {"style_encoder"}


def test_a_trait_that_no_row_knows_costs_nothing_and_the_others_are_the_mean_over_rows_that_know() -> None:
    heads = TraitHeads(4)
    features = torch.randn(3, 4, generator=torch.Generator().manual_seed(0))
    traits = torch.zeros(3, len(heads), dtype=torch.long)
    first, second = list(heads)[:2]
    traits[:, 0] = UNKNOWN
    traits[2, 1] = UNKNOWN
    losses = heads.losses(features, traits, smoothing=0.05)
    assert losses[first] == 0
    rows = torch.nn.functional.cross_entropy(heads[second](features[:2]), traits[:2, 1], label_smoothing=0.05)
    torch.testing.assert_close(losses[second], rows)
