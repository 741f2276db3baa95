"""Exports, gallery and figures of a set: two scenes in two splits, found through its index."""

import csv
import json
import shutil

import numpy as np
import pytest
from PIL import Image as Picture

from synfog_usd.base import files
from synfog_usd.dataset.exports import gallery, stats
from synfog_usd.dataset.exports.record import EXPORTERS, exporter
from synfog_usd.dataset.exports.run import export

pytest.importorskip("pyarrow", reason="pyarrow is not installed")


@pytest.fixture(scope="module")
def out(baked, tmp_path_factory):
    """Scene 0 for training and scene 1001 for testing, in two pipelines each."""
    from synfog_usd.dataset.sets import index, layout

    folder = tmp_path_factory.mktemp("set") / "two"
    manifest = json.loads((baked.folder / "bake.json").read_text())
    for number, split in ((0, "train"), (1001, "test")):
        unit = layout.unit_folder(number, "sky")
        shutil.copytree(baked.folder, folder / unit)
        rows = []
        for shot in manifest["shots"]:
            place = f"{unit}/sky/{shot['fog']}"
            (folder / place / "noise_free").mkdir()
            shutil.copyfile(folder / place / "srgb.png", folder / place / "noise_free" / "srgb.png")
            for pipeline, developed in (("synfog", place), ("noise_free", f"{place}/noise_free")):
                rows.append(
                    {
                        "scene": number,
                        "split": split,
                        "source": "rural",
                        "seed": 7 + number,
                        "lighting": "sky",
                        "camera": "",
                        "fog": shot["fog"],
                        "mor_m": shot["mor_m"],
                        "pipeline": pipeline,
                        "width_px": 192,
                        "height_px": 108,
                        "bake": unit,
                        "shot": place,
                        "developed": developed,
                        "outputs": ["srgb.png"],
                    }
                )
        index.write_part(folder, number // layout.A_FOLDER, rows)
    return folder


@pytest.mark.parametrize("name", [name for name, one in EXPORTERS.items() if not one.clips])
def test_splits_stay_apart_in_every_format(out, tmp_path, name):
    """Nothing of the test scene lies under train, nor the other way round."""
    census = export(out, exporter(name), tmp_path / name)
    assert census.splits == {"train": 6, "test": 6} and census.scenes == {"train": {0}, "test": {1001}}
    rows = list(csv.DictReader((tmp_path / name / "pictures.csv").read_text().splitlines()))
    assert {(row["scene"], row["split"]) for row in rows} == {("0", "train"), ("1001", "test")}
    for path in (tmp_path / name).rglob("*"):
        parts = path.relative_to(tmp_path / name).as_posix()
        if "000000-sky" in parts:
            assert "/test" not in parts, parts
        if "001001" in parts:
            assert "/train" not in parts, parts


def test_ids_of_coco_are_unique_in_each_split(out, tmp_path):
    export(out, exporter("coco"), tmp_path)
    for split in ("train", "test"):
        found = json.loads((tmp_path / "annotations" / f"instances_{split}.json").read_text())
        for key in ("images", "annotations"):
            ids = [one["id"] for one in found[key]]
            assert ids == list(range(1, len(ids) + 1))
        assert {one["synfog"]["split"] for one in found["images"]} == {split}


def test_ultralytics_gets_training_and_validation(out, tmp_path):
    """Without a split of that name, the test split is what it validates with."""
    import yaml

    export(out, exporter("yolo"), tmp_path)
    data = yaml.safe_load((tmp_path / "data.yaml").read_text())
    assert (data["train"], data["val"], data["test"]) == ("images/train", "images/test", "images/test")


def test_the_gallery_has_a_row_for_each_picture_and_a_view_for_each_scene(out, tmp_path):
    assert gallery.build(out, tmp_path) == 12
    data = json.loads((tmp_path / "data" / "index.js").read_text().removeprefix("window.SYNFOG_INDEX = ")[:-2])
    assert len(data["rows"]) == 12 and sorted(data["words"]["split"]) == ["test", "train"]
    assert [row[2] for row in data["rows"]] == [0] * 6 + [1] * 6
    for number in range(12):
        with Picture.open(tmp_path / "thumbs" / "000" / f"{number}.jpg") as thumb:
            assert max(thumb.size) <= gallery.THUMB_PX
    assert np.sum([path.suffix == ".js" for path in (tmp_path / "data" / "views" / "000").iterdir()]) == 2


def test_radiance_that_pipelines_share_is_read_and_counted_once(out, baked):
    figures = stats.gather(out)
    assert (figures.pictures, len(figures.scenes)) == (12, 2)
    assert len(figures.luminance["sky", "clear"]) == 2
    single = stats.gather(baked.folder)
    assert figures.bytes["radiance.exr"] == 2 * single.bytes["radiance.exr"]
    assert figures.bytes["labels.exr"] == 2 * single.bytes["labels.exr"]
    assert files.sha256_of(out / "scenes/000/000000/sky/labels.exr") == files.sha256_of(baked.folder / "labels.exr")
