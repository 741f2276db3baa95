"""A small network that sees through fog, and its training on the pairs of a set.  torch is imported on first use.

The network is a U-Net of three levels on half the picture's size, with the mean over the whole picture added at the
bottom.  Of a developed picture it takes R, G and B and gives what is to be added to them.  Of RAW it takes a plane for
each filter of a 2 x 2 mosaic (R, G, G, B), black 0 and white 1, balanced by the file's own white, and gives R, G and B
of twice the size: it demosaics, develops and defogs in one.

Pictures of four kinds of fog can come from one set:

    synfog                    light transport, and the sensor's noise
    noise_free                light transport
    asm_estimated.noise_free  the scattering model on radiance, with an airlight that is guessed from the picture
    asm_srgb.synfog           the scattering model on the codes of the clear picture, as Foggy Cityscapes is made

Source of the last: Sakaridis, Dai and Van Gool, Semantic Foggy Scene Understanding (2018); RAW planes: Chen, Chen, Xu
and Koltun, Learning to See in the Dark (2018).
"""

from __future__ import annotations

import functools
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from docs.studies import command, networks
from synfog_usd.base import files, seeds
from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.cli.progress import shown as progress_bar
from synfog_usd.dataset.exports import frames
from synfog_usd.dataset.exports.frames import LabelledPicture
from synfog_usd.lab.benchmark.raw import filter_planes

ASM_SRGB = "asm_srgb"
WIDTH = 16
"""Channels of the uppermost level; 143 000 weights altogether."""

SIDE_PX = 96
"""Of a square that is learned from."""

BATCH = 4
RATE = 1e-3
"""Adam's; it falls to 0 by a cosine."""

MULTIPLE = 8
"""A developed picture's sides must be multiples of this [px]; of RAW, its planes' of half of it."""


@dataclass(frozen=True, eq=False)  # each is itself, so that its pictures can be kept
class TrainingPair:
    """A view to learn from.

    Attributes:
        scene: intervals are over scenes.
        kind: of its fog, see the head of this module.
        foggy: the shot.
        clear: the picture in clear air by the same pipeline.
        target: the picture in clear air that is to be seen.
        raw: whether its RAW is learned from, and not the developed picture.
    """

    scene: str
    kind: str
    foggy: LabelledPicture
    clear: Path
    target: Path
    raw: bool = False


def pairs(source: Path, kind: str, *, target: str = "", split: str = "", raw: bool = False) -> list[TrainingPair]:
    """The pairs of a set or a bake.

    Args:
        source: folder.
        kind: of the fog: a pipeline of the set, or asm_srgb.PIPELINE.
        target: pipeline whose clear picture is to be seen; the foggy one's own if left out.
        split: of a set; all if left out.
        raw: whether RAW is taken.

    Raises:
        ParameterError: no such pair.
    """
    mixed = kind.startswith(f"{ASM_SRGB}.")
    pipeline = kind.removeprefix(f"{ASM_SRGB}.")
    own = pipeline.rpartition(".")[2]
    views: dict[tuple[Any, ...], LabelledPicture] = {}
    foggy = []
    for one in frames.pictures(source):
        if split in ("", one.split):
            if one.clear:
                views[one.scene, one.lighting, one.camera, one.pipeline] = one
            elif one.pipeline == pipeline:
                foggy.append(one)
    found = []
    for one in foggy:
        view = one.scene, one.lighting, one.camera
        clear, wanted = (views.get((*view, name)) for name in (own, target or own))
        if clear is not None and wanted is not None and (not raw or "raw.dng" in one.files):
            found.append(TrainingPair(f"{one.scene:06d}", kind, one, clear.screen, wanted.screen, raw))
    if not found:
        words = f"no {'RAW ' * raw}pictures in fog by {kind!r} with clear ones by {target or own!r}"
        there = ", ".join(sorted({view[3] for view in views})) or "none"
        raise ParameterError(f"{source}: {words}{f' in the split {split!r}' * bool(split)}; clear ones are by {there}")
    if mixed and raw:
        raise ParameterError(f"{kind!r} is made of developed pictures; RAW has no codes to mix")
    return found


@functools.lru_cache(maxsize=512)
def foggy_of(pair: TrainingPair) -> FloatArray:
    """(3, H, W) of 0 to 1, or (4, H / 2, W / 2) planes of RAW."""
    if pair.raw:
        return filter_planes(pair.foggy.files["raw.dng"])
    if not pair.kind.startswith(f"{ASM_SRGB}."):
        return shown(pair.foggy.screen)
    from synfog_usd.fog.airlight import estimated_airlight

    clear, t = shown(pair.clear).transpose(1, 2, 0), pair.foggy.transmittance()[:, :, None]
    mixed = clear * t + estimated_airlight(clear, t) * (1.0 - t)
    return (np.rint(255.0 * mixed.transpose(2, 0, 1)) / 255.0).astype(np.float32)


@functools.lru_cache(maxsize=512)
def shown(path: Path) -> FloatArray:
    """(3, H, W) of 0 to 1, coded as sRGB."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"), dtype=np.float32)
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise ParameterError(f"{path}: cannot be read as a picture ({error})") from error
    return np.ascontiguousarray(pixels.transpose(2, 0, 1)) / np.float32(255.0)


def network(*, raw: bool = False) -> Any:
    """The network, untrained; see the head of this module."""
    nn = networks.torch_library().nn

    def twice(planes: int, width: int) -> Any:
        return nn.Sequential(
            nn.Conv2d(planes, width, 3, padding=1), nn.ReLU(), nn.Conv2d(width, width, 3, padding=1), nn.ReLU()
        )

    class FogUNet(nn.Module):  # type: ignore[name-defined, misc]
        def __init__(self) -> None:
            super().__init__()
            self.first = twice(4 if raw else 12, WIDTH)
            self.second, self.third = twice(2 * WIDTH, 2 * WIDTH), twice(4 * WIDTH, 4 * WIDTH)
            self.down = nn.ModuleList([nn.Conv2d(WIDTH * n, 2 * WIDTH * n, 2, stride=2) for n in (1, 2)])
            self.whole = nn.Conv2d(4 * WIDTH, 4 * WIDTH, 1)
            self.up = nn.ModuleList([nn.ConvTranspose2d(2 * WIDTH * n, WIDTH * n, 2, stride=2) for n in (2, 1)])
            self.fourth, self.last = twice(2 * WIDTH, 2 * WIDTH), twice(WIDTH, WIDTH)
            self.out = nn.Conv2d(WIDTH, 12, 3, padding=1)
            self.fold, self.unfold = nn.PixelUnshuffle(2), nn.PixelShuffle(2)
            for layer in self.modules():  # He, Zhang, Ren and Sun 2015; the last begins with nothing to add
                if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
                    nn.init.kaiming_normal_(layer.weight)
                    nn.init.zeros_(layer.bias)
            nn.init.zeros_(self.out.weight)

        def forward(self, foggy: Any) -> Any:
            # square roots of linear light are nearly codes
            one = self.first(foggy.clamp(0.0, 1.0).sqrt() if raw else self.fold(foggy))
            two = self.second(self.down[0](one))
            three = self.third(self.down[1](two))
            three = three + self.whole(three.mean(dim=(2, 3), keepdim=True))
            two = self.fourth(two + self.up[0](three))
            clear = self.unfold(self.out(self.last(one + self.up[1](two))))
            return clear if raw else foggy + clear

    return FogUNet()


@dataclass(frozen=True)
class TrainedDefogger:
    """What came of a training.

    Attributes:
        model: torch's module.
        raw: whether it takes RAW.
        losses: by step, mean absolute error of a batch.
    """

    model: Any
    raw: bool
    losses: tuple[float, ...]

    def restore(self, foggy: FloatArray) -> FloatArray:
        """(3, H, W) of 0 to 1 from `foggy_of`."""
        torch = networks.torch_library()
        multiple = MULTIPLE // 2 if self.raw else MULTIPLE
        height, width = foggy.shape[1:]
        padded = np.pad(foggy, ((0, 0), (0, -height % multiple), (0, -width % multiple)), mode="symmetric")
        with torch.no_grad():
            clear = self.model(torch.from_numpy(padded)[None])[0].clamp(0.0, 1.0).numpy()
        scale = 2 if self.raw else 1
        return clear[:, : scale * height, : scale * width]


def train(
    found: Sequence[TrainingPair],
    *,
    seed: int = 0,
    steps: int = 2000,
    progress: Progress = silent,
) -> TrainedDefogger:
    """Train on squares of pairs, turned left to right at random.

    The same pairs, seed and steps give the same weights, on one machine with one number of threads.

    Args:
        found: from `pairs`.
        seed: of the first weights and of what is drawn.
        steps: batches of four squares.
        progress: whom to tell.

    Raises:
        ParameterError: torch is not installed, or a pair's pictures differ in size.
    """
    torch, raw = networks.torch_library(), found[0].raw
    with networks.repeating(torch, seed):
        model = network(raw=raw)
        optimiser = torch.optim.Adam(model.parameters(), lr=RATE)
        falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
        rng = seeds.stream(seed, "training")
        losses = []
        for step in range(steps):
            if step % 10 == 0:
                progress(f"step {step} of {steps}", step / steps)
            foggy, clear = (torch.from_numpy(np.stack(part)) for part in zip(*_squares(found, rng), strict=True))
            loss = torch.nn.functional.l1_loss(model(foggy), clear)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            falling.step()
            losses.append(loss.item())
    return TrainedDefogger(model.eval(), raw, tuple(losses))


def _squares(found: Sequence[TrainingPair], rng: np.random.Generator) -> list[tuple[FloatArray, FloatArray]]:
    scale = 2 if found[0].raw else 1
    side = SIDE_PX // scale
    made = []
    for _ in range(BATCH):
        pair = found[int(rng.integers(len(found)))]
        foggy, clear = foggy_of(pair), shown(pair.target)
        if tuple(scale * part for part in foggy.shape[1:]) != clear.shape[1:]:
            raise ParameterError(
                f"{pair.foggy.name}: {foggy.shape[2]} x {foggy.shape[1]} in fog and {clear.shape[2]} x "
                f"{clear.shape[1]} in clear air; a pair needs one size"
            )
        top, left = (int(rng.integers(max(1, part - side + 1))) for part in foggy.shape[1:])
        turned = -1 if rng.random() < 0.5 and not pair.raw else 1  # turned RAW would have another mosaic
        first = foggy[:, top : top + side, left : left + side][:, :, ::turned]
        top, left, wide = scale * top, scale * left, scale * side
        made.append((_whole(first, side), _whole(clear[:, top : top + wide, left : left + wide][:, :, ::turned], wide)))
    return made


def _whole(square: FloatArray, side: int) -> FloatArray:
    """A square of a picture that is smaller, filled by its mirror image."""
    down, right = side - square.shape[1], side - square.shape[2]
    return np.ascontiguousarray(np.pad(square, ((0, 0), (0, down), (0, right)), mode="symmetric"))


def write(found: TrainedDefogger, out: Path) -> None:
    """Write trained.onnx, methods.yaml that `benchmark defog` takes, weights.pt, losses.csv and losses.png.

    Args:
        found: from `train`.
        out: folder; its name is the method's.

    Raises:
        OutputError: the folder cannot be written.
    """
    planes, multiple = (4, MULTIPLE // 2) if found.raw else (3, MULTIPLE)
    networks.write_onnx(out / "trained.onnx", found.model, planes, multiple, ("foggy", "clear"))
    files.write_bytes(out / "weights.pt", as_bytes(found))
    more = f"takes: raw.dng, multiple: {MULTIPLE // 2}" if found.raw else f"multiple: {MULTIPLE}"
    text = f"synfog: benchmark/1\nmethods:\n  - {{name: {networks.name_of(out)}, onnx: trained.onnx, {more}}}\n"
    files.write_bytes(out / "methods.yaml", text.encode())
    networks.write_losses(out, found.losses, "mean_absolute_error")


def as_bytes(found: TrainedDefogger) -> bytes:
    """Its weights, as `load` reads them."""
    weights = io.BytesIO()
    networks.torch_library().save({"raw": found.raw, "state": found.model.state_dict()}, weights)
    return weights.getvalue()


def load(path: Path) -> TrainedDefogger:
    """The network of weights, without its losses.

    Raises:
        OutputError: it is none of ours.
    """
    torch = networks.torch_library()
    try:
        told = torch.load(path, weights_only=True)
        model = network(raw=told["raw"])
        model.load_state_dict(told["state"])
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise OutputError(f"{path}: cannot be read as weights ({' '.join(str(error).split())[:200]})") from error
    return TrainedDefogger(model.eval(), told["raw"], ())


def psnr(restored: FloatArray, truth: FloatArray) -> float:
    """Of two pictures (3, H, W), as `benchmark.metrics` has it: over codes of 8 bits [dB]."""
    from synfog_usd.lab.benchmark.metrics import psnr as of_codes

    codes = [np.rint(255.0 * np.clip(one, 0.0, 1.0)).astype(np.uint8) for one in (restored, truth)]
    return of_codes(codes[0], codes[1])


def main(
    source: command.Source,
    out: command.Out,
    raw: Annotated[bool, typer.Option("--raw", help="Take RAW instead of developed pictures.")] = False,
    pipeline: Annotated[
        str, typer.Option(help="Whose pictures in fog; asm_srgb.NAME mixes fog into the clear ones of NAME.")
    ] = "synfog",
    target: Annotated[str, typer.Option(help="Whose clear pictures are the aim; the pipeline's if left out.")] = "",
    split: Annotated[str, typer.Option(help="Split of a set; all if left out.")] = "",
    seed: Annotated[int, typer.Option(min=0, help="Of the first weights, and of what is drawn.")] = 0,
    steps: Annotated[int, typer.Option(min=1, help="Batches of four squares of 96 pixels.")] = 2000,
) -> None:
    """Train a network of 0.15 million weights to see through fog, for `benchmark defog --methods OUT/methods.yaml`."""
    networks.torch_library()
    examples = pairs(source, pipeline, target=target, split=split, raw=raw)
    with progress_bar(quiet=False) as (progress, _):
        trained = train(examples, seed=seed, steps=steps, progress=progress)
    write(trained, out)
    last = trained.losses[-max(1, steps // 20) :]
    print(f"{len(examples)} pairs; mean absolute error {sum(last) / len(last):.4f} of the last {len(last)} steps")
    print(f"{out / 'methods.yaml'} is for synfog-usd benchmark defog --methods")


if __name__ == "__main__":
    command.run(main)
