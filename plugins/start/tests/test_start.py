"""The start page without a browser: who may ask, what is taken, and how runs go, wait, end and are kept."""

import json
import shlex
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from anystyle.data.photo_masks import find_masks
from anystyle.errors import UserError
from anystyle.pipeline.request import Request
from anystyle_start.library import Library, Settings
from anystyle_start.progress import State, follow
from anystyle_start.server import StartServer
from anystyle_start.words import command_words, shown_command
from tests.support.browser import until
from tests.support.start_serving import Client, jpeg, pretended


@pytest.fixture
def started(tmp_path):
    with StartServer(tmp_path / "kept", 0, pretended(tmp_path)) as server:
        yield server


@pytest.fixture
def client(started):
    return Client(started)


@pytest.mark.parametrize(
    ("method", "path", "changes", "status"),
    [
        ("GET", "/", {}, 200),
        ("GET", "/", {"Host": "evil.example"}, 421),  # DNS rebinding
        ("GET", "/", {"Sec_Fetch_Site": "cross-site"}, 200),  # a link to the page
        ("GET", "/state", {"Sec_Fetch_Site": "cross-site"}, 403),
        ("GET", "/state", {"Sec_Fetch_Site": "same-site"}, 403),  # a page of another port
        ("GET", "/state", {"Origin": "http://evil.example"}, 403),
        ("POST", "/scenes", {}, 200),
        ("POST", "/scenes", {"Origin": "http://evil.example"}, 403),
        ("POST", "/scenes", {"Origin": None}, 403),
        ("POST", "/scenes", {"X_Anystyle_Token": None}, 403),
        ("POST", "/scenes", {"X_Anystyle_Token": "guessed"}, 403),
        ("PUT", "/scenes", {}, 403),
        ("GET", "/thumbnail/0123456789ab/x.jpg", {}, 400),
        ("GET", "/page/../1", {}, 400),
        ("GET", "/painting/..%2Fstreet", {}, 404),
    ],
)
def test_only_the_own_page_may_ask(client, method, path, changes, status):
    assert client.ask(method, path, **changes)[0] == status


def test_no_address_leads_out_of_a_scene(client):
    scene = client.made("a.jpg")
    for path in ("..%2F..%2Fscene.json", "..%2F..%2Finput%2Fa.jpg", "a.png"):
        for kind in ("thumbnail", "photograph", "mask"):
            assert client.ask("GET", f"/{kind}/{scene}/{path}")[0] == 404
    assert [
        client.ask("GET", f"/{each}")[0] for each in (f"thumbnail/{scene}/a.jpg.00.jpg", f"photograph/{scene}/a.jpg")
    ] == [200, 200]


def test_uploads_come_in_parts_under_names_of_their_own(client, started):
    scene = client.post("/scenes")["id"]
    content = jpeg((300, 200))
    first, second = content[:1000], content[1000:]
    assert client.upload(scene, "..%2F..%2FIMG%201.jpg", first, total=len(content)) == {"name": None}
    assert "a part was lost" in client.upload(scene, "IMG%201.jpg", second, total=len(content), offset=5)["error"]
    sent = {"total": len(content), "offset": len(first)}
    assert client.upload(scene, "..%2F..%2FIMG%201.jpg", second, **sent) == {"name": "IMG-1.jpg"}
    assert client.upload(scene, "img-1.jpg", content) == {"name": "img-1-2.jpg"}
    library = started.application.actions.library
    kept = {path.name: path.read_bytes() for path in library.inputs(scene)}
    assert kept == dict.fromkeys(["IMG-1.jpg", "img-1-2.jpg"], content)
    assert not list(library.uploads(scene).iterdir())
    client.post(f"/scenes/{scene}/remove", {"name": "IMG-1.jpg"})
    (library.thumbnails(scene) / ".partial-half.jpg").write_bytes(content[:1000])
    assert client.scene(scene)["thumbnails"] == ["img-1-2.jpg.00.jpg"]


@pytest.mark.parametrize(
    ("name", "content", "changes", "error"),
    [
        ("notes.txt", b"text", {}, "notes.txt is not a photograph, film or splat"),
        ("notes.jpg", b"text", {}, "notes.jpg"),
        ("cut.jpg", jpeg((800, 600))[:3000], {}, "cut.jpg"),
        ("a.jpg", b"", {}, "from 1 to"),
        ("a.jpg", jpeg(), {"total": 1 << 40}, "from 1 to"),
        ("a.jpg", jpeg(), {"total": 10}, "larger than was announced"),
        ("a.jpg", jpeg(), {"total": "many"}, "without a size"),
        ("a.jpg", jpeg(), {"upload": "../x"}, "without a name"),
        ("a.ply", b"ply", {}, "a scene is made of photographs, or one film, or one splat"),
        ("film.mp4", b"text", {}, "film.mp4 is not a video"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_and_leaves_nothing(client, started, name, content, changes, error):
    kept = [] if name == "film.mp4" else ["good.jpg"]
    scene = client.made(*kept)
    answer = client.upload(scene, name, content, **changes)
    assert error in answer["error"] and "\n" not in answer["error"] and "uploads" not in answer["error"]
    library = started.application.actions.library
    assert [path.name for path in library.inputs(scene)] == kept and not any(library.uploads(scene).glob("*"))


def test_the_server_closes_while_an_answer_ends(tmp_path, monkeypatch):
    """A worker that ends an answer wakes the server's thread, which may close before the closer's own call returns."""
    server = StartServer(tmp_path / "kept", 0, pretended(tmp_path))
    listening, trigger = server._server.socket, server._server.trigger
    pull = trigger._physical_pull

    def by_a_worker_first() -> None:
        pull()
        server._thread.join(timeout=2)
        pull()

    monkeypatch.setattr(trigger, "_physical_pull", by_a_worker_first)
    server.__exit__()
    assert not server._thread.is_alive() and not trigger._fds and listening.fileno() == -1


def run(client, scene, text):
    return client.post(f"/scenes/{scene}/run", {"texts": [text]})


def state_of(client, scene, *states):
    return until(lambda: (found := client.scene(scene))["state"] in states and found)


def test_runs_wait_for_each_other_are_cancelled_and_leave_nothing_half_written(client, started, tmp_path):
    first, second, third = (client.made("a.jpg") for _ in range(3))
    assert [run(client, scene, "wait") for scene in (first, second, third)] == [{}] * 3
    assert state_of(client, first, "running") and client.scene(third)["before"] == 2
    until(lambda: client.scene(first)["progress"]["sentence"].startswith("Building the scene: step 1 of 4"))
    assert run(client, first, "again") == {} and client.scene(first)["settings"]["texts"] == ["wait"]
    library = started.application.actions.library
    assert (library.run(first, 1) / "half").is_file()
    client.post(f"/scenes/{first}/cancel")
    client.post(f"/scenes/{third}/cancel")
    assert client.scene(first)["state"] == client.scene(third)["state"] == "cancelled"
    assert not library.run(first, 1).exists()
    assert state_of(client, second, "running")
    (tmp_path / "go").touch()
    result = state_of(client, second, "done")["result"]
    assert result["styles"] == ["wait"] and result["left_out"] == []
    assert client.ask("GET", f"/page/{second}/1") == (200, b"<h1>a scene</h1>")
    # A further run replaces the results when it has succeeded, and not before.
    assert run(client, second, "fail") == {}
    failed = state_of(client, second, "failed")
    assert failed["reasons"] == ["first reason", "second reason"] and failed["result"]["number"] == 1
    assert failed["without_cameras"] == "reconstruction=feedforward poses=predicted"
    assert run(client, second, "better") == {}
    until(lambda: client.scene(second)["result"]["number"] == 3 and not library.run(second, 1).exists())
    client.post(f"/scenes/{second}/rename", {"title": " My  </script> scene "})
    assert client.scene(second)["title"] == "My </script> scene"
    client.post(f"/scenes/{second}/delete")
    assert client.scene(second) is None and sorted(library.scenes()) == sorted([first, third])


def test_what_ran_when_the_program_ended_is_interrupted_and_goes_on_when_asked(tmp_path):
    with StartServer(tmp_path / "kept", 0, pretended(tmp_path)) as server:
        client = Client(server)
        scene, empty = client.made("a.jpg"), client.post("/scenes")["id"]
        run(client, scene, "wait")
        state_of(client, scene, "running")
        with pytest.raises(UserError, match="another start page keeps its scenes in"):
            StartServer(tmp_path / "kept", 0)
    assert Library(tmp_path / "kept")[scene].job.state == "interrupted"
    (tmp_path / "go").touch()
    with StartServer(tmp_path / "kept", 0, pretended(tmp_path)) as server:
        client = Client(server)
        assert client.scene(empty) is None
        run(client, scene, "wait")
        assert state_of(client, scene, "done")["thumbnails"] == ["a.jpg.00.jpg"]


def mask(white, size=(32, 24)):
    """A mask whose left half is white, or all of it."""
    picture, data = Image.new("L", size, 255 * (white == "all")), BytesIO()
    picture.paste(255, (0, 0, size[0] // 2, size[1]))
    picture.save(data, "PNG")
    return data.getvalue()


def test_masks_are_kept_by_the_names_of_photographs_and_the_run_reads_them(client, started, tmp_path):
    scene, library = client.made("IMG%201.jpg", "b.jpg", "c.jpg", "d.jpg"), started.application.actions.library

    def send(name, content):
        return client.post(f"/scenes/{scene}/masks?name={name}", content)

    named = [("IMG%201.png", "IMG-1.jpg"), ("B.JPG.png", "b.jpg"), ("c.jpg", "c.jpg"), ("d.png", "d.jpg")]
    assert [send(name, mask("half"))["name"] for name, _ in named] == [photograph for _, photograph in named]
    assert send("d.jpg", mask("all")) == {"name": "d.jpg"}  # nothing is marked any more
    refusals = {
        ("e.png", mask("half")): "e.png is named like none of the photographs",
        ("b.png", mask("half", (90, 24))): "the mask b.png has 90x24 pixels, and b.jpg 64x48",
        ("b.png", b"text"): "b.png",
    }
    for (name, content), error in refusals.items():
        answer = send(name, content)["error"]
        assert error in answer and "\n" not in answer and "masks/" not in answer
    client.post(f"/scenes/{scene}/remove", {"name": "c.jpg"})
    folder = library.masks(scene)
    assert sorted(path.name for path in folder.iterdir()) == ["IMG-1.jpg.png", "b.jpg.png"]
    assert list(client.scene(scene)["masks"]) == ["b.jpg", "IMG-1.jpg"]
    assert client.ask("GET", f"/mask/{scene}/b.jpg")[1] == (folder / "b.jpg.png").read_bytes()
    client.post(f"/scenes/{scene}/run", {"texts": ["wait"], "masked": "empty"})
    state_of(client, scene, "running")
    assert "cancel that" in send("b.jpg", mask("half"))["error"]
    client.post(f"/scenes/{scene}/cancel")
    request = Request.from_args([*library[scene].job.words])
    assert request.views.masked == "empty"
    found = find_masks(Path(request.views.masks), library.inputs(scene))
    assert {path.name: file.name for path, file in found.items()} == {
        "IMG-1.jpg": "IMG-1.jpg.png",
        "b.jpg": "b.jpg.png",
    }
    levels = np.asarray(Image.open(found[library.inputs(scene)[0]]))
    assert (levels[:, :16] == 255).all() and (levels[:, 16:] == 0).all()
    client.post(f"/scenes/{scene}/unmask")
    assert client.scene(scene)["masks"] == {}
    run(client, scene, "more")
    assert "--photo-masks" not in state_of(client, scene, "done")["result"]["command"]


def test_a_photograph_that_is_cut_out_is_named(client):
    scene, data = client.made("a.jpg"), BytesIO()
    Image.new("RGBA", (64, 48), (200, 0, 0, 0)).save(data, "PNG")
    client.upload(scene, "b.png", data.getvalue())
    assert client.scene(scene)["transparent"] == ["b.png"]


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        ({"texts": []}, "no style is given"),
        ({"more": "backbone.dept=3"}, "Did you mean"),
        ({"more": "--strength 2"}, "strength is 2.0"),
        ({"more": "--out elsewhere"}, "--out has no place here"),
        ({"more": "hydra.run.dir=/"}, "for the command line only"),
        ({"more": "--multirun a=1,2"}, "for the command line only"),
        ({"more": "elsewhere/"}, "'elsewhere/' is not an option"),
        ({"more": "--text 'open"}, "quotation mark is not closed"),
        ({"more": "video.frames=0"}, "video.frames=0"),
        ({"method": "brsh"}, "Did you mean 'brush'"),
        ({"mix": 0.5}, "--mix needs exactly two styles"),
        ({"images": ["../secret.png"]}, "there is no picture"),
        ({"images": ["example:nothing"]}, "no example is named"),
    ],
)
def test_the_form_is_checked_as_the_command_line_is(settings, error, photographs, tmp_path):
    with pytest.raises(UserError) as raised:
        command_words(Settings(**{"texts": ("red dots",)} | settings), "photographs", str(photographs), tmp_path)
    assert error in str(raised.value) and "\n" not in str(raised.value)


def test_the_command_line_that_is_shown_has_the_words_of_the_run(photographs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my photos").symlink_to(photographs)
    texts = ('it\'s "red"; $(dots)', "--blue")
    settings = Settings(texts, mix=0.25, preserve_color=0.5, method="brush", more="views.take=4 poses=known")
    words = command_words(settings, "photographs", "my photos/", tmp_path)
    assert shlex.split(shown_command(words, "A room")) == ["anystyle", "stylize", *words, "--out", "styled-A-room"]
    assert words[:4] == ["my photos/", "--text", texts[0], f"--text={texts[1]}"]
    assert words[4:] == ["--mix", "0.25", "--preserve-color", "0.5", "method=brush", "views.take=4", "poses=known"]


LINES = """\
load the model …
read the photographs …
10 of 12 photographs have no mask in /a/folder and count whole: 03.jpg
cameras of 12 photographs …
cameras features: 6 of 12 …
cameras matches: 40 of 66 …
cameras mapping: 2 of 13 …
11 shares nothing with any other photograph and was left out
fit step 200 of 500: 19.0 dB on views held out, 12 s left …
restyle 1/2: “1/9 dots” …
write scene, renders and video …
Traceback (most recent call last):
  File "somewhere"
anystyle: error: the disk is full
"""


def test_lines_become_sentences_and_a_fraction_that_grows():
    states = [State()]
    for line in LINES.splitlines():
        states.append(follow(states[-1], line, "photographs"))
        assert states[-2].done <= states[-1].done <= 1 and states[-1].sentence.endswith(".")
    sentences = list(dict.fromkeys(state.sentence for state in states))
    assert sentences[3:7] == [
        "Finding the cameras of 12 photographs.",
        "Finding where each photograph was taken: looking for points to recognise in photograph 6 of 12.",
        "Finding where each photograph was taken: comparing photographs, 40 of 66 pairs.",
        "Finding where each photograph was taken: placing photographs, 2 of 13.",
    ]
    assert "Building the scene: step 200 of 500, about 12 seconds left." in sentences
    assert "Painting style 1 of 2: “1/9 dots”." in sentences and states[-1].error == "the disk is full"
    assert states[-1].notes == ("11 shares nothing with any other photograph and was left out",)
    json.dumps([state.__dict__ for state in states])
