"""The examples: what the index says of them is so, and their names stand for paths."""

import json
from pathlib import Path

import pytest

import anystyle
from anystyle.commands.stylize import main
from anystyle.data.folder import read_views
from anystyle.data.images import image_size, open_image
from anystyle.errors import UserError
from anystyle.examples import examples, resolved
from anystyle.pipeline.options import PoseOptions, ViewOptions
from anystyle.pipeline.styles import Mixture

NAMES = sorted(examples())
PAINTINGS = [name for name in NAMES if examples()[name].license == "public domain"]


def test_they_are_one_capture_with_its_licence_and_small_paintings():
    (capture,) = {*NAMES} - {*PAINTINGS}
    folder = resolved(Path(f"example:{capture}"))
    assert [image_size(path) for path in sorted(folder.glob("*.jpg"))] == [(1024, 768)] * 12
    assert "Redistribution" in (folder / "LICENCE.txt").read_text()
    for name in PAINTINGS:
        path = resolved(Path(f"example:{name}"))
        assert path.stem == name and path.stat().st_size < 200_000 and 256 <= min(open_image(path).size) <= 512


def test_no_file_is_without_an_entry():
    files = {path for path in (resolved(Path(f"example:{name}")) for name in NAMES) if path.is_file()}
    assert files == {*(next(iter(files)).parent.iterdir())}


def test_names_are_inputs_and_styles_in_python():
    few = ViewOptions(take=2, short_side=56)
    wave = Path("example:wave")
    styles = [wave, Mixture("charcoal drawing", wave, 0.5)]
    poses = PoseOptions("predicted")
    results = anystyle.stylize("example:street", styles, reconstruction="feedforward", views=few, poses=poses)
    assert [source.name for source in results.encoded.sources] == ["01", "12"]
    names = [style.name for style in results.styles]
    assert names == ["the-great-wave-off-kanagawa", "charcoal-drawing_0.50_the-great-wave-off-kanag"]


@pytest.mark.slow
def test_the_cameras_of_the_capture_are_found(tmp_path):
    few = {"frames": 2}
    anystyle.stylize("example:street", "charcoal drawing", views=ViewOptions(short_side=56), video=few, out=tmp_path)
    made = json.loads((tmp_path / "report.json").read_text())["reconstruction"]
    assert (made["kind"], made["registered"], made["trust"]) == ("fit", 12, "good")


def test_a_path_that_is_no_example_stays():
    assert resolved(Path("photos/example:street")) == Path("photos/example:street")
    with pytest.raises(UserError, match=r"no example is named 'stret'\. Did you mean 'street'"):
        read_views([Path("example:stret")], short_side=56, multiple=14, max_views=1)


def test_the_help_of_stylize_ends_with_all_and_their_licences(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    shown = capsys.readouterr().out.splitlines()[-len(NAMES) :]
    for line, (name, one) in zip(shown, examples().items(), strict=True):
        assert line.split() == f"example:{name} {one.title}; {one.author}, {one.year}; {one.license}".split()
