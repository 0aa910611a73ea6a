"""Judged results of a small track."""

import pytest

from tests.support.benchmark_world import write_results, write_track


@pytest.fixture(scope="session")
def world(tmp_path_factory):
    """A track's file and judged results of three methods, of which noise has two seeds; nobody may change them."""
    from anystyle_benchmark.command_judge import main

    folder = tmp_path_factory.mktemp("world")
    track = write_track(folder / "track", views=2, images=3, texts=1)
    write_results(track, folder / "results", ("noise", "pasted", "unstyled"), seeds=2)
    main([str(folder / "results"), "--track", str(track), "--processes", "1"])
    return track, folder / "results"
