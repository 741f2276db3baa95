"""What five hundred composed worlds hold: road users by class, their distances, how much of them is hidden.

`python -m docs.studies.worlds [count]` draws `count` worlds (500 if left out)
over all road recipes, seed after seed, and prints the tables of docs/worlds.md.
No stage is written and nothing is rendered.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from synfog_usd.base import resources
from synfog_usd.world import compose, library, parameters
from synfog_usd.world.authoring import APERTURE
from synfog_usd.world.roads import rules
from synfog_usd.world.spec import Placement

DISTANCES_M = (10.0, 20.0, 40.0, 70.0, 100.0)
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
WITHIN_M = 100.0
RIDDEN = {"cyclist": "bicycle", "motorcyclist": "motorcycle"}
"""What riders sit on that are one model with it."""
WHO = ("parked", "under way", "on foot")


@dataclass
class Survey:
    """Counts over all worlds.

    Attributes:
        worlds: how many of each recipe.
        classes: road users by Cityscapes class, wherever they stand.
        near: in the picture's width and within WITHIN_M, by class.
        distances: of those, by the end of the distance class [m].
        hidden: of those, by who they are and the end of the class of the share that is hidden.
        layouts: how many differ.
        users, seen: road users of a world, and those in view by at least `rules.SHARE_SEEN`.
        seconds: to draw each.
    """

    worlds: Counter[str] = field(default_factory=Counter)
    classes: Counter[str] = field(default_factory=Counter)
    near: Counter[str] = field(default_factory=Counter)
    distances: Counter[float] = field(default_factory=Counter)
    hidden: Counter[tuple[str, float]] = field(default_factory=Counter)
    layouts: int = 0
    users: list[int] = field(default_factory=list)
    seen: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


def road_recipes(folder: Path | None = None) -> list[Path]:
    """Shipped recipes of worlds with rows of props, which are roads and roundabouts, by name."""
    folder = folder or resources.folder("stages") / "recipes"
    return [path for path in sorted(folder.glob("*.yaml")) if parameters.WORLDS[compose.load(path).world].row]


def survey(count: int, *, progress: Callable[[int], None] = lambda done: None) -> Survey:
    """Draw `count` worlds, recipe by recipe and seed by seed, and count what is in them."""
    found = Survey()
    recipes = [compose.load(path) for path in road_recipes()]
    layouts = set()
    for index in range(count):
        one = recipes[index % len(recipes)]
        began = time.process_time()
        world = compose.draw(one, seed=index // len(recipes))
        found.seconds.append(time.process_time() - began)
        found.worlds[one.name.removesuffix(".yaml")] += 1
        layouts.add((tuple((p.asset, p.x, p.y) for p in world.placed), world.road.reference_line.curvature))
        users = {p.name: p for p in world.placed if library.model(p.asset).label in rules.USERS}
        found.users.append(len(users))
        found.classes.update(label for p in users.values() for label in labels(p))
        fov = math.degrees(2 * math.atan(APERTURE / 2 / world.view.focal_length))
        shares = rules.visible_shares(world.view, fov, world.placed, world.road, within_m=WITHIN_M)
        found.seen.append(sum(share >= rules.SHARE_SEEN for share in shares.values()))
        for name, share in shares.items():
            p = users[name]
            away = math.hypot(p.x - world.view.x, p.y - world.view.y)
            found.near.update(labels(p))
            found.distances[next(end for end in DISTANCES_M if away <= end)] += 1
            found.hidden[who(p), next(end for end in SHARES if 1.0 - share <= end + 1e-9)] += 1
        progress(index + 1)
    found.layouts = len(layouts)
    return found


def labels(p: Placement) -> tuple[str, ...]:
    """Classes that a road user counts for: a cyclist is a rider and a bicycle."""
    label = library.model(p.asset).label
    return (label, RIDDEN[p.asset]) if p.asset in RIDDEN else (label,)


def who(p: Placement) -> str:
    """One of WHO; what goes on the lanes has lamps at dusk, or is ridden."""
    if p.group == "People" and p.asset != "rider":
        return WHO[2]
    return WHO[1] if p.lit or p.asset in (*RIDDEN, "rider", "bicycle") else WHO[0]


def tables(found: Survey) -> str:
    """The survey as Markdown."""
    total, near = sum(found.worlds.values()), sum(found.distances.values())
    lines = [
        f"{total} worlds: {', '.join(f'{n} {name}' for name, n in sorted(found.worlds.items()))}; {found.layouts} "
        f"different layouts.",
        f"Road users of a world: {min(found.users)} to {max(found.users)}, median {statistics.median(found.users):g}; "
        f"within {WITHIN_M:g} m and in view: "
        f"{min(found.seen)} to {max(found.seen)}, median {statistics.median(found.seen):g}.",
        "",
        "| class | in all worlds | in the picture within 100 m |",
        "|---|---:|---:|",
        *(f"| {name} | {n} | {found.near[name]} |" for name, n in found.classes.most_common()),
        "",
        "| distance from the camera | share |",
        "|---|---:|",
    ]
    low = 0.0
    for end in DISTANCES_M:
        lines.append(f"| {low:g} to {end:g} m | {found.distances[end] / max(near, 1):.0%} |")
        low = end
    each = {name: max(sum(found.hidden[name, end] for end in SHARES), 1) for name in WHO}
    lines += ["", f"| hidden by something else | all | {' | '.join(WHO)} |", "|---|" + "---:|" * (1 + len(WHO))]
    for end in SHARES:
        parts = [
            sum(found.hidden[name, end] for name in WHO) / max(near, 1),
            *(found.hidden[name, end] / each[name] for name in WHO),
        ]
        lines.append(
            f"| {'nothing' if end == 0.0 else f'up to {end:.0%}'} | {' | '.join(f'{part:.0%}' for part in parts)} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    made = survey(
        wanted, progress=lambda done: print(f"{done} of {wanted}", file=sys.stderr) if done % 50 == 0 else None
    )
    print(tables(made))
    print(f"\n{statistics.median(made.seconds):.2f} s of processor time each at the median.", file=sys.stderr)
