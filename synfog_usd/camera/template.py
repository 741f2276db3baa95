"""A sensor or lens to be filled in: every key of a profile with its meaning and range, as YAML that loads as it stands.

What keys mean is what the records' own docstrings say of them.
"""

from __future__ import annotations

import inspect
import re
import textwrap

from synfog_usd.camera import cfa
from synfog_usd.camera.profiles import LensProfile, SensorProfile, limits_of, load_lens, load_sensor

WIDTH = 100
"""Columns of a comment."""

EXAMPLE = "Estimate: that of a Pixel 4a, which is still to be replaced by your own"
"""Where the values are from that nobody replaced yet; a bake tells of them."""

SENSOR_WORDS = """\
serial: mine-0001

# Colour filter pattern, from the upper left pixel: one of {patterns}
cfa: RGGB

# Quantum efficiency behind each filter: one of four forms, which docs/camera.md explains.
qe: {{camera: Nikon 5100 (NPL), peak: 0.6, source: example}}
# qe: {{csv: qe.csv, source: example}}
# qe: {{observer: cie1931, peak: 1.0, source: example}}
# qe:
#   product:
#     sensor: {{csv: silicon.csv}}
#     ir_filter: {{short_pass: [650, 30]}}
#     filters: {{R: {{long_pass: [590, 30]}}, G: {{gaussian: [535, 90, 0.9]}}, B: {{gaussian: [455, 80, 0.85]}}}}
#   source: example
"""

LENS_WORDS = """\
# Tables, each of which may be left out; the pages of the ops tell what they mean (docs/reference/ops.md).
# distortion: {value: [-0.3, 0.08, 0, 0], source: example}
# fisheye: {value: [1, 0, -0.02], source: example}
# relative_illumination: {field_deg: [0, 20, 40], value: [1, 0.85, 0.5], source: example}
# aberrations:
#   field_deg: [0, 40]
#   tangential_um: [1, 3]
#   sagittal_um: [1, 2]
#   axial_450_um: [1, 1]
#   axial_650_um: [1, 1]
#   lateral_450_um: [0, -1]
#   lateral_650_um: [0, 1]
#   source: example
# drawing:
#   radius_mm: [4.52, 0, 0]
#   thickness_mm: [1, 0.5, 0]
#   index: [1.5168, 1, 1]
#   clear_mm: [2, 2, 2]
#   source: example
"""


def sensor_template() -> str:
    """A commented sensor; its values are those of the Pixel's."""
    words = SENSOR_WORDS.format(patterns=", ".join(cfa.PATTERNS))
    serial = _comment(meanings(SensorProfile)["serial"])
    return _written("sensor", f"{serial}\n{words}\n{_numbers(SensorProfile, load_sensor('imx363'))}")


def lens_template() -> str:
    """A commented lens; its values are those of the Pixel's."""
    return _written("lens", _numbers(LensProfile, load_lens("pixel4a")) + LENS_WORDS)


def meanings(record: type) -> dict[str, str]:
    """What a record's docstring says of each attribute, on one line."""
    section = inspect.cleandoc(record.__doc__ or "").partition("Attributes:\n")[2]
    by_key = {}
    for names, text in re.findall(
        r"^    (\w[\w, \n]*?):\s(.*?)(?=^    \w|\Z)", section, flags=re.MULTILINE | re.DOTALL
    ):
        for name in re.split(r",\s*", names):
            by_key[name] = " ".join(text.split()).rstrip(".")
    return by_key


def _numbers(record: type, values: SensorProfile | LensProfile) -> str:
    by_key, text = meanings(record), ""
    for key, limits in limits_of(record).items():
        whole = "a whole number, " if limits.whole else ""
        left_out = "" if limits.default is None else f"; {limits.default:g} if left out"
        comment = _comment(f"{by_key[key]} ({whole}{limits.low:g} to {limits.high:g}{left_out})")
        text += f"{comment}\n{key}: {{value: {getattr(values, key):.10g}, source: example}}\n\n"
    return text


def _comment(text: str) -> str:
    text = text[:1].upper() + text[1:]
    return textwrap.fill(text, WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False)


def _written(kind: str, body: str) -> str:
    head = (
        f"# A {kind} of your own.  Replace each value by that of your data sheet, and its source by the name of a\n"
        f"# text under 'sources'.  A graph names the file at its top: '{kind}: ./mine.yaml'.\n"
    )
    start = f"synfog: {kind}/1\nname: mine\ntitle: My {kind}\n"
    sources = f"sources:\n  example: '{EXAMPLE}'\n  # data_sheet: Maker, part, revision, page\n"
    return f"{head}\n{start}\n{body.rstrip()}\n\n{sources}"
