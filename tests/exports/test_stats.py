"""Figures of a bake, against counts made another way."""

import json

import pytest
from support.cli import run

from synfog_usd.dataset.exports import stats


def test_counts_are_those_of_the_labels(baked):
    """By class, fog, distance and share, counted from the label planes and files; three pictures share a scene."""
    figures = stats.gather(baked.folder)
    assert (figures.pictures, len(figures.scenes)) == (3, 1)
    seen = [row for row in baked.listed["instances"] if row["pixels"] and row["label"] in ("car", "person", "bus")]
    assert {name: sum(found.values()) for name, found in figures.objects.items()} == {
        name: 3 * sum(row["label"] == name for row in seen) for name in ("car", "person", "bus")
    }
    near = {row["id"] for row in seen if baked.seen.distance_m[baked.seen.instance_id == row["id"]].min() <= 20.0}
    counted = sum(sum(figures.distances[name].values()) for name in ("to 10 m", "to 20 m"))
    assert counted == 3 * len(near) > 0
    hidden = sum(row["pixels"] <= 0.2 * row["amodal_pixels"] for row in seen)
    assert sum(figures.shares["to 20%"].values()) == 3 * hidden > 0
    left = {row["id"]: row.get("visibility") for row in baked.left["mor50"]["instances"]}
    assert figures.fogs["mor50"]["invisible"] == sum(left[row["id"]] == "invisible" for row in seen) > 0
    assert figures.fog_m == {"clear": None, "mor150": 150.0, "mor50": 50.0}
    assert figures.a_picture(stats.HUMANS) == 3.0


def test_pixels_are_counted_by_class_once_for_all_fogs(baked):
    """As the rows of labels.json count; what is no instance is sky.  Shares are of the 19 classes that Cityscapes
    evaluates, and sum to 100.
    """
    figures = stats.gather(baked.folder)
    counted = {"sky": baked.seen.instance_id.size}
    for row in baked.listed["instances"]:
        counted[row["label"]] = counted.get(row["label"], 0) + row["pixels"]
        counted["sky"] -= row["pixels"]
    assert figures.pixels == {name: count for name, count in counted.items() if count}
    evaluated = [7, 8, 11, 12, 13, 17, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 31, 32, 33]
    told = sum(row["pixels"] for row in baked.listed["instances"] if row["semantic_id"] in evaluated) + counted["sky"]
    assert figures.share("car") == pytest.approx(100.0 * counted["car"] / told)
    assert sum(figures.metadata()["pixels_percent"].values()) == pytest.approx(100.0, abs=0.02)
    weights = {"road": 3.063728571, "building": 4.949110508, "vegetation": 7.091544151, "sky": 28.106302261,
               "car": 16.149547577, "pole": 91.361610413, "traffic sign": 204.906326294}  # fmt: skip
    for name, weight in weights.items():  # inverse class frequencies that others train with
        assert stats.CITYSCAPES_PIXELS[name] == pytest.approx(100.0 / weight, rel=0.06), name


def test_bytes_are_counted_once(baked):
    """Labels are of all three pictures; the sum is that of the folder."""
    figures = stats.gather(baked.folder)
    assert sum(figures.bytes.values()) == sum(path.stat().st_size for path in baked.folder.rglob("*") if path.is_file())


def test_the_verb_prints_tables_or_json(baked):
    """Every row of a table has a cell for each of its heads."""
    done = run("dataset", "stats", baked.folder)
    assert done.returncode == 0, done.stderr
    tables = [[line.split(" | ") for line in table.splitlines()] for table in done.stdout.strip().split("\n\n")]
    assert len(tables) == 7 and all(len({len(row) for row in table}) == 1 for table in tables)
    assert " nan " not in done.stdout
    assert json.loads(run("dataset", "stats", baked.folder, "--json").stdout)["pictures"] == 3
