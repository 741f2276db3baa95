"""The child in which a method works: `python -m synfog_usd.lab.benchmark.child`.

The first line on standard input is the method as JSON; each further line names a picture and where the answer goes.
Each is answered by a line of JSON: {"seconds": processor seconds} or {"error": one line}.  What measures answers is
such a child too, and gets the truth as well.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError, SynfogError
from synfog_usd.dataset.sets.cluster import cores
from synfog_usd.lab.benchmark import decode
from synfog_usd.lab.benchmark.classics import CLASSICS
from synfog_usd.lab.benchmark.decode import OnnxSession
from synfog_usd.lab.benchmark.detectors import Detector
from synfog_usd.lab.benchmark.methods import Defogger, Measurer, Method

Work = Callable[..., None]
"""From the file of a picture to that of the answer; what measures gets that of the truth, too."""

KINDS: dict[str, type[Method]] = {kind.__name__: kind for kind in (Defogger, Detector, Measurer)}


def main() -> None:
    """Answer until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print does not stand among the answers
    request = json.loads(sys.stdin.readline())
    method = KINDS[request.pop("does")](**request)
    with contextlib.suppress(ImportError):  # Windows has no such limit
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(method.memory_gb * 1e9),) * 2)
    work: Work | None = None
    for line in sys.stdin:
        task = json.loads(line)
        began = time.process_time()
        try:
            if method.kind == "command":
                _run(method, task)
            else:
                if work is None:
                    work = _loaded(method)
                work(*(Path(task[word]) for word in ("in", "out", "truth") if word in task))
            answer: dict[str, Any] = {"seconds": time.process_time() - began}
        except Exception as error:
            reason = str(error) if isinstance(error, SynfogError) else f"{type(error).__name__}: {error}"
            answer = {"error": " ".join(reason.split())[:300]}
        print(json.dumps(answer), file=answers, flush=True)


def read(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 of a picture."""
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def picture(path: Path) -> np.ndarray:
    """(H, W, 3) uint8.

    Raises:
        ParameterError: it cannot be read.
    """
    from PIL import Image

    try:
        return read(path)
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise ParameterError(f"{path}: cannot be read as a picture ({error})") from error


def _write(path: Path, pixels: np.ndarray) -> None:
    from PIL import Image

    if not np.isfinite(pixels).all():
        raise ValueError("the answer holds NaN or infinity")
    Image.fromarray(np.rint(np.clip(pixels, 0.0, 1.0) * 255.0).astype(np.uint8)).save(path)


def _tell(path: Path, answer: object) -> None:
    path.write_text(json.dumps(answer, allow_nan=False), encoding="utf-8")


def _loaded(method: Method) -> Work:
    if isinstance(method, Detector):
        find = decode.detector(method, _session(method))

        def boxes(source: Path, out: Path) -> None:
            _tell(out, find(read(source)))

        return boxes
    if isinstance(method, Measurer):
        from synfog_usd.lab.benchmark import metrics

        return lambda answer, out, truth: _tell(out, metrics.measure(picture(answer), picture(truth)))
    assert isinstance(method, Defogger)
    if method.kind == "onnx":
        restore = _network(method)
        return lambda taken, out: _write(out, restore(taken))
    classic = CLASSICS[method.target]
    return lambda taken, out: _write(out, classic(read(taken).astype(np.float64) / 255.0))


def _session(method: Method) -> OnnxSession:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = threads(method)
    session: OnnxSession = onnxruntime.InferenceSession(method.target, options, providers=["CPUExecutionProvider"])
    return session


def _network(method: Defogger) -> Callable[[Path], Array]:
    """What restores the picture of a file, (H, W, 3) of 0 to 1.

    Raises:
        ValueError: the network takes something else.
    """
    session = _session(method)
    inputs, outputs = session.get_inputs(), session.get_outputs()
    shape = inputs[0].shape
    if len(inputs) != 1 or len(shape) != 4 or (isinstance(shape[1], int) and shape[1] != 3):
        takes = ", ".join(f"{node.name} {node.shape}" for node in inputs)
        raise ValueError(f"the network takes {takes}; it must take one picture (1, 3, H, W)")
    low, high = method.range

    def restore(source: Path) -> Array:
        planes = read(source).transpose(2, 0, 1).astype(np.float32) / 255.0 * (high - low) + low
        height, width = planes.shape[1:]
        down, right = (-height) % method.multiple, (-width) % method.multiple
        batch = np.pad(planes, ((0, 0), (0, down), (0, right)), mode="symmetric")[None]
        for side, padded in zip(shape[2:], batch.shape[2:], strict=True):
            if isinstance(side, int) and side != padded:
                raise ValueError(
                    f"the network wants pictures of {shape[3]} x {shape[2]}, and this one has {width} x {height}; "
                    f"export it with free height and width"
                )
        answer = np.asarray(session.run([outputs[0].name], {inputs[0].name: batch})[0], dtype=np.float64)
        if answer.shape != batch.shape:
            raise ValueError(f"the network gave {answer.shape} for {batch.shape}")
        return (answer[0].transpose(1, 2, 0)[:height, :width] - low) / (high - low)

    return restore


def _run(method: Method, task: dict[str, str]) -> None:
    words = [word.replace("{in}", task["in"]).replace("{out}", task["out"]) for word in method.command]
    done = subprocess.run(words, cwd=method.target, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode != 0:
        output = (done.stderr or done.stdout).strip().splitlines()
        raise RuntimeError(f"ended with {done.returncode}: {output[-1] if output else 'it said nothing'}")
    if not Path(task["out"]).is_file():
        raise RuntimeError(f"it wrote no {method.suffix[1:].upper()}")


def threads(method: Method) -> int:
    """Its share of the cores: all of them where it works on one picture at a time."""
    return max(1, cores() // (method.at_once or cores()))


def as_line(method: Method) -> str:
    """The method as the child's first line."""
    return json.dumps({"does": type(method).__name__, **dataclasses.asdict(method)}) + "\n"


if __name__ == "__main__":
    main()
