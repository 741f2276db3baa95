"""The table of paths of binary layers: sound ones are let through, and damage is told before USD walks in it."""

import struct
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from synfog_usd.base.errors import StageError
from synfog_usd.stage import crate, open_stage

REPOSITORY = Path(__file__).resolve().parents[2]
FOLDERS = [REPOSITORY / "assets", REPOSITORY.parent / "shared" / "usd"]


def packed(numbers):
    """Whole numbers as USD packs them, each difference in as few bytes as it needs."""
    differences = np.diff(np.asarray(numbers, np.int64), prepend=0)
    differences = (differences + 2**31) % 2**32 - 2**31
    values, often = np.unique(differences, return_counts=True)
    common = int(values[often.argmax()])
    codes, follow = np.zeros(-(-len(numbers) // 4) * 4, np.uint8), b""
    for row, difference in enumerate(map(int, differences)):
        if difference != common:
            codes[row] = 1 if -(2**7) <= difference < 2**7 else 2 if -(2**15) <= difference < 2**15 else 3
            follow += difference.to_bytes((0, 1, 2, 4)[codes[row]], "little", signed=True)
    bits = (codes.reshape(-1, 4) << np.array([0, 2, 4, 6])).sum(axis=1).astype(np.uint8)
    raw = struct.pack("<i", common) + bits.tobytes() + follow
    return b"\0" + imagecodecs.lz4_encode(raw, header=False)


@pytest.mark.parametrize("at_once", [8, 1 << 20])
@pytest.mark.parametrize("count", [1, 4, 7, 1000])
def test_packed_numbers_are_unpacked_as_they_were(monkeypatch, at_once, count):
    """Of all widths, over both ends of int32, and in more than one go."""
    monkeypatch.setattr(crate, "_AT_ONCE", at_once)
    draws = np.random.default_rng(count)
    numbers = draws.integers(-(2**31), 2**31, count)
    for width in (1, 100, 30_000):
        some = draws.random(count) < 0.3
        numbers[some] = draws.integers(-width, width, int(some.sum()))
    np.testing.assert_array_equal(crate._integers(packed(numbers), count), numbers)


def written(path):
    """A stage whose rows have children, siblings, both and neither; its paths."""
    stage = Usd.Stage.CreateNew(str(path))
    for n in range(30):
        mesh = UsdGeom.Mesh.Define(stage, f"/World/Row{n % 5}/Mesh{n}")
        mesh.CreatePointsAttr([(n, 0, 0)])
        UsdGeom.XformCommonAPI(mesh).SetTranslate((n, 0, 0))
    stage.Save()
    return paths_of(path)


def paths_of(path):
    found = []
    Sdf.Layer.FindOrOpen(str(path)).Traverse("/", lambda one: found.append(str(one)))
    return sorted(found)


def changed(path, to, change):
    """Write the file with its table of paths put through `change(numbers, elements, jumps)`, behind all else."""
    data = bytearray(path.read_bytes())
    at = crate._sections(data)[b"PATHS"]
    paths, rows = struct.unpack_from("<QQ", data, at)
    columns, place = [], at + 16
    for _ in range(3):
        (size,) = struct.unpack_from("<Q", data, place)
        columns.append(crate._integers(bytes(data[place + 8 : place + 8 + size]), rows))
        place += 8 + size
    change(*columns)
    table = struct.pack("<QQ", paths, rows)
    for column in columns:
        block = packed(column)
        table += struct.pack("<Q", len(block)) + block
    (contents,) = struct.unpack_from("<q", data, 16)
    entry = data.index(b"PATHS\0", contents)
    struct.pack_into("<qq", data, entry + 16, len(data), len(table))
    to.write_bytes(data + table)


def test_a_sound_table_of_paths_that_is_unpacked_and_packed_again_is_read_by_usd_as_before(tmp_path):
    """So what is unpacked here is what USD unpacks."""
    paths = written(tmp_path / "a.usdc")
    changed(tmp_path / "a.usdc", tmp_path / "b.usdc", lambda *columns: None)
    assert paths_of(tmp_path / "b.usdc") == paths and len(paths) > 100
    assert not list(crate.faults_of_paths(tmp_path / "b.usdc"))
    assert open_stage(tmp_path / "b.usdc")


def first_with_both(jumps):
    return int(np.argmax(jumps > 0))


def endless(_numbers, _elements, jumps):
    jumps[-1] = 1  # and on behind the last row


def shorter(_numbers, _elements, jumps):
    jumps[first_with_both(jumps)] -= 1


def longer(_numbers, _elements, jumps):
    jumps[first_with_both(jumps)] += 1


def far(_numbers, _elements, jumps):
    jumps[first_with_both(jumps)] = 2**31 - 1


def unclosed(_numbers, _elements, jumps):
    jumps[-1] = -1


def unknown(_numbers, _elements, jumps):
    jumps[5] = -3


def ended(_numbers, _elements, jumps):
    jumps[0] = -2


def twice(numbers, _elements, _jumps):
    numbers[3] = numbers[7]


def missing(numbers, _elements, _jumps):
    numbers[3] = len(numbers)


def negative(numbers, _elements, _jumps):
    numbers[3] = -1


def wordless(_numbers, elements, _jumps):
    elements[4] = -(2**31)


@pytest.mark.parametrize(
    "change, told",
    [
        *((change, "is no tree") for change in (endless, shorter, longer, far, unclosed, unknown, ended)),
        (twice, "numbers a path twice"),
        (missing, "numbers a path that is not there"),
        (negative, "numbers a path that is not there"),
        (wordless, "names a word that is not there"),
    ],
)
def test_a_damaged_table_of_paths_is_one_line(tmp_path, change, told):
    """One wrong byte among the jumps took USD 20 s and 8 GB, and no error of its own."""
    written(tmp_path / "a.usdc")
    changed(tmp_path / "a.usdc", tmp_path / "b.usdc", change)
    with pytest.raises(StageError, match=rf"b\.usdc: its table of paths {told}; the file is damaged"):
        open_stage(tmp_path / "b.usdc")


def test_a_table_of_paths_that_cannot_be_unpacked_is_one_line(tmp_path):
    written(tmp_path / "a.usdc")
    data = bytearray((tmp_path / "a.usdc").read_bytes())
    data[crate._sections(data)[b"PATHS"] + 16 + 8 + 1] ^= 0xF0  # how many bytes LZ4 copies first
    (tmp_path / "b.usdc").write_bytes(data)
    with pytest.raises(StageError, match=r"b\.usdc: its table of paths cannot be unpacked"):
        open_stage(tmp_path / "b.usdc")


def test_a_later_version_is_left_to_usd(tmp_path):
    written(tmp_path / "a.usdc")
    changed(tmp_path / "a.usdc", tmp_path / "b.usdc", ended)
    data = bytearray((tmp_path / "b.usdc").read_bytes())
    data[9] = 99
    (tmp_path / "b.usdc").write_bytes(data)
    assert not list(crate.faults_of_paths(tmp_path / "b.usdc"))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_no_sound_file_has_a_fault(folder):
    """What ships, and files of other people's programs where they are at hand."""
    files = [*folder.rglob("*.usdc"), *folder.rglob("*.usdz"), *folder.rglob("*.usd")]
    if not files:
        pytest.skip(f"no binary layers in {folder.name}")
    assert not {file.name: found for file in files if (found := list(crate.faults_of_paths(file)))}
