"""More cars: a city car, a crossover and a taxi.

Their bodies are built as those of `vehicles`; lengths in metres, front along +Y.
"""

from __future__ import annotations

from dataclasses import replace

from assets.builders.bodywork import Body
from assets.builders.vehicles import CARS, build_car
from synfog_usd.world.components import Component, Look
from synfog_usd.world.lettering import letters
from synfog_usd.world.shapes import Part, box, shift, soft_box, turn

TAXI_SIGN_NITS = (900.0, 620.0, 90.0)

MORE_CARS = (
    Body(
        "city_car",
        "A three-door city car, 3.60 m long.",
        3.60,
        1.66,
        1.50,
        side=[
            (-1.75, 0.20), (1.68, 0.18), (1.80, 0.30), (1.79, 0.58), (1.70, 0.76), (1.40, 0.90), (0.95, 0.985),
            (-1.15, 1.02), (-1.70, 1.02), (-1.78, 0.80), (-1.80, 0.40),
        ],
        cabin=[
            (1.22, 0.82), (1.00, 0.985), (0.42, 1.40), (-0.05, 1.50), (-0.95, 1.48), (-1.52, 1.40), (-1.74, 1.00),
            (-1.72, 0.77),
        ],
        windows=[
            [(-0.28, 1.00), (0.80, 1.00), (0.42, 1.30), (0.24, 1.40), (-0.28, 1.42)],
            [(-1.30, 1.08), (-0.36, 1.02), (-0.36, 1.42), (-1.12, 1.38)],
        ],
        screen=((1.04, 1.00), (0.44, 1.42)),
        rear=((-1.74, 1.05), (-1.52, 1.40)),
        axles=(-1.17, 1.17),
        wheel=0.29,
        roof_half=0.54,
        belt=0.97,
        outer=(0.94353, -1.7702, 1.77821, 1.47676),
        seams=[(0.86, 0.32, 0.99), (-0.32, 0.34, 1.00)],
        lamps_z=0.70,
        tail=(0.76, 1.08),
        spokes=4,
        plate=0,
        rear_plate_z=0.60,
        paints=("white", "red", "blue", "sand", "black"),
        triangles=2500,
    ),
    Body(
        "crossover",
        "A large sport utility vehicle with a sloping back, 4.72 m long.",
        4.72,
        1.90,
        1.63,
        side=[
            (-2.30, 0.28), (2.22, 0.25), (2.35, 0.40), (2.34, 0.70), (2.22, 0.87), (1.72, 0.98), (1.08, 1.06),
            (-1.35, 1.11), (-2.22, 1.13), (-2.34, 0.95), (-2.36, 0.50),
        ],
        cabin=[
            (1.28, 0.90), (1.06, 1.06), (0.34, 1.51), (-0.28, 1.62), (-1.15, 1.58), (-2.02, 1.38), (-2.26, 1.12),
            (-2.20, 0.90),
        ],
        windows=[
            [(0.0, 1.10), (0.84, 1.10), (0.37, 1.40), (0.14, 1.51), (0.0, 1.525)],
            [(-0.94, 1.13), (-0.10, 1.10), (-0.10, 1.53), (-0.90, 1.515)],
            [(-1.72, 1.20), (-1.02, 1.14), (-0.98, 1.50), (-1.40, 1.42)],
        ],
        screen=((1.10, 1.08), (0.36, 1.52)),
        rear=((-2.24, 1.18), (-2.02, 1.40)),
        axles=(-1.42, 1.44),
        wheel=0.37,
        roof_half=0.62,
        belt=1.06,
        outer=(1.05757, -2.32689, 2.3309, 1.59846),
        seams=[(0.88, 0.42, 1.08), (-0.05, 0.42, 1.09), (-0.98, 0.58, 1.11)],
        lamps_z=0.82,
        tail=(0.88, 1.14),
        tail_inner=0.62,
        spokes=10,
        plate=4,
        paints=("silver", "black", "white", "blue", "red"),
        cladding=True,
        triangles=2500,
    ),
    replace(
        CARS[1],
        name="taxi",
        about="A taxi: a saloon of 4.65 m with a sign on its roof.",
        spokes=5,
        plate=5,
        paints=("cream", "black", "yellow"),
    ),
)  # fmt: skip


def build_more_cars() -> list[Component]:
    """The bodies of `MORE_CARS`."""
    return [_with_sign(build_car(body)) if body.name == "taxi" else build_car(body) for body in MORE_CARS]


def _with_sign(car: Component) -> Component:
    """A lit box on the roof that says what it is, to the front and to the back."""
    roof = max(float(p.points[:, 2].max()) for p in car.parts)
    sign: list[Part] = [
        soft_box((-0.24, -0.30, roof - 0.005), (0.24, -0.14, roof + 0.135), "taxi_sign", radius=0.04),
        box((-0.20, -0.28, roof - 0.03), (0.20, -0.16, roof + 0.0), "black_plastic"),
    ]
    word = letters("TAXI", 0.075, "sign_black")
    sign += [p.moved(shift(0, -0.22, roof + 0.03) @ turn(spin) @ shift(0, 0.083, 0)) for spin in (0, 180) for p in word]
    lamps = {name: _glowing(look) if name != "off" else look for name, look in car.variants["lamps"].items()}
    return replace(car, parts=(*car.parts, *sign), variants={**car.variants, "lamps": lamps})


def _glowing(look: Look) -> Look:
    return replace(look, materials={**look.materials, "taxi_sign": {"emissiveColor": TAXI_SIGN_NITS}})
