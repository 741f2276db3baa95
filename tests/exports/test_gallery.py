"""The gallery as a browser shows it: opened from disk, clicked, typed at, narrow, and with ten thousand pictures."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image as Picture
from support.browser import Tab, chromium

from synfog_usd import camera
from synfog_usd.base import files, resources
from synfog_usd.camera import writers
from synfog_usd.dataset.exports import gallery
from synfog_usd.dataset.exports.folder import ExportFolder

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")]


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def shown(baked, tmp_path_factory):
    """(gallery, set): the street with RAW files, and its gallery in a folder beside it with a blank in its name."""
    folder = tmp_path_factory.mktemp("gallery")
    out = folder / "set of one"
    shutil.copytree(baked.folder, out)
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    manifest = json.loads((out / "bake.json").read_text())
    radiance = {row["fog"]: writers.read_exr(out / "sky" / row["fog"] / "radiance.exr") for row in manifest["shots"]}
    exposure = camera.metered(graph, {"radiance": radiance["clear"]})
    for row in manifest["shots"]:
        place = out / "sky" / row["fog"]
        node = graph.outputs["raw.dng"]
        made = camera.develop(graph, {"radiance": radiance[row["fog"]]}, seed=1, exposure=exposure, keep=[node])
        writers.write_output("raw.dng", made[node], place, options=graph.options_of("raw.dng"))
        row["files"]["raw.dng"] = files.sha256_of(place / "raw.dng")
    files.write_json(out / "bake.json", manifest)
    gallery.build(out, folder / "a gallery")
    return folder / "a gallery", out


def count(page):
    return page.locator("#count").inner_text()


def test_the_grid_filters_by_each_key_and_says_how_many(shown, browser):
    with Tab(browser, shown[0] / "index.html") as page:
        assert count(page) == "3 of 3 pictures" and page.locator(".card").count() == 3
        page.select_option("#filter-fog", label="mor150")
        assert count(page) == "1 of 3 pictures" and "fog=mor150" in page.url
        page.select_option("#filter-fog", label="all")
        page.select_option("#filter-class", label="bus")
        assert count(page) == "3 of 3 pictures"
        images = page.evaluate("[...document.querySelectorAll('.card img')].map((i) => i.complete && i.naturalWidth)")
        assert images == [192, 192, 192]


def opened(page, fog):
    page.locator(".card", has_text=fog).first.click()
    page.wait_for_selector("body[data-ready]")


def at_pixel(page, x, y, size=(192, 108)):
    """Point at the middle of a pixel and read what the page says."""
    area = page.locator("#marks").bounding_box()
    page.mouse.move(area["x"] + (x + 0.5) / size[0] * area["width"], area["y"] + (y + 0.5) / size[1] * area["height"])
    return page.locator("#pointer").inner_text()


def test_the_pointer_reads_depth_transmittance_and_raw(shown, baked, browser):
    """At a car, the sky and the ground: the numbers of labels.exr, layers.exr and raw.dng."""
    with Tab(browser, shown[0] / "index.html") as page:
        opened(page, "mor150")
        seen, raw = baked.seen, writers.read_raw(shown[1] / "sky" / "mor150" / "raw.dng").pixels[..., 0]
        cars = [row for row in baked.listed["instances"] if row["label"] == "car" and row["pixels"]]
        y, x = np.argwhere(seen.instance_id == cars[0]["id"])[0]
        for column, row in ((x, y), (96, 3), (30, 100)):
            told = at_pixel(page, column, row)
            depth = seen.depth_m[row, column]
            assert f"x {column} y {row} " in told
            assert ("planar depth sky" in told) == (not np.isfinite(depth))
            if np.isfinite(depth):
                assert abs(float(told.split("planar depth ")[1].split(" m")[0]) - depth) < 0.02
                clear = np.exp(np.log(0.05) / 150.0 * seen.distance_m[row, column])
                assert abs(float(told.split(" T ")[1].split()[0]) - clear) < 0.005 * clear + 1e-4
            block = raw[row // 2 * 2 : row // 2 * 2 + 2, column // 2 * 2 : column // 2 * 2 + 2].ravel()
            assert " ".join(str(int(value)) for value in np.rint(block)) in told
        assert cars[0]["path"] in at_pixel(page, x, y)


def test_nothing_that_a_set_says_becomes_a_script(tmp_path, browser):
    """Names are shown as they are."""
    evil = "</script><script>window.hurt = 1</script><img src=x onerror='window.hurt = 1'>"
    row = {name: evil for name in gallery.OF_TEXT} | {"name": evil, "scene": 0, "mor_m": None, "classes": [], "view": 0}
    folder = ExportFolder(tmp_path)
    gallery.write_index(folder, [row, {**row, "fog": "clear"}], title=evil)
    for name in gallery.PAGE:
        shutil.copyfile(gallery.__file__.replace("gallery.py", f"page/{name}"), tmp_path / name)
    (tmp_path / "thumbs" / "000").mkdir(parents=True)
    for number in (0, 1):
        Picture.new("RGB", (16, 9)).save(tmp_path / "thumbs" / "000" / f"{number}.jpg")
    with Tab(browser, tmp_path / "index.html") as page:
        assert page.locator("#title").inner_text() == evil
        assert page.evaluate("window.hurt") is None
