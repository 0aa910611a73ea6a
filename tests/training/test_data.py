"""Scenes kept on disk, and loaders that start where a run stands."""

import multiprocessing
import os
import signal
from types import SimpleNamespace

import lightning.pytorch as pl
import pytest
import torch
from lightning.pytorch.demos.boring_classes import BoringModel

from anystyle.contracts import SceneSource
from anystyle.errors import UserError
from anystyle.testing.oracle import hashed
from anystyle.training.data import StepData, StepLoader
from anystyle.training.scene_cache import CachedScenes
from anystyle.types import Cameras, Views


class Counted(SceneSource):
    """Scenes that count how often they are made."""

    def __init__(self, *, size: int = 12, nearest: float = 0.5) -> None:
        self.size, self.nearest, self.made = size, nearest, 0

    def __len__(self) -> int:
        return 3

    def name(self, scene: int) -> str:
        return f"scene-{scene}"

    def num_views(self, scene: int) -> int:
        return 4

    def read(self, scene, views) -> Views:
        self.made += 1
        count, size = self.num_views(scene), self.size
        images = (hashed(scene + 1, (1, count, 3, size, size)) * 255).round() / 255
        cameras = Cameras(hashed(9, (1, count, 4, 4)), hashed(8, (1, count, 3, 3)), (size, size))
        depth = hashed(7, (1, count, size, size), self.nearest, 8)
        return Views(images=images, cameras=cameras, depth=depth).select(list(views))


def test_scenes_are_made_once_and_read_as_they_were(tmp_path):
    source = Counted()
    cached = CachedScenes(source, tmp_path)
    views = source.read(1, [3, 0])
    made = source.made
    for _ in range(3):
        read = cached.read(1, [3, 0])
        torch.testing.assert_close(read.images, views.images, atol=1e-7, rtol=0)
        torch.testing.assert_close(read.depth, views.depth, atol=0, rtol=2**-11)
        assert torch.equal(read.cameras.world_from_camera, views.cameras.world_from_camera)
        assert torch.equal(read.cameras.intrinsics, views.cameras.intrinsics)
    assert source.made == made + 1
    # Another process, or the same command a day later, finds what was made; it looks at the first scene alone.
    later = Counted()
    again = CachedScenes(later, tmp_path)
    assert torch.equal(again.read(1, [2]).images, cached.read(1, [2]).images)
    assert later.made == 1 and len(again) == 3 and again.name(2) == "scene-2" and again.num_views(0) == 4


def test_sources_that_share_a_cache_keep_apart(tmp_path):
    """What a first try has left does not spoil the second one."""
    for size in (8, 16, 8):
        assert CachedScenes(Counted(size=size), tmp_path).read(0, [1]).images.shape[-2:] == (size, size)
    CachedScenes(Counted(size=8, nearest=4), tmp_path).read(0, [1])  # the same images, other depth
    assert len(list(tmp_path.iterdir())) == 3


class Steps:
    """Batches that say which step, process and number of processes they are for."""

    def batch(self, step: int, rank: int, world: int) -> Views:
        return Views(images=torch.tensor([step, rank, world], dtype=torch.float32).reshape(1, 1, 3, 1, 1))


@pytest.mark.parametrize("workers", [0, 2])
def test_a_loader_starts_where_the_run_stands_and_draws_no_random_number(workers):
    torch.manual_seed(0)
    before = torch.get_rng_state()
    loader = StepLoader(Steps(), range(3, 7), rank=1, world=2, workers=workers)
    assert [batch.images.flatten().tolist() for batch in loader] == [[step, 1, 2] for step in range(3, 7)]
    # Lightning counts the steps already done.
    assert len(loader) == 7 and torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_batches_are_pinned_where_a_card_takes_them(device):
    strategy = SimpleNamespace(root_device=torch.device(device))
    data = StepData(Steps())
    steps = {"accumulate_grad_batches": 2, "global_step": 3, "max_steps": 5}
    data.trainer = SimpleNamespace(**steps, global_rank=0, world_size=1, strategy=strategy, optimizers=[])
    loader = data.train_dataloader().loader
    assert loader.pin_memory == (device == "cuda") and loader.sampler == range(6, 10)


@pytest.mark.filterwarnings("ignore")  # of Lightning
def test_several_optimizers_each_of_whose_steps_lightning_counts_are_refused():
    module = BoringModel()
    module.automatic_optimization = False
    module.configure_optimizers = lambda: [torch.optim.SGD(module.parameters(), 0.1) for _ in range(2)]
    with pytest.raises(UserError, match="a training has one optimizer"):
        pl.Trainer(accelerator="cpu", barebones=True).fit(module, datamodule=StepData(Steps()))


@pytest.mark.parametrize("name", [signal.SIGTERM, signal.SIGINT])
def test_signals_that_reach_the_workers_too_leave_the_training_its_batches(name):
    before = set(multiprocessing.active_children())
    rows = iter(StepLoader(Steps(), range(12), workers=2))
    # A batch of each: both are up.
    assert [int(next(rows).images.flatten()[0]) for _ in range(2)] == [0, 1]
    workers = set(multiprocessing.active_children()) - before
    assert len(workers) == 2
    for worker in workers:
        os.kill(worker.pid, name)
    assert [int(batch.images.flatten()[0]) for batch in rows] == list(range(2, 12))
    del rows
    for worker in workers:
        worker.join(20)
        assert worker.exitcode == 0
