"""What closes the view of drawn worlds: hills, fields, woods, houses, a skyline; a river under the bridge; plates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from synfog_usd.world.compose import draw, load
from synfog_usd.world.roads import horizon, road_built, roundabout_built, rules
from synfog_usd.world.roads.network import Road

RECIPES = Path(__file__).resolve().parents[2] / "stages" / "recipes"
KINDS = {"country": "rural", "town": "residential"}


def world(name, seed):
    spec = draw(load(RECIPES / f"{name}.yaml"), seed=seed)
    kind = road_built if isinstance(spec.road, Road) else roundabout_built
    return spec, kind._horizon(spec, spec.road)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rural", "residential", "roundabout", "bridge"])
def test_what_closes_the_view_stands_on_its_ground_away_from_the_road(name):
    """Three seeds: no foot is nearer than NEAR_M, above the ground, more than 2 m in it, or in the river."""
    for seed in range(3):
        spec, beyond = world(name, seed)
        for many in beyond.scatters():
            x, y, z = many.points.T
            assert beyond.away(x, y).min() > horizon.NEAR_M, many.name
            deep = beyond.ground(x, y) - z
            assert deep.min() > -1e-6 and deep.max() < 2.0, many.name
            if name == "bridge":
                assert not spec.road.flooded(x, y).any(), many.name


@pytest.mark.parametrize("kind", horizon.KINDS)
def test_towns_have_houses_all_round_and_the_country_has_fields(kind):
    """Over eight seeds: a town has 300 houses or more, the country 9 to 120; fields are of four kinds or more, and
    beyond 900 m land rises by 8 m or more in some direction.
    """
    for seed in range(8):
        beyond = horizon.Horizon(seed, kind, lambda x, y: 0 * x, lambda x, y: np.abs(x))
        found = beyond.scatters()
        houses = sum(len(one.points) for one in found if one.name.startswith("Far_Houses"))
        assert houses >= 300 if kind == "town" else 5 <= houses <= 120
        trees = next(one for one in found if one.name == "Far_Trees")
        assert 150 <= len(trees.points) <= 1400
        x, y = np.meshgrid(np.linspace(-900, 900, 61), np.linspace(-900, 900, 61))
        assert len(np.unique(beyond.crop(x, y))) >= 4
        angle = np.linspace(0, 2 * np.pi, 72)
        far = 2000.0 * np.cos(angle), 2000.0 * np.sin(angle)
        assert np.max(beyond.ground(*far)) > 8.0
        assert not beyond.relief(x, y, np.full_like(x, 100.0)).any()


def test_the_horizon_follows_its_seed():
    """Two of one seed are the same; of eight seeds no two have the same skyline and hills."""
    one, same = (world("rural", 5)[1].scatters() for _ in range(2))
    assert [m.name for m in one] == [m.name for m in same]
    for a, b in zip(one, same, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
    seen = set()
    for seed in range(8):
        beyond = horizon.Horizon(seed, "country", lambda x, y: 0 * x, lambda x, y: np.abs(x))
        seen.add(float(beyond.ground(np.array([1500.0]), np.array([0.0]))[0]))
    assert len(seen) == 8


def test_the_river_is_level_with_its_valley_and_far_below_the_bridge():
    """Water lies above the ground on its middle line, by less than half a metre where the strips are; the deck clears
    it by the bridge's depth.
    """
    for seed in range(3):
        spec, beyond = world("bridge", seed)
        road = spec.road
        water = road_built.land.river(road, beyond)
        normal = np.cross(*np.diff(water.points[water.faces], axis=1).swapaxes(0, 1))
        assert (normal[:, 2] > 0).all()
        low, high, depth = road.land.valley
        middle = (low + high) / 2
        t = road.lane_section.high + np.array([8.0, 20.0, 35.0])
        ground = road.ground(np.full(3, middle), t)
        np.testing.assert_allclose(ground, road.valley_floor, atol=1e-6)
        near = water.points[np.abs(beyond.away(*water.points[:, :2].T)) < 60.0]
        assert (near[:, 2] > ground[0]).all() and (near[:, 2] < ground[0] + 0.5).all()
        assert float(road.reference_line.height(middle)) - near[:, 2].max() > depth - 0.5


@pytest.mark.parametrize("seed", range(4))
def test_the_river_is_seen_from_the_car(seed):
    """Of places on the water ahead, within 25 degrees and 250 m, a tenth at least are in sight: the line from
    the lens passes over the ground and over the edges of the deck, below whose railing one looks through.
    """
    spec, _ = world("bridge", seed)
    road, view = spec.road, spec.view
    heading, (low, high, _) = np.deg2rad(view.heading), road.land.valley
    angle, far = (g.ravel() for g in np.meshgrid(np.deg2rad(np.linspace(-25, 25, 26)), np.linspace(30, 250, 45)))
    x, y = view.x - far * np.sin(heading + angle), view.y + far * np.cos(heading + angle)
    wet = np.abs(road.along_bridge(x, y)) < 0.3 * (high - low)
    s, t = road.reference_line.nearest(x, y)
    wet &= (t < road.lane_section.low - 2) | (t > road.lane_section.high + 2)
    assert wet.sum() > 100
    water, share = road.valley_floor + 0.3, np.linspace(0.005, 0.99, 200)[:, None]
    px, py = view.x + share * (x[wet] - view.x), view.y + share * (y[wet] - view.y)
    pz = view.z + share * (water - view.z)
    s, t = road.reference_line.nearest(px, py)
    out = np.maximum(t - road.lane_section.high, road.lane_section.low - t)
    deck = road.reference_line.height(s) + 0.12 + 0.08  # kerb and upstand
    covered = np.where(np.abs(out) < 0.4, pz < deck, pz < road.ground(s, t))
    assert (~covered.any(axis=0)).mean() > 0.1


@pytest.mark.parametrize("name", ["car_park", "roundabout", "crossroads"])
def test_cars_of_a_kind_have_plates_of_their_own(name):
    """Of all pairs of one model that stand in a world fewer than a tenth share a plate: by chance 1 in 24 do."""
    pairs = equal = 0
    for seed in range(4):
        spec = draw(load(RECIPES / f"{name}.yaml"), seed=seed)
        plates: dict[str, list[str]] = {}
        for p in spec.placed:
            if "plate" in p.variants:
                plates.setdefault(p.asset, []).append(p.variants["plate"])
        for found in plates.values():
            for i, one in enumerate(found):
                pairs += len(found) - i - 1
                equal += found[i + 1 :].count(one)
    assert pairs > 30
    assert equal < 0.1 * pairs


def test_people_of_a_kind_who_follow_each_other_are_others():
    """Over four seeds of a street no two of one model who come one after the other are the same individual, and several
    individuals are met; who has none gets none.
    """
    met: dict[str, set[str]] = {}
    for seed in range(4):
        last: dict[str, str] = {}
        for p in draw(load(RECIPES / "residential.yaml"), seed=seed).placed:
            choices = rules.model(p.asset).variants.get("individual", ())
            if p.group != "People":
                continue
            assert ("individual" in p.variants) == bool(choices)
            if choices:
                assert p.variants["individual"] != last.get(p.asset)
                last[p.asset] = p.variants["individual"]
                met.setdefault(p.asset, set()).add(last[p.asset])
    assert len(met) > 4 and max(len(found) for found in met.values()) >= 3


def test_people_who_stand_together_are_not_alike():
    """Of some 50 pairs of people within 4 m of each other in six worlds a tenth at most are at one moment of the step,
    where more stand together than there are moments; none of a kind wears the same.
    """
    pairs = alike = dressed_alike = 0
    for name in ("residential", "roundabout", "arterial"):
        for seed in (0, 5):
            people = [p for p in draw(load(RECIPES / f"{name}.yaml"), seed=seed).placed if "individual" in p.variants]
            people = [p for p in people if p.group == "People"]
            for i, one in enumerate(people):
                for other in people[i + 1 :]:
                    if np.hypot(one.x - other.x, one.y - other.y) < 4.0:
                        pairs += 1
                        alike += one.variants["individual"] == other.variants["individual"]
                        dressed_alike += one.asset == other.asset and one.variants["outfit"] == other.variants["outfit"]
    assert pairs > 15
    assert alike <= 0.1 * pairs
    assert dressed_alike == 0
