"""Pages and schema that are made from the ops: fresh, and of one mind with the loader."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import pytest
import yaml

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.errors import GraphError
from synfog_usd.base.image import Image
from synfog_usd.camera.graph import Range, Registry, load_graph, reference, schema
from synfog_usd.cli.graph import schema_text

ROOT = Path(__file__).resolve().parents[2]
GRAPHS = sorted(resources.folder("pipeline").glob("*.yaml"))


def test_the_pages_and_the_schema_are_fresh():
    """Made again by `synfog-usd graph explain --all` and `synfog-usd graph schema`."""
    made = {"docs/reference/ops.md": reference.pages(camera.OPS), "pipeline/graph.schema.json": schema_text()}
    stale = [name for name, text in made.items() if (ROOT / name).read_text(encoding="utf-8") != text]
    assert not stale, (
        "run: synfog-usd graph explain --all > docs/reference/ops.md; synfog-usd graph schema > "
        "pipeline/graph.schema.json"
    )


def test_a_page_tells_units_ranges_defaults_and_meanings():
    page = reference.page(camera.OPS, "sensor.dark_current")
    assert page.startswith(
        "## sensor.dark_current\n\nElectrons that heat frees during the exposure, before shot noise.\n"
    )
    assert "Takes electrons (mosaic, mean); gives electrons (mosaic, mean)." in page
    assert "| `temperature_c` | a number from -60 to 150 [degrees C] | `25` | T of the sensor [degrees C]. |" in page
    assert (
        "| `dark_current_e_s` | a number from 0 to 1e+07 [e-/s] | `sensor.dark_current_e_s` of the profile | I, at 25 "
        "degrees C [e-/s]. |" in page
    )
    assert "Source: EMVA 1288 release 4.0, section 7." in page and "Args" not in page
    assert "Draws random numbers" in reference.page(camera.OPS, "sensor.shot_noise") and "Draws" not in page
    with pytest.raises(
        GraphError, match=r"no op 'sensor.dark_curent'; there are .* Did you mean 'sensor.dark_current'\?"
    ):
        reference.page(camera.OPS, "sensor.dark_curent")


def test_all_pages_have_every_op_once_as_light_meets_them():
    heads = [line[3:] for line in reference.pages(camera.OPS).splitlines() if line.startswith("## ")]
    assert sorted(heads) == sorted(camera.OPS.ops)
    assert list(dict.fromkeys(head.partition(".")[0] for head in heads)) == ["light", "optics", "sensor", "isp"]


def test_every_parameter_of_the_camera_has_a_meaning_or_is_the_op_s_own_subject():
    """What a docstring leaves out is told by its first line: 'No pixel holds more than its full well'."""
    silent = {
        f"{op.name}.{item.name}"
        for op in camera.OPS
        for item in op.parameters.values()
        if item.can_be_set and not item.help
    }
    assert silent <= {"sensor.full_well.full_well_e"}


def test_a_unit_comes_from_the_name_or_the_docstring_and_both_must_agree():
    ops = Registry()

    @ops.op("a.fine", takes=None, gives=None)
    def fine(image: Image, *, time_s: float, speed: float, share: float) -> Image:
        """Fine.

        Args:
            time_s: how long.
            speed: how fast [m/s],
                on the road.
            share: of all [1].
        """
        return image

    assert [item.unit for item in ops.ops["a.fine"].parameters.values()] == ["s", "m/s", ""]
    assert ops.ops["a.fine"].parameters["speed"].help == "how fast [m/s], on the road."
    with pytest.raises(TypeError, match=r"'time_s' is in s by its name, but in ms by the docstring"):

        @ops.op("a.wrong", takes=None, gives=None)
        def wrong(image: Image, *, time_s: Annotated[float, Range(0.0)]) -> Image:
            """Wrong.

            Args:
                time_s: how long [ms].
            """
            return image


def parameter(op: str, name: str) -> dict:
    nodes = json.loads(schema_text())["properties"]["nodes"]["items"]["allOf"]
    (then,) = [item["then"] for item in nodes if item["if"]["properties"]["op"]["const"] == op]
    return then["properties"][name]


def test_the_schema_holds_ranges_choices_and_defaults():
    assert parameter("isp.demosaic", "algorithm")["enum"] == ["directional", "linear", "mhc", "menon"]
    assert parameter("isp.demosaic", "algorithm")["default"] == "directional"
    number, written, auto = parameter("sensor.expose", "exposure_s")["anyOf"]
    assert (
        number == {"type": "number", "exclusiveMinimum": 0.0, "maximum": 3600.0}
        and auto["const"] == "auto"
        and written["type"] == "string"
    )
    assert parameter("sensor.adc", "bits")["anyOf"][0] == {"type": "integer", "minimum": 8, "maximum": 16}
    assert parameter("isp.white_balance", "clip")["type"] == "boolean"


@pytest.mark.parametrize("path", GRAPHS, ids=lambda path: path.stem)
def test_a_shipped_graph_names_the_schema_beside_it(path):
    """The comment by which an editor finds it."""
    assert path.read_text().splitlines()[0] == "# yaml-language-server: $schema=graph.schema.json"


@pytest.fixture
def valid():
    """Whether the schema of some ops accepts a text."""
    jsonschema = pytest.importorskip("jsonschema")

    def accepts(text: str, ops: Registry) -> bool:
        made = schema.schema(ops)
        jsonschema.Draft7Validator.check_schema(made)
        return jsonschema.Draft7Validator(made).is_valid(yaml.safe_load(text))

    return accepts


@pytest.mark.parametrize("path", GRAPHS, ids=lambda path: path.stem)
def test_the_schema_accepts_the_shipped_graphs(valid, path):
    assert valid(path.read_text(), camera.OPS)


@pytest.mark.parametrize(
    "node",
    [
        "op: lens.pass",
        "op: lens.pass, scale: 10",
        "op: lens.pass, scale: 0",
        "op: lens.pass, scale: 10.1",
        "op: lens.pass, scale: '1/4'",
        "op: lens.pass, scale: 1e-3",
        "op: lens.pass, scale: auto",
        "op: lens.pass, scale: 3 m",
        "op: lens.pass, scale: true",
        "op: lens.pass, scale: null",
        "op: lens.pass, scale: [1]",
        "op: lens.pass, shape: round",
        "op: lens.pass, shape: rond",
        "op: lens.pass, shap: round",
        "op: lens.pas",
        "op: lens.pass, name: Lens 1",
        "op: lens.pass, in: radiance",
        "op: lens.pass, in: [radiance]",
        "op: lens.pass, in: [1]",
        "op: lens.pass, in: 3",
        "scale: 1",
    ],
)
def test_schema_and_loader_agree_on_a_node(tmp_path, registry, valid, node):
    """Names, types and ranges: what the one refuses the other refuses."""
    text = (
        f"synfog: graph/1\ninputs: [radiance]\nnodes:\n  - {{{node}}}\noutputs: {{a.exr: "
        f"{'lens_1' if 'Lens' in node else 'pass'}}}\n"
    )
    (tmp_path / "g.yaml").write_text(text)
    try:
        loads = bool(load_graph(tmp_path / "g.yaml", registry))
    except GraphError:
        loads = False
    assert valid(text, registry) is loads


@pytest.mark.parametrize(
    "output",
    [
        "raw.dng: adc",
        "raw.dng: {node: adc}",
        "raw.dng: {node: adc, compression: lossless}",
        "raw.dng: {node: adc, compression: zip}",
        "raw.dng: {node: adc, compresion: none}",
        "raw.dng: {node: [adc]}",
        "raw.exr: {node: adc, half: true, compression: none}",
        "raw.exr: {node: adc, half: 1}",
        "raw.tif: {node: adc, bits: 32}",
        "raw.tiff: {node: adc, bits: '32'}",
        "raw.tif: {node: adc, lossless: true}",
        "raw.bmp: adc",
    ],
)
def test_schema_and_loader_agree_on_an_output(tmp_path, registry, valid, output):
    text = (
        f"synfog: graph/1\ninputs: [radiance]\nnodes: [{{op: lens.pass}}, {{op: chip.expose}}, {{op: "
        f"chip.adc}}]\noutputs: {{{output}}}\n"
    )
    (tmp_path / "g.yaml").write_text(text)
    try:
        loads = bool(load_graph(tmp_path / "g.yaml", registry))
    except GraphError:
        loads = False
    assert valid(text, registry) is loads
