"""Inputs that once ended badly: a case of :mod:`fuzz.seeds`, a file of it, and what it held."""

import base64

_DEEP = 10_000
_BOMB = b"a: &a [x, x]\n" + b"".join(
    b"%c: &%c [*%c, *%c]\n" % (after, after, before, before)
    for before, after in zip(range(97, 119), range(98, 120), strict=True)
)

_VAST = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999, 17)}"
_CALLBACK = b"hydra:\n  callbacks:\n    x:\n      _target_: sympy.sympify\n      a: 1+1\n"
_ENDLESS = b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n"

KEPT: tuple[tuple[str, str, bytes], ...] = (
    ("transforms", "garden/transforms.json", b"null"),
    ("transforms", "garden/transforms.json", b"[" * _DEEP),
    ("transforms", "garden/transforms.json", b'{"w": 48, "h": 36, "fl_x": 0, "frames": []}'),
    ("transforms", "garden/transforms.json", b'{"w": 1e999, "h": 36, "fl_x": NaN, "frames": [3]}'),
    ("transforms", "garden/images/1.png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(x) = {} loop\n"),
    ("transforms", "garden/images/1.png", b"P6\n9999999 9999999\n255\n"),
    ("llff", "garden/poses_bounds.npy", _VAST),
    ("llff", "garden/poses_bounds.npy", b"PK\x03\x04"),
    ("colmap_binary", "garden/sparse/0/cameras.bin", b"\xff" * 64),
    ("colmap_text", "garden/sparse/0/images.txt", b"1 nan 0 0 0 0 0 0 1 a.png\n\n"),
    ("re10k", "train/index.json", b'{"../../x": "0.torch"}'),
    ("re10k", "train/index.json", b'{"clip": "../../0.torch"}'),
    ("re10k", "train/0.torch", b"\x80\x02."),
    ("re10k", "train/0.torch", b"\x80\x02cos\nsystem\nX\x01\x00\x00\x00x\x85R."),
    ("report", "sweep/0/metrics.json", b'{"psnr": 1e400, "n": [' + b"9" * 400 + b"]}"),
    ("report", "sweep/0/metrics.json", b"\xff\xfe{}"),
    ("report", "sweep/1/.hydra/overrides.yaml", _BOMB),
    ("report", "sweep/multirun.yaml", b"a: !!python/object/apply:os.system [x]"),
    ("configuration", "conf/model/mine.yaml", _CALLBACK),
    ("configuration", "conf/model/mine.yaml", b"hydra:\n  launcher:\n    _target_: os.system\n    command: x\n"),
    ("configuration", "conf/model/mine.yaml", _BOMB),
    ("answers_sqlite", "answers.sqlite", b"SQLite format 3\0" + b"\0" * 100),
    ("answers_csv", "answers.csv", b"participant,item,question,score\n\0,=1+1,style,1e999\n"),
    ("study", "study/study.json", b'{"id": "a", "items": {"a": null}}'),
    ("weights_tiny_branch_copy.safetensors", "tiny_branch_copy.safetensors", b"\xff" * 64),
    ("weights_net.pt", "net.pt", base64.b64decode("gAJ9cQAu")),
    ("plugins", "pyproject.toml", b"a = " + b"[" * _DEEP),
    ("splat_binary", "binary.ply", _ENDLESS),
    ("splat_compressed", "compressed.ply", b"ply\nformat binary_little_endian 1.0\nelement chunk 1\nend_header\n"),
    ("plan", "mine.yaml", b"participants: .inf\nquestions: [[[]]]\n"),
    ("state", "runs/test/bound.json", b"null"),
    ("state", "runs/test/last.ckpt", b"PK\x03\x04"),
)  # fmt: skip
