"""The self-test: that it passes, and that it can fail."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from synfog_usd.cli.main import app
from synfog_usd.lab import cases, selftest
from synfog_usd.render import backend, models


@pytest.fixture(scope="module", autouse=True)
def started():
    backend.start("auto")


def only(name, **changes):
    """One of the cases, changed."""
    (found,) = [case for case in cases.every() if name in case.name]
    return replace(found, **changes)


def constant(value, lost=0, *, peer=False):
    """A model that sees the same everywhere."""

    def make(loaded):
        camera = loaded.source.camera
        shape = (camera.width_px * camera.height_px, 3)
        accumulated = SimpleNamespace(
            mean=lambda: np.full(shape, value), variance=lambda: np.full(shape, 1e-12), lost=lost
        )
        return SimpleNamespace(accumulate=lambda **how: accumulated)

    return models.Model(make=make, peer=peer)


WALL = "wall at 50 m, MOR 150"


@pytest.mark.physics
def test_every_known_answer_is_met_on_this_machine():
    """All cases, all models: nothing is missed."""
    rows = list(selftest.run())
    assert not [result for row in rows for result in row if result.failed], (
        selftest.table(rows) + "\n" + selftest.summary(rows)
    )


@pytest.mark.parametrize(
    "names, word, fewest",
    [(("single",), "bank of", 1), pytest.param(("path", "single"), "", 10, marks=pytest.mark.slow)],
)
def test_the_quick_ones_are_met_as_a_user_runs_them(monkeypatch, names, word, fewest):
    """`selftest --quick --json` ends with 0, on our models; what is counted resolves 10 % or better."""
    chosen = [case for case in cases.every() if word in case.name]
    monkeypatch.setattr(selftest, "every", lambda: chosen)
    monkeypatch.setattr(models, "MODELS", {name: model for name, model in models.MODELS.items() if name in names})
    done = CliRunner().invoke(app, ["selftest", "--quick", "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["cases"]
    met = [result for result in found if result["counted"] and result["verdict"] == "met"]
    assert len(met) >= fewest and all(result["resolves"] <= 0.1 for result in met)
    assert len({result["case"] for result in found}) == len([case for case in chosen if case.quick]) > 0


def test_a_wrong_truth_is_missed(monkeypatch):
    """Half a percent too bright is seen, and the run ends with 1."""
    wrong = only(WALL, build=lambda: replace(cases.glowing_wall(0.02), truth=1.005 * np.exp(-1.0)))
    monkeypatch.setattr(models, "MODELS", {"path": models.MODELS["path"]})
    monkeypatch.setattr(selftest, "every", lambda: [wrong])
    done = CliRunner().invoke(app, ["selftest"])
    assert done.exit_code == 1, done.output
    assert "MISSED  path: " + wrong.name in done.output and "!-0.50/" in done.output and "1 MISSED" in done.output


@pytest.mark.parametrize(
    "value, lost, verdict, cell",
    [(np.nan, 0, "not finite", "!NaN 576"), (1.0, 3, "not finite", "!NaN 12"), (-1.0, 0, "negative", "!neg. 144 px")],
)
def test_nan_and_negative_radiance_fail_in_any_domain(monkeypatch, value, lost, verdict, cell):
    """A model of ours that has no stated domain yet, and gives what no model may; a peer's NaN is shown and not
    counted.
    """
    monkeypatch.setattr(
        models, "MODELS", {"new": constant(value, lost), "volpathmis": constant(value, lost, peer=True)}
    )
    ((ours, theirs),) = selftest.run([only(WALL)])
    assert (ours.verdict, ours.failed, ours.cell()) == (verdict, True, cell)
    assert (theirs.verdict, theirs.failed, theirs.cell()) == (verdict, False, cell[1:])


def test_outside_of_its_domain_a_model_is_shown_in_brackets(monkeypatch):
    """And a crash of ours counts, a refusal does not."""

    def crash(loaded):
        raise RuntimeError("no such instance")

    bad = models.Model(make=crash)
    shy = replace(models.MODELS["path"], refuses=lambda scene: "no")
    monkeypatch.setattr(models, "MODELS", {"new": constant(1.0), "bad": bad, "path": shy})
    ((new, bad, path),) = selftest.run([only(WALL)])
    assert new.verdict == "missed" and not new.failed and new.cell().startswith("(+171/")
    assert bad.failed and "no such instance" in selftest.summary([[bad]])
    assert path.verdict == "refused" and not path.failed
    assert selftest.table([[new, bad, path]]).splitlines()[1].startswith(new.case)


def test_too_noisy_is_a_failure(monkeypatch):
    """A run that could not have seen the bias that its case asks for is no proof."""
    monkeypatch.setattr(models, "MODELS", {"path": models.MODELS["path"]})
    ((result,),) = selftest.run([only("endless fog", samples=2, resolves=1e-4)])
    assert result.verdict == "noisy" and result.failed
