"""The index of a set: what is written is read again, by us and by any reader of Parquet."""

import pytest

from synfog_usd.base.errors import OutputError
from synfog_usd.dataset.sets import index, layout

pytest.importorskip("pyarrow")


def row(scene, pipeline="synfog", **more):
    bake = layout.unit_folder(scene, "sky")
    shot = f"{bake}/mor600"
    named = {"scene": scene, "split": "train", "source": "residential", "seed": 2**32 - 1 - scene, "lighting": "sky"}
    named |= {"camera": "", "fog": "mor600", "mor_m": 600.0, "pipeline": pipeline, "width_px": 320, "height_px": 180}
    return named | {"bake": bake, "shot": shot, "developed": shot, "outputs": ["raw.dng", "srgb.png"]} | more


def test_rows_come_back_in_order_with_the_paths_of_their_files(tmp_path):
    """Radiance, labels and outputs of a picture are named relative to the set, and found below it."""
    index.write_part(tmp_path, 0, [row(0), row(0, "raw", developed="scenes/000/000000/sky/mor600/raw"), row(17)])
    index.write_part(tmp_path, 1, [row(1000, fog="clear", mor_m=None)])
    found = list(index.pictures(tmp_path))
    assert [(one.scene, one.pipeline) for one in found] == [(0, "synfog"), (0, "raw"), (17, "synfog"), (1000, "synfog")]
    folder = tmp_path / "scenes/000/000000/sky"
    assert found[0].files["srgb.png"] == folder / "mor600/srgb.png"
    assert found[1].files["srgb.png"] == folder / "mor600/raw/srgb.png"
    assert found[0].files["radiance.exr"] == found[1].files["radiance.exr"] == folder / "mor600/radiance.exr"
    assert found[0].files["labels.json"] == found[0].bake / "labels.json" == folder / "labels.json"
    assert found[0].seed == 2**32 - 1 and found[0].mor_m == 600.0 and found[3].mor_m is None


def test_the_index_is_plain_parquet(tmp_path):
    """Another reader sees the same columns and values."""
    import pyarrow.dataset

    index.write_part(tmp_path, 0, [row(3)])
    table = pyarrow.dataset.dataset(tmp_path / "index").to_table().to_pylist()
    assert table == [row(3)] and set(table[0]) == set(index.COLUMNS)


def test_the_same_rows_are_the_same_bytes(tmp_path):
    for folder in ("one", "two"):
        index.write_part(tmp_path / folder, 0, [row(number) for number in range(50)])
    one, two = (layout.part_path(tmp_path / folder, 0).read_bytes() for folder in ("one", "two"))
    assert one == two


def test_a_damaged_part_is_one_line(tmp_path):
    index.write_part(tmp_path, 0, [row(3)])
    layout.part_path(tmp_path, 0).write_bytes(b"PAR1 nothing PAR1")
    with pytest.raises(OutputError, match=r"part-00000.parquet: cannot be read as part of an index"):
        list(index.pictures(tmp_path))


@pytest.mark.parametrize("number, folder", [(0, "000/000000"), (17, "000/000017"), (123_456, "123/123456")])
def test_no_folder_has_more_than_a_thousand_scenes(number, folder):
    """And a view of a rig's camera has a folder of its own beside the stage's own camera."""
    assert layout.unit_folder(number, "sky") == f"scenes/{folder}/sky"
    assert layout.unit_folder(number, "sky", "/World/Rig/Left") == f"scenes/{folder}/sky-Left"
