"""The page on data sets: its training example runs, on a set on disk and the processor, and learns."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from synfog_usd.dataset.sets import index, layout

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "datasets.md").read_text(encoding="utf-8")
SCENES = 60
AIR, T = 0.7, 0.5


def shown(pixels):
    return Image.fromarray(np.rint(255.0 * pixels).astype(np.uint8))


def test_the_training_example_learns_to_see_through_fog(tmp_path, monkeypatch):
    """Flat fog J t + A (1 - t) over pictures of chance: after one pass of the page's loop a picture that was not in it
    is nearer to its clear one than with the fog left on.
    """
    torch = pytest.importorskip("torch", reason="torch is not installed")
    pytest.importorskip("pyarrow")
    rng, rows = np.random.default_rng(1), []
    for scene in range(SCENES):
        clear = rng.random((3, 4, 3)).repeat(4, axis=0).repeat(4, axis=1)
        for fog, mor_m, pixels in (("clear", None, clear), ("mor150", 150.0, T * clear + AIR * (1.0 - T))):
            unit = layout.unit_folder(scene, "sky")
            shot = f"{unit}/{fog}"
            named = {"scene": scene, "split": "test" if scene == 0 else "train", "source": "rural", "seed": scene}
            named |= {"lighting": "sky", "camera": "", "fog": fog, "mor_m": mor_m, "pipeline": "synfog"}
            named |= {"width_px": 16, "height_px": 12, "bake": unit, "shot": shot, "developed": shot}
            rows.append({**named, "outputs": ["srgb.png"]})
            folder = tmp_path / "out" / "mini" / shot
            folder.mkdir(parents=True)
            shown(pixels).save(folder / "srgb.png")
    index.write_part(tmp_path / "out" / "mini", 0, rows)
    (block,) = [code for code in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL) if "import torch" in code]
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(0)
    found = {}
    exec(compile(block, "datasets.md", "exec", dont_inherit=True), found)
    assert len(found["pairs"]) == SCENES - 1
    unseen = tmp_path / "out" / "mini" / layout.unit_folder(0, "sky")
    foggy, sharp = (found["picture"](unseen / fog / "srgb.png")[None] for fog in ("mor150", "clear"))
    with torch.no_grad():
        cleared = foggy + found["model"](foggy)
    assert torch.nn.functional.l1_loss(cleared, sharp) < 0.95 * torch.nn.functional.l1_loss(foggy, sharp)
