"""What a training's batches cost from a folder of scenes, from shards on a disk, and from shards on a server.

``python -m tests.benchmarks.shards FOLDER [STEPS]`` packs the scenes of a folder, reads the same batches from each in
turns, compares them, and prints seconds and bytes for each step. The server is another process of this machine.
"""

import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable
from operator import truediv
from pathlib import Path
from statistics import median

import torch

from anystyle.data.scene_folder import FolderScenes
from anystyle.evaluation.tables import Table
from anystyle.training.data import Batch, SceneBatches
from anystyle_datasets.packing import pack
from anystyle_datasets.shard_sources import ShardScenes
from tests.support.range_server import Ranges, serving

SIDE, VIEWS = 224, 4


def serve(folder: Path, tell: Callable[[object], None], ask: Callable[[], object]) -> None:
    """Serve until asked to end; every question is answered with the bytes that were sent since the last."""
    with serving(folder) as address:
        tell(address)
        while ask():
            tell(sum(count for _, count in Ranges.log))
            Ranges.log.clear()


def measure(root: Path, steps: int) -> Table:
    """Medians over steps: seconds, the reader's seconds of CPU, and their ratio to the folder's of the same step."""
    folder = FolderScenes(root=str(root), short_side=SIDE)
    with tempfile.TemporaryDirectory() as name:
        index = pack(folder, Path(name), options={"short_side": SIDE, "multiple": None})
        here, there = multiprocessing.Pipe()
        server = multiprocessing.Process(target=serve, args=(Path(name), there.send, there.recv), daemon=True)
        server.start()
        sources = {"folder": folder, "shards": ShardScenes(root=name), "shards, served": ShardScenes(root=here.recv())}
        batches = {
            key: SceneBatches(source, batch_size=1, context_views=(VIEWS, VIEWS), spread="any")
            for key, source in sources.items()
        }
        figures: dict[str, list[tuple[float, float]]] = {key: [] for key in batches}
        read: dict[str, Batch] = {}
        for step in range(steps + 1):
            for turn in range(len(batches)):
                key = list(batches)[(step + turn) % len(batches)]
                wall, cpu = time.perf_counter(), time.process_time()
                read[key] = batches[key].batch(step)
                figures[key].append((time.perf_counter() - wall, time.process_time() - cpu))
            assert all(torch.equal(batch.views.images, read["folder"].views.images) for batch in read.values())
            if step == 0:  # the headers of the folder and the first connection are not counted
                here.send(True)
                here.recv()
        here.send(True)
        sent = here.recv() / steps
        here.send(False)
        server.join()
    walls, cpus = ({key: [row[part] for row in rows[1:]] for key, rows in figures.items()} for part in (0, 1))
    ratios = {key: median(map(truediv, cpus[key], cpus["folder"])) for key in cpus}
    rows = [(key, f"{median(walls[key]):.3f}", f"{median(cpus[key]):.3f}", f"{ratios[key]:.2f}") for key in ratios]
    packed = f"{len(index.names)} scenes of {sum(index.shards) / 2**20:.1f} MiB in {len(index.shards)} shards"
    told = f"{packed}; {VIEWS} views a step, {steps} steps; {sent / 1024:.0f} KiB a step were served"
    return Table(("read from", "seconds a step", "of CPU", "ratio"), tuple(rows), notes=(told,))


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    sys.stdout.write(measure(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 40).markdown())


if __name__ == "__main__":
    main()
