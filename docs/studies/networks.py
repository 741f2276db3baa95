"""What the trainings share: torch, draws that repeat, networks as ONNX, and losses.  torch is imported on first use."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base import files, seeds
from synfog_usd.base.errors import ParameterError


def torch_library() -> Any:
    """The module.

    Raises:
        ParameterError: it is not installed.
    """
    try:
        import torch
    except ImportError as error:
        raise ParameterError("training needs PyTorch: pip install torch onnxscript onnxruntime") from error
    return torch


@contextlib.contextmanager
def repeating(torch: Any, seed: int) -> Iterator[None]:
    """Draw from a seed, and by algorithms that repeat; leave torch as it was."""
    before = torch.are_deterministic_algorithms_enabled()
    with torch.random.fork_rng():
        torch.manual_seed(seeds.seed32(seed, "weights"))
        torch.use_deterministic_algorithms(True)
        try:
            yield
        finally:
            torch.use_deterministic_algorithms(before)


def write_onnx(path: Path, model: Any, planes: int, multiple: int, names: tuple[str, str]) -> None:
    """Write a network as ONNX of free height and width.

    Args:
        path: file, which appears whole.
        model: torch's module; takes (1, planes, H, W).
        planes: of its input.
        multiple: sides of its input are multiples of this [px].
        names: of its input and its output.

    Raises:
        OutputError: the folder cannot be written.
    """
    torch = torch_library()
    high, wide = (multiple * torch.export.Dim(name, min=2, max=2048) for name in ("high", "wide"))

    def export(temporary: Path) -> None:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), _quiet():
            warnings.simplefilter("ignore")
            torch.onnx.export(
                model,
                (torch.zeros(1, planes, 4 * multiple, 5 * multiple),),
                str(temporary),
                input_names=[names[0]],
                output_names=[names[1]],
                dynamic_shapes=({2: high, 3: wide},),
                verbose=False,
                external_data=False,
            )

    files.write_whole(path, export)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the exporter's lines on what is not installed."""
    logger = logging.getLogger("torch.onnx")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def name_of(out: Path) -> str:
    """A folder's name as YAML's flow style takes it: two networks that are compared have names of their own."""
    return json.dumps(out.resolve().name or "trained", ensure_ascii=False)


def write_losses(out: Path, losses: Sequence[float], name: str) -> None:
    """Write losses.csv and losses.png.

    Args:
        out: folder.
        losses: by step.
        name: of the loss, as the table's column has it.

    Raises:
        OutputError: the folder cannot be written.
    """
    rows = "".join(f"{step},{loss:.6g}\n" for step, loss in enumerate(losses))
    files.write_bytes(out / "losses.csv", f"step,{name}\n{rows}".encode())
    files.write_bytes(out / "losses.png", _drawn(losses, name))


def _drawn(losses: Sequence[float], name: str) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    window = max(1, len(losses) // 50)
    smooth = np.convolve(losses, np.full(window, 1.0 / window), mode="valid")
    axes.plot(losses, lw=0.5, color="#9fb8cc", label="batch")
    axes.plot(np.arange(smooth.size) + window // 2, smooth, lw=1.6, color="#0b5fa5", label=f"mean of {window}")
    axes.set(xlabel="step", ylabel=name.replace("_", " "), yscale="log")
    axes.legend()
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", metadata={"Software": None})
    return drawn.getvalue()
