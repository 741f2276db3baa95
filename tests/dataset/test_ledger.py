"""The manifest of a bake while it grows."""

import json

import pytest

from synfog_usd.base import files
from synfog_usd.dataset import ledger
from synfog_usd.dataset.plan import Shot


def baked(out, size, shots, names=("radiance.exr", "srgb.png")):
    """A bake that was made: (ledger, what it set aside)."""
    kept = ledger.Ledger(out, {"plan": {"size_px": size}}, ())
    moved = kept.set_aside(shots, names)
    for shot in shots:
        for name in names:
            files.write_bytes(out / shot.folder / name, f"{size} {shot.folder} {name}".encode())
        kept.add(shot, {"folder": shot.folder, "files": {n: files.sha256_of(out / shot.folder / n) for n in names}})
    files.write_bytes(out / "labels.exr", f"{size} labels".encode())
    kept.add_labels({"labels.exr": files.sha256_of(out / "labels.exr")})
    kept.finish(tuple(shots), {})
    return kept, moved


def there(out):
    return sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())


CLEAR, THICK = Shot("sky", "clear", "sky", "clear"), Shot("sky", "mor50", "sky", "mor50")


def test_shots_of_another_size_are_set_aside_with_their_labels(tmp_path):
    """What the second bake does not write over is a bake by itself then, hash by hash; a file of the user's stays."""
    baked(tmp_path, 64, [CLEAR, THICK])
    (tmp_path / "sky/mor50/mine.txt").write_text("mine")
    _, moved = baked(tmp_path, 32, [CLEAR])
    assert "sky/mor50 of an earlier bake" in moved and "earlier-1" in moved
    assert there(tmp_path) == [
        *("bake.json", "earlier-1/bake.json", "earlier-1/labels.exr"),
        *("earlier-1/sky/mor50/radiance.exr", "earlier-1/sky/mor50/srgb.png"),
        *("labels.exr", "sky/clear/radiance.exr", "sky/clear/srgb.png", "sky/mor50/mine.txt"),
    ]
    assert (tmp_path / "labels.exr").read_text() == "32 labels"
    assert (tmp_path / "earlier-1/labels.exr").read_text() == "64 labels"
    old = ledger.Ledger(tmp_path / "earlier-1", {"plan": {"size_px": 64}}, ())
    assert old.done(THICK) and not old.done(CLEAR) and old.labels_done()
    _, moved = baked(tmp_path, 16, [THICK])
    assert "sky/clear of an earlier bake" in moved and (tmp_path / "earlier-2/sky/clear/srgb.png").is_file()


def test_the_same_bake_moves_nothing_and_another_fog_of_it_stays_beside(tmp_path):
    """Its labels are those of the other fog too; what is written over is not kept."""
    baked(tmp_path, 64, [CLEAR])
    before = there(tmp_path)
    assert baked(tmp_path, 64, [CLEAR])[1] == "" and there(tmp_path) == before
    kept, moved = baked(tmp_path, 64, [THICK])
    assert moved == "" and kept.done(CLEAR)
    assert baked(tmp_path, 32, [CLEAR, THICK])[1] == "" and not (tmp_path / "earlier-1").exists()


def test_a_manifest_moves_no_file_that_lies_elsewhere(tmp_path):
    """Whatever it lists: by a path upwards, an absolute one, or a link."""
    out, other = tmp_path / "out", tmp_path / "other"
    baked(out, 64, [THICK])
    other.mkdir()
    (other / "a.txt").write_text("mine")
    (out / "link").symlink_to(other, target_is_directory=True)
    said = json.loads((out / ledger.MANIFEST).read_bytes())
    for folder in ("../other", str(other), "link"):
        said["shots"].append({"folder": folder, "files": {"a.txt": "0"}})
    files.write_json(out / ledger.MANIFEST, said)
    baked(out, 32, [CLEAR])
    assert (other / "a.txt").read_text() == "mine" and (out / "earlier-1/sky/mor50/srgb.png").is_file()


def test_moving_that_was_stopped_goes_on_in_the_same_folder(tmp_path, monkeypatch):
    """The manifest is written last, so what is moved half belongs to it."""
    baked(tmp_path, 64, [THICK])
    with monkeypatch.context() as patch:
        patch.setattr(files, "write_json", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            ledger.Ledger(tmp_path, {"plan": {"size_px": 32}}, ()).set_aside([CLEAR], ("srgb.png",))
    files.write_bytes(tmp_path / "sky/mor50/srgb.png", (tmp_path / "earlier-1/sky/mor50/srgb.png").read_bytes())
    baked(tmp_path, 32, [CLEAR])
    assert not (tmp_path / "earlier-2").exists() and (tmp_path / "earlier-1/bake.json").is_file()
    assert there(tmp_path / "sky") == ["clear/radiance.exr", "clear/srgb.png"]
