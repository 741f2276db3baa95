"""A small network that finds things, and its training on the pictures of a set.  torch is imported on first use.

For each cell of 2 x 2 pixels the network tells how likely the middle of a thing of each class lies there, and how far
the box's four sides are from the cell's middle.  The network is a U-Net of five levels on half the picture's size.
Cells are small because things are: half of the cars of a street at 320 x 180 are under 6 pixels wide.

It learns from squares, enlarged or made smaller, half of which are laid about a thing.

A thing is taught by a Gaussian over its box: cells near its middle learn its sides (generalised intersection over
union), and all cells learn the Gaussian (focal loss).  What no camera can see is not taught: cells in boxes of things
that fog makes invisible, or that are smaller than `LEAST_PX` pixels, count neither as things nor as background.

Source: Zhou, Wang and Kraehenbuehl, Objects as Points (2019); Liu et al., Training-Time-Friendly Network for Real-Time
Object Detection (2020); Rezatofighi et al., Generalized Intersection over Union (2019).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from docs.studies import command, networks
from docs.studies.training import shown
from synfog_usd.base import files, seeds
from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.base.progress import Progress, silent
from synfog_usd.cli.progress import shown as progress_bar
from synfog_usd.dataset.exports import taxonomy
from synfog_usd.lab.benchmark import detect
from synfog_usd.lab.benchmark.decode import GREY
from synfog_usd.lab.benchmark.detect import FoggedView

FOGS = ("all", "clear", "foggy")
WIDTHS = (24, 40, 64, 96, 128)
"""Channels of the levels; 0.9 million weights altogether."""

CELL_PX = 2
MULTIPLE = 32
"""Sides of what the network is given must be multiples of this [px]."""

SIDE_PX = 160
"""Of a square that is learned from."""

ZOOM = 0.6, 1.7
"""By how much it is enlarged; its logarithm is uniform."""

BATCH = 4
RATE = 1e-3
"""Adam's; it falls to 0 by a cosine."""

LEAST_PX = 12
"""Visible pixels; smaller things are not taught."""

SPREAD = 0.54 / 6.0
"""Standard deviation of a thing's Gaussian over its width and height (Liu et al. 2020)."""

NEAR = 0.5
"""Cells whose Gaussian is above it learn the sides."""

SIDES_WEIGHT = 5.0
"""Of the loss of sides, beside that of middles (Liu et al. 2020)."""

RARE = -4.6
"""Where the network begins: 1 % of the cells are middles (Lin et al., Focal Loss, 2017)."""

FOGS = ("all", "clear", "foggy")


@dataclass(frozen=True)
class TrainedFinder:
    """What came of a training.

    Attributes:
        model: torch's module; (1, 3, H, W) of 0 to 1 to (1, 4 + C, N), as YOLOv8 has it.
        classes: Cityscapes' labels, in its order; several of one class are joined by +.
        losses: by step.
    """

    model: Any
    classes: tuple[str, ...]
    losses: tuple[float, ...]


def views(
    source: Path, classes: Sequence[str], *, pipeline: str = "", fogs: str = "all", split: str = ""
) -> list[FoggedView]:
    """What is learned from.

    Args:
        source: folder of a set or of a bake.
        classes: Cityscapes' labels; several that are one class are joined by +.
        pipeline: whose pictures; all if left out.
        fogs: one of `FOGS`.
        split: of a set; all if left out.

    Raises:
        ParameterError: no such picture, or no such thing in them; a class that gets no boxes.
    """
    if fogs not in FOGS:
        raise ParameterError(f"--fogs {fogs}: takes {', '.join(FOGS)}")
    labels = [name for joined in classes for name in joined.split("+")]
    for name in labels:
        if name not in taxonomy.NAMES:
            near = did_you_mean(name, sorted(taxonomy.NAMES))
            raise ParameterError(f"--classes: {name!r} is no class of things.{near}")
        if labels.count(name) > 1:
            raise ParameterError(f"--classes: {name!r} stands in two classes; give it to one")
    found = [
        view
        for view in detect.find(source, split=split)
        if pipeline in ("", view.source.pipeline) and fogs in ("all", "clear" if view.source.clear else "foggy")
    ]
    if not found:
        words = f"no{'' if fogs == 'all' else ' ' + fogs} pictures by {pipeline!r}"
        raise ParameterError(f"{source}: {words}{f' in the split {split!r}' * bool(split)}")
    for name in classes:
        if not any(thing.label in name.split("+") and taught(thing) for view in found for thing in view.things):
            raise ParameterError(f"{source}: no {name} of {LEAST_PX} visible pixels in {len(found)} pictures")
    return found


def taught(thing: detect.LabelledThing, zoom: float = 1.0) -> bool:
    """Whether a camera can see it, and it is large enough, in a picture that is enlarged so much."""
    return thing.visibility != "invisible" and thing.pixels * zoom**2 >= LEAST_PX


def network(classes: int) -> Any:
    """The network, untrained; see the head of this module."""
    torch = networks.torch_library()
    nn = torch.nn

    def twice(planes: int, width: int) -> Any:
        layers = []
        for before in (planes, width):
            layers += [nn.Conv2d(before, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU()]
        return nn.Sequential(*layers)

    class FinderUNet(nn.Module):  # type: ignore[name-defined, misc]
        def __init__(self) -> None:
            super().__init__()
            self.fold = nn.PixelUnshuffle(2)
            planes = (12, *WIDTHS[:-1])
            self.down = nn.ModuleList([twice(*pair) for pair in zip(planes, WIDTHS, strict=True)])
            self.pool = nn.MaxPool2d(2)
            rising = list(itertools.pairwise(WIDTHS))[::-1]
            self.lift = nn.ModuleList([nn.ConvTranspose2d(below, width, 2, stride=2) for width, below in rising])
            self.up = nn.ModuleList([twice(width, width) for width, _ in rising])
            self.middles, self.sides = nn.Conv2d(WIDTHS[0], classes, 1), nn.Conv2d(WIDTHS[0], 4, 1)
            nn.init.constant_(self.middles.bias, RARE)

        def cells(self, picture: Any) -> tuple[Any, Any]:
            """(B, C, h, w) logits of middles; (B, 4, h, w) cells from a cell's middle to left, top, right, bottom."""
            levels = [self.down[0](self.fold(picture))]
            for block in self.down[1:]:
                levels.append(block(self.pool(levels[-1])))
            found = levels.pop()
            for number, level in enumerate(levels[::-1]):
                found = self.up[number](self.lift[number](found) + level)
            return self.middles(found), self.sides(found).clamp(-4.0, 6.0).exp()

        def forward(self, picture: Any) -> Any:
            return told(torch, *self.cells(picture))

    return FinderUNet()


def told(torch: Any, logits: Any, sides: Any) -> Any:
    """What `FinderUNet.cells` says of a picture as YOLOv8 has it, (B, 4 + C, N): boxes of all cells, and scores of
    those that are surer than their eight neighbours.
    """
    scores = logits.sigmoid()
    peak = torch.nn.functional.max_pool2d(scores, 3, stride=1, padding=1)
    scores = torch.where(scores >= peak, scores, torch.zeros_like(scores))
    x, y = middles_px(torch, logits)
    left, top, right, bottom = (CELL_PX * sides).unbind(1)
    boxes = [x + (right - left) / 2.0, y + (bottom - top) / 2.0, left + right, top + bottom]
    return torch.cat([torch.stack(boxes, 1), scores], 1).flatten(2)


def middles_px(torch: Any, cells: Any) -> tuple[Any, Any]:
    """x (1, w) and y (h, 1) of the middles of cells (B, planes, h, w) [px]."""
    high, wide = cells.shape[2:]
    x, y = (CELL_PX * (torch.arange(count, dtype=torch.float32) + 0.5) for count in (wide, high))
    return x[None, :], y[:, None]


def train(
    found: Sequence[FoggedView],
    classes: Sequence[str],
    *,
    seed: int = 0,
    steps: int = 8000,
    progress: Progress = silent,
) -> TrainedFinder:
    """Train on squares of pictures, enlarged, turned left to right and made brighter or darker at random.

    The same pictures, seed and steps give the same weights, on one machine with one number of threads.

    Args:
        found: from `views`.
        classes: as `views` has them, in the network's order.
        seed: of the first weights and of what is drawn.
        steps: batches of four squares.
        progress: whom to tell.

    Raises:
        ParameterError: torch is not installed.
    """
    torch = networks.torch_library()
    with networks.repeating(torch, seed):
        model = network(len(classes)).to(memory_format=torch.channels_last)  # a seventh faster
        optimiser = torch.optim.Adam(model.parameters(), lr=RATE)
        falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
        rng = seeds.stream(seed, "training")
        losses = []
        for step in range(steps):
            if step % 10 == 0:
                progress(f"step {step} of {steps}", step / steps)
            drawn = [_square(found[int(rng.integers(len(found)))], classes, rng) for _ in range(BATCH)]
            squares, *wanted = (torch.from_numpy(np.stack(part)) for part in zip(*drawn, strict=True))
            loss = _loss(torch, *model.cells(squares.contiguous(memory_format=torch.channels_last)), *wanted)
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 10.0)
            optimiser.step()
            falling.step()
            losses.append(loss.item())
    return TrainedFinder(model.eval(), tuple(classes), tuple(losses))


@functools.lru_cache(maxsize=1024)
def _pixels(path: Path) -> Any:
    """The picture, as Pillow has it."""
    from PIL import Image

    return Image.fromarray(np.rint(255.0 * shown(path)).astype(np.uint8).transpose(1, 2, 0))


def _square(
    view: FoggedView, classes: Sequence[str], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A square of a picture, and what is to be said of it; see `targets`."""
    from PIL import Image

    picture = _pixels(view.picture)
    places = {label: place for place, joined in enumerate(classes) for label in joined.split("+")}
    own = [thing for thing in view.things if thing.label in places]
    zoom = float(np.exp(rng.uniform(*np.log(ZOOM))))
    window = SIDE_PX / zoom  # in the picture's pixels
    corner = [rng.uniform(min(0.0, side - window), max(0.0, side - window)) for side in picture.size]
    near = [thing for thing in own if taught(thing, zoom)]
    if near and rng.random() < 0.5:
        box = near[int(rng.integers(len(near)))].box
        corner = [box[axis] + box[2 + axis] / 2.0 - window * rng.uniform(0.1, 0.9) for axis in (0, 1)]
        corner = [
            float(np.clip(low, min(0.0, side - window), max(0.0, side - window)))
            for low, side in zip(corner, picture.size, strict=True)
        ]
    seen = picture.transform(
        (SIDE_PX, SIDE_PX),
        Image.Transform.AFFINE,
        (1.0 / zoom, 0.0, corner[0], 0.0, 1.0 / zoom, corner[1]),
        Image.Resampling.BILINEAR,
        fillcolor=(GREY, GREY, GREY),
    )
    square = np.asarray(seen, dtype=np.float32).transpose(2, 0, 1) / np.float32(255.0)
    square = square * np.float32(rng.uniform(0.8, 1.2))
    rows = []
    for thing in own:
        left, top, width, height = (zoom * part for part in thing.box)
        left, top = left - zoom * corner[0], top - zoom * corner[1]
        rows.append((places[thing.label], taught(thing, zoom), left, top, width, height))
    if rng.random() < 0.5:
        square = square[:, :, ::-1]
        rows = [
            (kind, taken, SIDE_PX - left - width, top, width, height) for kind, taken, left, top, width, height in rows
        ]
    return square.clip(0.0, 1.0), *targets(rows, len(classes), SIDE_PX // CELL_PX)


def targets(
    rows: Sequence[tuple[int, bool, float, float, float, float]], classes: int, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What the network is to say of a square.

    Args:
        rows: class, whether it is taught, left, top, width and height [px] of each thing.
        classes: how many.
        count: cells along a side.

    Returns:
        (classes, count, count) Gaussians, 1 in the cell of a thing's middle, and -1 where nothing is taught;
        (4, count, count) left, top, right and bottom of the thing [px]; (count, count) weight of the sides' loss, 0
        but near a middle, which adds up to 1 for each thing.
    """
    heat = np.zeros((classes, count, count), dtype=np.float32)
    sides = np.zeros((4, count, count), dtype=np.float32)
    weight = np.zeros((count, count), dtype=np.float32)
    cells = np.arange(count)
    for kind, seen, left, top, width, height in sorted(rows, key=lambda row: -row[4] * row[5]):  # small ones last
        middle = int((left + width / 2.0) // CELL_PX), int((top + height / 2.0) // CELL_PX)
        if not seen:
            low, high = (
                (int(start // CELL_PX), int(-(-end // CELL_PX)))
                for start, end in ((left, left + width), (top, top + height))
            )
            region = heat[kind, max(0, high[0]) : max(0, high[1]), max(0, low[0]) : max(0, low[1])]
            region[region == 0.0] = -1.0
            continue
        if not all(0 <= part < count for part in middle):
            continue  # its middle lies in another square
        along = [
            np.exp(-0.5 * ((cells - place) / max(SPREAD * side / CELL_PX, 0.4)) ** 2)
            for place, side in zip(middle, (width, height), strict=True)
        ]
        bell = (along[1][:, None] * along[0][None, :]).astype(np.float32)
        heat[kind] = np.where(bell > 0.01, np.maximum(heat[kind], bell), heat[kind])
        near = bell > NEAR
        for plane, side in zip(sides, (left, top, left + width, top + height), strict=True):
            plane[near] = side
        weight[near] = bell[near] / bell[near].sum()
    return heat, sides, weight


def _loss(torch: Any, logits: Any, sides: Any, heat: Any, wanted: Any, weight: Any) -> Any:
    """Focal loss of middles, and generalised intersection over union of boxes, for each thing."""
    scores = logits.sigmoid().clamp(1e-6, 1.0 - 1e-6)
    things = (heat == 1.0).sum().clamp(min=1)
    hit = (heat == 1.0) * (1.0 - scores) ** 2 * scores.log()
    miss = ((heat >= 0.0) & (heat < 1.0)) * (1.0 - heat.clamp(min=0.0)) ** 4 * scores**2 * (1.0 - scores).log()
    x, y = middles_px(torch, logits)
    left, top, right, bottom = (CELL_PX * sides).unbind(1)
    found = torch.stack([x - left, y - top, x + right, y + bottom], 1)
    apart = (1.0 - giou(torch, found, wanted)) * weight
    return -(hit.sum() + miss.sum()) / things + SIDES_WEIGHT * apart.sum() / weight.sum().clamp(min=1.0)


def giou(torch: Any, one: Any, other: Any) -> Any:
    """Generalised intersection over union, -1 to 1, of boxes (B, 4, ...): left, top, right, bottom."""

    def area(low: Any, high: Any) -> Any:
        return (high - low).clamp(min=0.0).prod(1)

    low, high = torch.maximum(one[:, :2], other[:, :2]), torch.minimum(one[:, 2:], other[:, 2:])
    both = area(low, high)
    either = area(one[:, :2], one[:, 2:]) + area(other[:, :2], other[:, 2:]) - both
    hull = area(torch.minimum(one[:, :2], other[:, :2]), torch.maximum(one[:, 2:], other[:, 2:])).clamp(min=1e-6)
    return both / either.clamp(min=1e-6) - (hull - either) / hull


def write(found: TrainedFinder, out: Path) -> None:
    """Write trained.onnx, detectors.yaml that `benchmark detect` takes, losses.csv and losses.png.

    Args:
        found: from `train`.
        out: folder; its name is the detector's.

    Raises:
        OutputError: the folder cannot be written.
    """
    networks.write_onnx(out / "trained.onnx", found.model, 3, MULTIPLE, ("picture", "found"))
    labels = [f"{label}: {place}" for place, joined in enumerate(found.classes) for label in joined.split("+")]
    more = f"onnx: trained.onnx, layout: yolov8, nms: 0.6, classes: {{{', '.join(labels)}}}"
    text = f"synfog: benchmark/1\ndetectors:\n  - {{name: {networks.name_of(out)}, {more}}}\n"
    files.write_bytes(out / "detectors.yaml", text.encode())
    networks.write_losses(out, found.losses, "loss")


def main(
    source: command.Source,
    out: command.Out,
    classes: Annotated[
        str, typer.Option(help="Cityscapes' classes of things, comma-separated; + makes one class of several.")
    ] = "car,person",
    pipeline: Annotated[str, typer.Option(help="Whose pictures; all if left out.")] = "",
    fogs: Annotated[str, typer.Option(help="Pictures that are learned from: clear, foggy or all.")] = "all",
    split: Annotated[str, typer.Option(help="Split of a set; all if left out.")] = "",
    seed: Annotated[int, typer.Option(min=0, help="Of the first weights, and of what is drawn.")] = 0,
    steps: Annotated[int, typer.Option(min=1, help="Batches of four squares of 160 pixels.")] = 8000,
) -> None:
    """Train a network of 0.9 million weights to find things, for `benchmark detect --model OUT/detectors.yaml`."""
    networks.torch_library()
    names = tuple(dict.fromkeys(name.strip() for name in classes.split(",") if name.strip()))
    pictures = views(source, names, pipeline=pipeline, fogs=fogs, split=split)
    with progress_bar(quiet=False) as (progress, _):
        trained = train(pictures, names, seed=seed, steps=steps, progress=progress)
    write(trained, out)
    last = trained.losses[-max(1, steps // 20) :]
    print(f"{len(pictures)} pictures; loss {sum(last) / len(last):.3f} of the last {len(last)} steps")
    print(f"{out / 'detectors.yaml'} is for synfog-usd benchmark detect --model")


if __name__ == "__main__":
    command.run(main)
